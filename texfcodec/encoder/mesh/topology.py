"""Edges of a mesh that are lines, and vertices that may move, before any collapse (encoder only).

Lines are borders, edges of more than two faces, and those that a caller names: changes of material, field or UV, and sharp edges.
"""

from __future__ import annotations

import numpy as np

from ...core.distinct import distinct
from ...core.last_result import last_result
from ...geometry.edges import joined
from ...geometry.mesh import Mesh

FREE, ON_LINE, FIXED = 0, 1, 2  # what a vertex may do: move, move along its line, stay


@last_result  # half a dozen functions ask for those of one mesh
def undirected(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the undirected edges of faces without equal corners: (ends int64 [E, 2], the lower first; edge of every side int64
    [F, 3], from corner i to the next; number of faces at each edge int64 [E])."""
    after, size = np.roll(faces, -1, axis=1), int(faces.max(initial=0)) + 1
    sides = np.minimum(faces, after) * size + np.maximum(faces, after)
    code, edge, count = distinct(sides)
    return np.stack([code // size, code % size], axis=1), edge, count


def side_pairs(edge: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the two sides at each edge that two faces share: (int64 [P, 2], numbers 3 f + i of the sides; int64 [P], the
    edges). edge, count: of undirected()."""
    two = np.flatnonzero(count == 2)
    first, sides = np.cumsum(count)[two] - 2, _sorted(edge)
    return np.stack([sides[first], sides[first + 1]], axis=1), two


@last_result
def _sorted(edge):
    """Numbers of the sides, int64 [3 F], ascending by their edge."""
    return np.argsort(edge, axis=None, kind="stable")


def turned_faces(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return a mask, bool [F], of faces that point the opposite way to all three faces around them, none of which does so
    itself: a fault of scans. positions: float64 [V, 3]."""
    _, edge, count = undirected(faces)
    beside = side_pairs(edge, count)[0] // 3
    normals = scaled_normals(positions, faces)
    against = beside[(normals[beside[:, 0]] * normals[beside[:, 1]]).sum(axis=1) < 0]
    alone = np.bincount(against.ravel(), minlength=len(faces)) == 3
    return alone & ~np.isin(np.arange(len(faces)), against[alone[against].all(axis=1)])


def scaled_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return normals of faces, float64 [F, 3], whose lengths are not 1 but neither overflow nor vanish; 0 if there is no
    area."""
    u, v = (positions[faces[:, k]] - positions[faces[:, 0]] for k in (1, 2))
    scale = np.abs(np.concatenate([u, v], axis=1)).max(axis=1, initial=0)[:, None]
    return np.cross(*(side / np.where(scale > 0, scale, 1.0) for side in (u, v)))


def seam_edges(faces: np.ndarray, group: np.ndarray | None = None, corner: np.ndarray | None = None,
               apart: float = 0.0) -> np.ndarray:
    """Return the edges, int64 [L, 2], between two faces of different groups, or whose corners' values differ along the edge by
    more than `apart`. faces: int64 [F, 3] over welded vertices; group: [F], number of a material or a field; corner: [F, 3, C],
    UVs or normals."""
    ends, edge, count = undirected(faces)
    sides, edges = side_pairs(edge, count)
    seam = np.zeros(len(sides), bool)
    if group is not None:
        seam |= np.diff(np.asarray(group)[sides // 3], axis=1)[:, 0] != 0
    if corner is not None:
        held = np.asarray(corner).reshape(-1, np.shape(corner)[2])
        after = sides - sides % 3 + (sides + 1) % 3
        same = faces.ravel()[sides[:, 0]] == faces.ravel()[sides[:, 1]]  # both faces run along the edge the same way
        for first, second in ((sides, after), (after, sides)):
            other = np.where(same, first[:, 1], second[:, 1])
            seam |= (np.abs(held[first[:, 0]] - held[other]) > apart).any(axis=1)
    return ends[edges[seam]]


def sharp_edges(mesh: Mesh, degrees: float) -> np.ndarray:
    """Return edges between two faces whose normals are more than `degrees` apart, int64 [L, 2]. Faces without area and
    turned_faces() have no such edges: as lines they would never be collapsed."""
    ends, edge, count = undirected(mesh.faces)
    sides, edges = side_pairs(edge, count)
    normals, turned = scaled_normals(mesh.positions, mesh.faces), turned_faces(mesh.positions, mesh.faces)
    a, b = (normals[sides[:, k] // 3] for k in (0, 1))
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    sharp = (a * b).sum(axis=1) < np.cos(np.radians(degrees)) * lengths
    return ends[edges[sharp & ~turned[sides // 3].any(axis=1)]]


def line_edges(faces: np.ndarray, lines: np.ndarray | None) -> np.ndarray:
    """Return a mask, bool [E] over the edges of undirected(), of those that are borders, have more than two faces, or are among
    lines, int64 [L, 2]."""
    line = undirected(faces)[2] != 2
    return line if lines is None else line | named_edges(faces, lines)


def named_edges(faces: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return a mask, bool [E] over the edges of undirected(), of those that are among lines, int64 [L, 2] of end vertices."""
    ends, named = undirected(faces)[0], np.sort(np.asarray(lines, np.int64).reshape(-1, 2), axis=1)
    size = max(int(faces.max(initial=0)), int(named.max(initial=0))) + 1
    edges, wanted = ends[:, 0] * size + ends[:, 1], named[:, 0] * size + named[:, 1]
    out, place = np.zeros(len(edges) + 1, bool), np.searchsorted(edges, wanted)
    out[place[np.append(edges, -1)[place] == wanted]] = True
    return out[:-1]


def line_sides(faces: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a face at each of the lines that is an edge: (face int64 [L], its two corners, 0..2, at the line's ends int64 [L,
    2])."""
    edge = undirected(faces)[1].ravel()
    sides = np.flatnonzero(named_edges(faces, lines)[edge])
    first = sides[np.unique(edge[sides], return_index=True)[1]]
    return first // 3, np.stack([first % 3, (first + 1) % 3], axis=1)


def vertex_kinds(faces: np.ndarray, line: np.ndarray, vertices: int) -> np.ndarray:
    """Return what each vertex may do in a collapse, int64 [V]: FREE, ON_LINE for vertices of two line edges, FIXED for ends and
    crossings of lines and for vertices at which the mesh is no manifold. line: bool [E], of line_edges(); vertices: their
    number."""
    ends, edge, count = undirected(faces)
    degree = np.bincount(ends[line].ravel(), minlength=vertices)
    kind = np.where(degree == 0, FREE, np.where(degree == 2, ON_LINE, FIXED))
    kind[ends[count > 2].ravel()] = FIXED
    kind[_several_fans(faces, edge, count, vertices)] = FIXED
    return kind


def wedges(faces: np.ndarray, seams: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (wedge of every corner, int64 [F, 3]; chart of every face, int64 [F]), cut at seams. A wedge is the corners at a
    vertex that are connected by edges which are no seams. seams: int64 [L, 2], end vertices."""
    _, edge, count = undirected(faces)
    pairs, edges = side_pairs(edge, count)
    pairs = pairs[~named_edges(faces, seams)[edges]]
    return joined(_corner_links(faces, pairs), faces.size).reshape(-1, 3), joined(pairs // 3, len(faces))


def _several_fans(faces, edge, count, vertices):
    """Return vertices whose faces are not all connected by edges, bool [V]."""
    fans = joined(_corner_links(faces, side_pairs(edge, count)[0]), faces.size)
    first = np.diff(np.maximum.accumulate(fans), prepend=-1) > 0  # corner of each fan
    return np.bincount(faces.ravel()[first], minlength=vertices) > 1


def _corner_links(faces, pairs):
    """Return corners 3 f + i at the two ends of edges, in both faces: int64 [2 P, 2]. pairs: sides of each, int64 [P, 2]."""
    corner = np.arange(faces.size).reshape(-1, 3)
    after = np.roll(corner, -1, axis=1).ravel()
    links = []
    for swap in (False, True):  # the corner of one face at an end of the edge, and the other's at the same end
        first = after[pairs[:, 0]] if swap else pairs[:, 0]
        same = faces.ravel()[first] == faces.ravel()[pairs[:, 1]]
        links.append(np.stack([first, np.where(same, pairs[:, 1], after[pairs[:, 1]])], axis=1))
    return np.concatenate(links)
