"""tools/mutants.py: what is changed, and that a vector's killing is seen."""

import json
import os

import pytest

from tools import mutants
from tools.mutants import Case, cases_of, killer_of, mutants_of, page_of, traced

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants run in forked processes")


@pytest.fixture(scope="module")
def empty():
    """The quickest vector, traced."""
    return traced(next(case for case in cases_of() if case.name == "uncommon/empty"))


def test_every_change_of_a_module_is_numbered_and_another_text():
    for module in mutants.MODULES:
        found = mutants_of(module)
        assert len({m.number for m in found}) == len(found) > 50 and all(m.before != m.after for m in found)
    others = {"__init__", "oracles", "raster", "shading", "ssim"}  # no parts of the decoder
    assert {path.stem for path in mutants.NAIVE.glob("*.py")} - others == set(mutants.MODULES)


def test_a_vector_tells_what_it_calls_and_kills_what_it_sees(empty):
    assert isinstance(empty.said, dict) and ("bits", "units_of") in empty.functions
    killed = [m for m in mutants_of("bits") if m.function == "units_of" and killer_of(m, [empty] * empty.runs(m))]
    survivors = [m for m in mutants_of("bits") if m.function == "units_of" and m not in killed]
    assert any(m.before == "data[:8] == MAGIC" for m in killed)
    # one sound stream cannot hold a rule that refuses others
    assert any(m.before.startswith('require(reader.ended()') for m in survivors)
    assert not [m for m in mutants_of("planar") if empty.runs(m) and m.function != mutants.TOP]


def test_a_mutant_that_hangs_or_cannot_be_imported_is_killed(empty, monkeypatch):
    monkeypatch.setattr(mutants, "changed_code", lambda mutant: compile("while True: pass", "bits changed", "exec"))
    assert killer_of(mutants_of("bits")[0], [Case("a", empty.data, 0, empty.said, 0.01)]) == "a"
    monkeypatch.setattr(mutants, "changed_code", lambda mutant: compile("1 / 0", "bits changed", "exec"))
    assert killer_of(mutants_of("bits")[0], [empty]) == "uncommon/empty"


def test_the_page_counts_and_names_survivors_and_clauses():
    first, second, third, *_ = [m for m in mutants_of("filter") if m.function == "filter_stage"]
    text = page_of({first: "subset/a", second: None, third: None}, {third.key: "it means the same"})
    assert "3 mutants, 2 killed or equivalent (66.7%), 1 survivors." in text and f"- `{second.key}`" in text
    assert "it means the same" in text and "| 7.7 | 1 | subset/a 1 |" in text


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
