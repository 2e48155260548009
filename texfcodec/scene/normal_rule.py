"""The rule by which shading normals are derived (spec clause 8.4.1); geometry/shading_normals.py applies it."""

from __future__ import annotations

import math
from typing import NamedTuple

JOINED, MARKED, CODED = range(3)
AREA, ANGLE, BOTH = range(3)
WEIGHTS = 3
_WEIGHT_NAMES = ("area", "corner angle", "area and corner angle")
_KIND_NAMES = ("faces joined over edges", "faces joined over edges that are not marked as sharp,")


class NormalRule(NamedTuple):
    """Rule by which a corner's normal is derived from the faces around its vertex.

    Parameters
    ----------
    kind : int
        JOINED takes the mean over the faces that the corner reaches over edges, as far as the faces at an edge are within the
        angle. MARKED also stops at edges that the stream marks as sharp. CODED takes the normal from the stream and has no
        weight.
    weight : int
        AREA of a face, ANGLE of its corner at the vertex, or BOTH as a product.
    angle : int
        Whole degrees 0..180; 0 is flat.
    """

    kind: int
    weight: int
    angle: int

    @property
    def code(self) -> int:
        """Value of the syntax element normal_rule."""
        return WEIGHTS * self.kind + self.weight

    @property
    def cosine(self) -> float:
        """Least cosine of two normals that are within the angle; a little below it, so that 90 means right angles too."""
        return math.cos(math.radians(self.angle)) - 1e-9

    @property
    def is_flat(self) -> bool:
        """True if every corner has the normal of its face."""
        return self.kind != CODED and self.angle == 0

    @property
    def has_marks(self) -> bool:
        """True if the stream marks edges of its faces."""
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
    """Return the rule that the syntax elements normal_rule and normal_angle of a stream stand for.

    Parameters
    ----------
    code : int
        normal_rule: WEIGHTS * kind + weight.
    angle : int
        normal_angle: whole degrees 0..180.

    Returns
    -------
    NormalRule
        The rule.
    """
    return NormalRule(code // WEIGHTS, code % WEIGHTS, angle)
