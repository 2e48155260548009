"""The conformance runner, shown to fail decoders that are wrong on purpose and to pass a right one; and what vectors promise."""

import json
import re
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from conformance import run as runner
from conformance.make import __main__ as make
from conformance.make.claims import case_at, unkept
from conformance.make.good import subset, units_of
from conformance.make.vector import title_of
from conformance.reference import bits, decoder, materials, queries, syntax
from conformance.reference.bits import Invalid, Reader, Unsupported, require

REPOSITORY = Path(__file__).resolve().parents[2]
VECTORS = REPOSITORY / "conformance"
GOOD = [f"{path.parents[1].name}/{path.parent.name}" for kind in ("subset", "uncommon")
        for path in sorted((VECTORS / kind).glob("*/case.json"))]
RUNNER = REPOSITORY / "conformance" / "run.py"
REFERENCE_COMMAND = f'"{sys.executable}" "{REPOSITORY / "conformance" / "reference" / "decoder.py"}"'
# Quick ones: levels of detail, two fields, alpha, slices, no level at all, no geometry, and a refusal of each kind
SMALL = [
    "subset/k3/", "subset/two_fields/", "subset/alpha_mask/", "uncommon/one_voxel/", "uncommon/empty/", "uncommon/one_slice/",
    "uncommon/empty_codeword/", "faulty/cut_geometry/", "faulty/codec_id/", "faulty/unit_vertices_huge/",
    "subset/neural_hash/", "faulty/neural_code/", "uncommon/filter_slices/", "faulty/filter_left_out/",
    "subset/constant/", "uncommon/constant_second_field/", "faulty/constant_value/", "faulty/private_codec/",
    "subset/texels_alpha/", "uncommon/texels_mixed/", "uncommon/texels_flat/", "uncommon/texels_rounded/",
    "faulty/texels_uv_16/", "faulty/neural_texels/", "faulty/texels_num_keys_huge/",
    "uncommon/planar_mixed/", "uncommon/planar_alpha/", "uncommon/planar_filter/", "faulty/component_cross_17/",
    "faulty/planar_transform_off/", "faulty/geometry_moved/", "faulty/version_broken/",
]

# And those with queries, filters or planar supports
REFERENCE = sorted({*(case.rstrip("/") for case in SMALL), *(name for name in GOOD if "/filter_" in name or "/planar_" in name),
                    *(path.parent.relative_to(VECTORS).as_posix() for path in VECTORS.glob("*/*/queries.json"))})

# The reference decoder with one thing wrong; `files` is what it would write.
WRONG = """
import sys
from pathlib import Path
sys.path.insert(0, {repository!r})
from conformance.reference import decoder
from conformance.reference.bits import Invalid, Unsupported
stream, folder, more = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]), sys.argv[3:]
lod = int(more[more.index("--lod") + 1]) if "--lod" in more else 0
{before}
try:
    files = decoder.arrays(decoder.decode(stream, lod))
except (Invalid, Unsupported) as error:
    {refuse}
{after}
for name, content in files.items():
    (folder / (name + ".bin")).write_bytes(content)
"""
REFUSE = "print(error, file=sys.stderr); sys.exit(3 if isinstance(error, Invalid) else 5)"
LAST = """
for name in [name for name in files if name.endswith("values")][-1:]:
    files[name] = files[name][:-1] + bytes([files[name][-1] ^ 1])
"""
# Makes good what a stream lacks of its end unit, as a decoder does that stops where the data stop.
COMPLETED = """
end = bytes([5, 0]) + __import__("zlib").crc32(bytes([5, 0])).to_bytes(4, "little")
stream = stream + end if stream[-5:] != end[:-1] else stream + end[-1:]
"""
# A filter that sees no further than its own slice (7.7 says: in every slice).
SLICE_BY_SLICE = """
from conformance.reference import attributes
children, stage, ranges = attributes.children_of_range, attributes.filter_stage, []
def remembered(*arguments):
    ranges.append(children(*arguments))
    return ranges[-1]
def by_slice(means, *rest):
    voxels, out = list(means), {}
    last = max(i for i, (first, _) in enumerate(ranges) if first == 0)
    for first, end in ranges[last:]:
        out |= stage({v: means[v] for v in voxels[first:end]}, *rest)
    return out
attributes.children_of_range, attributes.filter_stage = remembered, by_slice
"""
FILTER = "from conformance.reference import attributes, filter as wiener; "
LAST_FIRST = FILTER + "whole = attributes.filtered_means; " + (
    "attributes.filtered_means = lambda unit, level: whole({**unit, 'filters': unit['filters'][::-1]}, level)")
TWO_STAGES = FILTER + "whole = attributes.filtered_means; " + (
    "attributes.filtered_means = lambda unit, level: whole({**unit, 'filters': unit['filters'][:2]}, level)")
# A constant plane that stays as long as the field is, whatever the level of detail.
FULL_LENGTH = """
checked = decoder.checked_values
decoder.checked_values = lambda unit, keys, lod, of: checked(unit, keys, 0 if unit["codec_id"] == decoder.CONSTANT else lod, of)
"""
NO_CHECKSUM = "decoder.checked_values = lambda unit, keys, *_: unit['plane_value'] * len(keys) if unit['codec_id'] == 2 else b''"
ANY_NAME = "from conformance.reference.bits import Reader; Reader.utf8 = lambda self, count, name: str(self.take(count, name))"
TEXELS = "from conformance.reference import texels; "
# Squares with their borders, which ask texels of no weight.
CLOSED_SQUARES = TEXELS + "import inspect; " + (
    "exec(inspect.getsource(texels.meet).replace('<=', '<').replace('>=', '>'), vars(texels))")
MIRROR_AT_CENTRES = TEXELS + "fold = lambda i, n: min(i % (2 * n - 2), -i % (2 * n - 2)); whole = texels.wrap; " + (
    "texels.wrap = lambda mode, i, n: fold(i, n) if mode == 2 else whole(mode, i, n)")
NO_LINES = TEXELS + "area = lambda a, b, c: (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]); " + (
    "places = texels.places; texels.places = lambda triangle, one: places(triangle, one) if area(*triangle) else []")
ROUNDED_DOWN = "import math; decoder.whole_number = lambda v, bits, most: math.floor(v)"
NO_ORIGIN = "whole = decoder.decode_uv; " + (
    "decoder.decode_uv = lambda unit, numbers: whole({**unit, 'uv_origin': [-7 * 16, 0]}, numbers)")
PLANAR = "from conformance.reference import attributes, following, mixing, planar, filter as wiener; "
NOT_ROTATED = PLANAR + "attributes.LevelDecoder.is_rotated = lambda *_: False"
NOT_FOLLOWED = PLANAR + "attributes.followed = lambda *_: None"
CONTEXTS_OF_VOXELS = PLANAR + "mixing.alike = lambda *_: None"
WITHOUT_CORNERS = PLANAR + "planar.CORNERS = ()"
UNLIMITED_RINGS = PLANAR + "rings = wiener.planar_rings; wiener.planar_rings = lambda m, v, c, _: rings(m, v, c, 1 << 30)"
UNLIMITED_FACTORS = PLANAR + (
    "cut = following.clip; following.clip = lambda low, high, v: v if high == 512 else cut(low, high, v)")
MIRRORED = """
import struct
for unit in (texf := decoder.decode(stream, lod))["units"]:
    unit["faces"] = [[a, c, b] for a, b, c in unit["faces"]]
files = decoder.arrays(texf)
"""


class ReferenceDecoder:
    """The reference decoder in this process, as the runner calls it."""

    asks = True

    def __call__(self, stream, lod, asked=b""):
        try:
            texf = decoder.decode(stream.read_bytes(), lod)
        except (Invalid, Unsupported) as error:
            return 3 if isinstance(error, Invalid) else 5, {}, str(error)
        files = decoder.arrays(texf) | (queries.answer_files(texf, queries.read_queries(asked)) if asked else {})
        return 0, {f"{name}.bin": content for name, content in files.items()}, ""


def run(command, *cases):
    """(exit code, lines) of the runner with a decoder command, or our own where it is None."""
    call = [sys.executable, str(RUNNER), *(["--decoder", command] if command else []), *cases]
    result = subprocess.run(call, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    return result.returncode, result.stdout.splitlines()


def wrong_decoder(folder, before="", refuse=REFUSE, after=""):
    """Command of the reference decoder with other statements before, on refusal or after."""
    program = folder / "wrong.py"
    program.write_text(WRONG.format(repository=str(REPOSITORY), before=before, refuse=refuse, after=after), encoding="utf-8")
    return f'"{sys.executable}" "{program}"'


def test_our_decoder_passes_every_vector():
    code, lines = run(None)
    assert code == 0, "\n".join(line for line in lines if line.startswith("FAIL"))
    assert int(lines[-1].split()[0]) == len(lines) - 1 >= 32


@pytest.mark.parametrize("name", REFERENCE)
def test_reference_decoder_passes(name):
    assert runner.faults_of(ReferenceDecoder(), VECTORS / name) == []


@pytest.mark.slow
def test_wrong_decoder_without_its_fault_is_right(tmp_path):
    code, lines = run(wrong_decoder(tmp_path), *SMALL)
    assert code == 0, "\n".join(lines)


@pytest.mark.parametrize(
    "case, complaint, fault",
    [
        ("subset/k3/", "field0_group0_values.bin differs", {"after": LAST}),
        ("subset/two_fields/", "field1_group0_values.bin differs", {"after": LAST}),
        ("subset/alpha_blend/", "field0_group1_values.bin differs", {"after": LAST}),
        ("subset/two_fields/", "field1_keys.bin differs", {"after": "files['field1_keys'] = files['field0_keys']"}),
        ("subset/two_fields/", "field1_keys.bin is missing", {"after": "files = {n: files[n] for n in files if '1_' not in n}"}),
        ("subset/k3/", "field1_keys.bin is unexpected", {"after": "files['field1_keys'] = b''"}),
        ("subset/k3/", "lod 1: field0_keys.bin differs", {"before": "lod = 0"}),
        ("subset/k3/", "geometry.bin differs", {"after": MIRRORED}),
        ("subset/k3/", "geometry.bin differs", {"after": "files['geometry'] = files['geometry'][:-88]"}),
        ("uncommon/empty/", "geometry.bin is missing", {"after": "files = {}"}),
        ("faulty/cut_geometry/", "exit code 0, expected 3", {"refuse": "files = {}"}),
        ("faulty/cut_end/", "exit code 0, expected 3", {"before": COMPLETED}),
        ("faulty/cut_last_byte/", "exit code 0, expected 3", {"before": COMPLETED}),
        ("faulty/cut_geometry/", "exit code 1, expected 3", {"refuse": "sys.exit(1)"}),
        ("faulty/codec_id/", "exit code 3, expected 5", {"refuse": "sys.exit(3)"}),
        ("faulty/unit_vertices_huge/", "exit code 0, expected 6 or 3", {"refuse": "files = {}"}),
        ("subset/k3/", "exit code 3", {"before": "sys.exit(3)"}),
        # filters: values_crc finds them first
        ("uncommon/filter_slices/", "lod 0: exit code 3", {"before": SLICE_BY_SLICE}),
        ("uncommon/filter_classes/", "lod 0: exit code 3", {"before": FILTER + "wiener.ROUGHNESS_ENTRIES = (4, 8, 16, 33)"}),
        ("uncommon/filter_alpha/", "lod 0: exit code 3", {"before": FILTER + "wiener.ROUGHNESS_ENTRIES = (5, 8, 16, 32)"}),
        ("uncommon/filter_largest/", "lod 0: exit code 3", {"before": FILTER + "wiener.clip = lambda low, high, v: v"}),
        ("uncommon/filter_three_stages/", "lod 0: exit code 3", {"before": LAST_FIRST}),
        ("uncommon/filter_three_stages/", "lod 0: exit code 3", {"before": TWO_STAGES}),
        ("subset/constant/", "lod 1: field0_group0_values.bin differs", {"before": FULL_LENGTH}),
        ("uncommon/constant_resolutions/", "lod 4: field0_group0_values.bin differs", {"before": FULL_LENGTH}),
        ("faulty/constant_value/", "exit code 0, expected 3", {"before": NO_CHECKSUM}),
        ("faulty/codec_name_not_utf8/", "exit code 5, expected 3", {"before": ANY_NAME}),
        # texels: keys_crc finds most of them first
        ("uncommon/texels_centres/", "lod 0: exit code 3", {"before": CLOSED_SQUARES}),
        ("uncommon/texels_flat/", "lod 0: exit code 3", {"before": NO_LINES}),
        ("uncommon/texels_mirror/", "lod 0: exit code 3", {"before": MIRROR_AT_CENTRES}),
        ("uncommon/texels_rounded/", "lod 0: exit code 3", {"before": ROUNDED_DOWN}),
        ("uncommon/texels_low/", "lod 0: exit code 3", {"before": NO_ORIGIN}),
        ("subset/texels_alpha/", "field0_uv.bin is missing", {"after": "del files['field0_uv']"}),
        ("uncommon/texels_mixed/", "field1_uv.bin is unexpected", {"after": "files['field1_uv'] = b''"}),
        # planar supports: values_crc finds them first
        ("uncommon/planar_direct/", "lod 0: exit code 3", {"before": NOT_ROTATED}),
        ("uncommon/planar_cross_1/", "lod 0: exit code 3", {"before": NOT_FOLLOWED}),
        ("uncommon/planar_plain/", "lod 0: exit code 3", {"before": CONTEXTS_OF_VOXELS}),
        ("uncommon/planar_mixed/", "lod 0: exit code 3", {"before": WITHOUT_CORNERS}),
        ("uncommon/planar_filter/", "lod 0: exit code 3", {"before": UNLIMITED_RINGS}),
        ("uncommon/planar_random/", "lod 0: exit code 3", {"before": UNLIMITED_FACTORS}),
    ],
)
def test_runner_fails_a_decoder_that_is_wrong(tmp_path, case, complaint, fault):
    code, (line, last) = run(wrong_decoder(tmp_path, **fault), case)
    assert line.startswith(f"FAIL {case[:-1]}: ") and complaint in line
    assert (code, last) == (7, "0 passed, 1 failed")


def test_command_that_answers_no_points_is_not_asked():
    code, (line, last) = run(REFERENCE_COMMAND, "subset/k3/")
    assert code == 0 and line.endswith("queries not asked") and last == "1 passed, 0 failed"


def test_reference_decoder_answers_points_as_a_command():
    code, (*lines, last) = run(REFERENCE_COMMAND, "--queries", "subset/k3/", "uncommon/texels_one/", "uncommon/maps_neural/")
    assert code == 0 and not any("not asked" in line for line in lines) and last == "3 passed, 0 failed"


def test_runner_fails_a_command_that_promised_answers_and_gives_none(tmp_path):
    code, (line, _) = run(wrong_decoder(tmp_path), "--queries", "uncommon/texels_one/")
    assert code == 7 and "group0_answers.bin has 0 bytes" in line


def test_runner_fails_a_decoder_that_hangs(tmp_path):
    command = wrong_decoder(tmp_path, before="import time; time.sleep(60)")
    code, lines = run(command, "--seconds", "0.5", "faulty/magic/")
    assert code == 7 and "no answer in 0.5 seconds" in lines[0]


def test_runner_refuses_to_run_nothing():
    call = [sys.executable, str(RUNNER), "no/such/case"]
    assert subprocess.run(call, cwd=REPOSITORY, capture_output=True, check=False).returncode == 2


# What the vectors say of themselves.


def test_vectors_stand_as_their_readme_says():
    standing = make.standing()
    assert make.differences(make.files_of(standing, [])) == []
    first, last = standing[0], standing[-1]
    changed = [first, last]
    make.put_in(changed, [replace(first, title="new"), replace(first, name="subset/more")])
    assert [v.name for v in changed] == [first.name, "subset/more", last.name] and changed[0].title == "new"
    assert all(v.title == title_of(v.claims) for v in standing if not v.expect)


@pytest.mark.parametrize("name", GOOD)
def test_vector_holds_what_it_claims(name):
    assert unkept(case_at(VECTORS / name)) == []


@pytest.mark.parametrize("name, claim", [
    ("uncommon/all_tools", ("{} filter stages", 3)), ("uncommon/all_tools_slices", "a filter"),
    ("uncommon/filter_classes", "slices"), ("uncommon/filter_lonely_voxels", "a filter stage of every class and component"),
    ("uncommon/filter_three_stages_slices", "a filter of alpha alone"), ("uncommon/filter_one_voxel", ("{} filter stages", 3)),
    ("uncommon/filter_slices", "lossless after three filter stages"),
    ("uncommon/random_codeword", "probabilities at their lower bound"),
    ("uncommon/needle_bits20_k8192", "a triangle whose corners have one grid coordinate"),
    ("uncommon/neural_waves", ("first_wave {}", 16384)), ("subset/constant_alpha", ("{} constant", "colour")),
    ("uncommon/constant_second_field", "all constant"), ("uncommon/constant_colour", "values of 0 and 255"),
    ("uncommon/texels_mirror", ("wrap {}", "clamp")), ("uncommon/texels_mirror", ("an image of {} x {}", 22, 10)),
    ("uncommon/texels_repeat_mirror", ("wrap {} x {}", "mirror", "repeat")),
    ("subset/texels_repeat", "texels that no face asks"), ("subset/texels_repeat", "UVs beside the image"),
    ("uncommon/texels_borders", "seams"), ("uncommon/texels_centres", ("all UVs on {} of texels", "borders")),
    ("uncommon/texels_whole", ("UVs quantised to {} bits", 9)), ("uncommon/texels_mixed", "two fields"),
    ("subset/k3", "a field over texels"), ("uncommon/planar_plain", "rotated splits"),
    ("uncommon/planar_mixed", "no rotated splits"), ("uncommon/planar_plain", "components that follow"),
    ("uncommon/planar_cross_1", "no components that follow"), ("uncommon/planar_cross_1", ("component_cross {}", 2)),
    ("uncommon/planar_mixed", "factors at their bounds"), ("uncommon/filter_classes", "two filter stages of five taps"),
    ("uncommon/all_tools", "a planar support"), ("subset/k3", ("{} constant beside RAHT {}", "alpha", "colour"))])
def test_claim_that_a_vector_does_not_keep_is_caught(name, claim):
    assert unkept(replace(case_at(VECTORS / name), claims=[claim])) == [f"'{title_of([claim])}' is not there"]


def test_the_encoder_makes_the_everyday_vectors_again_whatever_the_machine():
    """Byte for byte, from their sources. Where an encoder is to write other bytes, its rows of conformance/make get new names,
    and the old vectors stay as they are promised."""
    rows = subset()
    assert len(rows) > 10
    assert [name for name, _, _, data, _ in rows if (VECTORS / "subset" / name / "in.texf").read_bytes() != data] == []


def test_claim_that_nothing_checks_is_caught():
    assert unkept(replace(case_at(VECTORS / "subset/k3"), claims=["a new thing"])) == ["nothing checks 'a new thing'"]


@pytest.mark.parametrize("clauses", [["7.7"], ["11.6"], ["5.7.6"], ["7.11", "7.11.1", "7.11.2", "7.11.3"]])
def test_clause_that_a_vector_does_not_hit_is_caught(clauses):
    case = replace(case_at(VECTORS / "uncommon/all_tools_slices"), clauses=["7.2", "7.5.5", *clauses])
    assert unkept(case) == [f"nothing of clause {c} is there" for c in clauses]


def test_vectors_of_planar_supports_are_over_texels():
    """Good and faulty ones: a sheet of voxels could stand in for them without a word, since it has z = 0 as well."""
    streams = [path for path in VECTORS.glob("*/*/in.texf") if path.parent.name.split("_")[0] in ("planar", "dct", "component")]
    assert len(streams) == 26
    for path in streams:
        kinds = [payload[1] for kind, payload in units_of(path.read_bytes()) if kind == syntax.FIELD]
        assert kinds == [syntax.TEXELS], path


@pytest.mark.parametrize("name", ["filter_four_stages", "filter_mask_bit_15", "residual_cross_17", "planar_transform_2",
                                  "component_cross_17"])
def test_faulty_vector_has_no_fault_but_the_range(monkeypatch, name):
    """Without checks of ranges it decodes, and its values_crc is right: no other error stands in for the one it is there for."""
    data = (VECTORS / "faulty" / name / "in.texf").read_bytes()
    with pytest.raises((Invalid, Unsupported)):
        decoder.decode(data)
    monkeypatch.setattr(Reader, "number", lambda self, size, name, low, high, signed=False:
                        int.from_bytes(self.take(size, name), "little", signed=signed))
    monkeypatch.setattr(syntax, "require", lambda condition, sentence: None)
    monkeypatch.setattr(syntax, "known", lambda name, value, high: value)
    assert decoder.decode(data)["fields"]


@pytest.mark.parametrize("name, sentence", [
    ("draco_position", "a position is not below"), ("texels_uv_large", "a UV is out of range"),
    ("texels_uv_origin", "uv_origin is"), ("texels_uv_origin_low", "uv_origin is"), ("level_shift_over", "level_shift is"),
    ("level_shift_with_alpha", "level_shift is"), ("map_unit_more", "the attribute units are not those"),
    ("texels_uv_vertices", "another number of vertices"),
    ("group_of_idle", "nobody names the channels"), ("marks_missing_idle", "a sharp edges unit"),
    ("coded_missing_idle", "a coded normals unit"), ("parameter_default_binary32", "its default"), ("side_1e301", "side is"),
    ("origin_1e301", "origin is"),
])
def test_faulty_vector_has_no_fault_but_its_title(monkeypatch, name, sentence):
    """Without the check that has this sentence it decodes, with it not."""
    data = (VECTORS / "faulty" / name / "in.texf").read_bytes()
    with pytest.raises(Invalid, match=re.escape(sentence)):
        decoder.decode(data)
    for module in (bits, syntax, materials, decoder):
        monkeypatch.setattr(module, "require", lambda condition, said: require(condition or sentence in said, said))
    assert decoder.decode(data)["fields"]


def test_runner_names_the_first_level_that_is_wrong():
    case = json.loads((VECTORS / "subset/k3/case.json").read_text(encoding="utf-8"))
    checks = [int(digits, 16) for digits in case["levels"]["field0_group0"]]

    class Refusing:
        """A decoder that refuses every stream and writes these checksums of levels."""

        asks = False

        def __init__(self, *numbers):
            self.files = {"field0_group0_levels.bin": struct.pack(f"<{len(numbers)}I", *numbers)}

        def __call__(self, *_):
            return 3, dict(self.files), "values_crc"

    faults = lambda *numbers: runner.faults_of(Refusing(*numbers), VECTORS / "subset/k3")
    assert faults(*checks) == faults(checks[0]) == faults() != []
    assert faults(checks[0], 1, 2)[0] == "lod 0: field0_group0_levels.bin: level 1 is the first that differs"
    assert f"level {len(checks)} is the first" in faults(*checks, 0)[0]
