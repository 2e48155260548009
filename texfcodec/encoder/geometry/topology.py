"""Which edges of a mesh are lines and which vertices may move, before any collapse (encoder only)."""

from __future__ import annotations

import numpy as np

from ...geometry.edges import joined

FREE, ON_LINE, FIXED = 0, 1, 2  # what a vertex may do: move, move along its line, stay


def undirected(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges of faces without equal corners: (ends int64 [E, 2], the lower first; edge of every side int64 [F, 3], from corner i to
    the next; number of faces at each edge int64 [E])."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    size = int(faces.max(initial=0)) + 1
    code, edge, count = np.unique(ends[:, 0] * size + ends[:, 1], return_inverse=True, return_counts=True)
    return np.stack([code // size, code % size], axis=1), edge.reshape(-1, 3), count


def face_lines(faces: np.ndarray, lines: np.ndarray | None) -> np.ndarray:
    """Sides of faces that are borders, have more than two faces, or are named, bool [F, 3]. faces: int64 [F, 3] without equal
    corners; lines: int64 [L, 2]."""
    ends, edge, count = undirected(faces)
    marked = count != 2
    if lines is not None and len(lines) and len(ends):
        size = max(int(faces.max()), int(np.max(lines))) + 1
        named = np.sort(np.asarray(lines, np.int64), axis=1)
        marked |= np.isin(ends[:, 0] * size + ends[:, 1], named[:, 0] * size + named[:, 1])
    return marked[edge]


def vertex_kinds(faces: np.ndarray, marked: np.ndarray, vertices: int) -> np.ndarray:
    """FREE, ON_LINE for vertices of two line edges, FIXED for ends and crossings of lines and where the mesh is no manifold: int64
    [V]. marked: of face_lines()."""
    ends, edge, count = undirected(faces)
    line = np.zeros(len(ends), bool)
    line[edge[marked]] = True
    degree = np.bincount(ends[line].ravel(), minlength=vertices)
    kind = np.where(degree == 0, FREE, np.where(degree == 2, ON_LINE, FIXED))
    kind[ends[count > 2].ravel()] = FIXED
    kind[_several_fans(faces, edge, count, vertices)] = FIXED
    return kind


def _several_fans(faces, edge, count, vertices):
    """Vertices whose faces do not all hang together by edges, bool [V]."""
    corner = np.arange(faces.size).reshape(-1, 3)
    sides = np.argsort(edge, axis=None, kind="stable")
    pairs = sides[np.isin(edge.ravel()[sides], np.flatnonzero(count == 2))].reshape(-1, 2)
    after = np.roll(corner, -1, axis=1).ravel()
    links = []
    for swap in (False, True):  # the corner of one face at an end of the edge, and the other's at the same end
        first = after[pairs[:, 0]] if swap else pairs[:, 0]
        same = faces.ravel()[first] == faces.ravel()[pairs[:, 1]]
        links.append(np.stack([first, np.where(same, pairs[:, 1], after[pairs[:, 1]])], axis=1))
    roots = np.unique(joined(np.concatenate(links), faces.size))
    return np.bincount(faces.ravel()[roots], minlength=vertices) > 1
