"""Stanford PLY -> Scene: ascii and both binary orders, colours, UVs per vertex or per face corner; and decoded streams -> binary
little-endian PLY with sRGB vertex colours.

Own code rather than trimesh, which costs 0.9 s to import and forgets the file's TextureFile comment in some layouts.
An element whose lists all have the same length is read as one structured array; mixed lengths take a Python loop.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..scene.scene import WRAP_REPEAT, Material, Scene
from ..scene.srgb import to_bytes
from .images import TextureShelf, read_texture_file
from .mtl import decode_text
from .parts import Notes, Part, assemble, drop_alpha, linear_rgba
from .polygons import parse_numbers, triangulate
from .precision import float32_is_enough
from .vertex_appearance import vertex_colours
from .written_normals import are_lit, normals_at_vertices

if TYPE_CHECKING:
    from ..texf import Texf

_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
          "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
          "double": "f8", "float64": "f8"}
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_COLOR_NAMES = (("red", "green", "blue", "alpha"), ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
                ("r", "g", "b", "a"))
_NORMALS = ("nx", "ny", "nz")
_WRITTEN = ("red", "green", "blue", "alpha")


@dataclass
class _Element:
    """properties: list of (name, dtype letter, count dtype letter or None)."""

    name: str
    count: int
    properties: list = field(default_factory=list)


@dataclass
class _Header:
    form: str
    elements: list
    textures: list
    comments: list
    size: int


def read_ply(data: bytes, folder: Path, notes: Notes) -> Scene:
    """bytes of a .ply file -> Scene. folder: where its textures are. Errors: TXF-I21."""
    header = _read_header(data)
    tables = _read_elements(data, header)
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    for name in tables.keys() - {"vertex", "face"}:
        notes.remark(f"PLY element '{name}' is left out")
    if any(axis not in vertex for axis in "xyz"):
        raise InputError("TXF-I21", "the PLY file has no vertices with x, y and z")
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if lists is None or not len(lists[0]):
        raise InputError("TXF-I15", "the input has no triangles")
    points, indices = np.stack([vertex[axis] for axis in "xyz"], axis=1), _whole(lists[0])
    corners, row_of = triangulate(points, indices, np.asarray(lists[1], np.int64), notes)
    shelf = TextureShelf(notes)
    materials = _materials(header, folder, shelf)
    part = Part(points, indices[corners], _face_material(face, row_of, materials), _uv(vertex, face, corners, row_of),
                _color(vertex, face, row_of), "the PLY file", normal=_normal(vertex))
    _drop_rest(vertex, face, part, header, notes)
    metadata = {"comments": header.comments} if header.comments else {}
    return assemble([part], materials, shelf.textures, notes, metadata)


def _bad(what, **details):
    return InputError("TXF-I21", f"the PLY file is malformed: {what}", **details)


def _read_header(data):
    end = data.find(b"end_header")
    if end < 0:
        raise _bad("its header has no end")
    stop = data.find(b"\n", end)
    header = _Header("", [], [], [], len(data) if stop < 0 else stop + 1)
    for number, line in enumerate(decode_text(data[:end]).splitlines(), 1):
        words = line.split()
        try:
            if words:
                _header_line(header, words, line)
        except (IndexError, ValueError, KeyError) as error:
            raise _bad("a header line cannot be read", line=number, value=line[:80]) from error
    if header.form not in _ORDERS:
        raise _bad("its format is unknown", value=header.form[:40])
    return header


def _header_line(header, words, line):
    if words[0] == "format":
        header.form = words[1]
    elif words[0] in ("comment", "obj_info"):
        text = line.split(None, 1)[1] if len(words) > 1 else ""
        if len(words) > 2 and words[1].lower() == "texturefile":
            header.textures.append(text.split(None, 1)[1].strip())
        elif text and len(header.comments) < 100:
            header.comments.append(text[:500])
    elif words[0] == "element":
        header.elements.append(_Element(words[1], int(words[2])))
        if header.elements[-1].count < 0:
            raise ValueError("negative count")
    elif words[0] == "property":
        properties = header.elements[-1].properties
        if words[1] == "list":
            properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
        else:
            properties.append((words[2], _TYPES[words[1]], None))


def _read_elements(data, header):
    """{element: {property: array [n], or for lists (values [sum], lengths [n])}}"""
    is_text = header.form == "ascii"
    reader = _Ascii(data[header.size :]) if is_text else _Binary(data, header.size, _ORDERS[header.form])
    tables = {}
    for element in header.elements:
        if not element.properties:  # would cost no bytes per row, so its count could not be checked
            raise _bad(f"element '{element.name}' has no properties")
        tables[element.name] = reader.read(element)
    return tables


class _Ascii:
    """Every number of the body at once, as float64; elements are cut from it."""

    def __init__(self, body):
        values = parse_numbers(bytes(body), np.float64)
        if values is None:
            raise _bad("its body contains text that is not a number")
        self.values, self.at = values, 0

    def read(self, element):
        if not any(counter for _, _, counter in element.properties):
            block = self._take(element.count * len(element.properties), element)
            block = block.reshape(element.count, -1) if element.count else block.reshape(0, len(element.properties))
            return {name: _stored(block[:, i], kind) for i, (name, kind, _) in enumerate(element.properties)}
        return self._uniform(element) or _read_rows(element, lambda kind, count: self._take(count, element))

    def _take(self, count, element):
        if self.at + count > len(self.values):
            raise _bad(f"it ends within element '{element.name}'", value=len(self.values) - self.at, allowed=count)
        self.at += count
        return self.values[self.at - count : self.at]

    def _uniform(self, element):
        """All rows as long as the first: one reshape. None when they are not."""
        lengths: list[int | None] = []
        width = 0
        for _, _, counter in element.properties:
            if counter is None:
                lengths.append(None)
                width += 1
                continue
            if self.at + width >= len(self.values) or not 0 <= self.values[self.at + width] <= len(self.values):
                return None
            lengths.append(int(self.values[self.at + width]))
            width += 1 + int(self.values[self.at + width])
        if self.at + width * element.count > len(self.values):
            return None
        block = self.values[self.at : self.at + width * element.count].reshape(element.count, width)
        table: dict = {}
        column = 0
        for (name, kind, _), length in zip(element.properties, lengths, strict=True):
            if length is None:
                table[name] = _stored(block[:, column], kind)
                column += 1
                continue
            if (block[:, column] != length).any():
                return None
            values = block[:, column + 1 : column + 1 + length].reshape(-1)
            table[name] = _stored(values, kind), np.full(element.count, length)
            column += 1 + length
        self.at += width * element.count
        return table


class _Binary:
    def __init__(self, data, at, order):
        self.data, self.at, self.order = data, at, order

    def read(self, element):
        return self._uniform(element) or _read_rows(element, lambda kind, count: self._take(kind, count, element))

    def _take(self, kind, count, element):
        dtype = np.dtype(self.order + kind)
        if self.at + count * dtype.itemsize > len(self.data):
            raise _bad(f"it ends within element '{element.name}'", offset=len(self.data))
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def _uniform(self, element):
        """The element as one structured array when every list is as long as in the first row; else None."""
        fields: list[tuple] = []
        lengths: list[int | None] = []
        at = self.at
        for i, (_, kind, counter) in enumerate(element.properties):
            length = None
            if counter is not None:
                dtype = np.dtype(self.order + counter)
                if at + dtype.itemsize > len(self.data):
                    return None
                length = int(np.frombuffer(self.data, dtype, 1, at)[0])
                if not 0 <= length <= len(self.data):
                    return None
                fields.append((f"n{i}", self.order + counter))
                at += dtype.itemsize
            fields.append((f"p{i}", self.order + kind) if length is None else (f"p{i}", self.order + kind, (length,)))
            at += np.dtype(kind).itemsize * (1 if length is None else length)
            lengths.append(length)
        size = at - self.at
        if self.at + size * element.count > len(self.data) or not size:
            return None
        block = np.frombuffer(self.data, np.dtype(fields), element.count, self.at)
        if any((block[f"n{i}"] != length).any() for i, length in enumerate(lengths) if length is not None):
            return None
        self.at += size * element.count
        return {name: block[f"p{i}"] if lengths[i] is None else (block[f"p{i}"].reshape(-1), np.full(len(block), lengths[i]))
                for i, (name, _, _) in enumerate(element.properties)}


def _read_rows(element, take):
    """Row by row, for lists of different lengths. take: (dtype letter, count) -> the next values."""
    table: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in element.properties}
    for _ in range(element.count):
        for name, kind, counter in element.properties:
            length = 1 if counter is None else int(take(counter, 1)[0])
            if length < 0:
                raise _bad("a list has a negative length")
            table[name].append(take(kind, length))
    out = {}
    for name, kind, counter in element.properties:
        rows = table[name]
        values = np.concatenate(rows) if rows else np.zeros(0, kind)
        values = _stored(values, kind)
        out[name] = values if counter is None else (values, np.array([len(row) for row in rows], np.int64))
    return out


def _stored(values, kind):
    """Numbers of an ascii file in their declared type, so that uchar colours are recognised; large ones stay floats."""
    if kind[0] == "f" or values.dtype.kind != "f":
        return values
    info = np.iinfo(kind)
    inside = np.isfinite(values) & (values >= info.min) & (values <= info.max)
    return values.astype(kind) if inside.all() else values


def _whole(values):
    """Vertex indices as int64; what is no index becomes -1, which assemble refuses."""
    if values.dtype.kind != "f":
        return values.astype(np.int64)
    return np.where(np.isfinite(values) & (np.abs(values) < 2**53), values, -1).astype(np.int64)


def _materials(header, folder, shelf):
    if not header.textures:
        return [Material("default")]
    return [Material(name, texture=shelf.put(name, lambda name=name: read_texture_file(folder, name), name,
                                             (WRAP_REPEAT, WRAP_REPEAT))) for name in header.textures]


def _face_material(face, row_of, materials):
    """MeshLab's texnumber per face; -1 and numbers out of range mean the first."""
    number = face.get("texnumber")
    if number is None or isinstance(number, tuple):
        return 0
    number = _whole(np.asarray(number))[row_of]
    return np.where((number >= 0) & (number < len(materials)), number, 0)


def _uv(vertex, face, corners, row_of):
    """float64 [V, 2], or [F, 3, 2] from MeshLab's texcoord list; v turned downwards. None when there is none."""
    coordinates, lists = face.get("texcoord"), face.get("vertex_indices", face.get("vertex_index"))
    if isinstance(coordinates, tuple) and np.array_equal(coordinates[1], 2 * np.asarray(lists[1])):
        uv = np.asarray(coordinates[0], np.float64).reshape(-1, 2)[corners]
    else:
        names = next((names for names in _UV_NAMES if names[0] in vertex and names[1] in vertex), None)
        if names is None:
            return None
        uv = np.stack([np.asarray(vertex[name], np.float64) for name in names], axis=1)
    uv[..., 1] = 1.0 - uv[..., 1]
    return uv


def _color(vertex, face, row_of):
    """float32 linear RGBA [V, 4] or, per face, [F, 3, 4]; None when there is none."""
    for table in (vertex, face):
        for names in _COLOR_NAMES:
            present = [name for name in names if name in table and not isinstance(table[name], tuple)]
            if len(present) >= 3 and present[:3] == list(names[:3]):
                color = linear_rgba(np.stack([_unit(table[name]) for name in present], axis=1))
                return color if table is vertex else np.repeat(color[row_of][:, None], 3, axis=1)
    return None


def _normal(vertex):
    """float64 [V, 3], or None."""
    if any(name not in vertex or isinstance(vertex[name], tuple) for name in _NORMALS):
        return None
    return np.stack([np.asarray(vertex[name], np.float64) for name in _NORMALS], axis=1)


def _unit(values):
    """Colour samples to [0, 1]: by type for integers, as they are for floats."""
    values = np.asarray(values)
    if values.dtype.kind == "f":
        return values / 255.0 if values.size and np.nanmax(values) > 1.0 else values
    return values / float(np.iinfo(values.dtype).max)


def _drop_rest(vertex, face, part, header, notes):
    known = {"x", "y", "z", "vertex_indices", "vertex_index", "texnumber", "texcoord", *_NORMALS}
    known.update(name for names in (*_UV_NAMES, *_COLOR_NAMES) for name in names)
    drop_alpha(part.color, notes)
    if part.uv is not None and not header.textures:
        notes.remark("texture coordinates are left out: the file names no TextureFile")
    if part.uv is None and header.textures:
        notes.warn("the file names a texture but has no texture coordinates; UV (0, 0) is used")
    for table, kind in ((vertex, "vertex"), (face, "face")):
        for name in table:
            if name not in known:
                notes.remark(f"PLY property '{name}' of {kind} is left out")


def write_ply_surface(texf: Texf, dropped: list[str]) -> list:
    """Pieces of a PLY file: mesh with vertex colours (u8 sRGB, alpha only if the stream has any), and normals where every vertex
    has one of its own; dropped: gets a name where it has several, which would tear the surface."""
    vertex, index, _, rgba = vertex_colours(texf, with_material=False)
    faces = np.empty(len(index), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, index
    normals = None
    if len(index) and are_lit(texf):
        normals = normals_at_vertices(texf, index, len(vertex))
        dropped += ["the shading of hard edges"] * (normals is None)
    vertices, lines = _write_vertices(texf, texf.positions[vertex], to_bytes(rgba), normals)
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return [_write_header(lines), vertices.data, faces.data]


def write_ply_points(texf: Texf) -> list:
    """Pieces of a PLY file: voxel centres with colours."""
    voxels = texf.voxels()
    vertices, lines = _write_vertices(texf, voxels["center"], voxels["rgba"])
    return [_write_header(lines), vertices.data]


def _write_vertices(texf, points, rgba, normals=None):
    """Packed vertex records and their header lines; double coordinates where float would lose the lattice."""
    kind, name = ("<f4", "float") if float32_is_enough(texf) else ("<f8", "double")
    channels = _WRITTEN[: 4 if texf.has_alpha else 3]
    fields = [("p", kind, 3), ("n", "<f4", 3), ("c", "u1", len(channels))]
    records = np.empty(len(points), np.dtype([f for f in fields if f[0] != "n" or normals is not None]))
    records["p"], records["c"] = points, rgba[:, : len(channels)]
    lines = [f"element vertex {len(points)}", *(f"property {name} {axis}" for axis in "xyz")]
    if normals is not None:
        records["n"] = normals
        lines += [f"property float {axis}" for axis in _NORMALS]
    return records, lines + [f"property uchar {channel}" for channel in channels]


def _write_header(lines):
    return "\n".join(["ply", "format binary_little_endian 1.0", "comment texfcodec", *lines, "end_header", ""]).encode()
