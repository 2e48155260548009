"""glTF 2.0 out: one primitive per material and image, GLB or .gltf with files beside it.

A Texf stands in a later room, so that signatures here say Any.
"""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..scene import ALPHA_BLEND, ALPHA_MASK, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT
from .appearance import linear_u16, unique_corners, vertex_colours
from .precision import local_frame

if TYPE_CHECKING:
    from .textures import Textured

_ARRAY, _INDEX = 34962, 34963  # bufferView targets
_COMPONENT = {"f4": 5126, "u2": 5123, "u4": 5125}
_WRAPS = {WRAP_REPEAT: 10497, WRAP_CLAMP: 33071, WRAP_MIRROR: 33648}
_POINTS = 0
_UNLIT = "KHR_materials_unlit"
_EXTRAS_LIMIT = 65536  # bytes of metadata that may ride in asset.extras


class Document:
    """A glTF document under construction: json is the dict, pieces the binary buffer so far (every piece 4-aligned)."""

    def __init__(self, metadata: dict) -> None:
        """metadata: JSON-able dict, kept under asset.extras.texf when it is small; warnings says when it is not."""
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "texfcodec"}, "scene": 0,
                                     "scenes": [{"name": "texf"}]}
        self.pieces: list[bytes] = []
        self.length = 0
        self.warnings: list[str] = []
        if metadata:
            if len(json.dumps(metadata).encode()) <= _EXTRAS_LIMIT:
                self.json["asset"]["extras"] = {"texf": metadata}
            else:
                self.warnings.append(f"metadata above {_EXTRAS_LIMIT} bytes is not written")

    def add(self, kind: str, item: dict) -> int:
        """Append to one of the document's lists, made when first needed; returns the index."""
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
        view = self.add_view(values.tobytes(), target)
        accessor = {"bufferView": view, "componentType": _COMPONENT[values.dtype.str[1:]], "count": len(values), "type": kind}
        if bounds:
            accessor["min"], accessor["max"] = values.min(0).tolist(), values.max(0).tolist()
        if normalized:
            accessor["normalized"] = True
        return self.add("accessors", accessor)

    def add_mesh(self, primitives: list[dict], translation: list[float] | None, scale: float | None) -> None:
        """Put one mesh on one node of the scene."""
        node: dict[str, Any] = {"mesh": self.add("meshes", {"name": "texf", "primitives": primitives})}
        if translation is not None:
            node["translation"] = translation
        if scale is not None:
            node["scale"] = [scale] * 3
            if not 1.2e-38 < scale < 3.4e38:
                self.warnings.append("the mesh is outside the range of float32: viewers cannot show it")
        self.json["scenes"][0]["nodes"] = [self.add("nodes", node)]


def textured(texf: Any, look: Textured, images: list[str | bytes]) -> Document:
    """Document with TEXCOORD_0 and images. images: for each of look.textures its URI, or its PNG for the buffer."""
    document = Document(texf.metadata)
    if len(texf.faces) == 0:
        return document
    uv = look.corner_uv.astype(np.float32).reshape(-1, 2)
    corner, looks = texf.faces.ravel(), np.repeat(look.face_look, 3)
    normal = _written_normals(texf).reshape(-1, 3)
    first, index = unique_corners(looks, corner, np.ascontiguousarray(uv).view(np.uint64).ravel(), *normal.view(np.int32).T)
    columns = {"NORMAL": (normal[first], "VEC3", False), "TEXCOORD_0": (uv[first], "VEC2", False)}
    groups = _Groups(looks[first], look.face_look, [_material(texf.materials[m], int(image)) for m, image in look.looks])
    _add_surface(document, texf, corner[first], index.reshape(-1, 3), groups, columns)
    for number, (texture, image) in enumerate(zip(look.textures, images, strict=True)):
        _add_texture(document, texture.wrap, "texf" if len(images) == 1 else f"texf_{number}", image)
    return document


def _written_normals(texf):
    """Normals of corners, float32 [F, 3, 3]; 0 where the material is flat, which glTF says by leaving them out."""
    normal = texf.shading_normals()
    flat = np.array([m.normals.angle == 0 for m in texf.materials], bool)
    normal[flat[texf.face_material]] = 0.0
    return normal


def _add_texture(document, wrap, name, image):
    """A texture of its own for an image (URI or PNG bytes); images that wrap alike share a sampler."""
    if isinstance(image, str):
        entry = {"name": name, "uri": image}
    else:
        entry = {"name": name, "mimeType": "image/png", "bufferView": document.add_view(image)}
    # linear, linear-mipmap-linear
    sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": _WRAPS[wrap[0]], "wrapT": _WRAPS[wrap[1]]}
    known = document.json.get("samplers", [])
    at = known.index(sampler) if sampler in known else document.add("samplers", sampler)
    document.add("textures", {"sampler": at, "source": document.add("images", entry)})


def coloured(texf: Any) -> Document:
    """Document with COLOR_0 (linear) at vertices."""
    document = Document(texf.metadata)
    if len(texf.faces):
        vertex, index, material, rgba = vertex_colours(texf, with_material=True)
        groups = _Groups(material, texf.face_material, [_material(m, None) for m in texf.materials])
        _add_surface(document, texf, vertex, index, groups, {"COLOR_0": (linear_u16(rgba), "VEC4", True)})
    return document


def points(texf: Any) -> Document:
    """Document with the voxel centres as a point cloud, colours in COLOR_0, unlit."""
    document = Document(texf.metadata)
    voxels = texf.voxels()
    if len(voxels["rgba"]) == 0:
        return document
    local, translation, scale = local_frame(texf, voxels["center"])
    attributes = {
        "POSITION": document.add_accessor(local, "VEC3", _ARRAY, bounds=True),
        "COLOR_0": document.add_accessor(linear_u16(voxels["rgba"]), "VEC4", _ARRAY, normalized=True),
    }
    material = {"name": "voxels", "pbrMetallicRoughness": _base_colour(None), "extensions": {_UNLIT: {}}}
    if texf.has_alpha:
        material["alphaMode"] = "BLEND"
    document.json["extensionsUsed"] = [_UNLIT]
    primitive = {"attributes": attributes, "mode": _POINTS, "material": document.add("materials", material)}
    document.add_mesh([primitive], translation, scale)
    return document


def glb(document: Document) -> list:
    """The document as the pieces of a .glb file (list of bytes)."""
    if document.pieces:
        document.json["buffers"] = [{"byteLength": document.length}]
    text = _text(document)
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + (8 + document.length if document.pieces else 0)
    pieces = [struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A), text]
    if document.pieces:
        pieces += [struct.pack("<II", document.length, 0x004E4942), *document.pieces]
    return pieces


def gltf(document: Document, buffer_uri: str) -> tuple[list, list]:
    """The document as the pieces of a .gltf file and of its buffer: (list of bytes, list of bytes)."""
    if document.pieces:
        document.json["buffers"] = [{"byteLength": document.length, "uri": buffer_uri}]
    return [_text(document)], document.pieces


def _text(document):
    return json.dumps(document.json, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()


class _Groups(NamedTuple):
    """What becomes a primitive each. vertex: int64 [U] ascending and face: int64 [F], numbers of materials; materials: glTF
    dicts."""

    vertex: np.ndarray
    face: np.ndarray
    materials: list[dict]


def _add_surface(document, texf, vertex, index, groups, columns):
    """Primitives, one per group in use, each with accessors of its own: vertices come sorted by group.

    vertex: int64 [U]; index: int64 [F, 3]; columns: attribute name -> (array [U, k], glTF type, normalized).
    """
    local, translation, scale = local_frame(texf, texf.positions[vertex])
    primitives = []
    for number in np.unique(groups.vertex):
        low, high = np.searchsorted(groups.vertex, (number, number + 1))
        attributes = {"POSITION": document.add_accessor(local[low:high], "VEC3", _ARRAY, bounds=True)}
        for name, (values, kind, normalized) in columns.items():
            if name == "NORMAL" and not values[low:high].any():
                continue
            attributes[name] = document.add_accessor(values[low:high], kind, _ARRAY, normalized=normalized)
        corners = (index[groups.face == number] - low).ravel()
        indices = corners.astype(np.uint16 if high - low <= 65535 else np.uint32)  # 65535 itself is the restart value
        primitives.append(
            {"attributes": attributes, "indices": document.add_accessor(indices, "SCALAR", _INDEX), "material": int(number)}
        )
    for item in groups.materials:
        document.add("materials", item)
    if any(item.unlit for item in texf.materials):
        document.json["extensionsUsed"] = [_UNLIT]
    document.add_mesh(primitives, translation, scale)


def _material(material, texture):
    """glTF material dict of a scene.Material; texture: index or None."""
    out = {"pbrMetallicRoughness": _base_colour(texture)}
    if material.name:
        out["name"] = material.name
    if material.alpha_mode == ALPHA_MASK:
        out["alphaMode"], out["alphaCutoff"] = "MASK", float(material.alpha_cutoff)
    if material.alpha_mode == ALPHA_BLEND:
        out["alphaMode"] = "BLEND"
    if material.double_sided:
        out["doubleSided"] = True
    if material.unlit:
        out["extensions"] = {_UNLIT: {}}
    return out


def _base_colour(texture):
    surface = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    if texture is not None:
        surface["baseColorTexture"] = {"index": texture}
    return surface
