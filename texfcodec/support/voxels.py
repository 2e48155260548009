"""Voxels as the support of values: sorted keys, and what a surface point asks of them (spec clauses 6 and 8).

EncodeOptions stand in a later room, so that signatures here say Any.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .grid import BrickMap, build_brick_map
from .layout import octree_depth
from .morton import decode_morton
from .query import query_field
from .voxelise import voxelise

if TYPE_CHECKING:
    from ..geometry.canonical import CanonicalCube

MOST_DROPPED = 0.1  # share of the surface that the area threshold may leave without a voxel of its own


@dataclass(repr=False)
class VoxelSupport:
    """Voxels that values live in. resolution: K of the full grid; keys: int64 [N] ascending Morton keys; level_shift: octree
    levels that were left out, a voxel here being 2**level_shift of the full ones a side."""

    resolution: int
    keys: np.ndarray
    level_shift: int = 0
    planar: ClassVar[bool] = False

    def __repr__(self) -> str:
        return f"<VoxelSupport: {len(self.keys)} voxels of {self.size} a side>"

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def depth(self) -> int:
        """Levels of the octree over the grid at hand."""
        return octree_depth(self.size)

    @property
    def size(self) -> int:
        """Voxels a side of the grid at hand."""
        return -(-self.resolution >> self.level_shift)

    @cached_property
    def brick_map(self) -> BrickMap:
        """Finds the rank of a voxel; built when it is first asked for."""
        return build_brick_map(self.keys)

    def xyz(self) -> np.ndarray:
        """Voxel indices, int32 [N, 3]."""
        return decode_morton(self.keys)

    def coarser(self, levels: int) -> VoxelSupport:
        """The support with so many octree levels less, but for the root."""
        shift = min(levels, self.depth)
        return VoxelSupport(self.resolution, np.unique(self.keys >> 3 * shift), self.level_shift + shift) if shift else self

    def mean(self, values: np.ndarray, levels: int) -> np.ndarray:
        """Rounded means of values uint8 [N, C] over the voxels of coarser(levels), uint8 [n, C] (spec clause 8.3)."""
        parents = self.keys >> 3 * min(levels, self.depth)
        first = np.flatnonzero(np.diff(parents, prepend=-1))
        counts = np.diff(np.append(first, len(parents)))[:, None]
        sums = np.add.reduceat(values.astype(np.int64), first, axis=0)
        return ((2 * sums + counts) // (2 * counts)).astype(np.uint8)

    def query(self, cube: CanonicalCube, points: np.ndarray, values: np.ndarray, threads: int = 1) -> np.ndarray:
        """Values at surface points (8.2): float32 [M, C]. cube: CanonicalCube; points: float64 [M, 3], world; values: [N, C]."""
        grid = cube.to_grid(points, self.resolution) / (1 << self.level_shift)
        return query_field(grid, self.size, self.keys, self.brick_map, values, threads)[0]


def kept_voxels(surface: tuple[np.ndarray, np.ndarray], position_bits: int, resolution: int,
                options: Any) -> tuple[np.ndarray, int]:
    """Voxels of a decoded surface (lattice, faces), ascending keys int64 [N], and the area threshold that they are kept by:
    options.area_threshold, unless it would leave more than MOST_DROPPED of the surface without voxels. Encoder only."""
    keys, weights = voxelise(*surface, position_bits, resolution, 0, options.threads, options.limits.voxels)
    keep = weights >= options.area_threshold << 24
    if weights[~keep].sum(dtype=np.float64) > MOST_DROPPED * weights.sum(dtype=np.float64) or not keep.any():
        return keys, 0
    return keys[keep], options.area_threshold


def voxels_crc(keys: np.ndarray) -> int:
    """CRC-32 over the Morton keys as 64-bit little-endian numbers (spec 6.4)."""
    return zlib.crc32(np.ascontiguousarray(keys, "<i8").data)


def keys_are_sound(keys: np.ndarray, size: int) -> bool:
    """Whether these are Morton keys of voxels of a grid of `size` a side, ascending, at least one."""
    if keys.ndim != 1 or not len(keys):
        return False
    ascending = keys[0] >= 0 and (np.diff(keys) > 0).all() and keys[-1] < 1 << 42
    if not ascending:
        return False
    xyz = decode_morton(keys)
    return bool(xyz.min() >= 0 and xyz.max() < size)
