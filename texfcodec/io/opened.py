"""Files that a load has opened, and their sizes: no output may replace them, and a stream's size is compared with theirs."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_OPENED: ContextVar[dict[str, int] | None] = ContextVar("opened", default=None)


@contextmanager
def recording() -> Iterator[dict[str, int]]:
    """Yields {path as text: bytes} of the files that are opened in the block, in order; opened() fills it."""
    files: dict[str, int] = {}
    token = _OPENED.set(files)
    try:
        yield files
    finally:
        _OPENED.reset(token)


def opened(path: Path) -> None:
    """Record the path and size of an input file in recording(); every reader calls this for every file that it opens."""
    files = _OPENED.get()
    if files is not None and str(path) not in files:
        try:
            files[str(path)] = path.stat().st_size
        except OSError:  # the reader will say so
            files[str(path)] = 0
