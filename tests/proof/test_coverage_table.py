"""coverage_table of tools/proof: a branch that no run takes is found, and what is measured is what a decode imports."""

import json
from functools import partial

import pytest

from tools.proof import coverage_table
from tools.proof.coverage_table import (
    LEAST,
    REASONS,
    REPOSITORY,
    Branch,
    Module,
    Part,
    complaints,
    counted,
    file_of,
    measured,
    page_of,
    run_part,
    settings,
    share_of,
)

SMALL = "def f(a):\n    if a:\n        return 1\n    for b in a:\n        print(b)\n    return 2\n\n\nf([])\n"
MISSED = {"f: if a: -> return 1", "f: for b in a: -> print(b)"}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Module of a program of four branches, two of which it takes."""
    pytest.importorskip("coverage")
    folder = tmp_path_factory.mktemp("coverage")
    program = folder / "small.py"
    program.write_text(SMALL, encoding="utf-8")
    rc = settings(folder / "out", source=folder)
    assert run_part(Part("small", (str(program),), {}, "a program"), rc)[0] == 0
    (module,) = measured(rc, {"small": program})
    return module


def test_a_branch_that_is_not_taken_is_found(small):
    assert {branch.key_in("small") for branch in small.missed} == {f"small.{key}" for key in MISSED}
    assert (small.statements, small.branches, share_of([small])) == (7, 4, 50.0)


def test_a_branch_without_a_reason_fails_the_run_and_one_with_a_reason_does_not(small, monkeypatch):
    monkeypatch.setattr(coverage_table, "LEAST", 50.0)
    first, second = sorted(f"small.{key}" for key in MISSED)
    assert complaints([small], {first: "no need", second: "no need"}) == []
    (said,) = complaints([small], {first: "no need"})
    assert second in said and "nothing says why" in said


def test_too_small_a_share_fails_the_run_whatever_is_named():
    missed = tuple(Branch("f", n, "if a:", "b") for n in range(3))
    (said,) = complaints([Module("m", 200, 100, missed)], {"m.f: if a: -> b": "no need"})
    assert said.startswith("97.00 %") and str(LEAST) in said
    assert complaints([Module("m", 200, 100, missed[:2])], {"m.f: if a: -> b": "no need"}) == []


def test_a_key_holds_where_lines_move():
    told = {"summary": {"num_statements": 1, "num_branches": 2},
            "functions": {"f": {"missing_branches": [[2, 3]]}, "": {"missing_branches": [[1, -1]]}}}
    keys = lambda text, shift: {b.key_in("m") for b in counted("texfcodec.m", shifted(told, shift), text.splitlines()).missed}
    assert keys("if a:\n  if b:\n    c", 0) == keys("\n\nif a:\n  if b:\n    c", 2)


def shifted(told, lines):
    """What the report tells of the same file with lines before it."""
    move = partial(lambda line: line + lines if line > 0 else line)
    functions = {name: {"missing_branches": [[move(a), move(b)] for a, b in part["missing_branches"]]}
                 for name, part in told["functions"].items()}
    return told | {"functions": functions}


def test_the_page_names_every_missed_branch_and_why(small):
    text = page_of([small], {"small.f: if a: -> return 1": "it is a small program"}, [(Part("p", (), {}, "a part"), 2.4)])
    assert "**2 of 4 branches are taken, 50.00 %**" in text and "| small | 7 | 4 | 2 | 50.0 % |" in text
    assert "| small:2 | f | `if a:` | `return 1` | it is a small program |" in text
    assert "| small:4 | f | `for b in a:` | `print(b)` | **no reason given** |" in text and "| p | a part | 2 |" in text


def test_every_reason_is_of_lines_that_stand():
    for key, reason in json.loads(REASONS.read_text(encoding="utf-8")).items():
        place, _, way = key.partition(": ")
        lines = [line.strip() for line in module_of(place).read_text(encoding="utf-8").splitlines()]
        text, _, goal = way.rpartition(" -> ")
        assert text in lines and (goal == "end" or goal in lines) and reason.endswith("."), key


def module_of(place):
    """The file of "module.function" or "module.Class.method"."""
    parts = place.split(".")
    names = (file_of(".".join(["texfcodec", *parts[:n]])) for n in range(len(parts), 0, -1))
    return next(path for path in names if path.exists())


def test_every_part_names_files_that_stand():
    for part in coverage_table.PARTS:
        named = [word.partition("::") for word in part.call if ".py" in word]
        assert named or part.call[0] == "-m" and file_of(part.call[1]).exists(), part.name
        tests = [(file, test.partition("[")[0]) for file, _, test in named if test]
        assert all(f"def {test}(" in (REPOSITORY / file).read_text() for file, test in tests), part.name
        assert all((REPOSITORY / file).exists() for file, *_ in named), part.name
