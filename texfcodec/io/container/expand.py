"""A glTF file with coded primitives -> an ordinary glTF file: streams become accessors, indices and images again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...scene.channels import BASE_COLOUR, BY_NAME, MAPS
from ..atlas.packed_images import packed_images_of
from ..formats import AUTO
from ..gltf.accessor import read_accessor
from ..gltf.carried import EXTENSION
from ..gltf.document import open_document
from ..gltf.material import slot_of
from ..gltf.properties import extensions, integer, malformed, part
from ..gltf.writer import corner_columns, sampler_of
from ..output_textures import textured
from ..parts import Notes
from ..save_build import encoded_images
from ..saved_materials import SavedMaterial, SavedMaterials, skins_of
from ..vertex_appearance import unique_corners
from .layout import check_corners, is_container, read_primitives, streams_of
from .rewritten import ARRAY, INDEX, Rewritten

if TYPE_CHECKING:
    from ...texf import Texf
    from ..gltf.document import Document
    from ..output_textures import Textured
    from .layout import CodedPrimitive


def expand_bytes(data: bytes, folder: Path, decode: Callable[[bytes], Texf], texture_format: str = AUTO) -> bytes:
    """Return an ordinary GLB of a file whose primitives are coded in streams.

    Parameters
    ----------
    data : bytes
        A .glb or .gltf file.
    folder : Path
        Base of relative URIs.
    decode : function
        Stream -> Texf.
    texture_format : str
        As of SaveOptions.

    Returns
    -------
    bytes
        A GLB; a file without coded primitives is returned unchanged.

    Raises
    ------
    InputError, StreamError, LimitError, SupportError
        The file or a stream is at fault.
    """
    document = open_document(data, folder, Notes())
    return expanded(document, decode, texture_format) if is_container(document.root) else data


@np.errstate(all="ignore")  # positions that overflow are refused
def expanded(document: Document, decode: Callable[[bytes], Texf], texture_format: str = AUTO) -> bytes:
    """Return an ordinary GLB of a container, as expand_bytes()."""
    out = Rewritten(document)
    streams = [decode(stream) for stream in streams_of(document)]
    primitives = read_primitives(document, [len(texf.units) for texf in streams])
    for number, texf in enumerate(streams):
        Expansion(document, out, texf, [p for p in primitives if p.stream == number]).write(texture_format)
    for owner in (out.root, *out.root.get("textures", ())):
        _drop(owner)
    return out.glb()


@dataclass
class Expansion:
    """One stream of a container. primitives: those that consist of its units."""

    document: Document
    out: Rewritten
    texf: Texf
    primitives: list[CodedPrimitive]

    def write(self, texture_format: str) -> None:
        """Replace the primitives' units by accessors and their materials' images by those of the stream."""
        for coded in self.primitives:
            check_corners(coded, self.texf, _stored_count(self.document, coded, self._entry(coded)))
        mesh = textured(self.texf, self._materials())
        self._write_images(mesh, texture_format)
        columns = corner_columns(self.texf, mesh)
        starts = np.cumsum([0] + [len(unit.faces) for unit in self.texf.units])
        for coded in self.primitives:
            rows = np.concatenate([np.arange(starts[n], starts[n + 1]) for n in coded.units])
            corners = (3 * rows[:, None] + np.arange(3)).reshape(-1)
            has_image = bool(mesh.materials.has_image[rows].any())
            self._write_primitive(coded, rows, has_image, {name: column.values[corners] for name, column in columns.items()})

    def _entry(self, coded):
        return self.out.root["meshes"][coded.mesh]["primitives"][coded.number]

    def _materials(self):
        """Return the SavedMaterials of the stream: one for each material of the file and skin, with an image for each slot."""
        skins, face_skin = skins_of(self.texf)
        rows: list[SavedMaterial] = []
        face_row, known = np.full(len(self.texf.faces), -1, np.int64), {}
        starts = np.cumsum([0] + [len(unit.faces) for unit in self.texf.units])
        for coded in self.primitives:
            for unit in coded.units:
                key = self._entry(coded).get("material"), int(face_skin[starts[unit]])
                if key not in known:
                    known[key], number = len(rows), self.texf.units[unit].material
                    material = self.texf.materials[number]
                    rows.append(SavedMaterial(number, key[1], material, self._mapped(key[0], material)))
                face_row[starts[unit] : starts[unit + 1]] = known[key]
        for number, skin in enumerate(skins):
            wanted = {name for row in rows if row.skin == number for name in row.mapped}
            skin.has_base, skin.packed = BASE_COLOUR.name in wanted, packed_images_of(wanted)
        self.file_materials = [material for material, _ in known]
        if (face_row < 0).any():  # units that no primitive consists of
            rows.append(SavedMaterial(0, int(face_skin[face_row < 0][0]), self.texf.materials[0], ()))
            face_row[face_row < 0] = len(rows) - 1
        return SavedMaterials(skins, rows, face_row)

    def _mapped(self, number, material):
        """Return the channels of a material that have both a slot without an image in the file and values in the stream."""
        if number is None:
            return ()
        entry = self.document.entry("materials", number)
        return tuple(channel.name for channel in (BASE_COLOUR, *MAPS) if self._is_held(slot_of(entry, channel))
                     and (channel is BASE_COLOUR or channel.name in material.maps))

    def _is_held(self, info):
        """Return whether a textureInfo refers to a texture without an image, which a stream gives."""
        return bool(info) and is_from_stream(self.document.entry("textures", info.get("index")))

    def _write_images(self, mesh: Textured, texture_format):
        """Add the images of the stream, and name them in the materials."""
        images, _ = encoded_images(mesh, texture_format, self.texf.threads)
        numbers = []
        for texture, (form, data) in zip(mesh.textures, images, strict=True):
            image = self.out.add("images", {"mimeType": form.mime, "bufferView": self.out.add_view(data)})
            source: dict[str, Any] = {"source": image}
            if form.extension is not None:
                self.out.use_extension(form.extension, required=True)
                source = {"extensions": {form.extension: source}}
            numbers.append(self.out.add("textures", self._texture({"sampler": self._sampler(texture)} | source)))
        texcoord = {self._entry(coded).get("material"): coded.texcoord for coded in self.primitives}
        for material, images_of in zip(self.file_materials, mesh.images, strict=False):
            for name, image in images_of.items():
                info = slot_of(self.out.root["materials"][material], BY_NAME[name])
                is_new = info["index"] >= len(self.document.entries("textures"))
                if is_new and info["index"] != numbers[image]:  # two channels may share a slot, not two images
                    raise malformed("a material gets its images from several streams or fields", value=material)
                _refer(info, numbers[image], texcoord[material])

    def _texture(self, entry):
        """Return the entry of a texture of the stream."""
        return entry

    def _finish(self, primitive):
        """Complete a primitive whose attributes are written."""
        _drop(primitive)

    def _sampler(self, texture):
        sampler = sampler_of(texture)
        known = self.out.root.setdefault("samplers", [])
        return known.index(sampler) if sampler in known else self.out.add("samplers", sampler)

    def _write_primitive(self, coded, rows, has_image, columns):
        """Write one primitive. rows: its faces; has_image: whether its UVs are needed; columns: values at their corners, [3 F,
        k]."""
        entry, texf = self._entry(coded), self.texf
        vertex = coded.corners(texf).reshape(-1)
        linear = coded.matrix[:3, :3]
        mirrored = np.linalg.det(linear) < 0
        position = texf.positions[texf.faces[rows].reshape(-1)] @ linear.T + coded.matrix[:3, 3]
        values = {"POSITION": position.astype(np.float32)}
        if not np.isfinite(values["POSITION"]).all():
            raise malformed("the matrix of a primitive takes positions beyond float32")
        needs_normals = any("NORMAL" in target for target in entry.get("targets", ()))
        if columns["NORMAL"].any() or needs_normals:
            normal = columns["NORMAL"] if columns["NORMAL"].any() else texf.shading_normals()[rows].reshape(-1, 3)
            values["NORMAL"] = _unit(normal @ np.linalg.inv(linear)).astype(np.float32)
            if "TANGENT" in entry.get("attributes", {}) and "TANGENT" in columns and columns["TANGENT"].any():
                tangent = columns["TANGENT"].astype(np.float64)
                turned = _unit(tangent[:, :3] @ linear.T)
                values["TANGENT"] = np.column_stack([turned, tangent[:, 3] * (-1 if mirrored else 1)]).astype(np.float32)
        if has_image:
            values[f"TEXCOORD_{coded.texcoord}"] = columns["TEXCOORD_0"].astype(np.float32)
        faces = np.arange(len(vertex)).reshape(-1, 3)
        order = (faces[:, [0, 2, 1]] if mirrored else faces).reshape(-1)
        keys = [row for column in values.values() for row in np.ascontiguousarray(column).view(np.int32).T]
        first, index = unique_corners(vertex, *keys)
        self._write_attributes(coded, {name: column[first] for name, column in values.items()}, vertex[first])
        corners = index[order]
        corners = corners.astype(np.uint16 if len(first) <= 65535 else np.uint32)[:, None]
        entry["indices"] = self.out.add_accessor(corners, "SCALAR", target=INDEX)
        self._finish(entry)

    def _write_attributes(self, coded, values, vertex):
        """Write attributes of the stream, and repeat the stored ones. vertex: int64 [N], stored vertex of each vertex."""
        attributes, entry = {}, self._entry(coded)
        for name, column in values.items():
            number = attributes[name] = self.out.add_accessor(column, f"VEC{column.shape[1]}", target=ARRAY)
            if name == "POSITION":
                self.out.add_bounds(number, column)
        for name, number in stored_attributes(self.document, coded, entry).items():
            if name not in values:
                attributes[name] = self._repeated(number, vertex)
        entry["attributes"] = attributes
        repeated: dict[int, int] = {}
        for target in entry.get("targets", ()):
            for name, number in target.items():
                if number not in repeated:
                    repeated[number] = self._repeated(number, vertex, is_target=True)
                target[name] = repeated[number]

    def _repeated(self, number, vertex, is_target=False):
        """Return the number of a new accessor with the values of stored vertices."""
        values = read_accessor(self.document, number, ("SCALAR", "VEC2", "VEC3", "VEC4"))
        return self.out.add_stored(number, values[vertex], is_target)


def is_from_stream(texture: dict) -> bool:
    """Return whether a stream gives the image of a texture; an image of its own is then a fallback."""
    return EXTENSION in extensions(texture) or texture.keys().isdisjoint(("source", "extensions"))


def stored_attributes(document: Document, coded: CodedPrimitive, primitive: dict) -> dict[str, int]:
    """Return the accessors of a coded primitive's attributes that are stored for the stream's vertices: those with values in the
    file, if they are no fallback. primitive: its JSON, with accessors of the document."""
    numbers = {} if coded.has_fallback else part(primitive, "attributes")
    return {name: number for name, number in numbers.items()
            if not document.entry("accessors", number).keys().isdisjoint(("bufferView", "sparse"))}


def _stored_count(document, coded, primitive):
    """Return the number of values of the stored attributes of a primitive, None without any. Raises InputError TXF-I09 if they
    differ."""
    numbers = list(stored_attributes(document, coded, primitive).values())
    numbers += [n for target in primitive.get("targets", ()) for n in target.values()]
    counts = {integer(document.entry("accessors", n), "count", low=1) for n in numbers}
    if len(counts) > 1:
        raise InputError("TXF-I09", "the stored attributes of a primitive differ in count", value=sorted(map(str, counts)))
    return counts.pop() if counts else None


def _unit(vectors):
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)


def _refer(info, texture, texcoord):
    """Make a textureInfo refer to a texture of the stream."""
    info["index"] = texture
    info.pop("texCoord", None)
    if texcoord:
        info["texCoord"] = texcoord
    table = extensions(info)
    table.pop("KHR_texture_transform", None)
    if "extensions" in info and not table:
        del info["extensions"]


def _drop(owner):
    """Remove the extension from an object, if it is there."""
    owner.get("extensions", {}).pop(EXTENSION, None)
    if owner.get("extensions") == {}:
        del owner["extensions"]
