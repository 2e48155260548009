"""Side files that belong to an earlier output at the same path: that file names them, and this program wrote both."""

import json
from pathlib import Path
from urllib.parse import unquote

_MARK = b"# texfcodec"  # OBJ and MTL begin with it
_MOST = 1 << 26  # bytes of a .gltf or .mtl that are read


def own_sides(path: Path) -> frozenset[str]:
    """Return the names of the side files of an OBJ or .gltf that texfcodec wrote at path; none if it wrote no such file there."""
    try:
        names = list({".obj": _of_obj, ".gltf": _of_gltf}.get(path.suffix.lower(), _none)(path))
    except (OSError, ValueError, LookupError, AttributeError, TypeError, RecursionError):  # no such file, or not as ours are
        return frozenset()
    return frozenset(name for name in names if name == Path(name).name)


def _none(_):
    return ()


def _of_obj(path):
    with open(path, "rb") as file:
        if file.readline(100).strip() != _MARK:
            return
        words = file.readline(4096).decode().split()
    if len(words) != 2 or words[0] != "mtllib" or words[1] != Path(words[1]).name:
        return
    with open(path.parent / words[1], "rb") as file:
        text = file.read(_MOST)
    if text.startswith(_MARK):
        yield words[1]
        yield from (line.split()[-1] for line in text.decode().splitlines() if line.startswith(("map_Kd ", "map_d ")))


def _of_gltf(path):
    with open(path, "rb") as file:
        document = json.loads(file.read(_MOST))
    if document["asset"].get("generator") == "texfcodec":
        for kind in ("images", "buffers"):
            yield from (unquote(item["uri"]) for item in document.get(kind, ()) if isinstance(item.get("uri"), str))
