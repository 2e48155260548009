"""3DNTC streams: damaged and lying ones end in a coded error; points anywhere are answered, alike by any number of threads."""

import json
import os
import pickle
import subprocess
import sys
import zlib
from functools import lru_cache

import numpy as np
import pytest
from conftest import REPOSITORY
from damage import ONE_THREAD, fields_of, outcome, repacked
from interpreter import modules_after

from texfcodec import DecodeOptions, Limits, decode
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import UNIT_ATTRIBUTE
from texfcodec.bitstream.units import read_units
from texfcodec.codecs.base import split_groups
from texfcodec.codecs.neural.infer import BLOCK, LOCAL_BITS, _local, _rows_around, _weights, infer, infer_values, voxel_positions
from texfcodec.codecs.neural.payload import Tables

VECTORS = REPOSITORY / "conformance"
FORMS = ("subset/neural_resident", "subset/neural_transport")
# One of each shape: forms, levels, two fields, alpha
ALL = (*FORMS, "subset/neural_hash", "uncommon/neural_two_fields", "uncommon/neural_levels", "uncommon/neural_alpha_first",
       "uncommon/neural_needle")
LAST = (1 << 24) - 1


@lru_cache
def stream(name):
    data = (VECTORS / name / "in.texf").read_bytes()
    assert decode(data).evaluators  # and the kernels are compiled before anything is timed
    return data


def with_attribute(data, change):
    """The stream with change(payload) as the payload of its attribute unit, lengths and checksums right."""
    return repacked(data, lambda unit_type, payload: change(payload) if unit_type == UNIT_ATTRIBUTE else payload)


def latents_of(data):
    return bytes(read_stream(data, Limits()).joint["latent_data"])


def points_around(texf, count, seed=0):
    """World points in and around the canonical cube: float64 [count, 3]."""
    return texf.origin + texf.side * np.random.default_rng(seed).uniform(-0.2, 1.2, (count, 3))


# Damage


@pytest.mark.parametrize("name", FORMS)
def test_every_cut_of_the_attribute_unit_is_refused_under_a_right_checksum(name):
    """In the transport form a codeword that lacks its last bytes reads on in zeros: the values' checksum tells."""
    data = stream(name)
    size = sum(unit.end - unit.begin for unit in read_units(data)[0] if unit.type == UNIT_ATTRIBUTE)
    begin, codes = size - len(latents_of(data)), set()
    for end in range(0, size, 1 if name == FORMS[0] else 3):
        code = outcome(with_attribute(data, lambda payload, end=end: payload[:end]), ONE_THREAD)
        inside = {"TXF-S10"} if name == FORMS[0] else {"TXF-S32"}
        assert code in ({"TXF-S02"} if end < begin else inside), end
        codes.add(code)
    assert len(codes) == 2


@pytest.mark.parametrize("more", [1, 2, 8, 4096])
def test_bytes_after_the_latents_are_refused_in_the_resident_form(more):
    for name in ("subset/neural_resident", "subset/neural_hash", "uncommon/neural_levels"):
        assert outcome(with_attribute(stream(name), lambda payload: payload + bytes(more)), ONE_THREAD) == "TXF-S10"


@pytest.mark.parametrize("name", ["subset/neural_transport", "uncommon/neural_two_fields", "uncommon/neural_no_codeword"])
def test_damaged_codewords_are_caught_by_the_checksum_of_the_values(name):
    data, rng, codes = stream(name), np.random.default_rng(1), []
    size, plain = len(latents_of(data)), fields_of(data)
    for damage in range(120):
        def change(payload, damage=damage):
            words, head = bytearray(payload[len(payload) - size :]), payload[: len(payload) - size]
            if damage % 3 == 0 or not words:
                return head + rng.bytes(int(rng.integers(1, 2 * size + 40)))
            if damage % 3 == 1:
                return head + words[: int(rng.integers(size))]
            words[int(rng.integers(size))] ^= 1 << int(rng.integers(8))
            return head + words

        bent = with_attribute(data, change)
        codes.append(outcome(bent, ONE_THREAD))
        assert codes[-1] in ("TXF-S32", "decoded")
        assert codes[-1] == "TXF-S32" or fields_of(bent) == plain
    assert codes.count("TXF-S32") >= 100


def damaged(count):
    """Streams of every shape whose attribute unit is bent in a few bits, under right checksums; in every other one the bits are
    of what stands before network_data."""
    rng, out = np.random.default_rng(2), []
    for name in ALL:
        data = stream(name)
        out.append(data)
        unit = read_stream(data, Limits()).joint
        body = len(unit["network_data"]) + len(unit["latent_data"])
        for i in range(count):
            def change(payload, i=i, body=body):
                for _ in range(int(rng.integers(1, 4))):
                    payload[int(rng.integers(6, len(payload) - body if i % 2 else len(payload)))] ^= 1 << int(rng.integers(8))
                return payload

            out.append(with_attribute(data, change))
    return out


CODES = {"decoded", "TXF-U09", "TXF-S02", "TXF-S04", "TXF-S05", "TXF-S10", "TXF-S30", "TXF-S32", "TXF-S50", "TXF-L04", "TXF-L05",
         "TXF-L10"}
CHECKED = """
import json, pickle, sys
import numpy as np
sys.path.insert(0, "tests")
from damage import ONE_THREAD, outcome
from texfcodec import decode
from texfcodec.codecs.raht.entropy.range_coder import new_contexts, new_decoder
from texfcodec.codecs.neural.transport import _dec_codes

try:
    _dec_codes(np.empty((1, 2), np.int8), new_decoder(np.zeros(4, np.uint8), 0, 4), np.zeros(4, np.uint8), new_contexts(8))
    raise SystemExit("indices are not checked")
except IndexError:
    pass
streams = pickle.load(open(sys.argv[1], "rb"))
for sound in streams[:: int(sys.argv[2])]:
    decode(sound, ONE_THREAD)  # and the kernels are compiled before anything is timed
print(json.dumps([outcome(s, ONE_THREAD) for s in streams]))
"""


@pytest.mark.slow
def test_with_bounds_checked_no_damaged_payload_reads_outside_an_array(tmp_path):
    """The checked code is compiled into a cache of its own; unchecked code ends the same way."""
    streams = damaged(24)
    (tmp_path / "streams").write_bytes(pickle.dumps(streams))
    environment = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(REPOSITORY)}
    program = [sys.executable, "-c", CHECKED, str(tmp_path / "streams"), str(len(streams) // len(ALL))]
    run = subprocess.run(program, cwd=REPOSITORY, capture_output=True, text=True, check=False, env={**os.environ, **environment})
    assert run.returncode == 0, run.stderr[-3000:]
    codes = json.loads(run.stdout)
    assert codes == [outcome(s, ONE_THREAD) for s in streams] and set(codes) <= CODES
    assert codes[:: len(streams) // len(ALL)] == ["decoded"] * len(ALL) and len(set(codes)) >= 6
    assert codes.count("TXF-S32") > len(codes) // 4


# Limits


def test_large_tables_are_refused_before_memory_is_asked_for():
    """2**24 rows of 8 latents, of which the transport form needs no byte in the stream."""
    data = stream("uncommon/neural_ones_codeword")

    def grown(payload):
        place = payload.index(bytes([6, 0, 5]))  # level_resolution and table_log2 of its hashed level
        payload[place + 2] = 24
        return payload

    assert outcome(with_attribute(data, grown), DecodeOptions(threads=1, limits=Limits(latents=1 << 26))) == "TXF-L10"


def test_samples_of_the_grids_of_latents_count_towards_the_limit():
    """Of a stream that just passes without them."""
    data = stream("uncommon/neural_k33")
    total = next(n for n in (1 << k for k in range(8, 24)) if outcome(data, with_samples(n)) == "decoded")
    assert outcome(data, with_samples(total // 4)) == "TXF-L05"


def with_samples(samples):
    return DecodeOptions(threads=1, limits=Limits(samples=samples))


# Answers


@pytest.mark.parametrize("name", ALL)
def test_voxels_hold_what_the_query_answers_at_their_centres(name):
    texf = decode(stream(name))
    for number, part in enumerate(texf.fields):
        grid = texf.voxels()["xyz"][texf.voxels()["field"] == number]
        answer = infer(voxel_positions(grid, part.support.resolution), texf.evaluators[number])
        planes = split_groups((answer.astype(np.int64) + 128) >> 8, texf.groups)
        assert planes.keys() == part.planes.keys() and all(np.array_equal(planes[name], part.planes[name]) for name in planes)


@pytest.mark.parametrize("name", ALL)
def test_points_are_answered_at_their_position_and_outside_the_grid_on_its_border(name):
    texf, rng = decode(stream(name)), np.random.default_rng(4)
    positions = rng.integers(0, LAST + 1, (600, 3))
    scale = ((1 << texf.position_bits) - 1) << (24 - texf.position_bits)
    points = texf.origin + texf.side * (positions + 0.5) / scale
    below, above = (rng.random((600, 3)) < 0.2 for _ in range(2))
    reach = 10.0 ** rng.uniform(-3, 12, (600, 3))
    points = np.where(above, texf.origin + texf.side * (1.001 + reach), np.where(below, texf.origin - texf.side * reach, points))
    positions = np.where(above, LAST, np.where(below, 0, positions)).astype(np.int32)
    which = rng.integers(0, len(texf.fields), 600)
    answers = texf.query_by_field(points, which)
    for number, tables in enumerate(texf.evaluators):
        mine = which == number
        planes = split_groups(infer_values(positions[mine], tables), texf.groups)
        assert np.array_equal(answers[mine, :3], planes["base_colour"])
        assert np.array_equal(answers[mine, 3:], planes.get("alpha", np.full((mine.sum(), 1), 255)))


def test_points_without_any_latent_are_still_answered():
    """The vector has such voxels on both of its levels, and on each others that have latents (11.4)."""
    texf = decode(stream("uncommon/neural_sparse"))
    (tables,), (part,) = texf.evaluators, texf.fields
    levels, places, *maps = tables.index
    for n in range(len(levels)):
        cut = [slice(places[n, k], places[n + 1, k]) for k in (0, 1, 1, 1)]
        arrays = [array[rows] for array, rows in zip(maps, cut, strict=True)]
        resolution, log2, _, salt = levels[n]
        totals = []
        for position in voxel_positions(texf.voxels()["xyz"], part.support.resolution):
            u, v, w = (_local(c, resolution) for c in position)
            rows = np.empty(8, np.int64)
            _rows_around(u >> LOCAL_BITS, v >> LOCAL_BITS, w >> LOCAL_BITS, resolution, log2, salt, *arrays, rows)
            inside = [c & (1 << LOCAL_BITS) - 1 for c in (u, v, w)]
            totals.append(_weights(*inside, rows, np.empty(8, np.int32)))
        assert 50 < totals.count(0) < len(totals) - 50 and max(totals) < 1 << 24
    assert len(np.unique(part.rgba, axis=0)) > 100


@pytest.mark.parametrize("lod", [1, 3, 5, 13])
@pytest.mark.parametrize("name", ["subset/neural_resident", "uncommon/neural_two_fields", "uncommon/neural_alpha_first"])
def test_levels_of_detail_are_rounded_means_and_leave_the_query_as_it_is(name, lod):
    texf, coarse = decode(stream(name)), decode(stream(name), DecodeOptions(lod=lod))
    for fine, part in zip(texf.fields, coarse.fields, strict=True):
        shift = min(lod, (fine.support.resolution - 1).bit_length())
        assert (part.support.resolution, part.level_shift) == (fine.support.resolution, shift)
        for key, value in zip(part.keys, part.rgba.astype(int), strict=True):
            below = fine.rgba[fine.keys >> 3 * shift == key].astype(int)
            assert (value == (2 * below.sum(axis=0) + len(below)) // (2 * len(below))).all()
        assert np.array_equal(part.keys, np.unique(fine.keys >> 3 * shift))
    points, faces = points_around(texf, 50), np.arange(50)
    assert np.array_equal(coarse.query(points, faces), texf.query(points, faces))


def test_wrong_values_are_refused_at_every_level_of_detail():
    data = (VECTORS / "faulty" / "neural_values_crc" / "in.texf").read_bytes()
    for lod in (0, 1, 13):
        assert outcome(data, DecodeOptions(lod=lod)) == "TXF-S32"


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("name", ["subset/neural_transport", "uncommon/neural_two_fields", "uncommon/neural_needle"])
def test_any_number_of_threads_gives_the_same_bytes(name, threads):
    one, many = (decode(stream(name), DecodeOptions(threads=n)) for n in (1, threads))
    assert [zlib.crc32(f.rgba) for f in one.fields] == [zlib.crc32(f.rgba) for f in many.fields]
    points = points_around(one, 3 * BLOCK + 1)
    which = np.random.default_rng(3).integers(0, len(one.fields), len(points))
    assert one.query_by_field(points, which).tobytes() == many.query_by_field(points, which).tobytes()


def test_fields_share_the_codes_and_the_network():
    """256 fields of 2**28 latents are not 64 GiB."""
    first, second = decode(stream("uncommon/neural_two_fields_hash")).evaluators
    assert isinstance(first, Tables) and all(a is b for a, b in zip(first.network, second.network, strict=True))


# What is loaded


def test_decoding_and_asking_load_neither_torch_nor_the_fit():
    path = str(VECTORS / "subset" / "neural_hash" / "in.texf")
    modules, _ = modules_after("from pathlib import Path; from texfcodec import decode; "
                               f"texf = decode(Path({path!r}).read_bytes()); assert texf.query(texf.positions).any()")
    fitting = (f"texfcodec.codecs.neural.{name}" for name in ("fit", "train", "samples", "design"))
    foreign = {"torch", "texfcodec.encoder.encode", *fitting}
    assert "texfcodec.codecs.neural.infer" in modules and foreign.isdisjoint(modules)
