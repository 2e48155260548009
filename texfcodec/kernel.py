"""Compilation of kernels, and where the compiled code is kept.

Numba renews a cached kernel when its own file changes, not when a function it calls in another file does: after an upgrade or a
`git pull` an old decoder could run under a new source tree. So the cache folder carries a fingerprint of the whole package.
"""

import hashlib
import os
import sys
from functools import lru_cache, partial
from pathlib import Path

PACKAGE = Path(__file__).parent


@lru_cache(maxsize=1)
def fingerprint():
    """Hash over every source file of the package, 16 hexadecimal digits; takes a few milliseconds."""
    total = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        total.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def cache_folder():
    """Where compiled kernels are kept: a folder of this state of the package in NUMBA_CACHE_DIR, else in the user's cache."""
    base = os.environ.get("NUMBA_CACHE_DIR")
    if not base:
        home = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
        try:
            base = Path(home) if home else Path.home() / ".cache"
        except RuntimeError:  # no home directory
            base = PACKAGE / "__pycache__"  # never a folder that others may write to: cached kernels are code
    return Path(base) / "texfcodec" / fingerprint()


def kernel(function=None, **options):
    """Decorator: compiled without the interpreter's lock and cached in cache_folder(). options: further ones of numba.njit."""
    if function is None:
        return partial(kernel, **options)
    import numba

    usual = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())  # read while the decorator runs; other packages keep theirs
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = usual
