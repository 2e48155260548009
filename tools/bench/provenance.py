"""Where a page's figures come from: the machine, and the state of the code."""

import platform
import subprocess
from pathlib import Path

from texfcodec.options import default_threads
from tools.bench.jobs import REPOSITORY

# What figures depend on
SOURCES = ("texfcodec", "tools/bench/*.py", "tools/proof/*.py", "conformance/reference", "tests/oracles", "tests/fuzz",
           "tests/load")


def made_on(root=REPOSITORY):
    """Return the words after "Made by ..." on a page: the machine and the commit of a checkout."""
    return f"on {machine()}, commit {state_of(root)}"


def machine():
    """The processor of this machine and how many of it may be used, in words."""
    try:
        names = [line.partition(":")[2].strip() for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
                 if line.startswith("model name")]
    except OSError:
        names = []
    return f"{default_threads()} cores of {names[0] if names else platform.machine()}"


def commit_of(root):
    """Return the short hash of a checkout's commit."""
    return _git(root, "rev-parse", "--short=8", "HEAD")


def state_of(root, sources=SOURCES):
    """Return a checkout's commit in words, with the last one that changed the package, so that pages of the same codec can be
    seen to be so, and whether sources have uncommitted changes; "unknown" outside a checkout, such as in an sdist."""
    try:
        changed = _git(root, "status", "--porcelain", "--untracked-files=no", "--", *sources)
        package = _git(root, "log", "-1", "--format=%h", "--abbrev=8", "--", "texfcodec")
        return f"{commit_of(root)} (texfcodec of {package})" + (" **with changes that it does not have**" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(root, *words):
    words = ["git", "--no-optional-locks", "-C", root, *words]
    return subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True).stdout.strip()
