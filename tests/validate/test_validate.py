"""texf-validate: the decoder's first error, every error behind it once, and what is odd about valid streams."""

import json
import subprocess
import tracemalloc
from functools import lru_cache

import numpy as np
import pytest
from conftest import REPOSITORY
from plugins import TOY, toy_stream

from conformance.make.faulty import flipped, parsed, with_units, with_values, written
from texfcodec.api import decode, inspect
from texfcodec.bitstream.syntax import (
    SIGNATURE,
    UNIT_ATTRIBUTE,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
)
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.errors import LimitError, StreamError, SupportError, TexfError
from texfcodec.findings import BY_CODE, ERROR, FINDINGS
from texfcodec.geometry.geometry_unit import GeometryUnit
from texfcodec.limits import Limits
from texfcodec.options import DecodeOptions
from texfcodec.validate import framing, mesh_check, oddities, sandboxed
from texfcodec.validate.listing import MOST_OF_A_CODE, Listing, Oddity
from texfcodec.validate.validate import OUTCOME, ROW, validate

VECTORS = REPOSITORY / "conformance"
SMALL = Limits(voxels=1 << 18, samples=1 << 21)  # a lying resolution may cost a tenth of a second, no more


@lru_cache
def vector(name):
    """Bytes of a conformance vector."""
    return (VECTORS / name / "in.texf").read_bytes()


def codes(outcome, severity=ERROR):
    """Codes of one severity, in order."""
    return [row["code"] for row in outcome["findings"] if row["severity"] == severity]


def refusal(data, limits=SMALL):
    """The code that the decoder refuses a stream with, in a list; [] where it decodes."""
    try:
        decode(data, DecodeOptions(limits=limits, threads=1))
    except TexfError as error:
        return [error.code]
    return []


def first_unit(data, kind, number=0):
    """A unit of a type."""
    return [unit for unit in read_units(data)[0] if unit.type == kind][number]


# Errors


@pytest.mark.parametrize("kind", ["subset", "uncommon", "faulty"])
def test_the_first_error_of_every_vector_is_the_decoders_and_no_other_follows_from_it(kind):
    for folder in sorted(path.parent for path in (VECTORS / kind).glob("*/case.json")):
        case, name = json.loads((folder / "case.json").read_text(encoding="utf-8")), f"{kind}/{folder.name}"
        outcome = validate(vector(name))
        found = codes(outcome)
        assert found[:1] == [case["code"]][:kind == "faulty"] if kind == "faulty" else found == [], name
        assert len(found) == (kind == "faulty") or case["clauses"] == ["9.2"], (name, found)  # of the order of two faults
        assert (outcome["exit_code"] == 0) == (kind != "faulty") and outcome.keys() == OUTCOME, name
        assert kind == "faulty" or not outcome["not_checked"], name
        json.dumps(outcome, allow_nan=False)


def test_the_first_error_is_the_decoders_wherever_a_byte_of_a_payload_changes():
    data, rng = vector("subset/two_fields"), np.random.default_rng(3)
    seen = set()
    for unit in read_units(data)[0]:
        for at in rng.choice(np.arange(unit.begin, unit.end), 14):
            payload = bytearray(data[unit.begin : unit.end])
            payload[at - unit.begin] ^= 1 << int(rng.integers(8))
            changed = data[: unit.start] + write_unit(unit.type, bytes(payload)) + data[unit.stop :]
            expected = refusal(changed)
            assert codes(validate(changed, SMALL))[:1] == expected, (unit.name, at)
            seen |= {*expected}
    assert len(seen) > 4


def test_the_first_error_is_the_decoders_for_every_prefix():
    data = vector("subset/k3")
    for end in range(0, len(data), 5):
        assert codes(validate(data[:end], SMALL)) == refusal(data[:end]), end


@pytest.mark.parametrize("kind", [UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE, UNIT_METADATA,
                                  UNIT_END])
def test_a_wrong_checksum_is_one_finding_and_what_needs_the_unit_is_not_checked(kind):
    outcome = validate(flipped(vector("subset/metadata"), kind))
    assert codes(outcome) == ["TXF-S03"] and outcome["findings"][0]["unit_type"] == kind
    left = {unit["unit_type"] for unit in outcome["not_checked"]}
    needed = {UNIT_HEADER: {1, 2, 3, 4}, UNIT_FIELD: {3, 4}, UNIT_GEOMETRY: {2, 4}}
    assert left == needed.get(kind, set())


def test_two_faults_in_different_places_are_two_findings():
    data = vector("subset/two_fields")
    damaged = bytearray(data)
    for kind in (UNIT_FIELD, UNIT_ATTRIBUTE):
        damaged[first_unit(data, kind).stop - 1] ^= 1
    assert codes(validate(damaged)) == ["TXF-S03", "TXF-S03"]
    mixed = flipped(with_values(data, lambda s: s.attributes[1].update(values_crc=0)), UNIT_MATERIALS)
    assert codes(validate(mixed)) == ["TXF-S03", "TXF-S32"]


def test_every_broken_rule_is_found_in_the_decoders_order():
    def spoil(stream):
        stream.materials[0]["material_channels"] ^= 1 << 5
        stream.attributes[0]["values_crc"] ^= 1
        stream.attributes[1]["values_crc"] ^= 1
        stream.geometry[0]["geometry_crc"] ^= 1

    outcome = validate(with_values(vector("subset/two_fields"), spoil))
    # field 0 has lost its geometry, so that its values are not checked; those of field 1 are
    assert codes(outcome) == ["TXF-S14", "TXF-S24", "TXF-S32"]
    assert [unit["unit_type"] for unit in outcome["not_checked"]] == [UNIT_FIELD, UNIT_ATTRIBUTE]
    s24, s32 = outcome["findings"][1:3]
    assert (s24["unit_name"], s24["clause"], s32["unit_name"]) == ("geometry", "5.6.3", "attribute")


def test_a_length_that_lies_is_one_finding():
    data = vector("subset/two_fields")
    for number in range(len(read_units(data)[0])):
        at = read_units(data)[0][number].start + 1
        for change in (1, 64):
            assert codes(validate(data[:at] + bytes([data[at] ^ change]) + data[at + 1 :])) in (["TXF-S02"], ["TXF-S03"])


def test_units_out_of_order_are_named_and_still_read():
    data = vector("subset/two_fields")
    swapped = with_units(data, lambda units: units.insert(1, units.pop(5)))
    outcome = validate(swapped)
    assert codes(outcome)[:1] == refusal(swapped) == ["TXF-S07"] and set(codes(outcome)) == {"TXF-S07"}
    assert not outcome["not_checked"]


@pytest.mark.parametrize("error, expected", [
    ((), 0), (("TXF-L02",), 6), (("TXF-L02", "TXF-U01"), 5), (("TXF-U01", "TXF-L02", "TXF-S04"), 3),
])  # fmt: skip
def test_the_exit_code_is_the_worst_findings(error, expected):
    listing, family = Listing(), {"L": LimitError, "U": SupportError, "S": StreamError}
    for code in error:
        listing.error(family[code[4]](code, "x"))
    listing.oddity(Oddity("TXF-W02", "x"))
    assert listing.exit_code() == expected and listing.exit_code(strict=True) == (expected or 7)


def test_of_many_findings_of_a_code_some_are_kept_and_all_counted():
    listing = Listing()
    for _ in range(3 * MOST_OF_A_CODE):
        listing.oddity(Oddity("TXF-W09", "x", value=list(range(10_000))))
    assert len(listing.findings) == MOST_OF_A_CODE and listing.counts["note"] == 3 * MOST_OF_A_CODE
    assert listing.left_out == {"TXF-W09": 2 * MOST_OF_A_CODE} and len(json.dumps(listing.findings)) < 60_000


# Hard input

HEADER = SIGNATURE + write_unit(UNIT_HEADER, vector("subset/k3")[10 : first_unit(vector("subset/k3"), UNIT_HEADER).end])


@pytest.mark.parametrize("data, code", [
    (b"", "TXF-S01"), (b"\0", "TXF-S01"), (b"glTF" + bytes(99), "TXF-S01"), (bytes(10**6), "TXF-S01"), (SIGNATURE, "TXF-S02"),
    (SIGNATURE + bytes(10**6), "TXF-S03"), (HEADER + bytes(10**6), "TXF-S03"), (HEADER, "TXF-S02"),
    (HEADER + b"\2" + b"\xff" * 7 + b"\x7f", "TXF-S02"), (HEADER + b"\2" + b"\xff" * 50, "TXF-S05"),
    (HEADER + write_unit(UNIT_FIELD, b"") * 3000, "TXF-L14"), (HEADER + write_unit(200, b"") * 3000, "TXF-L14"),
    (HEADER + write_unit(UNIT_METADATA, b"\0" + b"[" * 10**5) + write_unit(UNIT_END, b""), "TXF-S11"),
])  # fmt: skip
def test_hard_input_gives_findings_in_little_memory(data, code, monkeypatch):
    monkeypatch.setattr(framing, "MOST_UNITS", 2000)
    tracemalloc.start()
    outcome = validate(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert code == codes(outcome)[0] and outcome["exit_code"] in (3, 6) and peak < 2 * len(data) + 8e6


def test_a_stream_of_too_many_units_is_not_called_valid(monkeypatch):
    monkeypatch.setattr(framing, "MOST_UNITS", 3)
    outcome = validate(vector("subset/two_fields"))
    assert codes(outcome) == ["TXF-L14"] and outcome["exit_code"] == 6


# Warnings and notes


def _named(*names):
    def edit(stream):
        stream.header["num_materials"] = len(names)
        stream.materials = [dict(stream.materials[0], material_name=name, name_length=len(name.encode())) for name in names]

    return with_values(vector("subset/k3"), edit)


def _metadata(raw):
    return with_units(vector("subset/k3"), lambda units: units.insert(-1, (UNIT_METADATA, b"\0" + raw)))


def _longer_draco(count):
    return with_values(vector("subset/k3"), lambda s: s.geometry[0].update(draco_data=bytes(s.geometry[0]["draco_data"]) +
                                                                           bytes(count)))


def _wrong_levels():
    def edit(stream):
        for word in stream.attributes[0]["codewords"]:
            word["level_bytes"] = [count + 1 for count in word["level_bytes"]]

    return with_values(vector("uncommon/level_index"), edit)


def _opaque():
    stream = parsed(vector("subset/alpha_blend"))
    for material in stream.materials:
        material["alpha_mode"] = 0
    return written(stream)


def _masked(cutoff):
    return with_values(vector("subset/alpha_mask"), lambda s: [m.update(alpha_cutoff=cutoff) for m in s.materials
                                                               if m["alpha_mode"] == 1])


def _same_material():
    return with_values(vector("subset/materials"), lambda s: s.geometry[1].update(material_index=s.geometry[0]["material_index"]))


ODD = {
    "TXF-W01": lambda: vector("uncommon/strange_units"), "TXF-W02": lambda: _metadata(b"[1]"),
    "TXF-W03": lambda: _longer_draco(3), "TXF-W05": lambda: vector("uncommon/random_codeword"), "TXF-W06": _wrong_levels,
    "TXF-W07": lambda: _named("stone\x1b[31m"), "TXF-W08": lambda: _named("../stone"), "TXF-W09": lambda: _named("a", "b", "a"),
    "TXF-W10": lambda: _named("a", "b"), "TXF-W11": lambda: vector("uncommon/maps_unlit"), "TXF-W12": _opaque,
    "TXF-W13": lambda: _masked(0), "TXF-W14": _same_material, "TXF-W16": lambda: vector("uncommon/maps_some"),
    "TXF-W18": lambda: with_values(vector("subset/k3"), lambda s: s.header.update(side=0.0)),
    "TXF-W19": lambda: vector("uncommon/one_voxel"), "TXF-W21": lambda: vector("uncommon/maps_shift_voxels"),
    "TXF-W22": lambda: vector("uncommon/empty"),
}
ROW_OF = np.array([[0, 0, 0], [4, 4, 4], [8, 8, 8], [8, 0, 0]])
# What no vector shows and no stream is at hand for: made of the arrays and values that a stream would give.
ODD_PARTS = {
    "TXF-W15": lambda: mesh_check.of_faces(GeometryUnit(0, 0, ROW_OF, np.array([[0, 1, 2], [0, 2, 3]]))),
    "TXF-W17": lambda: mesh_check.of_mesh([GeometryUnit(0, 0, ROW_OF, np.array([[0, 2, 3]]))], 14),
    "TXF-W20": lambda: oddities.of_field({"support": 1, "width": 64, "height": 64}, 200, 14),
    "TXF-W23": lambda: oddities.of_field({"support": 0, "resolution": 257}, 900, 8),
}


@pytest.mark.parametrize("code", ODD)
def test_an_odd_stream_is_valid_and_told(code):
    data = ODD[code]()
    outcome = validate(data)
    assert outcome["exit_code"] == 0 and refusal(data, Limits()) == [] and outcome["facts"]["bytes"]["total"] == len(data)
    rows = [row for row in outcome["findings"] if row["code"] == code]
    assert rows and all(row.keys() == ROW and row["severity"] == BY_CODE[code].severity and row["remedy"] for row in rows)
    assert BY_CODE[code].covers(rows[0]["clause"])


@pytest.mark.parametrize("code", ODD_PARTS)
def test_an_odd_part_is_told(code):
    (oddity,) = ODD_PARTS[code]()
    assert oddity.code == code and BY_CODE[code].covers(oddity.clause)


def test_a_plug_ins_codec_is_told(install):
    install({"toy": "toy:Toy"}, toy=TOY)
    outcome = validate(toy_stream())
    assert outcome["exit_code"] == 0 and "TXF-W04" in codes(outcome, "warning") and outcome["strict_exit_code"] == 7


def test_every_warning_and_note_has_its_test():
    told = {row.code for row in FINDINGS if row.severity != ERROR}
    assert told == {*ODD, *ODD_PARTS, "TXF-W04"} and len(told) > 20


@pytest.mark.parametrize("count", [1, 5, 300])
def test_the_end_of_draco_data_is_found_to_the_byte(count):
    (row,) = [row for row in validate(_longer_draco(count))["findings"] if row["code"] == "TXF-W03"]
    end = first_unit(vector("subset/k3"), UNIT_GEOMETRY).end
    assert row["value"] == count and row["unit_name"] == "geometry"
    assert row["offset"] - end in (0, 1)  # a longer unit_length may take one byte more


def test_codewords_are_read_to_their_ends_and_levels_are_counted_right():
    """What the decoder says of its reading, on streams of the encoder: nothing left over, and the level index as it stands."""
    for name in ("slices", "one_slice", "level_index", "all_tools_slices", "lossless_slices"):
        assert codes(validate(vector(f"uncommon/{name}")), "warning") == [], name


# The tool


def test_tool_prints_a_line_for_each_finding_and_a_sum(call, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(with_values(_named("a\x1b[31m", "b"), lambda s: s.attributes[0].update(values_crc=1)))
    code, out, err = call("texf-validate", path)
    lines = out.splitlines()
    assert code == 3 and err == "" and "\x1b" not in out and len(lines) == 4
    assert lines[0].startswith("error TXF-S32 at byte ")
    assert ", unit 4 (attribute), clause 7.10: the checksum of the decoded values" in lines[0]
    assert lines[1].startswith("warning TXF-W07 ") and lines[2].startswith("note TXF-W10 ")
    assert lines[3] == "invalid: 1 error, 1 warning, 1 note"
    assert call("texf-validate", path, "--quiet") == (3, "", "")


def test_tool_says_what_it_could_not_check(call, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(flipped(vector("subset/two_fields"), UNIT_GEOMETRY))
    lines = call("texf-validate", path)[1].splitlines()
    assert lines[-2] == "not checked because of the errors above: units 2 to 3 (field), units 6 to 7 (attribute)"


def test_tool_gives_json_with_the_facts(call, tmp_path):
    path = tmp_path / "a.texf"
    path.write_bytes(vector("uncommon/strange_units"))
    code, out, err = call("texf-validate", path, "--json", "--strict")
    told = json.loads(out)
    assert (code, err, told["exit_code"], told["schema"]) == (7, "", 7, 1)
    assert told["counts"] == {"error": 0, "warning": 3, "note": 0} and "units" not in told["facts"]
    assert told["facts"]["faces"] == inspect(vector("uncommon/strange_units"))["faces"]
    path.write_bytes(vector("faulty/channel_without_group"))
    told = json.loads(call("texf-validate", path, "--json")[1])
    assert told["facts"] is None and codes(told) == ["TXF-S14"]


@pytest.mark.parametrize("name, flags, expected", [
    ("subset/k3", (), 0), ("subset/k3", ("--strict",), 0), ("uncommon/strange_units", (), 0), ("faulty/version", (), 5),
    ("uncommon/strange_units", ("--strict",), 7), ("faulty/crc_field", ("--strict",), 3),
    *(("subset/k3", ("--limit", f"{name}=3"), 6) for name in ("faces", "voxels", "samples", "file-bytes")),
    ("none", (), 2), ("subset/k3", ("--what",), 1),
])  # fmt: skip
def test_tool_ends_with_the_code_of_the_worst(call, name, flags, expected):
    assert call("texf-validate", VECTORS / name / "in.texf", *flags)[0] == expected


# In a child process


def test_isolated_validation_finds_the_same():
    for name in ("uncommon/strange_units", "faulty/values_crc"):
        assert sandboxed.validate_isolated(vector(name)) == validate(vector(name))


@pytest.mark.parametrize("limits, expected", [(Limits(isolate_bytes=1 << 20), "TXF-L07"),
                                              (Limits(isolate_seconds=1e-3), "TXF-L08")])
def test_a_child_that_may_not_go_on_is_a_finding_beside_those_of_the_syntax(limits, expected):
    outcome = sandboxed.validate_isolated(vector("uncommon/strange_units"), limits)
    assert codes(outcome) == [expected] and outcome["exit_code"] == 6 and outcome["counts"]["warning"] == 3
    assert {unit["unit_type"] for unit in outcome["not_checked"]} == {UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE}


@pytest.mark.parametrize("answer", [None, {}, {"outcome": {}, "warnings": []}, {"outcome": {"findings": 3}, "warnings": []}])
def test_a_child_that_crashes_or_lies_is_an_error(monkeypatch, answer):
    def child(module, data, request, limits, folder):
        if answer is not None:
            (folder / sandboxed.FACTS).write_text(json.dumps(answer))
        return subprocess.CompletedProcess([], -11, b"", b"")

    monkeypatch.setattr(sandboxed, "run_child", child)
    outcome = sandboxed.validate_isolated(vector("subset/k3"))
    assert codes(outcome) == ["TXF-S40"] and outcome["exit_code"] == 3
