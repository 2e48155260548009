"""Plug-ins that cannot be loaded or are no codec end in a coded error that names them; what fails later is theirs."""

from pathlib import Path

import numpy as np
import pytest
from plugins import TOY, toy_stream
from shapes import scene_of, square

from texfcodec import EncodeOptions, Limits, SupportError, codecs, decode, encode, inspect
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
    (TOY.replace("    def dec(", "    def decode("), ("cannot be loaded", "abstract")),
    ("Toy = dict", ("does not provide a codec",)),
    (TOY.replace("id, name, purpose = 200, \"toy\",", "id, purpose = 200,"), ("does not provide a codec",)),
    (TOY.replace('"toy", "to try', '"tor", "to try'), ("does not provide a codec",)),
    (TOY.replace("id, name, purpose = 200,", "name, purpose ="), ("private range", "None")),
    (TOY.replace("= 200,", "= 200.0,"), ("private range", "200.0")),
    (TOY.replace("= 200,", "= True,"), ("private range", "True")),
    (TOY.replace("= 200,", "= 0,"), ("private range", "192..255")),
    (TOY.replace("= 200,", "= 191,"), ("private range", "191")),
    (TOY.replace("= 200,", "= 256,"), ("private range", "256")),
])
def test_plug_in_that_is_none_is_refused_by_name(install, text, names):
    assert text != TOY
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


@pytest.mark.parametrize("method, call", [("enc", lambda data: toy_stream()), ("dec", decode), ("describe", inspect)])
def test_plug_in_that_fails_later_raises_its_own_error(install, method, call):
    install({"toy": "toy_package:Toy"}, toy_package=TOY)
    data = toy_stream()
    lines = f"    def {method}(self, *_):\n        raise RuntimeError('out of luck')\n\n    def _("
    install({"toy": "toy_package:Toy"}, toy_package=TOY.replace(f"    def {method}(", lines))
    with pytest.raises(RuntimeError, match="out of luck"):
        call(data)
