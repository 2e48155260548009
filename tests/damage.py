"""Streams damaged on purpose, and how decoding them ends."""

import time
import zlib
from functools import lru_cache

import numpy as np
from shapes import crossing_sheets, painted_sphere

from texfcodec.api import decode
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import UNIT_END
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.codecs import plane_codec_of_unit
from texfcodec.decoder import _decode_plane
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import LimitError, StreamError, SupportError, TexfError
from texfcodec.field.voxels import VoxelSupport
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions, EncodeOptions

SMALL = Limits(voxels=1 << 18, samples=1 << 21)  # a lying resolution may cost a tenth of a second, no more
ONE_THREAD = DecodeOptions(threads=1)
FAMILIES = (StreamError, LimitError, SupportError)
END = write_unit(UNIT_END, b"")


@lru_cache
def small(kind="sphere"):
    """A stream of under a kilobyte, or one with two materials, alpha, metadata and textures, over voxels or ("texels") texels."""
    scene, resolution = (painted_sphere(3), 12) if kind == "sphere" else (crossing_sheets(), 20)
    support = "texels" if kind == "texels" else "voxels"
    scene.corner_uv = scene.corner_uv * 0.5 + 0.7 if kind == "texels" else scene.corner_uv  # beside the image, and not all of it
    data = encode_scene(scene, EncodeOptions(resolution=resolution, qp=34, partition="off", support=support)).data
    assert any(f.over_texels for f in decode(data).fields) == (kind == "texels")
    assert decode(data).fields  # and the decoder's kernels are compiled before anything is timed
    return data


def fields_of(data):
    return [(f.keys.tolist(), f.rgba.tolist()) for f in decode(data).fields]


def repacked(data, change):
    """The stream with each unit's payload replaced by change(type, payload); lengths and checksums are right again."""
    out = bytearray(data[:8])
    for unit in read_units(data)[0]:
        payload = change(unit.type, bytearray(data[unit.begin : unit.end]))
        out += write_unit(unit.type, bytes(payload))
    return bytes(out) + END


def outcome(data, options=None):
    """"decoded" or the code of the error. Any other exception fails the test that asks; so does a slow answer."""
    begin = time.perf_counter()
    try:
        decode(data, options or DecodeOptions(limits=SMALL, threads=1))
        code = "decoded"
    except TexfError as error:
        assert isinstance(error, FAMILIES) and error.code.startswith("TXF-") and str(error)
        code = error.code
    assert time.perf_counter() - begin < 5
    return code


def with_a_bit_flipped(data):
    """Copies of bytes with one bit of one byte turned over, byte after byte."""
    rng = np.random.default_rng(0)
    for i, byte in enumerate(data):
        yield data[:i] + bytes([byte ^ 1 << int(rng.integers(8))]) + data[i + 1 :]


def attribute_ending(data, keys):
    """"decoded" or the code that the attribute units end in. The voxels are given, so that their kernels need not be compiled."""
    try:
        for unit in read_stream(data, Limits()).attributes:
            plane = _decode_plane(plane_codec_of_unit(unit), unit, VoxelSupport(1 << unit["Depth"], keys), 0, ONE_THREAD)
            assert plane.shape == (len(keys), len(unit["qp"])) and zlib.crc32(plane) == unit["values_crc"]
    except TexfError as error:
        assert isinstance(error, (StreamError, SupportError)) and str(error)
        return error.code
    return "decoded"
