"""Transparent faces: layers of the surface, front to back, composited into one colour per pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..scene.scene import ALPHA_BLEND, ALPHA_MASK, Material
from .raster import Fragments, visible

if TYPE_CHECKING:
    from .triangles import Triangles

LAYERS = 8  # composited per pixel at most; what lies behind the eighth is not seen
PASSES = 64  # over the faces at most, layers that a mask cuts away included
CLOSED = 1 / 1024  # a pixel that lets less than this through is done


def see_through(materials: list[Material], face_material: np.ndarray) -> bool:
    """Return whether any face has a material that uses alpha.

    Parameters
    ----------
    materials : sequence of Material
        All materials.
    face_material : int64 [F]
        Indices into materials.

    Returns
    -------
    bool
        False if all faces are opaque.
    """
    return bool(np.array([m.alpha_mode in (ALPHA_MASK, ALPHA_BLEND) for m in materials], np.bool_)[face_material].any())


def opacity(materials: list[Material], material: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return the opacity of points by the alpha mode of their material: 1 if opaque; for a mask 1 from the cutoff on, 0 below;
    alpha for a blend.

    Parameters
    ----------
    materials : sequence of Material
        All materials.
    material : int64 [M]
        Indices into materials.
    alpha : float32 [M]
        0..255; NaN counts as 0.

    Returns
    -------
    float32 [M]
        0..1.
    """
    mode = np.array([m.alpha_mode for m in materials])[material]
    cutoff = np.array([m.alpha_cutoff for m in materials], np.float32)[material]
    share = np.clip(np.nan_to_num(alpha) / np.float32(255), 0, 1)
    return np.where(mode == ALPHA_BLEND, share, (mode != ALPHA_MASK) | (share >= cutoff)).astype(np.float32)


def composite(triangles: Triangles, shade: Callable[[Fragments], tuple[np.ndarray, np.ndarray]],
              threads: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw triangles with transparency: peel depth layers off front to back and mix their colours in each pixel.

    Parameters
    ----------
    triangles : Triangles
        Of set_up().
    shade : function (Fragments) -> (float32 [M, 3], float32 [M])
        Returns the colours of fragments, 0..255, and their opacity, 0..1.
    threads : int
        Most threads.

    Returns
    -------
    pixel : int64 [N]
        Pixels in which something is visible, row * width + column, ascending.
    colour : float32 [N, 3]
        Straight, 0..255.
    alpha : float32 [N]
        0..1.

    Notes
    -----
    Colours are mixed as they are coded (sRGB), as in browsers' canvases and most codecs' tools. Layers of exactly equal depth
    count as one.
    """
    count = triangles.camera.width * triangles.camera.height
    colour, through, layers = np.zeros((count, 3), np.float32), np.ones(count, np.float32), np.zeros(count, np.uint8)
    beyond = None
    for _ in range(PASSES):
        fragments = visible(triangles, threads, beyond)
        if len(fragments.pixel) == 0:
            break
        pixel = fragments.pixel
        seen, alpha = shade(fragments)
        colour[pixel] += (through[pixel] * alpha)[:, None] * seen
        through[pixel] *= 1 - alpha
        layers[pixel] += alpha > 0
        going_on = (through[pixel] > CLOSED) & (layers[pixel] < LAYERS)
        beyond = np.full(count, np.inf)
        beyond[pixel[going_on]] = fragments.depth[going_on]
    pixel = np.flatnonzero(through < 1)
    alpha = 1 - through[pixel]
    return pixel, colour[pixel] / alpha[:, None], alpha
