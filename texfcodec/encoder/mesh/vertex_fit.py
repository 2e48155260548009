"""Fit of a mesh's vertices to a source surface by least squares (encoder only).

Points are spread over both surfaces, each with the nearest point of the other. The distance along the source's normal counts in
full, the rest of it by TANGENTIAL, and differences of the displacements of neighbours by STIFFNESS. Points on lines (borders and
lines of the caller) count by their distance to the line. The nearest points change as the vertices move, so the fit is repeated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...geometry.areas import face_areas, sample_surface
from ...geometry.mesh import Mesh, points_at
from ...geometry.nearest_points import NearestPoints
from .normal_matrix import NormalEquations, NormalMatrix, PointResiduals
from .topology import line_sides

# D1 in dB of bball_0001 and ycb_scissors at 40 % of their faces, before 81.1 and 79.3: 1, 2, 3, 5 rounds 82.1, 82.2, 82.4, 82.5
# and 80.4, 80.6, 80.7, 80.8. STIFFNESS of 0.1, 0.01, 0.001: 82.0, 82.4, 82.5 and 80.3, 80.7, 80.9; TANGENTIAL of 0.1, 0.01,
# 0.001: 82.1, 82.4, 82.4 and 80.4, 80.7, 80.8. Less of both turns more faces on a coarse lattice.
SAMPLES, ROUNDS = 100_000, 3
LEAST_SAMPLES = 4  # for each face of the mesh: an indoor scan of 92,000 faces gets worse with one
TANGENTIAL, STIFFNESS, DAMPING = 0.003, 0.003, 1e-4
# Of the distance to where each round starts: parts that few points see stay. Without it a room and a can that are fine already
# lose 0.3 and 0.7 dB, with it they gain 0.2 and lose 0.1; scans that need the fit lose at most 0.07.
HOLD = 0.3
# Border of a terrain, distance rms in 1e-4 of its side: 7.9 without lines, 1.5, 1.2, 0.9 at 0.1, 0.3, 1; D1 79.8, 80.6, 80.5,
# 80.4 dB.
LINE_WEIGHT = 0.3
HALVINGS = 50  # of a displacement that turns a face; some ten faces of ten thousand are turned without
LINE_POINTS = 4  # on each edge of a line
BLOCK = 1 << 16  # points that are added at a time
SIDES = ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5))  # their middles: a quadrature that is exact for squares


@dataclass(frozen=True)
class VertexFit:
    """mesh: the fitted one; matrix: A in the squared error (x - x*)' A (x - x*) over the area around its positions x*, in units
    of half the source's longest side."""

    mesh: Mesh
    matrix: NormalMatrix


class MatchedLines(NamedTuple):
    """Edges of source and mesh that belong together, each int64 [L, 2]: Simplification.lines and SimplifiedMesh.lines."""

    source: np.ndarray
    mesh: np.ndarray


class _SampledSource:
    """A source surface with evenly spread points. points: float64 [M, 3]; face: int64 [M], that they are on; share: area that
    each stands for; nearest: NearestPoints of the mesh."""

    def __init__(self, mesh: Mesh, samples: int) -> None:
        self.mesh, self.nearest = mesh, NearestPoints(mesh)
        self.face, bary = sample_surface(mesh.positions, mesh.faces, samples)
        self.points = points_at(mesh, self.face, bary)
        self.share = float(face_areas(mesh.positions, mesh.faces).sum()) / samples

    def spacing(self, mesh: Mesh) -> float:
        """Return the side of a square that a face of another mesh stands for."""
        return np.sqrt(self.share * len(self.points) / len(mesh.faces))


def fit_vertices(source: Mesh, mesh: Mesh, lines: MatchedLines | None = None, samples: int = SAMPLES, rounds: int = ROUNDS,
                 threads: int = 1) -> VertexFit:
    """Return a mesh whose vertices are moved to fit a source surface by least squares, as a VertexFit.

    lines: edges of both meshes that are fitted to each other; samples: points on each surface, at least LEAST_SAMPLES for each
    face of the mesh; rounds: at least 1. The fit turns no face against its normal. Raises ValueError if one of the two meshes
    has no area.
    """
    source, mesh = source.checked(), mesh.checked()
    middle, half = source.frame()
    source, mesh = (Mesh((m.positions - middle) / half, m.faces) for m in (source, mesh))
    samples = max(samples, LEAST_SAMPLES * len(mesh.faces))
    sampled = _SampledSource(source, samples)
    normals = area_normals(mesh)
    for seed in range(1, rounds + 1):
        equations = NormalEquations(mesh.faces, len(mesh.positions))
        _add_surfaces(equations, mesh, sampled, seed, threads)
        _add_own(equations, mesh, 2 * HOLD)
        if lines is not None:
            _add_lines(equations, (mesh, lines.mesh), (source, lines.source), sampled.spacing(mesh))
        moved, matrix = equations.solve(STIFFNESS, DAMPING)
        mesh = Mesh(mesh.positions + _unturned(mesh, moved, normals)[:, None] * moved, mesh.faces)
    return VertexFit(Mesh(mesh.positions * half + middle, mesh.faces), matrix)


def own_fit(mesh: Mesh) -> VertexFit:
    """Return the VertexFit of a mesh to itself: its positions stay, and the matrix is computed in closed form."""
    mesh = mesh.checked()
    middle, half = mesh.frame()
    equations = NormalEquations(mesh.faces, len(mesh.positions))
    _add_own(equations, Mesh((mesh.positions - middle) / half, mesh.faces), 1.0)
    return VertexFit(mesh, equations.matrix(STIFFNESS, DAMPING))


def _unturned(mesh, moved, normals):
    """Return shares of the displacements, float64 [V], at which no face turns against its normal before the fit: they are halved
    until no face turns, and 0 if that does not help."""
    share = np.ones(len(moved))
    for _ in range(HALVINGS):
        later = area_normals(Mesh(mesh.positions + share[:, None] * moved, mesh.faces))
        turned = ((later * normals).sum(axis=1) <= 0) & normals.any(axis=1)
        if not turned.any():
            return share
        share[mesh.faces[turned]] *= 0.5
    return np.zeros(len(moved))


def area_normals(mesh: Mesh) -> np.ndarray:
    """Return face normals with a length of twice the area, float64 [F, 3]."""
    return np.cross(*(mesh.positions[mesh.faces[:, k]] - mesh.positions[mesh.faces[:, 0]] for k in (1, 2)))


def _add_own(equations, mesh, weight):
    """Add the mesh's distance to its own present surface."""
    cross = area_normals(mesh)
    length = np.linalg.norm(cross, axis=1)
    cross /= np.where(length > 0, length, 1.0)[:, None]
    for side in SIDES:
        for some in _blocks(len(cross)):
            face = np.arange(*some.indices(len(cross)))
            bary, nothing = np.tile(side, (len(face), 1)), np.zeros((len(face), 3))
            equations.add(PointResiduals(face, bary, nothing, cross[some], weight * length[some] / 6), 1 - TANGENTIAL, TANGENTIAL)


def _add_surfaces(equations, mesh, sampled, seed, threads):
    """Add points of both surfaces. sampled: _SampledSource."""
    moving, turn = NearestPoints(mesh), sampled.spacing(mesh)
    there = moving.find(sampled.points, sampled.nearest.normals(sampled.face), turn, threads=threads)
    for some in _blocks(len(there.face)):
        face, bary, normals = there.face[some], there.bary[some], sampled.nearest.normals(sampled.face[some])
        residual = sampled.points[some] - points_at(mesh, face, bary)
        _add_agreeing(equations, PointResiduals(face, bary, residual, normals, sampled.share), moving.normals(face))
    count = len(sampled.points)
    del there
    face, bary = sample_surface(mesh.positions, mesh.faces, count, seed)
    points = points_at(mesh, face, bary)
    own = moving.normals(face)
    del moving
    there = sampled.nearest.find(points, own, turn, threads=threads)
    for some in _blocks(count):
        normals = sampled.nearest.normals(there.face[some])
        residual = points_at(sampled.mesh, there.face[some], there.bary[some]) - points[some]
        _add_agreeing(equations, PointResiduals(face[some], bary[some], residual, normals, sampled.share), own[some])


def _add_agreeing(equations, points, own):
    """Add the PointResiduals whose direction agrees with their own normals, float64 [M, 3]; weight: of each point."""
    agree = (own * points.direction).sum(axis=1) > 0
    equations.add(points._replace(weight=points.weight * agree), 1 - TANGENTIAL, TANGENTIAL)


def _blocks(count):
    """Return slices of BLOCK points below count."""
    return [slice(begin, begin + BLOCK) for begin in range(0, count, BLOCK)]


def _add_lines(equations, moving, source, spacing):
    """Add points of both meshes' lines, each with the nearest point of the other mesh on a line of the same direction. moving,
    source: (mesh, lines); spacing: the mean side of a face, by which a length becomes an area."""
    face, corners = line_sides(moving[0].faces, moving[1])
    if not len(face) or not len(source[1]):
        return
    own, end = _as_faces(moving[0], np.take_along_axis(moving[0].faces[face], corners, axis=1)), _as_faces(*source)
    own_way, end_way = _ways(own), _ways(end)
    for outwards in (True, False):
        points, line, share, length = _line_points(own if outwards else end)
        there = NearestPoints(end if outwards else own).find(points)
        near = points_at(end if outwards else own, there.face, there.bary)
        moved, still = (line, there.face) if outwards else (there.face, line)
        second = share if outwards else 1 - there.bary[:, 0]
        bary = np.zeros((len(line), 3))
        np.put_along_axis(bary, corners[moved], np.stack([1 - second, second], axis=1), axis=1)
        alike = np.abs((own_way[moved] * end_way[still]).sum(axis=1)) > 0.5
        residual, weight = near - points if outwards else points - near, LINE_WEIGHT * spacing * length * alike
        equations.add(PointResiduals(face[moved], bary, residual, end_way[still], weight), -1.0, 1.0)


def _as_faces(mesh, lines):
    """Return lines as faces with two equal corners, which NearestPoints accepts as well."""
    return Mesh(mesh.positions, lines[:, [0, 1, 1]])


def _ways(lines):
    """Return unit vectors along lines, float64 [L, 3]."""
    way = np.diff(lines.positions[lines.faces[:, :2]], axis=1)[:, 0]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return way / np.where(length > 0, length, 1.0)


def _line_points(lines):
    """Return LINE_POINTS on every line: (points float64 [M, 3], line int64 [M], share of the way along it float64 [M], length
    that each point stands for float64 [M])."""
    line = np.repeat(np.arange(len(lines.faces)), LINE_POINTS)
    share = np.tile((np.arange(LINE_POINTS) + 0.5) / LINE_POINTS, len(lines.faces))
    length = np.linalg.norm(np.diff(lines.positions[lines.faces[:, :2]], axis=1)[:, 0], axis=1) / LINE_POINTS
    return points_at(lines, line, np.stack([1 - share, share, np.zeros(len(line))], axis=1)), line, share, length[line]
