"""Compiles kernels and caches the compiled code.

Numba renews a cached kernel if its own file changes, but not if a function that it calls in another file does. After an upgrade
or a `git pull` an old decoder could run under a new source tree. So the cache folder of a file's kernels carries a fingerprint of
that file and of its imports from the package; other changes compile nothing again.

Numba does not separate processes either. Two that first compile a kernel for different types at the same moment both number their
file 1, and a later process runs the code for the wrong types. So every kernel's files have a lock, and the types of loaded code
are checked; a file that cannot be read or written costs only a compilation. A second lock is held during a compilation: of
processes that need the kernel at the same moment one compiles, and the others load its result.
"""

import gc
import hashlib
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, partial, update_wrapper
from pathlib import Path
from typing import Any

import numpy as np

PACKAGE = Path(__file__).parents[1]
_DECORATING = threading.RLock()  # numba's setting is one for all threads, some of which import while others compile
_INSTRUCTIONS: list = []  # (name, function) of instruction(), not yet known to numba
IMPORT = re.compile(rb"^[ \t]*from[ \t]+(\.+|texfcodec\b\.?)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]+)", re.MULTILINE)


@lru_cache(maxsize=1024)
def _read(path: Path) -> tuple[str, bytes, tuple[Path, ...]]:
    """Returns (path within the package, hash of the content, package files that it imports, at the top or inside functions)."""
    content, imported = path.read_bytes(), []
    for start, module, names in IMPORT.findall(content):  # by strings: these loops as Paths took 0.1 s of every run
        root = path.parents[len(start) - 1] if start.startswith(b".") else PACKAGE
        place = os.path.join(root, *module.decode().split("."))
        for candidate in (place, *(os.path.join(place, name) for name in re.findall(r"\w+", names.decode()))):
            files = f"{candidate}.py", os.path.join(candidate, "__init__.py")
            imported += [Path(file) for file in files if os.path.isfile(file)]
    return os.path.relpath(path, PACKAGE), hashlib.sha256(content).digest(), tuple(imported)


@lru_cache(maxsize=256)
def fingerprint(path: Path) -> str:
    """Hash of the package's path, a file in it and all package files that the file imports, directly or indirectly: 16
    hexadecimal digits. The path is included because numba does not share kernels between installations either."""
    known, new = set(), {path}
    while new:
        known |= new
        new = {imported for file in new for imported in _read(file)[2]} - known
    total = hashlib.sha256(str(PACKAGE).encode())
    for name, content, _ in sorted(_read(file) for file in known):
        total.update(name.encode() + b"\0" + content)
    return total.hexdigest()[:16]


def _bases():
    """Candidate folders for the cache, best first. None may be writable by others, because cached kernels are code."""
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


def cache_folder(path: Path) -> Path:
    """Folder of a file's compiled kernels, created if it does not exist: named by the fingerprint, in NUMBA_CACHE_DIR, else in
    the user's cache, else beside the sources."""
    for base in _bases():
        folder = base / "texfcodec" / fingerprint(path)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            break
    return folder


class Kernel:
    """A function that numba compiles at its first call, or as a part of another kernel. Until then it does not import numba:
    that takes half a second, which a process that calls no kernel saves."""

    def __init__(self, function: Callable, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self.py_func, self._options, self._ready = function, options, None

    def __call__(self, *arguments: Any) -> Any:
        return (self._ready or self._dispatcher())(*arguments)

    def __getattr__(self, name):
        """Attributes of numba's dispatcher, such as signatures and _numba_type_, by which another kernel calls this one."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._dispatcher(), name)

    def _dispatcher(self):
        with _DECORATING:
            if self._ready is None:
                numba, function, options = _numba(), self.py_func, self._options
                folder = cache_folder(Path(function.__code__.co_filename))
                compiled = _compiled(numba, function, folder, options)
                if not numba.config.DISABLE_JIT:  # numba sets its settings when it is imported
                    _serve_kernels(numba, compiled, function, folder / "plain", options)
                self._ready = compiled
        return self._ready


# Any: Numba's compiled functions have no types, nor does partial() of this one.
def kernel(function: Callable | None = None, allocates: bool = False, **options: Any) -> Any:
    """Decorator: compiles a function without the interpreter's lock and caches it in cache_folder(). options: other keywords of
    numba.njit. Divisions are not checked for zero; the caller ensures that.

    allocates: the kernel creates or returns arrays. Numba then counts references, and each access to a named tuple of arrays is
    an atomic increment. That slowed the level kernels of the transform by half and the sampling of images by a third, so small
    kernels inside a loop allocate nothing.
    """
    if function is None:
        return partial(kernel, allocates=allocates, **options)
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return function
    return Kernel(function, {"_nrt": allocates, "no_cfunc_wrapper": True, **options})


def instruction(name: str) -> Callable[[Callable], Callable]:
    """Return a decorator of a function int64 -> int64. In kernels, the LLVM instruction of this name replaces it, such as ctpop;
    outside, Python runs the function itself."""

    def decorate(function):
        _INSTRUCTIONS.append((name, function))
        return function

    return decorate


def _numba():
    """The module numba, which knows every instruction() so far."""
    import numba

    while _INSTRUCTIONS:
        _register(*_INSTRUCTIONS.pop())
    return numba


def _register(name, function):
    from numba.extending import intrinsic, overload

    @intrinsic
    def llvm_instruction(_, v):
        return v(v), lambda context, builder, signature, values: getattr(builder, name)(values[0])

    @overload(function)
    def in_kernels(v):
        return lambda v: llvm_instruction(np.int64(v))  # type: ignore[call-arg]  # numba gives the first one


def _compiled(numba, function, folder, options):
    with _DECORATING:
        usual = numba.config.CACHE_DIR
        # Read while the decorator runs; other packages keep theirs.
        numba.config.CACHE_DIR = str(folder)
        try:
            dispatcher = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
        finally:
            numba.config.CACHE_DIR = usual
    if not numba.config.DISABLE_JIT:
        _share(dispatcher._cache, folder / f"{function.__name__}.lock")
        compiling = folder / f"{function.__name__}.compiling"
        called = "" if options.get("no_cpython_wrapper") else function.__qualname__
        dispatcher.compile = _once(dispatcher, called, compiling)
    return dispatcher


def _share(cache, lock):
    """Makes numba's cache of a kernel safe to share between processes and robust to damaged files. lock: path of a lock file."""
    from numba.core.runtime import rtsys

    save = cache.save_overload

    def load_ours(sig, target):
        try:
            with _alone(lock):
                rtsys.initialize(target)  # numba also prepares to compile, 0.3 s for a process that only loads
                overload = cache._load_overload(sig, target)
        except Exception:  # whatever unpickling makes of a file that was cut short
            return None
        return overload if overload is not None and overload.signature.args == tuple(getattr(sig, "args", sig)) else None

    def save_ours(sig, overload):
        with suppress(OSError), _alone(lock):  # a full disk: compiled again the next time
            try:
                save(sig, overload)
            except OSError:
                raise
            except Exception:  # the index is no index
                cache.flush()
                save(sig, overload)

    cache.load_overload, cache.save_overload = load_ours, save_ours


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Context manager: one process at a time, if the system locks files."""
    try:
        import fcntl

        file = open(path, "wb")
    except (ImportError, OSError):
        yield
        return
    with file:
        with suppress(OSError):  # a disk without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _serve_kernels(numba, dispatcher, function, folder, options):
    """Makes kernels that call this one compile a plain version of it. dispatcher: numba's, of this kernel. The plain version has
    no wrappers for Python, and it is compiled once for 0, 1 and any other integer; numba would take each constant for a type of
    its own. This shortens a first run by a third."""
    options, unliteral = {"no_cpython_wrapper": True, **options}, numba.types.unliteral
    plain = lru_cache(maxsize=1)(lambda: _compiled(numba, function, folder, options))  # at the first call by a kernel
    dispatcher.get_call_template = lambda args, kws: plain().get_call_template(tuple(unliteral(a) for a in args), kws)
    dispatcher.get_overload = lambda sig: plain().get_overload(sig)


def _once(dispatcher, called, file):
    """Returns dispatcher.compile with the garbage collector off, for one process at a time. The collector scans numba's many
    objects repeatedly, a tenth of a first run, and finds little. called: as in kernel_libraries(); file: the kernel's lock file.
    No kernel calls itself, so processes never wait for each other in a circle."""
    from numba.core.compiler_lock import global_compiler_lock as lock

    from .kernel_library import kernel_libraries

    compiling, compile_one, codegen = False, dispatcher.compile, dispatcher.targetctx.codegen()

    def compiled(signature):
        nonlocal compiling
        with lock:
            if compiling:  # for other types, by a kernel that it calls
                return compile_one(signature)
            collecting, compiling = gc.isenabled(), True
            gc.disable()
            try:
                with _alone(file), kernel_libraries(codegen, called):
                    return compile_one(signature)
            finally:
                compiling = False
                if collecting:
                    gc.enable()

    return compiled
