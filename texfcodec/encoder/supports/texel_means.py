"""Means over texels of values at the corners of faces (encoder only)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.kernel import kernel
from ...field.morton import decode_morton
from ...field.texel_set import _edge_columns, _rows_of, referenced_texels
from ...scene.fetch import _wrapped
from ...scene.scene import WRAP_CLAMP

MOST_VISITS = 1 << 27  # of texels by faces, a few seconds


@kernel
def _add_corners(uv, values, shares, fraction, wrap_s, wrap_t, rank, total):
    """Add to total, float64 [T, 2 C + 1], the share of every face times its values at the centre of each texel that it covers,
    times their squares, and the share itself in the last column.

    uv: int64 [N, 3, 2] in steps below MAX_UV of field.texel_set; values: float64 [N, 3, C] of the corners; shares: float64 [N];
    rank: int32 [height, width], rows of total, -1 for texels without one.
    """
    height, width = rank.shape
    columns = min(values.shape[2], (total.shape[1] - 1) // 2)
    half = np.int64(1) << fraction
    for f in range(uv.shape[0]):
        ax, ay, bx, by, cx, cy = (2 * uv[f, 0, 0], 2 * uv[f, 0, 1], 2 * uv[f, 1, 0], 2 * uv[f, 1, 1], 2 * uv[f, 2, 0],
                                  2 * uv[f, 2, 1])
        whole = float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
        top, bottom = _rows_of(min(ay, by, cy), max(ay, by, cy), fraction)
        for row in range(top, bottom + 1):
            low, high = 2 * half * row - half, 2 * half * (row + 1) + half
            first0, last0 = _edge_columns(ax, ay, bx, by, low, high, half)
            first1, last1 = _edge_columns(bx, by, cx, cy, low, high, half)
            first2, last2 = _edge_columns(cx, cy, ax, ay, low, high, half)
            y = 2 * half * row + half
            first, last = min(first0, first1, first2), max(last0, last1, last2)
            if wrap_s == WRAP_CLAMP:  # what lies beyond the border counts once, as in field.texel_set
                first, last = min(max(first, 0), width - 1), min(max(last, 0), width - 1)
            for column in range(first, last + 1):
                place = rank[_wrapped(row, height, wrap_t), _wrapped(column, width, wrap_s)]
                if place < 0 or place >= total.shape[0]:
                    continue
                x = 2 * half * column + half
                b, c = 1 / 3, 1 / 3
                if whole != 0:
                    b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / whole
                    c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / whole
                b, c = min(max(b, 0.0), 1.0), min(max(c, 0.0), 1.0)
                a = max(1 - b - c, 0.0)
                for k in range(columns):
                    value = (a * values[f, 0, k] + b * values[f, 1, k] + c * values[f, 2, k]) / (a + b + c)
                    total[place, k] += shares[f] * value
                    total[place, columns + k] += shares[f] * value * value
                total[place, 2 * columns] += shares[f]


class TexelMeans(NamedTuple):
    """Texels that some faces show. texel: int64 [T], flat indices into the image; mean: float64 [T, C], of their values, by area;
    spread: float64 [T, C], mean of the squared differences from it; area: float64 [T]."""

    texel: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    area: np.ndarray


def texel_means(uv: np.ndarray, values: np.ndarray, area: np.ndarray, fraction_bits: int, size: tuple[int, int],
               wrap: tuple[int, int]) -> TexelMeans:
    """Return the mean, over each texel of an image that faces show, of values interpolated between the faces' corners.

    Parameters
    ----------
    uv : int64 [N, 3, 2]
        Of the faces, in steps of 2**-fraction_bits texels.
    values : float64 [N, 3, C]
        Of their corners, interpolated between them.
    area : float64 [N]
        Of the faces; a face spreads it evenly over the texels that it covers.
    size, wrap : (int, int)
        (width, height) of the image; its modes.

    Returns
    -------
    TexelMeans
        Empty if the faces cover more than MOST_VISITS texels: an image that repeats so often has no use for means.
    """
    columns = values.shape[2]
    u, v = ((uv[:, corner] - uv[:, 0]).astype(np.float64) for corner in (1, 2))
    texels = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2 / 4.0**fraction_bits
    if texels.sum() > MOST_VISITS:
        return TexelMeans(np.zeros(0, np.int64), np.zeros((0, columns)), np.zeros((0, columns)), np.zeros(0))
    faces = np.arange(3 * len(uv)).reshape(-1, 3)
    referenced = decode_morton(referenced_texels(uv.reshape(-1, 2), faces, fraction_bits, size, wrap))
    flat = referenced[:, 1].astype(np.int64) * size[0] + referenced[:, 0]
    rank = np.full((size[1], size[0]), -1, np.int32)
    rank.reshape(-1)[flat] = np.arange(len(flat), dtype=np.int32)
    total = np.zeros((len(flat), 2 * columns + 1))
    shares = area / np.maximum(texels, 1.0)
    _add_corners(np.ascontiguousarray(uv), np.ascontiguousarray(values, np.float64), shares, fraction_bits, *wrap, rank, total)
    shown = total[:, -1] > 0
    flat, total = flat[shown], total[shown]
    mean, square = np.split(total[:, :-1] / total[:, -1:], 2, axis=1)
    return TexelMeans(flat, mean, np.maximum(square - mean**2, 0.0), total[:, -1])
