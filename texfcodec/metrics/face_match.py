"""Where on another mesh the points of a source's surface are: the face and the corner weights there.

A face that kept its corners, to the lattice, keeps its points. All other points ask the nearest point of the other mesh, so that
meshes with moved vertices or fewer faces can be compared. Sheets that lie close to each other are told apart by the way they face
and, in a stream, by their material, which has the source's number.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..core.kernel import kernel
from ..errors import InputError
from ..geometry.areas import face_areas
from ..geometry.mesh import Mesh, face_normals, points_at
from ..geometry.nearest_points import Nearest, NearestPoints
from ..texf import Texf

if TYPE_CHECKING:
    from ..scene.scene import Scene

# Of the square root of a mesh's area: by so much farther counts a face that looks the other way or has another material. A
# person has 1.3 sides of that, so it is 0.7 % of the side, some voxels: more than surfaces are moved, and less than the thickness
# of most parts.
SHEETS = 4 / 500_000**0.5


class Places(NamedTuple):
    """face: int64 [M]; bary: float64 [M, 3]; points: float64 [M, 3], world, where a field is asked: on the other mesh.

    Kept faces of a stream that is all over voxels ask on the source instead, from which only the lattice's rounding parts them.
    """

    face: np.ndarray
    bary: np.ndarray
    points: np.ndarray


class FaceMatch:
    """Finds points of a source on another mesh. source: Scene; other: Scene or Texf; threads. Raises InputError TXF-I70 where the
    other has no face."""

    def __init__(self, source: Scene, other: Scene | Texf, threads: int = 1) -> None:
        self.source, self.threads = Mesh(source.positions, source.faces), threads
        self.mesh = Mesh(other.positions, other.faces)
        if not len(other.faces):
            raise InputError("TXF-I70", "an empty asset has no face to query")
        self._materials: tuple[np.ndarray, np.ndarray] | None = None
        if isinstance(other, Texf):
            self._face, self._turn = decoded_faces(source, other)
            self._materials = source.face_material, other.face_material
            self._at_source = not any(part.over_texels for part in other.fields)
        else:
            same = np.array_equal(source.positions, other.positions) and np.array_equal(source.faces, other.faces)
            self._face = np.arange(len(source.faces)) if same else np.full(len(source.faces), -1)
            self._turn, self._at_source = np.zeros(len(source.faces), np.int64), False

    def find(self, face: np.ndarray, bary: np.ndarray) -> Places:
        """Where points of the source are. face: int64 [M]; bary: float64 [M, 3]."""
        there, weights, points = self._face[face], np.empty_like(bary), np.empty_like(bary)
        kept, lost = np.flatnonzero(there >= 0), np.flatnonzero(there < 0)
        order = (np.arange(3) - self._turn[face[kept]][:, None]) % 3
        weights[kept] = np.take_along_axis(bary[kept], order, axis=1)
        if len(lost):
            there[lost], weights[lost] = self._nearest(face[lost], bary[lost])
        if self._at_source:
            points[kept] = points_at(self.source, face[kept], bary[kept])
            points[lost] = points_at(self.mesh, there[lost], weights[lost])
        else:
            points = points_at(self.mesh, there, weights)
        return Places(there, weights, points)

    def _nearest(self, face, bary):
        group = None if self._materials is None else self._materials[0][face]
        nearest = self._sheets.find(points_at(self.source, face, bary), self._normals[face], group, self.threads)
        return nearest.face, nearest.bary

    @cached_property
    def _normals(self):
        return face_normals(self.source.positions[self.source.faces])

    @cached_property
    def _sheets(self):
        return Sheets(self.mesh, None if self._materials is None else self._materials[1])


class Sheets:
    """Points of a mesh nearest to given ones, on the sheet that faces the same way where there is one about as near.

    mesh: Mesh with a face; group: int64 [F] of its faces, such as their materials: a face of the same group is preferred, too.
    """

    def __init__(self, mesh: Mesh, group: np.ndarray | None = None) -> None:
        self._points = NearestPoints(mesh, group)
        middle, half = mesh.frame()
        area = face_areas((mesh.positions - middle) / half, mesh.faces).sum()
        self._gap = float(SHEETS * half * np.sqrt(area))

    def find(self, points: np.ndarray, normals: np.ndarray, group: np.ndarray | None = None, threads: int = 1) -> Nearest:
        """The points nearest to points, float64 [M, 3], of surfaces that face along normals, float64 [M, 3] of length 1 (or 0:
        any). group: int64 [M]."""
        return self._points.find(points, normals, self._gap, group, threads)


def decoded_faces(scene: Scene, texf: Texf) -> tuple[np.ndarray, np.ndarray]:
    """(face of texf that each face of the source became int64 [F], -1 where there is none; by how many corners it is turned int64
    [F]: corner k of the source is corner (k + turn) % 3 there). Faces are the same by their corners on the lattice, their
    orientation and their material; of several the last one answers."""
    here, first = _face_keys(texf.cube.to_lattice(scene.positions), scene.faces, scene.face_material)
    there, start = _face_keys(texf.lattice_positions, texf.faces, texf.face_material)
    match, turn = np.full(len(here), -1, np.int64), np.zeros(len(here), np.int64)
    if len(there):
        hashes = _hashes(there)
        order = np.argsort(hashes, kind="stable")
        place = np.searchsorted(hashes[order], _hashes(here), side="right") - 1
        face = order[np.maximum(place, 0)]
        same = (there[face] == here).all(axis=1)
        match[same], turn[same] = face[same], (start[face[same]] - first[same]) % 3
    return match, turn


def _face_keys(lattice, faces, material):
    """int64 [F, 4]: three packed corners, the smallest first and orientation kept, and the material; which corner was the
    smallest, int64 [F]. lattice: int64 [V, 3]; faces: int64 [F, 3]; material: int64 [F]."""
    packed = lattice[:, 0] | lattice[:, 1] << 20 | lattice[:, 2] << 40
    keys, first = np.empty((len(faces), 4), np.int64), np.empty(len(faces), np.int64)
    keys[:, 3] = material
    _turn_corners(packed, np.ascontiguousarray(faces, np.int64), keys, first)
    return keys, first


@kernel
def _turn_corners(packed, faces, keys, first):
    """Fills the first three columns of keys, and first."""
    for f in range(faces.shape[0]):
        least = 0
        for k in range(1, 3):
            if packed[faces[f, k]] < packed[faces[f, least]]:
                least = k
        first[f] = least
        for k in range(3):
            keys[f, k] = packed[faces[f, (least + k) % 3]]


def _hashes(keys):
    """uint64 [F] of rows int64 [F, 4], because sorting rows as such makes all of it take four times as long."""
    total = np.zeros(len(keys), np.uint64)
    for column in keys.T.astype(np.uint64):
        total = (total ^ column) * np.uint64(0xFF51AFD7ED558CCD)  # of Murmur3's finaliser; products wrap
        total ^= total >> np.uint64(32)
    return total
