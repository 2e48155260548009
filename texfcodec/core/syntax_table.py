"""Syntax tables and their elements. The reader, the writer, texf-info and the tables of the specification all walk over them.

Descriptors: u8 u16 u32 f32 f64 (little endian), i8, i32, v (unsigned LEB128, at most 8 bytes), bytes (the rest of the payload, or
`count` bytes), utf8 (`count` bytes). A Derived entry computes a named variable from earlier values; it takes no bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

V_MAX = (1 << 56) - 1


@dataclass(frozen=True)
class Element:
    """One syntax element. low/high: allowed range; count: None for a scalar, else the name of a value (array length); when:
    (text, function of the values) or None; each: for an array of structures, function (values, index) -> variables for item
    `index`; registry: a later specification may assign a meaning to numbers above the range (spec 4.3)."""

    name: str
    descriptor: str | Structure
    low: int | None = None
    high: int | None = None
    count: str | None = None
    when: tuple[str, Callable[[dict], bool]] | None = None
    each: Callable[[dict, int], dict] | None = None
    registry: bool = False


@dataclass(frozen=True)
class Derived:
    """A variable computed while reading: its text for the specification, and a function of the values read so far."""

    name: str
    text: str
    value: Callable[[dict], int | bool]


@dataclass(frozen=True)
class Structure:
    """A syntax structure: its name and clause in the specification, its elements in stream order, and the fewest bytes that it
    takes, where it is counted (spec 4.3)."""

    name: str
    clause: str
    elements: tuple[Element | Derived, ...]
    least: int = 0
