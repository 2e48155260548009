"""Fit of a mesh's vertices to a source surface by least squares (encoder only).

Points spread over both surfaces, each with the nearest point of the other: the distance along the source's normal counts in full,
the rest of it by TANGENTIAL, and differences of the displacements of neighbours by STIFFNESS. Points on lines (borders, and what
the caller names) count by their distance to the line. The nearest points change as the vertices move, so it is done again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry.areas import face_areas, sample_surface
from .distances import points_at
from .mesh import Mesh
from .nearest_points import NearestPoints
from .normal_matrix import NormalEquations, NormalMatrix

SAMPLES, ROUNDS = 100_000, 3
TANGENTIAL = 0.01
STIFFNESS = 0.01
DAMPING = 1e-4
LINE_WEIGHT = 1.0
LINE_POINTS = 4  # on each edge of a line


@dataclass(frozen=True)
class VertexFit:
    """positions: float64 [V, 3]; matrix: of the squared error around them, over the area: (x - positions)' A (x - positions) is by
    how much the error of x is larger."""

    positions: np.ndarray
    matrix: NormalMatrix


def fit_vertices(source: Mesh, mesh: Mesh, source_lines: np.ndarray | None = None, lines: np.ndarray | None = None,
                 samples: int = SAMPLES, rounds: int = ROUNDS) -> VertexFit:
    """Positions of a mesh's vertices that bring it closest to the source; both have area.

    source_lines, lines: int64 [L, 2], edges of the source and of the mesh that belong together; samples: on each surface.
    """
    source, mesh = source.checked(), mesh.checked()
    middle, half = source.frame()
    source, mesh = (Mesh((m.positions - middle) / half, m.faces) for m in (source, mesh))
    face, bary = sample_surface(source.positions, source.faces, samples)
    target = NearestPoints(source)
    start = points_at(source, face, bary), target.normals[face]
    area = float(face_areas(source.positions, source.faces).sum())
    turn = np.sqrt(area / len(mesh.faces))
    share = area / samples
    for number in range(rounds):
        equations = NormalEquations(mesh.faces, len(mesh.positions))
        _add_surface(equations, mesh, target, source, start, share, turn, number, samples)
        if lines is not None and source_lines is not None and len(lines) and len(source_lines):
            _add_lines(equations, mesh, lines, source, source_lines, turn)
        moved, matrix = equations.solve(STIFFNESS, DAMPING)
        mesh = Mesh(mesh.positions + moved, mesh.faces)
    return VertexFit(mesh.positions * half + middle, matrix)


def own_fit(mesh: Mesh) -> VertexFit:
    """The fit of a mesh to itself: its own positions, and the matrix in closed form. The middles of the sides are the points: a
    rule that is exact for squares."""
    mesh = mesh.checked()
    middle, half = mesh.frame()
    positions = (mesh.positions - middle) / half
    equations = NormalEquations(mesh.faces, len(positions))
    cross = np.cross(*(positions[mesh.faces[:, k]] - positions[mesh.faces[:, 0]] for k in (1, 2)))
    length = np.linalg.norm(cross, axis=1)
    normals, face = cross / np.where(length > 0, length, 1.0)[:, None], np.arange(len(mesh.faces))
    for side in ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5)):
        equations.add(face, np.tile(side, (len(face), 1)), np.zeros((len(face), 3)), normals, length / 6, 1 - TANGENTIAL, TANGENTIAL)
    return VertexFit(mesh.positions, equations.solve(STIFFNESS, DAMPING)[1])


def _add_surface(equations, mesh, target, source, start, share, turn, seed, samples):
    """Adds the points of both surfaces. start: (points, normals) of the source's."""
    points, normals = start
    moving = NearestPoints(mesh)
    there = moving.find(points, normals, turn)
    agree = (moving.normals[there.face] * normals).sum(axis=1) > 0
    equations.add(there.face, there.bary, points - points_at(mesh, there.face, there.bary), normals, share * agree, 1 - TANGENTIAL,
                  TANGENTIAL)
    face, bary = sample_surface(mesh.positions, mesh.faces, samples, seed + 1)
    own = points_at(mesh, face, bary)
    there = target.find(own, moving.normals[face], turn)
    normals = target.normals[there.face]
    agree = (moving.normals[face] * normals).sum(axis=1) > 0
    equations.add(face, bary, points_at(source, there.face, there.bary) - own, normals, share * agree, 1 - TANGENTIAL, TANGENTIAL)


def _add_lines(equations, mesh, lines, source, source_lines, turn):
    """Adds points of the mesh's lines and of the source's: a line is a face of two equal corners to NearestPoints."""
    pass
