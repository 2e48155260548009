"""Tilesets (3D Tiles 1.1) of texf-enc --batch: their glTF contents are assets, all other files are copied.

The JSON stays as it is, but for the URIs of contents whose suffix changes: tile.gltf becomes tile.glb.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlsplit

from ..batch.folders import LOCK, WORK
from ..core import cleanup
from ..core.json_text import json_text
from ..errors import InputError
from ..report import plural
from .catalogue import RESULTS, Asset
from .stream_names import SCENE

SUFFIX = ".json"
_SCENES = (".glb", ".gltf")
_URI = re.compile(r'("ur[il]"\s*:\s*)("(?:[^"\\]|\\.)*")')
_MOST_FILES = 1_000_000  # tilesets that refer to each other, and contents


class Tileset:
    """A tileset and those that its tiles refer to. assets: its glTF contents, as a catalogue has them; folder: that of its file,
    to which all names are relative; remarks: contents that are not taken, by kind."""

    def __init__(self, source: Path, note: Callable[[str], object]) -> None:
        self.folder, self._note = source.absolute().parent, note
        self._real = self.folder.resolve()
        self._texts: dict[str, str] = {}
        self._remarks: dict[str, list[str]] = {}
        self._contents: dict[str, InputError | None] = {}
        waiting = deque([source.name])
        while waiting:
            name = waiting.popleft()
            if name in self._texts:
                continue
            for uri, tile in self._read(name):
                self._add(name, uri, tile, waiting)
            if len(self._texts) + len(self._contents) > _MOST_FILES:
                raise self._wrong(f"there are more than {_MOST_FILES} files", name)
        self.assets = [Asset(name, self.folder / name, self._out(name, error), error=error, is_named=True)
                       for name, error in sorted(self._contents.items())]
        for kind, names in sorted(self._remarks.items()):
            note(f"{plural(len(names), 'content is', 'contents are')} copied unchanged ({kind}): {names[0]}")
        if not self.assets:
            raise self._wrong("it has no glTF content", source.name)

    def _read(self, name):
        """[(URI, tile)] of all contents of a tileset."""
        try:
            self._texts[name] = (self.folder / name).read_text(encoding="utf-8-sig")
            root = json.loads(self._texts[name])
        except FileNotFoundError:
            raise InputError("TXF-I01", "the file does not exist", path=str(self.folder / name)) from None
        except OSError as error:
            raise InputError("TXF-I03", "the file cannot be read", path=str(self.folder / name), reason=error.strerror) from None
        except (ValueError, RecursionError) as error:
            raise self._wrong(f"it is not JSON: {error}", name) from None
        try:
            return [(content.get("uri", content.get("url")), tile) for tile in _tiles(root["root"])
                    for content in (tile.get("contents") or [tile.get("content")]) if content is not None]
        except (TypeError, KeyError, AttributeError):
            raise self._wrong("its tiles are not those of 3D Tiles", name) from None

    def _add(self, home, uri, tile, waiting):
        if not isinstance(uri, str):
            raise self._wrong("a content has no URI", home)
        if uri.startswith("data:"):
            return self._remark("data URI", f"one of {home}")
        name = self._name(home, uri)
        suffix = os.path.splitext(name)[1].lower()
        if "implicitTiling" in tile:
            return self._remark("implicit tiles", name)
        if suffix == SUFFIX and (self.folder / name).is_file():
            return waiting.append(name)
        if suffix not in (*_SCENES, SUFFIX):
            return self._remark(suffix or "without suffix", name)
        missing = InputError("TXF-I01", "the file does not exist", path=str(self.folder / name))
        self._contents[name] = None if (self.folder / name).is_file() else missing
        return None

    def _name(self, home, uri):
        """Path of a file that a tileset refers to, relative to the folder. Raises InputError TXF-I57 if it is elsewhere."""
        parts = urlsplit(uri)
        path = os.path.normpath(Path(home).parent / unquote(parts.path))
        try:
            is_inside = not parts.scheme and not parts.netloc and (self.folder / path).resolve().is_relative_to(self._real)
        except (OSError, ValueError):
            is_inside = False
        if not is_inside or os.path.isabs(path) or path.startswith(".."):
            raise self._wrong(f"the content {uri[:200]!r} is outside of the folder of the tileset", home)
        return Path(path).as_posix()

    def _out(self, name, error):
        """The content's name in the folder for results; another file of that name in the tileset is not replaced."""
        stem, suffix = os.path.splitext(name)
        is_taken = suffix.lower() == SCENE or (self.folder / (stem + SCENE)).exists()
        return name if error or suffix.lower() == SCENE else (name if is_taken else stem) + SCENE

    def _remark(self, kind, name):
        self._remarks.setdefault(kind, []).append(name)

    def _wrong(self, reason, name):
        return InputError("TXF-I57", "the tileset cannot be read", path=str(self.folder / name), reason=reason)

    def check_out(self, out: Path) -> None:
        """Raise InputError TXF-O07 if the folder for results is that of the tileset."""
        if out.resolve() == self._real:
            raise InputError("TXF-O07", "the output would overwrite an input file", path=str(out))

    def finish(self, out: Path, failed: set[str]) -> None:
        """Copy all files that are not coded, then write the tilesets. out: folder for results; failed: names of assets that
        could not be coded, which are copied. Raises OSError."""
        coded = {asset.name: asset.out for asset in self.assets if asset.name not in failed}
        for name in self._files(out):
            if name not in coded and name not in self._texts and not _is_same(self.folder / name, out / name):
                _replace(out / name, partial(shutil.copy2, self.folder / name))
        for name, text in reversed(self._texts.items()):
            written = _URI.sub(partial(self._with_new_uri, name, coded), text)
            data = (self.folder / name).read_bytes() if written == text else written.encode()
            _replace(out / name, lambda path, data=data: path.write_bytes(data))

    def _files(self, out):
        """Names of all files of the folder, without the folder for results."""
        for place, folders, names in os.walk(self.folder):
            folders[:] = sorted(name for name in folders if name != WORK and (Path(place) / name).resolve() != out.resolve())
            for name in sorted(set(names) - {RESULTS, LOCK}):
                if not os.path.islink(os.path.join(place, name)) or (Path(place) / name).resolve().is_relative_to(self._real):
                    yield (Path(place) / name).relative_to(self.folder).as_posix()

    def _with_new_uri(self, home, coded, match):
        """The JSON text of a matched URI, another one for a content whose name changes."""
        uri = json.loads(match[2])
        parts = urlsplit(uri)
        name = Path(os.path.normpath(Path(home).parent / unquote(parts.path))).as_posix()
        if parts.scheme or coded.get(name, name) == name:
            return match[0]
        folder, slash, _ = parts.path.rpartition("/")
        return match[1] + json_text(parts._replace(path=folder + slash + quote(Path(coded[name]).name)).geturl())


def _tiles(root: Any) -> Iterator[dict[str, Any]]:
    """All tiles below one, itself first."""
    waiting = [root]
    while waiting:
        tile = waiting.pop()
        yield tile
        waiting += reversed(tile.get("children", []))


def _is_same(source, copy):
    """Return whether a file is the copy of an earlier run, by size and time."""
    try:
        stats = [os.stat(path) for path in (source, copy)]
    except OSError:
        return False
    return len({(stat.st_size, stat.st_mtime_ns) for stat in stats}) == 1


def _replace(target, write):
    """Writes a file beside its place, then renames it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        write(beside)
        cleanup.rename_all([(beside, target)])
    finally:
        beside.unlink(missing_ok=True)
