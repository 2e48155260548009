"""A .texf stream that rides in a GLB or glTF: the extension TEXF_stream of a scene, docs/guide/TEXF_stream.md.

The scene's own nodes are a fallback for viewers that do not know the extension; in place of all of them stands the stream.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from ..parts import Notes
from .document import GLB_MAGIC, open_document
from .properties import extensions, integer

if TYPE_CHECKING:
    from .document import Document
    from .writer import Document as Written

EXTENSION = "TEXF_stream"


def read_carried(document: Document) -> bytes | None:
    """The bytes of the stream that the default scene carries, None where it carries none. Raises InputError TXF-I09 to I11, where
    the extension names no bytes."""
    scenes, chosen = document.entries("scenes"), integer(document.root, "scene", 0, low=0)
    if chosen >= len(scenes) or EXTENSION not in extensions(scenes[chosen]):
        return None
    entry = extensions(scenes[chosen])[EXTENSION]
    return bytes(document.view(entry.get("bufferView") if isinstance(entry, dict) else None)[0])


def write_carried(document: Written, stream: bytes) -> None:
    """Puts the bytes of a stream into a document, untouched, behind what its scene shows."""
    document.json["scenes"][0]["extensions"] = {EXTENSION: {"bufferView": document.add_view(stream)}}
    document.use_extension(EXTENSION)


def stream_within(data: bytes) -> bytes:
    """The stream that the bytes of a GLB carry; other bytes are returned as they are, for whoever reads streams to judge. Raises
    InputError TXF-I26 where a GLB carries none, and TXF-I07 to I11, SupportError TXF-I33 where it is broken."""
    if data[:4] != GLB_MAGIC:
        return data
    stream = read_carried(open_document(data, Path(), Notes()))
    if stream is None:
        raise InputError("TXF-I26", "the GLB carries no .texf stream", value=EXTENSION)
    return stream
