"""Progress of many tasks: a bar with the time left if stderr is a terminal, else a line for each."""

import itertools
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(total: int) -> Iterator[Callable[[str, str, bool], None]]:
    """Context manager: give show(name, line, is_bad), which displays the end of one of `total` tasks. On a terminal it moves a
    bar, and only bad tasks get a line."""
    ended = itertools.count(1)
    if not sys.stderr.isatty():
        yield lambda name, line, is_bad: print(f"[{next(ended)}/{total}] {line}", file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description:32}", markup=False), BarColumn(24), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=1e9) as bar:
        task = bar.add_task("", total=total)

        def show(name, line, is_bad):
            if is_bad:
                bar.console.print(line, markup=False, highlight=False)
            bar.update(task, advance=1, description=name)

        yield show
