"""README and docs/guide against the tools: the pages name nothing that is not there, and leave out no format and no exit code."""

import re
import subprocess
import sys

import pages
import pytest

from texfcodec import errors
from texfcodec.cli import dec, enc, eval, info, render, validate, view
from texfcodec.io.formats import SAVED_SUFFIXES as WRITTEN
from texfcodec.io.formats import SUFFIXES as READ
from texfcodec.options import RATES

REPOSITORY = pages.REPOSITORY
COMMANDS = {"texf-enc": enc.enc, "texf-dec": dec.dec, "texf-info": info.info, "texf-render": render.render,
            "texf-eval": eval.evaluate, "texf-validate": validate.validate, "texf-view": view.view}
FLAG = re.compile(r"--[a-z][a-z-]*[a-z]")
# Flags of other programs: tools/bench/ (--out), conformance/run.py, tools/proof.
OTHER_FLAGS = {"--out", "--max", "--decoder", "--queries", "--home", "--light", "--alike", "--averaged", "--pair", "--config",
               "--advise", "--max-vertices", "--screenshot", "--anti-alias"}  # of version 0.9, which from_0_9.md names
PAGES = [pages.README, *pages.guide_pages()]
FRONT = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "js/README.md", "conformance/README.md")
LINKING = [*(REPOSITORY / name for name in FRONT), *sorted((REPOSITORY / "docs").rglob("*.md"))]
LONGEST_MEDIAN = 18  # words of a sentence


def page(name):
    return (pages.GUIDE / name).read_text(encoding="utf-8")


def names(paths):
    return [path.relative_to(REPOSITORY).as_posix() for path in paths]


def flags_of(command):
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}


def strange_flags(text):
    """(tool, flag) of every flag in a line of a tool that the tool does not have."""
    lines = [words for words in pages.commands_of(text) if words[0] in COMMANDS]
    return [(words[0], flag) for words in lines for word in words[1:] for flag in FLAG.findall(word)
            if flag not in flags_of(COMMANDS[words[0]])]


@pytest.mark.parametrize("path", PAGES, ids=names(PAGES))
def test_every_flag_is_that_of_its_line_or_in_the_prose_some_tools(path):
    text = path.read_text(encoding="utf-8")
    known = set().union(*map(flags_of, COMMANDS.values())) | OTHER_FLAGS
    assert strange_flags(text) == [] and {flag for flag in FLAG.findall(text) if flag not in known} == set()


def test_a_strange_flag_and_a_line_of_code_in_a_fence_are_told_apart():
    assert strange_flags("Text.\n\n    texf-dec a.texf b.glb --rate r03   # --lod is one\n") == [("texf-dec", "--rate")]
    assert strange_flags("```\n    texf-dec a.texf b.glb --rate r03\n```\n") == []


def test_every_format_that_is_read_or_written_stands_there():
    read, rest = page("formats.md").split("## What is read")[1].split("## What becomes")
    written = rest.split("## What is written")[1]
    assert [s for s in READ if f"{s} " not in read] == [] and [s for s in WRITTEN if f"{s} " not in written] == []


def test_every_rate_point_stands_there_as_it_is():
    text = page("rates.md")
    assert [name for name, (resolution, qp) in RATES.items() if f"| {name} | {resolution} | {qp} |" not in text] == []


def test_exit_codes_are_those_of_the_errors():
    text = page("errors.md")
    rows = dict(re.findall(r"^\| (\d+) \| .* \| `(\w+)` \|$", text, re.M))
    families = (errors.InputError, errors.StreamError, errors.SupportError, errors.LimitError)
    assert rows == {str(family.exit_code): family.__name__ for family in families}
    assert f"| {errors.EXIT_INTERRUPTED} | interrupted" in text and f"| {errors.EXIT_INTERNAL} | internal" in text


def broken_links(path):
    """Links of a page whose file or anchor is not there."""
    for target, anchor in pages.links_of(path.read_text(encoding="utf-8")):
        linked = path.parent / target if target else path
        if not linked.exists() or anchor and anchor not in pages.anchors_of(linked.read_text(encoding="utf-8")):
            yield f"{target}#{anchor}"


@pytest.mark.parametrize("path", LINKING, ids=names(LINKING))
def test_every_link_and_its_anchor_is_there(path):
    assert list(broken_links(path)) == []


def test_broken_links_are_found(tmp_path):
    (tmp_path / "there.md").write_text("# A head: line\n")
    text = "[a](there.md) [b](there.md#a-head-line) [c](gone.md) [d](there.md#gone) [e](https://example.org/x) `[f](code.md)`\n"
    (tmp_path / "page.md").write_text(text)
    assert list(broken_links(tmp_path / "page.md")) == ["gone.md#", "there.md#gone"]


def test_every_program_that_the_guide_names_is_there():
    program = re.compile(r"\b(?:conformance|tests|texfcodec|tools)/[\w/]+\.\w+")
    programs = {name for path in PAGES for name in program.findall(path.read_text(encoding="utf-8"))}
    assert len(programs) > 5 and [name for name in programs if not (REPOSITORY / name).exists()] == []


def test_every_page_of_the_guide_is_in_its_index():
    linked = {target for target, _ in pages.links_of(page("index.md"))}
    assert [path.name for path in pages.guide_pages() if path.name not in linked | {"index.md"}] == []


def test_the_sample_is_made_by_the_line_that_says_so(tmp_path):
    assert "python -m texfcodec.demo.asset vase.glb" in page("index.md")
    run = subprocess.run([sys.executable, "-m", "texfcodec.demo.asset", str(tmp_path / "vase.glb")], cwd=REPOSITORY,
                         capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0, run.stderr
    size = (tmp_path / "vase.glb").stat().st_size  # PNGs: some per cent more or less, depending on the zlib at hand
    assert abs(size - 1.6e6) < 0.2e6 and "1.6 MB" in page("index.md")


@pytest.mark.parametrize("path", PAGES, ids=names(PAGES))
def test_sentences_are_short(path, record_property):
    median = pages.median_length(path.read_text(encoding="utf-8"))
    print(f"{path.name}: a median of {median:g} words a sentence")
    record_property("median_words", median)
    assert median <= LONGEST_MEDIAN, path.name


def test_sentences_are_counted_without_code_tables_and_options():
    text = ("# A heading of no account\n\nOne two three. Four `code is one word` [six](a.md), with 8.4 or e.g. this. Last\n\n"
            "    texf-enc vase.glb. Not prose.\n\n| a. B c. | d |\n|---|---|\n\n- `--rate`: an option.\n"
            "- An item here, as r01. Is.\n\n```\nfenced. Code.\n```\n<!-- block: all -->\nGenerated. Text.\n<!-- end -->\n")
    assert [pages.words_in(sentence) for sentence in pages.sentences(text)] == [3, 8, 1, 5, 1]
    assert pages.median_length(text) == 3
