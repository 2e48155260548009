"""Decoding in a child process: the same result, and every way it can end badly is a coded error."""

import errno
import subprocess
import sys
import tempfile
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from conftest import REPOSITORY

from texfcodec import DecodeOptions, EncodeOptions, LimitError, Limits, Report, StreamError, TexfError, decode
from texfcodec.bitstream.stream import read_stream, write_stream
from texfcodec.codecs.neural.payload import Tables
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.sandbox import isolate as room
from texfcodec.sandbox.isolate import decode_isolated
from texfcodec.sandbox.limited_process import LEAST_BYTES
from texfcodec.scene.channels import ALPHA, group_values


@pytest.fixture(scope="module")
def stream(sample_scene):
    return encode_scene(sample_scene, EncodeOptions(resolution=64, qp=30)).data


def with_draco(stream, change):
    """The stream with the Draco bytes of its first geometry unit changed; all checksums are made anew."""
    parsed = read_stream(stream, Limits())
    unit = parsed.geometry[0]
    unit["draco_data"] = change(bytes(unit["draco_data"]))
    return write_stream(parsed)[0]


@pytest.mark.parametrize("lod", [0, 2])
def test_isolated_result_is_the_plain_one(stream, lod):
    options, report = DecodeOptions(lod=lod, isolate=True), Report()
    ours, plain = decode_isolated(stream, options, report), decode(stream, options)
    assert np.array_equal(ours.lattice_positions, plain.lattice_positions) and np.array_equal(ours.faces, plain.faces)
    assert np.array_equal(ours.face_material, plain.face_material) and np.array_equal(ours.face_field, plain.face_field)
    for a, b in zip(ours.fields, plain.fields, strict=True):
        assert (repr(a.support), a.level_shift) == (repr(b.support), b.level_shift)
        assert np.array_equal(a.keys, b.keys) and np.array_equal(a.rgba, b.rgba)
    assert ours.cube == plain.cube and ours.metadata == plain.metadata and ours.has_alpha == plain.has_alpha
    assert [m.name for m in ours.materials] == [m.name for m in plain.materials]
    assert report.child_peak_memory_bytes > 1 << 20 and "child geometry" in report.seconds


NEURAL = ("subset/neural_resident", "subset/neural_transport", "subset/neural_hash", "uncommon/neural_levels",
          "uncommon/neural_alpha_first", "uncommon/neural_two_fields", "uncommon/neural_largest", "uncommon/neural_small")


def vector(name):
    return (REPOSITORY / "conformance" / name / "in.texf").read_bytes()


def assert_same(ours, plain, place="texf"):
    """Every field of a dataclass, every entry, every array is the same; coarser levels that a picture asked for aside."""
    assert type(ours) is type(plain), place
    if is_dataclass(ours):
        for one in fields(ours):
            if one.name != "_pyramids":
                assert_same(getattr(ours, one.name), getattr(plain, one.name), f"{place}.{one.name}")
    elif isinstance(ours, np.ndarray):
        assert ours.dtype == plain.dtype and np.array_equal(ours, plain), place
    elif isinstance(ours, list | tuple):
        assert len(ours) == len(plain), place
        for i, (a, b) in enumerate(zip(ours, plain, strict=True)):
            assert_same(a, b, f"{place}[{i}]")
    elif isinstance(ours, dict):
        assert ours.keys() == plain.keys(), place
        for key in ours:
            assert_same(ours[key], plain[key], f"{place}[{key!r}]")
    elif isinstance(ours, Tables):
        assert_same(ours.arrays, plain.arrays, place)
        assert ours.components == plain.components, place
    else:
        assert ours == plain, place


@pytest.mark.parametrize("lod", [0, 2])
@pytest.mark.parametrize("name", ["uncommon/strange_units", "uncommon/alpha_first", "uncommon/neural_two_fields",
                                  "uncommon/texels_mixed", "subset/texels_alpha", "uncommon/texels_low", "uncommon/maps_some",
                                  "uncommon/maps_shift_texels", "uncommon/maps_grey", "uncommon/maps_parameters",
                                  "uncommon/maps_neural", "uncommon/maps_with_alpha"])
def test_every_field_of_the_result_is_the_plain_one(name, lod):
    plain = decode(vector(name), DecodeOptions(lod=lod))
    assert_same(decode(vector(name), DecodeOptions(lod=lod, isolate=True)), plain)
    assert plain.skipped or name != "uncommon/strange_units"


def test_a_result_that_differs_in_one_field_is_told():
    one, other = decode(vector("uncommon/strange_units")), decode(vector("uncommon/strange_units"))
    other.skipped = []
    with pytest.raises(AssertionError, match="skipped"):
        assert_same(one, other)


@pytest.mark.parametrize("name", NEURAL)
def test_network_of_an_answer_is_the_plain_one(name):
    plain = decode(vector(name), DecodeOptions(lod=1))
    assert_same_network(room._texf(*room._answer(plain, Report()), 2), plain)


@pytest.mark.parametrize("lod, name", [(0, NEURAL[1]), (2, NEURAL[3])])
def test_isolated_network_answers_as_the_plain_one(name, lod):
    assert_same_network(decode_isolated(vector(name), DecodeOptions(lod=lod)), decode(vector(name), DecodeOptions(lod=lod)))


def assert_same_network(ours, plain):
    """The tables are the same to the bit, and so are the answers."""
    for a, b in zip(ours.evaluators, plain.evaluators, strict=True):
        assert a.components == b.components
        assert all(np.array_equal(x, y) and np.asarray(x).dtype == np.asarray(y).dtype
                   for x, y in zip(a.arrays, b.arrays, strict=True))
    assert np.array_equal(ours.voxels()["rgba"], plain.voxels()["rgba"])
    rng = np.random.default_rng(0)
    points = plain.origin + plain.side * rng.uniform(-0.1, 1.1, (5000, 3))
    faces = rng.integers(0, len(plain.faces), 5000)
    assert ours.query(points, faces).tobytes() == plain.query(points, faces).tobytes()
    assert len(np.unique(ours.query(points, faces), axis=0)) > 10


def test_errors_of_a_network_come_through_the_child():
    for name, code in (("nan", "TXF-S50"), ("latents_huge", "TXF-L10"), ("num_latents", "TXF-S30"), ("codeword", "TXF-S32")):
        with pytest.raises(TexfError) as raised:
            decode_isolated(vector(f"faulty/neural_{name}"))
        assert raised.value.code == code


def test_parent_never_runs_draco(stream, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    assert len(decode_isolated(stream).faces) > 1000


def test_damaged_draco_is_a_coded_error(stream):
    middle = lambda data: data[: len(data) // 2] + bytes(len(data) - len(data) // 2)
    noise = lambda data: data[:20] + np.random.default_rng(0).bytes(len(data) - 20)
    for change in (middle, noise, lambda data: b"DRACO"):
        with pytest.raises(TexfError) as raised:
            decode_isolated(with_draco(stream, change))
        assert raised.value.code in ("TXF-S20", "TXF-S21", "TXF-S22", "TXF-S23", "TXF-S24", "TXF-S30", "TXF-S40", "TXF-L07")


def test_own_errors_come_through_with_their_facts(stream):
    with pytest.raises(LimitError) as raised:
        decode_isolated(stream, DecodeOptions(limits=Limits(voxels=10)))
    assert raised.value.code == "TXF-L04" and raised.value.details["allowed"] == 10
    with pytest.raises(StreamError) as raised:
        decode_isolated(stream[:-1])
    assert raised.value.code == "TXF-S02" and raised.value.details["clause"] == "5.2"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux caps the memory of a process reliably")
def test_memory_cap_ends_it(sample_scene):
    stream = encode_scene(sample_scene, EncodeOptions(resolution=256, qp=40, effort="fast")).data
    with pytest.raises(LimitError) as raised:
        decode_isolated(stream, DecodeOptions(limits=Limits(isolate_bytes=LEAST_BYTES, isolate_seconds=30)))
    assert raised.value.code == "TXF-L07" and raised.value.details["allowed"] == LEAST_BYTES


def test_time_cap_ends_it(stream):
    with pytest.raises(LimitError) as raised:
        decode_isolated(stream, DecodeOptions(limits=Limits(isolate_seconds=0.05)))
    assert raised.value.code == "TXF-L08"


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in for a crashing child is a shell script")
@pytest.mark.parametrize("act, code", [("kill -SEGV $$", "TXF-S40"), ("kill -KILL $$", "TXF-L07"), ("exit 0", "TXF-S40"),
                                       ("echo std::bad_alloc >&2; exit 1", "TXF-L07"), ("echo 7 > $5/facts.json", "TXF-S40"),
                                       ("echo '{}' > $5/facts.json", "TXF-S40")])  # fmt: skip
def test_child_that_crashes_or_lies_is_a_coded_error(stream, tmp_path, monkeypatch, act, code):
    script = tmp_path / "python"
    script.write_text(f"#!/bin/sh\nset -- x \"$@\"\ncat > /dev/null\n{act}\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    with pytest.raises(TexfError) as raised:
        decode_isolated(stream)
    assert raised.value.code == code


LIES = {
    "face index": lambda facts, arrays: arrays["faces"].__setitem__((0, 0), 10**9),
    "negative face": lambda facts, arrays: arrays["faces"].__setitem__((0, 0), -1),
    "lattice": lambda facts, arrays: arrays["lattice"].__setitem__((0, 0), 1 << 14),
    "keys out of order": lambda facts, arrays: arrays["keys"].__setitem__(1, 0),
    "key outside the grid": lambda facts, arrays: arrays["keys"].__setitem__(-1, 1 << 41),
    "fewer colours": lambda facts, arrays: arrays.__setitem__("plane_base_colour", arrays["plane_base_colour"][:-1]),
    "material number": lambda facts, arrays: facts["units"][0][0].__setitem__(1, 99),
    "no fields": lambda facts, arrays: facts.pop("fields"),
    "negative resolution": lambda facts, arrays: facts["fields"][0][0].__setitem__(0, -5),
    "text for bits": lambda facts, arrays: facts.__setitem__("position_bits", "14"),
    "no bits": lambda facts, arrays: facts.__setitem__("position_bits", 0),
    "an origin in the plane": lambda facts, arrays: facts["origin"].pop(),
    "an origin without end": lambda facts, arrays: facts["origin"].__setitem__(0, float("inf")),
    "no number for the side": lambda facts, arrays: facts.__setitem__("side", float("nan")),
    "a side below zero": lambda facts, arrays: facts.__setitem__("side", -1.0),
    "complex faces": lambda facts, arrays: arrays.__setitem__("faces", arrays["faces"].astype(complex)),
    "colours in eighths": lambda facts, arrays: arrays.__setitem__("plane_base_colour", arrays["plane_base_colour"] / 8),
}


@pytest.mark.parametrize("lie", LIES)
def test_answer_is_checked_again(stream, lie):
    facts, arrays = room._answer(decode(stream), Report())
    room._texf(facts, arrays, 1)
    LIES[lie](facts, arrays)
    with pytest.raises(StreamError) as raised:
        room._texf(facts, arrays, 1)
    assert raised.value.code == "TXF-S40"


def less(name):
    return lambda facts, arrays: arrays.__setitem__(name, arrays[name][:-1])


def with_appearance(change):
    """A lie about channel groups and materials."""
    def lie(facts, arrays):
        data = arrays["appearance"].tobytes()
        values = read_structure(room.APPEARANCE, Reader(data, 0, len(data)), {})
        change(values)
        arrays["appearance"] = np.frombuffer(write_structure(room.APPEARANCE, values), np.uint8)

    return lie


def more_groups(looks, group):
    looks["channel_groups"].append(group)
    looks["num_channel_groups"] += 1


def of_material(number, **changes):
    return with_appearance(lambda looks: looks["materials"][number].update(changes))


def of_group(number, **changes):
    return with_appearance(lambda looks: looks["channel_groups"][number].update(changes))


def shift_of(field, name, levels):
    return lambda facts, arrays: facts["shifts"][field].__setitem__(name, levels)


def without_plane(name):
    """The last field with a plane of this channel lacks it."""
    def lie(facts, arrays):
        groups, _ = room._appearance(arrays["appearance"])
        at = 1 + [channel.name for group in groups for channel in group.channels].index(name)
        field = max(n for n, (_, lengths) in enumerate(facts["fields"]) if lengths[at])
        arrays[f"plane_{name}"] = arrays[f"plane_{name}"][: -facts["fields"][field][1][at]]
        facts["fields"][field][1][at] = 0
        facts["shifts"][field].pop(name, None)

    return lie


# Of three fields: over texels with maps, over voxels with the same, over voxels without; the material of the maps is the first.
# Groups: base colour, normal with occlusion, normal_object, roughness, which is a level coarser in the second field.
MAP_LIES = {
    "a plane less": without_plane("roughness"),
    "no normals over voxels": without_plane("normal_object"),
    "no base colour": without_plane("base_colour"),
    "fewer values": less("plane_roughness"),
    "a shift that the values have not": shift_of(1, "roughness", 0),
    "a shift of base colour": shift_of(0, "base_colour", 1),
    "a negative shift": shift_of(1, "roughness", -1),
    "a shift beyond the root": shift_of(1, "roughness", 9),
    "a shift of a channel that is not there": shift_of(2, "metallic", 0),
    "text for a shift": shift_of(1, "roughness", "coarse"),
    "shifts of a field less": lambda facts, arrays: facts["shifts"].pop(),
    "a channel that no group holds": of_material(0, material_channels=0b1000110100),
    "a channel that its field has not": of_material(1, material_channels=0b100000),
    "a channel that cannot be named": of_material(1, material_channels=1),
    "a parameter that is the default": of_material(1, num_parameters=1,
                                                   parameters=[{"parameter_id": 2, "parameter_value": [1.0]}]),
    "grey where it is not": of_group(3, group_components=3),
    "channels in another order": of_group(1, group_semantics=[4, 5]),
    "a channel twice": of_group(3, group_semantics=[4]),
    "appearance cut": less("appearance"),
    "appearance with more": lambda facts, arrays: arrays.__setitem__("appearance", np.append(arrays["appearance"], np.uint8(0))),
    "no appearance": lambda facts, arrays: arrays.pop("appearance"),
}


@pytest.mark.parametrize("lie", MAP_LIES)
def test_maps_of_an_answer_are_checked_again(lie):
    plain = decode(vector("uncommon/maps_some"))
    assert [f.shifts.get("roughness") for f in plain.fields] == [0, 1, None]
    facts, arrays = room._answer(plain, Report())
    assert_same(room._texf(facts, arrays, plain.threads), plain)
    MAP_LIES[lie](facts, arrays)
    with pytest.raises(StreamError) as raised:
        room._texf(facts, arrays, 1)
    assert raised.value.code == "TXF-S40"


def number_of_field(field, place, value):
    return lambda facts, arrays: facts["fields"][field][0].__setitem__(place, value)


TEXEL_LIES = {  # of two fields over texels, numbers 0 and 2, and one over voxels; the units stand as 2, 1, 0
    "no width": number_of_field(0, 0, 0),
    "negative height": number_of_field(0, 1, -9),
    "a width of 2^30": number_of_field(0, 0, 1 << 30),
    "an image over the limit": lambda facts, arrays: facts["fields"][0][0].__setitem__(slice(0, 2), [16384, 16384]),
    "an image that the keys leave": number_of_field(0, 1, 8),
    "unknown wrap": number_of_field(2, 2, 3),
    "negative wrap": number_of_field(2, 3, -1),
    "fraction bits": number_of_field(2, 4, 9),
    "a level too many": number_of_field(0, 5, 15),
    "a negative level": number_of_field(0, 5, -1),
    "a coarser level with the keys of a finer one": number_of_field(0, 5, 1),
    "a number too few": lambda facts, arrays: facts["fields"][0][0].pop(),
    "texels as voxels": lambda facts, arrays: facts["fields"].__setitem__(0, ([16, 0], facts["fields"][0][1])),
    "voxels as texels": lambda facts, arrays: facts["fields"].__setitem__(1, ([16, 16, 0, 0, 4, 0], facts["fields"][1][1])),
    "keys out of order": lambda facts, arrays: arrays["keys"].__setitem__(1, 0),
    "a key beside the plane": lambda facts, arrays: arrays["keys"].__setitem__(0, 4),
    "fewer keys": less("keys"),
    "fewer values": less("plane_base_colour"),
    "fewer UVs": less("uv"),
    "no UVs": lambda facts, arrays: arrays.pop("uv"),
    "UVs of three numbers": lambda facts, arrays: arrays.__setitem__("uv", np.column_stack([arrays["uv"], arrays["uv"][:, 0]])),
    "a UV of 2^26": lambda facts, arrays: arrays["uv"].__setitem__((3, 1), 1 << 26),
    "the least number there is as a UV": lambda facts, arrays: arrays["uv"].__setitem__((3, 1), -(1 << 63)),
    "a unit over texels without UVs": lambda facts, arrays: facts["units"][0][0].__setitem__(2, 0),
    "a unit over voxels with UVs": lambda facts, arrays: facts["units"][1][0].__setitem__(2, 1),
    "UVs of another unit": lambda facts, arrays: (facts["units"][0][1].__setitem__(2, facts["units"][0][1][2] - 1)),
    "a unit of another field": lambda facts, arrays: facts["units"][1][0].__setitem__(0, 0),
    "a unit of a field that is not there": lambda facts, arrays: facts["units"][1][0].__setitem__(0, 3),
}


@pytest.mark.parametrize("lie", TEXEL_LIES)
def test_texels_of_an_answer_are_checked_again(lie):
    plain = decode(vector("uncommon/texels_mixed"))
    assert [f.over_texels for f in plain.fields] == [True, False, True] and [u.field for u in plain.units] == [2, 1, 0]
    facts, arrays = room._answer(plain, Report())
    assert_same(room._texf(facts, arrays, plain.threads), plain)
    TEXEL_LIES[lie](facts, arrays)
    with pytest.raises(StreamError) as raised:
        room._texf(facts, arrays, 1)
    assert raised.value.code == "TXF-S40"


def set_byte(arrays, at, value):
    arrays["neural"] = arrays["neural"].copy()
    arrays["neural"][at] = value


NEURAL_LIES = {
    "keys out of order": lambda facts, arrays: arrays["latent_keys"].__setitem__(1, 0),
    "key outside the grid": lambda facts, arrays: arrays["latent_keys"].__setitem__(-1, 1 << 40),
    "negative key": lambda facts, arrays: arrays["latent_keys"].__setitem__(0, -1),
    "fewer keys": lambda facts, arrays: arrays.__setitem__("latent_keys", arrays["latent_keys"][:-1]),
    "keys of two numbers": lambda facts, arrays: arrays.__setitem__("latent_keys", np.stack([arrays["latent_keys"]] * 2, 1)),
    "no keys": lambda facts, arrays: arrays.pop("latent_keys"),
    "transport form": lambda facts, arrays: set_byte(arrays, 0, 1),
    "odd features": lambda facts, arrays: set_byte(arrays, 1, 3),
    "no hidden layer": lambda facts, arrays: set_byte(arrays, 5, 0),
    "parameter not a number": lambda facts, arrays: set_byte(arrays, slice(40, 60), 0x7E),
    "fewer latents": lambda facts, arrays: arrays.__setitem__("neural", arrays["neural"][:-1]),
    "no payload": lambda facts, arrays: arrays.__setitem__("neural", arrays["neural"][:0]),
    "another channel": with_appearance(lambda looks: looks["channel_groups"][0].update(group_semantics=[7])),
    "a channel twice": with_appearance(lambda looks: more_groups(looks, looks["channel_groups"][0])),
    "a channel more": with_appearance(lambda looks: more_groups(looks, group_values([ALPHA]))),
    "a number for channels": lambda facts, arrays: arrays.__setitem__("appearance", np.uint8(3)),
    "no word of a codec": lambda facts, arrays: facts.pop("codec"),
    "another codec": lambda facts, arrays: facts.__setitem__("codec", "raht"),
    "a codec that is not there": lambda facts, arrays: facts.__setitem__("codec", "os"),
}


@pytest.mark.parametrize("lie", NEURAL_LIES)
def test_network_of_an_answer_is_checked_again(lie):
    facts, arrays = room._answer(decode(vector("uncommon/neural_two_fields")), Report())
    room._texf(facts, arrays, 1)
    NEURAL_LIES[lie](facts, arrays)
    with pytest.raises(StreamError) as raised:
        room._texf(facts, arrays, 1)
    assert raised.value.code == "TXF-S40"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not count a parent's memory")
def test_a_peak_is_that_of_the_process_and_not_of_the_one_that_began_it():
    program = "from texfcodec.report import peak_memory_bytes\nprint(peak_memory_bytes())"
    held = bytearray(b"x" * (300 << 20))
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert 1 << 20 < int(run.stdout) < 200 << 20 < len(held)


def test_a_system_that_starts_no_child_is_a_limit(monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", "a path")

    for place, name in ((tempfile, "mkdtemp"), (subprocess, "Popen")):
        with monkeypatch.context() as patched, pytest.raises(LimitError, match="TXF-L15.*No space left on device"):
            patched.setattr(place, name, full)
            decode_isolated(vector("uncommon/one_voxel"))
