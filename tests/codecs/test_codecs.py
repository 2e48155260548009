"""The registry of codecs, and what a sound plug-in can do: in Python, in the tools, and in the child that decodes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import REPOSITORY
from plugins import JOINT, TOY, toy_stream, write_plugin
from shapes import crossing_sheets, square

import texfcodec
from texfcodec import DecodeOptions, EncodeOptions, InputError, Limits, SupportError, codecs, decode, encode, inspect
from texfcodec.bitstream.stream import read_stream

# The registry


def test_registry_knows_our_codecs_by_name_and_id():
    for name, (number, *_) in codecs.OURS.items():
        codec = codecs.codec_of(name)
        assert (codec.id, codec.name) == (number, name) and codecs.codec_of_unit({"codec_id": number}) is codec
    assert codecs.codec_names() == ["raht", "3dntc"]
    numbers = [codec.id for codec in codecs.our_codecs()]
    assert len(set(numbers)) == len(numbers) and not set(numbers) & set(codecs.PRIVATE_IDS)


@pytest.mark.parametrize("name", ["nope", "", 7, None, ["raht"], {"raht": 0}])
def test_unknown_codec_is_refused_with_the_names_that_there_are(name):
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec=name)
    assert raised.value.code == "TXF-I50" and raised.value.details["allowed"] == "raht, 3dntc"


def test_constant_cannot_be_asked_for():
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec="constant")
    assert raised.value.code == "TXF-I50" and "the encoder uses it where it is suitable" in str(raised.value)


@pytest.mark.parametrize("settings", [["pack"], "pack", 5, None])
def test_settings_of_a_plug_in_are_a_dict(settings):
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec_options=settings)
    assert raised.value.code == "TXF-I50"


def test_settings_of_a_plug_in_have_no_part_in_our_codecs():
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec_options={"pack": True})
    assert raised.value.code == "TXF-I50" and raised.value.details["value"] == "pack"


# A sound plug-in


@pytest.mark.parametrize("settings", [{}, {"pack": True}])
def test_plug_in_codes_and_decodes(install, settings):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    assert codecs.codec_names() == ["raht", "3dntc", "toy"]
    data = toy_stream(codec_options=settings)
    exact = decode(encode(crossing_sheets(), EncodeOptions(lossless=True, resolution=24)))
    texf = decode(data)
    assert texf.has_alpha and len(texf.fields) == len(exact.fields) > 1
    for one, other in zip(texf.fields, exact.fields, strict=True):
        assert np.array_equal(one.keys, other.keys) and np.array_equal(one.rgba, other.rgba)
    unit = read_stream(data, Limits()).attributes[0]
    assert (unit["codec_id"], unit["codec_name"], unit["packed"]) == (200, "toy", int("pack" in settings))
    groups = inspect(data)["groups"]
    assert {(g["codec"], g["codec_id"], g["packed"]) for g in groups if g["codec"] != "constant"} \
        == {("toy", 200, int("pack" in settings))}
    assert texf.query(texf.positions[:5], np.zeros(5, np.int64)).shape == (5, 4)


@pytest.mark.parametrize("lod", [1, 2, 9])
def test_levels_of_detail_of_a_codec_without_levels_are_means(install, lod):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    for one, whole in zip(decode(data, DecodeOptions(lod=lod)).fields, decode(data).fields, strict=True):
        assert np.array_equal(one.keys, whole.support.coarser(lod).keys)
        for name, plane in one.planes.items():
            assert np.array_equal(plane, whole.support.mean(whole.planes[name], lod))


def test_settings_of_a_plug_in_are_checked_by_it(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    with pytest.raises(InputError, match="toy knows pack alone"):
        EncodeOptions(codec="toy", codec_options={"depth": 3})
    with pytest.raises(InputError, match="qp does not apply to codec toy"):
        EncodeOptions(codec="toy", qp=30)


def test_decoder_without_the_plug_in_names_it(install, monkeypatch):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    monkeypatch.setattr(codecs, "_plugins", dict)
    for call in (decode, inspect):
        with pytest.raises(SupportError) as raised:
            call(data)
        assert raised.value.code == "TXF-U07" and "'toy'" in str(raised.value) and raised.value.exit_code == 5


def test_plugins_of_one_id_are_told_apart_by_name(install):
    other = TOY.replace('"toy"', '"other"').replace("Toy", "Other").replace("decoded.tobytes()", "decoded.tobytes()[::-1]")
    other = other.replace('np.frombuffer(data, np.uint8)', 'np.frombuffer(data, np.uint8)[::-1]')
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"other": "other_package:Other"}, folder="others", other_package=other)
    ours, theirs = (encode(crossing_sheets(), EncodeOptions(codec=name, resolution=12)) for name in ("toy", "other"))
    assert ours != theirs
    for one, another in zip(decode(ours).fields, decode(theirs).fields, strict=True):
        assert np.array_equal(one.rgba, another.rgba)


def test_stream_of_another_codec_of_the_same_id_is_refused_by_name(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    renamed = _renamed(toy_stream(), b"toy", b"yot")
    with pytest.raises(SupportError) as raised:
        decode(renamed)
    assert raised.value.code == "TXF-U07" and "'yot'" in str(raised.value)


def test_stream_of_the_same_name_and_another_id_is_refused(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    renamed = _renamed(toy_stream(), b"\xc8\x03toy", b"\xc9\x03toy")
    with pytest.raises(SupportError) as raised:
        decode(renamed)
    assert raised.value.code == "TXF-U07" and raised.value.details["value"] == 201


def _renamed(data, old, new):
    """The stream with other bytes of the same number in its attribute units."""
    from texfcodec.bitstream.syntax import SIGNATURE, UNIT_END
    from texfcodec.bitstream.units import read_units, write_unit

    units = sorted((unit for kind in read_units(data, None) for unit in kind), key=lambda unit: unit.start)
    changed = [write_unit(unit.type, data[unit.begin : unit.end].replace(old, new)) for unit in units]
    assert any(old in data[unit.begin : unit.end] for unit in units)
    return SIGNATURE + b"".join(changed) + write_unit(UNIT_END, b"")


def test_joint_plug_in_answers_points(install):
    install({"tint": "tint_package:Tinted"}, tint_package=JOINT)
    made = texfcodec.encode_to_result(crossing_sheets(), EncodeOptions(codec="tint", resolution=16))
    assert made.choices["tint"] == [200, 100, 50, 25]
    texf = decode(made.data)
    assert len(texf.fields) > 1 and all((f.rgba == [200, 100, 50, 25]).all() for f in texf.fields)
    points = texf.origin + texf.side * np.random.default_rng(1).uniform(0, 1, (50, 3))
    assert (texf.query(points, np.zeros(50, np.int64)) == [200, 100, 50, 25]).all()
    (group,) = inspect(made.data)["groups"]
    assert (group["codec"], group["semantic"]) == ("tint", "all fields and groups")


# The tools, in processes of their own: nothing of this one's path is known there


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with both plug-ins, a mesh and a stream of each; what runs a tool there: call("enc", ...) -> CompletedProcess."""
    folder = tmp_path_factory.mktemp("bench")
    write_plugin(folder / "plugins", {"toy": "toy_package:Toy", "tint": "tint_package:Tinted"}, toy_package=TOY,
                 tint_package=JOINT)
    corners, faces = square()
    lines = [f"v {x} {y} {z} {x} {y} 0.5" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "in.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def call(tool, *arguments, plugins=True):
        paths = [str(REPOSITORY), *([str(folder / "plugins")] if plugins else [])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        return subprocess.run([sys.executable, "-m", f"texfcodec.cli.{tool}", *map(str, arguments)], cwd=folder, env=environment,
                              capture_output=True, text=True, check=False)

    call.folder = folder
    call.encoded = {name: call("enc", "in.obj", f"{name}.texf", "--codec", name, "--resolution", 16) for name in ("toy", "tint")}
    return call


@pytest.mark.parametrize("name, told", [("toy", "toy: "), ("tint", ", tint")])
def test_tools_take_a_plug_in(bench, name, told):
    made = bench.encoded[name]
    assert made.returncode == 0, made.stderr
    assert ("tinted [200, 100, 50]" if name == "tint" else "K 16, toy, 1 field") in made.stdout
    listed = bench("info", f"{name}.texf", "--verify")
    assert listed.returncode == 0 and told in listed.stdout and "verified: OK" in listed.stdout
    assert "codec_name = " + json.dumps(name) in listed.stdout
    for isolate in ((), ("--isolate",)):
        decoded = bench("dec", f"{name}.texf", f"{name}{len(isolate)}.npz", *isolate)
        assert decoded.returncode == 0, decoded.stderr
    one, other = (np.load(bench.folder / f"{name}{i}.npz") for i in (0, 1))
    assert set(one.files) == set(other.files) and all(np.array_equal(one[key], other[key]) for key in one.files)


@pytest.mark.parametrize("tool, extra", [("info", ()), ("dec", ("x.npz",)), ("dec", ("x.npz", "--isolate"))])
def test_tools_without_the_plug_in_name_it(bench, tool, extra):
    refused = bench(tool, "toy.texf", *extra, plugins=False)
    assert refused.returncode == 5 and "TXF-U07" in refused.stderr and "'toy'" in refused.stderr


def test_isolated_joint_plug_in_answers_as_the_plain_one(bench):
    program = ("from texfcodec import DecodeOptions, decode; a = decode('tint.texf', DecodeOptions(isolate=True)); "
               "b = decode('tint.texf'); p = b.positions; assert a.query(p).tobytes() == b.query(p).tobytes() and len(p) == 4; "
               "assert a.codec.name == b.codec.name == 'tint'")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), str(bench.folder / "plugins")])}
    done = subprocess.run([sys.executable, "-c", program], cwd=bench.folder, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


def test_report_of_a_plug_in_that_fails_says_its_name_on_the_command_line(bench):
    broken = bench.folder / "plugins" / "toy_broken.py"
    write_plugin(bench.folder / "broken", {"toy_broken": "toy_broken:Toy"}, toy_broken="raise OSError('no such model')")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), str(bench.folder / "broken")])}
    command = [sys.executable, "-m", "texfcodec.cli.enc", "in.obj", "x.texf", "--codec"]
    run = lambda codec: subprocess.run([*command, codec], cwd=bench.folder, env=environment, capture_output=True, text=True,
                                       check=False)
    refused = run("toy_broken")
    assert (refused.returncode, broken.exists()) == (5, False)
    assert "TXF-U08" in refused.stderr and "'toy_broken'" in refused.stderr and "Traceback" not in refused.stderr
    assert run("raht").returncode == 0
