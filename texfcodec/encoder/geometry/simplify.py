"""Simplification by edge collapses in the order of their quadric error (encoder only).

One run gives the whole sequence, and any number of faces is a prefix of it. A collapse is done only if it keeps the topology (the
link condition), turns no face by more than a right angle, and keeps lines: borders and the edges that the caller names (seams,
sharp edges) may be thinned out along themselves, never left, joined or crossed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .collapse import collapse_all
from .mesh import Mesh
from .quadrics import vertex_quadrics
from .topology import FIXED, face_lines, vertex_kinds


@dataclass(frozen=True)
class Simplification:
    """A sequence of collapses. source: the mesh that it starts from; kept, removed: int64 [C], the vertices that a collapse joins,
    the first of which lives on; placed: float64 [C, 3], where; remaining: int64 [C], faces after it, descending; last: int64 [F],
    the collapse that takes a face away, C for those that stay, -1 for those that had two equal corners."""

    source: Mesh
    kept: np.ndarray
    removed: np.ndarray
    placed: np.ndarray
    remaining: np.ndarray
    last: np.ndarray

    @property
    def fewest(self) -> int:
        """The least number of faces that can be had."""
        return int(self.remaining[-1]) if len(self.remaining) else int((self.last >= 0).sum())

    def at(self, count: int) -> SimplifiedMesh:
        """The mesh after the first collapses that leave at most `count` faces, or as few as there can be."""
        done = min(int(np.searchsorted(-self.remaining, -count, "left")) + 1, len(self.remaining))
        if count >= (self.last >= 0).sum():
            done = 0
        parent, positions = np.arange(len(self.source.positions)), self.source.positions.copy()
        parent[self.removed[:done]] = self.kept[:done]
        while True:
            further = parent[parent]
            if (further == parent).all():
                break
            parent = further
        positions[self.kept[:done]] = self.placed[:done]  # of a vertex that is placed again and again the last place stays
        face = np.flatnonzero(self.last >= done)
        vertex, faces = np.unique(parent[self.source.faces[face]], return_inverse=True)
        return SimplifiedMesh(Mesh(positions[vertex], faces.reshape(-1, 3)), face, vertex)


@dataclass(frozen=True)
class SimplifiedMesh:
    """mesh; face: int64 [F], the number that each face has in the source, so that its material and chart are known; vertex: int64
    [V], the number that each vertex has there, ascending."""

    mesh: Mesh
    face: np.ndarray
    vertex: np.ndarray


def simplify(source: Mesh, lines: np.ndarray | None = None, fixed: np.ndarray | None = None) -> Simplification:
    """Collapses edges of a mesh until none is left that may go.

    lines: int64 [L, 2], edges that are kept as lines beside the borders (see seams.py); fixed: bool [V], vertices that stay where
    they are. Vertices are joined by their numbers alone: equal positions have to be welded before. Edges of more than two faces
    and vertices at which fans of faces meet stay fixed. Faces with two equal corners are left out.

    Raises ValueError for positions that are not finite and indices out of range.
    """
    source = source.checked()
    middle, half = source.frame()
    positions = (source.positions - middle) / half
    whole = (source.faces != np.roll(source.faces, 1, axis=1)).all(axis=1)
    faces = source.faces[whole]
    marked = face_lines(faces, lines)
    kind = vertex_kinds(faces, marked, len(positions))
    if fixed is not None:
        kind[np.asarray(fixed, bool)] = FIXED
    found = collapse_all(positions, faces, marked, kind, vertex_quadrics(positions, faces, marked))
    last = np.full(len(source.faces), -1)
    last[whole] = found.last
    stays = found.exact  # a place that is a vertex's own is not scaled there and back
    placed = np.where((stays >= 0)[:, None], source.positions[stays], found.placed * half + middle)
    return Simplification(source, found.kept, found.removed, placed, found.remaining, last)
