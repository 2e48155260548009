"""File types by first bytes: for messages if the suffix means another type, and for UTF-16 text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    from .formats import Format

_KINDS = (
    (0, b"glTF", "a binary glTF (.glb)"),
    (0, b"\x89TXF\r\n\x1a\n", "a texf stream; texf-dec decodes it"),
    (0, b"\x89PNG\r\n\x1a\n", "a PNG image"),
    (0, b"\xff\xd8\xff", "a JPEG image"),
    (8, b"WEBP", "a WebP image"),
    (4, b"ftypavif", "an AVIF image"),
    (0, b"GIF8", "a GIF image"),
    (0, b"\xabKTX 20\xbb", "a KTX2 texture"),
    (0, b"DRACO", "a bare Draco mesh; only glTF files with Draco are read"),
    (0, b"PK\x03\x04", "a ZIP archive"),
    (0, b"\x1f\x8b", "a gzip file; unpack it first"),
    (0, b"BZh", "a bzip2 file; unpack it first"),
    (0, b"\xfd7zXZ", "an xz file; unpack it first"),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive; unpack it first"),
    (0, b"Kaydara FBX Binary", "an FBX file"),
    (0, b"BLENDER", "a Blender file"),
    (0, b"PXR-USDC", "a USD file"),
    (0, b"%PDF", "a PDF document"),
    (0, b"\x93NUMPY", "a numpy array"),
    (0, b"VXZ", "an O-Voxel file (.vxz)"),
    (0, b"ply\n", "a Stanford PLY (.ply)"),
    (0, b"ply\r", "a Stanford PLY (.ply)"),
    (0, b"solid ", "an STL as text (.stl)"),
    (0, b"<!DOCTYPE html", "a web page"),
    (0, b"<html", "a web page"),
    (0, b"version https://git-lfs", "a Git LFS pointer instead of the file"),
    (0, b"<?xml", "an XML file"),
    (0, b"{", "JSON, as in a .gltf"),
)
_BEGINNING = 1 << 16  # bytes that tell a text's format; comments may come first
_COMMENTS = re.compile(rb"\A(?:\s+|#[^\r\n]*|<!--.*?-->)+", re.DOTALL)
_OBJ = re.compile(rb"(?:v|vn|vt)[ \t]+[-+.\dEe]+[ \t\r\n]|(?:f|l|p|fo)[ \t]+-?\d|(?:o|g|s|mtllib|usemtl|mg|vp|cstype)[ \t]|"
                  rb"[og][\r\n]")
_OFF_STARTS = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF")
_BYTE_ORDER_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"), (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def what_it_is(data: bytes) -> str:
    """Return what kind of file the bytes look like, in words for a message, "" if no kind is recognised."""
    head = bytes(data[:64])
    for offset, start, words in _KINDS:
        if head[offset : offset + len(start)] == start:
            return words
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "UTF-16 text"
    if len(head) > 7 and head[1:8:2] == b"\0" * 4 and head[0:8:2].isascii() and b"\0" not in head[0:8:2]:
        return "UTF-16 text without a byte order mark; save it as UTF-8"
    return ""


def suffix_of(data: bytes) -> str | None:
    """Suffix of the format of data without a name, such as ".glb"; None if the first bytes do not identify it."""
    from .formats import FORMATS

    if data[:4] == b"PK\x03\x04" and data[30 : 30 + int.from_bytes(data[26:28], "little")].endswith(b".npy"):
        return ".npz"  # 3MF is a ZIP archive, too
    for entry in FORMATS:
        if any(data[: len(start)] == start for start in entry.starts):
            return entry.suffix
    text = _first_text(data)
    if text.startswith(b"{"):
        return ".gltf"
    if text.startswith(b"<") and b"<COLLADA" in text:
        return ".dae"
    if text.startswith(_OFF_STARTS):
        return ".off"
    if _OBJ.match(text):
        return ".obj"
    triangles = int.from_bytes(data[80:84], "little")
    return ".stl" if text.startswith(b"solid ") or (triangles and len(data) == 84 + 50 * triangles) else None


def _first_text(data):
    """The beginning of a text as UTF-8, from its first statement; comments of OBJ, OFF and XML are skipped."""
    text = bytes(data[:_BEGINNING])
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if text.startswith(mark)), None)
    if encoding is not None:  # "ignore": half a character at the end
        text = text.decode(encoding, "ignore").encode("utf-8", "ignore")
    return _COMMENTS.sub(b"", text)


def check_start(data: bytes, entry: Format) -> None:
    """Raise InputError TXF-I06 if the first bytes of a file do not fit its Format. entry: the Format of its suffix."""
    seen = what_it_is(data)
    expected = data[: len(entry.starts[0])] in entry.starts if entry.starts else not _belongs_elsewhere(seen, entry)
    if not expected:
        looks = f"starts like {seen}" if seen else f"does not start like a {entry.suffix} file"
        raise InputError("TXF-I06", f"the file is named {entry.suffix} but {looks}", value=bytes(data[:4]).hex())


def _belongs_elsewhere(seen, entry):
    """Return whether data for a text format look like another format; text formats have no magic bytes."""
    own = {".gltf": "JSON", ".stl": "an STL", ".dae": "an XML"}.get(entry.suffix)
    return bool(seen) and seen != "UTF-16 text" and not (own and seen.startswith(own))


def as_utf8(data: bytes) -> bytes:
    """Return text that has a byte order mark as UTF-8 without the mark, and other bytes unchanged. Raises InputError TXF-I06 if
    the text cannot be decoded."""
    for mark, encoding in _BYTE_ORDER_MARKS:
        if bytes(data[: len(mark)]) == mark:
            try:
                return bytes(data).decode(encoding).encode("utf-8")
            except UnicodeError as error:
                name = encoding.removesuffix("-sig").upper()
                raise InputError("TXF-I06", f"the file has the byte order mark of {name} but is not valid {name}",
                                 reason=str(error)[:100]) from error
    return data
