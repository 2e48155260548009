"""The image and the UVs of a field over texels, as they came: texels that the surface asks keep their values, the rest is filled
from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...field.texels import TexelSupport
from ...scene.channels import BASE_COLOUR
from ...scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR
from ...scene.srgb import to_bytes
from .gaps import fill_gaps
from .system import BLOCK

if TYPE_CHECKING:
    from ...texf import Field, Texf


def texel_support(part: Field, name: str = BASE_COLOUR.name) -> TexelSupport:
    """The support of a channel's plane in a field that is over texels."""
    support = part.support_of(name)
    assert isinstance(support, TexelSupport), "the field is over voxels"
    return support


def texel_image(texf: Texf, number: int) -> np.ndarray:
    """The texels at hand of field `number`, one over texels: uint8 [H, W, 3], or [H, W, 4] where its alpha is not 255 throughout.

    texf: decoded stream (Texf). Colour sRGB-coded, straight alpha, row 0 at v = 0. Texels that no face asks carry on the colours
    beside them, in the blocks that mip levels average; blocks end at the border of the image, so that this is right for every
    wrap mode.
    """
    support = texel_support(texf.fields[number])
    return _filled(texf, number, support.image(texf.fields[number].rgba), support.rank >= 0)


def texel_image_and_uv(texf: Texf, number: int) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """An image as texel_image() gives it, the UVs of the field's faces in it, float64 [F, 3, 2], v downwards (glTF), and where
    the centres of its columns and rows are, float64 [W] and [H], in texels of the full image.

    Where levels were left out and do not divide the full image evenly, its last texels at hand reach over its border.
    Faces that lie within one tile of the image each get UVs that stop short of these; where one does not, the image is written
    as fine as the nearest level that ends with the full image, and the UVs stay.
    """
    support = texel_support(texf.fields[number])
    texel, full = texf.uv[texf.faces[texf.face_field == number]], (support.width, support.height)
    extent = [side << support.level_shift for side in support.size]
    axes = [(texel[..., k], full[k], extent[k], support.wrap[k]) for k in range(2)]
    if all(_ends_evenly(*axis) for axis in axes):
        uv = np.stack([_shares(*axis) for axis in axes], axis=-1)
        return texel_image(texf, number), uv, tuple(_centres(size, support.level_shift) for size in support.size)
    shifts = _even_shifts(support)
    image = _filled(texf, number, *_finer(texf.fields[number], shifts, texf.threads))
    return image, texel / full, (_centres(image.shape[1], shifts[0]), _centres(image.shape[0], shifts[1]))


def _centres(count, shift):
    return (np.arange(count) + 0.5) * (1 << shift)


def _even_shifts(support):
    """Levels by which both sides of the full image can be halved, down to those at hand."""
    return tuple(min(support.level_shift, (side & -side).bit_length() - 1) for side in (support.width, support.height))


def _ends_evenly(texel, side, extent, wrap):
    """Whether UVs can be given in an image of `extent` texels in place of `side`: see texel_image_and_uv()."""
    if extent == side:
        return True
    first = 0 if wrap == WRAP_CLAMP else np.floor(texel.min(axis=1) / side)
    return bool((texel.max(axis=1) <= (first + 1) * side).all())


def _shares(texel, side, extent, wrap):
    """UVs along one axis, float64 [F, 3], of texels in the full image, in tiles of `extent` texels in place of `side`."""
    if extent == side:
        return texel / side
    tile = np.zeros((len(texel), 1)) if wrap == WRAP_CLAMP else np.floor(texel.min(axis=1, keepdims=True) / side)
    share = (texel - tile * side) / extent
    backwards = (wrap == WRAP_MIRROR) & (tile % 2 == 1)
    return tile + np.where(backwards, 1 - side / extent + share, share)


def _finer(part, shifts, threads):
    """Image uint8 [H, W, 4] of the nearest finer level that ends with the full image, 0 where no face asks, and which texels any
    asks, bool [H, W]."""
    support, shift = part.support, part.support.level_shift
    across, down = shifts
    width, height = support.width >> across, support.height >> down
    referenced = support.rank[np.ix_((np.arange(height) << down) >> shift, (np.arange(width) << across) >> shift)] >= 0
    image = np.zeros((height, width, 4), np.uint8)
    rows = max(BLOCK // width, 1)
    for top in range(0, height, rows):
        row, column = np.nonzero(referenced[top : top + rows])
        row += top
        texel = np.column_stack([(column + 0.5) * (1 << across), (row + 0.5) * (1 << down)])
        image[row, column] = to_bytes(support.query(texel, part.rgba, threads))
    return image, referenced


def _filled(texf, number, image, referenced):
    """The image, uint8 [H, W, 4], with colours and alpha where it is not asked, without alpha where that says nothing."""
    if (texf.fields[number].rgba[:, 3] == 255).all():
        image = np.ascontiguousarray(image[..., :3])
        fill_gaps(image, referenced)
        return image
    filled = image.copy()
    fill_gaps(filled[..., 3:], referenced)
    visible = referenced & (image[..., 3] > 0) if _sees_alpha(texf, number) else referenced
    fill_gaps(filled[..., :3], visible if visible.any() else referenced)
    return np.where(referenced[..., None], image, filled)


def _sees_alpha(texf, number):
    """Whether every material of a field is one that alpha can hide."""
    modes = [texf.materials[i].alpha_mode for i in np.unique(texf.face_material[texf.face_field == number])]
    return ALPHA_OPAQUE not in modes
