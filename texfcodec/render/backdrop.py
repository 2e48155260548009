"""Backgrounds of pictures for people, and the assets that need light to show more than their outline.

Metrics and refinements have conditions of their own, which nothing here changes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..geometry.areas import relative_areas, sample_surface
from ..scene.fetch import pack_source, sample_source
from ..scene.scene import Scene
from .textures import with_finite_uvs

if TYPE_CHECKING:
    from ..texf import Texf

Colour = tuple[int, int, int]
Background = Colour | tuple[Colour, Colour]  # one colour, or those of the top and of the bottom row
GREY: Background = ((150, 150, 150), (104, 104, 104))  # white and black stand off from it, and a grey from one of its ends
FEW = 8  # colours up to which a surface shows no shape
NEAR = 4  # coded levels within which two colours are one: what coding does to a constant is less
MOST_OTHERS = 0.02  # share of the surface that may have other colours: where two of a few meet, coding mixes them
POINTS = 4096


def rows(background: Background, height: int) -> np.ndarray:
    """Return a background as rows of pixels, a gradient from top to bottom if it has two colours.

    Parameters
    ----------
    background : (r, g, b) or pair of those
        One colour, or those of the top and of the bottom row; 0..255.
    height : int
        Number of rows.

    Returns
    -------
    uint8 [height, 1, 3]
        From the top row down.
    """
    ends, share = np.array(background, np.float64).reshape(-1, 3), np.linspace(0, 1, height)[:, None, None]
    return np.rint(ends[0] * (1 - share) + ends[-1] * share).astype(np.uint8)


def is_nearly_uniform(asset: Scene | Texf) -> bool:
    """Return whether the base colour has no more than FEW colours, so that a picture without light shows an outline and no shape.

    Parameters
    ----------
    asset : Scene or Texf
        Any.

    Returns
    -------
    bool
        False for an asset without a surface.
    """
    areas = relative_areas(asset.positions, asset.faces)
    if not areas.any() or not (isinstance(asset, Scene) or asset.fields):
        return False
    return has_few_colours(_colours(asset, *sample_surface(asset.positions, asset.faces, POINTS, areas=areas)))


def _colours(asset, face, bary):
    """float32 [M, 3] at points of faces."""
    if isinstance(asset, Scene):
        return sample_source(with_finite_uvs(pack_source(asset)), face, bary)[:, :3]
    points = np.einsum("mk,mkc->mc", bary, asset.positions[asset.faces[face]])
    return asset.query(points, face)[:, :3]


def has_few_colours(colours: np.ndarray) -> bool:
    """Return whether at most FEW colours cover all but a share of MOST_OTHERS.

    Parameters
    ----------
    colours : float or uint8 [M, 3]
        0..255; NaN counts as 0.

    Returns
    -------
    bool
        Colours within NEAR of each other count as one.
    """
    left = np.rint(np.nan_to_num(colours)).astype(np.int64)
    most = MOST_OTHERS * len(left)
    for _ in range(FEW):
        if len(left) <= most:
            break
        distinct, count = np.unique(left, axis=0, return_counts=True)
        left = left[(np.abs(left - distinct[count.argmax()]) > NEAR).any(axis=1)]
    return len(left) <= most
