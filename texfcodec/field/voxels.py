"""Voxels as a support: sorted keys, and queries at surface points (spec clauses 6 and 8)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .extents import octree_depth
from .grid import BrickMap, build_brick_map
from .keyed import Keyed
from .morton import decode_morton
from .query import query_field
from .voxelise import voxelise

if TYPE_CHECKING:
    from ..geometry.canonical import CanonicalCube

MOST_DROPPED = 0.1  # share of the surface that the area threshold may leave without a voxel of its own


@dataclass(repr=False)
class VoxelSupport(Keyed):
    """The voxels of one grid that hold values. resolution: K of the full grid; keys, level_shift: as in Keyed."""

    resolution: int
    keys: np.ndarray
    level_shift: int = 0

    def __repr__(self) -> str:
        return f"<VoxelSupport: {len(self.keys)} voxels of {self.size} a side>"

    @property
    def depth(self) -> int:
        """Levels of the octree over the grid at this level."""
        return octree_depth(self.size)

    @property
    def size(self) -> int:
        """Voxels a side of the grid at this level."""
        return -(-self.resolution >> self.level_shift)

    @cached_property
    def brick_map(self) -> BrickMap:
        """Maps voxels to ranks; built at first access."""
        return build_brick_map(self.keys)

    def xyz(self) -> np.ndarray:
        """Voxel indices, int32 [N, 3]."""
        return decode_morton(self.keys)

    def query(self, cube: CanonicalCube, points: np.ndarray, values: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the values at surface points (8.2): float32 [M, C]. cube: CanonicalCube, which maps points to the grid; points:
        float64 [M, 3] in world space; values: [N, C], one for each of these voxels."""
        grid = cube.to_grid(points, self.resolution) / (1 << self.level_shift)
        return query_field(grid, self.size, self.keys, self.brick_map, values, threads)[0]


def kept_voxels(surface: tuple[np.ndarray, np.ndarray], position_bits: int, resolution: int, area_threshold: int,
                threads: int, most_voxels: int | None) -> tuple[np.ndarray, int]:
    """Choose the voxels of a field and the area threshold to code: (ascending Morton keys int64 [N], threshold). Voxels with
    less surface than area_threshold / 256 voxel faces are dropped, unless more than MOST_DROPPED of the surface would then be
    without voxels: all stay, and the threshold is 0. surface: (lattice, faces), decoded; most_voxels: limit, or None. Encoder
    only. Raises LimitError."""
    lattice, faces = surface
    keys, weights = voxelise(lattice, faces, position_bits, resolution, 0, threads, most_voxels)
    keep = weights >= area_threshold << 24
    if weights[~keep].sum(dtype=np.float64) > MOST_DROPPED * weights.sum(dtype=np.float64) or not keep.any():
        return keys, 0
    return keys[keep], area_threshold


def keys_are_sound(keys: np.ndarray, size: int) -> bool:
    """Return whether keys are ascending Morton keys of voxels of a grid of `size` a side, at least one."""
    if keys.ndim != 1 or not len(keys):
        return False
    ascending = keys[0] >= 0 and (np.diff(keys) > 0).all() and keys[-1] < 1 << 42
    if not ascending:
        return False
    xyz = decode_morton(keys)
    return bool(xyz.min() >= 0 and xyz.max() < size)
