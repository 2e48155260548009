"""Planar supports (clause 7.11): the codec against the naive decoder, and what its tools are worth where they should help."""

import io
from dataclasses import replace
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image

from conformance.reference.attributes import decode_values
from texfcodec.codecs.raht import attribute_coder, tool_choice
from texfcodec.codecs.raht.attribute_coder import CodedAttributes, Tools, dec_attributes, enc_attributes
from texfcodec.codecs.raht.coefficients.dct_blocks import jpeg_likeness
from texfcodec.codecs.raht.coefficients.residual import ResidualPlan
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.codecs.raht.raht_values import coded_of, raht_values
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.codecs.raht.transform.filter import CLASSES, stage_of, taps_of
from texfcodec.codecs.raht.transform.planar_rings import PLANAR_TAPS
from texfcodec.codecs.raht.transform.quantise import MAX_MEAN, _dequantise, step_of
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure
from texfcodec.errors import TexfError
from texfcodec.field.morton import decode_morton, encode_morton

ALL = {"planar": 1, "planar_transform": 1, "component_cross": 16}


def island_keys(depth, seed=1):
    """Texels of a few discs and of single points: full blocks, edges and blocks of every shape."""
    rng, side = np.random.default_rng(seed), 1 << depth
    y, x = np.mgrid[:side, :side]
    mask = rng.random((side, side)) < 0.04
    for cx, cy, radius in rng.uniform((0, 0, side / 8), (side, side, side / 3), (3, 3)):
        mask |= (x - cx) ** 2 + (y - cy) ** 2 < radius**2
    y, x = np.nonzero(mask)
    return np.sort(encode_morton(np.stack([x, y, np.zeros_like(x)], axis=1)))


def texture(keys, components, seed=2):
    """uint8 [N, C]: stripes along both axes and a diagonal, whose components go together, and noise."""
    rng, (x, y, _) = np.random.default_rng(seed), decode_morton(keys).T
    light = 60 * np.sign(np.sin(0.8 * x)) + 40 * np.sin(0.45 * y + 0.3 * x) + 25 * ((x + y) // 5 % 2)
    values = 128 + light[:, None] * np.array([1, 0.7, -0.4])[:components] + rng.normal(0, 4, (len(keys), components))
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def sliced():
    return patch.multiple(attribute_coder, WHOLE_VOXELS=1, SLICE_VOXELS=60, SLICE_NODES=8)


def coded_image(keys, depth, rgb, tools, qp=24, plan=None, threads=1):
    """(CodedAttributes, means or values) of texels uint8 [N, C]."""
    values = forward_colour(rgb) if rgb.shape[1] == 3 else forward_plain(rgb)
    return enc_attributes(keys, depth, values, [qp] * rgb.shape[1], tools, threads, plan)


def decoded_image(keys, depth, coded, stop=None, threads=1):
    data, ends = np.frombuffer(b"".join(coded.codewords), np.uint8), np.cumsum([0, *map(len, coded.codewords)]).tolist()
    inverse = inverse_colour if len(coded.qp) == 3 else inverse_plain
    return dec_attributes(keys, depth, coded, data, list(pairwise(ends)), depth if stop is None else stop, threads, inverse)


def naive_unit(coded: CodedAttributes, depth):
    """The unit as the reference decoder reads it."""
    stages = [{"mask": s.mask, "coefficients": taps_of(s)} for s in coded.filters]
    names = ("qp", "kernel", "colour_range", "slice_level", "slice_first", "codewords", "residual", "residual_cross",
             "planar", "planar_transform", "component_cross", "dct_blocks")
    return {**{name: getattr(coded, name) for name in names}, "depth": depth, "components": len(coded.qp), "filters": stages,
            "num_models": coded.models, "root_mean": coded.root, "colour_transform": int(len(coded.qp) == 3)}


@pytest.mark.parametrize("models", [0, 1, 2, 8])
@pytest.mark.parametrize("components, rotated, cross", [(3, 1, 16), (3, 0, 5), (3, 1, 0), (1, 1, 0)])
def test_planar_fields_decode_as_by_the_naive_decoder(components, rotated, cross, models):
    """With slices, a filter of any taps and a colour range; coarser levels too."""
    keys, depth, mask = island_keys(5), 5, (1 << CLASSES * components) - 1
    stage = stage_of(mask, np.random.default_rng(7).integers(-128, 128, PLANAR_TAPS * mask.bit_count()), components)
    tools = Tools(colour_range=4, models=models, filters=1, planar=1, planar_transform=rotated, component_cross=cross)
    with sliced(), patch.object(attribute_coder, "fit_stage", lambda *_: stage):
        coded, means = coded_image(keys, depth, texture(keys, components), tools)
    assert coded.filters and len(coded.slice_first) > 2 and coded.planar_transform == rotated and coded.component_cross == cross
    theirs = decode_values(naive_unit(coded, depth), keys.tolist())
    assert decoded_image(keys, depth, coded, threads=2).tobytes() == theirs
    assert (inverse_colour if components == 3 else inverse_plain)(means).tobytes() == theirs
    for lod in (1, 3):
        coarse = decode_values(naive_unit(coded, depth), keys.tolist(), lod)
        assert decoded_image(keys, depth, coded, depth - lod).tobytes() == coarse


@pytest.mark.parametrize("models", [0, 8])
@pytest.mark.parametrize("seed", range(4))
def test_random_codewords_of_planar_fields_decode_as_by_the_naive_decoder(models, seed):
    """Huge coefficients: every bound of clause 7.11 is reached, and no mean leaves its range."""
    rng, keys = np.random.default_rng(seed), island_keys(4, seed)
    coded = CodedAttributes([63, 0, 40], [1, *[255] * 6], 3, models, [], [1 << 20, -(1 << 20), 5], 0, [0],
                            [rng.bytes(4000)], [], **ALL)
    data = np.frombuffer(coded.codewords[0], np.uint8)
    means = dec_attributes(keys, 4, coded, data, [(0, len(data))], 4)
    assert np.abs(means).max() == MAX_MEAN
    assert inverse_colour(means).tobytes() == decode_values(naive_unit(coded, 4), keys.tolist())


def jpeg_texture(keys, components, seed=4, quality=60):
    """The same texture, and noise, as a JPEG file gives it back."""
    x, y, _ = decode_morton(keys).T
    image = np.zeros((y.max() + 1, x.max() + 1, 3), np.uint8)
    image[y, x] = np.clip(texture(keys, 3).astype(int) + np.random.default_rng(seed).integers(-30, 31, (len(keys), 1)), 0, 255)
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality, subsampling=0)
    return np.asarray(Image.open(file))[y, x][:, :components]


@pytest.mark.parametrize("components, models, depth, slice_level", [(3, 8, 6, 0), (1, 3, 6, 2), (3, 6, 6, 5), (2, 8, 3, 0)])
def test_dct_blocks_decode_as_by_the_naive_decoder(components, models, depth, slice_level):
    """With a filter and slices, above and below the blocks; all coarser levels too."""
    keys, mask = island_keys(depth), (1 << CLASSES * components) - 1
    if depth == 3:  # one block, the whole image
        keys = np.sort(encode_morton(np.stack([*np.divmod(np.arange(64), 8), np.zeros(64, np.int64)], axis=1)))
    stage = stage_of(mask, np.random.default_rng(8).integers(-128, 128, PLANAR_TAPS * mask.bit_count()), components)
    tools = Tools(colour_range=4, models=models, filters=1, dct_blocks=1, **ALL)
    halves = lambda levels, _: (slice_level, [0, len(levels[slice_level]) // 2] if slice_level else [0])
    with patch.multiple(attribute_coder, fit_stage=lambda *_: stage, _plan_slices=halves):
        coded, means = coded_image(keys, depth, jpeg_texture(keys, components), tools, qp=20)
    _, whole = np.unique(keys >> 9, return_counts=True)
    assert coded.dct_blocks and (whole == 64).any()
    for lod in range(depth + 1):
        theirs = decode_values(naive_unit(coded, depth), keys.tolist(), lod)
        assert decoded_image(keys, depth, coded, depth - lod, threads=2).tobytes() == theirs
    assert (inverse_colour if components == 3 else inverse_plain)(means).tobytes() == decoded_image(keys, depth, coded).tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_random_codewords_of_dct_blocks_decode_as_by_the_naive_decoder(seed):
    rng, keys = np.random.default_rng(seed), island_keys(6, seed)
    coded = CodedAttributes([63, 0, 40], [1, *[255] * 6], 3, 8, [], [1 << 20, -(1 << 20), 5], 0, [0], [rng.bytes(20000)], [],
                            dct_blocks=1, **ALL)
    data = np.frombuffer(coded.codewords[0], np.uint8)
    means = dec_attributes(keys, 6, coded, data, [(0, len(data))], 6)
    assert np.abs(means).max() == MAX_MEAN
    assert inverse_colour(means).tobytes() == decode_values(naive_unit(coded, 6), keys.tolist())


def test_what_was_a_jpeg_gets_dct_blocks_and_half_the_bytes():
    keys = island_keys(7)
    jpeg, other = jpeg_texture(keys, 3), texture(keys, 3)
    choose = lambda rgb: tool_choice.choose_tools(keys, 7, forward_colour(rgb), [16] * 3, "balanced", 1, True)
    assert jpeg_likeness(keys, forward_colour(jpeg)[:, 0]) < 0.1 and choose(jpeg).dct_blocks
    assert jpeg_likeness(keys, forward_colour(other)[:, 0]) > tool_choice.MOST_UNLIKE_JPEG and not choose(other).dct_blocks
    size = lambda **off: len(coded_image(keys, 7, jpeg, replace(choose(jpeg), **off), 16)[0].codewords[0])
    assert size() < 0.75 * size(dct_blocks=0)
    assert jpeg_likeness(keys[:500], forward_colour(jpeg)[:500, 0]) == np.inf


def test_an_estimate_tries_nothing_but_dct_blocks_where_they_may_pay(monkeypatch):
    keys, tried = island_keys(7), []
    cost = tool_choice._lagrangian_cost
    monkeypatch.setattr(tool_choice, "_lagrangian_cost", lambda *given: tried.append(given) or cost(*given))
    given = [16] * 3, "balanced", 1, True, None
    choose = lambda rgb, rough: tool_choice.choose_tools(keys, 7, forward_colour(rgb), *given, rough)
    jpeg, other = jpeg_texture(keys, 3), texture(keys, 3)
    assert choose(jpeg, True).dct_blocks and {given[2].dct_blocks for given in tried} == {0, 1}
    count = len(tried)
    choose(jpeg, False)
    assert len(tried) - count > 2 * count
    tried.clear()
    assert not choose(other, True).dct_blocks and not tried


def test_lossless_texels_that_were_a_jpeg_are_dct_blocks_underneath():
    keys = island_keys(7)
    rgb = jpeg_texture(keys, 3)
    field, plan = (keys, 7, forward_colour(rgb)), ResidualPlan(0, rgb, inverse_colour)
    qp, dct_blocks = tool_choice.choose_base(*field, lambda qp: [qp] * 3, plan, "balanced", 1, True)
    assert dct_blocks == 1 and qp[0] in tool_choice.DCT_BASE_QPS
    coded, made = enc_attributes(*field, qp, Tools(models=8, dct_blocks=1, **ALL), 1, plan)
    assert np.array_equal(made, rgb) and decoded_image(keys, 7, coded).tobytes() == rgb.tobytes()


@pytest.mark.parametrize("delta", [0, 3])
def test_planar_residuals_keep_their_bound_and_decode_as_by_the_naive_decoder(delta):
    keys, rgb = island_keys(5), texture(island_keys(5), 3)
    with sliced():
        coded, made = coded_image(keys, 5, rgb, Tools(models=6, filters=1, **ALL), 28, ResidualPlan(delta, rgb, inverse_colour))
    assert np.abs(made.astype(int) - rgb).max() == delta
    assert made.tobytes() == decoded_image(keys, 5, coded).tobytes() == decode_values(naive_unit(coded, 5), keys.tolist())


@pytest.mark.parametrize("tool", ["planar_transform", "component_cross"])
def test_each_tool_saves_bytes_on_stripes_whose_components_go_together(tool):
    """Bits and error, weighed as the encoder weighs them."""
    keys = island_keys(7)
    values, whole = forward_colour(texture(keys, 3)), tool_choice._piece(keys, slice(None), 1)
    costs = [tool_choice._lagrangian_cost(values, [28] * 3, Tools(models=8, **{**ALL, **off}), whole) for off in ({}, {tool: 0})]
    assert costs[0] < 0.99 * costs[1]


def test_the_choice_leaves_out_what_does_not_pay():
    """Checks of single texels: sums and differences of their splits are worse than the splits; their colour does not follow."""
    y, x = (v.ravel() for v in np.mgrid[:32, :32])
    keys = encode_morton(np.stack([x, y, np.zeros_like(x)], axis=1))
    order = np.argsort(keys)
    rng = np.random.default_rng(5)
    rgb = (rng.integers(0, 2, (len(keys), 3)) * 255).astype(np.uint8)[order]
    chosen = tool_choice.choose_tools(keys[order], 5, forward_colour(rgb), [28] * 3, "balanced", 1, True)
    assert chosen.planar == 1 and chosen.component_cross < 16
    voxels = tool_choice.choose_tools(keys[order], 5, forward_colour(rgb), [28] * 3, "balanced", 1)
    assert (voxels.planar, voxels.planar_transform) == (0, 0) and voxels.component_cross < 16


@pytest.mark.parametrize("components", [1, 3])
def test_parameters_are_read_as_written(components):
    keys = island_keys(3)
    coded, _ = coded_image(keys, 3, texture(keys, components), Tools(models=1, **ALL))
    around = {"resolution": 8, "NumComponents": components, "Planar": 1}
    data = write_structure(RAHT, {**raht_values(coded, components == 3), **around})
    again, _ = coded_of(read_structure(RAHT, Reader(data, 0, len(data)), dict(around)))
    assert (again.planar, again.planar_transform, again.component_cross) == (1, 1, 16 if components == 3 else 0)
    voxels = write_structure(RAHT, {**raht_values(coded, components == 3), **around, "Planar": 0})
    assert len(data) - len(voxels) == 2  # planar_transform and dct_blocks


@pytest.mark.parametrize("name, value", [("planar_transform", 2), ("component_cross", 17)])
def test_parameters_out_of_range_are_refused(name, value):
    keys, around = island_keys(3), {"resolution": 8, "NumComponents": 3, "Planar": 1}
    coded, _ = coded_image(keys, 3, texture(keys, 3), Tools(models=1, **ALL))
    data = bytearray(write_structure(RAHT, {**raht_values(coded, True), **around}))
    at = 1 + 3 + 7 + 1 + 1 + 2 * (name == "component_cross")
    assert data[at] == {"planar_transform": 1, "component_cross": 16}[name]
    data[at] = value
    with pytest.raises(TexfError) as caught:
        read_structure(RAHT, Reader(bytes(data), 0, len(data)), dict(around))
    assert caught.value.code == ("TXF-U09" if name == "planar_transform" else "TXF-S04")


def test_halved_gain_gives_sum_and_difference_of_a_rotated_pair():
    """An orthonormal pair (a, b) comes from its rotation: ((s - d) / sqrt 2, (s + d) / sqrt 2), to a unit in the last place."""
    step = step_of(28)
    for s, d in ((5, 0), (3, -4), (-7, 7), (1 << 21, 1 << 21)):
        for q in (s - d, s + d):
            exact = q * step * np.sqrt(1 / 4 + 1 / 9) / np.sqrt(2)
            assert abs(int(_dequantise(q, step, 4, 9, 1)) - np.clip(exact, -(2**22 - 1), 2**22 - 1)) <= 1 + abs(exact) / 2**15
