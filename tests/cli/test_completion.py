"""Shell completion: click's, through the wrapper that turns errors into codes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TOOLS = ("texf-enc", "texf-dec", "texf-info", "texf-render", "texf-eval", "texf-validate", "texf-view")


def ask(tool, instruction, words=""):
    """What the tool answers to its shell. words: the line so far, the last of them unfinished."""
    variable = f"_{tool.replace('-', '_').upper()}_COMPLETE"
    line = {"COMP_WORDS": f"{tool} {words}", "COMP_CWORD": str(len(words.split(" ")))}
    program = [sys.executable, "-m", "texfcodec.cli." + tool.removeprefix("texf-")]
    environment = {**os.environ, **line, variable: instruction}
    run = subprocess.run(program, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert run.returncode == 0 and run.stderr == "", run.stderr
    return run.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
@pytest.mark.parametrize("tool", TOOLS)
def test_every_tool_has_a_script_for_every_shell(tool, shell):
    if shell == "bash" and not shutil.which("bash"):
        pytest.skip("there is no bash, whose version click looks at")
    script = ask(tool, f"{shell}_source")
    assert f"{shell}_complete" in script and tool in script


def test_options_and_their_values_are_completed():
    assert "plain,--rate" in ask("texf-enc", "bash_complete", "--ra").splitlines()
    assert ask("texf-enc", "bash_complete", "--rate r0").splitlines() == [f"plain,r0{i}" for i in range(1, 7)]


@pytest.mark.parametrize("tool, words", [
    ("texf-enc", "sam"), ("texf-enc", "a.glb b.te"), ("texf-enc", "--checkpoint f"), ("texf-dec", "a.te"),
    ("texf-dec", "a.texf b.g"), ("texf-info", "a.te"), ("texf-validate", "a.te"), ("texf-render", "sam"),
    ("texf-render", "a.glb b.p"), ("texf-render", "--compare b"),
    ("texf-eval", "sam"), ("texf-eval", "a.glb b.te"), ("texf-eval", "--lpips w"),
    ("texf-view", "sam"), ("texf-view", "a.texf b"), ("texf-view", "--export p"),
])  # fmt: skip
def test_names_of_files_are_left_to_the_shell(tool, words):
    assert ask(tool, "bash_complete", words).splitlines() == ["file," + words.split(" ")[-1]]


def test_the_line_of_the_guide_works_in_bash(tmp_path):
    if not shutil.which("bash"):
        pytest.skip("there is no bash")
    program = tmp_path / "texf-enc"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m texfcodec.cli.enc "$@"\n')
    program.chmod(0o755)
    line = 'eval "$(_TEXF_ENC_COMPLETE=bash_source texf-enc)"'
    assert line in (REPOSITORY / "docs" / "guide" / "index.md").read_text(encoding="utf-8")
    typed = "COMP_WORDS=(texf-enc --effort b); COMP_CWORD=2; _texf_enc_completion texf-enc; echo ${COMPREPLY[@]}"
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    run = subprocess.run(["bash", "-c", f"{line}; {typed}"], cwd=REPOSITORY, env=environment, capture_output=True, text=True,
                         check=False, timeout=120)
    assert run.stdout.split() == ["balanced"], run.stderr
