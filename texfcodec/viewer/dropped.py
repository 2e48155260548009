"""A mesh that somebody drops on the page, in any format that is read, from wherever it came: read in a child process with capped
memory and time, whose answer, a GLB, only the page reads."""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from .. import errors
from ..core.json_text import json_text
from ..errors import InputError, StreamError, TexfError
from ..io.formats import SUFFIXES, format_of
from ..io.magic import what_it_is
from ..limits import Limits
from ..sandbox.limited_process import FACTS, child_folder, crash_of, read_facts, run_child, within_cap

GLB_MAGIC = b"glTF"
CONVERTED = "mesh.glb"
MISSING = "missing"  # in what is said of a file that a mesh names
ALONE = "a dropped file arrives without the files that it names; open it with texf-view instead"


def glb_of_dropped(data: bytes, name: str, limits: Limits | None = None) -> bytes:
    """Convert a mesh that the user drops on the page to the bytes of a GLB, in a child process with capped memory and time.

    data: bytes of the mesh file; name: its name on the page, whose suffix gives the format unless data is a GLB. Raises
    TexfError.
    """
    if not data:
        raise InputError("TXF-I04", "the file is empty", path=name)
    suffix = Path(name).suffix.lower()
    if data.startswith(GLB_MAGIC) or format_of(suffix):
        return _mesh(data, name, limits or Limits())
    raise InputError("TXF-I05", f"{suffix or name} is not a supported format; choose .texf {' '.join(SUFFIXES)}",
                     looks_like=what_it_is(data) or None)


def _mesh(data, name, limits):
    with child_folder() as folder:
        child = run_child(__name__, data, {"name": name, "limits": asdict(limits)}, limits, folder)
        try:
            facts = read_facts(folder)
            if facts is None:
                return (folder / CONVERTED).read_bytes()
            family = {kind.__name__: kind for kind in (InputError, StreamError, errors.LimitError, errors.SupportError)}
            error = family[facts["family"]](str(facts["code"]), str(facts["message"]), **facts["details"])
        except (OSError, ValueError, KeyError, TypeError):
            raise crash_of(child, limits) from None
    raise error


def _child(folder, request):
    """The child's side: reads a mesh on stdin and leaves its GLB in the folder, or what is wrong with it."""
    import PIL.Image  # noqa: F401  what it needs is imported before the cap

    from . import glb  # noqa: F401

    limits, data, facts = Limits(**request["limits"]), sys.stdin.buffer.read(), None
    entry = _format_of(data, request["name"])
    with suppress(ImportError):  # the reader says what is missing
        import_module(entry.package or "json")
        import_module(f"texfcodec.io.{entry.module}")
    os.chdir(folder)  # where no file is that the mesh could name
    try:
        within_cap(limits, lambda: (folder / CONVERTED).write_bytes(_converted(data, request["name"])))
    except TexfError as error:
        facts = {"family": type(error).__name__, "code": error.code, "message": error.message, "details": error.details}
    (folder / FACTS).write_text(json_text(facts), encoding="utf-8")


def _format_of(data, name):
    """Format of a dropped mesh: that of its first bytes where it is a GLB, else of its name."""
    return format_of(".glb" if data.startswith(GLB_MAGIC) else Path(name).suffix.lower())


def _converted(data, name):
    from ..io.load import load
    from .glb import glb_of_scene

    file, entry = io.BytesIO(data), _format_of(data, name)
    file.name = f"dropped{entry.suffix}"  # never the name itself, which could lead into another folder
    try:
        scene = load(file)
    except InputError as error:
        if MISSING not in error.message:
            raise
        raise InputError(error.code, f"{error.message}; {ALONE}", **error.details) from error
    if set(scene.files) != {file.name}:
        raise InputError("TXF-I16", "a dropped mesh must contain all its images; it may not name files of this machine")
    if any(MISSING in warning for warning in scene.warnings):
        scene.warnings.append(ALONE)
    return glb_of_scene(scene)


if __name__ == "__main__":
    _child(Path(sys.argv[1]), json.loads(sys.argv[2]))
