"""Steps 1 to 5 of clause 9.2 over a whole stream: frames, payloads, and references between units. Nothing is decoded."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from ..bitstream.stream import Stream, faults_over_units, read_payload
from ..bitstream.syntax import (
    UNIT_ATTRIBUTE,
    UNIT_CODED_NORMALS,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_SHARP_EDGES,
    UNITS,
)
from ..bitstream.units import is_passed_over
from ..core.syntax_walk import Reader
from ..decoder import json_object
from ..errors import StreamError, TexfError
from ..limits import Limits
from . import oddities
from .framing import Frames, read_frames
from .listing import Listing, Oddity

STAND_IN = {"num_keys": 0, "support": None}  # for a field that could not be read
_NOTHING = Frames([], set(), False, set(), True)
# What holds no more than its syntax: once that is read, the unit is checked.
_PLAIN = (UNIT_HEADER, UNIT_MATERIALS, UNIT_METADATA)


@dataclass(kw_only=True)
class Parsed:
    """The readable part of a stream.

    numbers: by type, the numbers of the units whose values are in the lists of stream; an unreadable unit has a stand-in there,
    None or STAND_IN. lost: types with at least one faulty unit, so that nothing can be said about things that need all of them.
    checked: numbers of units whose check is complete.
    """

    listing: Listing
    frames: Frames = _NOTHING
    stream: Stream = field(default_factory=lambda: Stream({}))
    numbers: dict[int, list[int]] = field(default_factory=lambda: {kind: [] for kind in UNITS})
    lost: set[int] = field(default_factory=set)
    checked: set[int] = field(default_factory=set)

    def has_all(self, kind: int) -> bool:
        """Return whether all units of a type are readable and as many as the sequence header says. kind: UNIT_FIELD,
        UNIT_GEOMETRY or UNIT_MATERIALS."""
        counts = {UNIT_FIELD: (self.stream.fields, "num_fields"), UNIT_GEOMETRY: (self.stream.geometry, "num_geometry_units"),
                  UNIT_MATERIALS: (self.stream.materials, "num_materials")}
        held, count = counts[kind]
        return kind not in self.lost and bool(self.stream.header) and len(held) == self.stream.header[count]

    @property
    def unchecked(self) -> list[int]:
        """Numbers of units that were not checked, although no fault of them is known."""
        known = {number for number, unit in enumerate(self.frames.units) if unit.type in UNITS and unit.type != UNIT_END}
        return sorted(known - self.checked - self.listing.blamed)


def parse(data: bytes, limits: Limits) -> Parsed:
    """Read the syntax of a stream as far as its faults allow, and return it as Parsed, whose listing has the findings."""
    parsed = Parsed(listing=Listing())
    frames = read_frames(data, limits.file_bytes, parsed.listing)
    if frames is None:
        return parsed
    parsed.frames = frames
    order = [number for number, unit in enumerate(frames.units) if unit.type != UNIT_END]
    if not frames.in_order:
        order.sort(key=lambda number: frames.units[number].type)
    view = memoryview(data)
    for number in order:
        _read_unit(view, number, parsed, limits)
    if not parsed.stream.header:
        parsed.lost.add(UNIT_HEADER)
    if frames.whole and not frames.wrong:  # else something of everything may be missing
        for fault in faults_over_units(parsed.stream, len(parsed.numbers[UNIT_MATERIALS]), parsed.lost):
            parsed.listing.error(fault)
    _note_oddities(parsed)
    return parsed


def _read_unit(view, number, parsed, limits):
    unit, stream = parsed.frames.units[number], parsed.stream
    if number in parsed.frames.out_of_place:
        return
    if is_passed_over(view, unit):
        skipped = Oddity("TXF-W01", f"an unknown ancillary unit of {unit.stop - unit.start} bytes is skipped", "5.2",
                         value=unit.type)
        parsed.listing.oddity(skipped, number)
        parsed.checked.add(number)
        return
    lists = {UNIT_FIELD: stream.fields, UNIT_GEOMETRY: stream.geometry, UNIT_ATTRIBUTE: stream.attributes}
    held = lists.get(unit.type, [])
    before = len(held)
    parsed.numbers[unit.type].append(number)
    if number not in parsed.frames.wrong and not _needs_lost(view, unit, parsed):
        try:
            read_payload(view, unit, stream, limits)
            parsed.checked |= {number} if unit.type in _PLAIN else set()
            return
        except TexfError as error:
            parsed.listing.error(error, number)
    del held[before:]
    held.append(STAND_IN if unit.type == UNIT_FIELD else None)
    _forget(unit.type, parsed)


def _needs_lost(view, unit, parsed):
    """Return whether the payload cannot be read without something that is lost."""
    if unit.type == UNIT_MATERIALS:
        return not parsed.stream.header
    if unit.type == UNIT_ATTRIBUTE:
        return bool(parsed.lost & {UNIT_HEADER, UNIT_FIELD}) or not parsed.stream.header
    if unit.type == UNIT_GEOMETRY and UNIT_FIELD in parsed.lost:
        try:
            return parsed.stream.fields[Reader(view, unit.begin, unit.end).read_v("field_index", "5.6")] is STAND_IN
        except (StreamError, IndexError):
            return False
    return False


def _forget(kind, parsed):
    """Marks a type as lost after an unreadable unit."""
    parsed.lost.add(kind)
    if kind == UNIT_SHARP_EDGES:
        parsed.stream.sharp_edges = None
    if kind == UNIT_CODED_NORMALS:
        parsed.stream.coded_normals = None
    if kind == UNIT_METADATA:
        parsed.stream.metadata = None


def _note_oddities(parsed):
    """Adds the oddities of the readable units. Whether an element is used is judged only if no unit that could use it is lost."""
    stream, numbers, materials = parsed.stream, parsed.numbers, UNIT_MATERIALS not in parsed.lost and parsed.stream.materials
    geometry = parsed.has_all(UNIT_GEOMETRY)
    if stream.metadata is not None:
        _note(parsed, oddities.of_metadata(json_object(stream.metadata)), numbers[UNIT_METADATA][0])
    if materials:
        _note(parsed, oddities.of_materials(stream, geometry), numbers[UNIT_MATERIALS][0])
    if UNIT_HEADER not in parsed.lost:
        _note(parsed, oddities.of_header(stream, bool(materials)), numbers[UNIT_HEADER][0])
    for index, oddity in oddities.of_units(stream) if geometry else ():
        parsed.listing.oddity(oddity, numbers[UNIT_GEOMETRY][index])


def _note(parsed, noted: Iterable[Oddity], number: int):
    for oddity in noted:
        parsed.listing.oddity(oddity, number)
