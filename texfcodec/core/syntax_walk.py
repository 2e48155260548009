"""Reads, writes and describes any structure of a syntax table: three walkers over core/syntax_table.py."""

import struct
from typing import Any

from ..errors import StreamError, SupportError
from .syntax_table import V_MAX, Derived, Element, Structure

_FIXED = {"u8": "<B", "u16": "<H", "u32": "<I", "i8": "<b", "i32": "<i", "f32": "<f", "f64": "<d"}

REALS = {"f32": (2 - 2**-23) * 2.0**127, "f64": 1e300}  # largest magnitude of a real number


def write_v(value: int) -> bytes:
    """Unsigned LEB128, shortest form (spec 4.3)."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


class Reader:
    """A bounded view of the stream. data: bytes; [position, end): the readable range; base: file offset of data[0]."""

    def __init__(self, data: bytes | memoryview, position: int, end: int, base: int = 0) -> None:
        self.data, self.position, self.end, self.base = data, position, end, base

    def take(self, count: int, name: str, clause: str) -> bytes | memoryview:
        """Return the next `count` bytes and move past them. name, clause: of the element, for the StreamError TXF-S02 that it
        raises if there are fewer."""
        if count > self.end - self.position:
            raise StreamError("TXF-S02", f"the data ends inside {name}", clause=clause, offset=self.base + self.position,
                              value=self.end - self.position, allowed=f">= {count} bytes")
        begin = self.position
        self.position += count
        return self.data[begin : self.position]

    def read_v(self, name: str, clause: str) -> int:
        """Return the next number coded as write_v() does. name, clause: of the element. Raises StreamError TXF-S02, TXF-S05."""
        value = 0
        for i in range(8):
            byte = self.take(1, name, clause)[0]
            value |= (byte & 0x7F) << (7 * i)
            if byte < 0x80:
                if byte == 0 and i > 0:
                    break
                return value
        raise StreamError("TXF-S05", f"{name} is not a shortest-form variable-length number", clause="4.3",
                          offset=self.base + self.position)


def _count_of(element, values):
    if element.count is None:
        return None
    return int(element.count) if element.count.isdigit() else values[element.count]


def _check_fits(element, count, reader, clause):
    """Checks that the bytes that are left can hold all elements of an array, before the first of them is read (spec 4.3)."""
    kind = element.descriptor
    least = kind.least if isinstance(kind, Structure) else struct.calcsize(_FIXED.get(kind, "B"))
    if count * least > reader.end - reader.position:
        raise StreamError("TXF-S02", f"the data ends inside {element.name}", clause=clause,
                          offset=reader.base + reader.position, value=reader.end - reader.position,
                          allowed=f">= {count * least} bytes")


def check_range(element: Element, value: Any, offset: int | None, clause: str) -> None:
    """Raise StreamError TXF-S04 if a value is outside its element's range, SupportError TXF-U09 if it is above the range of a
    registry. offset, clause: where the value stands in the file and in the specification, for the error."""
    low, high = element.low, element.high
    if element.registry and high is not None and value > high:
        raise SupportError("TXF-U09", f"this version does not know the value of {element.name}", clause=clause,
                           offset=offset, value=value, allowed=f"<= {high}")
    if (low is not None and not value >= low) or (high is not None and value > high):
        allowed = f"{low}..{'' if high is None else high}"
        raise StreamError("TXF-S04", f"{element.name} is out of range", clause=clause, offset=offset, value=value,
                          allowed=allowed)


def _read_scalar(element, reader, clause):
    offset = reader.base + reader.position
    kind = element.descriptor
    if kind == "v":
        value = reader.read_v(element.name, clause)
    else:
        fmt = _FIXED[kind]
        (value,) = struct.unpack(fmt, reader.take(struct.calcsize(fmt), element.name, clause))
        if kind in REALS and not abs(value) <= REALS[kind]:
            raise StreamError("TXF-S04", f"{element.name} is not a finite number in range", clause=clause, offset=offset)
    check_range(element, value, offset, clause)
    return value


def _read_blob(element, reader, count, clause):
    offset = reader.base + reader.position
    raw = reader.take(reader.end - reader.position if count is None else count, element.name, clause)
    if element.descriptor == "bytes":
        return raw
    try:
        return bytes(raw).decode("utf-8")
    except UnicodeDecodeError:
        raise StreamError("TXF-S06", f"{element.name} is not valid UTF-8", clause=clause, offset=offset) from None


def read_structure(structure: Structure, reader: Reader, values: dict, trace: list | None = None, prefix: str = "") -> dict:
    """Read one structure at the reader's position. values: dict of the variables known so far; it is extended in place and
    returned.

    trace: list that receives (name, file offset, size in bytes, value) of every element; prefix: put before these names.
    """
    for element in structure.elements:
        if isinstance(element, Derived):
            values[element.name] = element.value(values)
            continue
        if element.when and not element.when[1](values):
            values[element.name] = [] if element.count else None
            continue
        begin, count = reader.position, _count_of(element, values)
        name = prefix + element.name
        if count is not None:
            _check_fits(element, count, reader, structure.clause)
        if isinstance(element.descriptor, Structure):
            items = []
            for i in range(count):
                inner = dict(values)
                if element.each:
                    inner.update(element.each(values, i))
                read_structure(element.descriptor, reader, inner, trace, f"{name}[{i}].")
                items.append({e.name: inner[e.name] for e in element.descriptor.elements})
            values[element.name] = items
            continue
        if element.descriptor in ("bytes", "utf8"):
            value = _read_blob(element, reader, count, structure.clause)
        elif count is None:
            value = _read_scalar(element, reader, structure.clause)
        else:
            value = [_read_scalar(element, reader, structure.clause) for _ in range(count)]
        values[element.name] = value
        if trace is not None:
            shown = f"{len(value)} bytes" if element.descriptor == "bytes" else value
            trace.append((name, reader.base + begin, reader.position - begin, shown))
    return values


def _write_scalar(element, value, clause):
    check_range(element, value, None, clause)
    if element.descriptor == "v":
        if not 0 <= value <= V_MAX:
            raise ValueError(f"{element.name} = {value} does not fit its descriptor")
        return write_v(int(value))
    return struct.pack(_FIXED[element.descriptor], value)


def _check_length(element, values):
    """Checks that an array is as long as its count; the length of a string is in UTF-8 bytes."""
    count = _count_of(element, values)
    if count is not None:
        value = values[element.name]
        length = len(value.encode("utf-8") if isinstance(value, str) else value)
        if length != count:
            raise ValueError(f"{element.name} has {length} entries where its count says {count}")


def write_structure(structure: Structure, values: dict) -> bytes:
    """Bytes of one structure. values: dict with a value for every element; derived variables are computed from them."""
    out = bytearray()
    values = dict(values)
    for element in structure.elements:
        if isinstance(element, Derived):
            values[element.name] = element.value(values)
            continue
        if element.when and not element.when[1](values):
            continue
        _check_length(element, values)
        if isinstance(element.descriptor, Structure):
            for i, item in enumerate(values[element.name]):
                shared = element.each(values, i) if element.each else {}
                out += write_structure(element.descriptor, {**values, **shared, **item})
        elif element.descriptor == "bytes":
            out += values[element.name]
        elif element.descriptor == "utf8":
            out += values[element.name].encode("utf-8")
        elif element.count is None:
            out += _write_scalar(element, values[element.name], structure.clause)
        else:
            for value in values[element.name]:
                out += _write_scalar(element, value, structure.clause)
    return bytes(out)
