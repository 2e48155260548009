"""Groups of corners that share a coded normal, their base normals, and the normals that residuals give, in integers so that every
decoder gets the same (spec clause 8.4.3)."""

from dataclasses import dataclass

import numpy as np

from ..scene.normal_rule import CODED, NormalRule
from .edges import Edges, corner_pairs, joined, reduced, reduced_normals, shared_edges, weld

ONE = 14  # fractional bits of a unit vector's component
_ANGLE = 12  # fractional bits of a right angle


@dataclass(frozen=True)
class CornerGroups:
    """Groups of face corners at one vertex that share a coded normal. group: int64 [3 F], the group of each corner 3 f + c, -1
    for none; first: int64 [G + 1], corner_of: int64 [C], the corners of group g are corner_of[first[g] : first[g + 1]]; frame:
    int64 [G, 3, 3], rows x, y and the base normal, of length 2**14."""

    group: np.ndarray
    first: np.ndarray
    corner_of: np.ndarray
    frame: np.ndarray

    def __len__(self) -> int:
        return len(self.frame)

    def normals(self, residuals: np.ndarray, step: int) -> np.ndarray:
        """Return the normals of the groups, int16 [G, 3] of length about 2**14, from coded residuals to the base normals.
        residuals: int64 [G, 2], each below 2**14; step: their quantiser step, below 2**13, in units of 2**-14 in the
        stereographic projection from the point opposite to the base normal.

        A residual times the step is below 2**27, its square below 2**54, a component of the sum below 2**56.
        """
        place = residuals * step
        rest = (1 << ONE) - ((place * place).sum(axis=1) >> ONE)
        weights = np.concatenate([2 * place, rest[:, None]], axis=1)
        return _unit(reduced((weights[:, :, None] * self.frame).sum(axis=1))).astype(np.int16)

    def residuals(self, normals: np.ndarray, step: int) -> np.ndarray:
        """Return the residuals int64 [G, 2] from which normals() gets nearest to the given normals. normals: float64 [G, 3] of
        length 1; step: as in normals(). Encoder only."""
        along = np.einsum("gak,gk->ga", self.frame / (1 << ONE), normals)
        side = np.hypot(along[:, 0], along[:, 1])[:, None]
        towards = np.where(side > 1e-9, along[:, :2] / np.maximum(side, 1e-9), (1.0, 0.0))
        front, height = along[:, 2:] > 0, along[:, 2:]  # two forms of the tangent of half the angle, each where it is exact
        distance = np.where(front, side / np.maximum(1 + height, 1.0), (1 - height) / np.maximum(side, 1e-9))
        place = towards * np.minimum(distance, MOST * step / (1 << ONE))
        return np.rint(place * ((1 << ONE) / step)).astype(np.int64)


MOST = 8000  # a residual's magnitude that the encoder writes at most; the syntax ends a little above


def corner_groups(lattice: np.ndarray, faces: np.ndarray, rules: list[NormalRule], face_rule: np.ndarray,
                  sharp: np.ndarray) -> CornerGroups:
    """Return the corner groups that have a coded normal, in coded order: those with a corner of a face whose rule is CODED.

    lattice: int64 [V, 3] below 2**20; faces: int64 [F, 3]; rules: of shading normals, by number; face_rule: int64 [F], number of
    each face's rule; sharp: bool, marks of the edges of faces whose rule has marks (spec 8.4.2).
    """
    edges = shared_edges(weld(lattice)[faces])
    of_edge = np.zeros(len(edges), bool)
    of_edge[edges.touching(np.array([rule.has_marks for rule in rules], bool)[face_rule])] = sharp
    coded = np.array([rule.kind == CODED for rule in rules], bool)[face_rule]
    return groups_of(lattice, faces, coded, edges, of_edge)


def groups_of(lattice: np.ndarray, faces: np.ndarray, coded: np.ndarray, edges: Edges, sharp: np.ndarray) -> CornerGroups:
    """Return the groups of corner_groups() for a surface whose edges are known already. coded: bool [F], whether a face's rule
    is CODED; edges: shared_edges() of the welded faces; sharp: bool [E], the marks of all edges."""
    vertex, normal = weld(lattice)[faces], reduced_normals(lattice, faces)
    rank, twins = _ranked(vertex)
    parent = joined(np.concatenate([_linked(edges, vertex, normal, sharp), twins]), 3 * len(faces))
    whole = (vertex != np.roll(vertex, 1, axis=1)).all(axis=1)
    asking = np.flatnonzero(np.repeat(coded & whole, 3))
    asking = asking[np.lexsort((rank[asking // 3], vertex.ravel()[asking]))]
    roots, at = np.unique(parent[asking], return_index=True)
    number = np.full(3 * len(faces), -1)
    number[roots[np.argsort(at)]] = np.arange(len(roots))
    group = number[parent]
    corner_of = np.argsort(group, kind="stable")
    corner_of = corner_of[np.searchsorted(group[corner_of], 0):]
    first = np.searchsorted(group[corner_of], np.arange(len(roots) + 1))
    return CornerGroups(group, first, corner_of, _frames(lattice, faces, normal, first, corner_of))


def _ranked(vertex):
    """(rank of every face by its positions, int64 [F], equal for faces with the same three positions in the same orientation;
    pairs of corners of such faces at one position, int64 [P, 2])."""
    first = np.argmin(vertex, axis=1)
    turned = (first[:, None] + np.arange(3)) % 3
    triple = np.take_along_axis(vertex, turned, axis=1)
    order = np.lexsort(triple.T[::-1])
    fresh = np.ones(len(order), bool)
    fresh[1:] = (triple[order[1:]] != triple[order[:-1]]).any(axis=1)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.cumsum(fresh) - 1
    again = np.flatnonzero(~fresh)
    corners = 3 * np.arange(len(vertex))[:, None] + turned
    return rank, np.stack([corners[order[again]], corners[order[again - 1]]], axis=2).reshape(-1, 2)


def _linked(edges, vertex, normal, sharp):
    """Pairs of corners at one end of an edge that is not sharp, int64 [L, 2]. If more than two faces share the edge, only pairs
    of faces with a non-negative dot product of their normals."""
    pairs, edge = corner_pairs(edges, vertex.ravel())
    two = np.bincount(edges.edge, minlength=len(edges))[edge] == 2
    facing = (normal[pairs[:, 0] // 3] * normal[pairs[:, 1] // 3]).sum(axis=1) >= 0
    return pairs[~sharp[edge] & (two | facing)]


def _frames(lattice, faces, normal, first, corner_of):
    """Frames of the groups, int64 [G, 3, 3]. The base normal is the sum of the faces' unit normals, weighted by their angles at
    the vertex: each product is below 2**28."""
    weighed = _unit(normal)[corner_of // 3] * _corner_angles(lattice, faces)[corner_of][:, None]
    base = _unit(reduced(np.add.reduceat(weighed, first[:-1], axis=0))) if len(corner_of) else np.zeros((0, 3), np.int64)
    base[~base.any(axis=1)] = (0, 0, 1 << ONE)
    axis = np.eye(3, dtype=np.int64)[np.argmin(np.abs(base), axis=1)]
    x = _unit(np.cross(base, axis))
    return np.stack([x, np.cross(base, x) >> ONE, base], axis=1)


def _corner_angles(lattice, faces):
    """Angles at the corners, int64 [3 F], about 2**12 for a right angle. Edges are reduced to 14 bits: dot products are below
    2**30, squares of the cross product's length below 2**60."""
    corners, out = lattice[faces], np.empty((len(faces), 3), np.int64)
    for i in range(3):
        u, v = (reduced(corners[:, (i + k) % 3] - corners[:, i]) for k in (1, 2))
        across, along = np.cross(u, v), (u * v).sum(axis=1)
        across = _isqrt_of((across * across).sum(axis=1))
        part = (across << _ANGLE) // np.maximum(across + np.abs(along), 1)
        right = 1 << _ANGLE
        angle = part + (3 * part * (right - part) * (2 * part - right) >> 2 * _ANGLE + 3)
        out[:, i] = np.where(along < 0, 2 * right - angle, angle)
    return out.ravel()


def _unit(vectors):
    """Scales vectors int64 [N, 3] to length 2**14; 0 stays 0. Their largest component has 14 bits."""
    length = _isqrt_of((vectors * vectors).sum(axis=1))
    return (vectors << ONE) // np.maximum(length, 1)[:, None]


def _isqrt_of(values):
    """floor(sqrt(v)) of int64 [N] below 2**60: the root in binary64 is off by one at most."""
    root = np.sqrt(values.astype(np.float64)).astype(np.int64)
    root -= root * root > values
    return root + ((root + 1) * (root + 1) <= values)
