"""OFF -> Scene: text files of the Geomview family with colours of vertices or faces, polygons of any size.

Own code rather than trimesh, which leaves colours out and fans polygons.
"""

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..report import plural
from ..scene.scene import Material, Scene
from .colour_range import unit_colours
from .parts import Notes, Part, assemble, drop_alpha, linear_rgba, no_triangles
from .polygons import counting, parse_numbers, triangulate

_HEADER = re.compile(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b", re.IGNORECASE)


def read_off(data: bytes, folder: Path, notes: Notes) -> Scene:
    """bytes of an .off file -> Scene. folder: not needed, an OFF names no file. Errors: TXF-I23."""
    data = re.sub(rb"#[^\r\n]*", b"", bytes(data))
    header = _HEADER.match(data)
    has_uv, has_color, has_normal, four, many = (bool(mark) for mark in header.groups()) if header else (False,) * 5
    if four or many or b"BINARY" in data[:40].upper():
        raise _bad("only text with three coordinates is supported", value=data[:20].decode("latin-1").strip())
    lines = [line for line in data[header.end() if header else 0 :].splitlines() if line.strip()]
    counts = parse_numbers(lines[0], np.float64) if lines else None
    if counts is None or len(counts) < 2 or not (np.isfinite(counts).all() and (counts == np.floor(counts)).all()):
        raise _bad("the line of counts is missing")
    vertices, faces = int(counts[0]), int(counts[1])
    if vertices < 0 or faces < 0 or 1 + vertices + faces > len(lines):
        raise _bad("it has fewer lines than its counts", value=len(lines), allowed=1 + vertices + faces)
    if not vertices or not faces:
        raise no_triangles((plural(vertices, "point", "points") + " without faces") * bool(vertices))
    table = _table(lines[1 : 1 + vertices])
    corners, sizes, face_color = _faces(lines[1 + vertices : 1 + vertices + faces], notes)
    triangles, polygon = triangulate(table[:, :3], corners, sizes, notes)
    color = _vertex_color(table, has_color, has_normal, has_uv, notes)
    if color is None and face_color is not None:
        color = np.repeat(face_color[polygon][:, None], 3, axis=1)
    elif face_color is not None:
        notes.drop("face colours (the vertices have colours too)")
    drop_alpha(color, notes)
    normal = table[:, 3:6] if has_normal and table.shape[1] >= 6 else None
    part = Part(table[:, :3], corners[triangles], color=color, label="the OFF file", normal=normal)
    return assemble([part], [Material("default")], [], notes)


def _bad(what, **details):
    return InputError("TXF-I23", f"the OFF file is malformed: {what}", **details)


def _table(lines):
    """Vertex lines -> float64 [V, columns]; all are as long as the first."""
    values, columns = parse_numbers(b" ".join(lines), np.float64), len(lines[0].split())
    if values is None or columns < 3 or len(values) != columns * len(lines):
        raise _bad("a vertex line cannot be read")
    return values.reshape(-1, columns)


def _faces(lines, notes):
    """(int64 [C] vertex of each corner, int64 [P] corners per face, float32 linear RGBA [P, 4] or None)."""
    widths = np.array([len(line.split()) for line in lines])
    values = parse_numbers(b" ".join(lines), np.float64)
    if values is None or len(values) != widths.sum():
        raise _bad("a face line cannot be read")
    starts = np.cumsum(widths) - widths
    sizes = np.where(np.isfinite(values[starts]), values[starts], -1)
    rest = widths - 1 - sizes
    if (sizes < 0).any() or (sizes != np.floor(sizes)).any() or (rest < 0).any():
        raise _bad("a face line is shorter than its count", face=int(np.argmax((sizes < 0) | (rest < 0))))
    sizes, rest = sizes.astype(np.int64), rest.astype(np.int64)
    found = values[np.repeat(starts + 1, sizes) + counting(sizes)]
    corners = np.where(np.isfinite(found) & (np.abs(found) < 2**53), found, -1).astype(np.int64)
    if (rest == 1).any():
        notes.drop("indices into a colour map")
    if ((rest == 2) | (rest > 4)).any():
        notes.remark("numbers after the corners of faces are left out")
    colored = (rest == 3) | (rest == 4)
    if not colored.any():
        return corners, sizes, None
    coded = np.full((len(lines), 4), np.nan)
    for column in range(4):
        rows = np.flatnonzero(colored & (rest > column))
        coded[rows, column] = values[starts[rows] + 1 + sizes[rows] + column]
    unit = unit_colours(coded, notes, "colours of faces")
    return corners, sizes, linear_rgba(np.where(np.isnan(coded), 1.0, unit))


def _vertex_color(table, has_color, has_normal, has_uv, notes):
    """float32 linear RGBA [V, 4] or None. Columns stand in the order position, normal, colour, texture coordinates."""
    at = 3 + (3 if has_normal else 0)
    last = table.shape[1] - (2 if has_uv else 0)
    if has_uv:
        notes.remark("texture coordinates are left out: an OFF file has no texture")
    columns = last - at
    if not has_color:
        if columns > 0:
            notes.remark(f"{columns} numbers after the position of each vertex are left out")
        return None
    if columns not in (3, 4):
        raise _bad("a vertex line has no colour of three or four numbers", value=columns)
    return linear_rgba(unit_colours(table[:, at:last], notes, "colours of vertices"))
