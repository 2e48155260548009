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
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.sandbox import isolate
from texfcodec.sandbox.answer import texf_of
from texfcodec.sandbox.isolate import ChildAnswer, decode_isolated, packed_answer
from texfcodec.sandbox.limited_process import LEAST_BYTES, NO_CAP


def isolated(data, options=None, report=None):
    """decode() in a child, whatever its codec."""
    options = options or DecodeOptions()
    return decode_isolated(data, read_stream(data, options.limits), options, report or Report())


def answered(data, plain, lie=lambda arrays: None, lod=0, threads=1):
    """The Texf that the parent makes of a child's answer with a lie in its arrays. plain: what the child decoded."""
    packed, arrays = packed_answer(plain)
    lie(arrays)
    options = DecodeOptions(lod=lod, threads=threads)
    return texf_of(read_stream(data, Limits()), ChildAnswer(arrays), options, Report(), (packed, arrays))


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
    ours, plain = isolated(stream, options, report), decode(stream, options)
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
    assert_same_network(answered(vector(name), plain, lod=1), plain)


@pytest.mark.parametrize("lod, name", [(0, NEURAL[1]), (2, NEURAL[3])])
def test_isolated_network_answers_as_the_plain_one(name, lod):
    assert_same_network(isolated(vector(name), DecodeOptions(lod=lod)), decode(vector(name), DecodeOptions(lod=lod)))


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
            isolated(vector(f"faulty/neural_{name}"))
        assert raised.value.code == code


def test_parent_never_runs_draco(stream, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    assert len(isolated(stream).faces) > 1000


def test_damaged_draco_is_a_coded_error(stream):
    middle = lambda data: data[: len(data) // 2] + bytes(len(data) - len(data) // 2)
    noise = lambda data: data[:20] + np.random.default_rng(0).bytes(len(data) - 20)
    for change in (middle, noise, lambda data: b"DRACO"):
        with pytest.raises(TexfError) as raised:
            isolated(with_draco(stream, change))
        assert raised.value.code in ("TXF-S20", "TXF-S21", "TXF-S22", "TXF-S23", "TXF-S24", "TXF-S30", "TXF-S40", "TXF-L07")


def test_own_errors_come_through_with_their_facts(stream):
    with pytest.raises(LimitError) as raised:
        isolated(stream, DecodeOptions(limits=Limits(voxels=10)))
    assert raised.value.code == "TXF-L04" and raised.value.details["allowed"] == 10
    with pytest.raises(StreamError) as raised:
        isolated(stream[:-1])
    assert raised.value.code == "TXF-S02" and raised.value.details["clause"] == "5.2"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux caps the memory of a process reliably")
def test_memory_cap_ends_it(sample_scene):
    stream = encode_scene(sample_scene, EncodeOptions(resolution=256, qp=40, effort="fast")).data
    with pytest.raises(LimitError) as raised:
        isolated(stream, DecodeOptions(limits=Limits(isolate_bytes=LEAST_BYTES, isolate_seconds=30)))
    assert raised.value.code == "TXF-L07" and raised.value.details["allowed"] == LEAST_BYTES


def test_time_cap_ends_it(stream):
    with pytest.raises(LimitError) as raised:
        isolated(stream, DecodeOptions(limits=Limits(isolate_seconds=0.05)))
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
        isolated(stream)
    assert raised.value.code == code


def put(name, place, value):
    """A lie: a number of an array is another. name: kind, unit or field, group."""
    def lie(arrays):
        arrays[name] = arrays[name].copy()
        arrays[name][place] = value

    return lie


def change(name, how):
    """A lie: an array is another."""
    return lambda arrays: arrays.__setitem__(name, how(arrays[name]))


def less(name):
    return change(name, lambda array: array[:-1])


def without(name):
    return lambda arrays: arrays.pop(name)


# By vector. texels_mixed has fields over texels, 0 and 2, and over voxels; its units stand as 2, 1, 0. maps_some has a field over
# texels with maps, one over voxels with the same, one over voxels without. normals_coded has marks and coded normals.
LIES = {
    "uncommon/texels_mixed": {
        "face index": put("4 0 0", (0, 0), 10**9), "negative face": put("4 0 0", (0, 0), (1 << 32) - 1),
        "complex faces": change("4 0 0", lambda array: array.astype(complex)), "no faces": without("4 0 0"),
        "lattice": put("2 0 0", (0, 0), 1 << 20), "a coordinate less": change("2 0 0", lambda array: array.reshape(-1)[:-1]),
        "keys out of order": put("6 0 0", 1, 0), "a key beside the plane": put("6 0 0", 0, 4), "fewer keys": less("6 0 0"),
        "a negative key": put("6 1 0", 0, -1), "a key outside the grid": put("6 1 0", -1, 1 << 41), "no keys": without("6 1 0"),
        "fewer values": less("7 0 0"), "no values": without("7 1 0"), "a component less": change("7 0 0", lambda v: v[:, 1:]),
        "values in eighths": change("7 0 0", lambda array: array / 8), "fewer UVs": less("3 0 0"), "no UVs": without("3 2 0"),
        "a UV of 2^26": put("3 0 0", (3, 1), 1 << 26), "the least number there is as a UV": put("3 0 0", (3, 1), -(1 << 31)),
    },
    "uncommon/maps_some": {"fewer values of a map": less("7 1 3"), "a map less": without("7 0 1")},
    "uncommon/normals_coded": {"a mark less": less("8 0 0"), "no marks": without("8 0 0"), "a normal less": less("9 0 0"),
                               "no normals": without("9 0 0")},
    "uncommon/neural_two_fields": {
        "keys out of order": put("latent_keys", 1, 0), "key outside the grid": put("latent_keys", -1, 1 << 40),
        "negative key": put("latent_keys", 0, -1), "fewer keys": less("latent_keys"), "no keys": without("latent_keys"),
        "keys of two numbers": change("latent_keys", lambda keys: np.stack([keys] * 2, 1)), "transport form": put("neural", 0, 1),
        "odd features": put("neural", 1, 3), "no hidden layer": put("neural", 5, 0),
        "parameter not a number": put("neural", slice(40, 60), 0x7E), "fewer latents": less("neural"),
        "no payload": change("neural", lambda array: array[:0]), "fewer values": less("7 1 0"),
    },
}


@pytest.mark.parametrize("name, lie", [(name, lie) for name, lies in LIES.items() for lie in lies])
def test_answer_is_checked_again(name, lie):
    data = vector(name)
    plain = decode(data)
    assert_same(answered(data, plain, threads=plain.threads), plain)
    with pytest.raises(StreamError) as raised:
        answered(data, plain, LIES[name][lie])
    assert raised.value.code == "TXF-S40"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not count a parent's memory")
def test_a_peak_is_that_of_the_process_and_not_of_the_one_that_began_it():
    program = "from texfcodec.report import peak_memory_bytes\nprint(peak_memory_bytes())"
    held = bytearray(b"x" * (300 << 20))
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert 1 << 20 < int(run.stdout) < 200 << 20 < len(held)


def test_a_system_without_a_cap_on_memory_is_a_warning(monkeypatch):
    packed, arrays = packed_answer(decode(vector("uncommon/one_voxel")))
    facts = {"capped": False, "seconds": {}, "peak_memory_bytes": 1, "packed": packed}
    monkeypatch.setattr(isolate, "_run_child", lambda *_: (facts, arrays))
    report = Report()
    isolated(vector("uncommon/one_voxel"), report=report)
    assert report.warnings == [NO_CAP]


def test_a_system_that_starts_no_child_is_a_limit(monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", "a path")

    for place, name in ((tempfile, "mkdtemp"), (subprocess, "Popen")):
        with monkeypatch.context() as patched, pytest.raises(LimitError, match="TXF-L15.*No space left on device"):
            patched.setattr(place, name, full)
            isolated(vector("uncommon/one_voxel"))
