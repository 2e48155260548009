"""Fields of some sixty values through both sides of the coder: small enough to run where kernels are plain Python, which is how
`make -C tools coverage` sees their branches."""

from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest

from texfcodec.codecs.neural.transport import dec_transport, enc_transport
from texfcodec.codecs.raht import attribute_coder
from texfcodec.codecs.raht.attribute_coder import Tools, dec_attributes, enc_attributes
from texfcodec.codecs.raht.coefficients.residual import ResidualPlan
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.errors import LimitError
from texfcodec.field import voxelise as voxelise_room
from texfcodec.field.morton import encode_morton
from texfcodec.field.voxelise import voxelise

PLANAR = {"planar": 1, "planar_transform": 1, "component_cross": 9}
DEPTH = 3
EVERY_BIT = 1e-4  # a trade-off at which every coefficient and every filter is worth its bits


def tiny_field(components, planar=0, seed=4):
    """(keys, values uint8 [N, C]): a slope with noise on a square of texels, or on a bent sheet of voxels."""
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[:8, :8].reshape(2, -1)
    keys = encode_morton(np.stack([x, y, np.zeros_like(x) if planar else (x + y) // 3], axis=1))
    keep, order = rng.random(64) < 0.9, np.argsort(keys)
    values = 20 * x[:, None] + 8 * y[:, None] * np.array([1, -0.5, 0.3])[:components] + rng.normal(60, 9, (64, components))
    return keys[order][keep[order]], values[order][keep[order]].clip(0, 255).astype(np.uint8)


def there_and_back(components, tools, qp, delta=None):
    """(values, coded, what the encoder says will be decoded) of a tiny field that the decoder has decoded to just that."""
    keys, values = tiny_field(components, tools.planar)
    forward, inverse = (forward_colour, inverse_colour) if components == 3 else (forward_plain, inverse_plain)
    plan = None if delta is None else ResidualPlan(delta, values, inverse)
    coded, made = enc_attributes(keys, DEPTH, forward(values), [qp] * components, tools, 1, plan)
    data, ends = np.frombuffer(b"".join(coded.codewords), np.uint8), np.cumsum([0, *map(len, coded.codewords)]).tolist()
    decoded = dec_attributes(keys, DEPTH, coded, data, list(pairwise(ends)), DEPTH, 1, None if plan is None else inverse, [])
    np.testing.assert_array_equal(decoded, made)
    return values, coded, made


@pytest.mark.parametrize("components", [1, 2, 3])
@pytest.mark.parametrize("tools", [{}, {"colour_range": 5}, {"models": 1}, {"models": 8, "colour_range": 3, "kernel": (9,) * 7},
                                   PLANAR, PLANAR | {"models": 6}], ids=str)
def test_tiny_fields_come_back_with_every_tool(components, tools):
    values, _, made = there_and_back(components, Tools(**tools), 16)
    inverse = inverse_colour if components == 3 else inverse_plain
    assert np.abs(inverse(made).astype(int) - values).max() <= 12


@pytest.mark.parametrize("models", [0, 8])
def test_tiny_fields_come_back_at_every_step(models):
    """From escapes of the largest coefficients to blocks of which nothing is coded."""
    finest, middle, coarsest = (sum(map(len, there_and_back(3, Tools(models=models), qp)[1].codewords)) for qp in (0, 40, 63))
    assert finest > 10 * middle > 10 * coarsest


@pytest.mark.parametrize("planar", [{}, PLANAR])
def test_tiny_fields_are_filtered_where_a_bit_is_cheap(planar):
    _, coded, _ = there_and_back(3, Tools(models=2, filters=2, trade_off=EVERY_BIT, **planar), 34)
    assert coded.filters
    _, coded, _ = there_and_back(3, Tools(models=2, filters=2, trade_off=1e9, **planar), 34)
    assert not coded.filters


@pytest.mark.parametrize("delta", [0, 1, 4, 127])
@pytest.mark.parametrize("components", [1, 2, 3])
@pytest.mark.parametrize("planar", [{}, PLANAR])
def test_no_value_of_a_tiny_field_is_further_off_than_its_bound(components, delta, planar):
    values, _, made = there_and_back(components, Tools(models=2, **planar), 28, delta)
    assert np.abs(made.astype(int) - values).max() <= delta


@pytest.mark.parametrize("models", [0, 6])
def test_slices_and_buffers_of_any_size_make_no_difference_to_the_decoder(models):
    plain = there_and_back(3, Tools(models=models), 4)[1]
    with patch.multiple(attribute_coder, WHOLE_VOXELS=1, SLICE_VOXELS=8, SLICE_NODES=2):
        assert len(there_and_back(3, Tools(models=models), 4, 0)[1].codewords) > 2
    with patch.multiple(attribute_coder, FIRST_ROOM=6, FEW_SYMBOLS=0):  # too little: some levels are coded again
        assert there_and_back(3, Tools(models=models), 4)[1] == plain


def test_latents_come_back_in_their_transport_form():
    codes = np.random.default_rng(1).integers(-8, 8, (9, 3)).astype(np.int8)
    codes[:2] = [[-8], [7]]
    assert dec_transport(enc_transport(codes), 9, 3).tolist() == codes.tolist()


def test_tiny_surfaces_are_voxelised_alike_in_slabs_and_refused_over_a_limit(monkeypatch):
    lattice = np.array([[0, 0, 0], [255, 0, 9], [0, 255, 30], [255, 255, 255], [90, 0, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2], [0, 4, 4]])
    keys, weights = voxelise(lattice, faces, 8, 6)
    monkeypatch.setattr(voxelise_room, "MIN_SLAB_SAMPLES", 9)
    for a, b in zip((keys, weights), voxelise(lattice, faces, 8, 6, threads=3), strict=True):
        assert a.tolist() == b.tolist()
    for threads in (1, 3):
        assert len(voxelise(lattice, faces, 8, 6, threads=threads, max_voxels=len(keys))[0]) == len(keys)
        with pytest.raises(LimitError):
            voxelise(lattice, faces, 8, 6, threads=threads, max_voxels=3)
