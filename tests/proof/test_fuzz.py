"""Fuzz targets as plain tests and under hypothesis; the guide, the floors and what watches over them, shown to catch what they
are for. tests/fuzz/run.py runs the same targets for as long as one likes."""

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz import atheris_loop, page, run, supervision
from fuzz.branches import Tracer, branches_of, taken
from fuzz.choices import Choices, edited
from fuzz.execution import Answer, Request
from fuzz.seeds import vectors
from fuzz.supervision import supervise
from fuzz.syntax import bent_stream, draw, framed, traced
from fuzz.targets import TARGETS
from fuzz.trees import bend_tree
from texfcodec.bitstream.syntax import UNIT_HEADER, structures
from texfcodec.core.syntax_walk import Reader, read_structure, write_structure

REPOSITORY = Path(__file__).resolve().parents[2]
NATIVE = "geometry"  # runs Draco, which a child process confines
INPUTS, SECONDS = 120, 0.3  # of a target, whichever ends first
HERE = sorted(set(TARGETS) - {NATIVE})


def inputs(target, seed):
    """Inputs of every length: random bytes, half of them mostly zeros."""
    chance = random.Random(seed)
    for _ in range(INPUTS):
        data = bytearray(chance.randbytes(chance.randrange(target.bytes + 1)))
        if chance.random() < 0.5:
            data = bytearray(byte if chance.random() < 0.3 else 0 for byte in data)
        yield bytes(data)


@pytest.mark.parametrize("name", HERE)
def test_a_target_ends_in_a_value_or_an_error_on_any_input(name):
    target, seen = TARGETS[name], {TARGETS[name].outcome(b"")}
    stop = time.monotonic() + SECONDS
    for data in inputs(target, name):
        seen.add(target.outcome(data))
        if time.monotonic() > stop:
            break
    assert all(outcome == "value" or outcome.startswith("TXF-") for outcome in seen)


@pytest.mark.parametrize("name", HERE)
@settings(deadline=None, max_examples=8, suppress_health_check=list(HealthCheck))
@given(data=st.binary(max_size=120))
def test_a_target_ends_in_a_value_or_an_error_on_what_hypothesis_makes(name, data):
    assert TARGETS[name].outcome(data)


def test_the_draco_wrapper_ends_in_an_error_in_a_child_process(tmp_path):
    answer = supervise(request(tmp_path, NATIVE, "plain", 1.0))
    assert answer.findings == [] and answer.executions >= 10 and set(answer.outcomes) - {"value"}


# What is drawn and what is bent


@pytest.mark.parametrize("seed", range(5))
def test_what_is_drawn_from_a_table_is_legal(seed):
    elsewhere = ("raht_parameters", "codeword_header", "filter_stage", "neural_parameters", "latent_level", "geometry")
    for structure in structures():
        if structure.name not in elsewhere:
            known = {"num_materials": 2, "NumComponents": 3}
            drawn = draw(structure, Choices(random.Random(seed).randbytes(300)), dict(known), {})
            payload = write_structure(structure, drawn)
            assert read_structure(structure, Reader(payload, 0, len(payload)), dict(known)) == drawn


def test_a_stream_is_framed_again_as_it_was_and_bent_in_one_unit():
    data = vectors()[3]
    assert framed((kind, payload) for kind, payload, _ in traced(data)) == data
    chance, bent = random.Random(0), set()
    for _ in range(50):
        changed = bent_stream(data, Choices(chance.randbytes(40)), (UNIT_HEADER,))
        at = len(changed) - len(data) + traced(data)[0][1].__len__() + 14
        assert changed[at:] == data[len(traced(data)[0][1]) + 14 :]
        bent.add(changed)
    assert len(bent) > 30


def test_choices_stay_in_range_and_an_empty_input_makes_the_first():
    chance = random.Random(1)
    for _ in range(300):
        choices, low = Choices(chance.randbytes(9)), chance.randrange(-99, 99)
        high = low + chance.randrange(300)
        assert low <= choices.whole(low, high) <= high and low <= choices.near(low, high) <= high
        assert isinstance(edited(chance.randbytes(chance.randrange(4)), choices), bytes)
        json.dumps(bend_tree({"a": [1, {"b": "c"}]}, choices))
    empty = Choices(b"")
    assert (empty.whole(3, 9), empty.flag(), empty.pick("xy"), empty.take(5), empty.filled(2)) == (3, False, "x", b"", b"\0\0")


# Branches


def test_a_branch_is_taken_where_its_body_is_entered_or_passed_by():
    module = "core/syntax_walk.py"
    with Tracer() as tracer:
        with pytest.raises(Exception, match="TXF-S02"):
            Reader(b"", 0, 0).take(1, "a byte", "5")
    went, missed = taken((module,), tracer.arcs)
    line = next(branch.place for branch in branches_of(module))
    assert line in went and line + " not" in missed and len(went) == 1
    with tracer:
        Reader(b"a", 0, 1).take(1, "a byte", "5")
    assert line + " not" in taken((module,), tracer.arcs)[0]


def test_every_target_has_branches_and_a_floor():
    for target in TARGETS.values():
        assert sum(len(branches_of(module)) for module in target.modules) >= 2, target.name
        assert 20 <= target.floor <= 100, target.name


# What watches


ROTTEN = """
import os, sys, time
sys.path[:0] = ["tests", "."]
import fuzz.execution as execution
from fuzz.targets import Target
def crashes(data):
    if len(data) > 4: os.abort()
def hangs(data):
    while len(data) > 4: pass
def eats(data):
    if len(data) > 4: bytearray(b"x" * (300 << 20))
def raises(data):
    if len(data) > 4: {{}}["key"]
def sleeps(data):
    pass
execution.TARGETS["rotten"] = Target("rotten", {which}, ("core/syntax_walk.py",))
execution.main()
"""


def request(folder, target, mode, seconds):
    return Request(target, mode, seconds, 1, str(folder / "corpus"), str(folder / "findings"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is capped, and read from /proc")
@pytest.mark.parametrize("which, kind", [("crashes", "crash"), ("hangs", "hang"), ("eats", "memory"), ("raises", "exception")])
def test_what_goes_wrong_is_found_and_kept(tmp_path, monkeypatch, which, kind):
    """Inputs that warm a target up are short, so that it goes wrong only once it is watched."""
    program = tmp_path / "execution.py"
    program.write_text(ROTTEN.format(which=which).replace("execution.main()", "execution.WARM_INPUTS = 0\nexecution.main()"))
    monkeypatch.setattr(supervision, "HERE", tmp_path)
    monkeypatch.setattr(supervision, "HANG_SECONDS", 0.7 if kind == "hang" else 60.0)
    monkeypatch.chdir(REPOSITORY)
    answer = supervise(request(tmp_path, "rotten", "plain", 3.0 if kind == "memory" else 0.3))
    found = answer.findings[0]
    assert found["kind"] == kind and len((tmp_path / "findings" / found["file"]).read_bytes()) > 4


def test_a_target_under_its_floor_and_a_finding_fail_the_run(tmp_path, monkeypatch, capsys):
    answers = [Answer(5, 9.0, {"value": 5}, ["a"] * 10, ["core/syntax_walk.py:9"] * 90, 3, [])]
    monkeypatch.setattr(run, "supervise", lambda *_: answers[0])
    words = ["--seconds", "9", "--target", "numbers", "--mode", "guided", "--engine", "own", "--out", str(tmp_path)]
    assert run.main(words) == 7 and "less than its floor" in capsys.readouterr().out
    answers[0] = Answer(5, 9.0, {"value": 5}, ["a"] * 99, ["core/syntax_walk.py:9"], 3, [])
    assert run.main([*words, "--page", str(tmp_path / "page.md")]) == 0
    found = {"target": "numbers", "kind": "crash", "place": "", "file": "numbers-crash-1.bin", "said": ""}
    answers[0].findings = [found]
    monkeypatch.setattr(run, "confirm", lambda one, *_: {**one, "checked": "value"})
    assert run.main(words) == 7 and "numbers-crash-1.bin" in capsys.readouterr().out
    rows = page.read_state(tmp_path / "state.jsonl")
    assert [row["coverage"] for row in rows] == [10.0, 99.0, 99.0] and len(rows[2]["findings"]) == 1
    text = (tmp_path / "page.md").read_text()
    monkeypatch.setattr(run, "FLOORS_FILE", tmp_path / "floors.json")
    assert run.main(["--seconds", "0", "--floors", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "floors.json").read_text())["numbers"] == 99 - run.MARGIN
    assert "| numbers | 0 | 10 | 0 | 18 | 99.0 % |" in text and "10 executions of" in text


def test_a_hang_without_the_compiler_and_memory_for_compiling_are_none():
    assert not supervision.is_real({"kind": "memory", "checked": "TXF-S04"})
    assert not supervision.is_real({"kind": "hang", "checked": "value"})
    assert supervision.is_real({"kind": "hang", "checked": "hang"})
    assert supervision.is_real({"kind": "exception", "checked": "value"})


@pytest.mark.slow
def test_the_guide_keeps_what_is_new_and_reaches_more(tmp_path):
    answer = supervise(request(tmp_path, "framing", "guided", 4.0), supervision.WITHOUT_JIT)
    assert answer.findings == [] and answer.kept >= 5 and len(answer.taken) > len(answer.missed)
    assert len(list((tmp_path / "corpus").glob("*.bin"))) == answer.kept


def test_atheris_ends_by_itself_where_it_is_installed(tmp_path):
    pytest.importorskip("atheris", reason="atheris is not installed")
    answer = atheris_loop.run_atheris(TARGETS["numbers"], 2, 1, tmp_path / "corpus", tmp_path / "findings")
    assert answer.executions > 10 and answer.findings == []


def test_the_command_line_tells_what_it_does_not_know():
    command = [sys.executable, "tests/fuzz/run.py", "--target", "nothing"]
    ended = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False,
                           env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    assert ended.returncode == 2 and "nothing" in ended.stderr
