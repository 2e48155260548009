"""tools/proof/mutants.py: what is changed, and that a vector's killing is seen."""

import json
import os
import re
from itertools import product

import pytest

from tools.proof import mutants
from tools.proof.mutants import Case, Mutant, cases_of, is_of, killer_of, mutants_of, page_of, traced, wanted_mutants

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants run in forked processes")


@pytest.fixture(scope="module")
def empty():
    """The quickest vector, traced."""
    return traced(next(case for case in cases_of() if case.name == "uncommon/empty"))


def test_every_change_of_a_module_is_numbered_and_another_text():
    for module in mutants.MODULES:
        found = mutants_of(module)
        assert len({m.number for m in found}) == len(found) > 40 and all(m.before != m.after for m in found)
    assert {path.stem for path in mutants.NAIVE.glob("*.py")} == set(mutants.MODULES)


def test_a_vector_tells_what_it_calls_and_kills_what_it_sees(empty):
    assert isinstance(empty.said, dict) and ("bits", "units_of") in empty.functions
    killed = [m for m in mutants_of("bits") if m.function == "units_of" and killer_of(m, [empty] * empty.runs(m))]
    survivors = [m for m in mutants_of("bits") if m.function == "units_of" and m not in killed]
    assert any(m.before == "data[:8] == MAGIC" for m in killed)
    # one sound stream cannot hold a rule that refuses others
    assert any(m.before.startswith('require(reader.ended()') for m in survivors)
    assert not [m for m in mutants_of("planar") if empty.runs(m) and m.function != mutants.TOP]


def test_a_function_that_makes_a_table_is_asked_of_all_that_read_it():
    (mutant, *_) = [m for m in mutants_of("mixing") if m.function == "stretch_table"]
    reads, other = (Case("a", b"", 0, functions=frozenset(called)) for called in ({("mixing", "squash")}, {("bits", "units_of")}))
    assert reads.runs(mutant) and not other.runs(mutant)
    assert not reads.runs(next(m for m in mutants_of("mixing") if m.function == "adapted"))


def test_a_mutant_that_hangs_or_cannot_be_imported_is_killed(empty, monkeypatch):
    monkeypatch.setattr(mutants, "changed_code", lambda mutant: compile("while True: pass", "bits changed", "exec"))
    assert killer_of(mutants_of("bits")[0], [Case("a", empty.data, 0, empty.said, 0.01)]) == "a"
    monkeypatch.setattr(mutants, "changed_code", lambda mutant: compile("1 / 0", "bits changed", "exec"))
    assert killer_of(mutants_of("bits")[0], [empty]) == "uncommon/empty"


def test_the_page_counts_and_names_survivors_and_clauses():
    first, second, third, *_ = [m for m in mutants_of("filter") if m.function == "filter_stage"]
    text = page_of({first: "subset/a", second: None, third: None}, {third.name: "it means the same"})
    assert "3 mutants, 2 killed or equivalent (66.7%), 1 survivors." in text
    place = f"conformance/reference/filter.py:{second.line}"
    assert f"| {place} | filter_stage | 7.7 | `{second.before}` -> `{second.after}` |" in text
    assert "it means the same" in text and "| 7.7 | 1 | subset/a 1 |" in text
    assert "A sample of two." in page_of({first: "subset/a", second: None}, {}, "A sample of two.")


def test_what_is_called_equivalent_is_one_mutant_each():
    names = [m.name for module in mutants.MODULES for m in mutants_of(module)]
    told = json.loads(mutants.EQUIVALENTS.read_text(encoding="utf-8"))
    assert told and all(names.count(name) == 1 and reason.endswith(".") for name, reason in told.items())


def test_tolerances_are_no_rules():
    of_queries = [m for m in mutants_of("queries") if m.function == mutants.TOP]
    assert of_queries and all(m.before in ("10 ** 6", "10", "6") for m in of_queries)


def test_a_part_is_a_function_or_a_clause_with_what_is_below():
    (split, *_), (waves, *_) = ([m for m in mutants_of(module) if m.function == function]
                                for module, function in (("attributes", "RangeDecoder.split"), ("neural", "waves")))
    assert all(is_of(split, part) for part in ("split", "RangeDecoder.split", "attributes.RangeDecoder.split", "7.6.2", "7"))
    assert not any(is_of(split, part) for part in ("7.5", "7.6.3", "bit", "1")) and is_of(waves, "11") and not is_of(waves, "1")


def test_a_sample_is_the_same_for_the_same_seed():
    drawn = lambda *call: wanted_mutants(mutants._arguments(["--module", "mixing", "--sample", "9", *call]))
    (first, told), (again, _), (other, _) = drawn(), drawn("--seed", "0"), drawn("--seed", "1")
    assert first == again != other and len(set(first)) == 9 and told.startswith("Samples: 9 of ")
    assert set(drawn("--seed", "0", "--seed", "1")[0]) == {*first, *other}


# Rules that once no vector held, by the vector that was made for them, as (module, text, what stands there instead).
FOLDS = "4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4"
ENDS = "65523, 65528, 65531, 65533, 65534, 65535"  # of SQUASH_TABLE
HELD = [
    ("uncommon/rules_quiet", "mixing", "largest_rate=5", "largest_rate=4"),
    ("uncommon/rules_quiet", "mixing", "largest_rate=5", "largest_rate=6"),
    ("uncommon/rules_leads", "residual", "min(abs(lead), 15)", "min(abs(lead), 14)"),
    ("uncommon/rules_leads", "residual", "min(abs(lead), 15)", "min(abs(lead), 16)"),
    ("uncommon/rules_half", "voxels", "((((e - s) * left) // (2 * rows)) << 16) // (2 * count)",
     "(((e - s) * left) << 16) // (4 * rows * count)"),
    ("uncommon/rules_slopes", "attributes", "self.weighted(c, octants) // self.weights[i]",
     "(2 * self.weighted(c, octants) + self.weights[i]) // (2 * self.weights[i])"),
    ("uncommon/filter_alpha", "filter", "(4, 8, 16, 32)", "(5, 8, 16, 32)"),
    ("uncommon/filter_slices", "filter", "(4, 8, 16, 32)", "(3, 8, 16, 32)"),
    ("uncommon/filter_three_stages", "attributes", 'for stage in unit["filters"]:', 'for stage in unit["filters"][:2]:'),
    *(("uncommon/rules_zeros", "mixing", "    1, 2, 3, 5", f"    {n}, 2, 3, 5") for n in (0, 2)),
    *(("uncommon/rules_ones", "mixing", ENDS, ENDS.replace(str(n), str(n + d))) for n, d in (
        *product((65523, 65528, 65531, 65533), (-1, 1)), (65534, 1), (65535, -1))),
    *(("uncommon/rules_folds", "edges", FOLDS, re.sub(rf"\b{n}\b", str(n + d), FOLDS))
      for n, d in product((4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4), (-1, 1))),
    *(("uncommon/rules_folds", "edges", text, other) for text, other in (
        ("dot(m, m) >> 12)", "dot(m, m) + 4095 >> 12)"), ("else found\n", "else found + 1\n"), ("found < 10", "found < 9"),
        ("return 12", "return 11"), ("return 13", "return 12"), ("* 2016", "* 2015"),
        ("triangles_at[edge]) <= 8", "triangles_at[edge]) <= 7"), ("triangles_at[edge]) <= 8", "triangles_at[edge]) <= 9"),
        ('"normal_rule"] >= 3', '"normal_rule"] >= 2'))),
    *((f"uncommon/normals_coded{name}", "normals", text, other) for name, text, other in (
        ("", "3 * t", "2 * t"), ("", ">> 27", ">> 26"), ("", "8192 - a", "8191 - a"), ("", "abs(z[k])", "z[k]"),
        ("", "(p * p + q * q) >> 14", "(p * p + q * q) // 2**15"), ("_wild", "min(7, ", "min(8, "),
        ("", "if known else 8", "if known else 0"), ("_wild", "k < 12", "k < 11"),
        ("_wild", "v <= 14", "v <= 13"), ("_wild", "2 if i else 1", "1"), ("_leaves", ">= 0:", "> 0:"),
        ("_sharp", "for other in faces[1:]:", "for other in faces[2:]:"), ("_leaves", "<= len(faces) <= 8", "<= len(faces) <= 2"),
        ("_one", "== 6)", ">= 3)"), ("_fine", "(s << 12)", "(s << 11)"))),
    ("uncommon/rules_hair", "voxels", "    shift = 0", "    shift = 1"),
    ("uncommon/rules_hair", "voxels", "(n >> shift)", "(-(-n >> shift))"),
    ("uncommon/rules_hair", "voxels", ">= 2**30", "> 2**30"),
    ("uncommon/rules_quarter", "texels", "abs(s - n) <= 0.25", "abs(s - n) < 0.25"),
    ("uncommon/rules_bound", "attributes", "self.code < bound", "self.code <= bound"),
    ("uncommon/rules_loose", "syntax", "128 if depth > 0", "127 if depth > 0"),
    ("uncommon/rules_checksums", "bits", "0, 2**32 - 1", "1, 2**32 - 1"),
    ("uncommon/rules_checksums", "bits", "0, 2**32 - 1", "0, 2**32 - 2"),
    ("uncommon/rules_long_numbers", "bits", "for i in range(8)", "for i in range(7)"),
    ("uncommon/rules_slice_level", "syntax", '"slice_level", 0, min(12', '"slice_level", 0, min(11'),
    ("uncommon/rules_groups", "syntax", '"num_channel_groups", 1), 23', '"num_channel_groups", 1), 22'),
    ("uncommon/rules_defaults", "materials", "[1.5], [0],", "[1.5], [1],"),
    ("uncommon/rules_defaults", "materials", "[100], [400]", "[100], [399]"),
    ("uncommon/rules_slanted", "texels", "(b[0] - a[0]", "(b[0] - a[1]"),
    ("uncommon/normals_marks_narrow", "edges", "len(set(turned)) == 3", "len(set(turned)) >= 2"),
    *((f"uncommon/dct_{name}", "dct", text, other) for name, text, other in (
        ("random", "-(2**25), 2**25", "-(2**24), 2**24"), ("fine", "return 15 +", "return 16 +"),
        ("blocks", "(3, 3, 2)", "(3, 3, 1)"), ("blocks", "3 * last[c]", "2 * last[c]"),
        ("blocks", "u + v < 4", "u + v < 5"), ("slices", "other < self.nodes.first", "other < 0"),
        ("blocks", "(2 * s + n)", "2 * s"), ("alpha", "63 * len(plane)", "64 * len(plane)"))),
    ("uncommon/queries_by_a_hair", "queries", "sum(candidate) * one", "sum(candidate) + one"),
    ("uncommon/queries_no_side", "queries", "else Fraction(0)", "else Fraction(1)"),
    ("uncommon/queries_no_side", "queries", "% 3, [0, 0, 0]", "% 3, [0, 0, 1]"),
    ("uncommon/maps_some", "queries", "[None] * count", "[None] + count"),
    ("uncommon/rules_one_level", "attributes", "ranges] if depth > 0", "ranges] if depth > 1"),
    ("uncommon/rules_valence", "syntax", "in (0, 2)", "in (0, 1)"),
    *((f"faulty/{name}", "syntax", text, other) for name, text, other in (
        ("slice_level_13", '"slice_level", 0, min(12', '"slice_level", 0, min(13'),
        ("num_models_9", '"num_models", 0, 8', '"num_models", 0, 9'),
        ("neural_hidden_0", '"num_hidden", 1', '"num_hidden", 0'), ("neural_width_0", '"hidden_width", 1', '"hidden_width", 0'),
        ("neural_half_4096_unasked", "largest >> 10", "largest >> 11"),
        ("neural_first_wave_0", '"first_wave", 1', '"first_wave", 0'),
        ("neural_first_wave_16385", '"first_wave", 1, 16384', '"first_wave", 1, 16385'),
        ("texels_uv_range_over", '2 ** unit["uv_bits"] - 1)', '2 ** unit["uv_bits"])'),
        ("codec_id_192", "1, 2, 192", "1, 2, 193"),
        ("groups_before_group", '"num_channel_groups", 1), 23', '"num_channel_groups", 1), 24'),
        ("position_bits_7", '"position_bits", 8', '"position_bits", 7'),
        ("position_bits_21", '"position_bits", 8, 20', '"position_bits", 8, 21'),
        ("num_channel_groups_0", '"num_channel_groups", 1', '"num_channel_groups", 0'), ("qp_64", '"qp", 0, 63', '"qp", 0, 64'),
        ("kernel_0", '["kernel"][0] >= 1', '["kernel"][0] >= 0'), ("residual_129", "128 if depth", "129 if depth"),
        ("num_filters_4", '"num_filters", 0, 3', '"num_filters", 0, 4'),
        ("level_index_2", '"level_index", 0, 1', '"level_index", 0, 2'),
        ("private_codec_letter", '"codec_name_length", 1', '"codec_name_length", 2'),
        ("level_shift_colour", "{0, 1} &", "{1} &"), ("level_shift_alpha", "{0, 1} &", "{0} &"),
        ("level_shift_with_alpha", "{0, 1} &", "{0} &"), ("texels_width_16385", "name, 1, 16384", "name, 1, 16385"))),
    *((f"faulty/{name}", "materials", text, other) for name, text, other in (
        ("normal_rule_7", '"normal_rule"), 6', '"normal_rule"), 7'),
        ("num_semantics_0", '"num_semantics", 1', '"num_semantics", 0'),
        ("num_semantics_4", '"num_semantics", 1, 3', '"num_semantics", 1, 4'),
        ("group_components_0", '"group_components", 1', '"group_components", 0'))),
]


@pytest.fixture(scope="module")
def held():
    """By name, the vectors that HELD names, with what the naive decoder says of them."""
    names = {name for name, *_ in HELD}
    return {case.name: traced(case) for case in cases_of() if case.name in names and case.lod == 0}


@pytest.mark.slow
@pytest.mark.parametrize("name, module, text, other", HELD)
def test_vector_holds_the_rule_that_it_was_made_for(held, monkeypatch, name, module, text, other):
    source = (mutants.NAIVE / f"{module}.py").read_text(encoding="utf-8")
    assert source.count(text) == 1 and (isinstance(held[name].said, dict) or held[name].said in ("Invalid", "Unsupported"))
    changed = compile(source.replace(text, other), f"{module} changed", "exec")
    monkeypatch.setattr(mutants, "changed_code", lambda mutant: changed)
    assert killer_of(Mutant(module, -1, "", 0, text, other), [held[name]]) == name


def test_a_run_goes_on_where_it_was_stopped(tmp_path, monkeypatch, capsys, empty):
    monkeypatch.setattr(mutants, "cases_of", lambda: [empty])
    state = tmp_path / "state.jsonl"
    call = ["--module", "bits", "--every", "40", "--jobs", "1", "--state", str(state)]
    assert mutants.main(call) == 7
    rows = [json.loads(line) for line in state.read_text().splitlines()]
    monkeypatch.setattr(mutants, "killer_of", lambda *_: pytest.fail("known already"))
    assert mutants.main([*call, "--page", str(tmp_path / "page.md")]) == 7
    assert len(rows) == len(mutants_of("bits")[::40]) and "mutants run" in capsys.readouterr().out
    assert isinstance(rows[0]["mutant"], list) and (tmp_path / "page.md").exists()
