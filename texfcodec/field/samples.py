"""The samples of the voxelisation (spec 6.3) as arrays, in batches, spread evenly by area over the surface."""

from collections.abc import Iterator

import numpy as np

from ..core.kernel import kernel
from .surface_walk import FACE, ROW, _next_row, _row_height, _sample_area, grid_coordinates, surface_walk

BATCH = 1 << 18  # samples a batch; a row has at most 2**16


@kernel
def _next_samples(corners, faces, per_edge, walk, points, face, bary, share):
    """Fills the arrays with the walk's next whole rows of samples. Returns their number, 0 at the end of the surface.

    points: float64 [M, 3] grid coordinates; bary: float64 [M, 3]; share: float64 [M] area in voxel faces. The faces have been
    checked against the corners.
    """
    order, start, half, state, n = walk.order, walk.start, walk.half_step, walk.state, 0
    while True:
        count = _next_row(corners, faces, per_edge, walk)
        if count == 0:
            break
        if n + count > face.shape[0]:
            state[ROW] -= 1  # for the next call
            break
        area, t = np.float64(_sample_area(state)) * 2.0**-32, _row_height(state)
        for i in range(count):
            for axis in range(3):
                points[n, axis] = (start[axis] + (2 * i + 1) * half[axis]) * 2.0**-32
            along = (2 * i + 1) / (2.0 * count) * (1.0 - t)
            bary[n, order[0]], bary[n, order[1]], bary[n, order[2]] = 1.0 - along - t, along, t
            face[n], share[n] = state[FACE], area
            n += 1
    return n


def surface_samples(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                    per_edge: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the samples of a surface in batches: (points float64 [M, 3] in grid coordinates, face int64 [M], bary float64 [M,
    3], share float64 [M]: the area that a sample stands for, in voxel faces). lattice: int64 [V, 3] below 2**position_bits;
    faces: int64 [F, 3] in 0..V-1; resolution: voxels a side; per_edge: samples per voxel edge."""
    corners, faces = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution)), np.ascontiguousarray(faces)
    walk = surface_walk()
    room = max(BATCH, (per_edge * resolution + 1) * 2)
    while True:
        points, bary = np.empty((room, 3)), np.empty((room, 3))
        face, share = np.empty(room, np.int64), np.empty(room)
        n = _next_samples(corners, faces, per_edge, walk, points, face, bary, share)
        if n == 0:
            return
        yield points[:n], face[:n], bary[:n], share[:n]
