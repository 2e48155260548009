"""Axes and units of formats that state them, converted to glTF's: +Y is up, +Z is forward, and the unit is a metre."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .parts import Notes

# Rows: glTF's x, y and z, by the axis that is up in the file. COLLADA 1.4.1 and 3MF's core give right, up and front.
_AXES = {
    "X": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "Y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "Z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}


@dataclass(frozen=True)
class Placing:
    """Axes and unit of a file. up: the axis that points up, "X", "Y" or "Z"; metres: length of the file's unit."""

    up: str = "Y"
    metres: float = 1.0

    @property
    def matrix(self) -> np.ndarray:
        """float64 [4, 4] from the file's space to glTF's, acting on columns."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.array(_AXES[self.up]) * self.metres
        return matrix


def placing_of(up: str, metres: float | None, where: str, notes: Notes) -> Placing:
    """Return the Placing of a file, and remark on it if it changes positions. up: an unknown axis counts as "Y"; metres: length
    of the unit, None for 1; where: the file's name in remarks, such as "the COLLADA file"."""
    if metres is not None and not (math.isfinite(metres) and metres > 0):
        notes.remark(f"the unit of {where} is not a length; a metre is used")
        metres = None
    placing = Placing(up if up in _AXES else "Y", 1.0 if metres is None else float(metres))
    done = [f"the axis {placing.up}_UP becomes Y up"] * (placing.up != "Y") + \
        [f"a unit of {placing.metres:g} m becomes a metre"] * (placing.metres != 1.0)
    if done:
        notes.remark(f"{where} is turned and scaled as it states: {' and '.join(done)}")
    return placing
