"""Images as the bytes of PNG, JPEG, WebP, AVIF and KTX2 files, and what glTF says of each format.

Pillow writes all but KTX2, which alktx2 writes with the encoder of Basis Universal's authors (opengl_basisu, which reads it, only
transcodes).
"""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, SupportError


@dataclass(frozen=True)
class ImageFormat:
    """A format that textures are written in. mime, suffix: of its files; extension: the glTF extension that a texture names it
    by, or None where every viewer reads it; quality: 1..100, that of no other wish, or None where the format has none."""

    name: str
    mime: str
    suffix: str
    extension: str | None = None
    quality: int | None = None


FORMATS = {one.name: one for one in (
    ImageFormat("png", "image/png", ".png"),
    ImageFormat("jpeg", "image/jpeg", ".jpg", None, 92),
    ImageFormat("webp", "image/webp", ".webp", "EXT_texture_webp", 90),
    ImageFormat("avif", "image/avif", ".avif", "EXT_texture_avif", 85),
    ImageFormat("ktx2", "image/ktx2", ".ktx2", "KHR_texture_basisu", 90),
)}  # fmt: skip
AUTO = "auto"  # automatic_image.py


def check_image_format(name: str, quality: int | None) -> None:
    """InputError TXF-O14 for a format, AUTO among them, or a quality that does not go with it, SupportError TXF-O15 for a format
    whose package is missing."""
    if not isinstance(name, str) or name not in (AUTO, *FORMATS):
        raise InputError("TXF-O14", "texture format not known", value=str(name)[:40], allowed=" ".join((AUTO, *FORMATS)))
    if quality is not None:
        if name == AUTO:
            raise InputError("TXF-O14", f"texture quality needs a texture format: {AUTO} sets its own", value=str(quality)[:40])
        if FORMATS[name].quality is None:
            raise InputError("TXF-O14", f"{name} is lossless and has no quality", value=quality)
        if isinstance(quality, bool) or not isinstance(quality, int) or not 1 <= quality <= 100:
            raise InputError("TXF-O14", "texture quality out of range", value=str(quality)[:40], allowed="1..100")
    if name == "ktx2":
        _ktx2_package()
    elif name in ("webp", "avif"):
        from PIL import features

        if not features.check(name):
            raise SupportError("TXF-O15", f"this build of Pillow writes no {name}: pip install -U pillow", value=name)


def format_for(image: np.ndarray, wanted: ImageFormat, warnings: list[str]) -> ImageFormat:
    """The format that an image, uint8 [H, W, 3 or 4], is written in: PNG, with a warning, where the wanted one cannot hold it."""
    if wanted.name == "jpeg" and image.shape[2] == 4:
        warnings.append("JPEG has no alpha: an image that has is written as PNG")
        return FORMATS["png"]
    if wanted.name == "ktx2" and (image.shape[0] % 4 or image.shape[1] % 4):
        warnings.append("glTF wants KTX2 textures with sides that 4 divides: an image that has others is written as PNG")
        return FORMATS["png"]
    return wanted


def encode_image(image: np.ndarray, form: ImageFormat, quality: int | None = None, srgb: bool = True) -> bytes:
    """The bytes of an image file. image: uint8 [H, W, 3 or 4], one that format_for() gave this form; quality: 1..100 or None for
    the format's own; srgb: whether it holds colours, for KTX2, which says so."""
    quality = form.quality if quality is None else quality
    if form.name == "ktx2":
        return _ktx2(image, quality, srgb)
    if form.name == "jpeg":
        return jpeg_bytes(image, **_settings(form.name, quality))
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, form.name.upper(), **_settings(form.name, quality))
    return out.getvalue()


def jpeg_bytes(image: np.ndarray, **settings: Any) -> bytes:
    """The bytes of a JPEG, by keywords of Pillow's save(), optimised and progressive where Pillow has room for that.

    It sets aside two bytes a texel at quality 95 and more, one below, and fails where noise takes more."""
    from PIL import Image

    picture, room = Image.fromarray(image), (2 if settings.get("quality", 0) >= 95 else 1) * image.shape[0] * image.shape[1]
    plain, small = io.BytesIO(), io.BytesIO()
    picture.save(plain, "JPEG", **settings)
    if len(plain.getvalue()) > 0.9 * room:
        return plain.getvalue()
    picture.save(small, "JPEG", optimize=True, progressive=True, **settings)
    return small.getvalue()


def _settings(name, quality):
    """Keywords of Pillow's save(). Chroma at full resolution where it can be had: charts make colour edges everywhere."""
    if name == "png":
        return {"compress_level": 3}
    if name == "jpeg":
        return {"quality": quality, "subsampling": 0}
    if name == "webp":
        return {"quality": quality, "method": 4, "exact": True}
    return {"quality": quality, "subsampling": "4:4:4", "speed": 6}


def _ktx2(image, quality, srgb):
    """ETC1S with all mip levels, which GPUs cannot make of compressed blocks."""
    height, width, columns = image.shape
    rgba = np.full((height, width, 4), 255, np.uint8)
    rgba[..., :columns] = image
    return _ktx2_package().encode_raw_rgba_to_ktx2(rgba.tobytes(), width, height, columns == 4, codec="etc1s", quality=quality,
                                                   srgb=srgb, linear=not srgb, mipmaps=True)


def _ktx2_package():
    try:
        import alktx2
    except ImportError as error:
        raise SupportError("TXF-O15", 'KTX2 textures are written by the package alktx2: pip install "texfcodec[formats]"',
                           value="alktx2") from error
    return alktx2
