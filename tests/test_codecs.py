"""The registry of codecs, and plug-ins: what a sound one can do, and that a fault in one is told as its own."""

import importlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import REPOSITORY
from plugins import JOINT, TOY, write_plugin
from shapes import crossing_sheets, painted_sphere, square

import texfcodec
from texfcodec import DecodeOptions, EncodeOptions, InputError, Limits, SupportError, codecs, decode, encode, inspect
from texfcodec.bitstream.inspect import _groups
from texfcodec.bitstream.stream import Stream, attribute_variables, read_stream, write_stream
from texfcodec.bitstream.syntax import ATTRIBUTE
from texfcodec.codecs import guest
from texfcodec.report import Report


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Puts plug-ins on the path as their packages would: install(points, folder="strangers", module=text, ...)."""
    before = set(sys.modules)

    def forget():
        importlib.invalidate_caches()
        for cached in (codecs._guests, codecs._guest):
            cached.cache_clear()
        for name in set(sys.modules) - before:
            if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]

    def put(points, folder="strangers", **modules):
        monkeypatch.syspath_prepend(str(write_plugin(tmp_path / folder, points, **modules)))
        forget()

    yield put
    monkeypatch.undo()
    forget()


def toy_stream(**options):
    return encode(crossing_sheets(), EncodeOptions(codec="toy", resolution=24, refine="off", **options))


def fault(call, *names):
    """The SupportError TXF-U08 that a call ends in; it must name all of names."""
    with pytest.raises(SupportError) as raised:
        call()
    assert raised.value.code == "TXF-U08" and all(name in str(raised.value) for name in ("toy", *names)), str(raised.value)
    return raised.value


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
    assert raised.value.code == "TXF-I50" and "the encoder takes it where it suits" in str(raised.value)


@pytest.mark.parametrize("settings", [["pack"], "pack", 5, None])
def test_settings_of_a_plug_in_are_a_dict(settings):
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec_options=settings)
    assert raised.value.code == "TXF-I50"


def test_settings_of_a_plug_in_have_no_part_in_our_codecs():
    with pytest.raises(InputError) as raised:
        EncodeOptions(codec_options={"pack": True})
    assert raised.value.code == "TXF-I50" and raised.value.details["value"] == "pack"


def test_names_that_a_stranger_may_not_take_are_those_that_stand_beside_its_own():
    stream = Stream({"channel_groups": [{"group_components": 3, "group_semantic": 0}]}, fields=[{"resolution": 4}])
    values = {"field_index": 0, "group_index": 0, "codec_id": 2, "plane_value": [1, 2, 3]}
    there = {element.name for element in ATTRIBUTE.elements} | attribute_variables(stream, values).keys() | {"offset"}
    assert there == guest.UNIT
    stream.attributes = [values]
    assert _groups(stream, [9])[0].keys() - {"qp", "codeword_bytes", "slice_level", "level_bytes", "value"} == guest.INSPECTED


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
    with pytest.raises(InputError, match="qp has no part in codec toy"):
        EncodeOptions(codec="toy", qp=30)


def test_decoder_without_the_plug_in_names_it(install, monkeypatch):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    monkeypatch.setattr(codecs, "_guests", dict)
    for call in (decode, inspect):
        with pytest.raises(SupportError) as raised:
            call(data)
        assert raised.value.code == "TXF-U07" and "'toy'" in str(raised.value) and raised.value.exit_code == 5


def test_strangers_of_one_id_are_told_apart_by_name(install):
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
    stream = read_stream(toy_stream(), Limits())
    data = write_stream(stream)[0]
    renamed = _renamed(data, b"toy", b"yot")
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
    """A folder with both plug-ins and a mesh, and what runs a tool there: call("enc", ...) -> CompletedProcess."""
    folder = tmp_path_factory.mktemp("bench")
    write_plugin(folder / "strangers", {"toy": "toy_package:Toy", "tint": "tint_package:Tinted"}, toy_package=TOY,
                 tint_package=JOINT)
    corners, faces = square()
    lines = [f"v {x} {y} {z} {x} {y} 0.5" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "in.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def call(tool, *arguments, plugins=True):
        paths = [str(REPOSITORY), *([str(folder / "strangers")] if plugins else [])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        return subprocess.run([sys.executable, "-m", f"texfcodec.cli.{tool}", *map(str, arguments)], cwd=folder, env=environment,
                              capture_output=True, text=True, check=False)

    call.folder = folder
    return call


@pytest.mark.parametrize("name, told", [("toy", "toy: "), ("tint", ", tint")])
def test_tools_take_a_plug_in(bench, name, told):
    made = bench("enc", "in.obj", f"{name}.texf", "--codec", name, "--resolution", "16")
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
    assert bench("enc", "in.obj", "lonely.texf", "--codec", "toy", "--resolution", "8").returncode == 0
    refused = bench(tool, "lonely.texf", *extra, plugins=False)
    assert refused.returncode == 5 and "TXF-U07" in refused.stderr and "'toy'" in refused.stderr


def test_isolated_joint_plug_in_answers_as_the_plain_one(bench):
    assert bench("enc", "in.obj", "both.texf", "--codec", "tint", "--resolution", "8").returncode == 0
    program = ("from texfcodec import DecodeOptions, decode; a = decode('both.texf', DecodeOptions(isolate=True)); "
               "b = decode('both.texf'); p = b.positions; assert a.query(p).tobytes() == b.query(p).tobytes() and len(p) == 4; "
               "assert a.codec.name == b.codec.name == 'tint'")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), str(bench.folder / "strangers")])}
    done = subprocess.run([sys.executable, "-c", program], cwd=bench.folder, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


# Plug-ins that are none


@pytest.mark.parametrize("text, names", [
    ("raise OSError('no such model')", ("cannot be loaded", "OSError: no such model", "toy_package:Toy")),
    ("import sys; sys.exit(0)", ("cannot be loaded", "SystemExit")),
    ("this is no Python", ("cannot be loaded", "SyntaxError")),
    ("", ("cannot be loaded", "AttributeError")),
    ("Toy = 5", ("cannot be loaded", "TypeError")),
    ("class Toy: pass", ("does not give a codec",)),
    ("Toy = dict", ("does not give a codec",)),
    (TOY.replace('"toy", "to try', '"tor", "to try'), ("does not give a codec", "value tor")),
    (TOY.replace("    def dec(", "    def decode("), ("cannot be loaded", "abstract")),
    (TOY.replace("id, name, purpose = 200,", "name, purpose ="), ("id", "None")),
    (TOY.replace("= 200,", "= 200.0,"), ("id", "200.0")),
    (TOY.replace("= 200,", "= True,"), ("id", "True")),
    (TOY.replace("= 200,", "= 0,"), ("claims the id of 'raht'", "192..255")),
    (TOY.replace("= 200,", "= 2,"), ("claims the id of 'constant'", "192..255")),
    (TOY.replace("= 200,", "= 191,"), ("outside the private range", "191", "192..255")),
    (TOY.replace("= 200,", "= 256,"), ("outside the private range", "256", "192..255")),
    (TOY.replace("= 200,", "= -1,"), ("outside the private range", "192..255")),
    (TOY.replace("structures = (PARAMETERS,)", "structures = ()"), ("structures", "()")),
    (TOY.replace("structures = (PARAMETERS,)", "pass"), ("structures", "()")),
    (TOY.replace("structures = (PARAMETERS,)", "structures = (5,)"), ("structures", "(5,)")),
    (TOY.replace("structures = (PARAMETERS,)", "structures = PARAMETERS"), ("structures",)),
    (TOY.replace('"packed", "u8", 0, 1', '"codec_id", "u8", 0, 1'), ("names of the attribute unit", "codec_id")),
    (TOY.replace("has_levels = False", "has_levels = None"), ("has_levels", "None")),
    (TOY.replace("has_levels = False", "options = ['qp']"), ("options", "['qp']")),
    (TOY.replace("has_levels = False", "position_bits = 99"), ("position_bits", "99")),
])
def test_plug_in_that_is_none_is_refused_by_name(install, text, names):
    install({"toy": "toy_package:Toy"}, toy_package=text)
    fault(lambda: EncodeOptions(codec="toy"), *names)
    fault(lambda: codecs.codec_of_unit({"codec_id": 200, "codec_name": "toy"}), *names)
    assert EncodeOptions().codec == "raht"  # the others go on


@pytest.mark.parametrize("value", ["no module at all", "toy_package", "missing:Toy", "toy_package:Toy.inner"])
def test_entry_point_that_leads_nowhere_is_refused_by_name(install, value):
    install({"toy": value}, toy_package=TOY)
    fault(lambda: EncodeOptions(codec="toy"), value)


def test_name_that_fits_no_unit_is_refused(install):
    name = "toy" + "o" * 253
    install({name: "toy_package:Toy"}, toy_package=TOY.replace('"toy", "to try', f'"{name}", "to try'))
    fault(lambda: EncodeOptions(codec=name), "1 to 255 bytes")


def test_two_plug_ins_of_one_name_are_refused_and_both_named(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"toy": "second_package:Toy"}, folder="others", second_package=TOY)
    fault(lambda: EncodeOptions(codec="toy"), "more than one", "toy_package:Toy", "second_package:Toy")


def test_package_that_is_installed_twice_is_one_plug_in(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"toy": "toy_package:Toy"}, folder="others", toy_package=TOY)
    assert EncodeOptions(codec="toy").codec == "toy"


def test_plug_in_does_not_take_the_place_of_ours(install):
    install({"raht": "toy_package:Toy"}, toy_package=TOY.replace('"toy", "to try', '"raht", "to try'))
    assert type(codecs.codec_of("raht")).__module__ == "texfcodec.codecs.raht.unit" and codecs.codec_names() == ["raht", "3dntc"]
    with pytest.raises(SupportError) as raised:
        codecs.codec_of_unit({"codec_id": 200, "codec_name": "raht"})
    assert raised.value.code == "TXF-U07"


# Plug-ins that fail on the way

WHOLE = "return {\"packed\": int(packed), \"toy_data\": zlib.compress(data) if packed else data}, decoded"
READ = "return np.frombuffer(data, np.uint8).reshape(len(support), values[\"NumComponents\"])"


@pytest.mark.parametrize("old, new, names", [
    (WHOLE, "raise RuntimeError('out of luck')", ("failed in enc()", "RuntimeError: out of luck")),
    (WHOLE, "import sys; sys.exit(1)", ("failed in enc()", "SystemExit")),
    (WHOLE, "return None", ("does not return (values, decoded)",)),
    (WHOLE, "return decoded", ("does not return (values, decoded)",)),
    (WHOLE, "return {}, decoded, 1", ("does not return (values, decoded)",)),
    (WHOLE, "return [], decoded", ("does not return (values, decoded)",)),
    (WHOLE, "return {}, decoded[:-1]", ("wrong kind", "uint8")),
    (WHOLE, "return {}, decoded[:, :-1]", ("wrong kind", "uint8")),
    (WHOLE, "return {}, decoded.astype(float)", ("wrong kind", "float64")),
    (WHOLE, "return {}, decoded.tolist()", ("wrong kind", "list")),
    (WHOLE, "return {}, None", ("wrong kind", "NoneType")),
    (WHOLE, "return {}, decoded", ("its table does not hold", "KeyError")),
    (WHOLE, "return {'packed': 2, 'toy_data': b''}, decoded", ("its table does not hold", "TXF-S04")),
    (WHOLE, "return {'packed': 'yes', 'toy_data': b''}, decoded", ("its table does not hold",)),
    (WHOLE, "return {'packed': 1, 'toy_data': 7.5}, decoded", ("its table does not hold",)),
    ("if options.codec_options", "if options.codec_opinions", ("failed in check_options()", "AttributeError")),
])
def test_plug_in_that_fails_in_coding_is_named(install, old, new, names):
    assert old in TOY
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(old, new))
    fault(toy_stream, *names)


@pytest.mark.parametrize("old, new, names", [
    (READ, "raise RuntimeError('out of luck')", ("failed in dec()", "RuntimeError: out of luck")),
    (READ, "return np.frombuffer(data, np.uint8)", ("wrong kind",)),
    (READ, READ + ".astype(np.int16)", ("wrong kind", "int16")),
    (READ, READ + "[1:]", ("wrong kind",)),
    (READ, "return None", ("wrong kind", "NoneType")),
    ("def describe", "def check(self, values):\n        1 / 0\n\n    def describe", ("failed in check()", "ZeroDivisionError")),
    ('Element("packed", "u8", 0, 1)', 'Element("packed", "u8", count="nobody")', ("has a table that cannot be read",)),
    ('Element("packed", "u8", 0, 1)', 'Element("packed", "u9")', ("has a table that cannot be read",)),
])
def test_plug_in_that_fails_in_decoding_is_named(install, old, new, names):
    assert old in TOY
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(old, new))
    fault(lambda: decode(data), *names)


@pytest.mark.parametrize("old, new, names", [
    ('return {"packed": values["packed"]', 'return {"packed": values["pack"]', ("failed in describe()", "KeyError")),
    ('return {"packed": values["packed"]', 'return 5 if values else {"a": 0', ("failed in describe()", "not a dict")),
    ('return {"packed": values["packed"]', 'return {"packed": values["toy_data"]', ("failed in describe()", "JSON")),
    ('return {"packed": values["packed"]', 'return {"packed": float("nan")', ("failed in describe()", "ValueError")),
    ('return {"packed": values["packed"]', 'return {"codec": "raht"', ("describes what every unit has", "codec")),
])
def test_plug_in_that_fails_in_describing_is_named(install, old, new, names):
    assert old in TOY
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(old, new))
    fault(lambda: inspect(data), *names)


@pytest.mark.parametrize("new, names", [
    ("yield group['nothing']", ("failed in info_lines()", "KeyError")),
    ("yield 5", ("lines of text from info_lines()",)),
    ("return 5", ("failed in info_lines()", "TypeError")),
])
def test_plug_in_that_fails_in_its_lines_is_named(install, new, names):
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace("yield f\"toy: {group['data_bytes']} bytes\"", new))
    fault(lambda: codecs.codec_of("toy").info_lines({"data_bytes": 3}), *names)


@pytest.mark.parametrize("seconds", ["float('nan')", "-1.0", "float('inf')", "None", "'long'"])
def test_plug_in_that_guesses_no_time_is_named(install, seconds):
    text = TOY.replace("def describe", f"def seconds(self, options):\n        return {seconds}\n\n    def describe")
    install({"toy": "toy_package:Toy"}, toy_package=text)
    fault(lambda: codecs.codec_of("toy").seconds(EncodeOptions(codec="toy")), "seconds()")


def test_plug_in_cannot_change_what_it_is_given_nor_the_unit(install):
    text = TOY.replace(WHOLE, "plane[:] = 0; return {'packed': 0, 'toy_data': data, 'codec_id': 0, 'values_crc': 1}, decoded")
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    wanted = toy_stream()
    install({"toy": "toy_package:Toy"}, toy_package=text)
    assert toy_stream() == wanted


def test_plane_that_is_not_contiguous_is_as_good(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    wanted = toy_stream()
    text = TOY.replace(", decoded\n", ", np.asfortranarray(decoded)\n").replace(READ, "return np.asfortranarray(" + READ[7:] + ")")
    install({"toy": "toy_package:Toy"}, toy_package=text)
    assert toy_stream() == wanted
    assert np.array_equal(decode(wanted).fields[0].rgba, decode(toy_stream()).fields[0].rgba)


LAST = "[Tint(tint, columns) for _ in source.surfaces], {\"tint\": tint})"


@pytest.mark.parametrize("old, new, names", [
    ("return Joint({", "raise RuntimeError('out of luck'); return Joint({", ("failed in enc()", "out of luck")),
    ("return Joint({\"tint\": tint}", "return tuple(({\"tint\": tint},)); return Joint({}", ("does not return a Joint",)),
    ("return Joint({\"tint\": tint}", "return Joint([tint]", ("does not return a Joint",)),
    ("return Joint({\"tint\": tint}", "return Joint({\"tint\": tint[1:]}", ("its table does not hold",)),
    (LAST, "[], {})", ("an evaluator for every field",)),
    (LAST, "None, {})", ("an evaluator for every field",)),
    (LAST, LAST.replace("{\"tint\": tint}", "{\"tint\": np.zeros(3)}"), ("JSON",)),
    (LAST, LAST.replace("{\"tint\": tint}", "None"), ("JSON",)),
    ("return np.tile(self.tint, (len(support), 1))", "return np.tile(self.tint, (len(support), 2))", ("wrong kind",)),
    ("return np.tile(self.tint, (len(support), 1))", "raise MemoryError", ("failed in values()", "MemoryError")),
])
def test_joint_plug_in_that_fails_in_coding_is_named(install, old, new, names):
    assert old in JOINT
    install({"toy": "toy_package:Tinted"}, toy_package=JOINT.replace('"tint"\n', '"toy"\n').replace(old, new))
    fault(lambda: encode(crossing_sheets(), EncodeOptions(codec="toy", resolution=8)), *names)


@pytest.mark.parametrize("old, new, call, names", [
    ("return [Tint(values[", "return [] and [Tint(values[", decode, ("an evaluator for every field",)),
    ("return [Tint(values[", "return 5 or [Tint(values[", decode, ("an evaluator for every field",)),
    ("        return out", "        return out[:, :3]", lambda data: decode(data).query([[0, 0, 0]]), ("wrong kind", "float32")),
    ("        return out", "        return out / 0.5 + 1j", lambda data: decode(data).query([[0, 0, 0]]), ("wrong kind", "complex")),
    ("    def enc(", "    def count_samples(self, values, surfaces, bits):\n        return -1\n\n    def enc(", decode,
     ("count_samples()", "-1")),
    ("    def enc(", "    def count_samples(self, values, surfaces, bits):\n        return None\n\n    def enc(", decode,
     ("count_samples()", "TypeError")),
])
def test_joint_plug_in_that_fails_in_decoding_is_named(install, old, new, call, names):
    text = JOINT.replace('"tint"\n', '"toy"\n')
    assert old in text
    install({"toy": "toy_package:Tinted"}, toy_package=text)
    data = encode(crossing_sheets(), EncodeOptions(codec="toy", resolution=8))
    install({"toy": "toy_package:Tinted"}, toy_package=text.replace(old, new))
    fault(lambda: call(data), *names)


@pytest.mark.parametrize("old, new", [
    ('return {"count": len(evaluators)}', 'return {"count": evaluators}'),
    ('{"keys": np.array([one.tint for one in evaluators])}', '{"keys": np.array([evaluators])}'),
    ('return {"count": len(evaluators)}, ', 'return '),
])
def test_joint_plug_in_that_cannot_be_packed_is_named(install, old, new):
    text = JOINT.replace('"tint"\n', '"toy"\n')
    assert old in text
    install({"toy": "toy_package:Tinted"}, toy_package=text.replace(old, new))
    texf = decode(encode(painted_sphere(), EncodeOptions(codec="toy", resolution=8)))
    fault(lambda: texf.codec.pack(texf.evaluators), "failed in pack()")


def test_report_of_a_plug_in_that_fails_says_its_name_on_the_command_line(bench):
    broken = bench.folder / "strangers" / "toy_broken.py"
    write_plugin(bench.folder / "broken", {"toy_broken": "toy_broken:Toy"}, toy_broken="raise OSError('no such model')")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), str(bench.folder / "broken")])}
    command = [sys.executable, "-m", "texfcodec.cli.enc", "in.obj", "x.texf", "--codec"]
    run = lambda codec: subprocess.run([*command, codec], cwd=bench.folder, env=environment, capture_output=True, text=True,
                                       check=False)
    refused = run("toy_broken")
    assert (refused.returncode, broken.exists()) == (5, False)
    assert "TXF-U08" in refused.stderr and "'toy_broken'" in refused.stderr and "Traceback" not in refused.stderr
    assert run("raht").returncode == 0


def test_child_that_decodes_tells_the_fault_of_a_plug_in(install, monkeypatch, tmp_path):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(READ, "raise RuntimeError('out of luck')"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "strangers"))
    fault(lambda: decode(data, DecodeOptions(isolate=True), Report()), "failed in dec()", "out of luck")
