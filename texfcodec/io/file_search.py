"""Search for files that a mesh names: by other encodings, letter case, Unicode forms, separators and folders. A file under
another name or in another folder is a remark; for a missing file the caller reports an error."""

from __future__ import annotations

import os
import re
import unicodedata
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .opened import opened

if TYPE_CHECKING:
    from .parts import Notes

ENCODINGS = ("utf-8", "gb18030", "cp932", "big5", "euc_kr", "cp1252", "cp1251", "cp1250", "cp437", "mac_roman")
_BYTES_OF = ("latin-1", "cp437", "cp1252")  # what a name in another encoding was taken for, by a reader or an unpacker
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_FILE = re.compile(r"\Afile:/*", re.IGNORECASE)
_SAME_SUFFIX = {".jpeg": ".jpg", ".jpe": ".jpg", ".tiff": ".tif"}
_USUAL = re.compile("(tex|texture|image|img|map|material|picture|bitmap|skin)s?")  # names of folders of images
_MOST_ENTRIES = 20_000  # of a folder; a search need not read a disk
_MOST_FOLDERS = 64
_SHOWN = 160  # characters of a name in a message


def is_remote(name: str) -> bool:
    """Return whether a name is an address on a network, such as https://, and not a file."""
    return bool(_SCHEME.match(name)) and not name[:5].lower() == "file:"


def missing_file(name: str, kind: str = "texture file") -> InputError:
    """Return the error for a file that a mesh names and that is missing: TXF-I16, or TXF-I27 for an address on a network. kind:
    of file, for the message."""
    shown = name if len(name) <= _SHOWN else name[:_SHOWN] + "..."
    if is_remote(name):
        return InputError("TXF-I27", f"{kind} '{shown}' is remote; nothing is downloaded")
    return InputError("TXF-I16", f"{kind} '{shown}' is missing or unreadable")


def read_file(folder: Path, name: str, notes: Notes, kind: str = "texture file") -> bytes:
    """Read a file that a mesh names and return its bytes. folder: of the mesh; notes: messages, as in find_file(); kind: of file,
    for the error of missing_file(), which is raised if there is none."""
    path = find_file(folder, name, notes)
    try:
        if path is not None:
            return path.read_bytes()
    except OSError as error:
        raise missing_file(name, kind) from error
    raise missing_file(name, kind)


def find_file(folder: Path, name: str, notes: Notes) -> Path | None:
    """Find a file that a mesh names, also under similar names, and return its path, or None. folder: of the mesh; notes: receives
    a remark if the file has another name or is in another folder, and a loss if several files fit equally well."""
    from urllib.parse import unquote

    if is_remote(name):
        return None
    local = ["/" + _FILE.sub("", unquote(name))] if _FILE.match(name) else []
    for candidate in (name, unquote(name), *local):
        path = Path(folder) / candidate
        if candidate and _is_file(path):
            opened(path)
            return path
    matches = _search(Path(folder), name, notes)
    if not matches:
        return None
    path = matches[0]
    if len(matches) > 1:
        notes.lose(f"file '{name[:_SHOWN]}' (guessed among {len(matches)} files)",
                   f"{len(matches)} files could be '{name[:_SHOWN]}'; '{_shown(path, folder)}' is read")
    else:
        notes.remark(f"file '{name[:_SHOWN]}' is read from '{_shown(path, folder)}'")
    opened(path)
    return path


def _is_file(path):
    try:
        return path.is_file()
    except (OSError, ValueError):  # name too long, embedded NUL
        return False


def _shown(path, folder):
    """A path as seen from the folder of the mesh, printable."""
    return Path(os.path.relpath(path, folder or ".")).as_posix().encode("utf-8", "replace").decode()


def _search(folder, name, notes):
    """Paths that fit the name, all from the best place that has any; [] without any."""
    ways = [(way, encoding) for spelling, encoding in _spellings(name) if (way := _parts(spelling))]
    above = folder.parent if folder.parent != folder else None
    for base in (folder, above):
        for way, encoding in ways if base is not None else ():
            for skipped in range(len(way)):  # the folders that another machine had come off one by one
                matches = _walk(base, way[skipped:], notes)
                if matches:
                    notes.encoding = encoding or notes.encoding
                    return matches
    for base in (folder, above):
        for place in _image_folders(base, notes) if base is not None else ():
            for way, encoding in ways:
                matches = _walk(place, way[-1:], notes)
                if matches:
                    notes.encoding = encoding or notes.encoding
                    return matches
    return []


def _parts(name):
    """A path in any system's notation -> its names without drive, quotes, "." and ".."."""
    name = _FILE.sub("", name.strip(" \t").strip("\"'"))
    return [part.strip(" ") for part in re.sub(r"^[A-Za-z]:", "", name.replace("\\", "/")).split("/") if part.strip(" .")]


def _walk(base, way, notes):
    """Files that a sequence of names leads to from a folder; names are compared by _key()."""
    places = [base]
    for part in way:
        places = [place / entry for place in places for entry in _entries(place, notes).get(_key(part), ())][:8]
        if not places:
            return []
    return [place for place in places if _is_file(place)]


def _entries(folder, notes):
    """{key: names} of the entries of a folder, read once in a load; {} if the folder cannot be read."""
    if folder not in notes.folders:
        keys: dict[str, list[str]] = {}
        try:
            with os.scandir(folder or ".") as entries:
                for entry in islice(entries, _MOST_ENTRIES):
                    for key in {_key(entry.name), *(_key(other) for other in readings(entry.name))}:
                        keys.setdefault(key, []).append(entry.name)
        except (OSError, ValueError):
            pass
        notes.folders[folder] = {key: sorted(names) for key, names in keys.items()}
    return notes.folders[folder]


def _image_folders(base, notes):
    """Subfolders that may hold the mesh's images, and the folders in those. Their name is usual, or begins with the name of the
    mesh's file and a mark; all others may belong to other meshes."""
    stem = re.escape(_key(notes.path.stem)) if notes.path is not None else ""
    own = re.compile(rf"{_USUAL.pattern}|{stem}(?:[^0-9a-z].*)?" if stem else _USUAL.pattern)
    named = _folders(base / name for key, names in _entries(base, notes).items() if own.fullmatch(key) for name in names)
    return named + _folders(place / name for place in named for names in _entries(place, notes).values() for name in names)


def _folders(places):
    return sorted({place for place in places if place.is_dir()})[:_MOST_FOLDERS]


def _key(name):
    """Key that is equal for names that some file system or exporter treats as equal."""
    name = unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())
    stem, dot, suffix = name.rpartition(".")
    return stem + _SAME_SUFFIX.get(dot + suffix, dot + suffix) if dot else name


def _spellings(name):
    """[(spelling, encoding)]: the name, the name with percent-escapes decoded, and its bytes in other encodings; each once, the
    likeliest first. encoding: if the name held bytes as Latin-1, the encoding that gave this spelling, else None."""
    from urllib.parse import unquote

    plain = (name, unquote(name), unquote(name, "latin-1"))
    out: dict[str, str | None] = dict.fromkeys(plain)
    for encoding in ENCODINGS:
        out.setdefault(in_encoding(name, encoding), encoding)
    for reading in (reading for text in plain for reading in readings(text)):
        out.setdefault(reading, None)
    return list(out.items())


def in_encoding(name: str, encoding: str | None) -> str:
    """Return a file name decoded by an encoding. name: its bytes as Latin-1, a byte a character; it is returned unchanged if
    encoding is None or cannot decode it."""
    try:
        return name.encode("latin-1").decode(encoding) if encoding and not name.isascii() else name
    except UnicodeError:
        return name


def readings(name: str) -> list[str]:
    """Return the names that a mesh may mean: the bytes of its name decoded by other encodings, [] for ASCII. A name that is not
    UTF-8 holds bytes as Latin-1, a byte a character, or is as the system gives it."""
    if name.isascii():
        return []
    out: dict[str, None] = {}
    for coded in (*_BYTES_OF, "surrogates"):
        try:
            data = name.encode("utf-8", "surrogateescape") if coded == "surrogates" else name.encode(coded)
        except UnicodeError:
            continue
        for encoding in ENCODINGS:
            try:
                out[data.decode(encoding)] = None
            except UnicodeError:
                continue
    out.pop(name, None)
    return list(out)
