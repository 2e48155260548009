"""The source mesh on its lattice: equal positions are merged, collapsed faces and idle flat faces removed (encoder only)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import sha256
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..core.components import components
from ..core.distinct import distinct
from ..errors import InputError, LimitError
from .areas import edge_columns, squared_cross
from .canonical import CanonicalCube, fit_cube

if TYPE_CHECKING:
    from ..limits import Limits
    from ..scene.scene import Scene

LEAST_HEIGHT = 2.0**-22  # of a face, in sides of the cube: about what rounding to binary32 does to three corners on a line


@dataclass
class Surface:
    """The source's mesh, its vertices rounded to a lattice. cube: CanonicalCube; lattice: int64 [V, 3], distinct; faces: int64
    [F, 3], three distinct corners each; origin_face: int64 [F] into the scene's faces; material: int64 [F]."""

    cube: CanonicalCube
    lattice: np.ndarray
    faces: np.ndarray
    origin_face: np.ndarray
    material: np.ndarray

    @cached_property
    def digest(self) -> bytes:
        """SHA-256 of the arrays, 32 bytes: equal for equal surfaces."""
        total = sha256(bytes([self.cube.position_bits]))
        for values in (self.lattice, self.faces, self.origin_face, self.material):
            total.update(np.ascontiguousarray(values).data)
        return total.digest()


class LatticeSettings(Protocol):
    """The settings that make_surface() reads."""

    @property
    def position_bits(self) -> int | None:
        """Bits of the lattice, 1..20."""

    @property
    def limits(self) -> Limits:
        """Limits of vertices and faces."""

    @property
    def allow_empty(self) -> bool:
        """True if a surface without faces is acceptable."""


def make_surface(scene: Scene, options: LatticeSettings) -> Surface:
    """Build the Surface of a scene: its vertices rounded to the lattice that options choose, equal positions merged, collapsed
    faces and flat faces that close no gap (idle_faces) removed. Raises InputError, LimitError."""
    limits = options.limits
    for code, what, count, limit in (("TXF-L02", "vertices", len(scene.positions), limits.vertices),
                                     ("TXF-L03", "faces", len(scene.faces), limits.faces)):
        if limit is not None and count > limit:
            raise LimitError(code, f"the mesh has more {what} than the limit allows", value=count, allowed=limit)
    assert options.position_bits is not None  # its __post_init__ fills it in
    cube = fit_cube(scene.positions, options.position_bits)
    surface = place_mesh(cube, cube.to_lattice(scene.positions), scene.faces, np.asarray(scene.face_material),
                         partial(thin_faces, scene.positions, scene.faces, cube.side))
    if len(surface.faces) == 0 and not options.allow_empty:
        raise InputError("TXF-I63", "every face is degenerate: no face has three distinct corners", value=len(scene.faces))
    return surface


def place_mesh(cube: CanonicalCube, points: np.ndarray, faces: np.ndarray, material: np.ndarray,
               thin: Callable[[np.ndarray], np.ndarray] | None = None) -> Surface:
    """The Surface of a mesh on its lattice: equal positions are merged, collapsed faces and flat faces that close no gap
    (idle_faces) removed.

    points: int64 [V, 3] in 0..cube.last; faces: int64 [F, 3], which origin_face of the result indexes; material: int64 [F],
    number of each face's material; thin: function of face numbers int64 [N] that returns bool [N], the faces to treat as flat
    besides those that are flat on the lattice.
    """
    packed = points[:, 0] | (points[:, 1] << 20) | (points[:, 2] << 40)
    unique, place, _ = distinct(packed)
    lattice = np.stack([(unique >> shift) & 0xFFFFF for shift in (0, 20, 40)], axis=1)
    faces = place[faces]
    keep = np.flatnonzero((faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0]))
    if len(keep):
        flat = flat_faces(lattice, faces[keep])
        flat = flat if thin is None else flat | thin(keep)
        keep = keep[~idle_faces(faces[keep], flat)]
    return Surface(cube, lattice, faces[keep], keep, material[keep])


def flat_faces(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces whose corners are collinear on the lattice, bool [F]. lattice: int64 [V, 3] below 2**20, so that the test is exact;
    faces: int64 [F, 3]."""
    u, v = edge_columns(lattice, faces)  # products of whole numbers below 2**20 are exact in binary64, too
    flat = np.ones(len(faces), bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        flat &= u[i] * v[j] == u[j] * v[i]
    return flat


def thin_faces(positions: np.ndarray, faces: np.ndarray, side: float, chosen: np.ndarray) -> np.ndarray:
    """Source faces lower than LEAST_HEIGHT times the side of the cube, bool [N]. Such faces have no visible area, but rounding to
    the lattice can give them some. positions: float64 [V, 3]; faces: int64 [F, 3]; side: above 0; chosen: int64 [N], the faces to
    test."""
    u, v = ([column / side for column in edge] for edge in edge_columns(positions, faces[chosen]))
    w = [c - b for b, c in zip(u, v, strict=True)]
    base = np.sqrt(np.max([e[0] * e[0] + e[1] * e[1] + e[2] * e[2] for e in (u, v, w)], axis=0))
    return np.sqrt(squared_cross(u, v)) <= LEAST_HEIGHT * base


def idle_faces(faces: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Return which faces are flat and close no gap, bool [F]: those in edge-connected components of flat faces alone, and,
    repeatedly, those that share at most one edge with others. If all faces are flat, none is idle, because nothing else would be
    visible.

    A flat face between others stays: without it, the corner in the middle of its long edge would leave a crack there. faces:
    int64 [F, 3] over welded vertices; flat: bool [F].
    """
    idle = np.zeros(len(faces), bool)
    if not flat.any() or flat.all():
        return idle
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    edge = distinct(ends[..., 0] * (int(faces.max()) + 1) + ends[..., 1])[1]
    component = _components(edge)
    solid = np.zeros(int(component.max()) + 1, bool)
    solid[component[~flat]] = True
    idle[~solid[component]] = True
    idle[_peeled(edge, flat, idle)] = True
    return idle


def _components(edge):
    """Component of every face, int64 [F]. edge: int64 [F, 3] numbers of a face's edges."""
    count = len(edge)
    rows, columns = np.repeat(np.arange(count), 3), count + edge.reshape(-1)
    return components(count + int(edge.max()) + 1, rows, columns)[:count]


def _peeled(edge, flat, gone):
    """Numbers of the flat faces that peel off one after the other, each while it shares at most one edge: list. For each edge the
    exclusive or of its faces' numbers is kept; once a single face is left, this is its number."""
    rows = np.flatnonzero(~gone)
    users = np.bincount(edge[rows].reshape(-1), minlength=int(edge.max()) + 1)
    numbers = np.zeros(len(users), np.int64)
    np.bitwise_xor.at(numbers, edge[rows].reshape(-1), np.repeat(rows, 3))
    candidates = np.flatnonzero(flat & ~gone & ((users[edge] > 1).sum(axis=1) <= 1)).tolist()
    uses, last, gone, peeled = users.tolist(), numbers.tolist(), gone.tolist(), []
    while candidates:
        face = candidates.pop()
        edges = edge[face].tolist()
        if gone[face] or not flat[face] or sum(uses[e] > 1 for e in edges) > 1:
            continue
        gone[face] = True
        peeled.append(face)
        for e in edges:
            uses[e] -= 1
            last[e] ^= face
            if uses[e] == 1:
                candidates.append(last[e])
    return peeled
