"""Images that Pillow reads, and KTX2 textures -> uint8 RGBA arrays, decoded once and only if a material refers to them; and such
arrays -> the bytes of PNG, JPEG, WebP, AVIF and KTX2 files (IMAGE_FORMATS of formats.py).
"""

from __future__ import annotations

import io
import re
import threading
from collections.abc import Callable, Hashable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, LimitError, SupportError
from ..scene.channels import BASE_COLOUR, BY_NAME
from ..scene.scene import Texture
from .formats import AUTO, IMAGE_FORMATS, TEXTURE_FORMATS, ImageFormat
from .ktx2 import KTX2, alktx2, read_ktx2, write_ktx2

if TYPE_CHECKING:
    from .parts import Notes

_LOST = ("TXF-I16", "TXF-I17", "TXF-I27", "TXF-I32")  # of one image, without which the mesh is read all the same
_ORIENTATION = 0x0112  # EXIF's tag
_STRIP_ROWS = 256  # converting in strips keeps one full-size array beside Pillow's own, not three


class TextureShelf:
    """Scene.textures under construction: one array per image, one Texture per (image, wrap)."""

    def __init__(self, notes: Notes) -> None:
        self.notes = notes
        self.textures: list[Texture] = []
        self._images: dict[Hashable, tuple[np.ndarray, int | None] | InputError] = {}
        self._indices: dict[tuple, int] = {}

    def put(self, key: Hashable, fetch: Callable[[], Any], name: str, wrap: tuple[int, int],
            channel: str = BASE_COLOUR.name, nearest: bool = False) -> int:
        """Add a texture, decoding its image once, and return its index; -1, with a note, if the image is missing or broken.

        key: hashable identity of the image; fetch: () -> its bytes, or InputError; name: in messages; wrap: (s, t); channel: name
        of the channel that the image gives; nearest: as in Texture.
        """
        if key not in self._images:
            self._images[key] = self._decode(fetch, name, BY_NAME[channel].srgb)
        image = self._images[key]
        if isinstance(image, InputError):
            what = channel.replace("_", " ")
            self.notes.fault(str(image.code), f"{image.message}; {what} is drawn without it", f"texture '{name[:160]}' of {what}",
                             **image.details)
            return -1
        if (key, wrap, nearest) not in self._indices:
            self._indices[key, wrap, nearest] = len(self.textures)
            self.textures.append(Texture(image[0], wrap, name, nearest=nearest, lossy_bytes=image[1]))
        return self._indices[key, wrap, nearest]

    def _decode(self, fetch, name, is_colour):
        try:
            data = fetch()
            return read_image(data, name, self.notes, is_colour), lossy_bytes(data)
        except InputError as error:
            if error.code not in _LOST:
                raise
            return error


def read_image(data: Any, name: str, notes: Notes, is_colour: bool = True) -> np.ndarray:
    """Decode an image to uint8 [H, W, 4] RGBA, row 0 at the top. data: bytes of its file, or a PIL image; name: in messages;
    is_colour: whether it holds colours.

    16-bit samples keep their high byte, and the EXIF orientation is applied, as in browsers, both with a remark. Colour profiles
    are ignored, as glTF requires.
    Errors: TXF-I17 Pillow, or for KTX2 opengl_basisu, cannot decode it; LimitError TXF-I40 more pixels than notes allow;
    SupportError TXF-I32 KTX2 without opengl_basisu.
    """
    import warnings

    from PIL import Image

    if isinstance(data, (bytes, memoryview)) and bytes(data[: len(KTX2)]) == KTX2:
        return read_ktx2(data, name, notes, is_colour)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # large but allowed sizes, odd palettes: none of these changes a pixel
        try:
            with _our_limit(notes.limits.image_pixels):
                image = data if isinstance(data, Image.Image) else Image.open(io.BytesIO(data))
                notes.check_pixels(image.width * image.height, name)
                image.load()
            upright = _upright(image, name, notes)
            rgba = _to_rgba(upright)
        except Image.DecompressionBombError as error:
            raise notes.too_many_pixels(next(iter(map(int, re.findall(r"\d+", str(error)))), None), name) from error
        except LimitError:
            raise
        except (MemoryError, KeyboardInterrupt):
            raise
        except Exception as error:  # Pillow's plugins raise whatever their parsers meet
            raise InputError("TXF-I17", f"image '{name}' cannot be decoded", reason=str(error)[:200] or None) from error
    if _sample_bits(data) == 16 or image.mode.startswith("I"):
        notes.remark(f"image '{name}' has 16-bit samples; the high 8 bits are used")
    if image.mode in ("CMYK", "YCCK"):
        notes.lose(f"colour profile of image '{name}' (CMYK)",
                   f"image '{name}' is CMYK; it is converted to RGB without its colour profile")
    return rgba


def lossy_bytes(data: Any) -> int | None:
    """Size in bytes of an image file whose format is lossy (JPEG, WebP's VP8, AVIF); None for other formats and PIL images."""
    if not isinstance(data, (bytes, memoryview)):
        return None
    head = bytes(data[:32])
    webp = head[:4] == b"RIFF" and head[8:12] == b"WEBP" and (head[12:16] == b"VP8 " or b"VP8 " in bytes(data[:4096]))
    return len(data) if head[:3] == b"\xff\xd8\xff" or webp or head[4:12] in (b"ftypavif", b"ftypavis") else None


_PILLOWS_LIMIT = threading.Lock()  # it is a variable of Pillow's module


@contextmanager
def _our_limit(pixels):
    """In this block Pillow refuses images with more pixels, also images inside others; None means no limit."""
    from PIL import Image

    with _PILLOWS_LIMIT:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, pixels and (pixels + 1) // 2  # it refuses more than twice that
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _upright(image, name, notes):
    """The image turned by its EXIF orientation."""
    from PIL import ImageOps

    try:
        orientation = image.getexif().get(_ORIENTATION, 1)
    except (AttributeError, KeyError, OSError, SyntaxError, TypeError, ValueError):  # broken EXIF data turn nothing
        return image
    if orientation not in range(2, 9):
        return image
    notes.remark(f"image '{name}' is turned as its EXIF orientation {orientation} requires")
    return ImageOps.exif_transpose(image)


def _sample_bits(data):
    """Bit depth in a PNG header (Pillow reduces RGB 16 bit silently); 8 for anything else."""
    is_png = isinstance(data, (bytes, memoryview)) and bytes(data[:8]) == b"\x89PNG\r\n\x1a\n"
    return data[24] if is_png and len(data) > 24 else 8


def _to_rgba(image):
    width, height = image.size
    out = np.empty((height, width, 4), np.uint8)
    for top in range(0, height, _STRIP_ROWS):
        strip = image.crop((0, top, width, min(top + _STRIP_ROWS, height)))
        out[top : top + _STRIP_ROWS] = _rgba_of_strip(strip, image.info.get("transparency"))
    return out


def _rgba_of_strip(strip, clear):
    """Return RGBA values of a strip. clear: the transparent value of 16-bit grey, which Pillow would clip instead of scale."""
    if not strip.mode.startswith("I"):
        usual = strip.mode in ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "La", "RGBa")
        return np.asarray((strip if usual else strip.convert("RGB")).convert("RGBA"))
    grey = np.asarray(strip).astype(np.int64)
    rgba = np.empty((*grey.shape, 4), np.uint8)
    rgba[..., :3] = np.clip(grey >> 8, 0, 255)[..., None]
    rgba[..., 3] = 255 if clear is None else np.where(grey == clear, 0, 255)
    return rgba


def check_image_format(name: str, quality: int | None) -> None:
    """Check a texture format, which may be AUTO, and a quality. Raises InputError TXF-O14 if they are unknown or do not go
    together, SupportError TXF-O15 if a package is missing."""
    if not isinstance(name, str) or name not in TEXTURE_FORMATS:
        raise InputError("TXF-O14", "the texture format is unknown", value=str(name)[:40], allowed=" ".join(TEXTURE_FORMATS))
    if quality is not None:
        if name == AUTO:
            raise InputError("TXF-O14", f"texture quality requires a texture format, because {AUTO} sets its own",
                             value=str(quality)[:40])
        if IMAGE_FORMATS[name].quality is None:
            raise InputError("TXF-O14", f"{name} is lossless and has no quality", value=quality)
        if isinstance(quality, bool) or not isinstance(quality, int) or not 1 <= quality <= 100:
            raise InputError("TXF-O14", "the texture quality is out of range", value=str(quality)[:40], allowed="1..100")
    if name == "ktx2":
        alktx2()
    elif name in ("webp", "avif"):
        from PIL import features

        if not features.check(name):
            raise SupportError("TXF-O15", f"this build of Pillow cannot write {name}: run pip install -U pillow", value=name)


def format_for(image: np.ndarray, wanted: ImageFormat) -> tuple[ImageFormat, tuple[str, ...]]:
    """Return the format to write an image in, and warnings: the wanted format, or PNG if that cannot hold the image. image: uint8
    [H, W, 3 or 4]."""
    if wanted.name == "jpeg" and image.shape[2] == 4:
        return IMAGE_FORMATS["png"], ("JPEG has no alpha: images with alpha are written as PNG",)
    if wanted.name == "ktx2" and (image.shape[0] % 4 or image.shape[1] % 4):
        text = "glTF requires KTX2 textures with sides that are multiples of 4: other images are written as PNG"
        return IMAGE_FORMATS["png"], (text,)
    return wanted, ()


def encode_image(image: np.ndarray, form: ImageFormat, quality: int | None = None, srgb: bool = True) -> bytes:
    """Return an image as the bytes of a file. image: uint8 [H, W, 3 or 4]; form: of format_for(); quality: 1..100, or None for
    the format's own; srgb: whether the image holds colours, which KTX2 stores."""
    quality = form.quality if quality is None else quality
    if form.name == "ktx2" and quality is not None:
        return write_ktx2(image, quality, srgb)
    if form.name == "jpeg":
        return encode_jpeg(image, **_encode_settings(form.name, quality))
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, form.name.upper(), **_encode_settings(form.name, quality))
    return out.getvalue()


def encode_jpeg(image: np.ndarray, **settings: Any) -> bytes:
    """Return an image, uint8 [H, W, 3], as the bytes of a JPEG, optimised and progressive if Pillow's buffer suffices. settings:
    keywords of Pillow's save().

    The buffer has two bytes a texel from quality 95, else one byte; Pillow fails if noise needs more."""
    from PIL import Image

    def saved(rows, **others):
        out = io.BytesIO()
        Image.fromarray(rows).save(out, "JPEG", **settings, **others)
        return out.getvalue()

    room, rows = (2 if settings.get("quality", 0) >= 95 else 1) * image.shape[0] * image.shape[1], some_rows(len(image))
    if len(saved(image[rows])) * len(image) > 0.5 * room * len(rows):  # perhaps
        plain = saved(image)
        if len(plain) > 0.9 * room:
            return plain
    return saved(image, optimize=True, progressive=True)


def some_rows(height: int) -> np.ndarray:
    """Return a sixteenth of the rows of an image, evenly distributed, by which the bytes of its file are estimated: int64 [n]."""
    return np.flatnonzero(np.arange(height) // 8 % 16 == 0)


def _encode_settings(name, quality):
    """Keywords of Pillow's save(). Chroma has full resolution if the format allows it: charts make colour edges everywhere."""
    if name == "png":
        return {"compress_level": 3}
    if name == "jpeg":
        return {"quality": quality, "subsampling": 0}
    if name == "webp":
        return {"quality": quality, "method": 4, "exact": True}
    return {"quality": quality, "subsampling": "4:4:4", "speed": 6}
