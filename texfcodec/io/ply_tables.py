"""PLY files as tables: {element: {property: numbers}}, of ascii and both binary orders.

An element whose lists all have the same length is read as one structured array; mixed lengths take a Python loop.
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
    """form: one of _ORDERS; textures: names of TextureFile comments; comments: the others, obj_info among them; size: bytes."""

    form: str
    elements: list
    textures: list
    comments: list
    size: int


def malformed(what: str, **details: object) -> InputError:
    """The error for a PLY file that does not follow its format."""
    return InputError("TXF-I21", f"the PLY file is malformed: {what}", **details)


def read_tables(data: bytes) -> tuple[PlyHeader, dict[str, dict]]:
    """bytes of a .ply file -> (its header, {element: {property: array [n], or for lists (values [sum], lengths [n])}}); names are
    in lower case. Errors: TXF-I21."""
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
    is_text = header.form == "ascii"
    reader = _Ascii(data[header.size :]) if is_text else _Binary(data, header.size, _ORDERS[header.form])
    tables = {}
    for element in header.elements:
        if not element.properties:  # would cost no bytes per row, so its count could not be checked
            raise malformed(f"element '{element.name}' has no properties")
        tables[element.name] = reader.read(element)
    return tables


class _Ascii:
    """Every number of the body at once, as float64; elements are cut from it."""

    def __init__(self, body):
        values = parse_numbers(bytes(body), np.float64)
        if values is None:
            raise malformed("its body contains text that is not a number")
        self.values, self.at = values, 0

    def read(self, element):
        if not any(counter for _, _, counter in element.properties):
            block = self._take(element.count * len(element.properties), element)
            block = block.reshape(element.count, -1) if element.count else block.reshape(0, len(element.properties))
            return {name: _stored(block[:, i], kind) for i, (name, kind, _) in enumerate(element.properties)}
        return self._uniform(element) or _read_rows(element, lambda kind, count: self._take(count, element))

    def _take(self, count, element):
        if self.at + count > len(self.values):
            raise malformed(f"it ends within element '{element.name}'", value=len(self.values) - self.at, allowed=count)
        self.at += count
        return self.values[self.at - count : self.at]

    def _uniform(self, element):
        """All rows as long as the first: one reshape. None when they are not."""
        lengths: list[int | None] = []
        width = 0
        for _, _, counter in element.properties:
            if counter is None:
                lengths.append(None)
                width += 1
                continue
            if self.at + width >= len(self.values) or not 0 <= self.values[self.at + width] <= len(self.values):
                return None
            lengths.append(int(self.values[self.at + width]))
            width += 1 + int(self.values[self.at + width])
        if self.at + width * element.count > len(self.values):
            return None
        block = self.values[self.at : self.at + width * element.count].reshape(element.count, width)
        table: dict = {}
        column = 0
        for (name, kind, _), length in zip(element.properties, lengths, strict=True):
            if length is None:
                table[name] = _stored(block[:, column], kind)
                column += 1
                continue
            if (block[:, column] != length).any():
                return None
            values = block[:, column + 1 : column + 1 + length].reshape(-1)
            table[name] = _stored(values, kind), np.full(element.count, length)
            column += 1 + length
        self.at += width * element.count
        return table


class _Binary:
    def __init__(self, data, at, order):
        self.data, self.at, self.order = data, at, order

    def read(self, element):
        return self._uniform(element) or _read_rows(element, lambda kind, count: self._take(kind, count, element))

    def _take(self, kind, count, element):
        dtype = np.dtype(self.order + kind)
        if self.at + count * dtype.itemsize > len(self.data):
            raise malformed(f"it ends within element '{element.name}'", offset=len(self.data))
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def _uniform(self, element):
        """The element as one structured array when every list is as long as in the first row; else None."""
        fields: list[tuple] = []
        lengths: list[int | None] = []
        at = self.at
        for i, (_, kind, counter) in enumerate(element.properties):
            length = None
            if counter is not None:
                dtype = np.dtype(self.order + counter)
                if at + dtype.itemsize > len(self.data):
                    return None
                length = int(np.frombuffer(self.data, dtype, 1, at)[0])
                if not 0 <= length <= len(self.data):
                    return None
                fields.append((f"n{i}", self.order + counter))
                at += dtype.itemsize
            fields.append((f"p{i}", self.order + kind) if length is None else (f"p{i}", self.order + kind, (length,)))
            at += np.dtype(kind).itemsize * (1 if length is None else length)
            lengths.append(length)
        size = at - self.at
        if self.at + size * element.count > len(self.data) or not size:
            return None
        block = np.frombuffer(self.data, np.dtype(fields), element.count, self.at)
        if any((block[f"n{i}"] != length).any() for i, length in enumerate(lengths) if length is not None):
            return None
        self.at += size * element.count
        return {name: block[f"p{i}"] if lengths[i] is None else (block[f"p{i}"].reshape(-1), np.full(len(block), lengths[i]))
                for i, (name, _, _) in enumerate(element.properties)}


def _read_rows(element, take):
    """Row by row, for lists of different lengths. take: (dtype letter, count) -> the next values."""
    table: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in element.properties}
    for _ in range(element.count):
        for name, kind, counter in element.properties:
            length = 1 if counter is None else int(take(counter, 1)[0])
            if length < 0:
                raise malformed("a list has a negative length")
            table[name].append(take(kind, length))
    out = {}
    for name, kind, counter in element.properties:
        rows = table[name]
        values = np.concatenate(rows) if rows else np.zeros(0, kind)
        values = _stored(values, kind)
        out[name] = values if counter is None else (values, np.array([len(row) for row in rows], np.int64))
    return out


def _stored(values, kind):
    """Numbers of an ascii file in their declared type, so that uchar colours are recognised; large ones stay floats."""
    if kind[0] == "f" or values.dtype.kind != "f":
        return values
    info = np.iinfo(kind)
    inside = np.isfinite(values) & (values >= info.min) & (values <= info.max)
    return values.astype(kind) if inside.all() else values


def indices_of(values: np.ndarray) -> np.ndarray:
    """Vertex indices as int64; what is no index becomes -1, which assemble refuses."""
    if values.dtype.kind != "f":
        return values.astype(np.int64)
    return np.where(np.isfinite(values) & (np.abs(values) < 2**53), values, -1).astype(np.int64)
