"""Which rule makes each material's shading normals again, at what angle, and where edges have to be marked as sharp (encoder only).

A rule costs two bytes a material and nothing more. Where none comes near the source, the edges at which its normals differ are
marked: 0.1 to 0.5 bits an edge, a thirtieth of what normals at vertices take through Draco (266 to 10,600 bytes on vintage_fan).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..asset.normal_rule import FLAT, JOINED, MARKED, PAIRS, USUAL, WEIGHTS, NormalRule
from ..asset.normals import Fans
from ..codecs.sharp_edges import enc_marks
from ..geometry.edges import folds

if TYPE_CHECKING:
    from ..asset.scene import Scene
    from ..geometry.surface import Surface

ANGLES = (15, 30, 45, 60, 75, 90, 120, 180)
CLOSER = (8, 4, 2, 1)  # degrees around the best of ANGLES
MARKED_ANGLES = (180, 90, 60)
CLIP = 10.0  # degrees: an error that is larger is as bad as this
ENOUGH = (0.5, 5.0)  # degrees at the median and at 95 % of the surface: what a rule has to reach
WORTH = 0.9  # of the mean clipped error: what marks have to bring it down to
SAME = 2.0  # degrees between normals that count as one
TRIED_VERTICES, TRIED_AT_LEAST = 4096, 64  # that rules are tried at, over all materials and for each
POINTS = (0.5, 0.95, 0.99)


@dataclass
class Shading:
    """How normals are made again. rules: one per material of the scene; marks: bool over the edges that are coded, data: their
    bytes, None where no rule asks for marks; told: for the report."""

    rules: list[NormalRule]
    marks: np.ndarray | None = None
    data: bytes | None = None
    told: dict[str, Any] = field(default_factory=dict)


def choose_normals(scene: Scene, surface: Surface) -> Shading:
    """The Shading of a scene on its lattice. Materials without light need none: theirs is the usual rule."""
    usual = FLAT if scene.flat else USUAL
    shading = Shading([USUAL if m.unlit else usual for m in scene.materials])
    used = np.zeros(len(scene.materials), bool)
    used[surface.material] = True
    lit = np.flatnonzero(used & ~np.array([m.unlit for m in scene.materials], bool))
    if scene.corner_normal is None or not len(lit):
        shading.told = {"reason": "the source has no normals" if scene.corner_normal is None else "no material is lit"}
        return shading
    target = _Target(scene, surface)
    _search(shading.rules, lit, target, _Target(scene, _tried(surface, lit)))
    error = _errors_of(shading, target)
    far = [m for m in lit if _is_far(error, target, m)]
    if far:
        error = _mark(shading, far, target, error)
    shading.told = _told(shading, lit, target, error, scene)
    return shading


class _Target:
    """A surface and the source's normals on it. source: float64 [3 F, 3]; weight: float64 [3 F], area; material: int64 [3 F]."""

    def __init__(self, scene, surface):
        self.surface, self.fans = surface, Fans(surface.lattice, surface.faces)
        self.source = scene.corner_normal[surface.origin_face].reshape(-1, 3).astype(np.float64)
        self.weight, self.material = np.repeat(self.fans.area, 3), np.repeat(surface.material, 3)
        self.all = np.arange(len(self.source))
        self.materials = len(scene.materials)

    def errors(self, normals, chosen=...):
        """Degrees between normals [N, 3] and the source's at chosen corners."""
        normals, source = normals.astype(np.float64), self.source[chosen]
        return np.degrees(np.arctan2(np.linalg.norm(np.cross(normals, source), axis=1), np.einsum("nk,nk->n", normals, source)))

    def scores(self, normals):
        """Mean clipped error by material, float64 [M]; 0 where it has no surface."""
        total = np.bincount(self.material, np.minimum(self.errors(normals), CLIP) * self.weight, self.materials)
        area = np.bincount(self.material, self.weight, self.materials)
        return total / np.where(area > 0, area, 1.0)


def _tried(surface, lit):
    """The faces around some vertices of every material, all of them where it is small: rules look no further."""
    each, chosen = max(TRIED_VERTICES // len(lit), TRIED_AT_LEAST), np.zeros(len(surface.lattice), bool)
    for material in lit if len(surface.lattice) > TRIED_VERTICES else ():
        mine = np.unique(surface.faces[surface.material == material])
        chosen[mine[:: max(1, len(mine) // each)]] = True
    if not chosen.any():
        return surface
    near = np.flatnonzero(chosen[surface.faces].any(axis=1))
    return replace(surface, faces=surface.faces[near], origin_face=surface.origin_face[near], material=surface.material[near])


def _search(rules, lit, whole, tried):
    """Puts the rule with the least error into rules, for each of the lit materials."""
    best = np.full(whole.materials, np.inf)

    def attempt(kind, angle, wanted):
        sets = tried.fans.joined(angle) if kind == JOINED else None
        for weight in range(WEIGHTS):
            rule = NormalRule(kind, weight, angle)
            found = tried.scores(tried.fans.normals(rule) if sets is None else tried.fans.of_sets(sets, weight, tried.all))
            for m in wanted[found[wanted] < best[wanted] - 1e-3]:
                best[m], rules[m] = found[m], rule

    found = tried.scores(tried.fans.normals(FLAT))
    for m in lit:
        best[m], rules[m] = found[m], FLAT
    for kind in (PAIRS, JOINED):
        for angle in ANGLES:
            attempt(kind, angle, lit)
    for step in CLOSER:
        centres = {(rules[m].kind, rules[m].angle) for m in lit if 0 < rules[m].angle < 180 and best[m] > 1e-2}
        for kind, angle in sorted(centres):
            near = np.array([m for m in lit if rules[m][::2] == (kind, angle)])
            for other in (angle - step, angle + step):
                attempt(kind, min(max(other, 1), 180), near)


def _errors_of(shading, target, sharp=None):
    """Degrees at every corner under the rules of a Shading."""
    out = np.zeros(len(target.source))
    by_rule: dict[NormalRule, list[int]] = {}
    for m, rule in enumerate(shading.rules):
        by_rule.setdefault(rule, []).append(m)
    for rule, materials in by_rule.items():
        chosen = np.flatnonzero(np.isin(target.material, materials))
        if len(chosen):
            out[chosen] = target.errors(target.fans.normals(rule, chosen, sharp), chosen)
    return out


def _is_far(error, target, material):
    mine = target.material == material
    median, most = quantiles(error[mine], target.weight[mine], POINTS[:2])
    return median > ENOUGH[0] or most > ENOUGH[1]


def _mark(shading, far, target, error):
    """Marks the edges of materials far from the source and gives these the rule that suits, where that brings them closer; the
    errors then. Marks are kept for all of them or none, so that an edge between two is marked once."""
    fans, surface = target.fans, target.surface
    sharp = _differing(target)
    best, chosen = {m: WORTH * _score(error, target, m) for m in far}, {}
    for angle in MARKED_ANGLES:
        sets = fans.joined(angle, sharp)
        for weight in range(WEIGHTS):
            found = target.errors(fans.of_sets(sets, weight, target.all))
            for m in far:
                score = _score(found, target, m)
                if score < best[m] - 1e-3:
                    best[m], chosen[m] = score, NormalRule(MARKED, weight, angle)
    if not chosen:
        return error
    for m, rule in chosen.items():
        shading.rules[m] = rule
    coded = fans.edges.touching(np.isin(surface.material, list(chosen)))
    shading.marks = sharp[coded]
    fold = folds(fans.edges, surface.lattice, surface.faces)
    shading.data = enc_marks(shading.marks, fans.edges.ends[coded], fold[coded])
    return _errors_of(shading, target, sharp & coded)


def _differing(target):
    """Edges at which the source's normals differ at one end or both, bool [E]; where more than two faces meet, between half of
    those that face one way."""
    pairs, cosine, edge = target.fans.links
    differ = np.einsum("nk,nk->n", target.source[pairs[:, 0]], target.source[pairs[:, 1]]) < np.cos(np.radians(SAME))
    count, one_way = len(target.fans.edges), cosine >= 0
    total = np.bincount(edge[one_way], minlength=count)
    odd = total[edge] == 0  # no pair faces one way: all count
    counted = one_way | odd
    return 2 * np.bincount(edge[counted & differ], minlength=count) >= np.maximum(np.bincount(edge[counted], minlength=count), 1)


def _score(error, target, material):
    mine = target.material == material
    return float(np.average(np.minimum(error[mine], CLIP), weights=target.weight[mine])) if target.weight[mine].any() else 0.0


def _told(shading, lit, target, error, scene):
    """What the report says: degrees over the surface of lit materials at POINTS, under the usual rule and under those chosen."""
    mine = np.isin(target.material, lit)
    before = _errors_of(Shading([USUAL] * target.materials), target)
    rows = [{"material": scene.materials[m].name, "rule": str(shading.rules[m]),
             "degrees": _rounded(error, target, target.material == m)} for m in lit]
    told = {"degrees": _rounded(error, target, mine), "usual_rule_degrees": _rounded(before, target, mine), "materials": rows}
    if shading.data is not None:
        told |= {"marked_edges": len(shading.marks), "sharp_edges": int(shading.marks.sum()), "marks_bytes": len(shading.data)}
    return told


def _rounded(error, target, mine):
    return [round(value, 3) for value in quantiles(error[mine], target.weight[mine], POINTS)]


def quantiles(error: np.ndarray, weight: np.ndarray, points: tuple[float, ...]) -> list[float]:
    """Least errors that so many parts of the weight do not exceed; 0 where there is no weight. error, weight: float64 [N]."""
    order = np.argsort(error)
    total = np.cumsum(weight[order])
    if not len(total) or total[-1] <= 0:
        return [0.0] * len(points)
    at = np.searchsorted(total, np.asarray(points) * total[-1] * (1 - 1e-12))
    return [float(error[order[i]]) for i in np.minimum(at, len(order) - 1)]
