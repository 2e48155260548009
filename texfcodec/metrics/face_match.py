"""Corresponding points on another mesh: the face and the barycentric coordinates there of points of a source's surface.

A face whose corners are unchanged, to the lattice, keeps its points. For all other points the nearest point of the other mesh is
taken, so that meshes with moved vertices or fewer faces can be compared. Sheets that lie close to each other are distinguished by
the direction they face and, in a stream, by their material, which has the source's number.
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
FACING_PENALTY = 4 / 500_000**0.5


class Places(NamedTuple):
    """Points on another mesh that correspond to points of a source.

    Attributes
    ----------
    face : int64 [M]
        Faces of the other mesh.
    bary : float64 [M, 3]
        Barycentric coordinates there.
    points : float64 [M, 3]
        World, where a field is sampled: on the other mesh. If a stream is all over voxels, points of kept faces are those on the
        source instead; they differ by the lattice's rounding alone.
    """

    face: np.ndarray
    bary: np.ndarray
    points: np.ndarray


class FaceMatch:
    """Finds the points on another mesh that correspond to points of a source: on the kept face if there is one, else the nearest.

    Parameters
    ----------
    source : Scene
        The mesh whose points are given.
    other : Scene or Texf
        The mesh on which they are searched.
    threads : int
        Most threads.

    Raises
    ------
    InputError
        TXF-I70 if the other mesh has no face.
    """

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
        """Return the points on the other mesh that correspond to points of the source.

        Parameters
        ----------
        face : int64 [M]
            Faces of the source.
        bary : float64 [M, 3]
            Barycentric coordinates there.

        Returns
        -------
        Places
            M points, in the same order.
        """
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
    """Finds nearest points of a mesh, and prefers the layer that faces the same way if it is about as near.

    Parameters
    ----------
    mesh : Mesh
        With at least one face.
    group : int64 [F], optional
        Group of each face, such as its material: a face of the same group is preferred, too.
    """

    def __init__(self, mesh: Mesh, group: np.ndarray | None = None) -> None:
        self._points = NearestPoints(mesh, group)
        middle, half = mesh.frame()
        area = face_areas((mesh.positions - middle) / half, mesh.faces).sum()
        self._gap = float(FACING_PENALTY * half * np.sqrt(area))

    def find(self, points: np.ndarray, normals: np.ndarray, group: np.ndarray | None = None, threads: int = 1) -> Nearest:
        """Find the point of the mesh nearest to each given point, on the layer that faces the same way if it is about as near.

        Parameters
        ----------
        points : float64 [M, 3]
            World.
        normals : float64 [M, 3]
            Directions that the surface should face, of length 1, or 0 for any.
        group : int64 [M], optional
            Group of each point.
        threads : int
            Most threads.

        Returns
        -------
        Nearest
            Face and barycentric coordinates of each point, in the same order.
        """
        return self._points.find(points, normals, self._gap, group, threads)


def decoded_faces(scene: Scene, texf: Texf) -> tuple[np.ndarray, np.ndarray]:
    """Find the face of a decoded Texf that each face of its source became.

    Parameters
    ----------
    scene : Scene
        The source.
    texf : Texf
        Its decoded stream.

    Returns
    -------
    face : int64 [F]
        Face of texf for each face of the source, -1 if there is none.
    turn : int64 [F]
        Rotation of the corners: corner k of the source is corner (k + turn) % 3 of the decoded face.

    Notes
    -----
    Faces are the same if their corners on the lattice, their orientation and their material are; of several the last is taken.
    """
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
    """Keys int64 [F, 4] of faces, and the number of each face's smallest corner, int64 [F].

    A key is three packed corners, the smallest first with the orientation kept, and the material. lattice: int64 [V, 3]; faces:
    int64 [F, 3]; material: int64 [F].
    """
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
    """Hashes uint64 [F] of rows int64 [F, 4]. Sorting the rows themselves would take decoded_faces() four times as long."""
    total = np.zeros(len(keys), np.uint64)
    for column in keys.T.astype(np.uint64):
        total = (total ^ column) * np.uint64(0xFF51AFD7ED558CCD)  # of Murmur3's finaliser; products wrap
        total ^= total >> np.uint64(32)
    return total
