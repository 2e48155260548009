"""Compilation of kernels, and where the compiled code is kept.

Numba renews a cached kernel when its own file changes, not when a function it calls in another file does: after an upgrade or a
`git pull` an old decoder could run under a new source tree. So the cache folder carries a fingerprint of the whole package.
"""

import hashlib
import os
import sys
from functools import lru_cache, partial
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


@lru_cache(maxsize=1)
def fingerprint():
    """Hash over the place and every source file of the package, 16 hexadecimal digits; takes a few milliseconds. The place
    counts because numba does not share kernels between installations either."""
    total = hashlib.sha256(str(PACKAGE).encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        total.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def _bases():
    """Places for the cache, best first. None of them may be writable by others: cached kernels are code."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        yield Path(given)
    users = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    if users:
        yield Path(users)
    try:
        yield Path.home() / ".cache"
    except RuntimeError:  # no home directory
        pass
    yield PACKAGE / "__pycache__"


def cache_folder():
    """Where compiled kernels are kept: a folder of this state of the package in NUMBA_CACHE_DIR, else in the user's cache, else
    beside the sources; made where it is not there yet."""
    for base in _bases():
        folder = base / "texfcodec" / fingerprint()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            break
    return folder


def kernel(function=None, **options):
    """Decorator: compiled without the interpreter's lock and cached in cache_folder(). options: further ones of numba.njit.
    Divisions are not checked for zero: whoever divides makes sure."""
    if function is None:
        return partial(kernel, **options)
    import numba

    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())  # read while the decorator runs; other packages keep theirs
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    finally:
        numba.config.CACHE_DIR = usual
