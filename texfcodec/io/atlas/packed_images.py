"""Images of several channels of a field, packed as glTF requires by channels.PACKED_IMAGES."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ...scene.channels import BY_NAME, PACKED_IMAGES, channel_over
from ...scene.factors import FLAT
from ...scene.srgb import to_bytes
from .fill_uncovered import fill_uncovered
from .texel_image import texel_support

if TYPE_CHECKING:
    from ...texf import Texf


def packed_images_of(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Return the channels that share an image, a tuple for each image that any of `names` needs, beside that of base colour.
    names: channel names of materials; a tuple holds those of them alone, in glTF's order."""
    wanted = set(names)
    return [tuple(name for name in packed if name in wanted) for packed in PACKED_IMAGES[1:] if wanted & set(packed)]


def packed_texel_image(texf: Texf, number: int, packed: tuple[str, ...], texels: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the image that channels of a field over texels share, uint8 [H, W, 3], or [H, W, 4] if a channel is in alpha.

    number: of the field; packed: names of the channels, an entry of packed_images_of(); texels: centres of the columns and rows
    of the base colour's image, in texels of the full image, float64 [W] and [H]. If every channel is coarser by a power of two,
    so is the image. Texels that no face refers to continue the values beside them.
    """
    part = texf.fields[number]
    columns, rows = _thinned(part, packed, *texels)
    support = texel_support(part)
    if support.has_centres(columns, rows) and not any(part.shifts.get(name, 0) for name in packed):
        image = support.image(packed_texels({name: part.planes[name] for name in packed}))
        return _filled(image, support.rank >= 0, packed)
    shift = support.level_shift
    referenced = support.rank[np.ix_(_cells(rows, shift, support.size[1]), _cells(columns, shift, support.size[0]))] >= 0
    row, column = np.nonzero(referenced)
    places = np.column_stack([columns[column], rows[row]])
    values = {name: texel_support(part, name).query(places, part.planes[name], texf.threads) for name in packed}
    image = np.zeros((*referenced.shape, 4), np.uint8)
    image[row, column] = packed_texels(values)
    return _filled(image, referenced, packed)


def _filled(image, referenced, packed):
    """The image without alpha if no channel is in it, texels filled that no face refers to."""
    image = image if any(3 in BY_NAME[name].columns for name in packed) else np.ascontiguousarray(image[..., :3])
    fill_uncovered(image, referenced)
    return image


def _cells(centres, shift, size):
    return np.minimum(centres.astype(np.int64) >> shift, size - 1)


def _thinned(part, packed, columns, rows):
    """Centres of the columns and rows of a packed image. columns, rows: those of the base colour's image."""
    shift = min(part.shifts.get(name, 0) for name in packed)
    if shift and not len(columns) % (1 << shift) and not len(rows) % (1 << shift):
        return tuple(line.reshape(-1, 1 << shift).mean(axis=1) for line in (columns, rows))
    return columns, rows


def packed_texels(values: dict[str, np.ndarray]) -> np.ndarray:
    """Return texels of an image that channels share, uint8 [N, 4], each channel in its columns and 255 elsewhere. values: uint8
    or float32 [N, C] in 0..255 by channel name of materials; normals are in tangent space."""
    out = np.full((len(next(iter(values.values()))), 4), 255, np.uint8)
    for name, value in values.items():
        channel = channel_over(name, planar=True)
        if channel.unit == "degrees":
            out[:, :3] = _normals_by_byte()[value[:, 0], value[:, 1]] if value.dtype == np.uint8 else to_bytes(with_z(value))
        else:
            out[:, list(channel.columns)] = value if value.dtype == np.uint8 else to_bytes(value)
    return out


@cache
def _normals_by_byte():
    """Texels of normal maps by red and green, uint8 [256, 256, 3]."""
    xy = np.stack(np.meshgrid(*[np.arange(256, dtype=np.float32)] * 2, indexing="ij"), axis=-1)
    return to_bytes(with_z(xy.reshape(-1, 2))).reshape(256, 256, 3)


def with_z(xy: np.ndarray) -> np.ndarray:
    """Return RGB texels of a tangent-space normal map, float32 [N, 3]. xy: its red and green, float32 [N, 2] in 0..255; blue, the
    z of a unit normal, follows by clause 8.5."""
    flat = xy / np.float32(FLAT) - 1
    length = np.sqrt(np.maximum((flat**2).sum(axis=1, keepdims=True), 1))
    flat = flat / length
    z = np.sqrt(np.maximum(1 - (flat**2).sum(axis=1, keepdims=True), 0))
    return (np.concatenate([flat, z], axis=1) + 1) * np.float32(FLAT)
