"""Choice of the rule by which a decoder derives each material's shading normals, of its angle, and of sharp edges to be marked
(encoder only).

A rule costs two bytes a material and nothing more. If no rule comes near the source, the edges at which its normals differ are
marked: 0.1 to 0.5 bits an edge, a thirtieth of the bytes of normals at vertices through Draco (266 to 10,600 bytes on
vintage_fan). If that is not enough either, residuals to the angle-weighted mean are coded for every group of corners.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...codecs.coded_normals import enc_residuals
from ...codecs.sharp_edges import enc_marks
from ...geometry.corner_groups import CornerGroups, groups_of
from ...geometry.edges import folds
from ...geometry.shading_normals import Fans, corner_normals
from ...report import Step, no_step
from ...scene.normal_rule import BOTH, CODED, FLAT, IN_STREAM, JOINED, MARKED, MOST_ANGLE, USUAL, WEIGHTS, NormalRule
from ..decision import Decision
from ..prepare.channel_weights import shown_of_radians
from ..price import coding_mse

if TYPE_CHECKING:
    from ...scene.scene import Scene
    from ..faces import SentSurface

ANGLES = (15, 30, 45, 60, 75, 90, 120, 180)
CLOSER = (8, 4, 2, 1)  # degrees around the best of ANGLES
MARKED_ANGLES = (180, 90, 60)
MOST_SHARE = 0.1  # of a budget of bytes: a headset of 62 kB at r04, 12 of them residuals, lost 5 dB in light at 45 kB with them
MOST_STEP = 4096  # that the syntax has room for
CLIP = 10.0  # degrees: an error that is larger is as bad as this
# Degrees at POINTS of the surface at QP 24: what has to be reached. Without the third, a jet whose rule is 13 degrees off on the
# last hundredth stays 2.4 dB worse in light, for want of 718 bytes of marks.
ENOUGH = (0.5, 3.0, 6.0)
# Of coded normals at QP 24, in units of 2**-14: at most 1.05 degrees, which leaves a median of 0.42 where all are off. Finer
# where bytes gain more in light there than among colours and maps: at 75, six models take 0.3 to 2 % more bytes for 0.1 to 0.5
# dB, a seventh 6 % for 0.2.
STEP, LEAST_STEP = 150, 40
DECIBELS = 12.0  # of the picture for ten times the bytes of attributes; 4 to 16 on five assets from QP 18 to 24
PRICE = 1.3  # 3 * 1.2 * 2 / (8 ln 2), 1.2 being the exponent of these DECIBELS
NOTICED = 0.3  # dB that errors take away from which residuals are tried, whatever the degrees
UNITS = 1 << 13  # of a step for a radian
AT_QP, DOUBLING = 24, 12  # what has to be reached doubles with so much more QP, and so does the step
WORTH = 0.9  # of the mean clipped error: what marks have to bring it down to
NEAR = 1.5  # times the least error at the tried corners: what is looked at on the whole surface
SAME = 2.0  # degrees between normals that count as one
TRIED_VERTICES, TRIED_AT_LEAST = 2048, 64  # that rules are tried at, over all materials and for each
POINTS = (0.5, 0.95, 0.99)


@dataclass(frozen=True)
class CodedNormals:
    """Normals of corner groups. normals: int16 [G, 3]; step: of the residuals; data: their bytes."""

    groups: CornerGroups
    normals: np.ndarray
    step: int
    data: bytes


@dataclass(frozen=True)
class Shading:
    """The rules for normals. rules: one per material of the scene; marks: bool over the coded edges, data: their bytes, None if
    no rule needs marks; coded: None if no rule is CODED."""

    rules: list[NormalRule]
    marks: np.ndarray | None = None
    data: bytes | None = None
    coded: CodedNormals | None = None

    @property
    def sharp_edges(self) -> dict | None:
        """Return the syntax values of the sharp_edges unit, None if there is none."""
        if self.marks is None:
            return None
        return {"num_edges": len(self.marks), "marks_crc": zlib.crc32(self.marks.tobytes()), "marks_data": self.data}

    @property
    def coded_normals(self) -> dict | None:
        """Return the syntax values of the coded_normals unit, None if there is none."""
        if self.coded is None:
            return None
        return {"num_groups": len(self.coded.groups), "normal_step": self.coded.step, "residual_data": self.coded.data,
                "normals_crc": zlib.crc32(self.coded.normals.astype("<i2").tobytes())}

    @property
    def signature(self) -> tuple:
        """Hashable key of the whole shading."""
        coded = None if self.coded is None else (self.coded.step, self.coded.data)
        return tuple(self.rules), self.data, coded

    def corner_normals(self, surface: SentSurface) -> np.ndarray:
        """Return the normals that a decoder derives at the corners of a surface, float32 [F, 3, 3]."""
        coded = None if self.coded is None else (self.coded.groups, self.coded.normals)
        return corner_normals(surface.lattice, surface.faces, self.rules, surface.material, self.marks, coded)


def choose_normals(scene: Scene, surface: SentSurface, qp: float = AT_QP, budget: int | None = None, attributes: float = 0.0,
                   step: Step = no_step) -> Decision[Shading]:
    """Return the Decision on the Shading of a scene: the rule for each material's normals, with marked sharp edges or coded
    normals if no rule comes near the source. Materials without light get the default rule. Warns if large errors remain.
    surface: the scene on its lattice; qp: of colours; budget: bytes of the whole stream, None without one; attributes: bytes
    that colours and maps are likely to take, 0 if unknown; step: of Report.stage()."""
    usual = FLAT if scene.flat else USUAL
    rules = [USUAL if m.unlit else usual for m in scene.materials]
    used = np.zeros(len(scene.materials), bool)
    used[surface.material] = True
    lit = np.flatnonzero(used & ~np.array([m.unlit for m in scene.materials], bool))
    if scene.corner_normal is None or not len(lit):
        reason = "the source has no normals" if scene.corner_normal is None else "no material is lit"
        return Decision(Shading(rules), {"reason": reason})
    target, tolerance = _Target(scene, surface, qp, attributes), tolerance_of(qp)
    shading = Shading(_search(rules, lit, target, _Target(scene, _tried(surface, lit), qp, attributes), step))
    error = _errors_of(shading.rules, target)
    far = [m for m in lit if _is_far(error, target, m, tolerance) or _is_noticed(error, target, m)]
    of_rules = error
    if far:
        most = np.inf if budget is None else MOST_SHARE * budget
        if not any(_is_far(error, target, m, tolerance) for m in far):
            most = min(most, target.worth(error))
        shading, error = _marked_or_coded(shading, far, target, error, tolerance, most)
    evidence = _evidence(shading, lit, target, error, of_rules, scene)
    median, most, _ = evidence["degrees"]
    if median <= ENOUGH[0] * max(tolerance, 1) and most <= ENOUGH[1] * max(tolerance, 1):
        return Decision(shading, evidence)
    warning = (f"the shading normals differ from the source's, by {median} degrees or more on half of the surface and {most} "
               "on 5 %; if that is visible, recompute the normals in the tool that wrote the mesh, or bake them into a normal "
               "map")
    return Decision(shading, evidence, warnings=(warning,))


def tolerance_of(qp: float) -> float:
    """Return the factor by which the errors of normals, in degrees, may exceed ENOUGH at a QP of colours; 1 at AT_QP."""
    return 2.0 ** ((qp - AT_QP) / DOUBLING)


class _Target:
    """A surface and the source's normals on it. source: float64 [3 F, 3]; weight: float64 [3 F], area; material: int64 [3 F];
    attributes: bytes of colours and maps, 0 if unknown; shown: error of a squared radian, over the error of coding."""

    def __init__(self, scene, surface, qp, attributes):
        self.attributes, self.shown = attributes, shown_of_radians(scene.weights) / coding_mse(qp)
        self.surface, self.fans = surface, Fans(surface.lattice, surface.faces)
        self.source = scene.corner_normal[surface.origin_face].reshape(-1, 3).astype(np.float64)
        self.weight, self.material = np.repeat(self.fans.area, 3), np.repeat(surface.material, 3)
        self.all = np.arange(len(self.source))
        self.materials = len(scene.materials)

    def step(self, count, tolerance):
        """Return the quantiser step of `count` coded normals. tolerance: of tolerance_of()."""
        finest, usual = LEAST_STEP * tolerance, STEP * tolerance
        byte_price = self.attributes * self.shown  # 0 where nothing is known, or nothing shows
        wanted = UNITS * np.sqrt(PRICE * count / byte_price) if byte_price > 0 else usual
        return round(min(max(wanted, finest, 1), usual, MOST_STEP))

    def lost(self, error, chosen=...):
        """Return the dB that errors of normals, degrees by corner, take from the lit picture at chosen corners."""
        if not self.weight[chosen].any():
            return 0.0
        squared = np.average(np.radians(np.minimum(error[chosen], CLIP)) ** 2, weights=self.weight[chosen])
        return 10 * np.log10(1 + self.shown * float(squared))

    def worth(self, error):
        """Return the bytes that removing all errors of normals is worth. error: degrees by corner."""
        return self.attributes * (10 ** (self.lost(error) / DECIBELS) - 1)

    def errors(self, normals, chosen=...):
        """Return the angles in degrees, float64 [N], between normals [N, 3] and the source's at chosen corners."""
        apart = normals - self.source[chosen]
        chord = np.sqrt(np.einsum("nk,nk->n", apart, apart))
        return np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0)))

    def scores(self, normals):
        """Return the mean clipped error in degrees by material, float64 [M]; 0 if a material has no surface. normals: [3 F, 3],
        at all corners."""
        total = np.bincount(self.material, np.minimum(self.errors(normals), CLIP) * self.weight, self.materials)
        area = np.bincount(self.material, self.weight, self.materials)
        return total / np.where(area > 0, area, 1.0)


def _tried(surface, lit):
    """Return the faces around some vertices of every material, all of them if it is small: rules are tried there only."""
    each, chosen = max(TRIED_VERTICES // len(lit), TRIED_AT_LEAST), np.zeros(len(surface.lattice), bool)
    for material in lit if len(surface.lattice) > TRIED_VERTICES else ():
        vertices = np.unique(surface.faces[surface.material == material])
        chosen[vertices[:: max(1, len(vertices) // each)]] = True
    if not chosen.any():
        return surface
    near = np.flatnonzero(chosen[surface.faces].any(axis=1))
    return replace(surface, faces=surface.faces[near], origin_face=surface.origin_face[near], material=surface.material[near])


def _search(rules, lit, whole, tried, step):
    """Return the rules, with the one of least error for each lit material: the best of all at the tried corners, then the best of
    every weight on the whole surface."""
    best = np.full((WEIGHTS, whole.materials), np.inf)
    angles = np.zeros(best.shape, np.int64)

    def attempt(angle, wanted):
        sets = tried.fans.joined(angle) if angle else None
        for weight in range(WEIGHTS):
            rule = NormalRule(JOINED, weight, angle)
            scores = tried.scores(tried.fans.normals(rule) if sets is None else tried.fans.of_sets(sets, weight, tried.all))
            better = wanted[scores[wanted] < best[weight, wanted] - 1e-3]
            best[weight, better], angles[weight, better] = scores[better], angle

    coarse = (0, *ANGLES)
    for number, angle in enumerate(coarse, 1):
        attempt(angle, lit)
        step(number, len(coarse) + len(CLOSER) + 1)
    for number, closer in enumerate(CLOSER, len(coarse)):
        step(number, len(coarse) + len(CLOSER) + 1)
        of_best = _least(best, angles)
        for angle in sorted({of_best[m].angle for m in lit if 0 < of_best[m].angle < MOST_ANGLE}):
            near = np.array([m for m in lit if of_best[m].angle == angle])
            for other in (angle - closer, angle + closer):
                attempt(min(max(other, 1), MOST_ANGLE), near)
    partly = [m for m in lit if (whole.material == m).sum() > (tried.material == m).sum()]
    _measure(best, angles, partly, whole)
    return [rule if m in lit else rules[m] for m, rule in enumerate(_least(best, angles))]


def _measure(best, angles, materials, whole):
    """Replace the errors of materials under their best rules, measured at some corners, by those on the whole surface: normals by
    every rule are computed once for all of them."""
    near = {(int(angles[weight, m]), weight, m) for m in materials for weight in range(WEIGHTS)
            if best[weight, m] <= NEAR * best[:, m].min() + 1e-3}
    for angle in sorted({angle for angle, _, _ in near}):
        sets = whole.fans.joined(angle) if angle else None
        for weight in sorted({weight for of, weight, _ in near if of == angle}):
            close = [m for m in materials if (angle, weight, m) in near]
            chosen = np.flatnonzero(np.isin(whole.material, close))
            rule = NormalRule(JOINED, weight, angle)
            normals = whole.fans.normals(rule, chosen) if sets is None else whole.fans.of_sets(sets, weight, chosen)
            error = whole.errors(normals, chosen)
            for m in close:
                of_m = whole.material[chosen] == m
                best[weight, m] = float(np.minimum(error[of_m], CLIP) @ whole.weight[chosen[of_m]]
                                        / max(whole.weight[chosen[of_m]].sum(), 1e-300))


def _least(best, angles):
    """Return the best rule of every material; the simplest if several are as good."""
    first = (best < best.min(axis=0) + 1e-3).argmax(axis=0)
    return [NormalRule(JOINED, int(weight), int(angles[weight, m])) for m, weight in enumerate(first)]


def _errors_of(rules, target, sharp=None):
    """Return degrees at every corner under the rules of the materials."""
    out = np.zeros(len(target.source))
    by_rule: dict[NormalRule, list[int]] = {}
    for m, rule in enumerate(rules):
        by_rule.setdefault(rule, []).append(m)
    for rule, materials in by_rule.items():
        chosen = np.flatnonzero(np.isin(target.material, materials))
        if len(chosen):
            out[chosen] = target.errors(target.fans.normals(rule, chosen, sharp), chosen)
    return out


def _is_far(error, target, material, tolerance):
    corners = target.material == material
    reached = quantiles(error[corners], target.weight[corners], POINTS)
    return any(value > enough * tolerance for value, enough in zip(reached, ENOUGH, strict=True))


def _is_noticed(error, target, material):
    """Return whether errors cost more of the picture than bytes could buy elsewhere; False if the bytes are unknown."""
    return bool(target.attributes) and target.lost(error, target.material == material) > NOTICED


def _marked_or_coded(shading, far, target, error, tolerance, most=np.inf):
    """Return (Shading, errors) of materials that are far from the source: over marked edges if these bring them closer, with
    coded normals if marks are not enough and residuals take at most `most` bytes. All marks are a single set, so that an edge
    between two materials is marked once."""
    sharp, rules = _differing(target), list(shading.rules)
    for m, rule in _rules_over_marks(far, target, error, sharp).items():
        rules[m] = rule
    edges, surface = target.fans.edges, target.surface
    of_marks = _errors_of(rules, target, sharp & edges.touching(_asks_marks(rules, surface)))
    in_stream = [IN_STREAM if m in far and (_is_far(of_marks, target, m, tolerance) or _is_noticed(of_marks, target, m)) else rule
                 for m, rule in enumerate(rules)]
    over_marks = _over_marks(in_stream, target, sharp, tolerance)
    if over_marks is not None and over_marks.coded is not None and len(over_marks.coded.data) > most:
        over_marks = _over_marks(rules, target, sharp, tolerance)
    if over_marks is None:
        return shading, error
    return over_marks, target.errors(over_marks.corner_normals(surface).reshape(-1, 3))


def _over_marks(rules, target, sharp, tolerance):
    """Return the Shading of rules some of which have marks; None if none has, or there is no edge to mark."""
    edges, surface = target.fans.edges, target.surface
    marked = edges.touching(_asks_marks(rules, surface))
    if not marked.any():
        return None
    data = enc_marks(sharp[marked], edges.ends[marked], folds(edges, surface.lattice, surface.faces)[marked])
    return Shading(rules, sharp[marked], data, _coded(rules, target, sharp & marked, tolerance))


def _asks_marks(rules, surface):
    """Return faces whose rule has marks, bool [F]."""
    return np.array([rule.has_marks for rule in rules], bool)[surface.material]


def _rules_over_marks(far, target, error, sharp):
    """Return {material: the rule over marks that brings it closer to the source}, of the materials that are far from it."""
    fans = target.fans
    best, chosen = {m: WORTH * _score(error, target, m) for m in far}, {}
    for angle in MARKED_ANGLES:
        sets = fans.joined(angle, sharp)
        for weight in range(WEIGHTS):
            errors = target.errors(fans.of_sets(sets, weight, target.all))
            for m in far:
                score = _score(errors, target, m)
                if score < best[m] - 1e-3:
                    best[m], chosen[m] = score, NormalRule(MARKED, weight, angle)
    return chosen


def _coded(rules, target, sharp, tolerance):
    """Return the CodedNormals of the materials whose rule is CODED, None if there are none. sharp: bool [E]."""
    asking = np.array([rule.kind == CODED for rule in rules], bool)[target.surface.material]
    if not asking.any():
        return None
    groups = groups_of(target.surface.lattice, target.surface.faces, asking, target.fans.edges, sharp)
    step = target.step(len(groups), tolerance)
    of_group = groups.group[groups.corner_of]
    weight = target.fans.weights(BOTH)[groups.corner_of]
    mean = np.stack([np.bincount(of_group, weight * target.source[groups.corner_of, k], len(groups)) for k in range(3)], axis=1)
    length = np.linalg.norm(mean, axis=1)
    base = groups.frame[:, 2] / np.linalg.norm(groups.frame[:, 2], axis=1)[:, None]
    mean = np.where(length[:, None] > 0, mean / np.where(length > 0, length, 1)[:, None], base)
    residuals = groups.residuals(mean, step)
    return CodedNormals(groups, groups.normals(residuals, step), step, enc_residuals(residuals, groups))


def _differing(target):
    """Return edges at which the source's normals differ at one end or both, bool [E]. If more than two faces meet, they have to
    differ between half of those that face one way."""
    pairs, cosine, edge = target.fans.links
    differ = np.einsum("nk,nk->n", target.source[pairs[:, 0]], target.source[pairs[:, 1]]) < np.cos(np.radians(SAME))
    count, one_way = len(target.fans.edges), cosine >= 0
    total = np.bincount(edge[one_way], minlength=count)
    odd = total[edge] == 0  # no pair faces one way: all count
    counted = one_way | odd
    return 2 * np.bincount(edge[counted & differ], minlength=count) >= np.maximum(np.bincount(edge[counted], minlength=count), 1)


def _score(error, target, material):
    corners = target.material == material
    error, weight = np.minimum(error[corners], CLIP), target.weight[corners]
    return float(np.average(error, weights=weight)) if weight.any() else 0.0


def _evidence(shading, lit, target, error, of_rules, scene):
    """Return the evidence for the report: degrees over the surface of lit materials at POINTS, under the default rule, under the
    best rules alone and as coded."""
    corners = np.isin(target.material, lit)
    before = _errors_of([USUAL] * target.materials, target)
    rows = [{"material": scene.materials[m].name, "rule": str(shading.rules[m]),
             "degrees": _rounded(error, target, target.material == m)} for m in lit]
    evidence = {"degrees": _rounded(error, target, corners), "usual_rule_degrees": _rounded(before, target, corners),
                "rule_degrees": _rounded(of_rules, target, corners), "materials": rows}
    if shading.data is not None:
        evidence |= {"marked_edges": len(shading.marks), "sharp_edges": int(shading.marks.sum()),
                     "marks_bytes": len(shading.data)}
    if shading.coded is not None:
        evidence |= {"coded_normals": len(shading.coded.groups), "normal_step": shading.coded.step,
                     "normals_bytes": len(shading.coded.data)}
    return evidence


def _rounded(error, target, corners):
    return [round(value, 3) for value in quantiles(error[corners], target.weight[corners], POINTS)]


def quantiles(error: np.ndarray, weight: np.ndarray, points: tuple[float, ...]) -> list[float]:
    """Return weighted quantiles of errors: for each of `points`, a share of the weight, the least error that this share does not
    exceed; 0 without weight. error, weight: float64 [N]."""
    order = np.argsort(error)
    total = np.cumsum(weight[order])
    if not len(total) or total[-1] <= 0:
        return [0.0] * len(points)
    at = np.searchsorted(total, np.asarray(points) * total[-1] * (1 - 1e-12))
    return [float(error[order[i]]) for i in np.minimum(at, len(order) - 1)]
