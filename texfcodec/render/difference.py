"""Two pictures of one view side by side, with a heat map of their difference and its scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..core.colour_error import ColourError
from ..core.json_text import json_ready
from .backdrop import Background, rows

if TYPE_CHECKING:
    from .shade import Picture

HOTTEST = 32  # coded levels of R, G, B (root mean square) from which on the heat map is at its hottest
RAMP = np.array([(0, 0, 0), (70, 15, 110), (190, 50, 85), (250, 150, 30), (255, 255, 190)], np.float64)
ONLY_ONE = (0, 160, 170)  # pixels that one of the pictures covers and the other does not
GAP = 8  # pixels between panels


def compare(first: Picture, second: Picture, background: tuple[int, int, int] = (255, 255, 255),
            around: Background | None = None) -> tuple[dict, np.ndarray]:
    """Compare two Pictures: return the PSNR between them, and a heat map of their difference.

    Parameters
    ----------
    first, second : Picture
        Pictures of the same size.
    background : (r, g, b)
        Colour under both pictures, 0..255.
    around : background, optional
        Background of the heat map's uncovered pixels; None for the same colour.

    Returns
    -------
    figures : dict
        "pixels_both", "pixels_only_first", "pixels_only_second"; "psnr_rgb", "psnr_y": dB over the pixels that both cover,
        unrounded; None if they are equal or pixels_both is 0.
    heat : uint8 [H, W, 3]
        The heat map.

    Raises
    ------
    ValueError
        The pictures have different sizes.
    """
    if (first.width, first.height) != (second.width, second.height):
        raise ValueError("the pictures have different sizes")
    both, a, b = np.intersect1d(first.pixel, second.pixel, assume_unique=True, return_indices=True)
    ref, got = _over(first, background)[a], _over(second, background)[b]
    psnr = {"psnr_rgb": None, "psnr_y": None}
    if len(both):
        error = ColourError()
        error.add(ref, got)
        psnr = {name: json_ready(error.result())[name] for name in psnr}
    image = np.empty((first.height, first.width, 3), np.uint8)
    image[:] = rows(background if around is None else around, first.height)
    heat = image.reshape(-1, 3)
    heat[first.pixel] = heat[second.pixel] = ONLY_ONE
    heat[both] = heat_colour(np.sqrt(((got - ref) ** 2).mean(axis=1)))
    counts = {"pixels_both": len(both), "pixels_only_first": len(first.pixel) - len(both),
              "pixels_only_second": len(second.pixel) - len(both)}
    return counts | psnr, image


def heat_colour(difference: np.ndarray) -> np.ndarray:
    """Return the colours of the heat map.

    Parameters
    ----------
    difference : float [M]
        Difference of two pixels in sRGB-coded levels of 0..255.

    Returns
    -------
    uint8 [M, 3]
        Black at 0, pale yellow from HOTTEST on.
    """
    place = np.clip(np.nan_to_num(difference, nan=HOTTEST) / HOTTEST, 0, 1) * (len(RAMP) - 1)
    steps = np.arange(len(RAMP))
    return np.stack([np.interp(place, steps, RAMP[:, c]) for c in range(3)], axis=1).round().astype(np.uint8)


def names_of_halves(assets: Sequence[tuple[bool, str]]) -> list[str]:
    """Return the captions of two pictures.

    Parameters
    ----------
    assets : pair of (bool, str)
        Whether it is a mesh, and its name.

    Returns
    -------
    list of str
        Such as "source: bunny.glb"; the first word is source for the mesh and stream for the stream, or first and second if both
        are of the same kind.
    """
    words = {(True, False): ("source", "stream"), (False, True): ("stream", "source")}
    kinds = words.get((assets[0][0], assets[1][0]), ("first", "second"))
    return [f"{kind}: {name}" for kind, (_, name) in zip(kinds, assets, strict=True)]


def sheet(panels: Sequence[np.ndarray], captions: Sequence[str],
          background: Background = (255, 255, 255)) -> np.ndarray:
    """Set pictures in a row, with a caption under each, and the heat map's colour scale under the last.

    Parameters
    ----------
    panels : sequence of uint8 [H, W, 3]
        The pictures.
    captions : sequence of str
        One for each.
    background : background
        Its bottom colour lies behind the captions.

    Returns
    -------
    uint8 [H', W', 3]
        The sheet.
    """
    height, width = panels[0].shape[:2]
    times = max(1, width // 512)
    foot = 30 * times
    out = np.empty((height + foot, len(panels) * (width + GAP) - GAP, 3), np.uint8)
    out[:] = paper = rows(background, 2)[-1, 0]
    ink = (0, 0, 0) if paper.sum() > 382 else (255, 255, 255)
    for i, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        left = i * (width + GAP)
        out[:height, left : left + width] = panel
        if i < len(panels) - 1:
            _write(out, caption, height + 10 * times, left + 4 * times, times, ink, left + width)
        else:
            _scale(out[height:, left : left + width], caption, times, ink)
    return out


def _over(picture, background):
    """The picture's pixels over the background, float32 [M, 3]."""
    alpha = picture.alpha[:, None]
    return picture.colour * alpha + np.float32(background) * (1 - alpha)


def _scale(out, caption, times, ink):
    """Draws the bar from 0 to HOTTEST with its numbers, and the caption to its right."""
    long, high = min(128 * times, out.shape[1] - 2), 8 * times
    out[4 * times : 4 * times + high, :long] = heat_colour(np.linspace(0, HOTTEST, long))[None]
    for share in (0, 1, 2, 3, 4):
        number = f"{HOTTEST * share // 4}" + "+" * (share == 4)
        _write(out, number, 14 * times, min(share * long // 4, long - 1), times, ink, out.shape[1])
    _write(out, caption, 3 * times, long + 4 * times, times, ink, out.shape[1])


def _write(out, text, top, left, times, ink, right):
    """Draws one line of text, each pixel of the small built-in font `times` x `times` large, cut at the borders."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default()
    box = font.getbbox(text)
    mask = Image.new("L", (max(int(box[2]) + 1, 1), max(int(box[3]) + 2, 1)))
    ImageDraw.Draw(mask).text((0, 0), text, 255, font)
    drawn = np.asarray(mask).repeat(times, axis=0).repeat(times, axis=1)[:, :, None] / 255.0
    place = out[top : top + drawn.shape[0], left : min(left + drawn.shape[1], right)]
    drawn = drawn[: place.shape[0], : place.shape[1]]
    place[:] = (place * (1 - drawn) + np.array(ink) * drawn).round()
