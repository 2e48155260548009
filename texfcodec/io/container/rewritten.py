"""A glTF file whose JSON tree was changed, written again: what nothing refers to any more is left out."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, LimitError
from ..gltf.accessor import DTYPES
from ..gltf.deflated import enc_view
from ..gltf.document import DEFLATED
from ..gltf.meshopt import EXTENSIONS as MESHOPT
from ..gltf.properties import extensions
from ..gltf.writer import glb_pieces
from .packed_accessors import pack_accessors, row_size
from .references import DATA, extension_names, has_unknown_references, reached, references

if TYPE_CHECKING:
    from ..gltf.document import Document

_COMPONENTS = {dtype[1:]: component for component, dtype in DTYPES.items()}
ARRAY, INDEX = 34962, 34963  # bufferView targets
_ALIGNMENT = 4
MOST_BYTES = 1 << 31  # of the buffer
_WORTH = 80  # bytes that the JSON of a deflated view takes
LABELS = ("name", "extras", "extensions")
PACKED = (DEFLATED, *MESHOPT)
_LAYOUT = (*PACKED, "KHR_draco_mesh_compression", "KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif",
           "MSFT_texture_dds")  # extensions of how data is stored
_IMAGES = ((0, b"\x89PNG", "image/png"), (0, b"\xff\xd8\xff", "image/jpeg"), (8, b"WEBP", "image/webp"),
           (4, b"ftypavif", "image/avif"), (0, b"\xabKTX 20\xbb", "image/ktx2"), (0, b"DDS ", "image/vnd-ms.dds"))


class Rewritten:
    """A copy of a glTF file that can be changed and written as a GLB.

    root: JSON tree, which callers change in place; entries of DATA keep their numbers until glb().
    """

    def __init__(self, document: Document) -> None:
        """document: the file that is copied."""
        self.document, self.root = document, deepcopy(document.root)
        self._new: dict[int, bytes] = {}
        self._added = 0  # bytes of new views
        self._numbers: dict[int, int] = {}  # by number of a bufferView, the one before entries were removed
        self._before = reached(self.root)

    def add(self, kind: str, entry: dict) -> int:
        """Append an entry to an array of the file; return its number."""
        self.root.setdefault(kind, []).append(entry)
        return len(self.root[kind]) - 1

    def add_view(self, data: bytes, **properties: Any) -> int:
        """Append bytes as a bufferView; return its number. properties: of the bufferView."""
        number = self.add("bufferViews", {"buffer": 0, "byteLength": len(data), **properties})
        self._new[number] = data
        self._added += len(data)
        if self._added > MOST_BYTES:
            raise LimitError("TXF-I41", "the file is too large for a GLB", value=self._added, allowed=MOST_BYTES)
        return number

    def add_accessor(self, values: np.ndarray, kind: str, normalized: bool = False, target: int | None = None,
                     sparse: bool = False) -> int:
        """Append an array as an accessor; return its number.

        Parameters
        ----------
        values : [N, width]
            In a component type of glTF.
        kind : str
            "SCALAR", "VEC2" ...
        normalized : bool
            Whether integers represent 0..1 or -1..1.
        target : int, optional
            Of the bufferView; rows of vertex attributes are padded to four bytes.
        sparse : bool
            Whether rows of 0 may be left out.
        """
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        entry: dict[str, Any] = {"componentType": _COMPONENTS[values.dtype.str[1:]], "count": len(values), "type": kind}
        if normalized:
            entry["normalized"] = True
        rows = np.flatnonzero(values.any(axis=1))
        if sparse and 2 * len(rows) < len(values):
            if len(rows):
                indices: np.ndarray = rows.astype("<u2" if len(values) <= 65536 else "<u4")
                entry["sparse"] = {"count": len(rows),
                                   "indices": {"bufferView": self.add_view(indices.tobytes()),
                                               "componentType": _COMPONENTS[indices.dtype.str[1:]]},
                                   "values": {"bufferView": self.add_view(values[rows].tobytes())}}
        else:
            entry["bufferView"] = self._add_rows(values, target)
        return self.add("accessors", entry)

    def add_stored(self, number: int, values: np.ndarray, is_target: bool) -> int:
        """Append stored values in another order or number of rows; return the number of their accessor. number: of the source's
        accessor, which says how they are stored; values: [N, width]; is_target: whether they are a morph target's."""
        old = self.document.entry("accessors", number)
        sparse = is_target and ("sparse" in old or "bufferView" not in old)
        new = self.add_accessor(values, old["type"], bool(old.get("normalized")), None if sparse else ARRAY, sparse)
        self.copy_labels(number, new)
        if is_target and "min" in old:
            self.add_bounds(new, values)
        return new

    def copy_labels(self, source: int, new: int) -> None:
        """Give a new accessor the name, extras and extensions of an accessor of the source."""
        old = self.document.entry("accessors", source)
        self.root["accessors"][new] |= {key: deepcopy(old[key]) for key in LABELS if key in old}

    def add_bounds(self, number: int, values: np.ndarray) -> None:
        """Give an accessor min and max. values: [N, width]."""
        self.root["accessors"][number] |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}

    def _add_rows(self, values, target):
        """Return the number of a new view of an array."""
        size = values.itemsize * values.shape[1]
        properties = {} if target is None else {"target": target}
        if target != ARRAY or size % _ALIGNMENT == 0:
            return self.add_view(values.tobytes(), **properties)
        padded = np.zeros((len(values), size + -size % _ALIGNMENT), np.uint8)
        padded[:, :size] = values.view(np.uint8).reshape(len(values), size)
        return self.add_view(padded.tobytes(), byteStride=padded.shape[1], **properties)

    def use_extension(self, name: str, required: bool = False) -> None:
        """Add an extension to extensionsUsed, and to extensionsRequired if required."""
        for kind in ("extensionsUsed", "extensionsRequired")[: 1 + required]:
            if name not in self.root.get(kind, ()):
                self.root.setdefault(kind, []).append(name)

    def require_no_more(self, name: str) -> None:
        """Remove an extension from extensionsRequired."""
        self.root["extensionsRequired"] = [other for other in self.root.get("extensionsRequired", []) if other != name]
        if not self.root["extensionsRequired"]:
            del self.root["extensionsRequired"]

    def glb(self, deflate: bool = False) -> bytes:
        """Return the file.

        Entries that only removed references had reached are left out, and accessors share bufferViews; a file with extensions
        whose references are not known keeps all entries as they are. deflate: whether to store bufferViews of accessors deflated
        where that saves bytes.
        """
        self._embed_images()
        if not has_unknown_references(self.root):
            pack_accessors(self)
            source = self.document.root
            idle = {(kind, n) for kind in DATA for n in range(len(source.get(kind, [])))} - self._before
            every = {(kind, n) for kind in DATA for n in range(len(self.root.get(kind, [])))}
            self._remove(every - reached(self.root, idle))
        if deflate:
            self._deflate()
        pieces, length = self._buffer()
        self._drop_extensions()
        return b"".join(glb_pieces(self.root, pieces, length))

    def _drop_extensions(self):
        """Remove extensions of the layout that the source used and this file does not, and empty lists of extensions."""
        gone = set(_LAYOUT) & set(extension_names(self.document.root)) - set(extension_names(self.root))
        for kind in ("extensionsUsed", "extensionsRequired"):
            if kind in self.root:
                self.root[kind] = [name for name in self.root[kind] if name not in gone]
                if not self.root[kind]:
                    del self.root[kind]

    def view(self, number: int) -> tuple[memoryview | bytes, int | None]:
        """Return (bytes, byteStride or None) of a bufferView, decoded if it was compressed."""
        if number in self._new:
            return self._new[number], self.root["bufferViews"][number].get("byteStride")
        return self.document.view(number)

    def _embed_images(self):
        """Move images that are in files, or in the text, into the buffer."""
        for number, entry in enumerate(self.root.get("images", [])):
            if "uri" in entry and number < len(self.document.root.get("images", [])):
                try:
                    data = bytes(self.document.image_bytes(number))
                except InputError:  # of a file that is not here: it keeps its name
                    continue
                del entry["uri"]
                entry |= {"bufferView": self.add_view(data), "mimeType": _image_type(data) or entry.get("mimeType", "image/png")}

    def _remove(self, unreached):
        """Remove entries and renumber references."""
        gone = {kind: {number for of, number in unreached if of == kind} for kind in DATA}
        number_of = {}
        for kind in DATA:
            kept = [n for n in range(len(self.root.get(kind, []))) if n not in gone[kind]]
            number_of[kind] = {old: new for new, old in enumerate(kept)}
        for holder, reference in list(references(self.root)):
            if holder[0] not in DATA or holder[1] not in gone[holder[0]]:
                reference.owner[reference.key] = number_of[reference.kind][reference.target]
        for kind in DATA:
            if gone[kind]:
                self.root[kind] = [self.root[kind][old] for old in number_of[kind]]
                if not self.root[kind]:
                    del self.root[kind]
        self._numbers = {new: old for old, new in number_of["bufferViews"].items()}

    def _deflate(self):
        """Store new bufferViews of accessors deflated where that saves bytes."""
        row_of: dict[int, int] = {}
        for entry in self.root.get("accessors", []):
            if self._numbers.get(number := entry.get("bufferView"), number) in self._new:
                row_of.setdefault(number, row_size(entry))
        for number, row in row_of.items():
            old, entry = self._numbers.get(number, number), self.root["bufferViews"][number]
            packed = enc_view(self._new[old], entry.get("byteStride", row))
            if len(packed) + _WORTH < len(self._new[old]):
                self._new[old] = packed
                entry["extensions"] = {DEFLATED: {"byteLength": len(packed), "row": entry.get("byteStride", row)}}

    def _buffer(self):
        """Return (pieces of the buffer, its length), after placing all views in it."""
        pieces, length, placeholder = [], 0, 0
        for number, entry in enumerate(self.root.get("bufferViews", [])):
            old = self._numbers.get(number, number)
            if old not in self._new and DEFLATED in extensions(entry):
                self._new[old] = bytes(self.document.view(old)[0])
                del entry["extensions"][DEFLATED]
            packed = next((extensions(entry)[name] for name in PACKED if name in extensions(entry)), None)
            owner = entry if packed is None else packed
            data = self._new[old] if old in self._new else self.document.stored(old)
            owner |= {"buffer": 0, "byteOffset": length}
            if packed is not None:
                entry |= {"buffer": 1, "byteOffset": placeholder}
                placeholder += entry["byteLength"] + -entry["byteLength"] % 8
            pieces += [data, b"\0" * (-len(data) % 8)]
            length += len(data) + len(pieces[-1])
        if length > MOST_BYTES:
            raise LimitError("TXF-I41", "the file is too large for a GLB", value=length, allowed=MOST_BYTES)
        self.root.pop("buffers", None)
        if pieces:
            self.root["buffers"] = [{"byteLength": length}]
        if placeholder:
            name = next(name for entry in self.root["bufferViews"] for name in PACKED if name in extensions(entry))
            self.root["buffers"].append({"byteLength": placeholder, "extensions": {name: {"fallback": True}}})
        return pieces, length


def _image_type(data):
    """Return the media type of an image file, "" if it is not known."""
    return next((mime for at, start, mime in _IMAGES if data[at : at + len(start)] == start), "")
