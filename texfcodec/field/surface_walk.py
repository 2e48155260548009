"""The single walk over the samples of a surface (spec 6.1 to 6.3), for voxelisation, transfer, contacts and measurements.

It uses integer arithmetic only and does not depend on vertex order, face order or start corner. Every corner is mapped to fixed
grid coordinates. Every triangle gets a canonical corner order and is covered by rows of samples parallel to its longest edge.
`_next_row` advances to the next row; the caller processes the samples of a row.
"""

from typing import NamedTuple

import numpy as np

from ..core.integer import _isqrt
from ..core.kernel import kernel

GRID_FRACTION = 16  # fractional bits of a fixed grid coordinate
FACE, ROW, ROWS, COLUMNS, UNIT, COUNT, AXIS, LOW, HIGH = range(9)  # places of SurfaceWalk.state
EVERYWHERE = 1 << 40  # beyond all voxels


class SurfaceWalk(NamedTuple):
    """State of a walk over the samples of a surface, face by face and row by row, all int64. corners [3, 3]: of the face, in
    fixed grid coordinates; order [3]: corner numbers of base start, base end and apex; start, half_step [3]: sample i of the row
    lies at start + (2 i + 1) * half_step, 32 fractional bits; state [9]: the face, the row, the face's rows and columns, its
    area per squared row count, the row's samples, the slab."""

    corners: np.ndarray
    order: np.ndarray
    start: np.ndarray
    half_step: np.ndarray
    state: np.ndarray


def surface_walk(axis: int = 0, low: int = -EVERYWHERE, high: int = EVERYWHERE) -> SurfaceWalk:
    """Return a SurfaceWalk that starts at the first face. It skips faces that have no samples in the slab low <= voxel
    index[axis] < high."""
    state = np.array([-1, 0, 0, 0, 0, 0, axis, low, high], np.int64)
    order, start, half_step = np.zeros((3, 3), np.int64)
    return SurfaceWalk(np.zeros((3, 3), np.int64), order, start, half_step, state)


def grid_coordinates(lattice: np.ndarray, position_bits: int, resolution: int) -> np.ndarray:
    """Return fixed-point grid coordinates (16 fractional bits) of lattice positions: floor(p * K * 2**16 / 2**B) (spec 6.1).

    lattice: int64 [..., 3] in 0..2**B-1, B being position_bits; resolution: K. Returns int64 of the same shape, below K * 2**16
    <= 2**29 (product < 2**49).
    """
    return (np.asarray(lattice, dtype=np.int64) * (resolution << GRID_FRACTION)) >> position_bits


@kernel
def _double_area(ux, uy, uz, vx, vy, vz):
    """Length of the cross product of two edges with |component| < 2**29.2, in units of 2**-32 voxel faces; < 2**61.

    Each product is below 2**58.4; the larger components are cut to 30 bits before squaring so that the sum stays < 2**62.
    """
    cx = abs(uy * vz - uz * vy)
    cy = abs(uz * vx - ux * vz)
    cz = abs(ux * vy - uy * vx)
    top = max(cx, max(cy, cz))
    shift = 0
    while (top >> shift) >= (1 << 30):
        shift += 1
    cx >>= shift
    cy >>= shift
    cz >>= shift
    return _isqrt(cx * cx + cy * cy + cz * cz) << shift


@kernel
def _precedes(g, a, b):
    for axis in range(3):
        if g[a, axis] != g[b, axis]:
            return g[a, axis] < g[b, axis]
    return False


@kernel
def _reach(g, a, b):
    """Chebyshev distance of corners a and b."""
    return max(abs(g[a, 0] - g[b, 0]), max(abs(g[a, 1] - g[b, 1]), abs(g[a, 2] - g[b, 2])))


@kernel
def _triangle_frame(g, per_edge, order):
    """Canonical frame of one triangle (spec 6.2): (columns n, rows m, area per squared row count).

    g: int64 [3, 3] fixed grid coordinates; order: int64 [3], filled with the corner numbers (base start, base end, apex). n <=
    per_edge * 2**13, m <= 3 * per_edge * 2**13; per_edge * area < 2**63 for per_edge <= 4.
    """
    a, b, c = 0, 1, 2
    if _precedes(g, b, a):
        a, b = b, a
    if _precedes(g, c, b):
        b, c = c, b
    if _precedes(g, b, a):
        a, b = b, a
    ab, ac, bc = _reach(g, a, b), _reach(g, a, c), _reach(g, b, c)
    if ab >= ac and ab >= bc:
        order[0], order[1], order[2], base = a, b, c, ab
    elif ac >= bc:
        order[0], order[1], order[2], base = a, c, b, ac
    else:
        order[0], order[1], order[2], base = b, c, a, bc
    if base == 0:
        return np.int64(1), np.int64(1), np.int64(0)
    s, e, t = order[0], order[1], order[2]
    area = _double_area(g[e, 0] - g[s, 0], g[e, 1] - g[s, 1], g[e, 2] - g[s, 2],
                        g[t, 0] - g[s, 0], g[t, 1] - g[s, 1], g[t, 2] - g[s, 2])
    voxel_edge = np.int64(1) << GRID_FRACTION
    columns = max(np.int64(1), (base * per_edge + voxel_edge - 1) >> GRID_FRACTION)
    height = area // base
    rows = max(np.int64(1), (height * per_edge + voxel_edge - 1) >> GRID_FRACTION)
    return columns, rows, area // (rows * rows)


@kernel
def _row_offset(columns, rows):
    """Height of a row above the lower edge of its band, in half bands (spec 6.3): 1, the middle, but 0, the edge itself, for
    slivers. The sides of a sliver are so slanted that a row in the middle would leave its ends without samples."""
    return np.int64(0) if columns > 4 * rows else np.int64(1)


@kernel
def _load_corners(corners, faces, f, g):
    """Writes the fixed grid coordinates of face f to g int64 [3, 3]; the faces have been checked against the corners."""
    for c in range(3):
        for d in range(3):
            g[c, d] = corners[faces[f, c], d]


@kernel
def _misses_slab(g, axis, low, high):
    """Return whether no sample of the triangle can have low <= voxel index[axis] < high. All divisions of a row round down, so a
    sample lies up to 2 * 2**-16 voxels below the triangle's least coordinate and never above its largest."""
    first = (min(g[0, axis], min(g[1, axis], g[2, axis])) - 2) >> GRID_FRACTION
    last = max(g[0, axis], max(g[1, axis], g[2, axis])) >> GRID_FRACTION
    return first >= high or last < low


@kernel
def _next_row(corners, faces, per_edge, walk):
    """Advances to the next row of samples (spec 6.3), or to the next face after the last row. Returns the number of samples in
    the row, 0 at the end of the surface. corners: int64 [V, 3] fixed grid coordinates; faces: int64 [F, 3], checked against the
    corners."""
    g, order, state = walk.corners, walk.order, walk.state
    state[ROW] += 1
    if state[ROW] >= state[ROWS]:
        f = state[FACE] + 1
        while f < faces.shape[0]:
            _load_corners(corners, faces, f, g)
            if not _misses_slab(g, state[AXIS], state[LOW], state[HIGH]):
                break
            f += 1
        state[FACE], state[ROW] = f, 0
        if f >= faces.shape[0]:
            state[ROWS] = 0
            return np.int64(0)
        state[COLUMNS], state[ROWS], state[UNIT] = _triangle_frame(g, per_edge, order)
    j, columns, rows = state[ROW], state[COLUMNS], state[ROWS]
    offset = _row_offset(columns, rows)
    left = 2 * rows - 2 * j - offset
    count = max(np.int64(1), (columns * left + 2 * rows - 1) // (2 * rows))
    for axis in range(3):
        s, e, t = g[order[0], axis], g[order[1], axis], g[order[2], axis]
        walk.start[axis] = (s + ((t - s) * (2 * j + offset)) // (2 * rows)) << 16
        walk.half_step[axis] = ((((e - s) * left) // (2 * rows)) << 16) // (2 * count)
    state[COUNT] = count
    return count


@kernel
def _sample_area(state):
    """Area that each sample of the row represents, in units of 2**-32 voxel faces. state: SurfaceWalk.state."""
    rows = state[ROWS]
    return (state[UNIT] * (2 * rows - 2 * state[ROW] - 1)) // (2 * state[COUNT])


@kernel
def _row_height(state):
    """Height of the row between base and apex, 0..1: the apex's barycentric coordinate of all its samples."""
    rows = state[ROWS]
    return (2 * state[ROW] + _row_offset(state[COLUMNS], rows)) / (2.0 * rows)
