"""Validation in a child process with capped memory and time, as in sandbox/isolate.py. The parent reads the syntax alone."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

from ..core.json_text import json_text
from ..errors import LimitError, TexfError
from ..findings import SEVERITIES
from ..limits import Limits
from ..report import Report
from ..sandbox.limited_process import FACTS, NO_CAP, child_folder, crash_of, memory_error, read_facts, run_child, within_cap
from .validate import OUTCOME, ROW, validate


def validate_isolated(data: bytes, limits: Limits | None = None, threads: int = 1, report: Report | None = None) -> dict:
    """Validate a stream as validate() does, with Draco and the kernels in a child process; return the same dict.

    limits.isolate_bytes and limits.isolate_seconds cap the child. If it breaks, the findings are those of the syntax and the
    error for the child.
    """
    limits, report = limits or Limits(), report or Report()
    try:
        with child_folder() as folder, report.stage("isolate"):
            return _answer_of(bytes(data), limits, threads, report, folder)
    except TexfError as error:
        return validate(data, limits, threads, report, failure=error)


def _answer_of(data, limits, threads, report, folder):
    """The child's outcome. Raises StreamError or LimitError if it gives none, or an invalid one."""
    child = run_child(__name__, data, {"limits": asdict(limits), "threads": threads}, limits, folder)
    try:
        answer = read_facts(folder)
        outcome, warnings = answer["outcome"], [str(text) for text in answer["warnings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise crash_of(child, limits) from error
    if outcome is None:
        raise memory_error(limits)
    if not _is_sound(outcome):
        raise crash_of(child, limits)
    report.warnings += warnings
    return outcome


def _is_sound(outcome):
    """Return whether an outcome has the form of validate()'s; the child may have been taken over."""
    rows = isinstance(outcome, dict) and outcome.keys() == OUTCOME and outcome["findings"]
    return isinstance(rows, list) and all(isinstance(row, dict) and row.keys() == ROW for row in rows) \
        and isinstance(outcome["counts"], dict) and outcome["counts"].keys() == {*SEVERITIES} \
        and all(type(outcome[name]) is int and 0 <= outcome[name] < 8 for name in ("exit_code", "strict_exit_code"))


def _child(folder, request):
    """The child's side: validates stdin and writes its answer into the folder."""
    limits, report = Limits(**request["limits"]), Report()
    data = sys.stdin.buffer.read()
    try:
        outcome, capped = within_cap(limits, lambda: validate(data, limits, request["threads"], report))
    except LimitError:  # of memory: any other is a finding
        outcome, capped = None, True
    answer = {"outcome": outcome, "warnings": [] if capped else [NO_CAP]}
    (folder / FACTS).write_text(json_text(answer), encoding="utf-8")


if __name__ == "__main__":
    _child(Path(sys.argv[1]), json.loads(sys.argv[2]))
