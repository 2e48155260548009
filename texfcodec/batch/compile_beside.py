"""Kernels of a first run, compiled by a second process beside it."""

import subprocess
from contextlib import suppress
from threading import Thread

from ..options import default_threads
from ..precompile import kernels_compiled
from .children import Caps, Children


def compile_beside(threads: int, *more: str) -> None:
    """Has another process compile what a first encode needs later on, while this one loads, codes and compiles what it needs
    first; what one of them has compiled the other loads. threads: that may run at once; nothing is done for one; more: words
    for precompile.py. The process ends with this one, if not before."""
    if min(threads, default_threads()) > 1 and not kernels_compiled():
        Thread(target=_compile, args=more, daemon=True).start()


def _compile(*more):
    with suppress(OSError):  # no process to be had: all is compiled here
        Children().run(("-m", "texfcodec.precompile", *more), subprocess.DEVNULL, subprocess.DEVNULL, Caps(1))
