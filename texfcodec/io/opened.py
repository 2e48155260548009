"""Which files a load has opened, and their sizes: no output may replace one of them, and a stream is compared with its source."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_OPENED: ContextVar[dict[str, int] | None] = ContextVar("opened", default=None)


@contextmanager
def recording() -> Iterator[dict[str, int]]:
    """Gives a dict that fills with what opened() is told in the block: {path as text: bytes}, in the order of opening."""
    files: dict[str, int] = {}
    token = _OPENED.set(files)
    try:
        yield files
    finally:
        _OPENED.reset(token)


def opened(path: Path) -> None:
    """Every reader says of every file, a Path, that it reads it."""
    files = _OPENED.get()
    if files is not None and str(path) not in files:
        try:
            files[str(path)] = path.stat().st_size
        except OSError:  # the reader will say so
            files[str(path)] = 0
