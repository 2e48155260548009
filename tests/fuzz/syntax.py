"""Two more walkers over the syntax tables: one draws a legal structure from choices, one bends elements of what was read.

What is bent is framed again with right lengths and checksums, so that it reaches the code behind them.
"""

import struct
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from fuzz.choices import ODD_NUMBERS, ODD_REALS, Choices, edited
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import SIGNATURE, UNIT_END, structures
from texfcodec.bitstream.units import write_unit
from texfcodec.core.syntax_table import V_MAX, Derived, Structure
from texfcodec.core.syntax_walk import write_v
from texfcodec.limits import Limits

SIZES = {"u8": 8, "u16": 16, "u32": 32, "i8": 8, "i32": 32}
UNLIMITED = Limits(**dict.fromkeys(Limits.__dataclass_fields__))
MOST_ITEMS = 70  # of a drawn array: the largest count that a table allows without another table is 64


def draw(structure: Structure, choices: Choices, values: dict, given: dict) -> dict:
    """Adds legal values of a structure to those known. given: by element name a value, or a function of (values, choices), for
    what a range cannot say."""
    for element in structure.elements:
        if isinstance(element, Derived):
            values[element.name] = element.value(values)
        elif element.when and not element.when[1](values):
            values[element.name] = [] if element.count else None
        elif element.name in given:
            told = given[element.name]
            values[element.name] = told(values, choices) if callable(told) else told
        else:
            values[element.name] = _drawn(element, choices, values, given)
    return values


def _drawn(element, choices, values, given):
    count = None if element.count is None else int(element.count) if element.count.isdigit() else values[element.count]
    if element.descriptor == "bytes":
        return choices.filled(count) if count is not None else choices.take(choices.whole(0, 200))
    if element.descriptor == "utf8":
        return "".join(chr(97 + byte % 26) for byte in choices.filled(count))
    if not isinstance(element.descriptor, Structure):
        one = lambda: _scalar(element, choices)
        return one() if count is None else [one() for _ in range(min(count, MOST_ITEMS))]
    items = []
    for i in range(min(count, MOST_ITEMS)):
        inner = draw(element.descriptor, choices, {**values, **(element.each(values, i) if element.each else {})}, given)
        items.append({part.name: inner[part.name] for part in element.descriptor.elements})
    return items


def _scalar(element, choices):
    if element.descriptor in ("f32", "f64"):
        return (choices.whole(0, 255) - (0 if element.low == 0 else 128)) / 16
    low, high = _range_of(element)
    return choices.near(low, high)


def _range_of(element):
    """The smallest and the largest number that an element may be."""
    bits = SIZES.get(element.descriptor, 56)
    signed = element.descriptor[0] == "i"
    low = element.low if element.low is not None else (-(1 << bits - 1) if signed else 0)
    high = element.high if element.high is not None else ((1 << bits - signed) - 1 if bits < 56 else V_MAX)
    return low, high


@lru_cache(maxsize=1)
def elements() -> dict:
    """Every element of every table by name; those that share a name are alike."""
    return {element.name: element for one in structures() for element in one.elements if not isinstance(element, Derived)}


def encoded(descriptor: str, value: Any) -> bytes:
    """Bytes of a number whether it is in range or not; what does not fit is cut."""
    if descriptor == "v":
        return write_v(max(value, 0))
    if descriptor in ("f32", "f64"):
        with_range = value if descriptor == "f64" or value != value or abs(value) < 3e38 or abs(value) == float("inf") else 0.0
        return struct.pack("<f" if descriptor == "f32" else "<d", with_range)
    bits = SIZES[descriptor]
    return (value % (1 << bits)).to_bytes(bits // 8, "little")


def bend(payload: bytes, rows: list, choices: Choices, most: int = 2) -> bytes:
    """The payload with one element, or up to `most`, that says something else. rows: (name, offset in the payload, size, value)
    of its elements, as readers trace them."""
    chosen = {choices.whole(0, len(rows) - 1) for _ in range(choices.whole(1, most))} if rows else ()
    for at in sorted(chosen, reverse=True):  # from the back, so that the other offsets stay right
        name, offset, size, value = rows[at]
        raw = payload[offset : offset + size]
        payload = payload[:offset] + _other(name.rpartition(".")[2], raw, value, choices) + payload[offset + size :]
    return payload


def _other(name, raw, value, choices):
    """Other bytes for an element."""
    element = elements()[name]
    if element.descriptor in ("bytes", "utf8") or choices.flag(6):
        return edited(raw, choices)
    if not isinstance(value, list):
        return encoded(element.descriptor, _other_number(element, value, choices))
    values = list(value)
    if values:
        values[choices.whole(0, len(values) - 1)] = _other_number(element, values[0], choices)
    return b"".join(encoded(element.descriptor, one) for one in values)


def _other_number(element, value, choices):
    if element.descriptor in ("f32", "f64"):
        return choices.pick(ODD_REALS)
    low, high = _range_of(element)
    kind = choices.whole(0, 4)
    if kind == 0:
        return choices.pick((low, low + 1, high, high - 1))
    if kind == 1:
        return choices.pick((low - 1, high + 1))
    if kind == 2:
        return value + choices.whole(0, 4) - 2
    return choices.near(low, high) if kind == 3 else choices.pick(ODD_NUMBERS)


def framed(units: Iterable[tuple[int, bytes]]) -> bytes:
    """A stream of (type, payload), with an end."""
    return SIGNATURE + b"".join(write_unit(kind, bytes(payload)) for kind, payload in units) + write_unit(UNIT_END, b"")


@lru_cache(maxsize=256)
def traced(data: bytes) -> list:
    """Units of a stream in its order: (type, payload, rows of its elements with offsets in the payload)."""
    trace: list = []
    read_stream(data, UNLIMITED, trace)
    relative = lambda unit, rows: [(name, offset - unit.begin, size, value) for name, offset, size, value in rows]
    return [(unit.type, data[unit.begin : unit.end], relative(unit, rows)) for unit, rows in trace]


def bent_stream(data: bytes, choices: Choices, kinds: tuple, most: int = 2) -> bytes:
    """A stream with one unit of these kinds bent under right checksums, or as it is where it has none."""
    units = traced(data)
    places = [i for i, (kind, _, _) in enumerate(units) if kind in kinds]
    if not places:
        return data
    at = choices.pick(places)
    bent = bend(*units[at][1:], choices, most)
    return framed((kind, bent if i == at else payload) for i, (kind, payload, _) in enumerate(units))
