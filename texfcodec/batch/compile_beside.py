"""Kernels of a first run, compiled by a second process beside it."""

import subprocess
from contextlib import suppress
from threading import Thread

from ..options import default_threads
from ..precompile import STAGES, kernels_compiled
from .children import Caps, Children


def compile_beside(threads: int, *stages: str) -> None:
    """Has another process compile what a first run needs later on, while this one loads, works and compiles what it needs first;
    what one of them has compiled the other loads. threads: that may run at once; nothing is done for one; stages: of
    precompile.STAGES, whose kernels are looked for in the cache first. The process ends with this one, if not before."""
    missing = [stage for stage in stages if not kernels_compiled(STAGES[stage].entries)]
    if missing and min(threads, default_threads()) > 1:
        Thread(target=_compile, args=missing, daemon=True).start()


def _compile(*stages):
    with suppress(OSError):  # no process to be had: all is compiled here
        Children().run(("-m", "texfcodec.precompile", *stages), subprocess.DEVNULL, subprocess.DEVNULL, Caps(1))
