"""The image and the UVs of a field over texels. Texels that the surface refers to keep their values; the others are filled from
them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...field.texels import TexelSupport
from ...scene.channels import BASE_COLOUR
from ...scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR
from ...scene.srgb import to_bytes
from .fill_uncovered import fill_uncovered
from .system import BLOCK

if TYPE_CHECKING:
    from ...texf import Field, Texf


def texel_support(part: Field, name: str = BASE_COLOUR.name) -> TexelSupport:
    """Return where a channel has values in a field over texels: the support of its plane. name: of the channel."""
    support = part.support_of(name)
    assert isinstance(support, TexelSupport), "the field is over voxels"
    return support


def texel_image(texf: Texf, number: int) -> np.ndarray:
    """Return the decoded image of field `number`, which is over texels: uint8 [H, W, 3], or [H, W, 4] if any alpha is below 255.

    texf: decoded stream (Texf). Colours are sRGB-coded, alpha is straight, row 0 is at v = 0. Texels that no face refers to
    continue the colours beside them, in the blocks that mip levels average. Blocks end at the border of the image, so that this
    holds for every wrap mode.
    """
    support = texel_support(texf.fields[number])
    return _filled(texf, number, support.image(texf.fields[number].rgba), support.rank >= 0)


def texel_image_and_uv(texf: Texf, number: int) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the image of field `number`, with the UVs for it: (image as of texel_image(); UVs of the field's faces in it,
    float64 [F, 3, 2], v downwards (glTF); (centres of its columns float64 [W], of its rows float64 [H]), in texels of the full
    image).

    If levels were left out that do not divide the full image evenly, the last decoded texels extend beyond its border. If every
    face is within a tile of the image, UVs are scaled to leave that excess out. Otherwise the image is written at the nearest
    finer level that ends with the full image, and the UVs stay.
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
    """Number of times that each side of the full image can be halved evenly, at most to the level at hand: (x, y)."""
    return tuple(min(support.level_shift, (side & -side).bit_length() - 1) for side in (support.width, support.height))


def _ends_evenly(texel, side, extent, wrap):
    """Return whether UVs along an axis can refer to an image of `extent` texels in place of `side`; see texel_image_and_uv()."""
    if extent == side:
        return True
    first = 0 if wrap == WRAP_CLAMP else np.floor(texel.min(axis=1) / side)
    return bool((texel.max(axis=1) <= (first + 1) * side).all())


def _shares(texel, side, extent, wrap):
    """UVs along an axis, float64 [F, 3], of places in the full image, for tiles of `extent` texels in place of `side`."""
    if extent == side:
        return texel / side
    tile = np.zeros((len(texel), 1)) if wrap == WRAP_CLAMP else np.floor(texel.min(axis=1, keepdims=True) / side)
    share = (texel - tile * side) / extent
    backwards = (wrap == WRAP_MIRROR) & (tile % 2 == 1)
    return tile + np.where(backwards, 1 - side / extent + share, share)


def _finer(part, shifts, threads):
    """(image uint8 [H, W, 4] of the nearest finer level that ends with the full image, whether any face refers to each texel,
    bool [H, W]); other texels are 0."""
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
    """The image, uint8 [H, W, 4], with colours and alpha filled in texels that no face refers to; [H, W, 3] if alpha is always
    255. referenced: bool [H, W]."""
    if (texf.fields[number].rgba[:, 3] == 255).all():
        image = np.ascontiguousarray(image[..., :3])
        fill_uncovered(image, referenced)
        return image
    filled = image.copy()
    fill_uncovered(filled[..., 3:], referenced)
    visible = referenced & (image[..., 3] > 0) if _sees_alpha(texf, number) else referenced
    fill_uncovered(filled[..., :3], visible if visible.any() else referenced)
    return np.where(referenced[..., None], image, filled)


def _sees_alpha(texf, number):
    """Return whether every material of a field uses alpha."""
    modes = [texf.materials[i].alpha_mode for i in np.unique(texf.face_material[texf.face_field == number])]
    return ALPHA_OPAQUE not in modes
