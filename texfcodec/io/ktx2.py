"""KTX2 textures with Basis Universal data (KHR_texture_basisu: ETC1S and UASTC) -> uint8 RGBA, and back to ETC1S.

Reading uses opengl_basisu: it contains the transcoder of the format's authors, has wheels for every Python that we support, and
is tested on damaged files. Khronos's pyktx has no wheels and needs its C library installed first. This module checks the header
before its sizes take memory, because the transcoder trusts the unpacked length that a Zstandard level states. Writing uses
alktx2, with the encoder of the same authors, because opengl_basisu only transcodes.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, SupportError

if TYPE_CHECKING:
    from .parts import Notes

KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
_HEADER = struct.Struct("<9I4I2Q")  # from vkFormat to the length of the global data; KTX 2.0 section 3
_LEVEL = struct.Struct("<3Q")
_NONE, _BASIS_LZ, _ZSTD = 0, 1, 2
_BLOCK_BYTES = 16  # of UASTC, 4 x 4 pixels


def read_ktx2(data: bytes | memoryview, name: str, notes: Notes, is_colour: bool = True) -> np.ndarray:
    """Decode the bytes of a .ktx2 file to uint8 [H, W, 4] RGBA of its largest level, row 0 at the top. is_colour: whether its
    values should be sRGB-coded; a file marked otherwise gets a warning.

    Errors: InputError TXF-I17 broken, or no Basis Universal data; SupportError TXF-I32 the package is missing;
    LimitError TXF-I40 more pixels than notes allow.
    """
    data = bytes(data)
    size = _check_header(data, name, notes)
    try:
        import opengl_basisu
    except ImportError as error:
        raise SupportError("TXF-I32", f"image '{name}' is a KTX2 texture, which requires the package "
                                      'opengl-basisu: run pip install "texfcodec[formats]"') from error
    try:
        texture = opengl_basisu.open(data)
        if (texture.width, texture.height) != size:
            raise ValueError("the transcoder returned another size")
        pixels = texture.transcode("rgba8").data
    except (ValueError, IndexError, RuntimeError) as error:
        raise _broken(name, str(error)[:200]) from error
    if is_colour and not texture.srgb:
        notes.warn(f"image '{name}' is marked as linear but holds colours; its values are read as sRGB")
    if texture.srgb and not is_colour:
        notes.warn(f"image '{name}' is marked as sRGB but holds no colours; its values are read as linear")
    return np.ascontiguousarray(pixels, np.uint8)


def _broken(name, reason):
    return InputError("TXF-I17", f"image '{name}' cannot be decoded", reason=reason)


def _check_header(data, name, notes):
    """(width, height), after checking the level index against them and against the file's length."""
    if len(data) < len(KTX2) + _HEADER.size + _LEVEL.size:
        raise _broken(name, "the KTX2 header is truncated")
    vk_format, _, width, height, depth, layers, faces, _, scheme, *_, sgd_at, sgd_size = _HEADER.unpack_from(data, len(KTX2))
    if vk_format or scheme > _ZSTD:
        raise _broken(name, f"the KTX2 file has no Basis Universal data (vkFormat {vk_format}, supercompression {scheme})")
    if not width or not height or depth or layers > 1 or faces != 1:
        raise _broken(name, "the KTX2 file is not a single two-dimensional image")
    notes.check_pixels(width * height, name)
    at, size, unpacked = _LEVEL.unpack_from(data, len(KTX2) + _HEADER.size)
    if at + size > len(data) or sgd_at + sgd_size > len(data):
        raise _broken(name, "part of the KTX2 file lies beyond its end")
    expected = -(-width // 4) * -(-height // 4) * _BLOCK_BYTES
    if scheme != _BASIS_LZ and (unpacked != expected or (scheme == _NONE and size != expected)):
        raise _broken(name, f"the KTX2 level has {unpacked} bytes, but its size requires {expected}")
    return width, height


def write_ktx2(image: np.ndarray, quality: int, srgb: bool) -> bytes:
    """Encode an image, uint8 [H, W, 3 or 4], as the bytes of a .ktx2 file: ETC1S with all mip levels, which GPUs cannot compute
    from compressed blocks.

    quality: 1..100; srgb: whether it holds colours. Errors: SupportError TXF-O15 the package is missing.
    """
    height, width, columns = image.shape
    rgba = np.full((height, width, 4), 255, np.uint8)
    rgba[..., :columns] = image
    return alktx2().encode_raw_rgba_to_ktx2(rgba.tobytes(), width, height, columns == 4, codec="etc1s", quality=quality,
                                            srgb=srgb, linear=not srgb, mipmaps=True)


def alktx2() -> Any:
    """The package that writes KTX2. Raises SupportError TXF-O15 if it is missing."""
    try:
        import alktx2 as package
    except ImportError as error:
        raise SupportError("TXF-O15", 'writing KTX2 textures requires the package alktx2: run pip install "texfcodec[formats]"',
                           value="alktx2") from error
    return package
