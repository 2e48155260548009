"""docs/guide/guide.md against the tools: it names nothing that is not there, and leaves out no format and no exit code."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from texfcodec import errors
from texfcodec.cli import dec, enc, eval, info, render, validate, view
from texfcodec.io.formats import SAVED_SUFFIXES as WRITTEN
from texfcodec.io.formats import SUFFIXES as READ
from texfcodec.options import RATES

REPOSITORY = Path(__file__).resolve().parents[2]
GUIDE = REPOSITORY / "docs" / "guide" / "guide.md"
COMMANDS = {"texf-enc": enc.enc, "texf-dec": dec.dec, "texf-info": info.info, "texf-render": render.render,
            "texf-eval": eval.evaluate, "texf-validate": validate.validate, "texf-view": view.view}
FLAG = re.compile(r"--[a-z][a-z-]*[a-z]")


@pytest.fixture(scope="module")
def text():
    return GUIDE.read_text(encoding="utf-8")


def flags_of(command):
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}


def test_every_flag_in_a_line_of_a_tool_is_that_tools(text):
    lines = [(name, line) for line in text.splitlines() for name in COMMANDS if re.match(rf"    (for .*do )?{name} ", line)]
    strange = [(name, flag) for name, line in lines for flag in FLAG.findall(line) if flag not in flags_of(COMMANDS[name])]
    assert len(lines) >= 6 and strange == []


def test_every_flag_in_the_prose_is_some_tools(text):
    known = set().union(*map(flags_of, COMMANDS.values())) | {"--out", "--max"}  # --out: bench/; --max-...: the limits
    assert {flag for flag in FLAG.findall(text)} <= known


def test_every_format_that_is_read_or_written_stands_there(text):
    read = text.split("## What is read")[1].split("## What becomes")[0]
    written = text.split("`texf-dec` writes")[1].split("##")[0]
    assert [s for s in READ if f"{s} " not in read] == [] and [s for s in WRITTEN if f"{s} " not in written] == []


def test_every_rate_point_stands_there_as_it_is(text):
    for name, (resolution, qp) in RATES.items():
        assert f"| {name} | {resolution} | {qp} |" in text, name


def test_exit_codes_are_those_of_the_errors(text):
    rows = dict(re.findall(r"^\| (\d+) \| .* \| `(\w+)` \|$", text, re.M))
    families = (errors.InputError, errors.StreamError, errors.SupportError, errors.LimitError)
    assert rows == {str(family.exit_code): family.__name__ for family in families}
    assert f"| {errors.EXIT_INTERRUPTED} | interrupted" in text and f"| {errors.EXIT_INTERNAL} | internal" in text


def test_every_link_and_every_program_is_there(text):
    links = re.findall(r"\]\(([^)#:]+)\)", text) + ["../" + name for name in re.findall(r"\b(?:tools|conditions)/\w+\.\w+", text)]
    assert len(links) > 5 and [link for link in links if not (GUIDE.parent / link).exists()] == []


def test_the_sample_is_made_by_the_line_that_says_so(text, tmp_path):
    assert "python -m texfcodec.demo.asset vase.glb" in text
    run = subprocess.run([sys.executable, "-m", "texfcodec.demo.asset", str(tmp_path / "vase.glb")], cwd=REPOSITORY,
                         capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0, run.stderr
    size = (tmp_path / "vase.glb").stat().st_size  # PNGs: some per cent more or less, depending on the zlib at hand
    assert abs(size - 1.6e6) < 0.2e6 and text.count("1.6 MB") == 2
