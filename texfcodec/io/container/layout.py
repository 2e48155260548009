"""The part-level form of TEXF_stream: which units of which stream a primitive of a glTF file consists of.

docs/guide/TEXF_stream.md specifies it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError, TexfError
from ..gltf.accessor import read_accessor
from ..gltf.carried import EXTENSION
from ..gltf.document import GLB_MAGIC, open_document
from ..gltf.properties import extensions, is_index, malformed, numbers, part
from ..parts import Notes

if TYPE_CHECKING:
    from ...texf import Texf
    from ..gltf.document import Document

FROM_STREAM = ("POSITION", "NORMAL", "TANGENT")  # and one TEXCOORD set
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class CodedPrimitive:
    """A primitive that consists of units of a stream.

    mesh, number: indices of the mesh and of the primitive in it; stream: index into the file's streams; units: indices of
    geometry units, in order; matrix: float64 [4, 4] acting on columns, from the stream's space to the mesh's; texcoord: number of
    the UV set that the stream gives; splits: int64 [N, 2], (corner, vertex) of corners that do not use their unit's vertex;
    has_fallback: whether its attributes and indices are those of a fallback, which stands for none of the stream's vertices.
    """

    mesh: int
    number: int
    stream: int
    units: tuple[int, ...]
    matrix: np.ndarray
    texcoord: int
    splits: np.ndarray
    has_fallback: bool = False

    def corners(self, texf: Texf) -> np.ndarray:
        """Return the vertex of each corner, int64 [F, 3]: numbered through the units in order, then the splits."""
        base, rows = 0, []
        for number in self.units:
            rows.append(texf.units[number].faces + base)
            base += len(texf.units[number].lattice)
        corner = np.concatenate(rows).reshape(-1)
        corner[self.splits[:, 0]] = self.splits[:, 1]
        return corner.reshape(-1, 3)


def write_extension(primitive: dict, coded: CodedPrimitive, splits: int | None) -> None:
    """Add the extension to a primitive. splits: number of the accessor of its splits, None without any."""
    entry = {"stream": coded.stream, "units": list(coded.units)}
    if not np.array_equal(coded.matrix, np.eye(4)):
        entry["matrix"] = short_numbers(coded.matrix.T.reshape(-1))
    if coded.texcoord:
        entry["texCoord"] = coded.texcoord
    if splits is not None:
        entry["splits"] = splits
    primitive.setdefault("extensions", {})[EXTENSION] = entry


def short_numbers(values: np.ndarray) -> list[float]:
    """Return numbers that are short in JSON: the shortest decimals of their float32."""
    return [float(str(value)) for value in np.asarray(values).astype(np.float32)]


def is_container(root: dict) -> bool:
    """Return whether a file has the part-level form of the extension."""
    return "streams" in part(extensions(root), EXTENSION)


def open_scene_file(data: bytes) -> Document | None:
    """Return the Document of a GLB with the part-level form of the extension; None for other bytes."""
    if data[:4] != GLB_MAGIC:
        return None
    try:
        document = open_document(data, Path(), Notes())
        return document if is_container(document.root) else None
    except TexfError:
        return None


def streams_of(document: Document) -> list[bytes]:
    """Return the streams of a file. Raises InputError TXF-I09 to I11."""
    views = part(extensions(document.root), EXTENSION).get("streams")
    if not isinstance(views, list) or not all(is_index(view) for view in views):
        raise malformed(f"'streams' of {EXTENSION} is not an array of indices")
    streams = [bytes(document.view(view)[0]) for view in views]
    places = sorted(document.place(view) for view in views)
    for (buffer, _, end), (other, begin, _) in pairwise(places):
        if buffer == other and begin < end:  # a small file could ask for any amount of work
            raise malformed("streams overlap", value=begin, allowed=end)
    return streams


def read_primitives(document: Document, unit_counts: list[int]) -> list[CodedPrimitive]:
    """Return the coded primitives of a file.

    unit_counts: number of geometry units of each stream.
    Raises InputError TXF-I09 for names of what is not there, two primitives on one unit, or a matrix without inverse.
    """
    result, users = [], {}
    for mesh, entry in enumerate(document.entries("meshes")):
        primitives = entry.get("primitives")
        for number, primitive in enumerate(primitives if isinstance(primitives, list) else ()):
            if not isinstance(primitive, dict) or EXTENSION not in extensions(primitive):
                continue
            coded = _read_primitive(document, part(extensions(primitive), EXTENSION), (mesh, number), unit_counts)
            if coded.has_fallback and (len(coded.splits) or primitive.get("targets")):
                raise malformed("a primitive with a fallback has splits or morph targets", value=number)
            for unit in coded.units:
                if (coded.stream, unit) in users:
                    raise malformed("two primitives consist of one unit of a stream", value=unit)
                users[coded.stream, unit] = mesh, number
            result.append(coded)
    return result


def _read_primitive(document, entry, place, unit_counts):
    stream, units = entry.get("stream"), entry.get("units")
    if not is_index(stream) or stream >= len(unit_counts):
        raise malformed("a primitive names a stream that is not there", value=str(stream)[:20], allowed=len(unit_counts) - 1)
    if not isinstance(units, list) or not units or not all(is_index(u) and u < unit_counts[stream] for u in units):
        raise malformed("a primitive names a unit that is not there", value=str(units)[:40], allowed=unit_counts[stream] - 1)
    matrix = np.array(numbers(entry, "matrix", _IDENTITY)).reshape(4, 4).T
    if not abs(np.linalg.det(matrix[:3, :3])) > 0 or not np.isfinite(np.linalg.inv(matrix[:3, :3])).all():
        raise malformed("the matrix of a primitive has no inverse")
    texcoord, splits, fallback = entry.get("texCoord", 0), np.zeros((0, 2), np.int64), entry.get("fallback", False)
    if not is_index(texcoord):
        raise malformed("'texCoord' is not an index", value=str(texcoord)[:20])
    if not isinstance(fallback, bool):
        raise malformed("'fallback' is neither true nor false", value=str(fallback)[:20])
    if "splits" in entry:
        stored = read_accessor(document, entry["splits"], ("VEC2",))
        if stored.dtype.kind != "u":
            raise malformed("the splits of a primitive are not unsigned integers", value=str(stored.dtype))
        splits = stored.astype(np.int64)
    return CodedPrimitive(mesh=place[0], number=place[1], stream=stream, units=tuple(units), matrix=matrix, texcoord=texcoord,
                          splits=splits, has_fallback=fallback)


def check_corners(coded: CodedPrimitive, texf: Texf, count: int | None) -> None:
    """Check the splits of a primitive and the number of its stored values.

    count: of the values of each stored attribute, None without any. Raises InputError TXF-I09 or TXF-I11.
    """
    corners = 3 * sum(len(texf.units[number].faces) for number in coded.units)
    vertices = sum(len(texf.units[number].lattice) for number in coded.units)
    if len(coded.splits):
        corner, vertex = coded.splits.T
        if corner.max() >= corners or vertex.max() >= vertices + len(corner):
            raise InputError("TXF-I11", "a split of a primitive refers to a corner or vertex that is not there",
                             value=[int(corner.max()), int(vertex.max())], allowed=[corners - 1, vertices + len(corner) - 1])
        vertices = max(vertices, int(vertex.max()) + 1)
    if count is not None and count != vertices:
        raise malformed("a stored attribute has other values than the units have vertices", value=count, allowed=vertices)
