"""Our decoder of meshopt views: what the encoder of the format's authors makes of small arrays, prefixes, flips and noise."""

import base64

import numpy as np
import pytest
from mesh_files import SQUARE, SQUARE_UV, TWO, Builder, load_bytes
from test_meshopt import EXTENSION, compress, exponential

from texfcodec.errors import TexfError
from texfcodec.io.gltf.meshopt import decode_view
from texfcodec.io.gltf.meshopt_views import decode_attributes, decode_sequence, decode_triangles, unfilter

# Encoded with the npm package meshoptimizer 1.x: 17 vertices of 16 bytes, and a grid of 2 x 2 cells.
ATTRIBUTES = (
    "oAIIiohoZEQiAAcA+ZY/jVOejc4uD3pA3q+fwAAAAHMBDwAAAJ2eAAYIiohmZkJAAEAAAAAHAAqNqulhN+nAzjn143Qxu8AAAABuAAAGCIqGhm"
    "REIABAAAAABwD2HqAFOI5y7IIB8iKhVlXAAAAApwEAP8Dwj5Dj5Hl6AAYIqIaGZEIgAEAAAAAHAAJDzWoohBG6/seinuZfusAAAAB3AQAP8ABN"
    "TuHiAAAAAAAAAAAAAAAAAAAAAACABwcAhe4HAIqQBwCPowcA")
PLAIN = (
    "gAcHAIXuBwCKkAcAj6MHAISKBwCJ8wcAjgsHAJOkBwCI1bgAjawHAJIaBwCYggcAjbUHAJIBBwCXagcAnBsHAJFuBwCWjAcAm2cHAKBQBwCVRA"
    "cAmlsHAJ6DvwCjZAcAmJMHAJ0/BwCiygcAp6bgAJxMBwCgygcApQOVAKqdBwCfswcAoyoHAKh5BwCt+pYAocoHAKaRBwCqugcAr3kHAKPCBwCo"
    "dAcArLkHALEVBwCl/wcAqfkHAK4yBwCyZgcAph8HAKuHBwCvQ8oAs7UHAKeOBwCrwQcAr/IHALMoBwCnNgcAq6gHAK8dBwCz+AcAp+YHAKtKBw"
    "Cv8gcAs1UHAKesBwCqgQcArp4HALIZBwA=")
TRIANGLES = (
    "4f4eEA5OHhIODwYAdodWZ3iphmWJaJgBaQAA")
SEQUENCE = (
    "0QAECAYMAgYECAYMAgIECAYMAgYECAYMAgAAAAA=")
GRID = np.array([[a, a + 1, a + 3, a + 1, a + 4, a + 3] for a in (0, 1, 3, 4)], np.uint32).ravel()
DECODERS = {"attributes": (lambda data: decode_attributes(data, 17, 16), ATTRIBUTES),
            "triangles": (lambda data: decode_triangles(data, 24), TRIANGLES),
            "sequence": (lambda data: decode_sequence(data, 24), SEQUENCE)}


def bytes_of(text):
    return base64.b64decode(text)


def stored(values):
    """Attributes uint8 [n, stride] as a stream of version 0 whose bytes are all plain: each differs from the one before."""
    values = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
    assert len(values) <= 16
    before = np.vstack([values[:1] * 0, values[:-1]])
    delta = (values.astype(np.int64) - before + 128) % 256 - 128
    coded = np.zeros((16, values.shape[1]), np.uint8)
    coded[: len(values)] = np.where(delta < 0, -2 * delta - 1, 2 * delta).astype(np.uint8)
    blocks = b"".join(b"\x03" + coded[:, column].tobytes() for column in range(values.shape[1]))
    return b"\xa0" + blocks + bytes(max(values.shape[1], 32))


def test_attributes_are_those_that_were_encoded():
    assert decode_attributes(bytes_of(ATTRIBUTES), 17, 16).tobytes() == bytes_of(PLAIN)
    values = np.random.default_rng(0).integers(0, 256, (9, 12), np.uint8)
    assert np.array_equal(decode_attributes(stored(values), 9, 12), values)


def test_triangles_are_those_that_were_encoded_from_whatever_corner_they_begin():
    turned = [tuple(np.roll(row, -int(np.argmin(row)))) for row in decode_triangles(bytes_of(TRIANGLES), 24).reshape(-1, 3)]
    assert turned == [tuple(np.roll(row, -int(np.argmin(row)))) for row in GRID.reshape(-1, 3)]
    assert np.array_equal(decode_sequence(bytes_of(SEQUENCE), 24), GRID)


@pytest.mark.parametrize("name", DECODERS)
def test_every_prefix_and_every_longer_stream_is_refused(name):
    decode, text = DECODERS[name]
    data = bytes_of(text)
    assert decode(data) is not None and all(decode(data[:length]) is None for length in range(len(data)))
    assert decode(data[:-1] + b"\0" + data[-1:]) is None or name == "attributes" and decode(data + b"\0" * 40) is None


@pytest.mark.parametrize("name", DECODERS)
def test_noise_and_flipped_bits_end_in_an_array_or_none(name):
    decode, text = DECODERS[name]
    data, rng = bytes_of(text), np.random.default_rng(1)
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        found = decode(bytes(flipped))
        assert found is None or found.dtype in (np.uint8, np.uint32)
    for _ in range(200):
        decode(data[:1] + rng.integers(0, 256, int(rng.integers(1, 400)), np.uint8).tobytes())


def test_filters_are_undone():
    up = np.array([[0, 0, 127, 5], [127, 0, 127, 6], [0, -127, 127, 7], [-60, 40, 127, 8]], np.int8)
    up = unfilter("OCTAHEDRAL", up.view(np.uint8)).view(np.int8)
    assert up[:3, :3].tolist() == [[0, 0, 127], [127, 0, 0], [0, -127, 0]] and up[:, 3].tolist() == [5, 6, 7, 8]
    np.testing.assert_allclose(np.linalg.norm(up[:, :3].astype(float), axis=1), 127, atol=1)
    values = np.array([[0.5, -3.25, 1e-20, 7e20], [0, 1, -1, 0.1]], np.float32)
    np.testing.assert_allclose(unfilter("EXPONENTIAL", exponential(values).view(np.uint8)).view(np.float32), values, rtol=3e-7)
    turned = unfilter("QUATERNION", np.array([[0, 0, 0, 511 << 2 | 3], [511 << 2, 0, 0, 511 << 2 | 2]], np.int16).view(np.uint8))
    half = round(32767 * 0.5**0.5)
    assert np.abs(turned.view(np.int16) - [[0, 0, 0, 32767], [0, 0, half, half]]).max() <= 40


def packed_square(required=True, **more):
    """A square whose positions and UVs are compressed views."""
    builder = Builder()
    primitive = builder.primitive(positions=SQUARE * 3 - 1, indices=TWO.astype(np.uint32), uv=SQUARE_UV, material=None)
    for name, values, stride in (("POSITION", SQUARE * 3 - 1, 12), ("TEXCOORD_0", SQUARE_UV, 8)):
        compress(builder, primitive["attributes"][name], stored(np.asarray(values, np.float32)), "ATTRIBUTES", stride, **more)
    if required:
        builder.tree["extensionsRequired"] = [EXTENSION]
    return builder.with_buffers([{"byteLength": len(builder.blob)}, {"byteLength": 1 << 20}])


def test_a_compressed_glb_loads_without_a_package(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    scene = load_bytes(tmp_path, packed_square(), strict=True)
    assert np.allclose(np.sort(scene.positions[scene.faces], axis=1), np.sort((SQUARE * 3 - 1)[TWO], axis=1))


def test_version_1_without_the_package_names_the_command(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    with pytest.raises(TexfError, match='TXF-I30.*pip install "texfcodec.formats."'):
        decode_view(b"\xa1" + bytes(80), {"count": 4, "byteStride": 12, "mode": "ATTRIBUTES"}, {"byteLength": 48}, 0)
