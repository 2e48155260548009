"""STL -> Scene: binary and text, corners at the same place become one vertex, colours of facets where a dialect has them.

Own code rather than trimesh, which keeps three vertices a facet and knows neither dialect of colours.
"""

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..report import plural
from ..scene.scene import Material, Scene
from .mtl import decode_text
from .parts import Notes, Part, assemble, linear_rgba, no_triangles
from .polygons import parse_numbers

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_ODD = np.uint64(0x9E3779B97F4A7C15)  # a multiplier that spreads the bits of a number
_NORMALS = "normals of facets are left out: the corners give them too"
_START = 84  # 80 bytes of header, 4 of count
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_NORMAL = re.compile(rb"\bnormal\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_SOLID = re.compile(rb"^\s*solid\b[ \t]*(.*?)\s*$", re.IGNORECASE | re.MULTILINE)


def read_stl(data: bytes, folder: Path, notes: Notes) -> Scene:
    """bytes of an .stl file -> Scene. folder: not needed, an STL names no file. Errors: TXF-I23."""
    if _is_binary(data):
        corners, color, metadata = _read_binary(data, notes)
    else:
        corners, color, metadata = _read_text(data, notes)
    if not len(corners):
        raise no_triangles()
    points, faces = weld(corners.reshape(-1, 3))
    part = Part(points, faces.reshape(-1, 3), color=color, label="the STL file")
    return assemble([part], [Material("default")], [], notes, metadata)


def weld(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows [n, 3] -> (distinct rows, int64 [n] row of each): an STL and its like name no shared vertices."""
    rows = np.ascontiguousarray(points + np.zeros((), points.dtype))  # -0 becomes 0, which is the same place
    bits = rows.view(f"u{rows.itemsize}")
    first, number = _distinct(bits, _hashes(bits))
    order = np.argsort(first)  # vertices in order of first use
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rows[first[order]].astype(np.float64), rank[number]


def _hashes(bits):
    """A hash of each row, uint64 [n]. bits: unsigned [n, 3]."""
    x, y, z = bits.astype(np.uint64).T
    mixed = ((x * _ODD + y) * _ODD + z) * _ODD
    return mixed ^ mixed >> np.uint64(29)


def _distinct(bits, hashes):
    """(number of the first of each distinct row, which of those each row is), both int64. Numbers sort in a third of the time
    that rows take; where the hashes of different rows are equal, the rows are sorted after all."""
    order = np.argsort(hashes)
    new = np.diff(hashes[order], prepend=~hashes[order[:1]]) != 0
    number = np.empty(len(bits), np.int64)
    number[order] = np.cumsum(new) - 1
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    if (bits == bits[first[number]]).all():
        return first, number
    keys = bits.view(np.dtype((np.void, bits.itemsize * 3))).reshape(-1)
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def _bad(what, **details):
    return InputError("TXF-I23", f"the STL file is malformed: {what}", **details)


def _is_binary(data):
    """The count fits the length, whatever the header says; many binary files begin with "solid" too."""
    if len(data) >= _START and len(data) == _START + _FACET.itemsize * int.from_bytes(data[80:84], "little"):
        return True
    return data[:512].lstrip()[:5].lower() != b"solid"


def _read_binary(data, notes):
    if len(data) < _START:
        raise _bad("it ends within its header", value=len(data), allowed=_START)
    count = int.from_bytes(data[80:84], "little")
    needed = _START + count * _FACET.itemsize
    if needed > len(data):
        raise _bad("it ends before its last facet", value=len(data), allowed=needed)
    if needed < len(data):
        notes.remark(plural(len(data) - needed, "byte", "bytes") + " after the last facet, ignored")
    facets = np.frombuffer(data, _FACET, count, _START)
    if facets["normal"].any():
        notes.remark(_NORMALS)
    return facets["corners"], _facet_color(bytes(data[:80]), facets["attribute"], notes), {}


def _facet_color(header, attribute, notes):
    """float32 linear RGBA [F, 3, 4] or None: 5 bits a channel, in the order of the Magics or of the VisCAM dialect."""
    place = header.find(b"COLOR=")
    magics = 0 <= place <= 70
    own = (attribute >> 15 == 0) if magics else (attribute >> 15 == 1)
    if not magics and not own.any():
        if attribute.any():
            notes.drop("attribute bytes of facets")
        return None
    channels = np.stack([attribute >> shift & 31 for shift in ((0, 5, 10) if magics else (10, 5, 0))], axis=1) / 31.0
    whole = np.frombuffer(header[place + 6 : place + 10], np.uint8) / 255.0 if magics else np.ones(4)
    coded = np.where(own[:, None], np.pad(channels, ((0, 0), (0, 1)), constant_values=1.0), whole)
    if magics and header.find(b"MATERIAL=") >= 0:
        notes.drop("MATERIAL of the STL header")
    return np.repeat(linear_rgba(coded)[:, None], 3, axis=1)


def _read_text(data, notes):
    vertices = _VERTEX.findall(data)
    values = parse_numbers(b" ".join(b" ".join(row) for row in vertices), np.float64)
    if values is None or len(values) != 3 * len(vertices):
        raise _bad("a vertex is not three numbers")
    lower = bytes(data).lower()
    facets = lower.count(b"endfacet")
    if len(vertices) != 3 * facets or lower.count(b"endsolid") == 0:
        raise _bad("it ends early, or a facet does not have three vertices", value=len(vertices), allowed=3 * facets)
    if any(float(number) for row in _NORMAL.findall(data)[:1] for number in row if _is_number(number)):
        notes.remark(_NORMALS)
    names = [decode_text(name)[:500] for name in _SOLID.findall(data) if name][:1000]
    return values.reshape(-1, 3, 3), None, {"solids": names} if names else {}


def _is_number(text):
    return parse_numbers(text, np.float64) is not None
