"""Texels as a support: the texels of an image that the surface references, and bilinear queries of them (spec clauses 6.5 and
8.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..core.kernel import kernel
from ..core.threads import over_blocks
from ..scene.scene import WRAP_CLAMP, WRAP_REPEAT
from .extents import octree_depth
from .keyed import Keyed
from .morton import decode_morton
from .voxels import keys_are_sound

BLOCK = 1 << 16


@dataclass(repr=False, kw_only=True)
class TexelSupport(Keyed):
    """The texels of one image that hold values. keys, level_shift: as in Keyed; width, height: of the full image; wrap: (s, t),
    modes of scene.scene; fraction_bits: a UV is in steps of 2**-fraction_bits texels."""

    keys: np.ndarray
    level_shift: int = 0
    width: int
    height: int
    wrap: tuple[int, int]
    fraction_bits: int

    planar = True

    def __repr__(self) -> str:
        return f"<TexelSupport: {len(self.keys)} texels of {self.size[0]} x {self.size[1]}>"

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the image at this level."""
        return -(-self.width >> self.level_shift), -(-self.height >> self.level_shift)

    @property
    def depth(self) -> int:
        """Levels of the tree over the image at this level."""
        return octree_depth(max(self.size))

    def xy(self) -> np.ndarray:
        """(column, row) of every texel, int32 [N, 2]."""
        return decode_morton(self.keys)[:, :2]

    @cached_property
    def place(self) -> np.ndarray:
        """Index of every texel in the rows of its image, int64 [N]."""
        column, row = self.xy().T
        return row * np.int64(self.size[0]) + column

    @cached_property
    def rank(self) -> np.ndarray:
        """Rank of every texel of the image, int32 [height, width]; -1 for texels that are not referenced. Built at first
        access."""
        out = np.full(self.size[::-1], -1, np.int32)
        out.ravel()[self.place] = np.arange(len(self.keys), dtype=np.int32)
        return out

    def image(self, values: np.ndarray) -> np.ndarray:
        """Return the image [height, width, C] of values [N, C], one for each of these texels; other texels are 0."""
        out = np.zeros((*self.size[::-1], values.shape[1]), values.dtype)
        rows = out.reshape(-1, values.shape[1])
        if rows.dtype == np.uint8 and rows.shape[1] == 4:
            rows, values = rows.view(np.uint32), np.ascontiguousarray(values).view(np.uint32)
        rows[self.place] = values
        return out

    def has_centres(self, columns: np.ndarray, rows: np.ndarray) -> bool:
        """Return whether these are the centres of all columns and rows, in texels of the full image, and none lies outside it;
        then query() there returns the values as they are. columns, rows: float64 [W], [H]."""
        sides = zip((columns, rows), self.size, (self.width, self.height), strict=True)
        return all(len(line) == count and count << self.level_shift == full
                   and bool((line == (np.arange(count) + 0.5) * (1 << self.level_shift)).all()) for line, count, full in sides)

    def query(self, texel: np.ndarray, values: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the values at UVs of the surface (8.2): float32 [M, C]. texel: float64 [M, 2], UVs in texels of the full image;
        values: [N, C], one for each of these texels."""
        out = np.empty((len(texel), values.shape[1]), np.float32)
        rank, size = self.rank, np.array([self.width, self.height], np.int64)

        def query_block(begin):
            part = slice(begin, begin + BLOCK)
            _bilinear(texel[part], size, *self.wrap, self.level_shift, rank, values, out[part])

        over_blocks(query_block, len(texel), BLOCK, threads)
        return out


@kernel
def _folded(x, size, mode):
    """A coordinate in texels, brought into 0..size by the wrap mode; clamping leaves a margin of 1 on both sides."""
    if mode == WRAP_CLAMP:
        return min(max(x, -1.0), size + 1.0)
    if mode == WRAP_REPEAT:
        return x - np.floor(x / size) * size
    x = x - np.floor(x / (2 * size)) * (2 * size)
    return x if x < size else 2 * size - x


@kernel
def _beside(i, size, mode):
    """Column or row i, at most one outside 0..size-1, by the wrap mode."""
    if mode == WRAP_REPEAT:
        return size - 1 if i < 0 else (0 if i >= size else i)
    return min(max(i, 0), size - 1)


@kernel(allocates=True)
def _bilinear(texel, size, wrap_s, wrap_t, shift, rank, values, out):
    """Writes bilinear values to out float32 [M, C]. Texels that are not referenced get no weight; if all four are missing, the
    value is 0. Bounds: columns and rows are wrapped into the image before they index rank, int32 [H, W] below len(values)."""
    sums = np.zeros(values.shape[1], np.float64)
    for i in range(texel.shape[0]):
        x = _folded(min(max(texel[i, 0], -1e9), 1e9), size[0], wrap_s) / (1 << shift) - 0.5
        y = _folded(min(max(texel[i, 1], -1e9), 1e9), size[1], wrap_t) / (1 << shift) - 0.5
        bx, by = np.int64(np.floor(x)), np.int64(np.floor(y))
        fx, fy = x - bx, y - by
        total = 0.0
        sums[:] = 0.0
        for corner in range(4):
            dx, dy = corner & 1, corner >> 1
            w = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy)
            column = min(max(_beside(bx + dx, rank.shape[1], wrap_s), 0), rank.shape[1] - 1)
            row = min(max(_beside(by + dy, rank.shape[0], wrap_t), 0), rank.shape[0] - 1)
            at = rank[row, column]
            if w > 0.0 and at >= 0:
                total += w
                for c in range(values.shape[1]):
                    sums[c] += w * values[at, c]
        for c in range(values.shape[1]):
            out[i, c] = np.float32(sums[c] / total) if total > 0.0 else 0.0


def texels_are_sound(keys: np.ndarray, size: tuple[int, int]) -> bool:
    """Return whether keys are ascending Morton keys of texels of an image of size (width, height), at least one."""
    return keys_are_sound(keys, max(size)) and bool((decode_morton(keys).max(axis=0) < [*size, 1]).all())
