"""Child processes that run Python: started, awaited, capped in time and memory, and stopped together."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ..core import cleanup

ROOT = Path(__file__).resolve().parents[2]  # where the package is imported from
WARM_UP = ("-m", "texfcodec.cli.enc", "--warmup")  # compiles the kernels
SLOWING = ("MALLOC_TRIM_THRESHOLD_",)  # Dask sets it for its workers; in a child it doubles the time in the system
POLL_SECONDS = 0.25  # how long a child may outlive the wish to stop it


class Overdue(Exception):
    """A child exceeded its time."""


@dataclass(frozen=True)
class Caps:
    """Limits of a child.

    threads: of OpenMP and BLAS; memory: bytes of data, None for no cap; end: time.monotonic() at which it is killed, None for
    never.
    """

    threads: int
    memory: int | None = None
    end: float | None = None


class Children:
    """Child processes that are running. unwanted: function, called now and then while a child runs; True stops all of them."""

    def __init__(self, unwanted: Callable[[], bool] = lambda: False) -> None:
        self._lock, self._unwanted = threading.Lock(), unwanted
        self._alive: set[subprocess.Popen] = set()
        self.stopped = False

    def run(self, words: Sequence[str], out: BinaryIO | int, log: BinaryIO | int, caps: Caps) -> int | None:
        """Run Python with arguments in a child process, wait for its end, and return its exit code; None if it was stopped.

        words: arguments of Python; out, log: where its stdout and stderr go, as in subprocess. Raises Overdue at caps.end, and
        OSError if no process can be started. The child ends with this process.
        """
        names = {f"{name}_NUM_THREADS": str(caps.threads) for name in ("OMP", "OPENBLAS", "MKL")}
        paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        inherited = {name: value for name, value in os.environ.items() if name not in SLOWING}
        command = [sys.executable, "-m", f"{__package__}.child", str(caps.memory or 0), *words]
        with self._lock:
            if self.stopped:
                return None
            child = cleanup.hold(lambda: _Group(command, stdin=subprocess.PIPE, stdout=out, stderr=log,
                                                   start_new_session=True, env={**inherited, **names, "PYTHONPATH": paths}))
            self._alive.add(child)
        try:
            return self._wait(child, caps.end)
        except BaseException as error:
            child.kill() if isinstance(error, Overdue) else self.stop()
            child.wait()
            raise
        finally:
            child.hang_up()
            with self._lock:
                self._alive.discard(child)
            cleanup.drop(child)

    def _wait(self, child, end):
        while True:
            left = POLL_SECONDS if end is None else min(POLL_SECONDS, max(end - time.monotonic(), 0))
            try:
                return child.wait(left)
            except subprocess.TimeoutExpired:
                pass
            if self._unwanted():
                self.stop()
            if end is not None and time.monotonic() >= end:
                raise Overdue from None

    def stop(self) -> None:
        """Kills them all with their own children, and prevents new ones."""
        with self._lock:
            self.stopped = True
            for child in self._alive:
                child.kill()


class _Group(subprocess.Popen):
    """A process that leads a group of its own, which is killed with it."""

    def hang_up(self) -> None:
        if self.stdin is not None:
            self.stdin.close()

    def kill(self) -> None:
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended since: no reason to spare others
                os.killpg(self.pid, signal.SIGKILL) if hasattr(os, "killpg") else super().kill()
