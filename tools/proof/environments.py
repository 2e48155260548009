"""Virtual environments with other versions of Python, numba and numpy, made when they are asked for."""

import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
VARIED = ("numba", "numpy")  # what environments differ in, beside Python; everything else is held at the version in use here
MADE = "made"  # the file that a finished environment holds


class NotMade(Exception):
    """An environment cannot be had; the message says why, in a few words."""


@dataclass(frozen=True)
class Environment:
    """python: "3.12"; pins: requirements of what is varied, none for the newest that fit."""

    python: str
    pins: tuple[str, ...] = ()

    @property
    def folder(self):
        """A name for it."""
        return re.sub(r"[^\w.]+", "_", "-".join([f"python{self.python}", *self.pins])).strip("_.")


def interpreter_of(version, given=()):
    """An interpreter of a version, "3.12": of the given ones, this one, or the one on PATH. Raises NotMade."""
    for program in (*given, sys.executable, shutil.which(f"python{version}")):
        if program and _version_of(program) == version:
            return program
    raise NotMade(f"no Python {version} was found")


def _version_of(program):
    words = [program, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    try:
        return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def requirements(pins):
    """What the package and the demo asset need, as words for pip: pins first, the versions in use here of what they do not name.
    scipy comes with scikit-image, and brings an OpenBLAS that tools/proof/determinism_child.py looks at."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["demo"], "scipy"]
    names = [re.match(r"[\w.-]+", text).group() for text in asked]
    pinned = {re.match(r"[\w.-]+", pin).group() for pin in pins}
    held = [f"{name}=={importlib.metadata.version(name)}" for name in names if name not in VARIED]
    return [*pins, *(text for name, text in zip(names, asked, strict=True) if name in VARIED and name not in pinned), *held]


def python_of(environment, top, make, given=()):
    """The interpreter of an environment below the folder top; made first where make allows it. Raises NotMade."""
    folder = top / environment.folder
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    if (folder / MADE).exists():
        return python
    if not make:
        raise NotMade("its environment is made by --environments only")
    interpreter = interpreter_of(environment.python, given)
    shutil.rmtree(folder, ignore_errors=True)
    _call([interpreter, "-m", "venv", str(folder)])
    _call([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile",
           *requirements(environment.pins)])
    (folder / MADE).touch()
    return python


def _call(words):
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    if run.returncode:
        said = [line for line in run.stderr.splitlines() if line.startswith("ERROR:")] or run.stderr.splitlines() or ["no word"]
        raise NotMade(f"{words[2]} fails: {said[0].removeprefix('ERROR: ')[:160]}")
