"""PLY files, ascii or binary in both byte orders, as tables: {element: {property: numbers}}.

An element whose lists have the same length is read as a structured array; mixed lengths take a Python loop.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from .mtl import decode_text
from .polygons import parse_numbers

_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
          "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
          "double": "f8", "float64": "f8"}
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class _Element:
    """properties: list of (name, dtype letter, count dtype letter or None)."""

    name: str
    count: int
    properties: list = field(default_factory=list)


@dataclass
class PlyHeader:
    """Header of a PLY file. form: one of _ORDERS; textures: names of TextureFile comments; comments: the others, obj_info among
    them; size: bytes."""

    form: str
    elements: list
    textures: list
    comments: list
    size: int


def malformed(what: str, **details: object) -> InputError:
    """Return the error for a PLY file that does not follow its format. what: the message; details: values beside it."""
    return InputError("TXF-I21", f"the PLY file is malformed: {what}", **details)


def read_tables(data: bytes) -> tuple[PlyHeader, dict[str, dict]]:
    """Parse the bytes of a .ply file: (header, {element: {property: array [n], or for lists (values [sum], lengths [n])}}). Names
    are in lower case. Raises InputError TXF-I21."""
    header = _read_header(data)
    return header, _read_elements(data, header)


def _read_header(data):
    end = data.find(b"end_header")
    if end < 0:
        raise malformed("its header has no end")
    stop = data.find(b"\n" if b"\n" in data[:end] else b"\r", end)
    header = PlyHeader("", [], [], [], len(data) if stop < 0 else stop + 1)
    for number, row in enumerate(re.split(rb"\r\n|\n|\r", data[:end]), 1):
        line = decode_text(row)
        words = line.split()
        try:
            if words:
                _header_line(header, words, line)
        except (IndexError, ValueError, KeyError) as error:
            raise malformed("a header line cannot be read", line=number, value=line[:80]) from error
    if header.form not in _ORDERS:
        raise malformed("its format is unknown", value=header.form[:40])
    return header


def _header_line(header, words, line):
    if words[0] == "format":
        header.form = words[1]
    elif words[0] in ("comment", "obj_info"):
        text = line.split(None, 1)[1] if len(words) > 1 else ""
        if len(words) > 2 and words[1].lower() == "texturefile":
            header.textures.append(text.split(None, 1)[1].strip())
        elif text and len(header.comments) < 100:
            header.comments.append(text[:500])
    elif words[0] == "element":
        header.elements.append(_Element(words[1].lower(), int(words[2])))
        if header.elements[-1].count < 0:
            raise ValueError("negative count")
    elif words[0] == "property":
        properties = header.elements[-1].properties
        if words[1] == "list":
            properties.append((words[4].lower(), _TYPES[words[3]], _TYPES[words[2]]))
        else:
            properties.append((words[2].lower(), _TYPES[words[1]], None))


def _read_elements(data, header):
    """{element: {property: array [n], or for lists (values [sum], lengths [n])}}"""
    reader = _Text(data[header.size :]) if header.form == "ascii" else _Binary(data, header.size, _ORDERS[header.form])
    tables = {}
    for element in header.elements:
        if not element.properties:  # would cost no bytes per row, so its count could not be checked
            raise malformed(f"element '{element.name}' has no properties")
        tables[element.name] = reader.uniform(element) or reader.rows(element)
    return tables


class _Binary:
    """Binary body of a PLY file. at: byte position in data; order: byte order, "<" or ">"."""

    def __init__(self, data, at, order):
        self.data, self.at, self.order = data, at, order

    def type_of(self, kind):
        """Stored dtype of a type of the header."""
        return np.dtype(self.order + kind)

    def stored(self, values, kind):
        """Values in their type of the header."""
        return values

    def _take(self, kind, count, element):
        dtype = self.type_of(kind)
        if self.at + count * dtype.itemsize > len(self.data):
            raise malformed(f"it ends within element '{element.name}'", offset=len(self.data))
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def uniform(self, element):
        """The element's table, read as a structured array, if all rows have lists as long as the first row's; else None."""
        fields: list[tuple] = []
        lengths: list[int | None] = []
        at = self.at
        for i, (_, kind, counter) in enumerate(element.properties):
            length = None
            if counter is not None:
                dtype = self.type_of(counter)
                if at + dtype.itemsize > len(self.data):
                    return None
                first = np.frombuffer(self.data, dtype, 1, at)[0]
                if not 0 <= first <= len(self.data):
                    return None
                length = int(first)
                fields.append((f"n{i}", dtype))
                at += dtype.itemsize
            fields.append((f"p{i}", self.type_of(kind)) if length is None else (f"p{i}", self.type_of(kind), (length,)))
            at += self.type_of(kind).itemsize * (1 if length is None else length)
            lengths.append(length)
        size = at - self.at
        if self.at + size * element.count > len(self.data) or not size:
            return None
        block = np.frombuffer(self.data, np.dtype(fields), element.count, self.at)
        if any((block[f"n{i}"] != length).any() for i, length in enumerate(lengths) if length is not None):
            return None
        self.at += size * element.count
        table = {}
        for i, ((name, kind, _), length) in enumerate(zip(element.properties, lengths, strict=True)):
            values = self.stored(block[f"p{i}"] if length is None else block[f"p{i}"].reshape(-1), kind)
            table[name] = values if length is None else (values, np.full(len(block), length))
        return table

    def rows(self, element):
        """The element's table, read row by row, for lists of different lengths."""
        table: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in element.properties}
        for _ in range(element.count):
            for name, kind, counter in element.properties:
                length = 1 if counter is None else int(self._take(counter, 1, element)[0])
                if length < 0:
                    raise malformed("a list has a negative length")
                table[name].append(self._take(kind, length, element))
        out = {}
        for name, kind, counter in element.properties:
            rows = table[name]
            values = self.stored(np.concatenate(rows) if rows else np.zeros(0, kind), kind)
            out[name] = values if counter is None else (values, np.array([len(row) for row in rows], np.int64))
        return out


class _Text(_Binary):
    """Ascii body of a PLY file, with all numbers parsed at once as float64."""

    def __init__(self, body):
        values = parse_numbers(bytes(body), np.float64)
        if values is None:
            raise malformed("its body contains text that is not a number")
        super().__init__(values.view(np.uint8), 0, "<")

    def type_of(self, kind):
        return np.dtype(np.float64)

    def stored(self, values, kind):
        return _stored(values, kind)


def _stored(values, kind):
    """Numbers of an ascii file in their declared type, so that uchar colours are recognised. Numbers out of range stay floats."""
    if kind[0] == "f" or values.dtype.kind != "f":
        return values
    info = np.iinfo(kind)
    inside = np.isfinite(values) & (values >= info.min) & (values <= info.max)
    return values.astype(kind) if inside.all() else values


def indices_of(values: np.ndarray) -> np.ndarray:
    """Return a file's vertex indices, of any type, as int64; invalid numbers become -1, which assemble() refuses."""
    if values.dtype.kind != "f":
        return values.astype(np.int64)
    return np.where(np.isfinite(values) & (np.abs(values) < 2**53), values, -1).astype(np.int64)
