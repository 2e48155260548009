"""Edges that faces share, in an order that depends only on the geometry, and the angle at each (spec clause 8.4.2)."""

from dataclasses import dataclass

import numpy as np

from ..core.components import components
from ..core.distinct import distinct
from ..core.last_result import last_result

MOST_AT_EDGE = 8  # faces; an edge of more is none to speak of
NORMAL_BITS = 14  # of the largest component of a normal that folds are taken from
FOLDS = (4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4)  # 4096 times the squared cosines of 2, 5, 10, 20, ... 60, 75, 88
RIGHT, BACK, UNKNOWN, MANY = range(len(FOLDS), len(FOLDS) + 4)
NUM_FOLDS = MANY + 1


@dataclass
class Edges:
    """Edges of two to MOST_AT_EDGE faces, ascending by their ends. ends: int64 [E, 2] numbers of welded vertices, the lower
    first; half: int64 [H], the sides 3 f + i of faces, from corner i to the next, edge by edge; edge: int64 [H], the edge of each
    side."""

    ends: np.ndarray
    half: np.ndarray
    edge: np.ndarray

    def __len__(self) -> int:
        return len(self.ends)

    def touching(self, faces: np.ndarray) -> np.ndarray:
        """Return which edges belong to at least one of the selected faces, bool [E]. faces: bool [F]."""
        out = np.zeros(len(self), bool)
        out[self.edge[faces[self.half // 3]]] = True
        return out


def weld(lattice: np.ndarray) -> np.ndarray:
    """Number the distinct positions, ascending by z, y and x, and return the number of each vertex's position: int64 [V].
    lattice: int64 [V, 3]."""
    packed = lattice[:, 0] | (lattice[:, 1] << 20) | (lattice[:, 2] << 40)
    return distinct(packed)[1]


@last_result  # the fields, their contacts and the small parts ask for those of one surface
def face_components(faces: np.ndarray) -> np.ndarray:
    """Return the number of the edge-connected component of every face: int64 [F]. faces: int64 [F, 3] over welded vertices."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    key = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = owner[order][same], owner[order][same + 1]
    return components(len(faces), a, b)


def shared_edges(corners: np.ndarray) -> Edges:
    """Return the Edges that faces share. corners: int64 [F, 3], welded vertices of the faces; a face with two equal corners has
    no edges."""
    after = np.roll(corners, -1, axis=1)
    key = (np.minimum(corners, after) << 32 | np.maximum(corners, after)).reshape(-1)
    whole = (corners != after).all(axis=1)
    del after
    order = np.argsort(key, kind="stable")  # sides of an edge in the order of the faces
    if not whole.all():
        order = order[whole[order // 3]]
    key = key[order]
    fresh = np.ones(len(order), bool)
    np.not_equal(key[1:], key[:-1], out=fresh[1:])
    first = np.flatnonzero(fresh)
    count = np.diff(np.append(first, len(key)))
    shared = (count >= 2) & (count <= MOST_AT_EDGE)
    ends = key[first[shared]]
    ends = np.stack([ends >> 32, ends & 0xFFFFFFFF], axis=1)
    del key
    kept = np.repeat(shared, count)
    return Edges(ends, order if kept.all() else order[kept], np.repeat(np.arange(len(ends)), count[shared]))


def folds(edges: Edges, lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the class of the angle between the faces at each edge, int64 [E] below NUM_FOLDS. It compares squared cosines in
    integers, so that all decoders agree. edges: shared_edges() of the welded faces; lattice: int64 [V, 3] below 2**20; faces:
    int64 [F, 3].

    Components of normals are below 2**42, then reduced to NORMAL_BITS bits: dot and squared lengths stay below 2**30, the square
    of the dot and the product of lengths below 2**60.
    """
    out = np.full(len(edges), MANY)
    if not len(edges):
        return out
    first = np.searchsorted(edges.edge, np.arange(len(edges)))
    two = np.flatnonzero(np.diff(np.append(first, len(edges.edge))) == 2)
    a, b = (reduced_normals(lattice, faces[edges.half[first[two] + k] // 3]) for k in (0, 1))
    dot, lengths = (a * b).sum(axis=1), (a * a).sum(axis=1) * (b * b).sum(axis=1)
    known = lengths > 0
    square = dot * dot // np.where(known, lengths >> 12, 1)
    fold = np.searchsorted(-np.array(FOLDS), -square, "left")
    fold = np.where((dot < 0) & (fold < RIGHT), BACK, fold)
    out[two] = np.where(known, fold, UNKNOWN)
    return out


def coded_edges(lattice: np.ndarray, faces: np.ndarray, marked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges that have a coded mark, in coded order: (ends int64 [E, 2], welded vertices; class of folds(), int64
    [E]). lattice: int64 [V, 3]; faces: int64 [F, 3]; marked: bool [F], faces whose material has marks."""
    edges = shared_edges(weld(lattice)[faces])
    coded = edges.touching(marked)
    return edges.ends[coded], folds(edges, lattice, faces)[coded]


def corner_pairs(edges: Edges, vertex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of corners 3 f + c of two faces at one end of their shared edge: (pairs int64 [L, 2], edge of each pair
    int64 [L]). All pairs of faces at an edge occur, so their order has no influence. vertex: int64 [3 F], welded vertex of each
    corner."""
    half, edge, pairs, at = edges.half, edges.edge, [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    other = half - half % 3 + (half + 1) % 3
    for step in range(1, len(half)):
        both = np.flatnonzero(edge[step:] == edge[:-step])
        if not len(both):
            break
        left, right, same = half[both], half[both + step], vertex[half[both]] == vertex[half[both + step]]
        pairs.append(np.stack([left, np.where(same, right, other[both + step])], 1))
        pairs.append(np.stack([other[both], np.where(same, other[both + step], right)], 1))
        at += [edge[both], edge[both]]
    return np.concatenate(pairs), np.concatenate(at)


def joined(links: np.ndarray, count: int) -> np.ndarray:
    """Join pairs of numbers into sets and return the set of each number below count: int64 [count]. Sets are numbered in the
    order of their lowest members. links: int64 [L, 2], the pairs."""
    return components(count, links[:, 0], links[:, 1])


def reduced_normals(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return face normals, not of unit length, as integers int64 [F, 3] whose largest component has NORMAL_BITS bits; 0 for a
    face without area. lattice: int64 [V, 3] below 2**20; faces: int64 [F, 3]."""
    u, v = (lattice[faces[:, k]] - lattice[faces[:, 0]] for k in (1, 2))
    return reduced(np.stack([u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1], u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
                             u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]], axis=1))


def reduced(vectors: np.ndarray) -> np.ndarray:
    """Return vectors, each shifted by bits, left or right, until its largest component has NORMAL_BITS bits; 0 stays 0. vectors:
    int64 [N, 3] below 2**60."""
    largest = np.abs(vectors).max(axis=1, initial=0)
    bits = np.zeros(len(vectors), np.int64)
    for k in (32, 16, 8, 4, 2, 1):
        high = largest >> k > 0
        bits += k * high
        largest = np.where(high, largest >> k, largest)
    down = (bits + (largest > 0) - NORMAL_BITS)[:, None]
    return np.where(down > 0, vectors >> np.maximum(down, 0), vectors << np.maximum(-down, 0))
