"""Evaluates a field at surface points: trilinear over the active corners, else the nearest active voxel (spec clause 8.2)."""


import numpy as np

from ..core.kernel import kernel
from ..core.threads import over_blocks
from .grid import BrickMap, _rank_of_voxel
from .morton import decode_morton, encode_morton

SEARCH_RINGS = 3
BLOCK = 1 << 16


@kernel
def _nearest(x, y, z, size, slots, bricks, words, ranks):
    """Rank of the active voxel whose centre is nearest to (x, y, z); -1 if none is within SEARCH_RINGS + 0.5, the distance up to
    which the searched cube contains every candidate. Ties go to the first in x, then y, then z."""
    bx, by, bz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    best, nearest = (SEARCH_RINGS + 0.5) ** 2, np.int64(-1)
    for ix in range(bx - SEARCH_RINGS, bx + SEARCH_RINGS + 1):
        for iy in range(by - SEARCH_RINGS, by + SEARCH_RINGS + 1):
            for iz in range(bz - SEARCH_RINGS, bz + SEARCH_RINGS + 1):
                d = (ix + 0.5 - x) ** 2 + (iy + 0.5 - y) ** 2 + (iz + 0.5 - z) ** 2
                if d < best:
                    rank = _rank_of_voxel(ix, iy, iz, size, slots, bricks, words, ranks)
                    if rank >= 0:
                        best, nearest = d, rank
    return nearest


@kernel(allocates=True)
def _query(points, size, slots, bricks, words, ranks, values, out, missed):
    """Writes trilinear values to out float32 [M, C] and to missed uint8 [M]: 1 for the nearest voxel's value, 2 if no voxel is
    near."""
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
    """Return the values of one field at points, and how each was obtained: (float32 [M, C], uint8 [M]). The latter is 0 for
    trilinear interpolation, 1 for the nearest active voxel within reach, 2 for the nearest of all voxels.

    points: float64 [M, 3] grid coordinates (voxel v covers [v, v + 1)); resolution: cells a side; keys: int64 [N], N >= 1,
    ascending Morton keys of the voxels; brick_map: BrickMap of keys; values: uint8 or float32 [N, C], of the voxels.
    """
    points = np.clip(np.asarray(points, np.float64), -1e6, 1e6)
    out, missed = np.empty((len(points), values.shape[1]), np.float32), np.empty(len(points), np.uint8)

    def query_block(begin):
        part = slice(begin, begin + BLOCK)
        _query(points[part], resolution, *brick_map.arrays, values, out[part], missed[part])

    over_blocks(query_block, len(points), BLOCK, threads)
    far = np.flatnonzero(missed == 2)
    if len(far):
        out[far] = values[nearest_of_all(points[far], resolution, keys)]
    return out, missed


def nearest_of_all(points: np.ndarray, resolution: int, keys: np.ndarray) -> np.ndarray:
    """Return the rank, int64 [M], of the voxel whose centre is nearest to each point; of several the lowest.

    points: float64 [M, 3] grid coordinates; keys: int64 [N], N >= 1, ascending Morton keys of voxels below resolution on each
    axis.
    """
    inside = np.clip(np.floor(points), 0, resolution - 1).astype(np.int64)
    guess = np.minimum(np.searchsorted(keys, encode_morton(inside)), len(keys) - 1)
    rank = np.empty(len(points), np.int64)
    _descend(np.ascontiguousarray(points), keys, decode_morton(keys), int(resolution - 1).bit_length(), guess, rank)
    return rank


@kernel(allocates=True)
def _descend(points, keys, xyz, levels, guess, rank):
    """Writes to rank int64 [M] the nearest voxel of each point. Ascending Morton keys form an octree: the keys of a cube are
    contiguous. Cubes farther than the best voxel so far are skipped. A cube is replaced by at most 8 smaller ones, so levels <=
    16 need 8 * 17 places."""
    first, last, level = np.empty(136, np.int64), np.empty(136, np.int64), np.empty(136, np.int64)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        nearest = guess[i]
        best = (xyz[nearest, 0] + 0.5 - x) ** 2 + (xyz[nearest, 1] + 0.5 - y) ** 2 + (xyz[nearest, 2] + 0.5 - z) ** 2
        first[0], last[0], level[0], waiting = 0, keys.shape[0], levels, 1
        while waiting > 0:
            waiting -= 1
            k, end, bits = first[waiting], last[waiting], level[waiting]
            if _square_distance(x, y, z, xyz[k, 0], xyz[k, 1], xyz[k, 2], bits) > best:
                continue
            if bits == 0:  # a voxel
                d = (xyz[k, 0] + 0.5 - x) ** 2 + (xyz[k, 1] + 0.5 - y) ** 2 + (xyz[k, 2] + 0.5 - z) ** 2
                if d < best or (d == best and k < nearest):
                    best, nearest = d, k
                continue
            while k < end:
                part = keys[k] >> 3 * (bits - 1)
                low, high = k + 1, end  # the first key of another part lies in low..high
                while low < high:
                    middle = (low + high) // 2
                    if keys[middle] >> 3 * (bits - 1) == part:
                        low = middle + 1
                    else:
                        high = middle
                first[waiting], last[waiting], level[waiting] = k, low, bits - 1
                waiting += 1
                k = low
        rank[i] = nearest


@kernel
def _square_distance(x, y, z, vx, vy, vz, bits):
    """Least squared distance from a point to the voxel centres in the cube of 2^bits voxels a side that contains voxel (vx, vy,
    vz)."""
    reach = np.int64(1) << bits
    dx = _outside(x, (vx >> bits) << bits, reach)
    dy = _outside(y, (vy >> bits) << bits, reach)
    dz = _outside(z, (vz >> bits) << bits, reach)
    return dx * dx + dy * dy + dz * dz


@kernel
def _outside(x, begin, reach):
    return max(begin + 0.5 - x, x - (begin + reach - 0.5), 0.0)
