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
from .topology import line_sides

SAMPLES, ROUNDS = 100_000, 3
TANGENTIAL = 0.003
STIFFNESS = 0.003
DAMPING = 1e-4
LINE_WEIGHT = 1.0
LINE_POINTS = 4  # on each edge of a line


@dataclass(frozen=True)
class VertexFit:
    """mesh: the fitted one; matrix: how the squared error, over the area, grows around its positions x*: by (x - x*)' A (x - x*) in
    units of half the source's longest side."""

    mesh: Mesh
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
    return VertexFit(Mesh(mesh.positions * half + middle, mesh.faces), matrix)


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
    return VertexFit(mesh, equations.solve(STIFFNESS, DAMPING)[1])


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


def _add_lines(equations, mesh, lines, source, source_lines, spacing):
    """Adds points of the mesh's lines and of the source's, each with the nearest of the other that runs the same way: a line is a
    face with two equal corners to NearestPoints."""
    face, corners = line_sides(mesh.faces, lines)
    if not len(face):
        return
    own, target = _as_faces(mesh.positions, np.take_along_axis(mesh.faces[face], corners, axis=1)), _as_faces(source.positions, source_lines)
    for start, end in ((own, target), (target, own)):
        line, share, points = _line_points(start)
        there = NearestPoints(end).find(points)
        moving, at, shares = (line, there.face, share) if start is own else (there.face, line, 1 - there.bary[:, 0])
        bary = np.zeros((len(line), 3))
        np.put_along_axis(bary, corners[moving], np.stack([1 - shares, shares], axis=1), axis=1)
        residual = (points_at(end, there.face, there.bary) - points) * (1 if start is own else -1)
        directions = _directions(target)[at]
        along = np.abs((_directions(own)[moving] * directions).sum(axis=1)) > 0.5
        length = np.linalg.norm(np.diff(start.positions[start.faces[line, :2]], axis=1)[:, 0], axis=1)
        weight = LINE_WEIGHT * spacing * length / LINE_POINTS * along
        equations.add(face[moving], bary, residual, directions, weight, -1.0, 1.0)


def _as_faces(positions, lines):
    return Mesh(positions, lines[:, [0, 1, 1]])


def _line_points(lines):
    """LINE_POINTS on every line: (line int64 [M], its share of the way float64 [M], points float64 [M, 3])."""
    line = np.repeat(np.arange(len(lines.faces)), LINE_POINTS)
    share = np.tile((np.arange(LINE_POINTS) + 0.5) / LINE_POINTS, len(lines.faces))
    return line, share, points_at(lines, line, np.stack([1 - share, share, np.zeros(len(line))], axis=1))


def _directions(lines):
    """Unit vectors along the lines, float64 [L, 3]."""
    way = np.diff(lines.positions[lines.faces[:, :2]], axis=1)[:, 0]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return way / np.where(length > 0, length, 1.0)
