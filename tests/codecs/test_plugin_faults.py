"""Plug-ins that are none, or that fail on the way: each ends in a coded error that names it."""

from pathlib import Path

import numpy as np
import pytest
from plugins import JOINT, TOY, toy_stream
from shapes import crossing_sheets, painted_sphere, scene_of, square

from texfcodec import DecodeOptions, EncodeOptions, Limits, SupportError, codecs, decode, encode, inspect
from texfcodec.cli.inputs import checked_stream

VECTORS = Path(__file__).resolve().parents[2] / "conformance"


def fault(call, *names):
    """The SupportError TXF-U08 that a call ends in; it must name all of names."""
    with pytest.raises(SupportError) as raised:
        call()
    assert raised.value.code == "TXF-U08" and all(name in str(raised.value) for name in ("toy", *names)), str(raised.value)
    return raised.value


# Plug-ins that are none


@pytest.mark.parametrize("text, names", [
    ("raise OSError('no such model')", ("cannot be loaded", "OSError: no such model", "toy_package:Toy")),
    ("import sys; sys.exit(0)", ("cannot be loaded", "SystemExit")),
    ("this is no Python", ("cannot be loaded", "SyntaxError")),
    ("", ("cannot be loaded", "AttributeError")),
    ("Toy = 5", ("cannot be loaded", "TypeError")),
    ("class Toy: pass", ("does not provide a codec",)),
    ("Toy = dict", ("does not provide a codec",)),
    (TOY.replace('"toy", "to try', '"tor", "to try'), ("does not provide a codec", "value tor")),
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
    (TOY.replace('"packed", "u8", 0, 1', '"codec_id", "u8", 0, 1'), ("names that the attribute unit uses", "codec_id")),
    (TOY.replace("has_levels = False", "has_levels = None"), ("has_levels", "None")),
    (TOY.replace("has_levels = False", "options = ['qp']"), ("options", "['qp']")),
    (TOY.replace("has_levels = False", "position_bits = 99"), ("position_bits", "99")),
])
def test_plug_in_that_is_none_is_refused_by_name(install, text, names):
    install({"toy": "toy_package:Toy"}, toy_package=text)
    fault(lambda: EncodeOptions(codec="toy"), *names)
    fault(lambda: codecs.codec_of_unit({"codec_id": 200, "codec_name": "toy"}), *names)
    assert EncodeOptions().codec == "raht"  # the others go on


def test_the_page_takes_streams_without_plug_ins_alone(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    options = EncodeOptions(codec="toy", resolution=4, refine="off")
    assert checked_stream((VECTORS / "uncommon" / "one_voxel" / "in.texf").read_bytes(), Limits()) == []
    with pytest.raises(SupportError, match="TXF-U11"):
        checked_stream(encode(scene_of(*square(), np.eye(4)), options), Limits())


@pytest.mark.parametrize("value", ["no module at all", "toy_package", "missing:Toy", "toy_package:Toy.inner"])
def test_entry_point_that_leads_nowhere_is_refused_by_name(install, value):
    install({"toy": value}, toy_package=TOY)
    fault(lambda: EncodeOptions(codec="toy"), value)


def test_list_of_entry_points_that_cannot_be_parsed_harms_nobody_else(install, tmp_path):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"other": "nothing"}, folder="garbled")
    (tmp_path / "garbled" / "garbled-1.0.dist-info" / "entry_points.txt").write_text("[texfcodec.codecs]\nnonsense\n")
    codecs._plugins.cache_clear()
    assert codecs.codec_names() == ["raht", "3dntc", "toy"] and EncodeOptions(codec="toy").codec == "toy"


def test_name_that_fits_no_unit_is_refused(install):
    name = "toy" + "o" * 253
    install({name: "toy_package:Toy"}, toy_package=TOY.replace('"toy", "to try', f'"{name}", "to try'))
    fault(lambda: EncodeOptions(codec=name), "1 to 255 bytes")


def test_two_plug_ins_of_one_name_are_refused_and_both_named(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"toy": "second_package:Toy"}, folder="others", second_package=TOY)
    fault(lambda: EncodeOptions(codec="toy"), "several plug-ins", "toy_package:Toy", "second_package:Toy")


def test_package_that_is_installed_twice_is_one_plug_in(install):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    install({"toy": "toy_package:Toy"}, folder="others", toy_package=TOY)
    assert EncodeOptions(codec="toy").codec == "toy"


def test_plug_in_does_not_take_the_place_of_ours(install):
    install({"raht": "toy_package:Toy"}, toy_package=TOY.replace('"toy", "to try', '"raht", "to try'))
    assert type(codecs.codec_of("raht")).__module__ == "texfcodec.codecs.raht.raht_codec"
    assert codecs.codec_names() == ["raht", "3dntc"]
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
    (WHOLE, "return {}, decoded", ("missing in its table", "KeyError")),
    (WHOLE, "return {'packed': 2, 'toy_data': b''}, decoded", ("missing in its table", "TXF-S04")),
    (WHOLE, "return {'packed': 'yes', 'toy_data': b''}, decoded", ("missing in its table",)),
    (WHOLE, "return {'packed': 1, 'toy_data': 7.5}, decoded", ("missing in its table",)),
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
    ('return {"packed": values["packed"]', 'return {"codec": "raht"', ("describes facts that every unit has", "codec")),
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
    text = TOY.replace(", decoded\n", ", np.asfortranarray(decoded)\n")
    text = text.replace(READ, f"return np.asfortranarray({READ.removeprefix('return ')})")
    install({"toy": "toy_package:Toy"}, toy_package=text)
    assert toy_stream() == wanted
    assert np.array_equal(decode(wanted).fields[0].rgba, decode(toy_stream()).fields[0].rgba)


def asked(data):
    """What a stream's first point answers."""
    return decode(data).query([[0, 0, 0]])


LAST = "[Tint(tint) for _ in source.surfaces], {\"tint\": tint})"


@pytest.mark.parametrize("old, new, names", [
    ("return Joint({", "raise RuntimeError('out of luck'); return Joint({", ("failed in enc()", "out of luck")),
    ("return Joint({\"tint\": tint}", "return tuple(({\"tint\": tint},)); return Joint({}", ("does not return a Joint",)),
    ("return Joint({\"tint\": tint}", "return Joint([tint]", ("does not return a Joint",)),
    ("return Joint({\"tint\": tint}", "return Joint({\"tint\": tint[1:]}", ("missing in its table",)),
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
    ("        return out", "        return out[:, :2]", asked, ("wrong kind", "float32")),
    ("        return out", "        return out + 1j", asked, ("wrong kind", "complex")),
    ("        return out", "        raise ValueError('lost')", asked, ("failed in query()", "lost")),
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


def test_child_that_decodes_tells_the_fault_of_a_plug_in(install, monkeypatch, tmp_path):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(READ, "raise RuntimeError('out of luck')"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "strangers"))
    fault(lambda: decode(data, DecodeOptions(isolate=True)), "failed in dec()", "out of luck")
