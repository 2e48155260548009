"""Shading normals by rule: which faces around a vertex a corner's normal is made of, and how much each counts (spec clause 8.4).

A rule looks at the lattice alone, across the borders of units, fields and materials, which are no creases. Where vertices carry
smoothing groups of their own (geometry.unit), these say which faces belong together, and the rule only how they are weighed.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..ground.kernel import kernel

PAIRS, JOINED = range(2)
AREA, ANGLE, BOTH = range(3)
WEIGHT_NAMES = ("area", "corner angle", "area and corner angle")
MOST_FACES = 256  # at a vertex, for pairs: their time grows with the square; beyond that every face keeps its own normal
MOST_AT_EDGE = 8  # faces; an edge of more joins none
STEPS = 2048  # of a component of a normal, so that equal ones merge
_CANCELLED = 1e-9  # of the weight that a sum keeps, below which it has no direction


class NormalRule(NamedTuple):
    """kind: PAIRS, a corner's normal is the mean over the faces around its vertex that are within the angle of its own; or JOINED,
    over those that it reaches over edges at which faces are within the angle. weight: AREA of a face, ANGLE of its corner at the
    vertex, or BOTH as a product. angle: whole degrees 0..180; 0 is flat."""

    kind: int
    weight: int
    angle: int

    @property
    def cosine(self) -> float:
        """Least cosine of two normals that are within the angle; a little below it, so that 90 means right angles too."""
        return float(np.cos(np.radians(self.angle))) - 1e-9

    def __str__(self) -> str:
        if self.angle == 0:
            return "flat"
        how = "pairs of faces" if self.kind == PAIRS else "faces joined over edges"
        return f"{how} within {self.angle} degrees, by {WEIGHT_NAMES[self.weight]}"


FLAT = NormalRule(PAIRS, AREA, 0)
USUAL = NormalRule(PAIRS, AREA, 45)


@kernel
def _paired(corners, vertex, ring, face_unit, weights, rules, out):
    """out float64 [N, 3]: for each of `corners`, the weighed sum of the normals around its vertex that are within its rule's angle.

    ring: (first int64 [V + 1], ranges of corner_of int64 [C], the corners 3 f + c around each vertex); rules: (least cosine
    float64 [N], weight int64 [N]) of each corner; weights: float64 [3, C].
    """
    first, corner_of = ring
    cosine, weight = rules
    for i in range(corners.shape[0]):
        a, kind = corners[i] // 3, weight[i]
        low, high = first[vertex[corners[i]]], first[vertex[corners[i]] + 1]
        few = high - low <= MOST_FACES or cosine[i] <= -1.0
        for j in range(low, high):
            c = corner_of[j]
            b = c // 3
            near = b == a
            if few and not near:
                dot = 0.0
                for k in range(3):
                    dot += face_unit[a, k] * face_unit[b, k]
                near = dot >= cosine[i]
            if near:
                for k in range(3):
                    out[i, k] += weights[kind, c] * face_unit[b, k]


@kernel
def _joined(links, parent):
    """Joins corners, int64 [L, 2], that are linked: parent int64 [C], at first its own number each, is then the least of its set."""
    for i in range(links.shape[0]):
        a, b = links[i, 0], links[i, 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    for i in range(parent.shape[0]):
        parent[i] = parent[parent[i]]


class Fans:
    """The corners 3 f + c around each vertex of a surface, and what rules ask of them. Vertices at one position count as one.

    lattice: int64 [V, 3] below 2**20; faces: int64 [F, 3]. vertex: int64 [3 F]; unit: float64 [F, 3] normals, 0 without area;
    weights: float64 [3, 3 F] by AREA, ANGLE, BOTH.
    """

    def __init__(self, lattice: np.ndarray, faces: np.ndarray) -> None:
        packed = lattice[:, 0] | (lattice[:, 1] << 21) | (lattice[:, 2] << 42)
        self.vertex = np.unique(packed, return_inverse=True)[1].reshape(-1)[faces].ravel()
        corners = lattice[faces].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        self.unit = normal / np.where(area > 0, area, 1.0)[:, None]
        angle = _corner_angles(corners)
        self.area = area
        self.weights = np.stack([np.repeat(area, 3), angle, np.repeat(area, 3) * angle])

    @cached_property
    def ring(self) -> tuple[np.ndarray, np.ndarray]:
        """(first int64 [V + 1], corner_of int64 [3 F]): the corners around vertex v are corner_of[first[v] : first[v + 1]]."""
        corner_of = np.argsort(self.vertex, kind="stable")
        first = np.searchsorted(self.vertex[corner_of], np.arange(int(self.vertex.max(initial=-1)) + 2))
        return first, corner_of

    @cached_property
    def links(self) -> tuple[np.ndarray, np.ndarray]:
        """(pairs of corners at one end of an edge that two faces share, int64 [L, 2], the cosine between their normals [L])."""
        start = np.arange(len(self.vertex))
        stop = start - start % 3 + (start + 1) % 3
        a, b = self.vertex[start], self.vertex[stop]
        key = np.minimum(a, b) * (int(self.vertex.max(initial=0)) + 1) + np.maximum(a, b)
        order = np.argsort(key, kind="stable")
        key = key[order]
        at = np.searchsorted(key, key, "left")
        few = np.searchsorted(key, key, "right") - at <= MOST_AT_EDGE
        found = []
        for step in range(1, MOST_AT_EDGE):
            one = np.flatnonzero((key[step:] == key[:-step]) & few[step:]) if step < len(key) else np.zeros(0, np.int64)
            if not len(one):
                break
            left, right = order[one], order[one + step]
            same = self.vertex[left] == self.vertex[right]
            found.append(np.stack([left, np.where(same, right, stop[right])], 1))
            found.append(np.stack([stop[left], np.where(same, stop[right], right)], 1))
        pairs = np.concatenate([np.zeros((0, 2), np.int64), *found])
        return pairs, np.einsum("nk,nk->n", self.unit[pairs[:, 0] // 3], self.unit[pairs[:, 1] // 3])

    def normals(self, rule: NormalRule, chosen: np.ndarray | None = None) -> np.ndarray:
        """Normals of corners by one rule, float32 [N, 3] of length 1. chosen: int64 [N], None for all."""
        chosen = np.arange(len(self.vertex)) if chosen is None else chosen
        if rule.angle == 0:
            return self._rounded(np.zeros((len(chosen), 3)), chosen)
        if rule.kind == JOINED:
            return self.of_sets(self.joined(rule.angle), rule.weight, chosen)
        total = np.zeros((len(chosen), 3))
        least = -2.0 if rule.angle == 180 else rule.cosine
        rules = np.full(len(chosen), least), np.full(len(chosen), rule.weight, np.int64)
        _paired(chosen, self.vertex, self.ring, self.unit, self.weights, rules, total)
        return self._rounded(total, chosen)

    def joined(self, angle: int) -> np.ndarray:
        """The set of every corner, int64 [3 F], where those at one end of an edge are in one if its faces are within the angle."""
        pairs, cosine = self.links
        parent = np.arange(len(self.vertex))
        _joined(pairs[cosine >= NormalRule(JOINED, AREA, angle).cosine], parent)
        return parent

    def of_sets(self, sets: np.ndarray, weight: int, chosen: np.ndarray) -> np.ndarray:
        """Normals of corners that are means over sets, float32 [N, 3]. sets: int64 [3 F], a number below 3 F for every corner, of
        corners at one vertex; chosen: int64 [N]."""
        weighed = self.weights[weight][:, None] * self.unit[np.arange(len(sets)) // 3]
        total = np.stack([np.bincount(sets, weighed[:, k], len(sets)) for k in range(3)], axis=1)
        return self._rounded(total[sets[chosen]], chosen)

    def _rounded(self, total, chosen):
        """Sums as unit vectors; the face's own normal where they cancel, z where it has none either."""
        length = np.linalg.norm(total, axis=1)
        own = self.unit[chosen // 3]
        most = self.weights[BOTH].max(initial=0.0)
        total = np.where((length > _CANCELLED * most)[:, None], total, own) if most else own
        rounded = np.rint(_unit(total) * STEPS)
        return _unit(rounded).astype(np.float32)


def _corner_angles(corners):
    """Angles in radians at the corners of triangles float64 [F, 3, 3]: [3 F]; 0 where two corners are one."""
    out = np.zeros((len(corners), 3))
    for i in range(3):
        u, v = (corners[:, (i + k) % 3] - corners[:, i] for k in (1, 2))
        out[:, i] = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("nk,nk->n", u, v))
    return out.ravel()


def _unit(vectors):
    """Vectors [N, 3] scaled to length 1; z for those without a direction."""
    length = np.linalg.norm(vectors, axis=1)
    flat = ~(length > 0)
    out = vectors / np.where(flat, 1.0, length)[:, None]
    out[flat] = (0.0, 0.0, 1.0)
    return out


def corner_normals(lattice: np.ndarray, faces: np.ndarray, rules: list[NormalRule] | None = None,
                   face_rule: np.ndarray | None = None) -> np.ndarray:
    """Unit normal of every face corner, float32 [F, 3, 3], components in steps of about 1/2048 so that equal ones merge.

    lattice: int64 [V, 3]; faces: int64 [F, 3]; rules: by number, the usual one alone where there are none; face_rule: int64 [F].
    """
    rules = [USUAL] if rules is None else rules
    of_corner = np.zeros(3 * len(faces), np.int64) if face_rule is None else np.repeat(face_rule, 3)
    fans, out = Fans(lattice, faces), np.empty((3 * len(faces), 3), np.float32)
    same: dict[NormalRule, list[int]] = {}
    for number, rule in enumerate(rules):
        same.setdefault(rule, []).append(number)
    for rule, numbers in same.items():
        chosen = np.flatnonzero(np.isin(of_corner, numbers))
        if len(chosen):
            out[chosen] = fans.normals(rule, chosen)
    return out.reshape(-1, 3, 3)
