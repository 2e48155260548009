"""Deterministic voxelisation: which voxels a surface touches and how much surface each of them holds (spec clause 6).

Each sample of the walk over the surface (surface_walk.py) marks the voxel it lies in and adds its share of the triangle's area
there. Integer arithmetic only.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..core.kernel import kernel
from ..errors import LimitError
from .morton import _morton_key
from .surface_walk import (
    AXIS,
    GRID_FRACTION,
    HIGH,
    LOW,
    _load_corners,
    _next_row,
    _sample_area,
    _triangle_frame,
    grid_coordinates,
    surface_walk,
)

SAMPLES_PER_EDGE = 2  # at least this many samples per voxel edge in either direction of the triangle (normative)
AREA_FRACTION = 32  # area weights are in units of 2**-32 voxel faces
MAX_VOXELS = 1 << 40  # in place of no limit
MIN_SLAB_SAMPLES = 1 << 17  # below this a second thread costs more than it brings


@kernel
def _slot(key, keys):
    """Slot of key in an open-addressing table (its own, or the first free one): keys of one 4x4x4 brick lie side by side."""
    mask = keys.shape[0] - 1
    brick = key >> 6
    slot = ((((brick ^ (brick >> 13)) * 2654435) << 6) ^ (key & 63)) & mask
    while keys[slot] >= 0 and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel(allocates=True)
def _grown(keys, weights):
    keys2, weights2 = np.zeros(keys.shape[0] * 2, np.int64), np.zeros(keys.shape[0] * 2, np.int64)
    keys2[:] = -1
    for i in range(keys.shape[0]):
        if keys[i] >= 0:
            slot = _slot(keys[i], keys2)
            keys2[slot] = keys[i]
            weights2[slot] = weights[i]
    return keys2, weights2


@kernel(allocates=True)
def _touched(corners, faces, resolution, walk, log2_slots, most, total):
    """Voxels of the walk's slab: int64 [2, n], keys in table order and weights; n in total [1]. Stops as soon as there are more
    than `most`, so that memory stays in proportion to that, and returns none of them. One array, because numba lets an interrupt
    through between two, and crashes on it.

    corners: int64 [V, 3] fixed grid coordinates; faces: int64 [F, 3], already checked against V by the caller's gather.
    A voxel's weight stays below 2**62: at most 2**31 samples (checked by the caller) of at most 2**31 each.
    """
    # One way of making arrays, np.zeros, in all kernels of this file: each costs a first run a tenth of a second
    keys, weights = np.zeros(1 << log2_slots, np.int64), np.zeros(1 << log2_slots, np.int64)
    keys[:] = -1
    used = 0
    start, half, state = walk.start, walk.half_step, walk.state
    axis, low, high = state[AXIS], state[LOW], state[HIGH]
    last = resolution - 1
    while True:
        count = _next_row(corners, faces, SAMPLES_PER_EDGE, walk)
        if count == 0:
            break
        share = _sample_area(state)
        run_key, run = np.int64(-1), np.int64(0)
        x, y, z = start[0] + half[0], start[1] + half[1], start[2] + half[2]
        dx, dy, dz = 2 * half[0], 2 * half[1], 2 * half[2]
        for i in range(count + 1):
            key = np.int64(-1)
            if i < count:
                vx = min(max(x >> 32, 0), last)
                vy = min(max(y >> 32, 0), last)
                vz = min(max(z >> 32, 0), last)
                along = vx if axis == 0 else (vy if axis == 1 else vz)
                if low <= along < high:
                    key = _morton_key(vx, vy, vz)
                x += dx
                y += dy
                z += dz
            if key != run_key:
                if run_key >= 0:
                    slot = _slot(run_key, keys)
                    if keys[slot] < 0:
                        keys[slot] = run_key
                        used += 1
                        if used > most:
                            total[0] = used
                            return np.empty((2, 0), np.int64)
                    weights[slot] += run
                    if 2 * used > keys.shape[0]:
                        keys, weights = _grown(keys, weights)
                run_key, run = key, np.int64(0)
            run += share
    n = 0
    out = np.zeros((2, used), np.int64)
    for i in range(keys.shape[0]):
        if keys[i] >= 0:
            out[0, n] = keys[i]
            out[1, n] = weights[i]
            n += 1
    total[0] = used
    return out


@kernel(allocates=True)
def _count_samples(corners, faces, per_edge, counts):
    """Upper bound of the samples of every face into counts int64 [F]; returns their sum (saturating at 2**62)."""
    g, order = np.zeros((3, 3), np.int64), np.zeros(3, np.int64)
    total = np.int64(0)
    for f in range(faces.shape[0]):
        _load_corners(corners, faces, f, g)
        columns, rows, _ = _triangle_frame(g, per_edge, order)
        counts[f] = (columns * (rows + 1) + 1) // 2 + rows
        total = min(total + counts[f], np.int64(1) << 62)
    return total


def _slabs(corners, faces, counts, resolution, threads):
    """Cuts the grid across its longest axis into slabs of about equal work: (axis, boundaries)."""
    span = corners.max(axis=0) - corners.min(axis=0)
    axis = int(np.argmax(span))
    slabs = int(max(1, min(threads, counts.sum() // MIN_SLAB_SAMPLES)))
    if slabs == 1:
        return axis, [0, resolution]
    middle = corners[faces, axis].sum(axis=1) // 3 >> GRID_FRACTION
    work = np.cumsum(np.bincount(np.clip(middle, 0, resolution - 1), weights=counts, minlength=resolution))
    cuts = np.searchsorted(work, work[-1] * np.arange(1, slabs) / slabs)
    return axis, sorted({0, resolution, *(int(c) for c in cuts)})


def count_samples(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                  per_edge: int = SAMPLES_PER_EDGE) -> int:
    """Upper bound of the samples that voxelise() will take, in time linear in the faces. Arguments as there."""
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    return int(_count_samples(corners, np.ascontiguousarray(faces, np.int64), per_edge, np.empty(len(faces), np.int64)))


def voxelise(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int, area_threshold: int = 0,
             threads: int = 1, max_voxels: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Active voxels of a surface (spec clause 6).

    lattice: int64 [V, 3] in 0..2**position_bits-1; faces: int64 [F, 3] in 0..V-1; resolution K: 1..8192.
    area_threshold: voxels with less than area_threshold / 256 voxel faces of surface are dropped.
    Returns (keys int64 [N], ascending Morton keys; weights int64 [N], area in units of 2**-32 voxel faces).
    Raises LimitError when the surface touches more than max_voxels voxels.
    """
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if len(faces) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    if faces.min() < 0 or faces.max() >= len(lattice):
        raise IndexError("face index outside the vertex list")
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    counts = np.empty(len(faces), np.int64)
    total = _count_samples(corners, faces, SAMPLES_PER_EDGE, counts)
    axis, bounds = _slabs(corners, faces, counts, resolution, threads)
    most = MAX_VOXELS if max_voxels is None else max_voxels
    log2_slots = int(np.clip(min(total // (2 * (len(bounds) - 1)), 2 * most), 64, 1 << 22)).bit_length()

    def voxels_of(slab):
        used = np.zeros(1, np.int64)
        return *_touched(corners, faces, resolution, surface_walk(axis, *slab), log2_slots, most, used), int(used[0])

    jobs = list(zip(bounds[:-1], bounds[1:], strict=True))
    if len(jobs) == 1:
        parts = [voxels_of(jobs[0])]
    else:
        with ThreadPoolExecutor(len(jobs)) as pool:
            parts = list(pool.map(voxels_of, jobs))
    if sum(p[2] for p in parts) > most:
        raise LimitError("TXF-L04", "the surface touches more voxels than the limit allows", clause="6.3", allowed=most)
    keys = np.concatenate([p[0] for p in parts])
    weights = np.concatenate([p[1] for p in parts])
    order = np.argsort(keys)
    keys, weights = keys[order], weights[order]
    if area_threshold:
        keep = weights >= (area_threshold << (AREA_FRACTION - 8))
        keys, weights = keys[keep], weights[keep]
    return keys, weights
