"""Components that follow the first over voxels (clause 7.4.4): the codec against the naive decoder, and what it is worth."""

import numpy as np
import pytest
from test_planar import coded_image, decoded_image, naive_unit, sliced

from conformance.reference import following
from conformance.reference.attributes import decode_values
from texfcodec.codecs.raht import tool_choice
from texfcodec.codecs.raht.attribute_coder import CodedAttributes, Tools, dec_attributes
from texfcodec.codecs.raht.transform.colour import forward_colour, inverse_colour
from texfcodec.codecs.raht.transform.quantise import MAX_MEAN
from texfcodec.field.morton import decode_morton, encode_morton


def bowl_keys(depth):
    """Voxels of a bowl and of single points around it."""
    side = 1 << depth
    rng, (x, y) = np.random.default_rng(3), np.mgrid[:side, :side]
    z = ((x - side / 2) ** 2 + (y - side / 3) ** 2) / side
    points = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3), rng.integers(0, side, (side, 3))]).astype(np.int64)
    return np.unique(encode_morton(points[points.max(axis=1) < side]))


def stripes(keys, components, slope=0.7):
    """uint8 [N, C]: stripes and noise; what the first component does the others do `slope` times as much, or against it."""
    rng, (x, y, z) = np.random.default_rng(4), decode_morton(keys).T
    light = 60 * np.sign(np.sin(0.8 * x + 0.3 * z)) + 40 * np.sin(0.45 * y)
    values = 128 + light[:, None] * np.array([1, slope, -slope])[:components] + rng.normal(0, 4, (len(keys), components))
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("components, cross", [(3, 16), (3, 5), (2, 16)])
@pytest.mark.parametrize("models", [0, 8])
def test_voxels_decode_as_by_the_naive_decoder(models, components, cross):
    """With slices and a colour range; coarser levels too."""
    keys = bowl_keys(5)
    with sliced():
        coded, _ = coded_image(keys, 5, stripes(keys, components), Tools(colour_range=4, models=models, component_cross=cross))
    assert coded.component_cross == cross and len(coded.slice_first) > 2 and not coded.planar
    for lod in (0, 2):
        theirs = decode_values(naive_unit(coded, 5), keys.tolist(), lod)
        assert decoded_image(keys, 5, coded, 5 - lod, threads=2).tobytes() == theirs


@pytest.mark.parametrize("seed", range(3))
def test_random_codewords_decode_as_by_the_naive_decoder(monkeypatch, seed):
    """Every bound of the clause is reached, and no mean leaves its range."""
    reached, clip = set(), following.clip

    def watched(low, high, value):
        reached.update({low} if value < low else {high} if value > high else ())
        return clip(low, high, value)

    monkeypatch.setattr(following, "clip", watched)
    rng, keys = np.random.default_rng(seed), bowl_keys(4)
    coded = CodedAttributes([16, 63, 40], [1, *[255] * 6], 3, 8, [], [1 << 20, -(1 << 20), 5], 0, [0], [rng.bytes(9000)], [],
                            component_cross=16)
    data = np.frombuffer(coded.codewords[0], np.uint8)
    means = dec_attributes(keys, 4, coded, data, [(0, len(data))], 4)
    assert inverse_colour(means).tobytes() == decode_values(naive_unit(coded, 4), keys.tolist())
    assert np.abs(means).max() == MAX_MEAN and {-512, 512} <= reached


def test_it_saves_bytes_where_components_go_together_and_is_weaker_where_they_do_not():
    keys = bowl_keys(6)
    values, whole = forward_colour(stripes(keys, 3)), tool_choice._piece(keys, slice(None), 0)
    costs = [tool_choice._lagrangian_cost(values, [28] * 3, Tools(models=8, component_cross=cross), whole) for cross in (16, 0)]
    assert costs[0] < 0.97 * costs[1]
    noise = np.random.default_rng(5).integers(0, 2, (len(keys), 3)).astype(np.uint8) * 255
    assert tool_choice.choose_tools(keys, 6, forward_colour(noise), [28] * 3, "balanced").component_cross < 16
