"""Ctrl-C at random moments of every tool, in a pending kernel, and where files are made and renamed."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import interrupts
import pytest

from texfcodec.cli import interrupts as answering
from texfcodec.core import cleanup

REPOSITORY = Path(__file__).resolve().parents[2]
UNIX = pytest.mark.skipif(sys.platform == "win32", reason="this system has no kill() of one's own process")
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="moments are counted by /proc")

PENDING = """
import os, signal, sys, threading
import numpy as np
signal.signal(signal.SIGINT, signal.default_int_handler)
from texfcodec.{module} import {function} as work
corners = np.array([[0, 0, 0], [16383, 0, 100], [16383, 16383, 0], [0, 16383, 50]])
faces = np.array([[0, 1, 2], [0, 2, 3]])
work(corners, faces, 14, 16)
threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    work(corners, faces, 14, 4096)
except KeyboardInterrupt:
    sys.exit(130)
"""

LATE = """
import os, signal, sys, time
from pathlib import Path
from texfcodec.io import output_files
from texfcodec.core import cleanup
rename = os.replace
def interrupted(a, b):  # once, after the first file, those of kernels that are compiled not counted
    rename(a, b)
    if Path(b).parent != Path(sys.argv[-1]).parent:
        return
    os.replace = rename
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)
os.replace = interrupted
from texfcodec.cli.{tool} import main
main()
"""


MIDWAY = """
import os, signal
from texfcodec import report
plain = report.Report.progress
def progress(self, stage, done, total):
    if stage == "transfer":
        os.kill(os.getpid(), signal.SIGINT)
    plain(self, stage, done, total)
report.Report.progress = progress
from texfcodec.cli.enc import main
main()
"""


def started(program, *arguments, handler=signal.SIG_DFL):
    """A finished process of a program's text. handler: of SIGINT, as its caller leaves it."""
    return subprocess.run([sys.executable, "-c", program, *arguments], cwd=REPOSITORY, capture_output=True, text=True,
                          check=False, timeout=300, preexec_fn=lambda: signal.signal(signal.SIGINT, handler))


@pytest.mark.slow
@LINUX
def test_every_tool_ends_as_it_should_at_random_moments(tmp_path):
    counts, found = interrupts.interrupt_all(tmp_path, 6)
    assert not found, "\n".join(found)
    assert {codes.total() for codes in counts.values()} == {6} and len(counts) == 7
    assert all(codes[130] > 1 for codes in counts.values())


@pytest.mark.slow
@LINUX
def test_a_tool_that_is_killed_leaves_whole_files_and_runs_again(tmp_path):
    counts, found = interrupts.interrupt_all(tmp_path, 3, sent=signal.SIGKILL)
    assert not found, "\n".join(found)
    assert all(codes[-signal.SIGKILL] > 0 for codes in counts.values()) and len(counts) == 7


@pytest.mark.slow
@UNIX
@pytest.mark.parametrize("module, function", [("encoder.place.contacts", "find_contacts"), ("field.voxelise", "voxelise")])
def test_an_interrupt_that_waits_for_a_kernel_is_a_keyboard_interrupt(module, function):
    """Numba runs Python while it boxes a kernel's results; an interrupt between two arrays was a SystemError or a crash."""
    program = PENDING.format(module=module, function=function)
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert run.returncode == 130, run.stderr[-500:]


@pytest.mark.slow
def test_no_kernel_that_python_calls_returns_two_arrays():
    program = """
import sys, inspect
from texfcodec.precompile import warm_up
warm_up()
from texfcodec.core.kernel import Kernel
from numba.core import types
seen, many = set(), []
for name, module in list(sys.modules.items()):
    for kernel in vars(module).values() if name.startswith("texfcodec.") else ():
        if isinstance(kernel, Kernel) and kernel.__module__ == name:
            for signature in kernel.nopython_signatures:
                seen.add(kernel.__name__)
                result = signature.return_type
                if isinstance(result, types.BaseTuple) and any(isinstance(one, types.Array) for one in result):
                    many.append(kernel.__name__)
print(*sorted(seen), "-", *many)
"""
    run = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True, timeout=600)
    seen, many = (set(part.split()) for part in run.stdout.split(" -"))
    entries = {"_cells", "_touched", "_gather", "_query", "_enc_mixed_level", "_dec_direct_level", "_infer"}
    assert entries <= seen and len(seen) > 40
    assert not many  # but for what only other kernels call, which is compiled without a way to Python


@UNIX
def test_ctrl_c_in_mid_encode_leaves_nothing(tmp_path):
    interrupts.prepare(tmp_path)
    before = interrupts.contents(tmp_path)
    run = started(MIDWAY, tmp_path / "mesh.ply", tmp_path / "a.texf", *interrupts.SMALL)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", interrupts.INTERRUPTED.decode())
    assert interrupts.contents(tmp_path) == before


@UNIX
def test_an_interrupt_after_the_rename_comes_too_late(tmp_path):
    interrupts.prepare(tmp_path)
    run = started(LATE.format(tool="enc"), tmp_path / "mesh.ply", tmp_path / "a.texf", *interrupts.SMALL)
    assert (run.returncode, run.stderr) == (0, "") and "a.texf: " in run.stdout
    assert (tmp_path / "a.texf").read_bytes() == (tmp_path / "stream.texf").read_bytes()


@UNIX
def test_an_interrupt_between_two_renames_waits_for_the_last(tmp_path):
    interrupts.prepare(tmp_path)
    run = started(LATE.format(tool="dec"), tmp_path / "stream.texf", tmp_path / "a.gltf")
    names = {path.name for path in tmp_path.iterdir()}
    assert {"a.gltf", "a.bin", "a.png"} <= names and not [name for name in names if name.endswith(".tmp")]
    assert (run.returncode, run.stdout.count("faces")) == (0, 1)


def test_a_process_that_ignores_the_signal_goes_on_ignoring_it(tmp_path):
    interrupts.prepare(tmp_path)
    run = started(LATE.format(tool="enc"), tmp_path / "mesh.ply", tmp_path / "a.texf", *interrupts.SMALL, handler=signal.SIG_IGN)
    assert run.returncode == 0 and (tmp_path / "a.texf").exists()


def test_import_of_a_tool_leaves_the_signal_alone():
    program = "import signal; from texfcodec.cli import enc; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    assert started(program).stdout == "True\n"


def test_what_is_unfinished_is_removed(tmp_path):
    with cleanup.new_file(tmp_path / "half") as file:
        file.write(b"half")
    with cleanup.Folder("texf-test-") as folder:
        (Path(folder) / "deeper").mkdir()
        (Path(folder) / "deeper" / "answer").write_bytes(b"x")
        cleanup.remove_all()
        assert not os.path.exists(folder)
    assert list(tmp_path.iterdir()) == []
    cleanup.remove(tmp_path / "half")


def test_a_child_gets_its_input_and_is_ended_when_it_takes_too_long():
    program = [sys.executable, "-c", "import sys; print(sys.stdin.read()[::-1])"]
    assert cleanup.run_child(program, b"abc", 60, dict(os.environ)).stdout.strip() == b"cba"
    with pytest.raises(subprocess.TimeoutExpired):
        cleanup.run_child([sys.executable, "-c", "import time; time.sleep(60)"], b"", 0.3, dict(os.environ))
    assert not cleanup._children


def test_a_child_that_is_held_ends_with_the_process():
    child = cleanup.hold(lambda: subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]))
    cleanup.remove_all()
    cleanup.drop(child)
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)
    child.wait()


def test_of_files_that_are_renamed_together_none_that_is_new_stays_alone(tmp_path):
    for name in ("new.tmp", "other.tmp", "old"):
        (tmp_path / name).write_text(name)
    pairs = [("new.tmp", "new"), ("other.tmp", "old"), ("missing.tmp", "third")]
    with pytest.raises(OSError):
        cleanup.rename_all([(tmp_path / a, tmp_path / b) for a, b in pairs])
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"old": "other.tmp"}


# The thread that answers an interrupt, called as a function


INTERRUPT = bytes([signal.SIGINT])


@pytest.fixture
def answer(monkeypatch):
    """answer(bytes, ...): what the thread has written, (descriptor, line), once it has read these and ended the process."""

    class Ended(BaseException):
        pass

    def end(code):
        raise Ended(code)

    def run(*heard):
        left, written = list(heard), []
        calls = SimpleNamespace(read=lambda *_: left.pop(0), write=lambda *what: written.append(what), _exit=end)
        monkeypatch.setattr(answering, "os", calls)
        try:
            with pytest.raises(Ended, match="130"):
                answering._wait(7)
        finally:
            cleanup.GATE.release()
            cleanup.begin()
        assert not left
        return written

    for name, usual in (("errors", None), ("partly", False), ("kept", False), ("bar", False)):  # what other tests have left
        monkeypatch.setattr(answering.Talk, name, usual)
    cleanup.begin()
    return run


def test_an_interrupt_removes_what_is_unfinished_and_says_so(answer, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["texf-enc", "a.glb", "a.texf"])
    cleanup.new_file(tmp_path / "half").close()
    assert answer(bytes([signal.SIGTERM]), INTERRUPT) == [(2, b"error TXF-C02: interrupted; nothing was written\n")]
    assert list(tmp_path.iterdir()) == []
    cleanup.remove(tmp_path / "half")


def test_once_the_outcome_stands_only_a_second_interrupt_ends_the_process(answer):
    cleanup.finish()
    assert answer(INTERRUPT, INTERRUPT) == []


@pytest.mark.parametrize("told, errors, target", [(["a", "--json"], None, 1), (["-", "--json"], None, 1),
                                                  (["a", "-", "--json"], None, 2), (["a", "--json"], 5, 5)])
def test_an_interrupt_is_json_where_json_is_asked_for(answer, monkeypatch, told, errors, target):
    monkeypatch.setattr(sys, "argv", ["texf-info", *told])
    monkeypatch.setattr(answering.Talk, "errors", errors)
    ((where, line),) = answer(INTERRUPT)
    assert where == target and json.loads(line)["error"] == {
        "code": "TXF-C02", "message": "interrupted; nothing was written", "exit_code": 130}


def test_an_interrupt_gives_back_the_cursor_that_a_progress_bar_hides(answer, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["texf-enc", "a.glb", "a.texf"])
    monkeypatch.setattr(answering.Talk, "bar", True)
    ((_, line),) = answer(INTERRUPT)
    assert line.startswith(b"\x1b[?25h\n")


@pytest.mark.parametrize("command, original, ours", [
    (["texf-dec", "a.texf"], [], True), (["-m"], ["python", "-m", "texfcodec.cli.dec"], True), ([], [], False),
    (["-m"], ["python", "-m", "pytest"], False), (["some/other.py"], [], False)])
def test_a_process_is_one_of_the_tools_by_its_command_line(monkeypatch, command, original, ours):
    monkeypatch.setattr(sys, "argv", command)
    monkeypatch.setattr(sys, "orig_argv", original)
    assert answering.is_program() == ours


def test_a_handler_of_somebody_else_stays_and_ours_is_ignored_at_the_end(monkeypatch):
    usual = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        theirs = signal.getsignal(signal.SIGINT)
        answering.install()
        monkeypatch.setattr(answering.Talk, "installed", False)
        answering.ignore()
        assert signal.getsignal(signal.SIGINT) is theirs
        monkeypatch.setattr(answering.Talk, "installed", True)
        answering.ignore()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, usual)
