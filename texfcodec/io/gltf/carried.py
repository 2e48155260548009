"""A .texf stream inside a GLB or glTF: the extension TEXF_stream of a scene, docs/guide/TEXF_stream.md.

The stream replaces all nodes of the scene, which are a fallback for viewers that do not know the extension.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from ..parts import Notes
from .document import DEFLATED as EXTENSION
from .document import GLB_MAGIC, open_document
from .properties import extensions, integer

if TYPE_CHECKING:
    from .document import Document
    from .writer import Document as Written

def read_carried(document: Document) -> bytes | None:
    """Return the .texf stream that a glTF file carries in an extension of its default scene, or None. Raises InputError TXF-I09
    to I11 if the extension refers to no valid bytes."""
    scenes, chosen = document.entries("scenes"), integer(document.root, "scene", 0, low=0)
    if chosen >= len(scenes) or EXTENSION not in extensions(scenes[chosen]):
        return None
    entry = extensions(scenes[chosen])[EXTENSION]
    return bytes(document.view(entry.get("bufferView") if isinstance(entry, dict) else None)[0])


def write_carried(document: Written, stream: bytes) -> None:
    """Append a .texf stream, byte for byte, to a document under construction, as an extension of its scene."""
    document.json["scenes"][0]["extensions"] = {EXTENSION: {"bufferView": document.add_view(stream)}}
    document.use_extension(EXTENSION)


def stream_within(data: bytes) -> bytes:
    """Return the .texf stream in the bytes of a file: the stream that a GLB carries, or the bytes themselves if they are no GLB.
    Raises InputError TXF-I26 if a GLB carries no stream, and TXF-I07 to I11 or SupportError TXF-I33 if it is broken."""
    if data[:4] != GLB_MAGIC:
        return data
    stream = read_carried(open_document(data, Path(), Notes()))
    if stream is None:
        raise InputError("TXF-I26", "the GLB carries no .texf stream", value=EXTENSION)
    return stream
