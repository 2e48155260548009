"""Codec constant: taken exactly where a plane has one value, exact at every level of detail, and a few bytes long."""

from unittest.mock import patch

import numpy as np
import pytest
from shapes import painted_sphere, scene_of, sphere, square

from texfcodec import DecodeOptions, EncodeOptions, Limits, decode, encode, encode_to_result, inspect
from texfcodec.bitstream.stream import read_stream
from texfcodec.codecs import codec_of
from texfcodec.encoder.values.coder import codec_for
from texfcodec.field.voxels import VoxelSupport
from texfcodec.scene.scene import ALPHA_BLEND, Material

CONSTANT = codec_of("constant")
VEIL = Material("veil", alpha_mode=ALPHA_BLEND)


def uniform_sphere(alpha=1.0):
    """A sphere in one colour, of one alpha."""
    positions, faces = sphere()
    colours = np.tile(np.array([0.5, 0.2, 0.05, alpha], np.float32), (len(positions), 1))
    return scene_of(positions, faces, colours, materials=[VEIL] if alpha < 1 else None)


def codecs_of(data):
    return [group["codec"] for group in inspect(data)["groups"]]


def as_asked(scene, options):
    """The stream without codec constant, and what it decodes to."""
    with patch("texfcodec.encoder.values.coder.codec_for", lambda plane, asked: asked):
        return encode(scene, options)


@pytest.mark.parametrize("values, suits", [
    ([119.6, 120.4], True),
    ([120.4, 120.6], False),
    ([119.5, 120.0, 120.5], True),  # halves go to the even one, as the lossless coding of RAHT has it
    ([120.5, 121.5], False),
    ([120.4999, 120.5001], False),
    ([0.0, 0.5], True),
    ([254.6, 255.0], True),
    ([7.0], True),
])
def test_plane_suits_where_its_rounded_values_are_equal(values, suits):
    plane = np.tile(np.array(values, np.float32)[:, None], (1, 3))
    assert CONSTANT.suits(plane) is suits
    asked = codec_of("raht")
    assert codec_for(plane, asked) is (CONSTANT if suits else asked)


@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 1000, 4097])
def test_a_single_other_value_anywhere_is_seen(count):
    rng = np.random.default_rng(count)
    for place in {0, count - 1, *rng.integers(0, count, 20).tolist()}:
        for component in range(3):
            plane = rng.uniform(99.51, 100.49, (count, 3)).astype(np.float32)
            assert CONSTANT.suits(plane)
            plane[place, component] = 100.51
            assert CONSTANT.suits(plane) is (count == 1)


@pytest.mark.parametrize("value", [[0, 0, 0], [255, 255, 255], [1, 128, 254], [7]])
def test_what_is_coded_comes_back_at_every_level(value):
    support = VoxelSupport(8, np.sort(np.random.default_rng(0).choice(512, 90, replace=False)))
    plane = np.tile(np.array(value, np.float32), (90, 1)) + np.float32(0.3)
    values, decoded = CONSTANT.enc(np.clip(plane, 0, 255), support, EncodeOptions())
    for levels in range(6):
        got = CONSTANT.dec(values, support, levels, 1)
        assert got.dtype == np.uint8 and got.shape == (len(support.coarser(levels)), len(value)) and (got == value).all()
    assert np.array_equal(decoded, CONSTANT.dec(values, support, 0, 1)) and CONSTANT.describe(values) == {"value": value}


@pytest.mark.parametrize("choices", [{"qp": 40}, {"lossless": True}, {"max_error": 3}, {"qp": 20, "refine": "fit"}])
def test_asset_of_one_colour_is_exact(choices):
    scene = uniform_sphere()
    data = encode(scene, EncodeOptions(resolution=32, **choices))
    exact = decode(as_asked(scene, EncodeOptions(resolution=32, lossless=True)))
    assert codecs_of(data) == ["constant"]
    for one, other in zip(decode(data).fields, exact.fields, strict=True):
        assert np.array_equal(one.keys, other.keys) and np.array_equal(one.rgba, other.rgba)


@pytest.mark.parametrize("lod", range(8))
def test_levels_of_detail_have_the_same_value(lod):
    data = encode(uniform_sphere(0.4), EncodeOptions(resolution=33, qp=30))
    assert codecs_of(data) == ["constant", "constant"]
    (whole,), (part,) = decode(data).fields, decode(data, DecodeOptions(lod=lod)).fields
    assert np.array_equal(part.keys, whole.support.coarser(lod).keys)
    assert (part.rgba == whole.rgba[0]).all() and len(part.rgba) == len(part.keys)


def test_constant_alpha_stands_beside_coded_colour():
    scene = painted_sphere()
    scene.materials = [VEIL]
    scene.corner_color[..., 3] = 0.4
    options = EncodeOptions(resolution=32, lossless=True)
    data, wanted = encode(scene, options), decode(as_asked(scene, options))
    assert codecs_of(data) == ["raht", "constant"]
    assert np.array_equal(decode(data).fields[0].rgba, wanted.fields[0].rgba) and (wanted.fields[0].rgba[:, 3] == 102).all()


def test_one_colour_makes_the_attributes_a_few_bytes():
    scene, options = uniform_sphere(), EncodeOptions(resolution=128, qp=28)
    ours = encode_to_result(scene, options).sizes
    with patch("texfcodec.encoder.values.coder.codec_for", lambda plane, asked: asked):
        before = encode_to_result(scene, options).sizes
    assert ours["attributes"] == 6 + 11 <= before["attributes"] // 3  # frame and unit
    assert {name: ours[name] for name in ("geometry", "other")} == {name: before[name] for name in ("geometry", "other")}


def test_points_of_a_constant_field_have_its_colour():
    texf = decode(encode(uniform_sphere(0.4), EncodeOptions(resolution=32, qp=30)))
    (field,) = texf.fields
    assert (texf.query(texf.positions) == field.rgba[0]).all()
    coarse = decode(encode(uniform_sphere(), EncodeOptions(resolution=32, qp=30)), DecodeOptions(lod=3))
    assert (coarse.query(coarse.positions) == [*coarse.fields[0].rgba[0, :3], 255]).all()


@pytest.mark.slow
def test_search_ends_with_a_constant_stream():
    scene = scene_of(*square(), np.tile(np.array([0.2, 0.3, 0.4, 1], np.float32), (4, 1)))
    made = encode_to_result(scene, EncodeOptions(target_bytes=400))
    assert codecs_of(made.data) == ["constant"] and len(made.data) <= 400
    assert read_stream(made.data, Limits()).attributes[0]["plane_value"] == decode(made.data).fields[0].rgba[0, :3].tolist()
