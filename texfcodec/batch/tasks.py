"""A task: commands that run one after the other in a folder of their own, and their outcome.

Tasks and outcomes travel to workers and back, so they hold nothing but numbers, texts and paths. Each attempt has a new folder,
which whoever runs the task makes; the folder becomes a result only when the client has renamed it, or its files.
"""

import errno
import hashlib
import shutil
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from .children import ROOT, Caps, Children, Overdue

LOG = "log.txt"
DONE, FAILED, FULL, INTERRUPTED, OVERDUE, UNSUITED = "done", "failed", "full", "interrupted", "overdue", "unsuited"
FULL_BYTES = 1 << 16  # a disk with less than this to spare is full
_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))


@dataclass(frozen=True, kw_only=True)
class Task:
    """Commands and their limits.

    name: for people, unique. commands: [(step, arguments of Python)], with {root}, {folder}, {input} and {threads} for the
    folder of the code, the folder of the attempt, the asset and a number. input: the asset; files: {name: text} that the folder
    holds at first; out: the file that gets stdout, LOG by default; enough: a file whose existence makes the remaining commands
    needless; unsuited: the exit code of a command that cannot run on this machine; package: package_code() of the client, "" for
    any; threads, memory, seconds: limits; memory in bytes, seconds for all commands together.
    """

    name: str
    commands: tuple[tuple[str, tuple[str, ...]], ...]
    input: Path
    files: dict[str, str] = field(default_factory=dict)
    out: str = LOG
    enough: str = ""
    unsuited: int | None = None
    package: str = ""
    threads: int = 1
    memory: int | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Outcome:
    """The end of a task. state: one of DONE, FAILED, FULL, INTERRUPTED, OVERDUE, UNSUITED; reason: a sentence, "" for DONE."""

    state: str
    reason: str = ""


def perform(task: Task, folder: Path, children: Children) -> Outcome:
    """Run the commands of a task one after the other and return the Outcome. folder: created here, keeps all files, LOG
    included; children: runs the processes."""
    try:
        folder.mkdir()
        for name, text in task.files.items():
            (folder / name).write_text(text, encoding="utf-8")
        return _run_commands(task, folder, children)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        return Outcome(FULL, "the disk is full") if is_full(error) else Outcome(FAILED, f"{type(error).__name__}: {error}")


def _run_commands(task, folder, children):
    caps = Caps(task.threads, task.memory, None if task.seconds is None else time.monotonic() + task.seconds)
    places = {"root": ROOT, "folder": folder, "input": task.input, "threads": task.threads}
    with open(folder / LOG, "ab") as log, open(folder / task.out, "ab") as out:
        for step, words in task.commands:
            try:
                code = children.run([word.format(**places) for word in words], out, log, caps)
            except Overdue:
                return Outcome(OVERDUE, f"{step}: took longer than {task.seconds:g} s")
            if code is None or children.stopped:
                return Outcome(INTERRUPTED, "interrupted")
            if code:
                return _failure(task, step, code, folder)
            if task.enough and (folder / task.enough).exists():
                break
    return Outcome(DONE)


def _failure(task, step, code, folder):
    if shutil.disk_usage(folder).free < FULL_BYTES:
        return Outcome(FULL, f"{step}: the disk is full")
    capped = f", with a memory limit of {task.memory} bytes" if task.memory and code < 0 else ""
    reason = f"ended by signal {-code}{capped}" if code < 0 else last_line(folder / LOG)
    return Outcome(UNSUITED if code == task.unsuited else FAILED, f"{step}: {reason}")


@cache
def package_code() -> str:
    """16 digits over the sources of the package from which this process runs."""
    total = hashlib.sha256()
    for path in sorted((ROOT / "texfcodec").rglob("*.py")):
        total.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def last_line(path: Path) -> str:
    """Return the last line of a log file that is not blank, at most 300 characters."""
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), "no output")[:300]


def is_full(error: BaseException) -> bool:
    """Return whether an error reports a full disk or an exceeded quota."""
    return isinstance(error, OSError) and error.errno in _FULL


def remove_folder(folder: Path) -> None:
    """Remove the folder of an attempt with its files, if it exists."""
    shutil.rmtree(folder, ignore_errors=True)

