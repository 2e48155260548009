"""The image of a field over texels, as it came: texels that the surface asks keep their values, the rest is filled from them.

A Texf stands in a later room, so that signatures here say Any.
"""

from typing import Any

import numpy as np

from ..scene import ALPHA_OPAQUE
from .bake import BLOCK, fill_gaps, to_bytes


def texel_image(texf: Any, number: int) -> np.ndarray:
    """The image of field `number`, one over texels: uint8 [H, W, 3], or [H, W, 4] where its alpha is not 255 throughout.

    texf: decoded stream (Texf). Colour sRGB-coded, straight alpha, row 0 at v = 0. UVs in texels of the full image, divided by
    its (width, height), are UVs of this one at every level of detail: see _whole_levels. Texels that no face asks carry on the
    colours beside them, in the blocks that mip levels average; blocks end at the border of the image, so that this is right for
    every wrap mode.
    """
    part = texf.fields[number]
    image, asked = _at_hand(part, texf.threads)
    if (part.rgba[:, 3] == 255).all():
        image = np.ascontiguousarray(image[..., :3])
        fill_gaps(image, asked)
        return image
    filled = image.copy()
    fill_gaps(filled[..., 3:], asked)
    visible = asked & (image[..., 3] > 0) if _sees_alpha(texf, number) else asked
    fill_gaps(filled[..., :3], visible if visible.any() else asked)
    return np.where(asked[..., None], image, filled)


def _sees_alpha(texf, number):
    """Whether every material of a field is one that alpha can hide."""
    modes = [texf.materials[i].alpha_mode for i in np.unique(texf.face_material[texf.face_field == number])]
    return ALPHA_OPAQUE not in modes


def _whole_levels(side, levels):
    """As many of the left-out levels as divide a side of the full image evenly.

    Where one does not, the last texel at hand reaches over the border of the full image, and an image of such texels would need
    other UVs, which cannot be where faces wrap around. So the image is written as fine as the nearest level that ends with it."""
    return min(levels, (side & -side).bit_length() - 1)


def _at_hand(part, threads):
    """The image uint8 [H, W, 4] of a field, 0 where no face asks, and which texels any asks, bool [H, W]."""
    support, rank = part.support, part.support.rank
    shift = support.level_shift
    across, down = _whole_levels(support.width, shift), _whole_levels(support.height, shift)
    if (across, down) == (shift, shift):
        return support.image(part.rgba), rank >= 0
    width, height = support.width >> across, support.height >> down
    asked = rank[np.ix_((np.arange(height) << down) >> shift, (np.arange(width) << across) >> shift)] >= 0
    image = np.zeros((height, width, 4), np.uint8)
    rows = max(BLOCK // width, 1)
    for top in range(0, height, rows):
        row, column = np.nonzero(asked[top : top + rows])
        row += top
        texel = np.column_stack([(column + 0.5) * (1 << across), (row + 0.5) * (1 << down)])
        image[row, column] = to_bytes(support.query(texel, part.rgba, threads))
    return image, asked
