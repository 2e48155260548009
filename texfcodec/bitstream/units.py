"""Framing: signature, units with length and CRC-32, and the order in which units may come (spec clauses 5.1 and 5.2)."""

import struct
import zlib
from dataclasses import dataclass

from ..errors import LimitError, StreamError, SupportError
from ..ground.walk import Reader, write_v
from .syntax import (
    ANCILLARY,
    SIGNATURE,
    UNIT_END,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_NAMES,
    UNIT_SHARP_EDGES,
    UNITS,
    VERSION,
)

ONE_AT_MOST = (UNIT_HEADER, UNIT_MATERIALS, UNIT_METADATA, UNIT_SHARP_EDGES)


@dataclass
class Unit:
    """One unit: type, its payload's file range [begin, end), and the whole unit's [start, stop)."""

    type: int
    begin: int
    end: int
    start: int
    stop: int

    @property
    def name(self) -> str:
        return UNIT_NAMES.get(self.type, f"unknown ({self.type})")


def write_unit(unit_type: int, payload: bytes) -> bytes:
    """Type, length, payload and CRC-32 over all three."""
    body = bytes([unit_type]) + write_v(len(payload)) + payload
    return body + struct.pack("<I", zlib.crc32(body))


def _read_unit(data, position):
    reader = Reader(data, position, len(data))
    unit_type = reader.take(1, "unit_type", "5.2")[0]
    length = reader.read_v("unit_length", "5.2")
    begin = reader.position
    reader.take(length, UNIT_NAMES.get(unit_type, "an unknown unit"), "5.2")
    (crc,) = struct.unpack("<I", reader.take(4, "unit_crc", "5.2"))
    if zlib.crc32(data[position : begin + length]) != crc:
        raise StreamError("TXF-S03", f"the checksum of the {UNIT_NAMES.get(unit_type, 'unknown')} unit does not match",
                          clause="5.2", offset=position)
    return Unit(unit_type, begin, begin + length, position, reader.position)


def _check_version(data, header):
    """Before anything that follows is looked at: another version may have other units."""
    if header.begin < header.end and data[header.begin] != VERSION:
        raise SupportError("TXF-U04", "the stream is of another version of the format", clause="5.3", offset=header.begin,
                           value=data[header.begin], allowed=VERSION)


def read_units(data: bytes, max_file_bytes: int | None = None) -> tuple[list[Unit], list[Unit]]:
    """Splits a stream into units. data: bytes. Returns (units in file order without the end unit, skipped ones).

    Raises StreamError for a broken frame, wrong order or trailing bytes, SupportError for another version and for an unknown
    critical unit, LimitError for a stream longer than max_file_bytes.
    """
    if max_file_bytes is not None and len(data) > max_file_bytes:
        raise LimitError("TXF-L01", "the stream is larger than the limit", value=len(data), allowed=max_file_bytes)
    if data[: len(SIGNATURE)] != SIGNATURE:
        kind = "is empty" if not data else "does not start with the TexF signature"
        raise StreamError("TXF-S01", f"the stream {kind}", clause="5.1", offset=0)
    units: list[Unit] = []
    skipped: list[Unit] = []
    view, position, last = memoryview(data), len(SIGNATURE), -1
    while True:
        unit = _read_unit(view, position)
        position = unit.stop
        if not units and unit.type != UNIT_HEADER:
            raise StreamError("TXF-S07", "the first unit is not the sequence header", clause="5.2", offset=unit.start)
        if not units:
            _check_version(data, unit)
        if unit.type in ONE_AT_MOST and any(u.type == unit.type for u in units):
            raise StreamError("TXF-S07", f"there is a second {unit.name} unit", clause="5.2", offset=unit.start)
        if unit.type >= ANCILLARY:
            (units if unit.type in UNITS else skipped).append(unit)
            continue
        if unit.type not in UNITS:
            raise SupportError("TXF-U01", "unknown critical unit", clause="5.2", offset=unit.start, value=unit.type)
        if unit.type < last:
            raise StreamError("TXF-S07", f"the {unit.name} unit is out of order", clause="5.2", offset=unit.start)
        last = unit.type
        if unit.type == UNIT_END:
            if unit.end != unit.begin:
                raise StreamError("TXF-S08", "the end unit has a payload", clause="5.9", offset=unit.begin)
            if position != len(data):
                raise StreamError("TXF-S08", "there are bytes after the end unit", clause="5.9", offset=position,
                                  value=len(data) - position, allowed=0)
            return units, skipped
        units.append(unit)
