"""Triangles from PLY's strips, which Stanford's and MeshLab's files have, and from range grids of scanners."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..report import plural

if TYPE_CHECKING:
    from .parts import Notes

_JUMP = 8.0  # times the usual edge of a range grid; a longer one joins what the scanner saw in front with what is behind


def strip_triangles(values: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return the triangles int64 [F, 3] of triangle strips. values: their vertex indices, strip after strip; lengths: number of
    indices in each of the file's lists. A negative index, or the largest of an unsigned type, ends a strip and begins another.
    Every second triangle of a strip is reversed; triangles that use a vertex twice are left out."""
    indices = _restarts_negative(np.asarray(values))
    starts = np.zeros(len(indices) + 1, bool)
    starts[np.cumsum(lengths) - lengths] = True
    strip = np.cumsum(starts[:-1] | (indices < 0))
    if len(indices) < 3:
        return np.zeros((0, 3), np.int64)
    rows = np.flatnonzero((strip[:-2] == strip[2:]) & (indices[:-2] >= 0))  # only the first of a strip may be negative
    first = np.searchsorted(strip, strip[rows], "left")
    first += indices[first] < 0
    odd = (rows - first) % 2
    triangles = np.stack([indices[rows + odd], indices[rows + 1 - odd], indices[rows + 2]], axis=1)
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _restarts_negative(values):
    if values.dtype.kind == "f":
        return np.where(np.isfinite(values) & (np.abs(values) < 2**53), values, -1).astype(np.int64)
    restart = values == np.iinfo(values.dtype).max if values.dtype.kind == "u" else np.zeros(len(values), bool)
    return np.where(restart, -1, values.astype(np.int64))


def grid_triangles(points: np.ndarray, indices: np.ndarray, lengths: np.ndarray, comments: list[str], notes: Notes) -> np.ndarray:
    """Return the triangles int64 [F, 3] of a range grid: up to two between four neighbours, facing the scanner along +z.

    points: [V, 3]; indices, lengths: values and lengths of its lists, which hold a vertex or nothing; comments: obj_info of the
    header, which gives the numbers of columns and rows. Triangles with edges far longer than the median are jumps in depth and
    are left out, with a remark.
    """
    info = {words[0]: int(words[1]) for text in comments if len(words := text.split()) == 2 and words[1].isdigit()}
    width, height = info.get("num_cols", 0), info.get("num_rows", 0)
    lengths = np.asarray(lengths)
    if width < 1 or width * height != len(lengths) or (lengths > 1).any():
        notes.lose("range grid (of unknown size)", "a range grid without its num_cols and num_rows is left out")
        return np.zeros((0, 3), np.int64)
    flat = np.full(len(lengths), -1, np.int64)
    flat[lengths == 1] = indices
    grid = np.where((flat < 0) | (flat >= len(points)), -1, flat).reshape(height, width)
    a, b, c, d = (corner.reshape(-1) for corner in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]))
    whole = (a >= 0) & (d >= 0)
    faces = np.concatenate([np.stack(rows, axis=1)[chosen] for rows, chosen in (
        ((a, b, d), whole & (b >= 0)), ((a, d, c), whole & (c >= 0)),
        ((a, b, c), (a >= 0) & (b >= 0) & (c >= 0) & (d < 0)), ((b, d, c), (a < 0) & (b >= 0) & (c >= 0) & (d >= 0)))])
    return _towards_z(points, _without_jumps(points, faces, notes))


def _without_jumps(points, faces, notes):
    corners = np.asarray(points, np.float64)[faces]
    longest = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1) if len(faces) else np.zeros(0)
    kept = ~(longest > _JUMP * np.median(longest)) if len(faces) else np.zeros(0, bool)
    if not kept.all():
        notes.remark(plural(int((~kept).sum()), "triangle", "triangles") + " across jumps in depth left out")
    return faces[kept]


def _towards_z(points, faces):
    corners = np.asarray(points, np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.where((normal[:, 2] < 0)[:, None], faces[:, [0, 2, 1]], faces)
