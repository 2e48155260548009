"""tools/proof/stability.py: the page has the cases of the rooms, the search finds the worst, a broken bound is seen."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bounds import Case, Draws, value_of, worst_of

from tools.proof import stability as command
from tools.proof.stability import CASES, GROUPS, bound_of, page_of, row_of, rows_of

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs" / "reports" / "stability.md"
PLANTED = Case("planted", "none", "a peak that seeds do not meet", 0.5, "of the peak", "It does not hold.",
               lambda draw: math.exp(-40 * sum((draw.unit() - at) ** 2 for at in (0.731, 0.212, 0.645))))


def test_cases_are_told_apart_and_say_why_they_hold():
    rooms = [case for case in CASES.values() if case.why and case.stress and case.unit and case.seeds]
    assert len(rooms) == len(CASES) > 25 and all("|" not in case.name for case in rooms)
    assert all(math.isfinite(case.bound) for case in rooms) and len(GROUPS) > 5


def test_the_page_has_the_tables_cases_with_their_bounds_and_none_broken():
    page = PAGE.read_text(encoding="utf-8")
    rows = rows_of(page)
    assert {name: bound for name, (bound, _) in rows.items()} == {name: bound_of(case) for name, case in CASES.items()}
    assert all(worst <= CASES[name].bound * (1 + 1e-9) for name, (_, worst) in rows.items())
    assert all(f"- **{case.name}** ({case.stress}). {case.why}\n" in page for case in CASES.values())


def test_the_page_has_a_row_and_a_reason_for_what_was_found():
    name = next(iter(CASES))
    found = {name: worst_of(CASES[name], trials=1)}
    page = page_of(found, [])
    assert row_of(CASES[name], found[name]) in page and CASES[name].why in page and "1 cases, 1 trials." in page
    assert rows_of(page).keys() == {name}


def test_a_case_that_is_worse_than_its_bound_is_found_and_ends_with_7(monkeypatch, capsys):
    name = next(iter(CASES))
    for value in (math.nextafter(CASES[name].bound, 9), math.inf, math.nan):
        doctored = replace(CASES[name], measure=lambda draw, value=value: draw.unit() * 0 + value)
        assert worst_of(doctored, trials=2).value > doctored.bound
        monkeypatch.setitem(CASES, name, doctored)
        assert command.main(["--case", name, "--trials", "2"]) == 7
        assert f"broken: {name}" in capsys.readouterr().err
    monkeypatch.setitem(CASES, name, replace(CASES[name], measure=lambda draw: 0.0))
    assert command.main(["--case", name, "--trials", "2"]) == 0


def test_a_run_goes_on_where_it_was_stopped(tmp_path, monkeypatch, capsys):
    name, state = next(iter(CASES)), tmp_path / "found" / "state.jsonl"
    words = ["--case", name, "--trials", "3", "--small", "--state", str(state)]
    assert command.main(words) == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(command, "worst_of", lambda *_: pytest.fail("known already"))
    assert command.main(words) == 0 and capsys.readouterr().out == first and len(state.read_text().splitlines()) == 1


def test_the_search_finds_a_planted_peak_that_seeds_miss():
    seeds, search = worst_of(replace(PLANTED, search=False), trials=2000), worst_of(PLANTED, trials=2000)
    assert seeds.by == "seeds" and seeds.value < 0.99
    assert search.by == "search" and search.value > 0.99


def test_trials_are_the_same_again_and_a_trial_is_played_again_from_its_answers():
    one, two = (worst_of(PLANTED, trials=60) for _ in range(2))
    assert (one.value, one.answers, one.by) == (two.value, two.answers, two.by)
    value, answers = value_of(PLANTED, one.answers, np.random.default_rng(77))
    assert (value, answers) == (one.value, one.answers)


def test_a_trial_that_raises_names_its_case_and_answers():
    with pytest.raises(ZeroDivisionError) as caught:
        worst_of(replace(PLANTED, measure=lambda draw: 1 / int(draw.unit() < 0)), trials=1)
    assert "planted" in caught.value.__notes__[0]


@pytest.mark.parametrize("answer", [0.0, 0.5, 1.0])
def test_draws_stay_in_their_range_at_the_ends(answer):
    draw = Draws(np.random.default_rng(0), [answer] * 40)
    assert 3 <= draw.integer(3, 9) <= 9 and draw.pick("abc") in "abc" and -2 <= draw.real(-2, 5) <= 5
    assert set(draw.integers((2, 3), -1, 1).ravel()) <= {-1, 0, 1} and draw.reals((2,), 0, 1).max() <= 1
