"""3DNTC: the decoder gives to the bit what the oracle gives that was written from clause 11 alone. Whole streams, as the encoder
writes them and with payloads of any shape, points of query() inside and outside the cube, and payloads without a stream."""

import struct
import zlib
from dataclasses import replace
from functools import lru_cache
from unittest.mock import patch

import numpy as np
import pytest
from shapes import painted_sphere, scene_of, square

from conformance.reference.attributes import de_interleave
from conformance.reference.bits import Invalid, Reader, units_of
from conformance.reference.decoder import decode as naive_decode
from conformance.reference.decoder import decode_geometry, triangles_of_field
from conformance.reference.neural import (
    Neural,
    centre,
    hard_gelu,
    latent_keys,
    position_of,
    resident_row,
    transported_rows,
)
from conformance.reference.syntax import read_neural
from conformance.reference.syntax import read_stream as naive_stream
from conformance.reference.voxels import active_voxels
from texfcodec import DecodeOptions, EncodeOptions, Limits, StreamError, decode
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.codecs.neural import design
from texfcodec.codecs.neural.infer import infer, voxel_positions
from texfcodec.codecs.neural.neural_syntax import NEURAL
from texfcodec.codecs.neural.payload import Level, Payload, Tables, dec_codes, payload_of, payload_values
from texfcodec.codecs.neural.transport import dec_transport
from texfcodec.core.syntax_walk import write_structure
from texfcodec.encoder.encode import encode_scene
from texfcodec.precompile import small_scene

COLOUR = {"num_semantics": 1, "group_semantics": [0], "group_components": 3}
ALPHA = {"num_semantics": 1, "group_semantics": [1], "group_components": 1}
LAST = 2**24 - 1
KINDS = ("usual", "subnormal", "large", "any")
# Payload but for components: features, octaves, first wave, hidden, levels as (resolution, table_log2)
SHAPES = {
    "usual": (16, 3, 40, (24, 16), [(9, 0), (5, 0)]),
    "narrow": (2, 0, 1, (1,), [(1, 0)]),
    "odd": (6, 2, 16384, (5, 1, 7), [(7, 0), (11, 1), (30, 0)]),
    "wide": (10, 1, 3, (128, 3), [(8192, 11)]),
    "four": (4, 8, 16384, (3, 5, 2, 9), [(2, 0), (8192, 9), (8192, 0), (3, 6)]),
    "largest": (64, 8, 16384, (128,) * 4, [(1, 0), (2, 0), (8192, 0), (4096, 1)]),
}


# Payloads


def parameters_of_layer(rng, kind, inputs, count):
    """Binary16 patterns; usual ones keep the activations in range."""
    if kind == "usual":
        return (rng.normal(0, 1.4 / np.sqrt(inputs), count)).astype("<f2").view("<u2")
    sign = rng.integers(0, 2, count) << 15
    if kind == "subnormal":
        return (sign | rng.integers(0, 1 << 11, count)).astype("<u2")
    if kind == "large":
        return (sign | rng.integers(25 << 10, 27 << 10, count)).astype("<u2")
    return (sign | rng.integers(0, 27 << 10, count)).astype("<u2")


def random_payload(shape, components, entries, kinds=("usual",), seed=0):
    """Payload with random codes and parameters, each layer of one of the kinds. entries: by level, the latents of every field."""
    features, octaves, first_wave, hidden, levels = SHAPES[shape]
    rng = np.random.default_rng(seed)
    levels = tuple(Level(grid, log2, 3, () if log2 else tuple(own)) for (grid, log2), own in zip(levels, entries, strict=True))
    payload = Payload(features, octaves, first_wave, hidden, levels, components)
    layers = zip(payload.widths, payload.widths[1:], strict=False)
    payload.halves = np.concatenate([
        parameters_of_layer(rng, kinds[min(n, len(kinds) - 1)], inputs, (inputs + 1) * outputs)
        for n, (inputs, outputs) in enumerate(layers)])
    payload.codes = rng.integers(-8, 8, (payload.rows, features), np.int8)
    return payload


def random_keys(rng, grid, count):
    """Ascending Morton keys of so many voxels of a grid, fewer where it is small; the last of all is among them."""
    xyz = np.append(rng.integers(0, grid, (count, 3)), [[grid - 1] * 3], axis=0)
    key = lambda voxel: sum((int(c) >> i & 1) << (3 * i + axis) for axis, c in enumerate(voxel) for i in range(13))
    return sorted({key(voxel) for voxel in xyz})


def oracle_of(payload, form, num_fields, keys):
    """The oracle of a payload, which it reads from the bytes of 5.7.4."""
    groups = {1: [1], 3: [3], 4: [3, 1]}[payload.components]
    known = {"num_fields": num_fields, "NumOutputs": payload.components}
    reader, unit = Reader(write_structure(NEURAL, payload_values(payload, form) | known)), {}
    read_neural(reader, unit, {"num_fields": num_fields, "channel_groups": [{"components": count} for count in groups]})
    assert reader.ended()
    return Neural(unit, keys)


def positions_around(rng, grids, count):
    """Random positions, those of corners of the cube, and ones on the planes where cells of latents meet."""
    positions = rng.integers(0, LAST + 1, (count, 3))
    positions[:2] = [[0] * 3, [LAST] * 3]
    for n in range(2, count // 2):
        grid, axis = grids[n % len(grids)], n % 3
        meeting = ((2 * int(rng.integers(0, grid)) + 1) << 23) // grid + n % 5 - 2
        positions[n, axis] = min(max(meeting, 0), LAST)
    return positions


@pytest.mark.parametrize("kinds", [("usual",), ("subnormal",), ("large", "subnormal"), ("any",), ("large",)])
@pytest.mark.parametrize("shape", list(SHAPES)[:-1])
def test_payload_answers_random_points_like_the_oracle(shape, kinds):
    rng, number, num_fields, components = np.random.default_rng(len(shape)), 1, 3, {"narrow": 1, "wide": 3}.get(shape, 4)
    grids = SHAPES[shape][4]
    keys = [[] if log2 else [random_keys(rng, grid, 40) for _ in range(num_fields)] for grid, log2 in grids]
    payload = random_payload(shape, components, [[len(k) for k in own] for own in keys], kinds, seed=len(kinds))
    tables = Tables(payload, number, [np.array(own[number], np.int64) if own else None for own in keys])
    positions = positions_around(rng, [grid for grid, _ in grids], 70)
    for grid, own in zip(grids, keys, strict=True):  # sparse grids: most points would meet no latent
        if own:
            near = [centre(de_interleave(key), grid[0]) for key in own[number][:10]]
            positions = np.append(positions, np.clip(np.array(near) + rng.integers(-400, 400, (len(near), 3)), 0, LAST), axis=0)
    oracle = oracle_of(payload, len(kinds) - 1, num_fields, keys)
    expected = [oracle.answer(number, position) for position in positions.tolist()]
    assert infer(positions, tables).tolist() == expected
    if kinds == ("usual",) and shape != "narrow":
        assert len({value for values in expected for value in values} - {0, 65280}) > 30


def test_hash_tells_256_fields_apart_like_the_oracle():
    payload, answers = random_payload("wide", 3, [()]), set()
    oracle, positions = oracle_of(payload, 0, 256, [[]]), positions_around(np.random.default_rng(2), [8192], 12)
    for number in (0, 1, 255):
        expected = [oracle.answer(number, position) for position in positions.tolist()]
        assert infer(positions, Tables(payload, number, [None])).tolist() == expected
        answers.add(str(expected))
    assert len(answers) == 3


@pytest.mark.parametrize("outside", [-1, LAST + 1])
def test_a_position_outside_the_cube_is_no_question(outside):
    tables = Tables(random_payload("wide", 3, [()]), 0, [None])
    with pytest.raises(IndexError, match="outside the cube"):
        infer(np.array([[0, outside, 0]]), tables)


def test_hard_gelu_of_the_oracle_is_that_of_the_paper():
    for v in range(-40000, 40000, 7):
        x = v / 16384
        assert abs(hard_gelu(v) / 16384 - x * min(max(x + 1.5, 0), 3) / 3) < 2**-14


@pytest.mark.parametrize("length", [0, 1, 3, 40, 400])
def test_any_codeword_is_unpacked_like_by_the_oracle(length):
    data = np.random.default_rng(length).bytes(length)
    assert dec_transport(data, 11, 6).tolist() == transported_rows(data, 6, 11)


def test_every_byte_holds_the_codes_that_the_oracle_finds_in_it():
    assert dec_codes(bytes(range(256)), 2).tolist() == [resident_row(bytes([byte])) for byte in range(256)]


def test_centres_of_voxels_are_those_of_the_oracle():
    for resolution in (1, 2, 3, 24, 1000, 8191, 8192):
        voxels = [[0, 0, 0], [resolution - 1] * 3, [resolution // 2, resolution // 3, resolution // 5]]
        assert voxel_positions(voxels, resolution).tolist() == [list(centre(voxel, resolution)) for voxel in voxels]


# Streams


@lru_cache
def coded(name):
    """A stream as the encoder writes it; its search for a grid begins at a small one, only to be quick."""
    scene = {"one": painted_sphere(4), "two": small_scene(), "packed": small_scene()}[name]
    options = EncodeOptions(codec="3dntc", steps=20, resolution=24, resident_bytes=26000, transport=name == "packed", threads=1)
    with patch.object(design, "MOST_RESOLUTION", 40):
        return encode_scene(scene, options).data


@lru_cache
def carrier(scene):
    """(Stream of a small scene, for the oracle: triangles by field, position_bits); two crossing sheets have a field each."""
    made = {"sphere": lambda: painted_sphere(3), "sheets": small_scene, "flat": lambda: scene_of(*square())}[scene]()
    data = encode_scene(made, EncodeOptions(resolution=24, effort="fast", support="voxels", threads=1)).data
    plain = naive_stream(units_of(data))
    bits = plain["header"]["position_bits"]
    units = [decode_geometry(unit, bits) for unit in plain["geometry"]]
    return read_stream(data, Limits()), [triangles_of_field(units, n) for n in range(len(plain["fields"]))], bits


def fields_of(triangles, bits, resolution):
    """(Syntax values of the fields, keys by field): field n has n voxels a side more than the first."""
    keys = [active_voxels(own, bits, resolution + n, 2) for n, own in enumerate(triangles)]
    values = [{"field_index": n, "support": 0, "resolution": resolution + n, "area_threshold": 2, "num_keys": len(own),
               "keys_crc": zlib.crc32(np.array(own, "<i8"))} for n, own in enumerate(keys)]
    return values, keys


def with_payload(scene, resolution, shape, groups, form=0, kinds=("usual",), change=None):
    """Bytes of the carrier with a random payload whose checksum is the oracle's. change: of the unit's values, before it."""
    stream, triangles, bits = carrier(scene)
    entries = [[] if log2 else [len(active_voxels(own, bits, grid, 3)) for own in triangles] for grid, log2 in SHAPES[shape][4]]
    payload = random_payload(shape, sum(group["group_components"] for group in groups), entries, kinds)
    stream = replace(stream, header=stream.header | {"channel_groups": groups, "num_channel_groups": len(groups)})
    stream.fields, keys = fields_of(triangles, bits, resolution)
    unit = {"field_index": 0, "group_index": 0, "codec_id": 1, "level_shift": 0, "values_crc": 0, **payload_values(payload, form)}
    unit |= change(unit) if change else {}
    stream.attributes = [unit]
    (plain,) = naive_stream(units_of(write_stream(stream)[0]))["attributes"]
    neural, crc = Neural(plain, latent_keys(plain, triangles, bits)), 0
    for number, of_field in enumerate(keys):
        for values in neural.voxel_values(number, resolution + number, of_field):
            crc = zlib.crc32(bytes(values), crc)
    unit["values_crc"] = crc
    return write_stream(stream)[0]


def assert_naive_agrees(data, lod=0):
    """Keys and values of all fields; returns what both decoders made of the stream."""
    ours, naive = decode(data, DecodeOptions(lod=lod, threads=1)), naive_decode(data, lod)
    columns = [slice(0, 3) if group["semantics"] == [0] else slice(3, 4) for group in naive["header"]["channel_groups"]]
    for mine, theirs in zip(ours.fields, naive["fields"], strict=True):
        assert (mine.support.size, mine.keys.tolist()) == (theirs["resolution"], theirs["keys"])
        assert [mine.rgba[:, column].tobytes() for column in columns] == [*theirs["values"].values()]
    return ours, naive


def assert_queries_agree(ours, naive, count=60, seed=0):
    """Points on the surface, in and around the cube, and far away, each asking the field of a random face."""
    rng, columns = np.random.default_rng(seed), []
    for group in naive["header"]["channel_groups"]:
        columns += [0, 1, 2] if group["semantics"] == [0] else [3]
    faces = rng.integers(0, len(ours.faces), count)
    points = ours.origin + ours.side * rng.uniform(-0.2, 1.2, (count, 3))
    on_surface = np.arange(count) % 3 == 0
    shares = rng.dirichlet(np.ones(3), count)[:, :, None]
    points[on_surface] = (ours.positions[ours.faces[faces]] * shares).sum(axis=1)[on_surface]
    points[1:4], points[4] = [[1e30, -1e30, 0], [-1e300, 1e-320, 5e-324], ours.origin], ours.origin + ours.side
    expected = np.full((count, 4), 255.0)
    for row, (point, number) in enumerate(zip(points.tolist(), ours.face_field[faces].tolist(), strict=True)):
        expected[row, columns] = np.array(naive["neural"].answer(number, position_of(point, naive["header"]))) / 256
    assert ours.query(points, faces).astype(np.float64).tolist() == expected.tolist()


@pytest.mark.parametrize("name, fields, groups, form", [("one", 1, 1, 0), ("two", 2, 2, 0), ("packed", 2, 2, 1)])
def test_encoded_stream_is_decoded_and_asked_like_by_the_oracle(name, fields, groups, form):
    ours, naive = assert_naive_agrees(coded(name))
    shape = len(naive["fields"]), len(naive["header"]["channel_groups"]), naive["neural"].unit["form"]
    assert shape == (fields, groups, form)
    assert_queries_agree(ours, naive)


@pytest.mark.parametrize("lod", [1, 2, 13])
def test_coarser_levels_are_the_oracles_rounded_means(lod):
    ours, naive = assert_naive_agrees(coded("two"), lod)
    assert ours.fields[0].support.size == -(-24 // 2 ** min(lod, 5))
    assert_queries_agree(ours, naive, count=10)  # the network answers at any level of detail


@pytest.mark.parametrize("groups", [[COLOUR], [COLOUR, ALPHA], [ALPHA, COLOUR], [ALPHA]], ids=["rgb", "rgba", "argb", "a"])
@pytest.mark.parametrize("scene, resolution", [("sphere", 9), ("sheets", 7), ("flat", 1)])
def test_channel_groups_of_any_order_are_the_oracles(scene, resolution, groups):
    ours, naive = assert_naive_agrees(with_payload(scene, resolution, "usual", groups))
    assert_queries_agree(ours, naive, count=20)
    assert ours.has_alpha == (ALPHA in groups)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", ["narrow", "odd", "wide"])
@pytest.mark.parametrize("form", [0, 1])
def test_streams_with_payloads_of_any_shape_are_the_oracles(shape, form, kind):
    """Hashed and other levels side by side, over two fields of different resolution."""
    data = with_payload("sheets", 7, shape, [COLOUR, ALPHA], form, (kind, "usual"))
    ours, naive = assert_naive_agrees(data, lod=form)
    assert [field["resolution"] for field in naive["fields"]] == ([4, 4] if form else [7, 8])
    assert_queries_agree(ours, naive, count=20)


@pytest.mark.parametrize("codeword", [b"", b"\x00", bytes(400), b"\xff" * 400, bytes(range(256)) * 4])
def test_codewords_too_short_and_too_long_are_read_like_by_the_oracle(codeword):
    assert_naive_agrees(with_payload("sheets", 7, "odd", [COLOUR], 1, change=lambda unit: {"latent_data": codeword}))


# Refusals


def with_level(unit, **values):
    first, *rest = unit["latent_levels"]
    return {"latent_levels": [first | values, *rest]}


def with_parameter(unit, half):
    return {"network_data": bytes(unit["network_data"][:-2]) + struct.pack("<H", half)}


LIES = {
    "a latent too many": lambda unit: with_level(unit, num_latents=[n + 1 for n in unit["latent_levels"][0]["num_latents"]]),
    "another grid": lambda unit: with_level(unit, level_resolution=unit["latent_levels"][0]["level_resolution"] + 1),
    "another threshold": lambda unit: with_level(unit, latent_threshold=65535),
    "a byte too many": lambda unit: {"latent_data": bytes(unit["latent_data"]) + b"\0"},
    "a byte too few": lambda unit: {"latent_data": unit["latent_data"][:-1]},
    "2^12": lambda unit: with_parameter(unit, 27 << 10),
    "-infinity": lambda unit: with_parameter(unit, 63 << 10),
    "no number": lambda unit: with_parameter(unit, (31 << 10) + 1),
    "a wrong checksum": lambda unit: {"values_crc": unit["values_crc"] ^ 1},
    "of another field": lambda unit: {"field_index": 1},
    "of another group": lambda unit: {"group_index": 1},
}


@pytest.mark.parametrize("lie", list(LIES))
def test_a_lie_is_refused_by_both(lie):
    stream = read_stream(coded("two"), Limits())
    stream.attributes[0] |= LIES[lie](stream.attributes[0])
    assert_both_refuse(write_stream(stream)[0])


def assert_both_refuse(data):
    """At every level of detail: 8.3 has all values of a 3DNTC stream checked."""
    for lod in (0, 2):
        with pytest.raises(StreamError):
            decode(data, DecodeOptions(lod=lod))
        with pytest.raises(Invalid):
            naive_decode(data, lod)


@pytest.mark.parametrize("units", [0, 2])
def test_another_number_of_3dntc_units_is_refused_by_both(units):
    stream = read_stream(coded("two"), Limits())
    stream.attributes = stream.attributes * units
    assert_both_refuse(write_stream(stream)[0])


def test_codecs_side_by_side_are_refused_by_both():
    stream = read_stream(coded("two"), Limits())
    raht = read_stream(encode_scene(small_scene(), EncodeOptions(resolution=24, effort="fast")).data, Limits()).attributes
    for attributes in (raht[:-1] + stream.attributes, stream.attributes + raht[1:], stream.attributes + raht):
        stream.attributes = attributes
        assert_both_refuse(write_stream(stream)[0])


def test_odd_features_are_refused_by_both():
    odd = Payload(3, 0, 1, (2,), (Level(1, 1, 0),), 3, np.zeros(17, np.uint16), np.zeros((2, 3), np.int8))
    stream = read_stream(coded("one"), Limits())
    stream.attributes[0] |= payload_values(odd, 0)
    assert_both_refuse(write_stream(stream)[0])


def test_largest_parameter_is_taken_by_both():
    stream = read_stream(coded("one"), Limits())
    stream.attributes[0] |= with_parameter(stream.attributes[0], (27 << 10) - 1)
    data = write_stream(stream)[0]
    assert payload_of(read_stream(data, Limits()).joint, Limits()).halves[-1] == (27 << 10) - 1
    assert naive_stream(units_of(data))["attributes"][0]["parameters"][-1] == (27 << 10) - 1
