"""Texels of normal maps in another frame: the mean of what all faces that show a texel need (encoder only)."""

from __future__ import annotations

import numpy as np

from ...core.kernel import kernel
from ...field.morton import decode_morton
from ...field.texel_set import _edge_columns, _rows_of, asked_texels, shown_area
from ...scene.factors import FLAT
from ...scene.fetch import _wrapped
from ...scene.scene import WRAP_CLAMP
from ..texel_field import FULL_BITS

COLUMNS = 10  # of a sum: a matrix and its weight
MOST_VISITS = 1 << 27  # of texels by faces, a few seconds: images that repeat more often stay as they are


@kernel
def _add_matrices(uv, matrices, shares, fraction, wrap_s, wrap_t, rank, total):
    """Adds to total, float64 [T, COLUMNS], the share of every face times its matrix at the centre of each texel that it asks.

    uv: int64 [N, 3, 2] in steps below MAX_UV of field.texel_set; matrices: float64 [N, 3, 9] of the corners; shares: float64 [N];
    rank: int32 [height, width], rows of total, -1 where there is none.
    """
    height, width = rank.shape
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
                scale = shares[f] / (a + b + c)
                for k in range(9):
                    total[place, k] += scale * (a * matrices[f, 0, k] + b * matrices[f, 1, k] + c * matrices[f, 2, k])
                total[place, 9] += shares[f]


def mean_matrices(uv: np.ndarray, between: np.ndarray, area: np.ndarray, off: np.ndarray, size: tuple[int, int],
                  wrap: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """What the texels need that some faces show.

    Parameters
    ----------
    uv : int64 [N, 3, 2]
        Of all faces, in steps of 2**-FULL_BITS texels.
    between : float64 [N, 3, 3, 3]
        What each corner of a face needs.
    area : float64 [N]
        Of the faces.
    off : bool [N]
        The faces that need something; the others need the unit matrix.
    size, wrap : (int, int)
        (width, height) of the image; its modes.

    Returns
    -------
    (int64 [T], float64 [T, 3, 3])
        Texels as flat indices into the image, and the mean, by area, of what all faces that show each need. None where the faces
        go over more than MOST_VISITS texels.
    """
    steps, corners = uv[off].reshape(-1, 2), np.arange(3 * int(off.sum())).reshape(-1, 3)
    texels = _areas(uv[off]) / 4.0**FULL_BITS
    if texels.sum() > MOST_VISITS:
        return np.zeros(0, np.int64), np.zeros((0, 3, 3))
    asked = decode_morton(asked_texels(steps, corners, FULL_BITS, size, wrap))[:, :2].astype(np.int64)
    flat = asked[:, 1] * size[0] + asked[:, 0]
    rank = np.full((size[1], size[0]), -1, np.int32)
    rank.reshape(-1)[flat] = np.arange(len(flat), dtype=np.int32)
    total = np.zeros((len(flat), COLUMNS))
    shares = area[off] / np.maximum(texels, 1.0)
    _add_matrices(np.ascontiguousarray(uv[off]), np.ascontiguousarray(between[off].reshape(-1, 3, 9)), shares, FULL_BITS, *wrap,
                  rank, total)
    others = uv[~off].reshape(-1, 2)
    right = shown_area(others, np.arange(len(others)).reshape(-1, 3), FULL_BITS, size, wrap, area[~off]).reshape(-1)[flat, None]
    weight = total[:, 9:] + right
    shown = weight[:, 0] > 0
    return flat[shown], ((total[:, :9] + right * np.eye(3).ravel())[shown] / weight[shown]).reshape(-1, 3, 3)


def _areas(uv):
    """Of faces in squares of steps, float64 [N]."""
    u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return np.abs(u[:, 0].astype(np.float64) * v[:, 1] - u[:, 1].astype(np.float64) * v[:, 0]) / 2


def turned_texels(texels: np.ndarray, matrices: np.ndarray, scale: float) -> np.ndarray:
    """Tangent-space normals in other frames.

    Parameters
    ----------
    texels : float32 [T, 2]
        x and y, 0..255; z follows from length 1.
    matrices : float64 [T, 3, 3]
        From the old frame into the new.
    scale : float
        Of the map, glTF's normalTexture.scale, which stays.

    Returns
    -------
    float64 [T, 3]
        Whole numbers in 0..255, of length 1 as directions. A normal that would point inwards lies in the plane.
    """
    xy = texels.astype(np.float64) / FLAT - 1
    normal = np.column_stack([scale * xy, np.sqrt(np.maximum(1 - (xy**2).sum(axis=1), 0.0))])
    normal = np.einsum("nij,nj->ni", matrices, normal)
    normal[:, 2] = np.maximum(normal[:, 2], 0.0)
    normal[:, :2] /= scale or 1.0
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    return np.clip(np.rint((normal + 1) * FLAT), 0, 255)
