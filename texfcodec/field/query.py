"""Asking a field at surface points: trilinear over the active corners, nearest active voxel as fallback (spec clause 8.2)."""


import numpy as np

from ..core.kernel import kernel
from ..core.threads import over_blocks
from .grid import BrickMap, _rank_of_voxel
from .morton import decode_morton

SEARCH_RINGS = 3
BLOCK = 1 << 16


@kernel
def _nearest(x, y, z, size, slots, bricks, words, ranks):
    """Rank of the active voxel whose centre is nearest to (x, y, z), -1 where none is within SEARCH_RINGS + 0.5 (up to there
    the cube that is searched holds every candidate). Ties go to the first in x, then y, then z."""
    bx, by, bz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    best, found = (SEARCH_RINGS + 0.5) ** 2, np.int64(-1)
    for ix in range(bx - SEARCH_RINGS, bx + SEARCH_RINGS + 1):
        for iy in range(by - SEARCH_RINGS, by + SEARCH_RINGS + 1):
            for iz in range(bz - SEARCH_RINGS, bz + SEARCH_RINGS + 1):
                d = (ix + 0.5 - x) ** 2 + (iy + 0.5 - y) ** 2 + (iz + 0.5 - z) ** 2
                if d < best:
                    rank = _rank_of_voxel(ix, iy, iz, size, slots, bricks, words, ranks)
                    if rank >= 0:
                        best, found = d, rank
    return found


@kernel
def _query(points, size, slots, bricks, words, ranks, values, out, missed):
    """Trilinear answers into out float32 [M, C]; missed uint8 [M]: 1 where the nearest voxel answered, 2 where none was near."""
    sums = np.zeros(values.shape[1], np.float64)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        bx, by, bz = np.int64(np.floor(x - 0.5)), np.int64(np.floor(y - 0.5)), np.int64(np.floor(z - 0.5))
        fx, fy, fz = x - 0.5 - bx, y - 0.5 - by, z - 0.5 - bz
        total = 0.0
        sums[:] = 0.0
        for corner in range(8):
            dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
            w = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy) * (fz if dz else 1.0 - fz)
            if w <= 0.0:
                continue
            rank = _rank_of_voxel(bx + dx, by + dy, bz + dz, size, slots, bricks, words, ranks)
            if rank >= 0:
                total += w
                for c in range(values.shape[1]):
                    sums[c] += w * values[rank, c]
        missed[i] = 0
        if total > 0.0:
            for c in range(values.shape[1]):
                out[i, c] = np.float32(sums[c] / total)
            continue
        rank = _nearest(x, y, z, size, slots, bricks, words, ranks)
        missed[i] = 1 if rank >= 0 else 2
        for c in range(values.shape[1]):
            out[i, c] = values[rank, c] if rank >= 0 else 0.0


def query_field(points: np.ndarray, resolution: int, keys: np.ndarray, brick_map: BrickMap, values: np.ndarray,
                threads: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Values of one field at grid points.

    points: float64 [M, 3] grid coordinates (voxel v covers [v, v + 1)); keys: int64 [N], N >= 1; values: uint8 or float32 [N, C].
    Returns (float32 [M, C], uint8 [M]: 0 trilinear, 1 nearest active voxel within reach, 2 nearest found by search of all).
    """
    points = np.clip(np.asarray(points, np.float64), -1e6, 1e6)
    out, missed = np.empty((len(points), values.shape[1]), np.float32), np.empty(len(points), np.uint8)

    def one(begin):
        part = slice(begin, begin + BLOCK)
        _query(points[part], resolution, *brick_map.arrays, values, out[part], missed[part])

    over_blocks(one, len(points), BLOCK, threads)
    far = np.flatnonzero(missed == 2)
    if len(far):
        from scipy.spatial import cKDTree

        _, rank = cKDTree(decode_morton(keys) + 0.5).query(points[far])
        out[far] = values[rank]
    return out, missed
