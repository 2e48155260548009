"""glTF 2.0 containers: GLB chunks, JSON, buffers, URIs, bufferViews."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import InputError, SupportError
from ...report import plural
from ..file_search import missing_file, read_file
from .deflated import dec_view
from .meshopt import EXTENSIONS, decode_view
from .properties import extensions, integer, is_index, malformed, part, title

if TYPE_CHECKING:
    import numpy as np

    from ..parts import Notes

DEFLATED = "TEXF_stream"
MOST_LEVELS = 100  # of the JSON tree
GLB_MAGIC, CHUNK_JSON, CHUNK_BIN = b"glTF", 0x4E4F534A, 0x004E4942


class Document:
    """The JSON tree of a glTF file and the bytes that it refers to.

    root: dict; chunk: the GLB's binary chunk, or None; folder: base of relative URIs; notes: Notes.
    """

    def __init__(self, root: dict, chunk: memoryview | None, folder: Path, notes: Notes) -> None:
        self.root, self.folder, self.notes = root, folder, notes
        self._chunk = chunk
        self._buffers: dict[int, memoryview] = {}
        self._entries: dict[str, list[dict]] = {}
        self._decoded: dict[int, bytes] = {}
        self.sparse: dict[int, np.ndarray] = {}  # of accessor.py, which writes the values of each in once

    def entries(self, kind: str) -> list[dict]:
        """Top-level array such as "nodes": list of dict."""
        if kind not in self._entries:
            entries = self.root.get(kind, [])
            if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
                raise malformed(f"'{kind}' is not an array of objects")
            self._entries[kind] = entries
        return self._entries[kind]

    def entry(self, kind: str, index: Any) -> dict:
        """Return entry `index` of a top-level array such as "nodes"; InputError TXF-I09 if there is none."""
        entries = self.entries(kind)
        if not is_index(index) or index >= len(entries):
            raise malformed(f"'{kind}' has no such entry", value=index, entries=len(entries))
        return entries[index]

    def buffer(self, index: Any) -> memoryview:
        """The bytes of buffer `index`, exactly byteLength long."""
        entry = self.entry("buffers", index)
        if index not in self._buffers:
            length = integer(entry, "byteLength", low=0)
            data = self._buffer_data(entry, index)
            if len(data) < length:
                raise InputError("TXF-I10", f"buffer {index} is shorter than its byteLength",
                                 value=len(data), allowed=length)
            self._buffers[index] = memoryview(data)[:length]
        return self._buffers[index]

    def _buffer_data(self, entry, index):
        if "uri" in entry:
            return self._buffer_file(entry["uri"])
        if index == 0 and self._chunk is not None:
            return self._chunk
        raise InputError("TXF-I10", f"buffer {index} has no data")

    def view(self, index: Any) -> tuple[memoryview | bytes, int | None]:
        """(bytes, byteStride or None) of bufferView `index`. Raises InputError TXF-I11 if it leaves its buffer."""
        entry = self.entry("bufferViews", index)
        packed = next((part(extensions(entry), name) for name in (DEFLATED, *EXTENSIONS) if name in extensions(entry)), None)
        data = self._slice(entry, index) if packed is None else self._unpacked(packed, entry, index)
        stride = integer(entry, "byteStride", low=1) if "byteStride" in entry else None
        return data, stride

    def stored(self, index: int) -> memoryview:
        """The bytes of bufferView `index` as the file has them, compressed or not."""
        entry = self.entry("bufferViews", index)
        packed = (part(extensions(entry), name) for name in EXTENSIONS if name in extensions(entry))
        return self._slice(next(packed, entry), index)

    def place(self, index: int) -> tuple[int, int, int]:
        """Return (buffer, begin, end) of the bytes of a bufferView in the file, compressed or not. view() has checked them."""
        entry = self.entry("bufferViews", index)
        packed = (part(extensions(entry), name) for name in (DEFLATED, *EXTENSIONS) if name in extensions(entry))
        stored = next(packed, entry)
        begin = stored.get("byteOffset", 0)
        return stored["buffer"], begin, begin + stored["byteLength"]

    def _slice(self, entry, index):
        """The bytes that a bufferView, or an extension in it, refers to."""
        buffer = self.buffer(entry.get("buffer"))
        offset, length = integer(entry, "byteOffset", 0, low=0), integer(entry, "byteLength", low=0)
        if offset + length > len(buffer):
            raise InputError("TXF-I11", f"bufferView {index} exceeds its buffer",
                             value=offset + length, allowed=len(buffer))
        return buffer[offset : offset + length]

    def _unpacked(self, packed, entry, index):
        """The decoded bytes of a compressed bufferView; if its form is not supported, the plain copy that some files have."""
        if index not in self._decoded and DEFLATED in extensions(entry):
            spent = sum(len(self._decoded[n]) for n in self._decoded)
            self._decoded[index] = dec_view(self._slice(packed, index), packed, entry, index, spent)
        if index not in self._decoded:
            try:
                self._decoded[index] = decode_view(self._slice(packed, index), packed, entry, index)
            except SupportError:
                if any(name in self.root.get("extensionsRequired", []) for name in EXTENSIONS) or not self._has_plain(entry):
                    raise
                self._decoded[index] = self._slice(entry, index)
        return self._decoded[index]

    def _has_plain(self, entry):
        """Return whether the buffer of a view has bytes. Other buffers are placeholders for unpacked views."""
        buffer = self.entry("buffers", entry.get("buffer"))
        return "uri" in buffer or (entry["buffer"] == 0 and self._chunk is not None)

    def _buffer_file(self, uri):
        try:
            return self._uri_bytes(uri, "buffer file")
        except InputError as error:
            if error.code not in ("TXF-I16", "TXF-I27"):
                raise
            raise InputError("TXF-I10", error.message) from error

    def _uri_bytes(self, uri, kind):
        """Bytes of a data URI or a file. kind: the file's name in messages."""
        if not isinstance(uri, str):
            raise malformed("a uri is not a string")
        if uri[:5].lower() == "data:":
            return _data_uri(uri)
        return read_file(self.folder, uri, self.notes, kind)

    def image_bytes(self, index: Any) -> memoryview | bytes:
        """Encoded bytes of image `index`. Raises InputError TXF-I16 if its file is missing or unnamed, TXF-I27 if it is
        remote."""
        entry = self.entry("images", index)
        if "bufferView" in entry:
            return self.view(entry["bufferView"])[0]
        if "uri" not in entry:
            raise missing_file(title(entry, index))
        return self._uri_bytes(entry["uri"], "texture file")


def open_document(data: bytes, folder: Path, notes: Notes) -> Document:
    """Bytes of a .glb or .gltf file -> Document.

    Errors: TXF-I07 broken GLB container, TXF-I08 no JSON, TXF-I09 no object, TXF-I33 not glTF 2.
    """
    if data[:4] == GLB_MAGIC:
        text, chunk = _read_glb(data, notes)
    else:
        text, chunk = data, None
    root = _parse(text)
    _check_depth(root)
    if not isinstance(root, dict):
        raise malformed("the top level is not an object")
    asset = root.get("asset")
    version = asset.get("version", "2.0") if isinstance(asset, dict) else "2.0"
    if str(version).split(".")[0] != "2":
        raise SupportError("TXF-I33", "only glTF 2 is supported", value=str(version)[:20])
    return Document(root, chunk, folder, notes)


def _read_glb(data, notes):
    """(JSON bytes, binary chunk or None); glTF 2.0 section 4.4."""
    if len(data) < 20:
        raise InputError("TXF-I07", "the GLB file is truncated", value=len(data), allowed=20)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise SupportError("TXF-I33", "only glTF 2 is supported", value=version)
    if length > len(data):
        raise InputError("TXF-I07", "the GLB file is truncated", value=len(data), allowed=length)
    if length < len(data):
        notes.remark(plural(len(data) - length, "byte", "bytes") + " after the end of the GLB container, ignored")
    chunks = list(_chunks(memoryview(data)[:length]))
    if not chunks or chunks[0][0] != CHUNK_JSON:
        raise InputError("TXF-I07", "the first GLB chunk is not JSON", offset=12)
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == CHUNK_BIN else None
    return bytes(chunks[0][1]), binary


def _chunks(data):
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, at)
        if at + 8 + length > len(data):
            raise InputError("TXF-I07", "a GLB chunk exceeds the file", offset=at, value=length, allowed=len(data) - at - 8)
        yield kind, data[at + 8 : at + 8 + length]
        at += 8 + length


def _parse(text):
    try:
        return json.loads(bytes(text).decode("utf-8-sig"), parse_constant=lambda name: None)
    except json.JSONDecodeError as error:
        raise _no_json(error) from error
    except (ValueError, RecursionError) as error:
        raise InputError("TXF-I08", "the glTF text is not JSON", reason=str(error)[:100]) from error


def _check_depth(root):
    """Check that a tree has at most MOST_LEVELS levels, so that functions may recurse into it."""
    level = [root]
    for _ in range(MOST_LEVELS):
        level = [child for value in level if isinstance(value, (dict, list)) and value
                 for child in (value.values() if isinstance(value, dict) else value)]
    if level:
        raise malformed("objects and arrays are nested too deeply", allowed=MOST_LEVELS)


def _no_json(error):
    """The error with the position where the text stops being JSON, and the text there."""
    text, at = error.doc, min(error.pos, len(error.doc))
    before, here = text[:at].rstrip(), text[at:].lstrip()
    if here[:1] in ("}", "]") and before[-1:] == "," or here[:1] == "," and error.msg.startswith("Illegal trailing comma"):
        why = "a comma precedes a closing bracket"
    elif here[:2] in ("//", "/*") or here[:1] == "#":
        why = "it contains a comment, which JSON does not allow"
    elif not here:
        why = "the text ends early"
    elif here[:1] == "'":
        why = "it has single quotes where JSON requires double quotes"
    else:
        why = error.msg[:1].lower() + error.msg[1:]
    return InputError("TXF-I08", f"the glTF text is not JSON: {why}", line=error.lineno, column=error.colno,
                      value=here[:20].partition("\n")[0] or None)


def _data_uri(uri):
    import base64
    import binascii
    from urllib.parse import unquote_to_bytes

    head, comma, body = uri.partition(",")
    try:
        if comma:
            return base64.b64decode(unquote_to_bytes(body)) if head.lower().endswith(";base64") else unquote_to_bytes(body)
    except (binascii.Error, ValueError) as error:
        raise InputError("TXF-I10", "a data URI cannot be decoded", reason=str(error)) from error
    raise InputError("TXF-I10", "a data URI has no data")
