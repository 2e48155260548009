"""The point of a mesh that is nearest to a given one."""

import numpy as np

from ..geometry.areas import sample_surface

LANDMARKS, NEIGHBOURS = 500_000, 8
BLOCK = 1 << 15  # points asked at a time, each with its NEIGHBOURS triangles


class NearestFaces:
    """Finds the points of a mesh nearest to given ones. Of surfaces that lie on each other, the one that faces the given way
    answers: without that, the lining of a garment would answer for its outside.

    positions: float64 [V, 3]; faces: int64 [F, 3], one of which has area; threads.
    """

    def __init__(self, positions: np.ndarray, faces: np.ndarray, threads: int = 1) -> None:
        from scipy.spatial import cKDTree  # here, as is trimesh below, because it takes long to import

        self._threads = threads
        self._origin = positions.min(axis=0)
        self._side = float((positions - self._origin).max())
        self._corners = ((positions - self._origin) / self._side)[faces]
        self._normals = face_normals(self._corners)
        face, bary = sample_surface(positions, faces, LANDMARKS)
        places = np.einsum("mk,mkc->mc", bary, self._corners[face])
        self._face = np.concatenate([face, np.arange(len(faces))])  # a centroid each: no face is too small to be found
        places = np.concatenate([places, self._corners.mean(axis=1)])
        edges = self._corners[:, 1:] - self._corners[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
        self._turn = 4 * np.sqrt(area / LANDMARKS)  # a normal that is off by 1 counts as four landmarks' spacing
        self._tree = cKDTree(np.hstack([places, self._turn * self._normals[self._face]]))

    def find(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(face int64 [M], bary float64 [M, 3]) of the points nearest to world points, float64 [M, 3], on surfaces that face
        along normals, float64 [M, 3] of length 1 (or 0: any).

        The nearest point is exact on its triangle, and the triangle is the nearest of those around the NEIGHBOURS nearest of
        LANDMARKS points spread over the mesh.
        """
        face, bary = np.empty(len(points), np.int64), np.empty((len(points), 3))
        for begin in range(0, len(points), BLOCK):
            part = slice(begin, begin + BLOCK)
            face[part], bary[part] = self._nearest((points[part] - self._origin) / self._side, normals[part])
        return face, bary

    def _nearest(self, points, normals):
        """(face int64 [M], bary float64 [M, 3]) of points in units of the mesh's side."""
        from trimesh.triangles import closest_point, points_to_barycentric

        keys = np.hstack([points, self._turn * normals])
        faces = self._face[self._tree.query(keys, NEIGHBOURS, workers=self._threads)[1]]
        every = np.repeat(points, NEIGHBOURS, axis=0)
        with np.errstate(all="ignore"):  # triangles without area
            near = closest_point(self._corners[faces.ravel()], every)
            distance = np.linalg.norm(near - every, axis=1).reshape(faces.shape)
        against = np.einsum("mkc,mc->mk", self._normals[faces], normals) < 0
        best = np.argmin(np.where(np.isfinite(distance), distance, np.inf) + self._turn * against, axis=1)
        row = np.arange(len(points))
        face = faces[row, best]
        with np.errstate(all="ignore"):
            return face, _inside(points_to_barycentric(self._corners[face], near.reshape(*faces.shape, 3)[row, best]))


def face_normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals float64 [M, 3] of triangles [M, 3, 3]; zero where a triangle has no area."""
    edges = corners[:, 1:] - corners[:, :1]
    edges = edges / np.maximum(np.abs(edges).max(axis=(1, 2), initial=0.0, keepdims=True), 1e-300)
    normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def _inside(bary):
    """Barycentric coordinates that are of this triangle; a triangle without area answers with its first corner."""
    bary = np.clip(np.where(np.isfinite(bary), bary, 0.0), 0.0, 1.0)
    total = bary.sum(axis=1, keepdims=True)
    return np.where(total > 0, bary / np.where(total > 0, total, 1.0), (1.0, 0.0, 0.0))
