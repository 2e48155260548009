"""The samples of the voxelisation (spec 6.3) as arrays, a batch at a time, for whatever looks at the surface evenly by area."""

from collections.abc import Iterator

import numpy as np

from ..core.kernel import kernel
from .voxelise import _load_corners, _row, _row_offset, _triangle_frame, grid_coordinates

BATCH = 1 << 18  # samples a batch; a row has at most 2**16


@kernel
def _next_samples(corners, faces, per_edge, place, points, face, bary, share):
    """Fills the arrays with whole rows of samples from place, int64 [2] (face, row), on, which is moved; returns their number.

    points: float64 [M, 3] grid coordinates; bary: float64 [M, 3]; share: float64 [M] area in voxel faces. The faces have been
    checked against the corners.
    """
    g, order = np.empty((3, 3), np.int64), np.empty(3, np.int64)
    start, half = np.empty(3, np.int64), np.empty(3, np.int64)
    n = 0
    while place[0] < faces.shape[0]:
        f = place[0]
        _load_corners(corners, faces, f, g)
        columns, rows, unit = _triangle_frame(g, per_edge, order)
        offset = _row_offset(columns, rows)
        while place[1] < rows:
            j = place[1]
            count = _row(g, order, columns, rows, j, start, half)
            if n + count > face.shape[0]:
                return n
            area, t = np.float64((unit * (2 * rows - 2 * j - 1)) // (2 * count)) * 2.0**-32, (2 * j + offset) / (2.0 * rows)
            for i in range(count):
                for axis in range(3):
                    points[n, axis] = (start[axis] + (2 * i + 1) * half[axis]) * 2.0**-32
                along = (2 * i + 1) / (2.0 * count) * (1.0 - t)
                bary[n, order[0]], bary[n, order[1]], bary[n, order[2]] = 1.0 - along - t, along, t
                face[n], share[n] = f, area
                n += 1
            place[1] += 1
        place[0], place[1] = f + 1, 0
    return n


def surface_samples(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                    per_edge: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yields (points float64 [M, 3] grid coordinates, face int64 [M], bary float64 [M, 3], share float64 [M] area in voxel faces)
    until the surface is covered. lattice: int64 [V, 3]; faces: int64 [F, 3] in 0..V-1; per_edge: samples per voxel edge."""
    corners, faces = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution)), np.ascontiguousarray(faces)
    place = np.zeros(2, np.int64)
    room = max(BATCH, (per_edge * resolution + 1) * 2)
    while place[0] < len(faces):
        points, bary = np.empty((room, 3)), np.empty((room, 3))
        face, share = np.empty(room, np.int64), np.empty(room)
        n = _next_samples(corners, faces, per_edge, place, points, face, bary, share)
        yield points[:n], face[:n], bary[:n], share[:n]
