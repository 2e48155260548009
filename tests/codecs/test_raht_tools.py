"""Mixed bits, colour falloff, filter: kernels against the naive code, what is signalled, damaged payloads."""

import json
import os
import pickle
import subprocess
import sys
import zlib
from functools import lru_cache
from itertools import pairwise
from shutil import rmtree
from unittest.mock import patch

import numpy as np
import pytest
from conftest import REPOSITORY
from damage import attribute_ending as ending
from shapes import crossing_sheets

from conformance.reference.attributes import decode_values
from conformance.reference.bits import units_of
from conformance.reference.decoder import decode as naive_decode
from conformance.reference.syntax import read_stream as naive_stream
from oracles import kernels as oracles
from texfcodec.api import decode
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.bitstream.syntax import UNIT_ATTRIBUTE, UNIT_END
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.codecs.raht import attribute_coder, tool_choice
from texfcodec.codecs.raht.attribute_coder import Tools, enc_attributes
from texfcodec.codecs.raht.entropy import mixing
from texfcodec.codecs.raht.entropy.mixing import MAX_MODELS, _mixed_bit, _mixed_probability, new_chosen, new_model
from texfcodec.codecs.raht.entropy.range_coder import Coder, new_encoder
from texfcodec.codecs.raht.raht_values import raht_values
from texfcodec.codecs.raht.transform import filter as filter_room
from texfcodec.codecs.raht.transform import rings as rings_room
from texfcodec.codecs.raht.transform.octree import CELLS, Octree
from texfcodec.codecs.raht.transform.planar_rings import PLANAR_TAPS
from texfcodec.codecs.raht.transform.prediction import FALLOFF, _falloff, inverse_range
from texfcodec.codecs.raht.transform.quantise import MAX_MEAN, step_of
from texfcodec.core.kernel import PACKAGE, fingerprint
from texfcodec.encoder.encode import encode_scene
from texfcodec.field.morton import decode_morton, encode_morton
from texfcodec.limits import Limits
from texfcodec.options import EncodeOptions

UNIT = 4096  # one grey level in fixed point
TOP = (1 << 22) - 1  # the largest probability of a context
ENDS = (-MAX_MEAN, -1, 0, 1, 65535, 255 * UNIT, MAX_MEAN)
CODES = {"decoded", "TXF-U02", "TXF-U09", *(f"TXF-S{n:02d}" for n in (2, 4, 5, 8, 9, 10, 11, 12, 32))}  # of an attribute unit


# Mixed bits


def random_model(rng):
    """Eight contexts, two weight sets and a refinement set, in any state, often at the ends of their ranges."""
    model, reach = new_model(MAX_MODELS, 2, 1), int(rng.choice([1, 13107, 1 << 17, 1 << 24, 1 << 31]))
    ends = rng.choice([[0, 1, TOP], rng.integers(TOP + 1, size=3)])
    model.contexts[:] = np.column_stack([rng.choice(ends, (MAX_MODELS, 2)), rng.choice([0, 1, 30, 62, 63], MAX_MODELS)])
    model.weights[:] = rng.integers(-reach, reach + 1, model.weights.shape)
    model.uses[:] = rng.choice([0, 1, 15, 16, 1503, 1504, 1519, 1520, 1521], 2)
    model.refinement[:] = rng.choice([0, TOP, int(rng.integers(TOP))], model.refinement.shape)
    return model


def weight_set(model, s, m):
    """A weight set as the oracle takes it: the weights of m models and the bias, and the count."""
    return [*model.weights[s, :m].tolist(), int(model.weights[s, MAX_MODELS])], int(model.uses[s])


def test_tables_and_initial_states_of_mixing_are_the_oracles():
    """Squash, Stretch, the learning rates, the weights and the refinement set."""
    assert mixing.SQUASH.tolist() == oracles.squash_table() and mixing.STRETCH.tolist() == oracles.stretch_table()
    assert mixing.LEARNING.tolist() == [16 + 1536 // (16 + n) for n in range(1522)]  # then 16 for ever
    model, plain = new_model(3, 1, 1), oracles.mixing.MixedTable(MAX_MODELS)
    assert model.refinement[0].tolist() == plain.refinements[0]
    assert weight_set(model, 0, MAX_MODELS) == (plain.weight_sets[0].weight, plain.weight_sets[0].count)


def test_any_state_gives_the_oracles_probability_and_next_state_for_3000_bits():
    """Extreme weights, contexts, counts and refinements; weights past the models in use stay as they are."""
    rng, seen, out = np.random.default_rng(1), set(), np.empty(64, np.uint8)
    chosen = new_chosen()
    chosen.sets[1] = 1
    for _ in range(3000):
        model, m, bit = random_model(rng), int(rng.integers(1, MAX_MODELS + 1)), int(rng.integers(2))
        model.weights[:, m:MAX_MODELS] %= mixing.MAX_WEIGHT  # never out of range, as they stay what they were at first
        order = rng.permutation(MAX_MODELS)
        chosen.where[:], used, idle, before = order, order[:m], order[m:], mixing.copy_model(model)
        p, contexts, first, second, refinement = oracles.mixed_bit(
            bit, [tuple(c) for c in model.contexts[used].tolist()], weight_set(model, 0, m), weight_set(model, 1, m),
            model.refinement[0].tolist())
        assert int(_mixed_probability(model, m, chosen)) == p and 8 <= p <= 65528
        assert _mixed_bit(True, Coder(new_encoder(), out, 0), model, m, chosen, bit) == bit
        assert model.contexts[used].tolist() == [list(c) for c in contexts]
        assert [weight_set(model, s, m) for s in (0, 1)] == [first, second]
        assert model.refinement[0].tolist() == refinement
        assert (model.contexts[idle] == before.contexts[idle]).all()
        assert (model.weights[:, m:MAX_MODELS] == before.weights[:, m:MAX_MODELS]).all()
        seen.add(p)
    assert {8, 65528} <= seen and len(seen) > 200


# Falloff, filter, threads


def test_the_colour_falloff_is_the_oracles_on_random_extreme_and_boundary_values():
    """Differences of none to the largest there are, and one more or less than where an entry of the table begins."""
    rng, seen = np.random.default_rng(2), set()
    for i in range(4000):
        components, reach, qp = int(rng.choice([1, 3])), int(rng.choice([1, 2, 5, 10, 255])), int(rng.integers(64))
        centre = rng.choice(ENDS, components) if i % 2 else rng.integers(-MAX_MEAN, MAX_MEAN + 1, components)
        mean = rng.choice(ENDS, components) if i % 3 else centre.copy()
        if i % 3 == 0:
            entry = int(rng.integers(34)) * reach * step_of(qp) // 16
            mean[0] = np.clip(centre[0] + entry + rng.integers(-2, 3), -MAX_MEAN, MAX_MEAN)
        arrays = [np.array([v], np.int32) for v in (mean, centre)]
        got = int(_falloff(arrays[0], 0, arrays[1], 0, inverse_range(reach, step_of(qp))))
        assert got == oracles.falloff(mean.tolist(), centre.tolist(), reach, step_of(qp))
        seen.add(got)
    assert seen == set(FALLOFF.tolist()) and inverse_range(0, UNIT) == 0


def random_stage(rng, components, of_each=filter_room.RINGS):
    """(filter_mask, filter_coefficients) of clause 5.7.3, often at the ends of their ranges."""
    full = (1 << filter_room.CLASSES * components) - 1
    mask = int(rng.choice([0, 1, full, full, int(rng.integers(full))]))
    return mask, rng.choice([-128, 127, *rng.integers(-99, 99, 4)], of_each * mask.bit_count()).tolist()


@pytest.mark.parametrize("depth, count, base", [(1, 3, 0), (2, 60, 0), (4, 300, 0), (13, 90, 8187)])
@pytest.mark.parametrize("components", [1, 2, 3])
@pytest.mark.parametrize("planar", [False, True])
def test_filter_stages_are_the_oracles_on_random_and_extreme_means(depth, count, base, components, planar, monkeypatch):
    """Three stages on top of each other, in pieces of a few parents, up to the last corner of the largest grid."""
    for kind in (filter_room.VoxelRings, filter_room.TexelRings):
        monkeypatch.setattr(kind, "pieces", 5)
    rng, changed = np.random.default_rng(depth), 0
    of_each, xyz = PLANAR_TAPS if planar else filter_room.RINGS, rng.integers(base, 1 << depth, (count, 3))
    keys = np.unique(encode_morton(xyz * [1, 1, not planar]))
    rings, voxels = filter_room.rings_of(Octree(keys, depth, planar)), [tuple(v) for v in decode_morton(keys).tolist()]
    for qp, extreme in ((0, 0.0), (28, 0.0), (28, 0.1), (63, 0.0), (63, 1.0), (0, 1.0)):
        step, shape = step_of(qp), (len(keys), components)
        mean = 90 * UNIT + rng.integers(-step, step + 1, shape)
        mean = np.where(rng.random(shape) < extreme, rng.choice(ENDS, shape), mean)
        mean = mean.clip(-MAX_MEAN, MAX_MEAN).astype(np.int32)
        plain = dict(zip(voxels, mean.tolist(), strict=True))
        for _ in range(3):
            (mask, taps), before = random_stage(rng, components, of_each), mean
            plain = oracles.filter_stage(plain, mask, taps, [step] * components, planar)
            stage, run = filter_room.stage_of(mask, taps, components), lambda jobs: [job() for job in jobs]
            mean = filter_room.apply_stage(stage, rings, mean, np.full(components, step), run)
            assert mean.tolist() == [plain[v] for v in voxels]
            changed += (mean != before).any()
    assert changed >= 6


@pytest.mark.parametrize("components", [1, 2, 3])
def test_rings_are_written_nowhere_else(components):
    rng, ring = np.random.default_rng(components), np.full((components + 1, filter_room.RINGS), -99, np.int64)
    mean = rng.integers(-MAX_MEAN, MAX_MEAN + 1, (20, components)).astype(np.int32)
    rings_room._rings(rng.integers(0, 20, CELLS), -1, 3, mean, ring[:components])  # every cell has one
    assert (ring[components] == -99).all() and (ring[:components] != -99).all()


def plane_keys(side):
    """Keys of a square of voxels, ascending."""
    x, y = np.divmod(np.arange(side * side), side)
    return np.sort(encode_morton(np.stack([x, y, np.full_like(x, side // 3)], -1)))


def field_values(kind, keys, components):
    """int32 [N, C] with 12 fractional bits."""
    rng, xyz, shape = np.random.default_rng(3), decode_morton(keys), (len(keys), components)
    values = {"constant": np.full(shape, 77.0), "noise": rng.uniform(0, 255, shape),
              "waves": 120 + 90 * np.sin(xyz @ np.full((3, components), 0.21)) + rng.normal(0, 3, shape),
              "checks": np.repeat(255.0 * (xyz.sum(axis=1) // 2 % 2)[:, None], components, axis=1)}[kind]
    return np.rint(values * UNIT).astype(np.int32)


@pytest.mark.parametrize("kind", ["constant", "noise", "waves", "checks"])
@pytest.mark.parametrize("components, models", [(1, 0), (1, 6), (3, 0), (3, 8)])
def test_a_filter_is_signalled_only_where_its_gain_is_worth_its_bits(kind, components, models):
    """No component's error grows, all together it falls by the price; white noise at small steps gets no filter."""
    keys, price, signalled = plane_keys(48), Tools().trade_off * filter_room.COEFFICIENT_BITS, {}
    values = field_values(kind, keys, components)
    for qp in (4, 28, 46, 63):
        tools = [Tools(colour_range=5, models=models, filters=n) for n in (0, 3)]
        (plain, before), (coded, after) = (enc_attributes(keys, 6, values, [qp] * components, t) for t in tools)
        without, error = ((((m.astype(float) - values) / step_of(qp)) ** 2).sum(axis=0) for m in (before, after))
        assert plain.filters == [] and plain.codewords == coded.codewords and (error <= without).all()
        assert without.sum() - error.sum() >= 0.99 * price * sum(s.mask.bit_count() for s in coded.filters)
        assert kind != "constant" or not error.any()
        signalled[qp] = len(coded.filters)
    assert (signalled[46] > 0) == (kind != "constant") and (kind != "noise" or signalled[4] == signalled[28] == 0)


@pytest.mark.slow
@pytest.mark.parametrize("effort", list(tool_choice.EFFORTS))
def test_2_to_18_voxels_in_two_slices_are_the_same_bytes_and_values_for_1_and_2_threads(effort):
    """The smallest cloud that the encoder slices, its tools chosen by trial, decoded by as many threads."""
    keys, depth, qp, made = plane_keys(512), 9, [28, 27, 27], []
    values = field_values("waves", keys, 3)
    for threads in (1, 2):
        tools = tool_choice.choose_tools(keys, depth, values, qp, effort, threads)
        coded, means = enc_attributes(keys, depth, values, qp, tools, threads)
        written, ends = raht_values(coded, True), np.cumsum([0, *map(len, coded.codewords)]).tolist()
        data = np.frombuffer(written["codeword_data"], np.uint8)
        decoded = attribute_coder.dec_attributes(keys, depth, coded, data, list(pairwise(ends)), depth, threads)
        made.append((tools, written, means.tobytes(), decoded.tobytes()))
    assert made[0] == made[1] and made[0][2] == made[0][3]
    assert written["num_slices"] == 2 and written["num_models"] == tool_choice.EFFORTS[effort].models


# Streams with any tools


@lru_cache
def source(models, filters, resolution=17, max_error=None, slices=False):
    """A stream with these tools and random filter stages; the checksums of its values are the naive decoder's."""
    rng, whole = np.random.default_rng(filters), 1 if slices else attribute_coder.WHOLE_VOXELS
    qp = 4 if max_error is None else None
    options = EncodeOptions(resolution=resolution, qp=qp, max_error=max_error, effort="fast", partition="off")
    cut = patch.multiple(attribute_coder, WHOLE_VOXELS=whole, SLICE_VOXELS=60, SLICE_NODES=4)
    tools = patch.dict(tool_choice.EFFORTS, fast=Tools(colour_range=255, models=models))
    with cut, tools, patch("texfcodec.encoder.values.coder.codec_for", lambda plane, asked: asked):
        data = encode_scene(crossing_sheets(), options).data
    stream, keys = read_stream(data, Limits()), decode(data).fields[0].keys.tolist()
    for unit in stream.attributes:
        stages = [random_stage(rng, len(unit["qp"])) for _ in range(filters)]
        unit["filters"] = [{"filter_mask": mask, "filter_coefficients": taps} for mask, taps in stages]
        unit["num_filters"] = filters
    plain = naive_stream(units_of(write_stream(stream)[0]))["attributes"]
    for unit, twin in zip(stream.attributes, plain, strict=True):
        unit["values_crc"] = zlib.crc32(decode_values(twin, keys))
    return write_stream(stream)[0]


def assert_naive_agrees(data):
    """Colour and alpha of the only field, byte by byte; returns it."""
    (mine,), (theirs,) = decode(data).fields, naive_decode(data)["fields"]
    values = [mine.rgba[:, :3].tobytes(), mine.rgba[:, 3].tobytes()]
    assert (mine.keys.tolist(), values) == (theirs["keys"], [*theirs["values"].values()])
    return mine


@pytest.mark.parametrize("filters", [0, 3])
@pytest.mark.parametrize("models", [0, 1, 6, 8])
def test_streams_of_any_tools_are_decoded_as_by_the_naive_decoder(models, filters):
    """Sheets of noise in small steps, so that classes of all sizes occur."""
    assert len(assert_naive_agrees(source(models, filters)).keys) > 500


@pytest.mark.parametrize("filters", range(4))
@pytest.mark.parametrize("models", [1, 6, 8])
def test_a_single_voxel_comes_back_whatever_tools_are_signalled(models, filters):
    """At depth 0 nothing is coded, and a voxel without neighbours is filtered to itself; the encoder has no filter."""
    data = source(models, filters, resolution=1)
    for unit in read_stream(data, Limits()).attributes:
        assert [unit[name] for name in ("Depth", "num_models", "num_filters")] == [0, models, filters]
    (usual,) = decode(source(0, 0, resolution=1)).fields
    assert assert_naive_agrees(data).rgba.tolist() == usual.rgba.tolist() and usual.rgba.shape == (1, 4)
    values = np.array([[255 * UNIT, -7, 65535]], np.int32)
    coded, means = enc_attributes(np.zeros(1, np.int64), 0, values, [28] * 3, Tools(models=models, filters=filters))
    assert (coded.filters, coded.codewords, means.tolist()) == ([], [], values.tolist())


def damaged(data, rng, count):
    """`count` streams for each damage to an attribute unit: a few bytes, a cut, a few of its codewords, all of them."""
    units, out = [[u.type, data[u.begin : u.end]] for u in read_units(data)[0]], []
    coded = [a["codeword_data"] for a in read_stream(data, Limits()).attributes]
    places = [i for i, (kind, _) in enumerate(units) if kind == UNIT_ATTRIBUTE]
    bend = lambda b: bytes(int(rng.integers(256)) if rng.random() < 3 / len(b) else v for v in b)
    for place, words in [list(zip(places, coded, strict=True))[i] for i in rng.integers(len(places), size=count)]:
        payload, head = units[place][1], units[place][1].removesuffix(words)
        fill = rng.bytes(len(words)) if rng.random() < 0.8 else bytes([int(rng.choice([0, 255]))]) * len(words)
        for broken in (bend(payload), payload[: int(rng.integers(len(payload)))], head + bend(words), head + fill):
            parts = [[kind, broken if i == place else whole] for i, (kind, whole) in enumerate(units)]
            out.append(data[:8] + b"".join(write_unit(*part) for part in [*parts, (UNIT_END, b"")]))
    return out


def corpus(resolution, count, *more):
    """(damaged streams of all tools and of slices, each after its source; number of sources). more: further ones."""
    choices = [{"models": m, "filters": f} for m in (0, 1, 6, 8) for f in (0, 3)]
    choices += [{"models": 6, "filters": 3, "slices": True}, *more]
    sources, rng = [source(resolution=resolution, **chosen) for chosen in choices], np.random.default_rng(6)
    return [stream for data in sources for stream in (data, *damaged(data, rng, count))], len(sources)


def assert_ends_well(program, path, streams, sources, flags=(), **environment):
    """After `program`, in its own interpreter, as here: sources decode, a code or the checksum tells of damage."""
    keys = decode(streams[0]).fields[0].keys
    path.write_bytes(pickle.dumps((streams, keys)))
    task = "streams, keys = pickle.load(open(sys.argv[1], 'rb'))\nprint(json.dumps([ending(s, keys) for s in streams]))"
    program = f"import json, pickle, sys\nsys.path.insert(0, 'tests')\n{program}\n{task}"
    run = subprocess.run([sys.executable, *flags, "-c", program, str(path)], cwd=REPOSITORY, capture_output=True,
                         text=True, check=False, env={**os.environ, "PYTHONPATH": str(REPOSITORY), **environment})
    assert run.returncode == 0, run.stderr[-3000:]
    codes = json.loads(run.stdout)
    assert set(codes) <= CODES and {"TXF-S02", "TXF-S04", "TXF-S10", "TXF-S32"} <= set(codes)
    assert codes[:: len(streams) // sources] == ["decoded"] * sources
    assert codes.count("TXF-S32") > len(codes) // 4 and codes.count("decoded") < len(codes) // 4
    assert codes == [ending(stream, keys) for stream in streams]


BEYOND = """
from damage import attribute_ending as ending
from texfcodec.codecs.raht.transform.prediction import _falloff
import numpy as np
for wrong in BAD:
    try:
        _falloff(np.zeros((1, 3), np.int32), wrong, np.zeros((1, 3), np.int32), 0, 1)
        raise SystemExit("indices are not checked")
    except IndexError:
        pass
"""


@pytest.mark.slow
def test_with_bounds_checked_no_damaged_attribute_unit_reads_outside_an_array(tmp_path, pytestconfig):
    """Compiled in half a minute, the kernels but those of residuals stay in pytest's cache until a source changes."""
    folder = pytestconfig.cache.mkdir("bounds-checked") if hasattr(pytestconfig, "cache") else tmp_path
    current = {fingerprint(path) for path in PACKAGE.rglob("*.py")}
    for old in (folder / "texfcodec").glob("*"):
        if old.name not in current:
            rmtree(old, ignore_errors=True)
    assert_ends_well(BEYOND.replace("BAD", "[2]"), tmp_path / "streams", *corpus(17, 8), NUMBA_BOUNDSCHECK="1",
                     NUMBA_CACHE_DIR=str(folder))


WATCHED = """
import numpy as np
import texfcodec.core.kernel as room

class Watched(np.ndarray):
    def __getitem__(self, index):
        if any(isinstance(i, (int, np.integer)) and i < 0 for i in (index if type(index) is tuple else (index,))):
            raise IndexError(index)
        return super().__getitem__(index)

    def __setitem__(self, index, value):
        self[index]
        super().__setitem__(index, value)

def watch(value):
    if isinstance(value, np.ndarray):
        return value.view(Watched)
    return type(value)(*map(watch, value)) if hasattr(value, "_fields") else value

room.kernel = lambda function=None, **_: (lambda *given: function(*map(watch, given))) if function else room.kernel
""" + BEYOND.replace("BAD", "(-1, 1)") + """
for name in [n for n in sys.modules if n.startswith("texfcodec.codecs.raht.")]:
    space = vars(sys.modules[name])
    space.update({k: watch(v) for k, v in space.items() if isinstance(v, np.ndarray)})
"""


@pytest.mark.slow
def test_without_the_jit_no_damaged_attribute_unit_has_a_negative_index_or_an_overflow(tmp_path):
    """With residuals too. Bounds checks let negative indices pass; overflows are warnings, which are errors here."""
    streams = corpus(4, 2, {"models": 6, "filters": 3, "max_error": 1})
    assert_ends_well(WATCHED, tmp_path / "streams", *streams, ["-W", "error::RuntimeWarning"], NUMBA_DISABLE_JIT="1")
