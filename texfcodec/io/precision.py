"""Precision of written positions: their error must stay below a quarter of the lattice spacing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..texf import Texf

_TAME = 1e15  # beyond this (or below its inverse) float32 squares, which every viewer takes, overflow or vanish


def float32_is_enough(texf: Texf) -> bool:
    """Return whether float32 holds world coordinates to a quarter of the lattice spacing, and in a range that viewers can
    square."""
    if len(texf.positions) == 0 or not texf.side > 0:
        return bool(np.abs(texf.positions).max(initial=0.0) < _TAME)
    return reach(texf) * 2.0**-24 <= spacing(texf) / 4 and reach(texf) < _TAME and texf.side > 1 / _TAME


def spacing(texf: Texf) -> float:
    """Return the distance between neighbouring points of the position lattice in world units; 0 for a mesh without extent."""
    return float(texf.side) / ((1 << texf.position_bits) - 1)


def reach(texf: Texf) -> float:
    """Return the largest absolute world coordinate of a decoded mesh's vertices."""
    return float(np.abs(texf.positions).max(initial=0.0))


def decimal_digits(texf: Texf) -> int:
    """Return how many significant decimal digits a text format needs to hold world coordinates to a quarter of the lattice
    spacing, 6..17."""
    if not spacing(texf) > 0 or reach(texf) == 0:
        return 17
    return min(max(math.ceil(math.log10(reach(texf)) - math.log10(spacing(texf))) + 2, 6), 17)


def local_frame(texf: Texf, points: np.ndarray) -> tuple[np.ndarray, list[float] | None, float | None]:
    """Return points in a frame that float32 can hold, and the transform of the node that brings them back to the world.

    points: float64 [N, 3] world. Returns (float32 [N, 3], translation list or None, scale float or None):
    world = translation + scale * point. Most meshes stay in world space. Those far from the origin are relative to the origin
    of their cube; very large and very small meshes are also divided by its side.
    """
    if float32_is_enough(texf):
        return points.astype(np.float32), None, None
    local = points - texf.origin
    if texf.side == 0 or 1 / _TAME < texf.side < _TAME:
        return local.astype(np.float32), [float(x) for x in texf.origin], None
    return (local / texf.side).astype(np.float32), [float(x) for x in texf.origin], float(texf.side)
