"""Colours at vertices in place of an image, if they show a field as well as an image would.

A stream does not state whether its colours came from an image or from vertices. So colours are fitted to the vertices and
compared with the field between them. Measured at r01 and r03: fits to fields from vertices have 43.8 to 47.7 dB of RGB, for which
an atlas has 46 to 57; fits to fields from images have 24.9 to 33.3 dB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..scene.srgb import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from ..texf import Texf

FIRST = 20_000  # points that settle most fields
POINTS = (100_000, 1_000_000)  # least and most points of the fit
PER_FACE = 4
ROUNDS = 4  # two more gain less than 0.1 dB
LEAST_AT_FIRST = 28.0  # dB before the fit, which gains 2 to 3
LEAST = 42.0  # dB
NO_LESS = 36.0  # dB before the fit from which colours at vertices show all of a field that came from them
TAIL = (0.999, 32.0)  # levels that so many of the points stay within: small print on a large face has hardly a part in the mean


@dataclass
class VertexColours:
    """Colours of face corners. rgba: float64 [U, 4], 0..255, sRGB-coded, straight alpha; index: int64 [n, 3] into rgba, for every
    face; psnr: dB of RGB between the colours, interpolated in linear light as in viewers, and the field."""

    rgba: np.ndarray
    index: np.ndarray
    psnr: float


def fit_vertex_colours(texf: Texf, faces: np.ndarray) -> VertexColours | None:
    """Return least-squares colours at the corners of faces, whose interpolation comes closest to the field; None if an image
    would show more detail. texf: decoded stream
    (Texf); faces: int64 [n]."""
    area = _areas(texf, faces)
    if not len(faces) or not area.sum() > 0:
        return None
    rgba, index = _at_corners(texf, faces)
    psnr, _ = _error(_residual(rgba, *_sampled(texf, faces, index, area, FIRST)))
    if psnr < LEAST_AT_FIRST:
        return None
    count = min(max(PER_FACE * len(faces), POINTS[0]), POINTS[1])
    corners, weights, shown = _sampled(texf, faces, index, area, count)
    for _ in range(ROUNDS):
        rgba = _closer(rgba, corners, weights, _residual(rgba, corners, weights, shown))
    psnr, tail = _error(_residual(rgba, corners, weights, shown))
    return VertexColours(rgba, index, psnr) if psnr >= LEAST and tail <= TAIL[1] else None


def psnr_at_vertices(texf: Texf) -> float | None:
    """Return the PSNR in dB of RGB between the field of a decoded stream (Texf) and its values at the vertices, blended across
    faces; None without faces that have area."""
    faces = np.arange(len(texf.faces))
    area = _areas(texf, faces)
    if not len(faces) or not area.sum() > 0:
        return None
    rgba, index = _at_corners(texf, faces)
    return float(_error(_residual(rgba, *_sampled(texf, faces, index, area, FIRST)))[0])


def _at_corners(texf, faces):
    """(values of the field at corners, float64 [U, 4]; index into them, int64 [n, 3])."""
    corner = texf.faces[faces].ravel()
    _, first, index = np.unique(corner * len(texf.fields) + np.repeat(texf.face_field[faces], 3), return_index=True,
                                return_inverse=True)
    rgba = np.asarray(texf.query(np.ascontiguousarray(texf.positions[corner[first]]), faces[first // 3]), np.float64)
    return rgba, index.reshape(-1, 3)


def _areas(texf, faces):
    """Areas of faces as shares of the cube's side squared, float64 [n]."""
    place = (texf.positions - texf.origin) / (texf.side or 1.0)
    a, b, c = (place[texf.faces[faces, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _sampled(texf, faces, index, area, count):
    """Points evenly distributed on the faces: (corners int64 [M, 3] into rgba, weights float64 [M, 3], colours [M, 4])."""
    total = np.cumsum(area)
    face = np.searchsorted(total, (np.arange(count) + 0.5) * (total[-1] / count)).clip(0, len(faces) - 1)
    turn = np.random.default_rng(0).random((count, 2))
    root = np.sqrt(turn[:, 0])
    weights = np.column_stack([1 - root, root * (1 - turn[:, 1]), root * turn[:, 1]])
    points = np.einsum("mk,mkc->mc", weights, texf.positions[texf.faces[faces[face]]])
    return index[face], weights, np.asarray(texf.query(points, faces[face]), np.float64)


def _residual(rgba, corners, weights, shown):
    """The field's values minus interpolated colours, float64 [M, 4]; colour is weighted by alpha."""
    light = np.column_stack([srgb_to_linear(rgba[:, :3] / 255), rgba[:, 3] / 255])
    between = np.einsum("mk,mkc->mc", weights, light[corners])
    off = shown - 255 * np.column_stack([linear_to_srgb(between[:, :3]), between[:, 3]])
    off[:, :3] *= shown[:, 3:] / 255
    return np.nan_to_num(off)


def _error(off):
    """(PSNR in dB, the lower of colour and alpha; the TAIL quantile of errors, in levels)."""
    mean = max(float((off[:, :3] ** 2).mean()), float((off[:, 3] ** 2).mean()), 1e-6)
    return 10 * np.log10(255**2 / mean), float(np.quantile(np.abs(off).max(axis=1), TAIL[0]))


def _closer(rgba, corners, weights, off):
    """Every colour moved by the weighted mean of the residuals around it."""
    flat, count = corners.ravel(), len(rgba)
    total = np.bincount(flat, weights.ravel(), count)
    moved = [np.bincount(flat, (weights * off[:, c : c + 1]).ravel(), count) for c in range(4)]
    return np.clip(rgba + np.column_stack(moved) / np.maximum(total, 1e-9)[:, None], 0, 255)
