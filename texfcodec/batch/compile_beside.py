"""Compilation of a first run's kernels by a second process beside it."""

import subprocess
from contextlib import suppress
from threading import Thread

from ..options import default_threads
from ..precompile import STAGES, kernels_compiled
from .children import Caps, Children


def compile_beside(threads: int, *stages: str) -> None:
    """Start a process that compiles the kernels that a first run needs last; this process loads, works and compiles the first.

    Each process loads from the cache what the other has compiled. threads: of this run; with a single thread no process starts;
    stages: keys of precompile.STAGES; those whose kernels are cached are left out. The process ends at the latest with this one.
    """
    missing = [stage for stage in stages if not kernels_compiled(STAGES[stage].entries)]
    if missing and min(threads, default_threads()) > 1:
        Thread(target=_compile, args=missing, daemon=True).start()


def _compile(*stages):
    with suppress(OSError):  # no process to be had: all is compiled here
        Children().run(("-m", "texfcodec.precompile", *stages), subprocess.DEVNULL, subprocess.DEVNULL, Caps(1))
