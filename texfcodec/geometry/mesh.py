"""A triangle mesh without appearance, points on it and normals of its faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

BLOCK = 1 << 16  # points whose corners are held at a time


class Mesh(NamedTuple):
    """positions: float64 [V, 3]; faces: int64 [F, 3] into positions."""

    positions: np.ndarray
    faces: np.ndarray

    def checked(self) -> Mesh:
        """The mesh with contiguous float64 and int64 arrays. Raises ValueError for invalid shapes, indices and positions."""
        positions = np.ascontiguousarray(self.positions, np.float64).reshape(-1, 3)
        faces = np.ascontiguousarray(self.faces, np.int64).reshape(-1, 3)
        if not np.isfinite(positions).all():
            raise ValueError("positions must be finite")
        if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
            raise ValueError(f"faces must hold integers from 0 to {len(positions) - 1}")
        return Mesh(positions, faces)

    def frame(self) -> tuple[np.ndarray, float]:
        """(middle of the bounding box, float64 [3]; half its longest side, 1 for a box without extent). (positions - middle) /
        half is in -1..1."""
        if not len(self.positions):
            return np.zeros(3), 1.0
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        half = float(np.max(high / 2 - low / 2))
        return low / 2 + high / 2, half if half > 0 else 1.0


def points_at(mesh: Mesh, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
    """Return the points at places on a mesh, float64 [M, 3]. face: int64 [M]; bary: float64 [M, 3], barycentric coordinates."""
    out = np.empty((len(face), 3))
    for begin in range(0, len(face), BLOCK):
        some = slice(begin, begin + BLOCK)
        out[some] = np.einsum("mk,mkc->mc", bary[some], mesh.positions[mesh.faces[face[some]]])
    return out


def face_normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals float64 [M, 3] of triangles [M, 3, 3]; zero for a triangle without area."""
    edges = [corners[:, corner, axis] - corners[:, 0, axis] for corner in (1, 2) for axis in range(3)]  # columns: twice as fast
    longest = np.full(len(corners), 1e-300, corners.dtype)
    for column in edges:
        np.maximum(longest, np.abs(column), out=longest)
    ux, uy, uz, vx, vy, vz = (column / longest for column in edges)
    normals = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx]
    length = np.sqrt(normals[0] * normals[0] + normals[1] * normals[1] + normals[2] * normals[2])
    return np.stack(normals, axis=1) / np.where(length > 0, length, 1.0)[:, None]
