"""Clause 4.4: what a decoder of edition 1.0 does with the additions of a later edition, by our decoder and by the C++ one."""

from pathlib import Path

import pytest

from texfcodec import Limits, Report, SupportError, decode
from texfcodec.sandbox import wasm

VECTORS = Path(__file__).resolve().parents[2] / "conformance"


def refusal(decoder, data):
    with pytest.raises(SupportError) as caught:
        decoder(data)
    return caught.value


@pytest.mark.parametrize("name, code, words, element, value", [
    ("unknown_critical_unit", "TXF-U01", "critical unit", "unit_type", 6), ("codec_id", "TXF-U02", "codec", "codec_id", 7),
    ("codec_id_191", "TXF-U02", "codec", "codec_id", 191), ("private_codec", "TXF-U07", "nobody's, ü", "codec_id", 200),
    ("support_2", "TXF-U09", "support", "support", 2), ("version", "TXF-U04", "version", "version", 2)])
def test_what_a_later_edition_adds_is_refused_as_unsupported_and_named(name, code, words, element, value):
    data = (VECTORS / "faulty" / name / "in.texf").read_bytes()
    ours, other = refusal(decode, data), refusal(lambda data: wasm.Sandbox(Limits()).decode(data, 0), data)
    assert (ours.code, ours.as_dict()["value"], other.code) == (code, value, code)
    assert words in ours.message and f"{element} is {value}" in other.message


@pytest.mark.parametrize("name, types", [("strange_units", [200, 199, 255]), ("metadata_format_1", [128])])
def test_what_a_later_edition_adds_as_ancillary_is_skipped_and_named(name, types):
    report = Report()
    texf = decode((VECTORS / "uncommon" / name / "in.texf").read_bytes(), report=report)
    assert [unit["type"] for unit in texf.skipped] == types and len(texf.faces)
    assert all(str(kind) in "".join(report.warnings) for kind in types)
