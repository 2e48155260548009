"""Appearance of a decoded mesh without images: colours at vertices, and the splitting of shared vertices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..scene.channels import BY_NAME, CORNER_MAPS, PARAMETER_BY_NAME
from ..scene.factors import linear_values
from ..scene.srgb import srgb_to_linear

if TYPE_CHECKING:
    from ..texf import Texf


def unique_corners(*keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge corners that agree in every key; the first key is the outermost order of the result.

    keys: integer [N] each. Returns (first int64 [U]: a corner of each merged vertex; index int64 [N]: merged vertex of each
    corner).
    """
    order = np.lexsort(keys[1::-1])  # most corners at a vertex agree in the other keys too: few are sorted by them
    new = _differ(keys[:2], order)
    run = np.cumsum(new) - 1
    mixed = np.zeros(len(order), bool)
    mixed[run[_differ(keys[2:], order) & ~new]] = True
    some = np.flatnonzero(mixed[run])
    part = order[some]
    part = part[np.lexsort([*(key[part] for key in keys[:1:-1]), run[some]])]
    order[some] = part
    new[some] |= _differ(keys[2:], part)
    index = np.empty(len(order), np.int64)
    index[order] = np.cumsum(new) - 1
    return order[new], index


def _differ(keys, order):
    """Return whether each corner differs from the one before it in any key, bool [n]; the first does. order: int64 [n]."""
    new = np.zeros(len(order), bool)
    new[:1] = True
    for key in keys:
        ranked = key[order]
        new[1:] |= ranked[1:] != ranked[:-1]
    return new


def vertex_colours(texf: Texf, with_material: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the colours of a decoded stream at its vertices, splitting those where fields or, with_material, materials meet.

    Returns (vertex int64 [U] into texf.positions, of each split vertex; index int64 [F, 3] of the faces into those; material
    int64 [U], rgba float32 [U, 4] 0..255 sRGB-coded, straight alpha).
    """
    corner = texf.faces.ravel()
    fields, materials = np.repeat(texf.face_field, 3), np.repeat(texf.face_material, 3)
    outer = materials if with_material else np.zeros_like(materials)
    first, index = unique_corners(outer, corner, fields)
    vertex = corner[first]
    rgba = np.zeros((0, 4), np.float32)
    if len(first):
        rgba = np.asarray(texf.query(np.ascontiguousarray(texf.positions[vertex]), first // 3), np.float32)
    return vertex, index.reshape(-1, 3), materials[first], rgba


def vertex_maps(texf: Texf, vertex: np.ndarray, index: np.ndarray) -> dict[str, np.ndarray]:
    """Return further channels of a decoded stream at its split vertices, float32 [U, C] by channel: linear, 0..1, with factors,
    as io.corner_maps reads them. vertex, index: of vertex_colours()."""
    face = np.empty(len(vertex), np.int64)
    face[index.ravel()] = np.repeat(np.arange(len(index)), 3)
    names = sorted({name for part in texf.fields for name in part.planes} & CORNER_MAPS)
    out = {name: np.ones((len(vertex), BY_NAME[name].components), np.float32) for name in names}
    for number, part in enumerate(texf.fields):
        rows, held = np.flatnonzero(texf.face_field[face] == number), [name for name in names if name in part.planes]
        if len(rows) and held:
            values = texf.query_planes(number, held, np.ascontiguousarray(texf.positions[vertex[rows]]), face[rows])
            for name in held:
                out[name][rows] = linear_values(name, np.asarray(values[name], np.float32))
    for name, channel in ((name, BY_NAME[name]) for name in names if BY_NAME[name].parameter in PARAMETER_BY_NAME):
        default = PARAMETER_BY_NAME[channel.parameter].default
        factors = np.array([material.parameters.get(channel.parameter, default) for material in texf.materials], np.float32)
        out[name] *= np.clip(factors, 0, 1)[texf.face_material[face]]
    return out


def linear_u16(rgba: np.ndarray) -> np.ndarray:
    """Convert colours to those of glTF's COLOR_0, linear normalised uint16 [N, 4]. rgba: sRGB-coded 0..255, float or uint8;
    alpha is only rescaled."""
    if rgba.dtype == np.uint8:
        table = linear_u16(np.repeat(np.arange(256, dtype=np.float64)[:, None], 4, 1))
        out = table[:, 0][rgba]
        out[:, 3] = rgba[:, 3].astype(np.uint16) * 257
        return out
    unit = np.clip(np.nan_to_num(rgba.astype(np.float64)), 0.0, 255.0) / 255.0
    unit[:, :3] = srgb_to_linear(unit[:, :3])
    return np.rint(unit * 65535.0).astype(np.uint16)
