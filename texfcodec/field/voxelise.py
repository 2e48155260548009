"""Deterministic voxelisation: the voxels that a surface touches and the area in each (spec clause 6).

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
BRICK, MARKS, WEIGHTS, ROW = 0, 1, 2, 10  # of a brick of 2 x 2 x 2: its key, the voxels touched, a bit each, their weights
MIN_SLAB_SAMPLES = 1 << 17  # below this a second thread costs more than it brings


@kernel
def _slot(brick, slots, rows):
    """Slot of a brick in an open-addressing table of row numbers plus 1: its own, or the first free one. 32 adjacent bricks have
    adjacent slots."""
    mask = slots.shape[0] - 1
    group = brick >> 5
    slot = ((((group ^ (group >> 13)) * 2654435) << 5) ^ (brick & 31)) & mask
    while slots[slot] > 0 and rows[slots[slot] - 1, BRICK] != brick:
        slot = (slot + 1) & mask
    return slot


@kernel(allocates=True)
def _grown(rows):
    more = np.zeros((2 * rows.shape[0], ROW), np.int64)
    for n in range(rows.shape[0]):  # more[:n] = rows would compile 13 kernels of text for its error
        for i in range(ROW):
            more[n, i] = rows[n, i]
    return more


@kernel(allocates=True)
def _slots_of(rows):
    """A table of slots for twice as many bricks as there are rows."""
    slots = np.zeros(4 * rows.shape[0], np.int64)
    for n in range(rows.shape[0]):
        slots[_slot(rows[n, BRICK], slots, rows)] = n + 1
    return slots


@kernel(allocates=True)
def _touched(corners, faces, resolution, walk, log2_bricks, most, total):
    """Returns the bricks of the walk's slab, int64 [n, ROW] in the order of their first sample, and writes the number of their
    voxels to total [1]. Stops and returns no bricks once there are more than `most` voxels, so that memory stays in proportion to
    it. It returns one array, because numba lets an interrupt through between two and then crashes.

    corners: int64 [V, 3] fixed grid coordinates; faces: int64 [F, 3], already checked against V by the caller's gather. A voxel's
    weight stays below 2**62: at most 2**31 samples (checked by the caller) of at most 2**31 each.
    """
    # One way of making arrays, np.zeros, in all kernels of this file: each costs a first run a tenth of a second
    rows, slots = np.zeros((1 << log2_bricks, ROW), np.int64), np.zeros(4 << log2_bricks, np.int64)
    used, n, last_brick, row = 0, 0, np.int64(-1), 0
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
                    brick, place = run_key >> 3, run_key & 7
                    if brick != last_brick:
                        slot = _slot(brick, slots, rows)
                        if slots[slot] == 0:
                            if n == rows.shape[0]:
                                rows = _grown(rows)
                                slots = _slots_of(rows[:n])
                                slot = _slot(brick, slots, rows)
                            rows[n, BRICK] = brick
                            n += 1
                            slots[slot] = n
                        last_brick, row = brick, slots[slot] - 1
                    if not (rows[row, MARKS] >> place) & 1:
                        rows[row, MARKS] |= 1 << place
                        used += 1
                        if used > most:
                            total[0] = used
                            return np.zeros((0, ROW), np.int64)
                    rows[row, WEIGHTS + place] += run
                run_key, run = key, np.int64(0)
            run += share
    total[0] = used
    return rows[:n]


@kernel
def _voxels_of(rows, order, least, keys, weights):
    """Fills keys and weights int64 [N] with the voxels of weight at least `least`, from bricks int64 [n, ROW] in an order int64
    [n]. Returns their number."""
    n = 0
    for i in range(order.shape[0]):
        row = order[i]
        for place in range(8):
            if (rows[row, MARKS] >> place) & 1 and rows[row, WEIGHTS + place] >= least:
                keys[n] = rows[row, BRICK] << 3 | place
                weights[n] = rows[row, WEIGHTS + place]
                n += 1
    return n


@kernel(allocates=True)
def _count_samples(corners, faces, per_edge, counts):
    """Writes an upper bound of every face's samples to counts int64 [F]. Returns their sum (saturating at 2**62)."""
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
    return axis, sorted({0, resolution, *(int(c) & ~1 for c in cuts)})  # no brick is in two


def count_samples(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                  per_edge: int = SAMPLES_PER_EDGE) -> int:
    """Return an upper bound of the samples of the surface that voxelise() takes, in time linear in the faces. Arguments as
    there."""
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    return int(_count_samples(corners, np.ascontiguousarray(faces, np.int64), per_edge, np.empty(len(faces), np.int64)))


def voxelise(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int, area_threshold: int = 0,
             threads: int = 1, max_voxels: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the active voxels, those that hold part of a surface (spec clause 6): (keys int64 [N], ascending Morton keys;
    weights int64 [N], area of the surface in each, in units of 2**-32 voxel faces).

    lattice: int64 [V, 3] in 0..2**position_bits-1; faces: int64 [F, 3] in 0..V-1; resolution K: 1..8192; area_threshold: voxels
    with less than area_threshold / 256 voxel faces of surface are dropped. Raises LimitError if the surface touches more than
    max_voxels voxels.
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
    log2_bricks = int(np.clip(min(total // (32 * (len(bounds) - 1)), most), 64, 1 << 20)).bit_length()

    def bricks_of(slab):
        used = np.zeros(1, np.int64)
        return _touched(corners, faces, resolution, surface_walk(axis, *slab), log2_bricks, most, used), int(used[0])

    jobs = list(zip(bounds[:-1], bounds[1:], strict=True))
    if len(jobs) == 1:
        parts = [bricks_of(jobs[0])]
    else:
        with ThreadPoolExecutor(len(jobs)) as pool:
            parts = list(pool.map(bricks_of, jobs))
    used = sum(p[1] for p in parts)
    if used > most:
        raise LimitError("TXF-L04", "the surface touches more voxels than the limit allows", clause="6.3", allowed=most)
    rows = parts[0][0] if len(parts) == 1 else np.concatenate([p[0] for p in parts])
    keys, weights = np.empty(used, np.int64), np.empty(used, np.int64)
    n = _voxels_of(rows, np.argsort(rows[:, BRICK]), area_threshold << (AREA_FRACTION - 8), keys, weights)
    return (keys, weights) if n == used else (keys[:n].copy(), weights[:n].copy())
