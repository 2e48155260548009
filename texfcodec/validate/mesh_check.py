"""Oddities of decoded geometry, and of its Draco data."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..decoder import decode_unit
from ..errors import StreamError
from ..geometry.geometry_unit import GeometryUnit
from .listing import Oddity

FACES_AT_ONCE = 1 << 18  # so that nothing takes more memory than the mesh itself
AXIS_BITS = 20  # of a packed coordinate


def of_draco(values: dict, position_bits: int) -> Iterator[Oddity]:
    """Yield a warning (Oddity) if Draco data has unused bytes. values: syntax elements of the geometry unit, which decodes
    without error."""
    length = len(values["draco_data"])
    end = draco_end(values, position_bits)
    if end < length:
        yield Oddity("TXF-W03", f"the mesh ends after {end} of {length} bytes of Draco data", "5.6", values["offset"] + end,
                     length - end, 0)


def draco_end(values: dict, position_bits: int) -> int:
    """Return how many bytes of a geometry unit's Draco data its decoding needs. values: the unit's syntax elements.

    Draco does not report where it stops, so shorter data are tried: one byte less, which is the only try on data without
    surplus, then halves of the possible surplus.
    """
    data = values["draco_data"]

    def is_enough(length):
        try:
            decode_unit(values | {"draco_data": data[:length]}, position_bits)
        except StreamError:
            return False
        return True

    low, high = 0, len(data)  # enough bytes are more than low, at most high
    while high - low > 1:
        middle = high - 1 if high == len(data) else (low + high) // 2
        low, high = (low, middle) if is_enough(middle) else (middle, high)
    return high


def of_faces(unit: GeometryUnit) -> Iterator[Oddity]:
    """Yield a finding (Oddity) if faces of a geometry unit have no area."""
    flat = sum(int(_flat(unit.lattice, unit.faces[i : i + FACES_AT_ONCE]).sum())
               for i in range(0, len(unit.faces), FACES_AT_ONCE))
    if flat:
        yield Oddity("TXF-W15", f"{flat} of {len(unit.faces)} faces have no area", "5.6", value=flat)


def _flat(lattice, faces):
    a, b, c = (lattice[faces[:, i]] for i in range(3))  # below 2**20, so that products stay below 2**41
    return ~np.cross(b - a, c - a).any(axis=1)


def of_mesh(units: list[GeometryUnit], position_bits: int) -> Iterator[Oddity]:
    """Yield findings (Oddity) on all geometry units: faces that occur twice, positions that use half of the lattice or less."""
    twice, total = _twice(units), sum(len(unit.faces) for unit in units)
    if twice:
        yield Oddity("TXF-W16", f"{twice} of {total} faces are repeated", "5.6", value=twice)
    low, high = (np.array([f(u.lattice, axis=0) for u in units]) for f in (np.min, np.max))
    widest = int((high.max(axis=0) - low.min(axis=0)).max())
    if 0 < widest < 1 << position_bits - 1:
        yield Oddity("TXF-W17", "the positions use half of the lattice or less", "5.3", value=widest,
                     allowed=f"about {(1 << position_bits) - 1}")


def _twice(units):
    """Number of faces that have the same corners, in the same cyclic order, as an earlier face."""
    rows = np.concatenate([_turned(unit) for unit in units])
    rows = rows[np.lexsort(rows.T)]
    return int((rows[1:] == rows[:-1]).all(axis=1).sum())


def _turned(unit):
    """Faces as packed lattice positions, int64 [F, 3], rotated so that the smallest is first."""
    packed = unit.lattice @ np.array([1, 1 << AXIS_BITS, 1 << 2 * AXIS_BITS])
    corners = packed[unit.faces]
    turn = (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(corners, turn, axis=1)
