"""Every command of README and of the guide is run, one after the other, on a small asset, or is named here with a reason."""

import re
import subprocess
import sys
import time

import numpy as np
import pages
import pytest
from batches import write_ball
from gltf_scenes import spinning
from voxel_files import shell, write_vxz

# What a command is not run for, and the reason. Every entry stands for at least one command, or a test says so.
SKIPPED = {
    r"^texf-view (?!.*--export)": "serves a page until Ctrl-C",
    r"--scheduler": "needs a Dask cluster; tests/batch makes one",
    r" scan\.(texf|glb)": "TEXF_stream.md speaks of a scan of the reader's own; the same flags run on vase.glb",
}


FIRST = [pages.README, pages.GUIDE / "index.md"]


def all_commands(found=None):
    """(page, words) of every command of some pages, by default of all; each command once, where it stands first."""
    seen = set()
    for path in found or [*FIRST, *pages.guide_pages()]:
        for words in pages.commands_of(path.read_text(encoding="utf-8")):
            if tuple(words) not in seen:
                seen.add(tuple(words))
                yield path.name, words


def reason_to_skip(words):
    """Why a command is not run, or None."""
    return next((why for pattern, why in SKIPPED.items() if re.search(pattern, " ".join(words))), None)


def code_after(text, mark):
    """The first block of a fence behind a mark."""
    return re.search(r"```\w*\n(.*?)^```", text[text.index(mark) :], re.M | re.S)[1]


@pytest.fixture
def folder(tmp_path, monkeypatch, install):
    """Where the commands run: with the catalogue and the codec that the pages show."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "meshes").mkdir()
    write_ball(tmp_path / "meshes")
    (tmp_path / "city").mkdir()
    for name in ("fan.glb", "city/fan.glb"):
        (tmp_path / name).write_bytes(spinning().glb())
    (tmp_path / "city/tileset.json").write_text('{"root": {"content": {"uri": "fan.glb"}}}')
    (tmp_path / "statue.vxz").write_bytes(write_vxz(shell(8)))
    np.savez(tmp_path / "statue.npz", **shell(8), resolution=8)
    lines = pages.indented_lines((pages.GUIDE / "catalogue.md").read_text(encoding="utf-8"))
    manifest = lines[lines.index("[options]") : max(i for i, line in enumerate(lines) if line.startswith("options = ")) + 1]
    (tmp_path / "catalogue.toml").write_text("\n".join(manifest))
    codec = code_after((pages.GUIDE / "own_codec.md").read_text(encoding="utf-8"), "## A minimal codec")
    install({"zipped": "zipped:Zipped"}, zipped=codec)
    monkeypatch.delitem(sys.modules, "texfcodec.cli.enc", raising=False)  # another test may have read it without the codec
    return tmp_path


def run(words, call):
    """(exit code, what it said last) of one command."""
    if words[0] == "python":
        done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True, check=False, timeout=120)
        pages.write_vase(words[-1])
        return done.returncode, done.stderr[-500:]
    code, _, said = call(*words)
    return code, said[-500:]


@pytest.mark.parametrize("found", [FIRST, None], ids=["readme and index", "all pages"])
def test_every_command_of_readme_and_guide_runs_or_is_skipped_for_a_reason(folder, call, found):
    failed, seconds = [], []
    for page, words in all_commands(found):
        if reason_to_skip(words) is None:
            begin = time.perf_counter()
            code, said = run(words, call)
            seconds.append((time.perf_counter() - begin, " ".join(words)))
            failed += [f"{page}: {' '.join(words)}: exit code {code}: {said}"] if code else []
    print("\n".join(f"{taken:6.1f} s  {words}" for taken, words in seconds))
    print(f"{sum(taken for taken, _ in seconds):6.1f} s in all, {len(seconds)} commands")
    assert failed == [] and len(seconds) > (4 if found else 20)


def test_what_is_skipped_is_there_and_is_little():
    commands = [words for _, words in all_commands()]
    unused = [pattern for pattern in SKIPPED if not any(re.search(pattern, " ".join(words)) for words in commands)]
    assert unused == [] and sum(reason_to_skip(words) is not None for words in commands) < len(commands) / 3


def test_commands_are_found_where_pages_have_them():
    text = ("Text.\n\n    texf-enc a.glb b.texf --rate r03   # a comment\n    a.texf: 5 bytes\n"
            "    python -m texfcodec.demo.asset c.glb\n\n| x |\n\n```\n    texf-dec in a fence\n```\n")
    assert pages.commands_of(text) == [["texf-enc", "a.glb", "b.texf", "--rate", "r03"],
                                       ["python", "-m", "texfcodec.demo.asset", "c.glb"]]
    assert reason_to_skip(["texf-view", "a.texf"]) and reason_to_skip(["texf-view", "a.texf", "--export", "p.html"]) is None
