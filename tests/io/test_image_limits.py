"""The limit on pixels of an image is our own: it stands before any decoding, a flag raises it, and Pillow's has no say."""

import io
import json
import struct
import zlib

import numpy as np
import pytest
from mesh_files import SQUARE_UV, Builder, encoded, load_bytes
from PIL import Image

from texfcodec import Limits
from texfcodec.cli.enc import main as run_enc
from texfcodec.errors import LimitError
from texfcodec.io.images import read_image
from texfcodec.io.load import load
from texfcodec.io.parts import Notes

PIXELS = np.random.default_rng(0).integers(0, 256, (10, 11, 3), np.uint8)


def tiff(side):
    """A TIFF of a few bytes that says it is an RGBA image of this side, compressed."""
    tags = {256: side, 257: side, 258: 8, 259: 5, 262: 2, 273: 8, 277: 4, 278: side, 279: 4, 338: 2}
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4)


def png_header(side):
    """A PNG that ends behind its header."""
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in (head, data))


def glb(image):
    builder = Builder()
    builder.primitive(uv=SQUARE_UV, material=builder.material(builder.texture(image)))
    return builder


@pytest.mark.parametrize("data", [tiff(12_000), png_header(16_384)], ids=["tiff", "png"])
def test_a_small_file_of_a_huge_image_is_refused_before_it_is_decoded(data, monkeypatch):
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("the image is decoded"))
    for plugin in ("TiffImagePlugin.TiffImageFile", "PngImagePlugin.PngImageFile", "ImageFile.ImageFile"):
        module, name = plugin.split(".")
        monkeypatch.setattr(getattr(__import__(f"PIL.{module}", fromlist=[name]), name), "load",
                            lambda image: pytest.fail("the image is decoded"))
    with pytest.raises(LimitError) as caught:
        read_image(data, "a", Notes())
    assert len(data) < 245 and caught.value.code == "TXF-I40" and caught.value.details["allowed"] == 1 << 27
    assert caught.value.details["value"] in (12_000**2, 16_384**2)


def test_the_limit_can_be_raised_and_switched_off(tmp_path):
    with pytest.raises(LimitError) as caught:
        load_bytes(tmp_path, glb(encoded(PIXELS)), limits=Limits(image_pixels=109))
    assert caught.value.details == {"value": 110, "allowed": 109}
    for limits in (Limits(image_pixels=110), Limits(image_pixels=0), None):
        np.testing.assert_array_equal(load(tmp_path / "a.glb", limits=limits).textures[0].image[..., :3], PIXELS)


def test_pillows_own_limit_has_no_say_and_stays_as_it_was(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 20)
    assert read_image(encoded(PIXELS), "a", Notes()).shape == (10, 11, 4)
    with pytest.raises(LimitError):
        read_image(encoded(PIXELS), "a", Notes(limits=Limits(image_pixels=50)))
    assert Image.MAX_IMAGE_PIXELS == 20


def test_images_inside_images_count(monkeypatch):
    icon = io.BytesIO()
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(icon, "ICO", sizes=[(64, 64)])
    lying = bytearray(icon.getvalue())
    lying[6] = lying[7] = 4  # the directory says 4 x 4
    with pytest.raises(LimitError, match="more pixels than the limit"):
        read_image(bytes(lying), "a", Notes(limits=Limits(image_pixels=1000)))


@pytest.mark.parametrize("limit, code, remedy", [
    ("image-pixels", "TXF-I40", "raise --limit image-pixels"), ("voxels", "TXF-L04", "--texel-size")])
def test_a_limit_names_the_option_that_raises_it_and_what_shrinks(tmp_path, capsys, limit, code, remedy):
    (tmp_path / "a.glb").write_bytes(glb(encoded(PIXELS)).glb())
    command = [str(tmp_path / "a.glb"), str(tmp_path / "a.texf"), "--resolution", "64", "--limit", f"{limit}=90",
               "--threads", "1"]
    with pytest.raises(SystemExit) as ended:
        run_enc([*command, "--quiet"])
    err = capsys.readouterr().err
    assert ended.value.code == 6 and err.count("\n") == 1
    assert f"error {code}" in err and remedy in err and f"--limit {limit}" in err
    with pytest.raises(SystemExit):
        run_enc([*command, "--json"])
    assert remedy in json.loads(capsys.readouterr().out)["error"]["remedy"]
    assert not (tmp_path / "a.texf").exists()


def test_16_bit_grey_of_many_rows_keeps_its_high_byte_and_its_transparent_value():
    grey = np.random.default_rng(1).integers(0, 65536, (700, 33)).astype(np.uint16)
    file = io.BytesIO()
    Image.fromarray(grey).save(file, "PNG", transparency=int(grey[300, 5]))
    rgba = read_image(file.getvalue(), "grey", Notes())
    np.testing.assert_array_equal(rgba[..., 0], grey >> 8)
    np.testing.assert_array_equal(rgba[..., 3] == 0, grey == grey[300, 5])
