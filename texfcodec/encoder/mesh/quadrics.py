"""Quadric errors: sums of squared distances to planes, as ten numbers (encoder only; Garland and Heckbert 1997)."""

from __future__ import annotations

import numpy as np

from ...core.kernel import kernel

LINE_WEIGHT = 10.0  # of the planes that stand on line edges, beside the faces' own
POINT_WEIGHT = 1e-5  # of the distance to the vertex itself: flat parts keep round triangles, and no place is undetermined


def vertex_quadrics(positions: np.ndarray, faces: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """Return the quadric of each vertex, the sum over its faces of squared distances to their planes: float64 [V, 10],
    coefficients of xx, xy, xz, yy, yz, zz, x, y, z, 1. positions: float64 [V, 3] in -1..1; faces: int64 [F, 3]; marked: bool [F,
    3], sides (corner i to the next) that are lines."""
    out = np.zeros((len(positions), 10))
    _fill(positions, faces, marked, out)
    return out


@kernel
def _add_plane(q, n0, n1, n2, p, weight):
    """Add the plane through p with the normal (n0, n1, n2) of length 1."""
    d = -(n0 * p[0] + n1 * p[1] + n2 * p[2])
    q[0] += weight * n0 * n0
    q[1] += weight * n0 * n1
    q[2] += weight * n0 * n2
    q[3] += weight * n1 * n1
    q[4] += weight * n1 * n2
    q[5] += weight * n2 * n2
    q[6] += weight * n0 * d
    q[7] += weight * n1 * d
    q[8] += weight * n2 * d
    q[9] += weight * d * d


@kernel
def _add_point(q, p, weight):
    q[0] += weight
    q[3] += weight
    q[5] += weight
    for k in range(3):
        q[6 + k] -= weight * p[k]
        q[9] += weight * p[k] * p[k]


@kernel
def _fill(positions, faces, marked, out):
    for f in range(faces.shape[0]):
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0.0:
            continue
        nx, ny, nz, area = nx / length, ny / length, nz / length, length / 2.0
        for i in range(3):
            q, p = out[faces[f, i]], positions[faces[f, i]]
            _add_plane(q, nx, ny, nz, p, area)
            _add_point(q, p, POINT_WEIGHT * area)
        for i in range(3):
            if not marked[f, i]:
                continue
            j = (i + 1) % 3
            p, r = positions[faces[f, i]], positions[faces[f, j]]
            ex, ey, ez = r[0] - p[0], r[1] - p[1], r[2] - p[2]
            mx, my, mz = ey * nz - ez * ny, ez * nx - ex * nz, ex * ny - ey * nx
            side = np.sqrt(mx * mx + my * my + mz * mz)
            if side > 0.0:
                weight = LINE_WEIGHT * side * side
                _add_plane(out[faces[f, i]], mx / side, my / side, mz / side, p, weight)
                _add_plane(out[faces[f, j]], mx / side, my / side, mz / side, p, weight)


@kernel
def _error_at(q, x, y, z):
    return max(0.0, x * (q[0] * x + 2.0 * (q[1] * y + q[2] * z + q[6])) + y * (q[3] * y + 2.0 * (q[4] * z + q[7]))
               + z * (q[5] * z + 2.0 * q[8]) + q[9])


@kernel
def _least_place(q, p, r, place):
    """Fill place with the minimum of the quadric and return its error. The minimum solves its three equations; if these are close
    to singular, or the solution is farther from the edge's middle than the edge is long, it is the best of both ends and the
    middle."""
    c00, c01, c02 = q[3] * q[5] - q[4] * q[4], q[2] * q[4] - q[1] * q[5], q[1] * q[4] - q[2] * q[3]
    whole = q[0] * c00 + q[1] * c01 + q[2] * c02
    trace = q[0] + q[3] + q[5]
    long = 0.0
    for k in range(3):
        long += (p[k] - r[k]) ** 2
    if whole > 1e-12 * trace * trace * trace:
        c11, c12, c22 = q[0] * q[5] - q[2] * q[2], q[1] * q[2] - q[0] * q[4], q[0] * q[3] - q[1] * q[1]
        place[0] = -(c00 * q[6] + c01 * q[7] + c02 * q[8]) / whole
        place[1] = -(c01 * q[6] + c11 * q[7] + c12 * q[8]) / whole
        place[2] = -(c02 * q[6] + c12 * q[7] + c22 * q[8]) / whole
        off = 0.0
        for k in range(3):
            off += (place[k] - (p[k] + r[k]) / 2.0) ** 2
        if off <= long:
            return _error_at(q, place[0], place[1], place[2])
    best = np.inf
    for way in range(3):
        s = 0.5 * ((way + 1) % 3)  # the middle first, so that it answers where all are equal
        x, y, z = p[0] + s * (r[0] - p[0]), p[1] + s * (r[1] - p[1]), p[2] + s * (r[2] - p[2])
        error = _error_at(q, x, y, z)
        if error < best:
            best = error
            place[0], place[1], place[2] = x, y, z
    return best
