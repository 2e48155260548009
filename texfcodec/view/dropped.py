"""What somebody drops on the page: a stream or a GLB, from wherever it came. Both are read in a child process with capped memory
and time, a stream by isolate.py, whose answer is checked again, a mesh here, whose answer only the page reads."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict, replace
from pathlib import Path

from .. import errors
from ..api import decode
from ..capped import FACTS, child_folder, crash_of, read_facts, run_child, within_cap
from ..errors import InputError, StreamError, TexfError
from ..ground.json_text import json_text
from ..limits import Limits
from ..options import DecodeOptions

GLB_MAGIC = b"glTF"
CONTAINER = "container"


def container_of_dropped(data: bytes, name: str, options: DecodeOptions | None = None) -> bytes:
    """The container (view.pack) of the bytes of a .texf or .glb file; name: what the page calls it. Raises TexfError."""
    from .pack import pack

    options = options or DecodeOptions()
    if not data:
        raise InputError("TXF-I04", "the file is empty", path=name)
    if data.startswith(GLB_MAGIC):
        return _mesh(data, name, options.limits)
    return pack(decode(data, replace(options, isolate=True)), name, len(data))


def _mesh(data, name, limits):
    with child_folder() as folder:
        child = run_child(__name__, data, {"name": name, "limits": asdict(limits)}, limits, folder)
        try:
            facts = read_facts(folder)
            if facts is None:
                return (folder / CONTAINER).read_bytes()
            family = {kind.__name__: kind for kind in (InputError, StreamError, errors.LimitError, errors.SupportError)}
            error = family[facts["family"]](str(facts["code"]), str(facts["message"]), **facts["details"])
        except (OSError, ValueError, KeyError, TypeError):
            raise crash_of(child, limits) from None
    raise error


def _child(folder, request):
    """The child's side: reads a GLB on stdin and leaves its container in the folder, or what is wrong with it."""
    import PIL.Image  # noqa: F401  what it needs is imported before the cap

    from ..asset.load import gltf_read  # noqa: F401
    from . import pack  # noqa: F401

    limits, data, facts = Limits(**request["limits"]), sys.stdin.buffer.read(), None
    os.chdir(folder)  # where no file is that the mesh could name
    try:
        within_cap(limits, lambda: (folder / CONTAINER).write_bytes(_packed(data, request["name"])))
    except TexfError as error:
        facts = {"family": type(error).__name__, "code": error.code, "message": error.message, "details": error.details}
    (folder / FACTS).write_text(json_text(facts), encoding="utf-8")


def _packed(data, name):
    from ..asset.load.files import load_glb
    from .pack import pack

    scene = load_glb(data)
    if set(scene.files) != {"-"}:
        raise InputError("TXF-I16", "a mesh that is dropped must hold all of its images: it may not name files of this machine")
    return pack(scene, name, len(data))


if __name__ == "__main__":
    _child(Path(sys.argv[1]), json.loads(sys.argv[2]))
