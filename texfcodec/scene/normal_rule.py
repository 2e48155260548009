"""What a rule of shading normals says (spec clause 8.4.1). geometry/shading_normals.py makes normals by it."""

from __future__ import annotations

import math
from typing import NamedTuple

JOINED, MARKED, CODED = range(3)
AREA, ANGLE, BOTH = range(3)
WEIGHTS = 3
_WEIGHT_NAMES = ("area", "corner angle", "area and corner angle")
_KIND_NAMES = ("faces joined over edges", "faces joined over edges that are not marked as sharp,")


class NormalRule(NamedTuple):
    """kind: a corner's normal is the mean over the faces around its vertex that it reaches over edges at which faces are within
    the angle (JOINED) and that the stream does not mark as sharp (MARKED), or it is in the stream (CODED, which has no weight).
    weight: AREA of a face, ANGLE of its corner at the vertex, or BOTH as a product. angle: whole degrees 0..180; 0 is flat."""

    kind: int
    weight: int
    angle: int

    @property
    def code(self) -> int:
        """normal_rule in the stream."""
        return WEIGHTS * self.kind + self.weight

    @property
    def cosine(self) -> float:
        """Least cosine of two normals that are within the angle; a little below it, so that 90 means right angles too."""
        return math.cos(math.radians(self.angle)) - 1e-9

    @property
    def is_flat(self) -> bool:
        """Whether every corner has the normal of its face."""
        return self.kind != CODED and self.angle == 0

    @property
    def has_marks(self) -> bool:
        """Whether edges of its faces are marked."""
        return self.kind in (MARKED, CODED)

    def __str__(self) -> str:
        if self.kind == CODED:
            return "coded"
        if self.is_flat:
            return "flat"
        return f"{_KIND_NAMES[self.kind]} within {self.angle} degrees, weighed by {_WEIGHT_NAMES[self.weight]}"


FLAT = NormalRule(JOINED, AREA, 0)
USUAL = NormalRule(JOINED, AREA, 45)
IN_STREAM = NormalRule(CODED, AREA, 0)
MOST_ANGLE = 180


def rule_of(code: int, angle: int) -> NormalRule:
    """The rule of normal_rule and normal_angle."""
    return NormalRule(code // WEIGHTS, code % WEIGHTS, angle)
