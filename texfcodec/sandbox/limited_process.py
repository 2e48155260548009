"""Work in a child process with capped memory and time, for files from unknown sources.

The parent starts a module of the package with run_child(), which does its work in within_cap() and leaves its answer in a folder.
"""

import errno
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..core import cleanup
from ..core.integer import _isqrt
from ..errors import LimitError, StreamError, TexfError
from ..limits import Limits

FACTS = "facts.json"
FACTS_BYTES = 64 << 20  # the JSON half of an answer is never larger
NO_CAP = "this system cannot limit the memory of a process; only the time was limited"
STACK_BYTES = 16 << 20
LEAST_BYTES = 16 << 20  # one voxel takes 4 MB; under 2, LLVM and numpy were seen to crash where an allocation is refused
_SQUARE = np.ones((256, 256))
_NO_MEMORY = ("bad_alloc", "allocat", "failed to map", "out of memory", "memoryerror", "can't start new thread")


@contextmanager
def child_folder() -> Iterator[Path]:
    """A temporary folder for a child's answer. Raises LimitError TXF-L15 if the system has none, or starts no child."""
    try:
        with cleanup.Folder("texf-") as folder:
            yield Path(folder)
    except OSError as error:
        raise LimitError("TXF-L15", "a child process cannot be started", reason=error.strerror) from error


def run_child(module: str, data: bytes, request: dict, limits: Limits, folder: Path) -> subprocess.CompletedProcess:
    """Run a module of the package in a child process with limits.isolate_seconds, and return the ended process with its stderr.

    data: sent to its stdin; request: JSON-ready, its second argument; folder: for its answer, its first argument. Raises
    LimitError TXF-L08 if it takes too long.
    """
    package = str(Path(__file__).parent.parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))}
    environment |= {"MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # each takes address space
    command = [sys.executable, "-P", "-m", module, str(folder), json.dumps(request)]  # -P: nothing from the working folder
    try:
        return cleanup.run_child(command, data, limits.isolate_seconds, environment)
    except subprocess.TimeoutExpired:
        raise LimitError("TXF-L08", "decoding took longer than the limit allows", allowed=limits.isolate_seconds) from None


def read_facts(folder: Path) -> dict:
    """Return the facts that a child has left in its folder as JSON. Raises OSError, ValueError if there are none."""
    if (folder / FACTS).stat().st_size > FACTS_BYTES:
        raise ValueError("too long")
    return json.loads((folder / FACTS).read_bytes())


def crash_of(child: subprocess.CompletedProcess, limits: Limits) -> TexfError:
    """Return the error for a child that ended without an answer: TXF-L07 if it lacked memory, else StreamError TXF-S40."""
    said = child.stderr.decode("utf-8", "replace")[-2000:].lower()
    if any(word in said for word in _NO_MEMORY) or child.returncode == -9:  # SIGKILL: the system ran short
        return memory_error(limits)
    return StreamError("TXF-S40", "the decoder crashed on this stream", status=child.returncode)


def memory_error(limits: Limits) -> LimitError:
    """Return LimitError TXF-L07, for a child that needs more memory than limits.isolate_bytes."""
    return LimitError("TXF-L07", "decoding needs more memory than the limit allows", allowed=limits.isolate_bytes)


Result = TypeVar("Result")


def within_cap(limits: Limits, work: Callable[[], Result]) -> tuple[Result, bool]:
    """Call work() with this process's memory capped by limits.isolate_bytes. Return (its result, whether a cap was possible).

    Native code without memory may crash instead of raising an error. So everything but the work itself is loaded before the cap:
    a stack that need not grow, Draco, the buffers of matrix products, the parts that numba loads at its first call; the caller
    imports its modules. Raises the errors of work(); LimitError TXF-L07 if memory is the cause.
    """
    if limits.isolate_bytes is not None and limits.isolate_bytes < LEAST_BYTES:
        raise memory_error(limits)
    usual = threading.stack_size(STACK_BYTES)
    try:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(_capped, limits, work).result()
    except Exception as error:
        unread = isinstance(error, ImportError | SyntaxError)  # a module of an installation that worked before
        if is_memory(error) or (unread and limits.isolate_bytes is not None):
            raise memory_error(limits) from error
        raise
    finally:
        threading.stack_size(usual)


def _capped(limits, work):
    import DracoPy  # noqa: F401

    np.dot(_SQUARE, _SQUARE)
    _isqrt(np.int64(2))
    capped = cap_memory(limits.isolate_bytes)
    return work(), capped


def cap_memory(size: int | None) -> bool:
    """Cap this process's address space at its present size plus size bytes, None for no cap. Return whether this was
    possible."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if size is not None:
            with open("/proc/self/statm") as file:
                present = int(file.read().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (present + size, present + size))
    except (ImportError, OSError, ValueError):
        return size is None
    return True


def is_memory(error: BaseException | None) -> bool:
    """Return whether an error, or one that led to it, is a lack of memory; libraries wrap such errors in their own."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if any(word in str(error).lower() for word in _NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
