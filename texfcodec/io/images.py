"""Images of any kind Pillow reads, and KTX2 textures -> uint8 RGBA arrays, decoded once and only where a material asks."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Hashable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, LimitError
from ..scene.channels import BASE_COLOUR, BY_NAME
from ..scene.scene import Texture
from .opened import opened

if TYPE_CHECKING:
    from .parts import Notes

KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
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
        """Index of the texture, or -1 (with a note) where its image is missing or broken.

        key: hashable identity of the image; fetch: () -> its bytes, or InputError; wrap: (s, t); channel: what it is for;
        nearest: as Texture has it.
        """
        if key not in self._images:
            self._images[key] = self._decode(fetch, name, BY_NAME[channel].srgb)
        image = self._images[key]
        if isinstance(image, InputError):
            self.notes.fault(str(image.code), f"{image.message}; {channel.replace('_', ' ')} goes without it", **image.details)
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
            if error.code not in ("TXF-I16", "TXF-I17"):
                raise
            return error


def read_image(data: Any, name: str, notes: Notes, is_colour: bool = True) -> np.ndarray:
    """bytes of an image file, or a PIL image -> uint8 [H, W, 4] RGBA, row 0 at the top. is_colour: whether colour asks for it.

    16-bit samples keep their high byte (with a remark); colour profiles and EXIF rotation are ignored, as glTF says.
    Errors: TXF-I17 Pillow, or for KTX2 opengl_basisu, cannot decode it; LimitError TXF-I40 more pixels than notes allow;
    SupportError TXF-I32 KTX2 without opengl_basisu.
    """
    import warnings

    from PIL import Image

    if isinstance(data, (bytes, memoryview)) and bytes(data[: len(KTX2)]) == KTX2:
        from .ktx2 import read_ktx2

        return read_ktx2(data, name, notes, is_colour)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # large but allowed sizes, odd palettes: none of these changes a pixel
        try:
            with _our_limit(notes.image_pixels):
                image = data if isinstance(data, Image.Image) else Image.open(_stream(data))
                check_pixels(image.width * image.height, name, notes)
                image.load()
            rgba = _to_rgba(image)
        except Image.DecompressionBombError as error:
            raise _too_large(next(iter(map(int, re.findall(r"\d+", str(error)))), None), name, notes) from error
        except LimitError:
            raise
        except (MemoryError, KeyboardInterrupt):
            raise
        except Exception as error:  # Pillow's plugins raise whatever their parsers meet
            raise InputError("TXF-I17", f"image '{name}' cannot be decoded", reason=str(error)[:200] or None) from error
    if _sample_bits(data) == 16 or image.mode.startswith("I"):
        notes.remark(f"image '{name}' has 16-bit samples; the high 8 bits are used")
    if image.mode in ("CMYK", "YCCK"):
        notes.warn(f"image '{name}' is CMYK; it is converted to RGB without its colour profile")
    return rgba


def lossy_bytes(data: Any) -> int | None:
    """Bytes of an image file whose format is lossy (JPEG, WebP's VP8, AVIF); None for all others and for what is no file."""
    if not isinstance(data, (bytes, memoryview)):
        return None
    head = bytes(data[:32])
    webp = head[:4] == b"RIFF" and head[8:12] == b"WEBP" and (head[12:16] == b"VP8 " or b"VP8 " in bytes(data[:4096]))
    return len(data) if head[:3] == b"\xff\xd8\xff" or webp or head[4:12] in (b"ftypavif", b"ftypavis") else None


_PILLOWS_LIMIT = threading.Lock()  # it is a variable of Pillow's module


@contextmanager
def _our_limit(pixels):
    """Pillow refuses images of more pixels than this in the block, those inside other images, too; None: refuses none."""
    from PIL import Image

    with _PILLOWS_LIMIT:
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, pixels and (pixels + 1) // 2  # it refuses more than twice that
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def check_pixels(count: int, name: str, notes: Notes) -> None:
    """LimitError TXF-I40 for an image, called by its name, of more pixels than notes allow; before anything is decoded."""
    if notes.image_pixels is not None and count > notes.image_pixels:
        raise _too_large(count, name, notes)


def _too_large(count, name, notes):
    return LimitError("TXF-I40", f"image '{name}' has more pixels than the limit allows",
                      value=count, allowed=notes.image_pixels)


def missing_image(name: str) -> InputError:
    """The error for a texture file that is not there."""
    return InputError("TXF-I16", f"texture file '{name}' is missing or unreadable")


def find_file(folder: Path, name: str) -> Path | None:
    """Path of the file a mesh names, or None: as written, percent-decoded, with backslashes turned, or beside the mesh."""
    from urllib.parse import unquote

    slashed = name.replace("\\", "/")
    for candidate in (name, unquote(name), slashed, unquote(slashed), slashed.rsplit("/", 1)[-1]):
        path = Path(folder) / candidate
        try:
            if candidate and path.is_file():
                opened(path)
                return path
        except (OSError, ValueError):  # name too long, embedded NUL
            continue
    return None


def read_texture_file(folder: Path, name: str) -> bytes:
    """bytes of an image file named by a mesh; InputError TXF-I16."""
    path = find_file(folder, name)
    try:
        if path is not None:
            return path.read_bytes()
    except OSError as error:
        raise missing_image(name) from error
    raise missing_image(name)


def _stream(data):
    from io import BytesIO

    return BytesIO(data)


def _sample_bits(data):
    """Bit depth in a PNG header (Pillow reduces RGB 16 bit silently); 8 for anything else."""
    is_png = isinstance(data, (bytes, memoryview)) and bytes(data[:8]) == b"\x89PNG\r\n\x1a\n"
    return data[24] if is_png and len(data) > 24 else 8


def _to_rgba(image):
    width, height = image.size
    out = np.empty((height, width, 4), np.uint8)
    if image.mode.startswith("I"):
        return _deep_grey(image, out)
    for top in range(0, height, _STRIP_ROWS):
        strip = image.crop((0, top, width, min(top + _STRIP_ROWS, height)))
        if strip.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "La", "RGBa"):
            strip = strip.convert("RGB")
        out[top : top + _STRIP_ROWS] = np.asarray(strip.convert("RGBA"))
    return out


def _deep_grey(image, out):
    """16-bit grey: Pillow would clip instead of scale."""
    grey = np.asarray(image).astype(np.int64)
    out[..., :3] = np.clip(grey >> 8, 0, 255)[..., None]
    clear = image.info.get("transparency")
    out[..., 3] = 255 if clear is None else np.where(grey == clear, 0, 255)
    return out
