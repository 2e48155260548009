"""Compilation of kernels, and where the compiled code is kept.

Numba renews a cached kernel when its own file changes, not when a function it calls in another file does: after an upgrade or a
`git pull` an old decoder could run under a new source tree. So the cache folder of a file's kernels carries a fingerprint of that
file and of all that it imports from the package; a change elsewhere compiles nothing again.
"""

import hashlib
import os
import re
import sys
from functools import lru_cache, partial
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
IMPORT = re.compile(rb"^[ \t]*from[ \t]+(\.+|texfcodec\b\.?)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]+)", re.MULTILINE)


def _imported(path):
    """Files of the package that a file imports from, at the top or inside functions."""
    for start, module, names in IMPORT.findall(path.read_bytes()):
        root = path.parents[len(start) - 1] if start.startswith(b".") else PACKAGE
        place = root.joinpath(*module.decode().split("."))
        for candidate in (place, *(place / name for name in re.findall(r"\w+", names.decode()))):
            for file in (candidate.with_suffix(".py"), candidate / "__init__.py"):
                if file.is_file():
                    yield file


@lru_cache(maxsize=256)
def fingerprint(path):
    """Hash over the place of the package, a file of it and all that the file imports from there, straight or through others: 16
    hexadecimal digits. The place counts because numba does not share kernels between installations either."""
    known, new = set(), {path}
    while new:
        known |= new
        new = {file for one in new for file in _imported(one)} - known
    total = hashlib.sha256(str(PACKAGE).encode())
    for file in sorted(known):
        total.update(os.path.relpath(file, PACKAGE).encode() + b"\0" + file.read_bytes() + b"\0")
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


def cache_folder(path):
    """Where the compiled kernels of a file are kept: a folder of this state of it in NUMBA_CACHE_DIR, else in the user's cache,
    else beside the sources; made where it is not there yet."""
    for base in _bases():
        folder = base / "texfcodec" / fingerprint(path)
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

    usual, options = numba.config.CACHE_DIR, {"nogil": True, "error_model": "numpy", **options}
    # Read while the decorator runs; other packages keep theirs.
    numba.config.CACHE_DIR = str(cache_folder(Path(function.__code__.co_filename)))
    try:
        made = numba.njit(cache=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = usual
    if not numba.config.DISABLE_JIT:
        _serve_kernels(numba, made, function, options)
    return made


def _serve_kernels(numba, made, function, options):
    """Makes other kernels that call `made` compile a plain version of it: without the two wrappers for Python, not cached, as it
    becomes part of their code, and once for 0, 1 and any other integer, where numba takes each constant for a type of its own.
    First use is a third shorter for it."""
    plain, unliteral = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function), numba.types.unliteral
    made.get_call_template = lambda args, kws: plain.get_call_template(tuple(unliteral(a) for a in args), kws)
    made.get_overload = plain.get_overload
