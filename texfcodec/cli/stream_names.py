"""Names of the streams of a batch: unique, and never changed once given.

The rule: chair.glb becomes chair.texf, or chair.glb if scenes are kept. If several assets would get the same name, each takes
its whole name, chair.glb.texf and chair.stl.texf. If these differ in case alone, or come from different folders, six digits of a
hash follow, as in chair.glb~1f3a5c.texf. An asset that has a stream already keeps its name, whatever is added to the catalogue
later.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    from .catalogue import Asset

SUFFIX, SCENE = ".texf", ".glb"  # of a stream, and of a scene whose meshes are in streams
_WITH_SCENES = (".glb", ".gltf")


def short_name(name: Path, suffix: str = SUFFIX) -> str:
    """Return the usual name of an asset's stream: the path of its mesh file in the catalogue with another suffix. suffix: SCENE
    for the scene of a glTF; other formats have no scene and get SUFFIX."""
    return _short_stem(name) + (suffix if name.suffix.lower() in _WITH_SCENES else SUFFIX)


def _short_stem(name):
    return _inside(name).with_suffix("").as_posix()


def _whole_stem(name):
    return _inside(name).as_posix()


def _marked_stem(name):
    digest = hashlib.sha256(name.as_posix().encode("utf-8", "surrogateescape")).hexdigest()
    return f"{_inside(name).as_posix()}~{digest[:6]}"


def _inside(path):
    """The path below the folder for results; an asset from elsewhere keeps its own name alone."""
    return Path(path.name) if path.is_absolute() or ".." in path.parts else path


_FORMS: tuple[Callable[[Path], str], ...] = (_short_stem, _whole_stem, _marked_stem)


def given_names(results: Path) -> dict[str, str]:
    """Return {name of an asset: name of its stream} for the assets with a stream in a results.jsonl, which may not exist."""
    names: dict[str, str] = {}
    with contextlib.suppress(OSError), open(results, "rb") as file:
        for line in file:
            with contextlib.suppress(ValueError, KeyError, TypeError):
                row = json.loads(line)
                if "stream" in row:
                    names[row["asset"]] = row["out"]
    return names


def with_own_names(assets: list[Asset], given: dict[str, str]) -> list[Asset]:
    """Return the assets, each with a unique name of its stream in out, even on systems that ignore letter case.

    Assets that no rule distinguishes, such as the same file twice, get error TXF-O16. given: names of an earlier run, as
    given_names() returns them, which are kept, as are names that a manifest chose.
    """
    form = [0] * len(assets)
    for number, asset in enumerate(assets):
        if not asset.is_named and asset.error is None:
            before = os.path.splitext(given.get(asset.name, ""))[0]
            known = [f for f, stem in enumerate(_FORMS) if stem(Path(asset.name)) == before]
            form[number] = -1 - known[0] if known else 0
    for _ in range(2 * len(_FORMS)):
        for group in _clashing(assets, form):
            movable = [number for number in group if 0 <= form[number] < len(_FORMS) - 1 and not assets[number].is_named]
            shortest = min((form[number] for number in movable), default=0)
            for number in movable:
                form[number] += form[number] == shortest
    clashing = {number for group in _clashing(assets, form) for number in group}
    return [replace(asset, out=_out(asset, form[number]), error=_error(asset) if number in clashing else asset.error)
            for number, asset in enumerate(assets)]


def _clashing(assets, form):
    """Groups of the numbers of assets whose streams would have the same name."""
    groups: dict[str, list[int]] = {}
    for number, asset in enumerate(assets):
        if asset.error is None:
            groups.setdefault(_key(_out(asset, form[number])), []).append(number)
    return [group for group in groups.values() if len(group) > 1]


def _key(name):
    """A key that names share if a file system ignores letter case and Unicode forms."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _out(asset, form):
    """The stream's name in a form; a form below 0 is the name that was given before."""
    if asset.is_named or asset.error is not None:
        return asset.out
    return _FORMS[form if form >= 0 else -1 - form](Path(asset.name)) + os.path.splitext(asset.out)[1]


def _error(asset):
    return InputError("TXF-O16", "another asset of the batch has the same output name", value=asset.out)
