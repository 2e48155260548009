"""Vertices and triangles of a glTF document: plain, packed by Draco (KHR_draco_mesh_compression) or by meshoptimizer
(EXT_meshopt_compression).

Every packing has positions(), which gives vertices and their frame, and primitive(), which adds their accessors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import InputError, SupportError
from ...report import plural
from ..formats import COMPRESSIONS
from ..precision import local_frame

if TYPE_CHECKING:
    from ...texf import Texf
    from .writer import Document

ARRAY, INDEX = 34962, 34963  # bufferView targets
DRACO, MESHOPT, QUANTISED = "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization"
_UV_BITS, _NORMAL_BITS = 16, 10  # a sixteenth of a texel at 4096; directions within 0.1 degrees
_DRACO_LEVEL = 7
_DRACO_KINDS = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 3}


class Column(NamedTuple):
    """An attribute. values: [N, k]; kind: such as "VEC3"; normalized: whether integers represent 0..1 or -1..1."""

    values: np.ndarray
    kind: str
    normalized: bool = False


def check_compression(name: str) -> None:
    """Raises InputError TXF-O14 for a name that is not in COMPRESSIONS, SupportError TXF-O15 if its package is missing."""
    if name not in COMPRESSIONS:
        raise InputError("TXF-O14", "the mesh compression is unknown", value=str(name)[:40], allowed=" ".join(COMPRESSIONS))
    if name == "meshopt":
        _meshopt_package()


def packing_of(name: str) -> Plain:
    """Return the object that writes accessors in a compression. name: one of COMPRESSIONS."""
    return {"none": Plain, "draco": Draco, "meshopt": Meshopt}[name]()


class Plain:
    """Writes meshes as accessors without compression."""

    def positions(self, texf: Texf, vertex: np.ndarray) -> tuple:
        """Return the positions of vertices as the file stores them, [N, 3], and the translation and scale of the node that brings
        them to world space, None if there is none. vertex: int64 [N] into texf.positions."""
        return local_frame(texf, texf.positions[vertex])

    def primitive(self, document: Document, columns: dict[str, Column], corners: np.ndarray) -> dict:
        """Add a primitive's attributes and indices to a document and return the primitive's JSON dict. columns: by attribute
        name, a row for each vertex; corners: int64 [3 F], the vertex of each face corner."""
        columns = {name: smallest(name, column) for name, column in columns.items()}
        attributes = {name: document.add_accessor(c.values, c.kind, ARRAY, name == "POSITION", c.normalized)
                      for name, c in columns.items()}
        indices: np.ndarray = corners.astype(index_type(len(columns["POSITION"].values)))
        return {"attributes": attributes, "indices": document.add_accessor(indices, "SCALAR", INDEX)}


class Draco(Plain):
    """Draco data: positions on the stream's lattice, UVs in 16 bits, normals in 10 bits; other attributes are unchanged."""

    def __init__(self, uv_bits: int = _UV_BITS) -> None:
        self._uv_bits = uv_bits

    def positions(self, texf: Texf, vertex: np.ndarray) -> tuple:
        """Return positions and node as Plain does, and keep the stream's lattice, to which primitive() quantises them."""
        local, translation, scale = super().positions(texf, vertex)
        origin = texf.origin if translation is None else np.zeros(3)
        self._lattice = texf.position_bits, texf.side if scale is None else 1.0, origin
        return local, translation, scale

    def primitive(self, document: Document, columns: dict[str, Column], corners: np.ndarray) -> dict:
        """Add a primitive as Draco data and return its JSON dict; uncompressed, with a warning, if Draco fails."""
        import DracoPy

        try:
            packed = self._packed(columns, corners)
        except Exception as error:  # DracoPy derives its errors from Exception directly
            document.warnings.append(f"Draco cannot compress part of the mesh, which stays uncompressed: {str(error)[:200]}")
            return super().primitive(document, columns, corners)
        mesh = DracoPy.decode(packed)
        if len(mesh.faces) * 3 != len(corners):
            document.warnings.append("Draco leaves out " + plural(len(corners) // 3 - len(mesh.faces), "face", "faces")
                                     + " without area")
        arrays = {attribute["unique_id"]: np.asarray(attribute["data"]) for attribute in mesh.attributes}
        ids = _draco_ids(mesh, columns)
        attributes = {name: document.add_description(arrays[ids[name]], c.kind, name == "POSITION", c.normalized)
                      for name, c in columns.items()}
        corners = np.asarray(mesh.faces).reshape(-1)
        indices = document.add_description(corners.astype(index_type(len(mesh.points))), "SCALAR")
        document.use_extension(DRACO, required=True)
        return {"attributes": attributes, "indices": indices,
                "extensions": {DRACO: {"bufferView": document.add_view(packed), "attributes": ids}}}

    def _packed(self, columns, corners):
        """Draco bytes of a primitive."""
        import DracoPy

        bits, side, origin = self._lattice
        settings = {"quantization_range": float(side), "quantization_origin": [float(x) for x in origin]} if side > 0 else {}
        more = {"normals": "NORMAL", "tex_coord": "TEXCOORD_0"}
        settings |= {word: columns[name].values.astype(np.float64) for word, name in more.items() if name in columns}
        rest = {number: np.ascontiguousarray(columns[name].values) for number, name in _generic(columns)}
        return DracoPy.encode(columns["POSITION"].values.astype(np.float32), corners.reshape(-1, 3).astype(np.uint32),
                              quantization_bits=bits, compression_level=_DRACO_LEVEL, generic_attributes=rest or None,
                              normal_quantization_bits=_NORMAL_BITS, tex_coord_quantization_bits=self._uv_bits, **settings)


def _generic(columns):
    """[(number, name)] of columns for which Draco has no kind; the numbers do not collide with those of other columns."""
    return [(8 + i, name) for i, name in enumerate(name for name in columns if name not in _DRACO_KINDS)]


def _draco_ids(mesh, columns):
    """{name: Draco's number} of every column; _packed() numbered the columns without a kind."""
    ids = {attribute["attribute_type"]: attribute["unique_id"] for attribute in mesh.attributes
           if attribute["attribute_type"] in _DRACO_KINDS.values()}
    named = {name: ids[kind] for name, kind in _DRACO_KINDS.items() if name in columns}
    return named | {name: number for number, name in _generic(columns)}


class Meshopt(Plain):
    """meshopt data: vertices in order of use, positions as lattice coordinates, UVs in 16 bits, normals in 11 bits."""

    def positions(self, texf: Texf, vertex: np.ndarray) -> tuple:
        """Return positions as lattice coordinates [N, 3], and translation and scale of the node that brings them to the world."""
        if not texf.side > 0:
            return super().positions(texf, vertex)
        step = float(texf.side) / ((1 << texf.position_bits) - 1)
        lattice = texf.lattice_positions[vertex].astype(np.uint16 if texf.position_bits <= 16 else np.float32)
        return lattice, [float(x) for x in texf.origin], step

    def primitive(self, document: Document, columns: dict[str, Column], corners: np.ndarray) -> dict:
        """Add a primitive as meshopt data, its vertices sorted by use, and return its JSON dict."""
        package = _meshopt_package()
        order, corners = _by_use(package, corners, len(columns["POSITION"].values))
        attributes = {}
        for name, column in columns.items():
            values, normalized = _compact(name, column)
            if values.dtype != np.float32:
                document.use_extension(QUANTISED, required=True)
            view = _add_vertices(document, package, values[order])
            attributes[name] = document.add_description(values[order], column.kind, name == "POSITION", normalized, view)
        corners = corners.astype(index_type(len(order)))
        packed = package.encode_index_buffer(corners.astype(np.uint32), len(corners), len(order))
        view = document.add_packed_view(packed, len(corners), corners.itemsize, {"mode": "TRIANGLES"}, INDEX)
        return {"attributes": attributes, "indices": document.add_description(corners, "SCALAR", view=view)}


def _by_use(package, corners, count):
    """(order of vertices by first use, int64 [N]; corners of triangles in an order that suits vertex caches)."""
    placed = np.empty(len(corners), np.uint32)
    package.optimize_vertex_cache(placed, corners.astype(np.uint32), len(corners), count)
    used, first, number = np.unique(placed, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first, kind="stable"), kind="stable")
    return used[np.argsort(first, kind="stable")].astype(np.int64), rank[number.reshape(-1)]


def _compact(name, column):
    """(values in fewer bits, whether they are normalised) of a column."""
    values = column.values
    if name == "NORMAL" and values.dtype == np.float32:
        return (np.rint(values * 1023) * 32).astype(np.int16), True
    if name.startswith("TEXCOORD") and values.dtype == np.float32 and values.size and values.min() >= 0 and values.max() <= 1:
        return np.rint(values.astype(np.float64) * 65535).astype(np.uint16), True
    return values, column.normalized


def _add_vertices(document, package, values):
    """Index of a new compressed view of an attribute, with rows padded to four bytes."""
    row = values.itemsize * values.shape[1]
    padded = np.zeros((len(values), row + -row % 4), np.uint8)
    padded[:, :row] = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).view(np.uint8).reshape(len(values), row)
    coding = {"mode": "ATTRIBUTES"}
    if values.dtype == np.float32 and (values == np.rint(values)).all() and np.abs(values).max(initial=0) < 1 << 23:
        padded = (values.astype(np.int32) & 0xFFFFFF).astype("<u4").view(np.uint8)  # mantissas of exponent 0
        coding["filter"] = "EXPONENTIAL"
    package.encode_vertex_version(0)  # the one that the extension knows
    packed = package.encode_vertex_buffer(np.ascontiguousarray(padded), *padded.shape)
    return document.add_packed_view(packed, len(padded), padded.shape[1], coding, ARRAY)


def _meshopt_package():
    try:
        import meshoptimizer
    except ImportError as error:
        raise SupportError("TXF-O15", 'meshopt requires the package meshoptimizer: run pip install "texfcodec[formats]"',
                           value="meshoptimizer") from error
    return meshoptimizer


def smallest(name: str, column: Column) -> Column:
    """Return a column in the smallest type of glTF's core that holds its values exactly: 8 bits for colours that are multiples of
    257, 16 bits for UVs that are multiples of 1 / 65535."""
    values = column.values
    if name == "COLOR_0" and values.dtype == np.uint16 and not (values % 257).any():
        return Column((values // 257).astype(np.uint8), column.kind, True)
    if name.startswith("TEXCOORD") and values.size and values.min() >= 0 and values.max() <= 1:
        whole = np.rint(values.astype(np.float64) * 65535)
        if ((whole / 65535).astype(np.float32) == values).all():
            return Column(whole.astype(np.uint16), column.kind, True)
    return column


def index_type(count: int) -> type:
    """Return the type of indices into `count` vertices, uint16 or uint32; the index 65535 is reserved for restarts."""
    return np.uint16 if count <= 65535 else np.uint32
