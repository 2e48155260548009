"""Edges that faces share, in an order that depends on the geometry alone, and how far they fold (spec clause 8.4.2)."""

from dataclasses import dataclass

import numpy as np

MOST_AT_EDGE = 8  # faces; an edge of more is none to speak of
NORMAL_BITS = 14  # of the largest component of a normal that folds are taken from
FOLDS = (4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4)  # 4096 times the squared cosines of 2, 5, 10, 20, ... 60, 75, 88
RIGHT, BACK, UNKNOWN, MANY = range(len(FOLDS), len(FOLDS) + 4)
NUM_FOLDS = MANY + 1


@dataclass
class Edges:
    """Edges of two to MOST_AT_EDGE faces, ascending by their ends. ends: int64 [E, 2] numbers of welded vertices, the lower
    first; half: int64 [H], the sides 3 f + i of faces, from corner i to the next, edge after edge; edge: int64 [H], whose side
    each is."""

    ends: np.ndarray
    half: np.ndarray
    edge: np.ndarray

    def __len__(self) -> int:
        return len(self.ends)

    def touching(self, faces: np.ndarray) -> np.ndarray:
        """Edges that at least one of the chosen faces has, bool [E]. faces: bool [F]."""
        out = np.zeros(len(self), bool)
        out[self.edge[faces[self.half // 3]]] = True
        return out


def weld(lattice: np.ndarray) -> np.ndarray:
    """Number of every lattice position among the different ones, ascending by z, y and x: int64 [V]. lattice: int64 [V, 3]."""
    packed = lattice[:, 0] | (lattice[:, 1] << 20) | (lattice[:, 2] << 40)
    return np.unique(packed, return_inverse=True)[1].reshape(-1)


def shared_edges(corners: np.ndarray) -> Edges:
    """Edges of faces whose corners are welded vertices, int64 [F, 3]. A face with two equal corners has none."""
    start, stop = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, stop), np.maximum(start, stop)
    order = np.lexsort((high, low))  # stable: sides of an edge in the order of the faces
    whole = (corners != np.roll(corners, -1, axis=1)).all(axis=1)
    order = order[whole[order // 3]]
    low, high = low[order], high[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    edge = np.cumsum(fresh) - 1
    count = np.bincount(edge)
    shared = (count >= 2) & (count <= MOST_AT_EDGE)
    kept = shared[edge] if len(edge) else np.zeros(0, bool)
    ends = np.stack([low[fresh], high[fresh]], axis=1)[shared]
    return Edges(ends, order[kept], (np.cumsum(shared) - 1)[edge[kept]])


def folds(edges: Edges, lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Class of the angle between the faces at each edge, int64 [E] below NUM_FOLDS: by squared cosines in integers, so that all
    decoders agree. lattice: int64 [V, 3] below 2**20; faces: int64 [F, 3].

    Components of normals are below 2**42, then brought to NORMAL_BITS bits: dot and squared lengths stay below 2**30, the square
    of the dot and the product of lengths below 2**60.
    """
    out = np.full(len(edges), MANY)
    if not len(edges):
        return out
    first = np.searchsorted(edges.edge, np.arange(len(edges)))
    two = np.flatnonzero(np.diff(np.append(first, len(edges.edge))) == 2)
    a, b = (_normals(lattice, faces[edges.half[first[two] + k] // 3]) for k in (0, 1))
    dot, lengths = (a * b).sum(axis=1), (a * a).sum(axis=1) * (b * b).sum(axis=1)
    known = lengths > 0
    square = dot * dot // np.where(known, lengths >> 12, 1)
    fold = np.searchsorted(-np.array(FOLDS), -square, "left")
    fold = np.where((dot < 0) & (fold < RIGHT), BACK, fold)
    out[two] = np.where(known, fold, UNKNOWN)
    return out


def coded_edges(lattice: np.ndarray, faces: np.ndarray, marked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges that have a mark, in order: (ends int64 [E, 2], fold int64 [E]). lattice: int64 [V, 3]; faces: int64 [F, 3]; marked:
    bool [F], faces whose material asks for marks."""
    edges = shared_edges(weld(lattice)[faces])
    coded = edges.touching(marked)
    return edges.ends[coded], folds(edges, lattice, faces)[coded]


def _normals(lattice, faces):
    """Normals of faces as int64 [N, 3] whose largest component has NORMAL_BITS bits; 0 where a face has no area."""
    u, v = (lattice[faces[:, k]] - lattice[faces[:, 0]] for k in (1, 2))
    normal = np.stack([u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1], u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
                       u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]], axis=1)
    largest = np.abs(normal).max(axis=1)
    bits = sum((largest >> k > 0).astype(np.int64) for k in range(43))[:, None]
    return np.where(bits > NORMAL_BITS, normal >> np.maximum(bits - NORMAL_BITS, 0), normal << np.maximum(NORMAL_BITS - bits, 0))
