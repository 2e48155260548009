"""Position of a surface point on its face, and the UV there (spec clause 8.2)."""

import numpy as np

from ..core.kernel import kernel


@kernel
def _along(px, py, pz, ax, ay, az, bx, by, bz):
    """(share 0..1 of the way from a to b of the point nearest to p, its squared distance)."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    length, t = dx * dx + dy * dy + dz * dz, 0.0
    if length > 0.0:
        t = min(max(((px - ax) * dx + (py - ay) * dy + (pz - az) * dz) / length, 0.0), 1.0)
    ex, ey, ez = ax + t * dx - px, ay + t * dy - py, az + t * dz - pz
    return t, ex * ex + ey * ey + ez * ez


@kernel
def corner_weights(px, py, pz, corner, out):
    """Write to out, float64 [3], the barycentric weights of the point of a triangle nearest to p. corner: float64 [3, 3], one
    corner a row. In decoding, corners are integers below 2**20: the cross product n of two edges is then exact, and rounding
    does not hide the area of a sliver."""
    ux, uy, uz = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
    vx, vy, vz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
    dx, dy, dz = px - corner[0, 0], py - corner[0, 1], pz - corner[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    if area > 0.0:
        out[1] = ((dy * vz - dz * vy) * nx + (dz * vx - dx * vz) * ny + (dx * vy - dy * vx) * nz) / area
        out[2] = ((uy * dz - uz * dy) * nx + (uz * dx - ux * dz) * ny + (ux * dy - uy * dx) * nz) / area
        out[0] = 1.0 - out[1] - out[2]
        if out[0] >= 0.0 and out[1] >= 0.0 and out[2] >= 0.0:
            return
    nearest = np.inf
    for a in range(3):
        b = (a + 1) % 3
        t, distance = _along(px, py, pz, corner[a, 0], corner[a, 1], corner[a, 2], corner[b, 0], corner[b, 1], corner[b, 2])
        if distance < nearest:
            nearest = distance
            out[:] = 0.0
            out[a], out[b] = 1.0 - t, t


@kernel(allocates=True)
def _texel_positions(points, positions, faces, uv, face_index, out):
    """Writes the UVs of the points to out float64 [M, 2]. Bounds: the caller has checked face_index, and faces against
    positions."""
    corner, weight = np.empty((3, 3)), np.zeros(3)
    for i in range(points.shape[0]):
        f = face_index[i]
        for a in range(3):
            for k in range(3):
                corner[a, k] = positions[faces[f, a], k]
        weight[:] = 0.0
        corner_weights(points[i, 0], points[i, 1], points[i, 2], corner, weight)
        for k in range(2):
            out[i, k] = weight[0] * uv[faces[f, 0], k] + weight[1] * uv[faces[f, 1], k] + weight[2] * uv[faces[f, 2], k]


def texel_positions(points: np.ndarray, positions: np.ndarray, faces: np.ndarray, uv: np.ndarray,
                    face_index: np.ndarray) -> np.ndarray:
    """Return the UVs, float64 [M, 2], at the point of a given face nearest to each of the points.

    points: float64 [M, 3]; positions: float64 [V, 3], integers below 2**20; faces: int64 [F, 3] into them; uv: float64 [V, 2];
    face_index: int64 [M], the face of each point, checked by the caller.
    """
    out = np.empty((len(points), 2))
    _texel_positions(np.ascontiguousarray(points), positions, faces, uv, np.ascontiguousarray(face_index), out)
    return out
