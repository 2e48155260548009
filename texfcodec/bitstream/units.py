"""Framing: signature, units with length and CRC-32, and the permitted order of units (spec clauses 5.1 and 5.2)."""

import struct
import zlib
from dataclasses import dataclass

from ..core.syntax_walk import Reader, write_v
from ..errors import LimitError, StreamError, SupportError
from .syntax import (
    ANCILLARY,
    METADATA_JSON,
    SIGNATURE,
    UNIT_CODED_NORMALS,
    UNIT_END,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_NAMES,
    UNIT_SHARP_EDGES,
    UNITS,
    VERSION,
)

ONE_AT_MOST = (UNIT_HEADER, UNIT_MATERIALS, UNIT_METADATA, UNIT_SHARP_EDGES, UNIT_CODED_NORMALS)


@dataclass
class Unit:
    """One unit. type; [begin, end): its payload's range in the file; [start, stop): the range of the whole unit."""

    type: int
    begin: int
    end: int
    start: int
    stop: int

    @property
    def name(self) -> str:
        return UNIT_NAMES.get(self.type, f"unknown ({self.type})")


def write_unit(unit_type: int, payload: bytes) -> bytes:
    """Return the bytes of one unit: type, length, payload and the CRC-32 over all three."""
    body = bytes([unit_type]) + write_v(len(payload)) + payload
    return body + struct.pack("<I", zlib.crc32(body))


def read_frame(data: memoryview, position: int) -> tuple[Unit, bool]:
    """Read the frame of the unit that begins at a position: (the Unit, whether its checksum matches). Raises StreamError if its
    length is invalid or exceeds the data."""
    reader = Reader(data, position, len(data))
    unit_type = reader.take(1, "unit_type", "5.2")[0]
    length = reader.read_v("unit_length", "5.2")
    begin = reader.position
    reader.take(length, UNIT_NAMES.get(unit_type, "an unknown unit"), "5.2")
    (crc,) = struct.unpack("<I", reader.take(4, "unit_crc", "5.2"))
    return Unit(unit_type, begin, begin + length, position, reader.position), zlib.crc32(data[position : begin + length]) == crc


def wrong_checksum(unit: Unit) -> StreamError:
    """Return, without raising it, the error of a unit whose checksum does not match."""
    return StreamError("TXF-S03", f"the checksum of the {UNIT_NAMES.get(unit.type, 'unknown')} unit does not match",
                       clause="5.2", offset=unit.start)


def check_start(data: bytes, max_file_bytes: int | None = None) -> None:
    """Checks the size and the signature of a stream before its units (spec 9.2, step 1). Raises LimitError, StreamError."""
    if max_file_bytes is not None and len(data) > max_file_bytes:
        raise LimitError("TXF-L01", "the stream is larger than the limit", value=len(data), allowed=max_file_bytes)
    if data[: len(SIGNATURE)] != SIGNATURE:
        kind = "is empty" if not data else "does not start with the TexF signature"
        raise StreamError("TXF-S01", f"the stream {kind}", clause="5.1", offset=0)


def check_version(data: bytes | memoryview, header: Unit) -> None:
    """Check the format version in the header unit before the rest of the stream: another version may have other units. Raises
    StreamError for an empty header, SupportError."""
    if header.begin == header.end:
        raise StreamError("TXF-S02", "the sequence header is empty", clause="5.3", offset=header.begin)
    if data[header.begin] != VERSION:
        what = "a newer version" if data[header.begin] > VERSION else "version 0, a draft"
        raise SupportError("TXF-U04", "the stream has another "
                                      f"format version: {what}", clause="5.3", offset=header.begin, value=data[header.begin],
                           allowed=VERSION)


def check_place(unit: Unit, seen: set[int]) -> None:
    """Check that a unit may follow the units before it in the stream (spec 5.2). seen: their types. Raises StreamError,
    SupportError."""
    if not seen and unit.type != UNIT_HEADER:
        raise StreamError("TXF-S07", "the first unit is not the sequence header", clause="5.2", offset=unit.start)
    if unit.type in ONE_AT_MOST and unit.type in seen:
        raise StreamError("TXF-S07", f"there is a second {unit.name} unit", clause="5.2", offset=unit.start)
    if unit.type >= ANCILLARY:
        return
    if unit.type not in UNITS:
        raise SupportError("TXF-U01", "unknown critical unit", clause="5.2", offset=unit.start, value=unit.type)
    if unit.type < max((other for other in seen if other in UNITS and other < ANCILLARY), default=0):
        raise StreamError("TXF-S07", f"the {unit.name} unit is out of order", clause="5.2", offset=unit.start)


def is_passed_over(data: bytes | memoryview, unit: Unit) -> bool:
    """Return whether a decoder skips a unit: this version does not define its type or, for metadata, its format (spec 5.2,
    5.8)."""
    if unit.type == UNIT_METADATA and unit.begin < unit.end:
        return data[unit.begin] != METADATA_JSON
    return unit.type not in UNITS


def check_end(unit: Unit, length: int) -> None:
    """Checks that an end unit is empty and ends the stream of `length` bytes (spec 5.9). Raises StreamError."""
    if unit.end != unit.begin:
        raise StreamError("TXF-S08", "the end unit has a payload", clause="5.9", offset=unit.begin)
    if unit.stop != length:
        raise StreamError("TXF-S08", "bytes follow the end unit", clause="5.9", offset=unit.stop,
                          value=length - unit.stop, allowed=0)


def read_units(data: bytes, max_file_bytes: int | None = None) -> tuple[list[Unit], list[Unit]]:
    """Splits a stream into units: (units in file order without the end unit, skipped units). data: bytes.

    Raises StreamError for a broken frame, wrong order or trailing bytes, SupportError for another version and for an unknown
    critical unit, LimitError for a stream longer than max_file_bytes.
    """
    check_start(data, max_file_bytes)
    units: list[Unit] = []
    skipped: list[Unit] = []
    seen: set[int] = set()
    view, position = memoryview(data), len(SIGNATURE)
    while True:
        unit, right = read_frame(view, position)
        if not right:
            raise wrong_checksum(unit)
        check_place(unit, seen)
        if not seen:
            check_version(view, unit)
        seen.add(unit.type)
        position = unit.stop
        if unit.type == UNIT_END:
            check_end(unit, len(data))
            return units, skipped
        (skipped if is_passed_over(view, unit) else units).append(unit)
