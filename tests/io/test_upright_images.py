"""Images that EXIF turns: seen as browsers show them, with a remark."""

import numpy as np
import pytest
from mesh_files import encoded
from PIL import Image

from texfcodec.io.images import read_image
from texfcodec.io.parts import Notes

PICTURE = np.zeros((8, 16, 3), np.uint8)
PICTURE[:4, :8] = 255  # white in the corner at the top left
# Where EXIF 2.3 says that the stored corner at the top left is shown: (upwards, to the left, sides change).
SHOWN = {1: (True, True, False), 2: (True, False, False), 3: (False, False, False), 4: (False, True, False),
         5: (True, True, True), 6: (True, False, True), 7: (False, False, True), 8: (False, True, True)}


def turned(orientation, form="JPEG"):
    exif = Image.Exif()
    exif[0x0112] = orientation
    return encoded(PICTURE, form, exif=exif)


@pytest.mark.parametrize("form", ["JPEG", "PNG", "WEBP"])
@pytest.mark.parametrize("orientation", SHOWN)
def test_the_corner_is_where_exif_puts_it(orientation, form):
    notes = Notes()
    image = read_image(turned(orientation, form), "photo", notes)
    top, left, is_turned = SHOWN[orientation]
    assert image.shape == ((16, 8, 4) if is_turned else (8, 16, 4))
    height, width = image.shape[:2]
    assert image[height // 4 if top else -height // 4, width // 4 if left else -width // 4, 0] > 200
    assert np.mean(image[..., 0] > 128) == pytest.approx(0.25, abs=0.05)
    assert notes.remarks == [f"image 'photo' is turned as its EXIF orientation {orientation} requires"] * (orientation > 1)
    assert notes.dropped == notes.warnings == []


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_an_orientation_that_is_none_turns_nothing(orientation):
    notes = Notes()
    assert read_image(turned(orientation), "photo", notes).shape == (8, 16, 4) and notes.remarks == []


def test_broken_exif_data_turn_nothing():
    data = turned(6)
    at = data.index(b"Exif")
    broken = data[: at + 8] + bytes(255 - byte for byte in data[at + 8 : at + 20]) + data[at + 20 :]
    assert read_image(broken, "photo", Notes()).shape == (8, 16, 4)
