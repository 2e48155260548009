"""Which files a load has opened, and their sizes: no output may replace one of them, and a stream is compared with its source."""

from contextlib import contextmanager
from contextvars import ContextVar

_OPENED = ContextVar("opened", default=None)


@contextmanager
def recording():
    """Gives a dict that fills with what opened() is told in the block: {path as text: bytes}, in the order of opening."""
    files = {}
    token = _OPENED.set(files)
    try:
        yield files
    finally:
        _OPENED.reset(token)


def opened(path):
    """Every reader says of every file, a Path, that it reads it."""
    files = _OPENED.get()
    if files is not None and str(path) not in files:
        try:
            files[str(path)] = path.stat().st_size
        except OSError:  # the reader will say so
            files[str(path)] = 0
