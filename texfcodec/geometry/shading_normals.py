"""Shading normals by rule: the faces around a vertex that contribute to a corner's normal, and their weights (spec clause 8.4).

A rule ignores the borders of units, fields and materials, which are not creases.
"""

from functools import cached_property

import numpy as np

from ..scene.normal_rule import ANGLE, AREA, CODED, JOINED, MARKED, USUAL, NormalRule
from .corner_groups import CornerGroups
from .edges import Edges, corner_pairs, joined, shared_edges, weld

STEPS = 2048  # of a component of a normal, so that equal ones merge
BLOCK = 1 << 16  # faces, corners or pairs
_CANCELLED = 1e-9  # of the weight that a sum keeps, below which it has no direction


class Fans:
    """The corners 3 f + c around each vertex of a surface, with the quantities from which rules of shading normals compute.
    Vertices at one position count as one.

    lattice: int64 [V, 3] below 2**20; faces: int64 [F, 3]. Attributes: vertex: int64 [3 F], welded vertex of each corner; unit:
    float64 [F, 3] normals, 0 without area; area: float64 [F], twice the area in squared lattice steps.
    """

    def __init__(self, lattice: np.ndarray, faces: np.ndarray) -> None:
        self.vertex = weld(lattice)[faces].ravel()
        self.unit, self.area, self._mesh = np.empty((len(faces), 3)), np.empty(len(faces)), (lattice, faces)
        for some in _blocks(len(faces)):
            corners = lattice[faces[some]].astype(np.float64)
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = self.area[some] = np.linalg.norm(normal, axis=1)
            self.unit[some] = normal / np.where(area > 0, area, 1.0)[:, None]

    @cached_property
    def _angle(self):
        lattice, faces = self._mesh
        corners = (lattice[faces[some]].astype(np.float64) for some in _blocks(len(faces)))
        return np.concatenate([np.zeros(0), *map(_corner_angles, corners)])

    def weights(self, weight: int) -> np.ndarray:
        """Return the weight of each corner in the mean of normals at its vertex, float64 [3 F]. weight: AREA of the face, ANGLE
        at the corner, or BOTH multiplied."""
        if weight == ANGLE:
            return self._angle
        area = np.repeat(self.area, 3)
        return area if weight == AREA else area * self._angle

    @cached_property
    def edges(self) -> Edges:
        """Edges that faces share."""
        return shared_edges(self.vertex.reshape(-1, 3))

    @cached_property
    def links(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(pairs of corners at one end of a shared edge, int64 [L, 2]; the cosine between the normals of their faces, float64
        [L]; the edge, int64 [L]). All pairs of faces at an edge occur, so their order has no influence."""
        pairs, edge = corner_pairs(self.edges, self.vertex)
        cosine = np.empty(len(pairs))
        for some in _blocks(len(pairs)):
            cosine[some] = np.einsum("nk,nk->n", self.unit[pairs[some, 0] // 3], self.unit[pairs[some, 1] // 3])
        return pairs, cosine, edge

    def normals(self, rule: NormalRule, chosen: np.ndarray | None = None, sharp: np.ndarray | None = None) -> np.ndarray:
        """Return shading normals of corners by one rule, float32 [N, 3] of length 1. chosen: int64 [N], corners 3 f + c, None
        for all; sharp: bool [E], the edges that are marked as sharp."""
        chosen = np.arange(len(self.vertex)) if chosen is None else chosen
        if rule.is_flat:
            return self._rounded(np.zeros((1, 4)), np.zeros(len(chosen), np.int64), chosen)
        return self.of_sets(self.joined(rule.angle, sharp if rule.kind == MARKED else None), rule.weight, chosen)

    def joined(self, angle: int, sharp: np.ndarray | None = None) -> np.ndarray:
        """Return the number of the set that every corner belongs to, int64 [3 F]; a set shares a normal. Two corners at one end
        of an edge are in one set if the angle between their faces is within `angle`, as in NormalRule, and the edge is not
        sharp. sharp: bool [E]."""
        pairs, cosine, edge = self.links
        linked = cosine >= NormalRule(JOINED, AREA, angle).cosine
        if sharp is not None:
            linked &= ~sharp[edge]
        return joined(pairs[linked], len(self.vertex))

    def of_sets(self, sets: np.ndarray, weight: int, chosen: np.ndarray) -> np.ndarray:
        """Return for each chosen corner the weighted mean of the face normals in its set, float32 [N, 3] of length 1. sets:
        int64 [3 F] below 3 F, of joined(); the corners of a set share a vertex. weight: as in weights(); chosen: int64 [N],
        corners 3 f + c."""
        weights = self.weights(weight)
        parts = [np.bincount(sets, weights * np.repeat(self.unit[:, k], 3)) for k in range(3)]  # in the order of the corners
        total = np.stack([*parts, np.bincount(sets, weights)], axis=1)
        return self._rounded(total, sets[chosen], chosen)

    def _rounded(self, total, sets, chosen):
        """Unit vectors of the sums [S, 4] of the sets of chosen corners. If a sum cancels, the face's own normal; if that is
        zero, z."""
        clear = np.linalg.norm(total[:, :3], axis=1) > _CANCELLED * total[:, 3]
        out = _stepped(total[:, :3])[sets]
        unclear = np.flatnonzero(~clear[sets])
        out[unclear] = _stepped(self.unit, chosen[unclear] // 3)
        return out


def _stepped(vectors, chosen=None):
    """Chosen vectors [N, 3], of None all, as unit vectors in steps of STEPS, float32 [n, 3]."""
    out = np.empty((len(vectors) if chosen is None else len(chosen), 3), np.float32)
    for some in _blocks(len(out)):
        out[some] = _unit(np.rint(_unit(vectors[some if chosen is None else chosen[some]]) * STEPS))
    return out


def _blocks(count):
    """Slices of BLOCK numbers below count. Blockwise intermediate results stay in the cache and need little memory."""
    return [slice(begin, min(begin + BLOCK, count)) for begin in range(0, count, BLOCK)]


def _of_groups(groups, normals, fans, chosen):
    """Coded normals of corners, float32 [N, 3]; a corner without a group gets its face's normal."""
    group = groups.group[chosen]
    return _unit(np.where(group[:, None] >= 0, normals[group].astype(np.float64), fans.unit[chosen // 3])).astype(np.float32)


def _corner_angles(corners):
    """Angles in radians at the corners of triangles float64 [F, 3, 3]: [3 F]; 0 if two corners coincide."""
    out = np.zeros((len(corners), 3))
    for i in range(3):
        u, v = (corners[:, (i + k) % 3] - corners[:, i] for k in (1, 2))
        out[:, i] = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("nk,nk->n", u, v))
    return out.ravel()


def _unit(vectors):
    """Vectors [N, 3] scaled to length 1; z for vectors without a direction."""
    length = np.linalg.norm(vectors, axis=1)
    flat = ~(length > 0)
    out = vectors / np.where(flat, 1.0, length)[:, None]
    out[flat] = (0.0, 0.0, 1.0)
    return out


def corner_normals(lattice: np.ndarray, faces: np.ndarray, rules: list[NormalRule] | None = None,
                   face_rule: np.ndarray | None = None, sharp: np.ndarray | None = None,
                   coded: tuple[CornerGroups, np.ndarray] | None = None) -> np.ndarray:
    """Unit normal of every face corner, float32 [F, 3, 3], in steps of about 1/2048 so that equal normals merge.

    lattice: int64 [V, 3]; faces: int64 [F, 3]; rules: of shading normals, by number, or empty for the usual rule alone;
    face_rule: int64 [F], number of each face's rule; sharp: bool over the edges of faces whose rule has marks (spec 8.4.2), None
    without such a rule; coded: CornerGroups and their normals int16 [G, 3], None without a CODED rule.
    """
    rules = [USUAL] if rules is None else rules
    of_corner = np.zeros(3 * len(faces), np.int64) if face_rule is None else np.repeat(face_rule, 3)
    fans, out = Fans(lattice, faces), np.empty((3 * len(faces), 3), np.float32)
    if sharp is not None:
        of_edge = np.zeros(len(fans.edges), bool)
        of_edge[fans.edges.touching(np.array([r.has_marks for r in rules], bool)[of_corner[::3]])] = sharp
        sharp = of_edge
    same: dict[NormalRule, list[int]] = {}
    for number, rule in enumerate(rules):
        same.setdefault(rule, []).append(number)
    for rule, numbers in same.items():
        chosen = np.flatnonzero(np.isin(of_corner, numbers))
        if len(chosen) and rule.kind == CODED and coded is not None:
            out[chosen] = _of_groups(*coded, fans, chosen)
        elif len(chosen):
            out[chosen] = fans.normals(rule, chosen, sharp)
    return out.reshape(-1, 3, 3)
