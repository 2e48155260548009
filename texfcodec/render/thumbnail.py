"""A small picture of an asset, and pictures as PNG bytes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from .backdrop import GREY, is_nearly_uniform
from .camera import direction_of_angles, framing
from .environment import DAYLIGHT
from .shade import box_down, render_texf

if TYPE_CHECKING:
    from ..texf import Texf

SIDE, TIMES = 256, 2  # pixels, and how many times as large it is drawn
AZIMUTH, ELEVATION = 30.0, 25.0


def to_png(image: np.ndarray) -> bytes:
    """Encode an image as PNG.

    Parameters
    ----------
    image : uint8 [H, W, 3]
        The image.

    Returns
    -------
    bytes
        The file.
    """
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG", compress_level=3)
    return data.getvalue()


def thumbnail(texf: Texf) -> bytes:
    """Draw a Texf as a PNG for notebooks: from the front, a little from above and the side, on grey.

    Parameters
    ----------
    texf : Texf
        A decoded stream; it is drawn in light if it is plain.

    Returns
    -------
    bytes
        The file.
    """
    camera = framing(direction_of_angles(AZIMUTH, ELEVATION), texf.positions, SIDE * TIMES)
    picture = render_texf(texf, camera, threads=texf.threads, shaded=DAYLIGHT if is_nearly_uniform(texf) else None)
    return to_png(box_down(picture.image(GREY), TIMES))
