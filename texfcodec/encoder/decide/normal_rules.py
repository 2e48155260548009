"""Which rule makes each material's shading normals again, at what angle, and where edges are marked as sharp (encoder only).

A rule costs two bytes a material and nothing more. Where none comes near the source, the edges at which its normals differ are
marked: 0.1 to 0.5 bits an edge, a thirtieth of what normals at vertices take through Draco (266 to 10,600 bytes on vintage_fan).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...codecs.sharp_edges import enc_marks
from ...geometry.edges import folds
from ...geometry.shading_normals import Fans
from ...report import Step, no_step
from ...scene.normal_rule import FLAT, JOINED, KINDS, MARKED, MOST_ANGLE, PAIRS, USUAL, WEIGHTS, NormalRule
from ..decision import Decision

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene

ANGLES = (15, 30, 45, 60, 75, 90, 120, 180)
CLOSER = (8, 4, 2, 1)  # degrees around the best of ANGLES
MARKED_ANGLES = (180, 90, 60)
CLIP = 10.0  # degrees: an error that is larger is as bad as this
ENOUGH = (0.5, 5.0)  # degrees at the median and at 95 % of the surface: what a rule has to reach
WORTH = 0.9  # of the mean clipped error: what marks have to bring it down to
NEAR = 1.5  # times the least error at the tried corners: what is looked at on the whole surface
SAME = 2.0  # degrees between normals that count as one
TRIED_VERTICES, TRIED_AT_LEAST = 2048, 64  # that rules are tried at, over all materials and for each
POINTS = (0.5, 0.95, 0.99)


@dataclass(frozen=True)
class Shading:
    """How normals are made again. rules: one per material of the scene; marks: bool over the edges that are coded, data: their
    bytes, None where no rule needs marks."""

    rules: list[NormalRule]
    marks: np.ndarray | None = None
    data: bytes | None = None

    @property
    def values(self) -> dict | None:
        """Syntax values of the sharp_edges unit, None where there is none."""
        if self.marks is None:
            return None
        return {"num_edges": len(self.marks), "marks_crc": zlib.crc32(self.marks.tobytes()), "marks_data": self.data}


def choose_normals(scene: Scene, surface: Surface, step: Step = no_step) -> Decision[Shading]:
    """The Shading of a scene on its lattice. Materials without light need none: theirs is the usual rule. Warns where errors stay
    large. step: of Report.stage()."""
    usual = FLAT if scene.flat else USUAL
    rules = [USUAL if m.unlit else usual for m in scene.materials]
    used = np.zeros(len(scene.materials), bool)
    used[surface.material] = True
    lit = np.flatnonzero(used & ~np.array([m.unlit for m in scene.materials], bool))
    if scene.corner_normal is None or not len(lit):
        reason = "the source has no normals" if scene.corner_normal is None else "no material is lit"
        return Decision(Shading(rules), {"reason": reason})
    target = _Target(scene, surface)
    shading = Shading(_search(rules, lit, target, _Target(scene, _tried(surface, lit)), step))
    error = _errors_of(shading.rules, target)
    far = [m for m in lit if _is_far(error, target, m)]
    if far:
        shading, error = _mark(shading, far, target, error)
    evidence = _evidence(shading, lit, target, error, scene)
    median, most, _ = evidence["degrees"]
    if median <= ENOUGH[0] and most <= ENOUGH[1]:
        return Decision(shading, evidence)
    warning = (f"no rule makes the shading normals again: half of the surface is off by {median} degrees or more, a "
               f"twentieth by {most}; if that shows, let the tool that wrote the mesh compute its normals anew, or bake them "
               "into a normal map")
    return Decision(shading, evidence, warnings=(warning,))


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
        apart = normals - self.source[chosen]
        chord = np.sqrt(np.einsum("nk,nk->n", apart, apart))
        return np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0)))

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


def _search(rules, lit, whole, tried, step):
    """The rules, with the one of the least error for each of the lit materials: among all at the tried corners, then the best of
    every kind and weight on the whole surface."""
    best = np.full((KINDS - 1, WEIGHTS, whole.materials), np.inf)
    found = np.zeros(best.shape, np.int64)  # angles

    def attempt(kind, angle, wanted):
        sets = tried.fans.joined(angle) if kind == JOINED and angle else None
        for weight in range(WEIGHTS):
            rule = NormalRule(kind, weight, angle)
            scores = tried.scores(tried.fans.normals(rule) if sets is None else tried.fans.of_sets(sets, weight, tried.all))
            better = wanted[scores[wanted] < best[kind, weight, wanted] - 1e-3]
            best[kind, weight, better], found[kind, weight, better] = scores[better], angle

    coarse = [(kind, angle) for kind in (PAIRS, JOINED) for angle in (0, *ANGLES)]
    for number, (kind, angle) in enumerate(coarse, 1):
        attempt(kind, angle, lit)
        step(number, len(coarse) + len(CLOSER) + 1)
    for number, closer in enumerate(CLOSER, len(coarse)):
        step(number, len(coarse) + len(CLOSER) + 1)
        of_best = _least(best, found)
        for kind, angle in sorted({of_best[m][::2] for m in lit if 0 < of_best[m].angle < MOST_ANGLE}):
            near = np.array([m for m in lit if of_best[m][::2] == (kind, angle)])
            for other in (angle - closer, angle + closer):
                attempt(kind, min(max(other, 1), MOST_ANGLE), near)
    for m in lit:
        if len(tried.all) < len(whole.all) and (whole.material == m).sum() > (tried.material == m).sum():
            for kind, weight in np.argwhere(best[:, :, m] <= NEAR * best[:, :, m].min() + 1e-3).tolist():
                best[kind, weight, m] = _score_of(NormalRule(kind, weight, int(found[kind, weight, m])), whole, m)
    return [rule if m in lit else rules[m] for m, rule in enumerate(_least(best, found))]


def _least(best, found):
    """The best rule of every material; the simplest where several are as good."""
    flat = best.reshape(-1, best.shape[2])
    first = (flat < flat.min(axis=0) + 1e-3).argmax(axis=0)
    angles = found.reshape(flat.shape)
    return [NormalRule(int(i) // WEIGHTS, int(i) % WEIGHTS, int(angles[i, m])) for m, i in enumerate(first)]


def _score_of(rule, target, material):
    chosen = np.flatnonzero(target.material == material)
    error = np.minimum(target.errors(target.fans.normals(rule, chosen), chosen), CLIP)
    return float(error @ target.weight[chosen] / max(target.weight[chosen].sum(), 1e-300))


def _errors_of(rules, target, sharp=None):
    """Degrees at every corner under the rules of the materials."""
    out = np.zeros(len(target.source))
    by_rule: dict[NormalRule, list[int]] = {}
    for m, rule in enumerate(rules):
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
    """(Shading, errors) with the edges of materials far from the source marked, and these with the rule that suits, where that
    brings them closer. Marks are kept for all of them or none, so that an edge between two is marked once."""
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
    coded = fans.edges.touching(np.isin(surface.material, list(chosen)))
    if not coded.any():
        return shading, error
    rules = [chosen.get(m, rule) for m, rule in enumerate(shading.rules)]
    fold = folds(fans.edges, surface.lattice, surface.faces)
    data = enc_marks(sharp[coded], fans.edges.ends[coded], fold[coded])
    return Shading(rules, sharp[coded], data), _errors_of(rules, target, sharp & coded)


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


def _evidence(shading, lit, target, error, scene):
    """What the report says: degrees over the surface of lit materials at POINTS, under the usual rule and under those chosen."""
    mine = np.isin(target.material, lit)
    before = _errors_of([USUAL] * target.materials, target)
    rows = [{"material": scene.materials[m].name, "rule": str(shading.rules[m]),
             "degrees": _rounded(error, target, target.material == m)} for m in lit]
    evidence = {"degrees": _rounded(error, target, mine), "usual_rule_degrees": _rounded(before, target, mine), "materials": rows}
    if shading.data is not None:
        evidence |= {"marked_edges": len(shading.marks), "sharp_edges": int(shading.marks.sum()),
                     "marks_bytes": len(shading.data)}
    return evidence


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
