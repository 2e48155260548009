"""RAHT: kernels against oracles, the error of the fixed-point transform, and round trips of the codec."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from oracles import kernels as oracles
from texfcodec.codecs.raht import attribute_coder as codec_room
from texfcodec.codecs.raht.attribute_coder import Tools, dec_attributes, enc_attributes
from texfcodec.codecs.raht.codewords import codeword_count, level_count
from texfcodec.codecs.raht.coefficients.blocks import _plane_energy
from texfcodec.codecs.raht.entropy.contexts import (
    CONTEXTS,
    _classes,
    _dec_magnitude,
    _enc_magnitude,
    _magnitude_cost,
    _surroundings,
)
from texfcodec.codecs.raht.entropy.range_coder import (
    PENDING,
    _dec_bit,
    _dec_bypass,
    _enc_bit,
    _enc_bypass,
    finish,
    new_contexts,
    new_decoder,
    new_encoder,
)
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.codecs.raht.transform.octree import Nodes, Octree, build_octree
from texfcodec.codecs.raht.transform.prediction import DEFAULT_KERNEL, Means, _predict, inverse_range
from texfcodec.codecs.raht.transform.quantise import MAX_DIFFERENCE, MAX_MEAN, STEP_TABLE, _dequantise, step_of
from texfcodec.codecs.raht.transform.raht import _inverse, _tree_weights, _weighted_mean
from texfcodec.errors import StreamError
from texfcodec.field.morton import encode_morton

ULP_PER_LEVEL = 2  # three split roundings and one of the prediction's mean, half a unit each
UNIT = 4096  # one grey level in fixed point
FRESH = (1 << 21, 1 << 21, 0)  # a context that no bit has met


def random_keys(rng, depth, count, planar=0):
    return np.unique(encode_morton(rng.integers(0, 1 << depth, (count, 3)) * [1, 1, 1 - planar]))


def surface_keys(depth):
    """Voxels of a sphere-like shell: every level has full and thin nodes."""
    side = 1 << depth
    xyz = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    radius = np.linalg.norm(xyz - (side - 1) / 2, axis=1)
    return np.sort(encode_morton(xyz[np.abs(radius - side * 0.45) < 0.6]))


# Octree


@pytest.mark.parametrize("depth,count", [(0, 1), (1, 8), (2, 5), (3, 200), (13, 300)])
def test_levels_nodes_and_weights_are_those_of_the_keys(depth, count):
    keys = random_keys(np.random.default_rng(depth), depth, count)
    levels = build_octree(keys, depth)
    assert len(levels) == depth + 1
    for number, level in enumerate(levels):
        nodes = oracles.level_nodes(keys.tolist(), depth, number)
        assert level.weight.tolist() == list(nodes.values())
        assert level.octant.tolist() == [v & 7 for v in nodes]
        if number < depth:
            below = list(oracles.level_nodes(keys.tolist(), depth, number + 1))
            for i, value in enumerate(nodes):
                mine = below[level.first_child[i] : level.first_child[i + 1]]
                assert [v >> 3 for v in mine] == [value] * len(mine)
                assert level.occupancy[i] == sum(1 << (v & 7) for v in mine)


def table_of(nodes, planar):
    """The neighbour table of nodes, as the codec keeps it; where it is planar, nothing is above or below."""
    table = np.array(oracles.neighbours(nodes), np.int32)
    assert not planar or (np.delete(table, range(1, 27, 3), axis=1) == -1).all()
    return table[:, 1::3] if planar else table


@pytest.mark.parametrize("planar", [0, 1])
@pytest.mark.parametrize("depth,count", [(1, 8), (3, 150), (4, 900), (13, 200)])
def test_the_neighbour_table_of_every_level_is_the_dict_of_coordinates(depth, count, planar):
    keys = random_keys(np.random.default_rng(count), depth, count, planar)
    octree = Octree(keys, depth, planar)
    for number in range(depth + 1):
        above = len(octree.levels[max(number - 1, 0)])
        table = octree.table(number, [(0, above // 2), (above // 2, above)])  # made in two ranges, as slices do
        assert table.tolist() == table_of(list(oracles.level_nodes(keys.tolist(), depth, number)), planar).tolist()
    assert Octree(keys, depth, planar).table(depth).tolist() == table.tolist()  # all levels at once


def test_a_table_that_another_thread_has_made_meanwhile_stays():
    """It was taken away, and the other thread found none: an IndexError, now and then, where parts are coded side by side."""
    octree, deeper = Octree(random_keys(np.random.default_rng(3), 6, 300, 0), 6), []

    def late(jobs):
        for job in jobs:
            job()
        deeper.append(octree.table(5))  # as another thread does before this one is done

    octree.table(3, run=late)
    assert octree.table(5) is deeper[0] and octree.table(5).tolist() == Octree(octree.keys, 6).table(5).tolist()


def test_codeword_and_level_counts_follow_the_slicing():
    assert [codeword_count(*a) for a in ((0, 0, 1), (5, 0, 1), (5, 3, 4))] == [0, 1, 5]
    assert [level_count(*a) for a in ((5, 0, 0), (5, 3, 0), (5, 3, 1))] == [5, 3, 2]


# Prediction


KERNELS = [DEFAULT_KERNEL, (1, 0, 0, 0, 0, 0, 0), (255,) * 7, (7, 3, 2, 1, 30, 20, 9)]


@pytest.mark.parametrize("colour_range", [0, 1, 255])
@pytest.mark.parametrize("components", [1, 2, 3])
@pytest.mark.parametrize("seed,kernel", list(enumerate(KERNELS)))
@pytest.mark.parametrize("planar", [0, 1])
def test_predictions_are_the_oracles_for_every_node_and_two_slice_starts(seed, kernel, components, colour_range, planar):
    rng, depth, step = np.random.default_rng(seed), 4 if planar else 3, step_of(40)
    keys = random_keys(rng, depth, 160 if planar else 220, planar)
    levels = build_octree(keys, depth)
    parents, children = (list(oracles.level_nodes(keys.tolist(), depth, d)) for d in (depth - 1, depth))
    table = table_of(parents, planar)
    parent_mean, child_mean = (rng.integers(-MAX_MEAN, MAX_MEAN + 1, (len(v), components)).astype(np.int32)
                               for v in (parents, children))
    nodes = Nodes(levels[depth - 1].first_child, levels[depth - 1].occupancy, levels[depth].weight, table, planar)
    around = np.full((8, 4), -99, np.int64)
    for first in (0, len(parents) // 2):
        for p in range(first, len(parents), 3):
            got = np.full((9, components), -99, np.int64)  # a row beyond the octants', which nobody may write
            _predict(p, first, nodes, Means(parent_mean, child_mean), np.array(kernel, np.int64),
                     inverse_range(colour_range, step), around, got[:8])
            assert (got[8] == -99).all()
            expected = oracles.predict(p, first, parents, children, parent_mean.tolist(), child_mean.tolist(), kernel,
                                       colour_range, step)
            assert {octant: got[octant].tolist() for octant in expected} == expected


# Quantisation


def test_steps_follow_the_qp_within_a_5000th():
    for qp in range(64):
        assert step_of(qp) == oracles.step(qp)
        assert abs(step_of(qp) / UNIT / 2 ** ((qp - 4) / 6) - 1) < 1 / 5000
    assert STEP_TABLE == oracles.STEP_TABLE and step_of(4) == UNIT


WEIGHT = st.one_of(st.integers(1, 1 << 26), st.integers(1, 9), st.sampled_from([1 << 26, (1 << 26) - 1]))
MAGNITUDE = st.one_of(st.integers(-(1 << 25), 1 << 25), st.integers(-20, 20))


@settings(deadline=None, max_examples=400)
@given(MAGNITUDE, st.integers(0, 63), WEIGHT, WEIGHT)
def test_differences_are_the_oracles(q, qp, w1, w2):
    """How far they are off stands in test_transform_bounds.py."""
    got = int(_dequantise(q, step_of(qp), w1, w2))
    assert got == oracles.dequantise(q, step_of(qp), w1, w2) and abs(got) <= MAX_DIFFERENCE


# Transform


BLOCK = st.dictionaries(st.integers(0, 7), WEIGHT.map(lambda w: max(1, w >> 3)), min_size=1, max_size=8)
MEAN = st.integers(-MAX_MEAN, MAX_MEAN)


def tree_of(weights):
    tree = np.zeros(15, np.int64)
    ordered = np.array([weights[o] for o in sorted(weights)], np.int64)
    splits = _tree_weights(0, np.int64(sum(1 << o for o in weights)), ordered, tree)
    assert splits == len(weights) - 1
    assert tree.tolist() == oracles.tree_weights(weights)
    return tree


def by_octant(values, weights):
    return {o: int(values[o]) for o in weights}


def rebuilt(weights, q, mean, predicted, step):
    """Means of a block's children by octant, as _rebuild_children puts them together; q, predicted: of one component."""
    tree, values, predicted = tree_of(weights), np.full((15, 1), -99, np.int64), np.array(predicted, np.int64)[:, None]
    _inverse(tree, np.array(q, np.int64)[:, None], 0, mean - _weighted_mean(tree, predicted, 0), step, values)
    return by_octant(values[7:, 0] + predicted[:, 0], weights)


@settings(deadline=None, max_examples=200)
@given(BLOCK, st.lists(MEAN, min_size=8, max_size=8), MEAN, st.lists(MAGNITUDE, min_size=7, max_size=7), st.integers(0, 63))
def test_a_rebuilt_block_is_the_oracles_and_within_two_ulp_of_exact_fractions(weights, predicted, mean, q, qp):
    args = weights, dict(enumerate(q)), mean, by_octant(predicted, weights), step_of(qp)
    got = rebuilt(weights, q, mean, predicted, step_of(qp))
    assert got == oracles.inverse(*args)
    exact = oracles.inverse(*args, exact=True)
    assert max(abs(got[o] - exact[o]) for o in weights) <= ULP_PER_LEVEL
    total = sum(weights.values())
    assert abs(sum(Fraction(weights[o] * got[o], total) for o in weights) - mean) <= ULP_PER_LEVEL


@settings(deadline=None, max_examples=100)
@given(BLOCK, st.lists(MEAN, min_size=8, max_size=8), MEAN)
def test_a_block_without_coefficients_keeps_its_mean_within_half_an_ulp(weights, predicted, mean):
    got, total = rebuilt(weights, [0] * 7, mean, predicted, step_of(30)), sum(weights.values())
    assert got == oracles.inverse(weights, {}, mean, by_octant(predicted, weights), step_of(30))
    assert abs(sum(Fraction(weights[o] * got[o], total) for o in weights) - mean) <= Fraction(1, 2)


# Range coder


def coded(symbols):
    """Codeword of (context or None for bypass, bit) pairs, and the most bytes that waited for a carry."""
    state, out, contexts, waited = new_encoder(), np.empty(64 + 4 * len(symbols), np.uint8), new_contexts(8), 0
    for ctx, bit in symbols:
        if ctx is None:
            _enc_bypass(state, out, bit)
        else:
            _enc_bit(state, out, contexts, ctx, bit)
        waited = max(waited, int(state[PENDING]))
    return finish(state, out), waited


def assert_decodes(data, symbols):
    buffer = np.frombuffer(b"\xaa" + data + b"\x55", np.uint8)  # what stands around a codeword must not matter
    state, contexts, plain = new_decoder(buffer, 1, 1 + len(data)), new_contexts(8), oracles.RangeDecoder(data)
    for ctx, bit in symbols:
        if ctx is None:
            assert _dec_bypass(state, buffer, 1 + len(data)) == bit == plain.bypass()
        else:
            assert _dec_bit(state, buffer, 1 + len(data), contexts, ctx) == bit == plain.bit(ctx)
    assert contexts.tolist() == [list(plain.contexts.get(ctx, FRESH)) for ctx in range(8)]


@pytest.mark.parametrize("target", [b"\x80", b"\x40", b"\x01\x23\x45\x67\x89\xab\xcd\xef\x80"])
@pytest.mark.parametrize("last", [0, 1])
@pytest.mark.parametrize("seed", range(3))
def test_carries_run_through_long_chains_of_0xff(target, last, seed):
    """Symbols that a decoder reads from a number with a few leading bytes keep the interval around it: low is ...FFFF below."""
    plain, rng = oracles.RangeDecoder(target), np.random.default_rng(seed)
    symbols = [(ctx, plain.bit(ctx)) for ctx in rng.integers(0, 8, 400).tolist()]
    for tail in ([last] * 12, [last, 1 - last] * 20):
        extended = symbols + [(None, b) for b in tail]
        data, waited = coded(extended)
        assert waited >= 10
        assert_decodes(data, extended)


def test_a_codeword_is_read_as_if_zeros_followed():
    symbols = [(None, 0), *[(None, 1)] * 100]
    data, _ = coded(symbols)
    assert len(data) <= 4
    assert_decodes(data, symbols)


def test_an_encoder_that_runs_out_of_room_says_so():
    state, out = new_encoder(), np.empty(4, np.uint8)
    for i in range(100):
        _enc_bypass(state, out, i & 1)
    with pytest.raises(OverflowError, match="full"):
        finish(state, out)


# Binarisation


def magnitude_round_trip(cases):
    """Codes (component, strength, large, value) one after the other; returns what kernel and oracle read."""
    state, out, contexts = new_encoder(), np.empty(64 + 32 * len(cases), np.uint8), new_contexts(CONTEXTS)
    for c, strength, large, value in cases:
        _enc_magnitude(state, out, contexts, c, strength, large, abs(value), int(value < 0))
    data = finish(state, out)
    buffer, plain, again = np.frombuffer(data + b"\0", np.uint8), oracles.RangeDecoder(data), new_contexts(CONTEXTS)
    state = new_decoder(buffer, 0, len(data))
    read = [int(_dec_magnitude(state, buffer, len(data), again, c, strength, large)) for c, strength, large, _ in cases]
    np.testing.assert_array_equal(again, contexts)
    return read, [plain.magnitude(c, strength, large) for c, strength, large, _ in cases]


SIZE = st.one_of(st.integers(1, 40), st.integers(1, 1 << 22), st.sampled_from([14, 15, 16, 17, (1 << 22) - 1, 1 << 22]))


SIZES = [*range(1, 71), *(v for i in range(7, 23) for v in ((1 << i) + 13, (1 << i) + 14, (1 << i) + 15))]


@settings(deadline=None, max_examples=100)
@example([(i % 3, i % 7, i % 3, v if i & 1 else -v) for i, v in enumerate(SIZES)])  # all to 70 and around powers of two
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 6), st.integers(0, 4), st.tuples(SIZE, st.sampled_from([-1, 1]))
                          .map(lambda p: p[0] * p[1])), min_size=1, max_size=60))
def test_coefficients_up_to_2_to_22_come_back_from_kernel_and_oracle(cases):
    values = [v for *_, v in cases]
    assert magnitude_round_trip(cases) == (values, values)


def test_a_prefix_that_never_ends_stops_at_24_and_its_value_is_clipped():
    """No bytes read as zeros, zeros as ones: the largest magnitude there is, 2**25 + 14, whose difference is then limited."""
    buffer = np.zeros(1, np.uint8)
    value = int(_dec_magnitude(new_decoder(buffer, 0, 0), buffer, 0, new_contexts(CONTEXTS), 0, 0, 0))
    assert value == oracles.RangeDecoder(b"").magnitude(0, 0, 0) == -((1 << 25) + 14)
    assert _dequantise(value, step_of(63), 1, 1) == -MAX_DIFFERENCE


@pytest.mark.parametrize("magnitude", [1, 2, 15, 16, 17, 1000, 1 << 22])
def test_the_price_of_a_magnitude_is_its_bins_in_fresh_contexts(magnitude):
    bins = 1 + min(magnitude, 15) + (0 if magnitude < 16 else 2 * (magnitude - 15).bit_length() - 1)
    assert _magnitude_cost(new_contexts(CONTEXTS), 0, 0, 0, magnitude, codec_room._bits_of()) == 256 * bins


# Surroundings and energies


@pytest.mark.parametrize("planar", [0, 1])
@pytest.mark.parametrize("seed", range(3))
def test_surroundings_are_the_oracles_for_every_block_and_plane(seed, planar):
    rng = np.random.default_rng(seed)
    nodes = list(oracles.level_nodes(random_keys(rng, 4, 160, planar).tolist(), 4, 4))
    energy, above = (rng.integers(0, 256, (len(nodes), 2)).astype(np.uint8) >> rng.integers(0, 8) for _ in range(2))
    table, sums = table_of(nodes, planar), np.zeros(6, np.int64)
    for first in (0, len(nodes) // 3):
        for p in range(first, len(nodes)):
            _surroundings(p, first, table, planar, energy, above, sums)
            for k in range(2):
                expected = oracles.surroundings(p, first, nodes, energy[:, k].tolist(), above[:, k].tolist())
                assert _classes(sums, k) == expected


@settings(deadline=None)
@given(st.lists(MAGNITUDE, min_size=21, max_size=21), st.integers(1, 7))
def test_energies_are_sixteen_times_the_mean_magnitude_up_to_255(values, splits):
    q = np.array(values, np.int64).reshape(7, 3)
    total = sum(abs(v) for row in q[:, 1:3].tolist() for v in row)
    assert _plane_energy(q, 1, 3, splits) == min(255, 16 * total // (2 * splits))


# The codec


def round_trip(keys, depth, values, qp, threads=1, tools=None):
    """Encodes, checks that the decoder has what the encoder said it would, returns (coded, means)."""
    coded_unit, expected = enc_attributes(keys, depth, values, qp, tools, threads)
    means = decode(keys, depth, coded_unit, depth, threads)
    np.testing.assert_array_equal(means, expected)
    return coded_unit, means


def decode(keys, depth, coded_unit, stop, threads=1, codewords=None):
    codewords = coded_unit.codewords if codewords is None else codewords
    ends = np.cumsum([0] + [len(c) for c in codewords]).tolist()
    data = np.frombuffer(b"".join(codewords) + b"\xcc", np.uint8)[:-1]
    spans = list(pairwise(ends)) if depth else []
    return dec_attributes(keys, depth, coded_unit, data, spans, stop, threads)


def node_sums(values, keys, shift):
    """Exact sums of the voxels' values below every node and the nodes' weights."""
    _, first, count = np.unique(keys >> shift, return_index=True, return_counts=True)
    return np.add.reduceat(values.astype(np.int64), first, axis=0), count[:, None]


def smooth_values(keys, components, seed=0):
    from texfcodec.field.morton import decode_morton

    rng, xyz = np.random.default_rng(seed), decode_morton(keys)
    waves = np.sin(xyz @ rng.normal(0, 0.3, (3, components)) + rng.uniform(0, 6, components))
    return np.rint((127.5 + 100 * waves + rng.normal(0, 4, waves.shape)) * UNIT).astype(np.int32)


@pytest.mark.parametrize("depth", range(14))
@pytest.mark.parametrize("components", [1, 3])
def test_the_decoder_has_what_the_encoder_predicts_at_depth(depth, components):
    rng = np.random.default_rng(depth)
    keys = random_keys(rng, depth, 400)
    values = rng.integers(0, 255 * UNIT + 1, (len(keys), components)).astype(np.int32)
    coded_unit, means = round_trip(keys, depth, values, [28] * components)
    assert means.shape == (len(keys), components) and means.dtype == np.int32
    assert len(coded_unit.codewords) == (1 if depth else 0) and [len(b) for b in coded_unit.level_bytes] == [depth] * (depth > 0)


@pytest.mark.parametrize("qp", [0, 10, 63])
@pytest.mark.parametrize("components", [1, 3])
def test_every_node_is_the_mean_of_its_voxels_within_two_ulp_a_level(components, qp):
    keys, depth = surface_keys(5), 5
    values = smooth_values(keys, components)
    coded_unit, voxels = round_trip(keys, depth, values, [qp] * components)
    assert np.abs(np.array(coded_unit.root) - values.astype(np.int64).mean(axis=0)).max() <= 0.5
    for stop in range(depth + 1):
        sums, weight = node_sums(voxels, keys, 3 * (depth - stop))
        assert np.abs(sums / weight - decode(keys, depth, coded_unit, stop)).max() <= ULP_PER_LEVEL * (depth - stop)


@settings(deadline=None, max_examples=40)
@given(st.data())
def test_any_values_on_any_voxels_decode_to_what_the_encoder_has(data):
    depth = data.draw(st.integers(0, 5))
    keys = np.array(sorted(data.draw(st.sets(st.integers(0, 8**depth - 1), min_size=1, max_size=60))))
    components = data.draw(st.sampled_from([1, 3]))
    tools = Tools(colour_range=data.draw(st.sampled_from([0, 5])), models=data.draw(st.integers(0, 8)),
                  filters=data.draw(st.integers(0, 3)))
    seed, qp = data.draw(st.integers(0, 999)), data.draw(st.lists(st.integers(0, 63), min_size=components, max_size=components))
    low, high = data.draw(st.sampled_from([(0, 256), (100, 101), (-128, 128)]))
    values = np.random.default_rng(seed).integers(low * UNIT, high * UNIT, (len(keys), components)).astype(np.int32)
    _, means = round_trip(keys, depth, values, qp, tools=tools)
    assert means.shape == values.shape


def sliced(monkeypatch, voxels=300, nodes=16):
    monkeypatch.setattr(codec_room, "WHOLE_VOXELS", 1)
    monkeypatch.setattr(codec_room, "SLICE_VOXELS", voxels)
    monkeypatch.setattr(codec_room, "SLICE_NODES", nodes)


@pytest.mark.parametrize("slices", [False, True])
def test_level_bytes_of_each_codeword_are_enough_for_its_levels(slices, monkeypatch):
    """A decoder that has fetched no more than level_bytes says decodes the coarse levels bit for bit."""
    if slices:
        sliced(monkeypatch)
    keys, depth = surface_keys(5), 5
    coded_unit, _ = round_trip(keys, depth, smooth_values(keys, 3), [16] * 3)
    top = coded_unit.slice_level
    assert (len(coded_unit.codewords) > 3) == slices
    for stop in range(depth + 1):
        taken = [min(stop, top or depth), *[max(0, stop - top)] * (len(coded_unit.codewords) - 1)]
        cut = [c[: sum(b[:n])] for c, b, n in zip(coded_unit.codewords, coded_unit.level_bytes, taken, strict=True)]
        np.testing.assert_array_equal(decode(keys, depth, coded_unit, stop, codewords=cut), decode(keys, depth, coded_unit, stop))
    for codeword, counts in zip(coded_unit.codewords, coded_unit.level_bytes, strict=True):
        assert sum(counts) >= len(codeword) and min(counts) >= 0


def test_slices_plan_at_most_64_even_parts(monkeypatch):
    sliced(monkeypatch, voxels=10, nodes=100)
    keys = surface_keys(6)
    level, first = codec_room._plan_slices(build_octree(keys, 6), 6)
    sizes = np.diff([*np.add.accumulate([0, *np.unique(keys >> 3 * (6 - level), return_counts=True)[1]])[first], len(keys)])
    assert len(first) == 64 and first[0] == 0 and sizes.max() <= 2 * len(keys) / 64


def test_slices_that_begin_past_the_last_node_are_refused(monkeypatch):
    sliced(monkeypatch)
    keys = surface_keys(5)
    coded_unit, _ = round_trip(keys, 5, smooth_values(keys, 1), [28])
    coded_unit.slice_first[-1] = 1 << 40
    with pytest.raises(StreamError) as caught:
        decode(keys, 5, coded_unit, 5)
    assert caught.value.code == "TXF-S12"


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=200), st.integers(0, 63), st.sampled_from([1, 3]))
def test_any_bytes_decode_to_means_in_range(data, qp, components):
    keys = surface_keys(3)
    kernel, root = [1, *[255] * 6], [1 << 20] * components
    unit = codec_room.CodedAttributes([qp] * components, kernel, 0, 0, [], root, 0, [0], [data], [])
    means = decode(keys, 3, unit, 3)
    assert np.abs(means).max() <= MAX_MEAN


# Colour


def test_decoded_colour_is_the_oracles_for_20000_means_of_the_visible_range():
    """One unit more or less in a coefficient shows in one of some 500 of these."""
    rng = np.random.default_rng(9)
    means = np.column_stack([rng.integers(0, 255 * UNIT, 20_000), rng.integers(-128 * UNIT, 128 * UNIT, (20_000, 2))])
    assert inverse_colour(means.astype(np.int32)).tolist() == [list(oracles.rgb_of(*m)) for m in means.tolist()]


def test_a_voxels_transform_does_not_depend_on_the_other_voxels():
    rgb = np.random.default_rng(8).uniform(0, 255, (1003, 3)).astype(np.float32)
    whole = forward_colour(rgb)
    for part in (slice(0, 1), slice(1002, 1003), slice(17, 20), slice(5, 500)):
        np.testing.assert_array_equal(forward_colour(rgb[part]), whole[part])


def test_plain_values_come_back_and_are_clipped():
    np.testing.assert_array_equal(inverse_plain(forward_plain(np.arange(256)[:, None]))[:, 0], np.arange(256))
    assert inverse_plain(np.array([[-MAX_MEAN], [MAX_MEAN], [2047], [2048]], np.int32))[:, 0].tolist() == [0, 255, 0, 1]
