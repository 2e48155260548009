"""Residuals (clause 7.9): lossless and near-lossless fields, from the codec to the command line."""

import json
from dataclasses import replace
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
import shapes
from interrupts import TETRAHEDRON

from conformance.reference.decoder import decode as naive_decode
from texfcodec import EncodeOptions, decode
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.codecs.raht import attribute_coder
from texfcodec.codecs.raht.coefficients.residual import MAX_CROSS, ResidualPlan
from texfcodec.codecs.raht.tool_choice import BASE_QPS
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.encoder.encode import Encoder, encode_scene
from texfcodec.encoder.write import write
from texfcodec.errors import StreamError
from texfcodec.io.load import load
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions
from texfcodec.report import Report

SLICES = {"WHOLE_VOXELS": 1, "SLICE_VOXELS": 300, "SLICE_NODES": 16}


@pytest.fixture
def sliced(monkeypatch):
    """Small fields in many slices."""
    for name, value in SLICES.items():
        monkeypatch.setattr(attribute_coder, name, value)


def prepared_scene(scene, **choices):
    """(Plan, function from a max_error to the stream)."""
    prepared = Encoder(scene=scene).filled(EncodeOptions(max_error=0, threads=2, **choices), Report())

    def coded(bound):
        coder = prepared.price.planes.at(max_error=bound)
        return write(replace(prepared, price=replace(prepared.price, coder=coder)), Report()).data

    return prepared, coded


def rgba_of(field):
    alpha = field.planes.get("alpha", np.full((len(field.keys), 1), 255, np.float32))
    return np.column_stack([field.planes["base_colour"], alpha])


def sources(prepared):
    """The rounded colours of all fields with alpha: int64 [N, 4]."""
    return np.concatenate([np.rint(rgba_of(f)) for f in prepared.fields]).astype(np.int64)


def colours(data):
    return np.concatenate([f.rgba for f in decode(data).fields]).astype(np.int64)


def assert_naive_agrees(data):
    ours, naive = decode(data), naive_decode(data)
    for mine, theirs in zip(ours.fields, naive["fields"], strict=True):
        assert mine.keys.tolist() == theirs["keys"]
        assert mine.rgba[:, :3].tobytes() == theirs["values"][0]
        if len(theirs["values"]) > 1:
            assert mine.rgba[:, 3].tobytes() == theirs["values"][1]


def field(components, count=1200, depth=5, seed=3):
    """(keys, values uint8) of a random field: half of it smooth, half of it noise."""
    rng = np.random.default_rng(seed)
    keys = np.sort(rng.choice(1 << 3 * depth, count, replace=False))
    smooth = 128 + 90 * np.sin(keys[:, None] / (3000 + 800 * np.arange(components)))
    noise = rng.integers(0, 256, (count, components))
    return keys, np.where(np.arange(count)[:, None] < count // 2, smooth, noise).astype(np.uint8)


def coded_field(keys, values, delta, depth=5, qp=28, threads=1, models=6):
    colour = values.shape[1] == 3
    inverse = inverse_colour if colour else inverse_plain
    tools = attribute_coder.Tools(colour_range=5, models=models, filters=1)
    means = (forward_colour if colour else forward_plain)(values)
    plan = ResidualPlan(delta, values, inverse)
    return attribute_coder.enc_attributes(keys, depth, means, [qp] * values.shape[1], tools, threads, plan)


def decoded_field(keys, coded, codewords, depth=5, stop=5, threads=1):
    data, ends = np.frombuffer(b"".join(codewords), np.uint8), np.cumsum([0, *map(len, codewords)]).tolist()
    inverse = inverse_colour if len(coded.qp) == 3 else inverse_plain
    return attribute_coder.dec_attributes(keys, depth, coded, data, list(pairwise(ends)), stop, threads, inverse)


@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_lossless_gives_back_every_rounded_colour_and_alpha(effort):
    prepared, code = prepared_scene(shapes.crossing_sheets(), resolution=48, effort=effort)
    assert (colours(code(0)) == sources(prepared)).all()


def test_lossless_keeps_a_single_voxel():
    prepared, code = prepared_scene(shapes.painted_sphere(), resolution=1)
    with patch("texfcodec.encoder.values.coder.codec_for", lambda plane, asked: asked):
        data = code(0)
    assert read_stream(data, Limits()).attributes[0]["residual"] == 0
    assert (colours(data) == sources(prepared)).all()


def test_no_value_is_further_off_than_the_bound_and_bytes_fall_with_it():
    prepared, code = prepared_scene(shapes.painted_sphere(16), resolution=64, area_threshold=0)
    source, sizes = sources(prepared), []
    for bound in (0, 1, 2, 7):
        data = code(bound)
        assert np.abs(colours(data) - source).max() <= bound
        sizes.append(len(data))
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) == len(sizes)


@pytest.mark.parametrize("bound", [0, 2])
def test_the_naive_decoder_agrees_on_colour_and_alpha(bound):
    _, code = prepared_scene(shapes.crossing_sheets(), resolution=18, partition="off")
    assert_naive_agrees(code(bound))


@pytest.mark.usefixtures("sliced")
def test_the_naive_decoder_agrees_with_slices():
    prepared, code = prepared_scene(shapes.crossing_sheets(), resolution=18, partition="off")
    data = code(1)
    assert read_stream(data, Limits()).attributes[0]["NumSlices"] > 1
    assert_naive_agrees(data)
    assert np.abs(colours(data) - sources(prepared)).max() == 1


@pytest.mark.usefixtures("sliced")
@pytest.mark.parametrize("delta", [0, 4])
def test_codewords_and_values_do_not_depend_on_threads(delta):
    keys, values = field(3, 3000)
    (one, made), (four, again) = (coded_field(keys, values, delta, threads=n) for n in (1, 4))
    assert one.codewords == four.codewords and len(one.codewords) > 3 and (made == again).all()
    assert (decoded_field(keys, one, one.codewords, threads=3) == made).all()


@pytest.mark.parametrize("components, models", [(1, 6), (3, 6), (3, 0)])
def test_any_bytes_decode_to_values(components, models):
    keys, values = field(components, 700)
    coded, _ = coded_field(keys, values, 3, models=models)
    rng = np.random.default_rng(5)
    for data in (b"", bytes(4000), b"\xff" * 4000, *(rng.bytes(n) for n in (1, 100, 4000, 20000)),
                 coded.codewords[0][:300] + bytes(9000)):
        for coded.residual in (1, 4, 128):
            coded.residual_cross = [MAX_CROSS] * components
            made = decoded_field(keys, coded, [data])
            assert made.dtype == np.uint8 and made.shape == values.shape


def test_levels_of_detail_are_those_without_residuals():
    keys, values = field(3)
    coded, _ = coded_field(keys, values, 0)
    coarse = decoded_field(keys, coded, coded.codewords, stop=4)
    coded.residual = 0
    assert (decoded_field(keys, coded, coded.codewords, stop=4) == coarse).all()


def test_a_broken_residual_is_found_by_the_checksum():
    _, code = prepared_scene(shapes.painted_sphere(), resolution=24)
    stream = read_stream(code(0), Limits())
    stream.attributes[0]["values_crc"] ^= 1
    assert len(decode(write_stream(stream)[0], DecodeOptions(lod=1)).fields[0].keys) > 1
    with pytest.raises(StreamError, match="checksum"):
        decode(write_stream(stream)[0])


def test_equal_components_are_predicted_from_the_first():
    keys, values = field(1)
    coded, made = coded_field(keys, np.repeat(values, 3, axis=1), 0)
    alone, _ = coded_field(keys, values, 0)
    assert coded.residual_cross == [MAX_CROSS, 0, MAX_CROSS] and (made[:, :1] == values).all()
    assert len(coded.codewords[0]) < 1.6 * len(alone.codewords[0])


def test_the_encoder_sets_a_qp_of_its_candidates():
    data = encode_scene(shapes.painted_sphere(), EncodeOptions(max_error=0, resolution=40, chroma_qp_offset=0)).data
    assert {*read_stream(data, Limits()).attributes[0]["qp"]} <= {*BASE_QPS}


@pytest.fixture
def mesh(tmp_path):
    """A tetrahedron with vertex colours as PLY."""
    (tmp_path / "tetra.ply").write_text(TETRAHEDRON)
    return tmp_path / "tetra.ply"


@pytest.mark.parametrize("flags, bound, word", [(["--lossless"], 0, "lossless"), (["--near-lossless", 3], 3, "maximum error 3")])
def test_the_command_line_codes_within_the_bound_and_says_so(mesh, call, flags, bound, word):
    out = mesh.with_suffix(".texf")
    code, said, _ = call("texf-enc", mesh, out, "--resolution", 32, *flags)
    assert code == 0 and f"K 32, {word}, " in said
    prepared, _ = prepared_scene(load(mesh), resolution=32)
    assert np.abs(colours(out.read_bytes()) - sources(prepared)).max() <= bound
    elements = [row for unit in json.loads(call("texf-info", out, "--json")[1])["units"] for row in unit["elements"]]
    assert {row["value"] for row in elements if row["name"] == "residual"} == {bound + 1}


@pytest.mark.parametrize("flags", [("--lossless", "--near-lossless", 1), ("--lossless", "--qp", 20),
                                   ("--near-lossless", 2, "--target-bytes", 9000), ("--lossless", "--target-psnr", 40)])
def test_flags_that_exclude_a_bound_are_refused_by_name(mesh, call, flags):
    code, _, said = call("texf-enc", mesh, mesh.with_suffix(".texf"), *flags)
    assert code == 2 and "TXF-I50" in said and all(flag in said for flag in flags if str(flag).startswith("--"))
    assert not mesh.with_suffix(".texf").exists()
