"""The units of a stream as far as their lengths can be followed, whatever errors they contain (spec 9.2, steps 1 to 3)."""

from __future__ import annotations

from typing import NamedTuple

from ..bitstream.syntax import SIGNATURE, UNIT_END, UNIT_HEADER, UNITS
from ..bitstream.units import ONE_AT_MOST, Unit, check_end, check_place, check_start, check_version, read_frame, wrong_checksum
from ..errors import LimitError, StreamError, TexfError
from .listing import Listing

MOST_UNITS = 1 << 16  # of a stream; each takes memory, and the encoder writes as many as there are fields and materials
MOST_WRONG = 8  # units one after the other with wrong checksums: then lengths are not believed any more


class Frames(NamedTuple):
    """Units of a stream.

    units: in the order of the stream, unknown ones included; wrong: numbers of those with a wrong checksum; whole: whether they
    reach to the end unit; out_of_place: numbers of duplicates and of unknown critical units; in_order: whether the others are in
    the required order.
    """

    units: list[Unit]
    wrong: set[int]
    whole: bool
    out_of_place: set[int]
    in_order: bool


def read_frames(data: bytes, max_file_bytes: int | None, listing: Listing) -> Frames | None:
    """Read the sequence of units of a stream, without their payloads. Adds findings to listing. Return None if the signature,
    the version or max_file_bytes already rules out the rest."""
    try:
        check_start(data, max_file_bytes)
    except TexfError as error:
        listing.error(error)
        return None
    units, wrong, cut = _walk(memoryview(data))
    listing.units = units
    if 0 not in wrong and units and units[0].type == UNIT_HEADER:
        try:
            check_version(data, units[0])
        except TexfError as error:
            listing.error(error, 0)
            return None
    out_of_place, in_order = _judge(units, wrong, len(data), listing)
    if cut is not None and len(units) - 1 not in wrong:  # behind a wrong checksum a wrong length was to be expected
        listing.error(cut)
    return Frames(units, wrong, cut is None, out_of_place, in_order)


def _walk(view):
    """(units, numbers of those with a wrong checksum, the error that ended the walk or None).

    If the last units all have wrong checksums, only the first of them is kept: its length led to the others.
    """
    units: list[Unit] = []
    wrong: set[int] = set()
    cut: StreamError | LimitError | None = None
    position, run = len(SIGNATURE), 0
    while cut is None:
        try:
            unit, right = read_frame(view, position)
        except StreamError as error:
            cut = error
            break
        run = 0 if right else run + 1
        if not right:
            wrong.add(len(units))
        units.append(unit)
        position = unit.stop
        if unit.type == UNIT_END and (right or position == len(view)):
            return units, wrong, None
        if run == MOST_WRONG:
            cut = wrong_checksum(unit)
        elif len(units) == MOST_UNITS:
            cut = LimitError("TXF-L14", "the stream has more units than texf-validate can check", offset=position,
                             allowed=MOST_UNITS)
    believed = len(units) - max(run - 1, 0)
    return units[:believed], {number for number in wrong if number < believed}, cut


def _judge(units, wrong, length, listing):
    """Adds errors of checksums, places and the end unit to listing. Returns out_of_place and in_order of Frames."""
    seen: set[int] = set()
    out_of_place: set[int] = set()
    in_order = True
    for number, unit in enumerate(units):
        if number in wrong:
            listing.error(wrong_checksum(unit), number)
        elif not (unit.type == UNIT_HEADER and seen and unit.type not in seen):  # the first unit is blamed for a late header
            try:
                check_place(unit, seen)
                if unit.type == UNIT_END:
                    check_end(unit, length)
            except TexfError as error:
                listing.error(error, number)
                in_order = False
                if unit.type in ONE_AT_MOST and unit.type in seen or unit.type not in UNITS:
                    out_of_place.add(number)
        seen.add(unit.type)
    return out_of_place, in_order
