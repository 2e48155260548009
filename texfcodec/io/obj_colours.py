"""Colours of vertices in OBJ files, which the format does not define. Most tools write them behind the coordinates, ZBrush and
Meshmixer in comments ("#MRGB" and "#vcolor")."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..report import plural
from .colour_range import unit_colours
from .parts import drop_alpha, linear_rgba
from .polygons import parse_numbers

if TYPE_CHECKING:
    from .parts import Notes

MRGB, VCOLOR = b"#MRGB", b"#vcolor"
_DIGITS = 8  # of a vertex in an MRGB block: mask, red, green, blue
_WHAT = "colours of vertices"


def vertex_colours_of(vertices: np.ndarray, comments: list[tuple[int, bytes]], notes: Notes) -> np.ndarray | None:
    """Return the colours of an OBJ's vertices, float32 linear RGBA [V, 4], white for vertices without a colour; None if no vertex
    has any.

    vertices: float64 [V, columns] of the v statements, NaN where a row is shorter; comments: (v statements before it, text) of
    each comment that holds colours, in file order.
    """
    coded = _behind(vertices, notes)
    if coded is None:
        coded = _in_comments(comments, len(vertices), notes)
    elif comments:
        notes.remark("colours in comments of the OBJ file are left out: its vertices have colours of their own")
    if coded is None:
        return None
    color = linear_rgba(np.where(np.isnan(coded).all(axis=1)[:, None], 1.0, coded))
    drop_alpha(color, notes)
    return color


def _behind(vertices, notes):
    """sRGB-coded [V, 3 or 4] behind x y z, NaN in rows without, or None. Seven numbers are x y z r g b a, or x y z w r g b if the
    fourth is always 1 and the last varies."""
    columns = vertices.shape[1]
    if columns < 6:
        if columns > 3 and (np.nan_to_num(vertices[:, 3:], nan=1.0) != 1.0).any():
            notes.drop("weights of vertices (OBJ statement 'v')")
        return None
    rest = vertices[:, 3:]
    present = ~np.isnan(rest[:, 2])
    if columns >= 8:
        notes.drop(f"numbers of vertices from the eighth on (OBJ statement 'v', {columns} numbers)")
    if columns == 7 and (rest[present, 0] == 1).all() and np.ptp(np.nan_to_num(rest[present, 3], nan=1.0)) > 0:
        rest = rest[:, 1:]
    elif columns >= 7:
        rest = rest[:, :4].copy()
        rest[present & np.isnan(rest[:, 3]), 3] = _opaque(rest[present])
    out = np.full((len(rest), rest.shape[1]), np.nan)
    out[present] = unit_colours(rest[present], notes, _WHAT)
    return out


def _opaque(rows):
    return 255.0 if np.nanmax(rows[:, 3], initial=0.0) > 2.0 else 1.0


def _in_comments(comments, count, notes):
    """sRGB-coded [V, 3] from comments, NaN for vertices without, or None. A block of MRGB lines colours the vertices after those
    of the previous block. A vcolor line colours the vertex before it; if all lines follow the vertices, line n colours vertex
    n."""
    if not comments:
        return None
    out = np.full((count, 3), np.nan)
    hexes, numbers = (_rows(comments, mark) for mark in (MRGB, VCOLOR))
    extra = _polypaint(hexes, out) if hexes else _numbered(numbers, out, notes)
    left = int(np.isnan(out).all(axis=1).sum())
    if extra is None:
        notes.lose("colours in comments of the OBJ file (not readable)",
                   "colours in comments of the OBJ file cannot be read; vertices are white")
        return None
    if extra or left:
        notes.lose("some colours in comments of the OBJ file (their number differs from that of vertices)",
                   f"colours in comments of the OBJ file do not match its vertices: {plural(left, 'vertex is', 'vertices are')} "
                   f"white, {plural(extra, 'colour is', 'colours are')} left out")
    return out


def _rows(comments, mark):
    return [(before, text[len(mark) :].strip()) for before, text in comments if text.startswith(mark)]


def _polypaint(rows, out):
    """Write the colours of MRGB lines into out. Returns the number of colours without a vertex, or None if a line is not
    hexadecimal."""
    start, extra = 0, 0
    blocks: dict[int, list[bytes]] = {}
    for before, text in rows:
        blocks.setdefault(before, []).append(text[: len(text) // _DIGITS * _DIGITS])
    for before, texts in blocks.items():
        try:
            bytes_of = np.frombuffer(bytes.fromhex(b"".join(texts).decode("ascii")), np.uint8)
        except ValueError:
            return None
        rgb = bytes_of.reshape(-1, 4)[:, 1:] / 255.0
        end = min(start + len(rgb), before if len(blocks) > 1 else len(out), len(out))
        out[start:end] = rgb[: max(end - start, 0)]
        extra, start = extra + len(rgb) - max(end - start, 0), max(before, end) if len(blocks) > 1 else end
    return extra


def _numbered(rows, out, notes):
    """Read vcolor lines as _polypaint() does its own; None if a line is not numbers."""
    values = parse_numbers(b" ".join(text for _, text in rows), np.float64)
    if values is None or len(values) not in (3 * len(rows), 4 * len(rows)):
        return None
    rgb = unit_colours(values.reshape(len(rows), -1), notes, _WHAT)[:, :3]
    places = np.array([before for before, _ in rows]) - 1
    if len(np.unique(places)) < len(places):
        places = np.arange(len(rows))
    inside = (places >= 0) & (places < len(out))
    out[places[inside]] = rgb[inside]
    return int((~inside).sum())
