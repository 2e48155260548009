"""Progress of a long run on stderr: a bar on a terminal, else a line now and then."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from ..report import Report
from .interrupts import Talk

LINE_SECONDS = 10.0  # between two lines


@contextmanager
def bar() -> Iterator[Report]:
    """A Report whose stages are bars on the terminal, gone when the block ends."""
    from rich.console import Console as Terminal
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description:12}"), BarColumn(24), TimeElapsedColumn(),
               TextColumn("{task.fields[note]}"))
    tasks = {}
    with Progress(*columns, console=Terminal(stderr=True), transient=True) as shown:

        def show(stage, done, total):
            if stage not in tasks:
                tasks[stage] = shown.add_task(stage, total=total, note="")
            shown.update(tasks[stage], completed=done, total=total, note=report.note)

        report = Report(show)
        Talk.bar = True
        try:
            yield report
        finally:
            Talk.bar = False


@contextmanager
def lines() -> Iterator[Report]:
    """A Report whose current stage gets a line every LINE_SECONDS: its name, the share done, the seconds since the beginning."""
    begin, over, at_work = time.perf_counter(), threading.Event(), [("", 0.0)]  # stage and share, which change together

    def note(stage, done, total):
        at_work[0] = stage, done / total if total else 0.0

    def talk():
        while not over.wait(LINE_SECONDS):
            stage, share = at_work[0]
            if stage:
                print(_line(stage, share, report.note, time.perf_counter() - begin), file=sys.stderr, flush=True)

    report = Report(note)
    talker = threading.Thread(target=talk, daemon=True)
    talker.start()
    try:
        yield report
    finally:
        over.set()
        talker.join()


def _line(stage, share, note, seconds):
    done = f" {100 * share:.0f} %" if share else ""
    return f"progress: {stage}{done}, {seconds:.0f} s" + (f", {note}" if note else "")
