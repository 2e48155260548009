"""The source's surface drawn onto another mesh: every vertex moves to the nearest point there, so that each face, with its UVs
and colours, lies on the sent surface.

Everything that samples the appearance of the source walks over its own faces and need not know that they have moved. Between two
vertices a face cuts the corner of a fold of the other mesh, by less than a voxel if faces are a few voxels wide. Encoder only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.distinct import distinct
from ...geometry.mesh import Mesh, face_normals, points_at
from ...geometry.nearest_points import NearestPoints
from ...render.tangent_frames import interpolate_corners
from .vertex_fit import area_normals

INSET = 0.3  # of the way to the middle of a face, at most
SAME_SIDE = 0.866  # cosine of what a smooth surface turns within that
TURN = 0.05  # of the longest side: how much farther away a point counts that looks the other way


@dataclass(frozen=True, kw_only=True)
class DrawnSource:
    """The source's faces after a move of their corners onto another mesh. mesh: the moved faces, in the source's order; place:
    int64 [V], face of the other mesh that each of its vertices is on; bary: float64 [V, 3], position of the vertex on that
    face."""

    mesh: Mesh
    place: np.ndarray
    bary: np.ndarray

    def from_corners(self, corner: np.ndarray) -> np.ndarray:
        """Return values at the corners of the moved faces, float32 [F, 3, C], from values at the corners of the other mesh,
        float32 [G, 3, C]."""
        return interpolate_corners(corner, self.place, self.bary)[self.mesh.faces]


def draw_onto(source: Mesh, group: np.ndarray, other: Mesh, other_group: np.ndarray, threads: int = 1) -> DrawnSource:
    """Return the source drawn onto another mesh: each vertex moves to the nearest point there. group, other_group: int64, a
    number for each face of the two; a source face goes to faces of its own group if any are about as near, so that one part of
    an asset is not drawn onto another."""
    count = int(group.max(initial=0)) + 1
    pair, faces, _ = distinct(source.faces * count + group[:, None])
    points = source.positions[pair // count]
    turn = TURN * 2 * source.frame()[1]
    nearest = NearestPoints(other, other_group).find(points, vertex_normals(points, faces), turn, pair % count, threads)
    mesh = Mesh(points_at(other, nearest.face, nearest.bary), faces)
    return DrawnSource(mesh=mesh, place=nearest.face, bary=nearest.bary)


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the sum of the area-weighted normals of the faces at each vertex, float64 [V, 3], not of length 1."""
    cross, out = area_normals(Mesh(positions, faces)), np.zeros_like(positions)
    for corner in range(3):
        for axis in range(3):
            out[:, axis] += np.bincount(faces[:, corner], cross[:, axis], len(positions))
    return out


class FetchedNormals:
    """A source's normals at the corners of another mesh.

    Each corner takes the normal of the nearest point that faces the same way. At an edge of the surface it takes that of the side
    which the face is on: of a point a little inside the face. nearest: returns the NearestPoints of the source, when a normal is
    due.
    """

    def __init__(self, source: Mesh, nearest: Callable[[], NearestPoints], other: Mesh, threads: int = 1) -> None:
        self._source, self._nearest, self._other, self._threads = source, nearest, other, threads

    def of(self, corner_normal: np.ndarray) -> np.ndarray:
        """Return the other mesh's corner normals, float32 [G, 3, 3], of length 1, from the source's corner normals, float32 [F,
        3, 3]."""
        values = [interpolate_corners(corner_normal, there.face, there.bary) for there in self._places]
        values = [normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12) for normal in values]
        same = (values[0] * values[1]).sum(axis=1) > SAME_SIDE
        return np.where(same[:, None], *values).astype(np.float32).reshape(-1, 3, 3)

    @cached_property
    def _places(self):
        """Return the places of the corners, and of points a little inside their faces."""
        corners, source = self._other.positions[self._other.faces], self._source
        side, turn = np.repeat(face_normals(corners), 3, axis=0), TURN * 2 * source.frame()[1]
        edge = np.sqrt(np.square(source.positions[source.faces[:, 0]] - source.positions[source.faces[:, 1]]).sum(axis=1).mean())
        inwards = corners.mean(axis=1, keepdims=True) - corners
        length = np.linalg.norm(inwards, axis=2, keepdims=True)
        inner = corners + inwards * np.minimum(INSET, edge / np.where(length > 0, length, 1.0) / 2)
        nearest = self._nearest()
        return [nearest.find(points.reshape(-1, 3), side, turn, threads=self._threads) for points in (corners, inner)]
