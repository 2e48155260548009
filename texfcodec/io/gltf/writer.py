"""glTF 2.0 out: one primitive per material and image, GLB or .gltf with files beside it, plain or packed."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...core.json_text import json_text
from ...scene.channels import NORMAL_MAPS
from ...scene.scene import ALPHA_BLEND, ALPHA_NAMES
from ..precision import local_frame
from ..vertex_appearance import linear_u16, unique_corners, vertex_colours, vertex_maps
from .material import UNLIT, WRAPS, extensions_of, write_material
from .packing import ARRAY, MESHOPT, Column, Plain

if TYPE_CHECKING:
    from ...scene.scene import Texture
    from ...texf import Texf
    from ..formats import ImageFormat
    from ..output_textures import Textured

_COMPONENT = {"f4": 5126, "u2": 5123, "u4": 5125, "i2": 5122, "u1": 5121}
WRAP_CODES = {mode: code for code, mode in WRAPS.items()}
_POINTS = 0
OPTIONAL = {"NORMAL", "TANGENT"}  # left out of primitives that have none
_LINEAR, _NEAREST = (9729, 9987), (9728, 9728)  # filters of a sampler: linear with mipmaps; nearest
_LEVEL = 1 - 1e-5  # cosine from which two normals are one, a quarter of a degree
_EXTRAS_LIMIT = 65536  # bytes of metadata that may ride in asset.extras


class Document:
    """A glTF document under construction. json: the dict; pieces: the binary buffer so far, each piece 4-aligned."""

    def __init__(self, metadata: dict) -> None:
        """metadata: JSON-able dict, stored in asset.extras.texf if it is small, else named in warnings."""
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "texfcodec"}, "scene": 0,
                                     "scenes": [{"name": "texf"}]}
        self.pieces: list[bytes] = []
        self.length = 0
        self.unpacked = 0  # bytes of what packed views unpack to
        self.warnings: list[str] = []
        if isinstance(metadata.get("copyright"), str):
            self.json["asset"]["copyright"] = metadata["copyright"]
        if metadata:
            if len(json_text(metadata).encode()) <= _EXTRAS_LIMIT:
                self.json["asset"]["extras"] = {"texf": metadata}
            else:
                self.warnings.append(f"metadata above {_EXTRAS_LIMIT} bytes is not written")

    def add(self, kind: str, item: dict | str) -> int:
        """Append an item to a list of the document, which is created if absent; returns the index."""
        self.json.setdefault(kind, []).append(item)
        return len(self.json[kind]) - 1

    def add_view(self, data: bytes | memoryview, target: int | None = None) -> int:
        """Append bytes as a bufferView; returns its index."""
        view = {"buffer": 0, "byteOffset": self.length, "byteLength": len(data)}
        if target:
            view["target"] = target
        padded = bytes(data) + b"\0" * (-len(data) % 4)
        self.pieces.append(padded)
        self.length += len(padded)
        return self.add("bufferViews", view)

    def add_accessor(self, values: np.ndarray, kind: str, target: int | None, bounds: bool = False,
                     normalized: bool = False) -> int:
        """Append an array [N] or [N, k] (float32, uint16, uint32) as an accessor; returns its index."""
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        return self.add_description(values, kind, bounds, normalized, self.add_view(values.tobytes(), target))

    def add_description(self, values: np.ndarray, kind: str, bounds: bool = False, normalized: bool = False,
                        view: int | None = None) -> int:
        """Append an accessor for an array whose bytes are in a view that exists, or in no view; returns its index."""
        accessor = {"componentType": _COMPONENT[values.dtype.str[1:]], "count": len(values), "type": kind}
        if view is not None:
            accessor["bufferView"] = view
        if bounds:
            accessor["min"], accessor["max"] = values.min(0).tolist(), values.max(0).tolist()
        if normalized:
            accessor["normalized"] = True
        return self.add("accessors", accessor)

    def add_packed_view(self, packed: bytes, count: int, stride: int, coding: dict, target: int) -> int:
        """Append a bufferView of count elements of stride bytes, packed by meshopt; returns its index. coding: mode and filter of
        the extension."""
        inner = {"buffer": 0, "byteOffset": self.length, "byteLength": len(packed), "byteStride": stride, "count": count} | coding
        self.pieces.append(packed + b"\0" * (-len(packed) % 4))
        self.length += len(self.pieces[-1])
        view = {"buffer": 1, "byteOffset": self.unpacked, "byteLength": count * stride, "target": target,
                "extensions": {MESHOPT: inner}}
        if target == ARRAY:
            view["byteStride"] = stride
        self.unpacked += count * stride + -count * stride % 4
        self.use_extension(MESHOPT, required=True)
        return self.add("bufferViews", view)

    def use_extension(self, name: str, required: bool = False) -> None:
        """Add an extension to extensionsUsed, and to extensionsRequired if required."""
        for kind in ("extensionsUsed", "extensionsRequired")[: 1 + required]:
            if name not in self.json.get(kind, ()):
                self.json.setdefault(kind, []).append(name)

    def finish(self, uri: str | None = None) -> None:
        """Add the buffer, with its file's URI if it has one, and the placeholder buffer of packed views."""
        if self.pieces:
            self.json["buffers"] = [{"byteLength": self.length} | ({} if uri is None else {"uri": uri})]
        if self.unpacked:
            self.add("buffers", {"byteLength": self.unpacked, "extensions": {MESHOPT: {"fallback": True}}})

    def add_mesh(self, primitives: list[dict], translation: list[float] | None, scale: float | None) -> None:
        """Add a mesh and its node to the scene."""
        node: dict[str, Any] = {"mesh": self.add("meshes", {"name": "texf", "primitives": primitives})}
        if translation is not None:
            node["translation"] = translation
        if scale is not None:
            node["scale"] = [scale] * 3
            if not 1.2e-38 < scale < 3.4e38:
                self.warnings.append("the mesh exceeds the range of float32, so viewers cannot show it")
        self.json["scenes"][0]["nodes"] = [self.add("nodes", node)]


def textured(texf: Texf, mesh: Textured, images: list[tuple[ImageFormat, str | bytes]], packing: Plain | None = None) -> Document:
    """Document with images, and TEXCOORD_0 or COLOR_0 for faces that have these. images: (format, URI or bytes for the buffer) of
    each of mesh.textures; packing: of packing.py, or None for plain accessors."""
    document, packing = Document(texf.metadata), packing or Plain()
    if len(texf.faces) == 0:
        return document
    corner, corner_row = texf.faces.ravel(), np.repeat(mesh.materials.face_row, 3)
    columns = corner_columns(texf, mesh)
    keys = (np.ascontiguousarray(column.values).view(np.int32).T for column in columns.values())
    first, index = unique_corners(corner_row, corner, *(row for key in keys for row in key))
    columns = {name: column._replace(values=column.values[first]) for name, column in columns.items()}
    materials = [part.material if part.mapped else _without_direction(part.material, document.warnings)
                 for part in mesh.materials.rows]
    entries = [write_material(material, images) for material, images in zip(materials, mesh.images, strict=True)]
    groups = _Groups(corner_row[first], mesh.materials.face_row, entries, [_unused(part) for part in mesh.materials.rows])
    _add_surface(document, texf, corner[first], index.reshape(-1, 3), groups, columns, packing)
    for texture, (form, image) in zip(mesh.textures, images, strict=True):
        _add_texture(document, texture, form, image)
    return document


def _without_direction(material, warnings):
    """The material without anisotropy, for faces without UVs: anisotropy needs their direction, and viewers draw such faces
    white."""
    if not material.parameters.get("anisotropy", (0.0,))[0]:
        return material
    warnings.append(f"anisotropy of material '{material.name}' needs UVs, which its faces do not have; it is left out")
    kept = {name: value for name, value in material.parameters.items() if not name.startswith("anisotropy")}
    return replace(material, parameters=kept)


def corner_columns(texf: Texf, mesh: Textured) -> dict[str, Column]:
    """{name: Column [3 F, k]} of the corners' attributes; 0 for faces without."""
    columns = {"TEXCOORD_0": Column(mesh.corner_uv.astype(np.float32).reshape(-1, 2), "VEC2"),
               "NORMAL": Column(_written_normals(texf, mesh).reshape(-1, 3), "VEC3")}
    if mesh.corner_tangent is not None:
        columns["TANGENT"] = Column(_written_tangents(mesh).reshape(-1, 4), "VEC4")
    if any(part.colours is not None for part in mesh.materials.rows):
        columns["COLOR_0"] = Column(_written_colours(mesh.materials).reshape(-1, 4), "VEC4", True)
    return columns


def _unused(saved):
    """Names of the attributes that a primitive of a SavedMaterial does not use."""
    return ({"TEXCOORD_0"} if not saved.mapped else set()) | ({"COLOR_0"} if saved.colours is None else set())


def _written_colours(materials):
    """Colours of corners in glTF's coding, uint16 [F, 3, 4]; 0 for faces without."""
    out = np.zeros((len(materials.face_row), 3, 4), np.uint16)
    for number, saved in enumerate(materials.rows):
        if saved.colours is not None:
            out[materials.face_row == number] = linear_u16(saved.colours.rgba)[saved.colours.index]
    return out


def _written_tangents(mesh):
    """Tangents of corners, float32 [F, 3, 4]; 0 for materials without a normal map."""
    return np.where(_has_normal_map(mesh)[:, None, None], mesh.corner_tangent, np.float32(0))


def _has_normal_map(mesh):
    """Return whether the material of each face has a normal map, bool [F]."""
    return np.array([bool(NORMAL_MAPS & images.keys()) for images in mesh.images], bool)[mesh.materials.face_row]


def _written_normals(texf, mesh):
    """Normals of corners, float32 [F, 3, 3]; 0 for flat materials, because glTF shades faces without normals flat. Faces with a
    normal map keep theirs, because tangents are ignored without normals (section 3.7.2.1)."""
    normal = texf.shading_normals()
    flat = np.array([m.normals.is_flat for m in texf.materials], bool)
    level = ((normal * normal[:, [1, 2, 0]]).sum(axis=2) > _LEVEL).all(axis=1)
    for number in np.flatnonzero(~flat):  # materials whose faces all meet in sharp edges
        faces = texf.face_material == number
        flat[number] = bool(faces.any()) and bool(level[faces].all()) and _are_of_faces(texf, normal, faces)
    normal[flat[texf.face_material] & ~_has_normal_map(mesh)] = 0.0
    return normal


def _are_of_faces(texf, normal, chosen):
    """Return whether the normals of corners equal those of their faces, for faces with area. chosen: bool [F], the faces."""
    a, b, c = (texf.lattice_positions[texf.faces[chosen, k]].astype(np.float64) for k in range(3))
    across = np.cross(b - a, c - a)
    length = np.linalg.norm(across, axis=1)
    return bool(((across * normal[chosen, 0]).sum(axis=1) >= _LEVEL * length).all())


def _add_texture(document, texture, form, image):
    """Add a texture for an image, a URI or bytes. form: its ImageFormat. Textures with equal wrap and filter share a sampler."""
    name = texture.name
    if isinstance(image, str):
        entry = {"name": name, "uri": image}
    else:
        entry = {"name": name, "mimeType": form.mime, "bufferView": document.add_view(image)}
    sampler = sampler_of(texture)
    known = document.json.get("samplers", [])
    at = known.index(sampler) if sampler in known else document.add("samplers", sampler)
    source = {"source": document.add("images", entry)}
    if form.extension is not None:
        document.use_extension(form.extension, required=True)
        source = {"extensions": {form.extension: source}}
    document.add("textures", {"sampler": at} | source)


def sampler_of(texture: Texture) -> dict[str, int]:
    """The glTF sampler of a Texture."""
    magnified, minified = _NEAREST if texture.nearest else _LINEAR
    return {"magFilter": magnified, "minFilter": minified, "wrapS": WRAP_CODES[texture.wrap[0]],
            "wrapT": WRAP_CODES[texture.wrap[1]]}


def coloured(texf: Texf, packing: Plain | None = None) -> Document:
    """Document with COLOR_0 (linear) at vertices and, unless packed, further channels as _METALLIC and so on, which our loader
    reads. packing: as in textured()."""
    document = Document(texf.metadata)
    if len(texf.faces):
        vertex, index, material, rgba = vertex_colours(texf, with_material=True)
        entries = [write_material(_without_direction(m, document.warnings), {}) for m in texf.materials]
        groups = _Groups(material, texf.face_material, entries, [set()] * len(entries))
        columns = {"COLOR_0": Column(linear_u16(rgba), "VEC4", True)}
        if packing is None or type(packing) is Plain:  # packed forms hold the attributes that glTF names
            columns |= {f"_{name.upper()}": Column(values, "SCALAR" if values.shape[1] == 1 else "VEC3")
                        for name, values in vertex_maps(texf, vertex, index).items()}
        _add_surface(document, texf, vertex, index, groups, columns, packing or Plain())
    return document


def points(texf: Texf) -> Document:
    """Document with the voxel centres as a point cloud, colours in COLOR_0, unlit."""
    document = Document(texf.metadata)
    voxels = texf.voxels()
    if len(voxels["rgba"]) == 0:
        return document
    local, translation, scale = local_frame(texf, voxels["center"])
    attributes = {
        "POSITION": document.add_accessor(local, "VEC3", ARRAY, bounds=True),
        "COLOR_0": document.add_accessor(linear_u16(voxels["rgba"]), "VEC4", ARRAY, normalized=True),
    }
    material = {"name": "voxels", "extensions": {UNLIT: {}}}
    if texf.has_alpha:
        material["alphaMode"] = ALPHA_NAMES[ALPHA_BLEND]
    document.use_extension(UNLIT)
    primitive = {"attributes": attributes, "mode": _POINTS, "material": document.add("materials", material)}
    document.add_mesh([primitive], translation, scale)
    return document


def glb(document: Document) -> list:
    """The document as the pieces of a .glb file (list of bytes)."""
    document.finish()
    return glb_pieces(document.json, document.pieces, document.length)


def glb_pieces(root: dict, pieces: list, length: int) -> list:
    """The pieces of a .glb file (list of bytes). root: JSON tree; pieces: of the buffer; length: their bytes."""
    text = _text(root)
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + (8 + length if pieces else 0)
    head = [struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A), text]
    return head + ([struct.pack("<II", length, 0x004E4942), *pieces] if pieces else [])


def gltf(document: Document, buffer_uri: str) -> tuple[list, list]:
    """The document as the pieces of a .gltf file and of its buffer: (list of bytes, list of bytes)."""
    document.finish(buffer_uri)
    return [_text(document.json)], document.pieces


def _text(root):
    return json_text(root, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")


class _Groups(NamedTuple):
    """Groups of faces, each of which becomes a primitive. vertex: int64 [U], ascending, and face: int64 [F]: group of each vertex
    and face, an index into materials; materials: glTF dicts; unused: names of the attributes that each leaves out."""

    vertex: np.ndarray
    face: np.ndarray
    materials: list[dict]
    unused: list[set[str]]


def _add_surface(document, texf, vertex, index, groups, columns, packing):
    """Add a primitive with its own accessors for each group in use; vertices are sorted by group.

    vertex: int64 [U]; index: int64 [F, 3]; columns: attribute name -> Column of [U, k]; packing: of packing.py.
    """
    local, translation, scale = packing.positions(texf, vertex)
    columns = {"POSITION": Column(local, "VEC3")} | columns
    primitives = []
    for number in np.unique(groups.vertex):
        low, high = np.searchsorted(groups.vertex, (number, number + 1))
        part = {name: column._replace(values=column.values[low:high]) for name, column in columns.items()}
        part = {name: column for name, column in part.items()
                if name not in groups.unused[number] and (name not in OPTIONAL or column.values.any())}
        corners = (index[groups.face == number] - low).ravel()
        primitives.append(packing.primitive(document, part, corners) | {"material": int(number)})
    for item in groups.materials:
        document.add("materials", item)
    for name in extensions_of(groups.materials):
        document.use_extension(name)
    document.add_mesh(primitives, translation, scale)
