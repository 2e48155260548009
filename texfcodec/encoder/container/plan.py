"""Which primitives of a glTF file are coded, in which stream and where in its space (encoder only).

A primitive is coded if it is made of triangles. Its material's images are coded if every primitive that shows them is, and if
nothing but the default material of these primitives needs them. What the stream does not hold is stored beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import LimitError, TexfError
from ...io.container.layout import FROM_STREAM
from ...io.container.references import texture_infos
from ...io.gltf.accessor import read_floats
from ...io.gltf.carried import EXTENSION
from ...io.gltf.material import read_material, read_material_fields, slot_of
from ...io.gltf.mesh import VARIANTS, MeshReader
from ...io.gltf.properties import extensions, is_index
from ...io.gltf.properties import part as part_of
from ...io.gltf.reader import local_matrix, references
from ...io.images import TextureShelf
from ...io.parts import Notes
from ...scene.channels import BASE_COLOUR, BY_NAME
from ...scene.scene import Material

if TYPE_CHECKING:
    from ...io.gltf.document import Document
    from ...io.gltf.material import MaterialFields
    from ...io.parts import Part

_INSTANCES = "EXT_mesh_gpu_instancing"
_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
_SIZES = 64.0  # ratio of sizes from which on two meshes have lattices of their own; chosen, not measured
_TRIANGLES = (4, 5, 6)


class KeptNotes(Notes):
    """Notes of a reader whose caller keeps in the file what the reader leaves out, guesses or repairs: nothing is lost."""

    def drop(self, name: str) -> None:
        """Ignore the name: the property stays in the file."""

    def remark(self, sentence: str) -> None:
        """Ignore what a reader says of such properties."""

    def warn(self, sentence: str) -> None:
        """Ignore what a reader says of such properties."""

    def fault(self, code: str, message: str, name: str, **details: object) -> None:
        """Remark that something stays in the file as it is."""
        super().remark(f"{name} stays in the file as it is ({code})")


@dataclass(kw_only=True)
class CodedPart:
    """A primitive that is coded. mesh, number: its place in the file; part: in mesh space; material: index in the file, or None;
    stored: names of attributes that are stored; has_targets: whether it has morph targets; place: float64 [4, 4], from mesh space
    to the stream's space; cluster: equal for parts that share images, directly or not, and so must be in one stream."""

    mesh: int
    number: int
    part: Part
    material: int | None
    stored: tuple[str, ...]
    has_targets: bool
    place: np.ndarray = field(default_factory=lambda: np.eye(4))
    cluster: int = 0

    @property
    def keeps_vertices(self) -> bool:
        """True if values are stored for its vertices."""
        return bool(self.stored) or self.has_targets


@dataclass(kw_only=True)
class Plan:
    """Decisions on a file. streams: parts of each stream; materials: as a stream holds them, by index in the file, with
    textures of `textures`; slots: coded channels of each material; texcoord: number of the UV set that streams give it; reader:
    of the file's meshes; remarks: why primitives and images are not coded."""

    streams: list[list[CodedPart]]
    materials: dict[int | None, Material]
    textures: list
    slots: dict[int | None, tuple[str, ...]]
    texcoord: dict[int | None, int]
    reader: MeshReader
    remarks: list[str]

    def leave(self, parts: list[CodedPart], reason: str, coded: list[CodedPart]) -> None:
        """Leave parts as they are in the file, with images that no coded part of their stream shows. reason: for a remark."""
        shown = {part.material for part in coded}
        for part in parts:
            if part.material not in shown:
                self.slots[part.material] = ()
            self.remarks.append(f"primitive {part.number} of mesh {part.mesh} stays as it is: {reason}")


@np.errstate(all="ignore")  # overflow and NaN are values that primitives are left out for
def plan_of(document: Document) -> Plan:
    """Return the Plan of a file. Raises InputError, LimitError, SupportError."""
    shelf = TextureShelf(document.notes)
    remarks: list[str] = []
    fields: dict[int | None, MaterialFields] = {}
    reader = MeshReader(document, lambda material: fields.setdefault(material, read_material_fields(document, material)))
    parts, idle = _read_parts(document, reader, remarks)
    materials = {material: read_material(document, material, fields[material], shelf)
                 for material in dict.fromkeys(part.material for part in parts)}
    pinned = _pinned_materials(document, idle) | _materials_without_uv(document, parts, fields)
    slots = {number: () if number in pinned else _channels(material) for number, material in materials.items()}
    _add_stored(document, parts, slots)
    texcoord: dict[int | None, int] = {}
    for number in materials:
        taken = {name for part in parts if part.material == number for name in part.stored}
        texcoord[number] = next(n for n in range(len(taken) + 1) if f"TEXCOORD_{n}" not in taken)
    _place_parts(document, parts)
    reduced = {number: _reduced(material, slots[number]) for number, material in materials.items()}
    return Plan(streams=_grouped(parts, reduced), materials=reduced, textures=shelf.textures, slots=slots, texcoord=texcoord,
                reader=reader, remarks=[*remarks, *document.notes.remarks])


def _read_parts(document, reader, remarks):
    """Return (CodedParts, entries of the primitives that are not coded)."""
    parts, idle = [], []
    for mesh, entry in enumerate(document.entries("meshes")):
        for number, primitive in enumerate(entry.get("primitives", [])):
            part = _read_part(reader, mesh, number, primitive, remarks)
            if part is None:
                idle.append(primitive)
            else:
                parts.append(CodedPart(mesh=mesh, number=number, part=part, material=primitive.get("material"), stored=(),
                                       has_targets=bool(primitive.get("targets"))))
    return parts, idle


def _read_part(reader, mesh, number, primitive, remarks):
    """Return the Part of a primitive; None if it is not made of triangles or cannot be read."""
    if primitive.get("mode", 4) not in _TRIANGLES or "POSITION" not in primitive.get("attributes", {}) \
            or EXTENSION in extensions(primitive):
        return None
    try:
        part = reader.unposed(mesh, number)
        if part is None or not len(part.faces) or part.faces.max() >= len(part.positions):
            return None
        reader.stored(mesh, number)  # so that nothing fails once it is coded
        used = np.asarray(part.positions, np.float64)[part.faces]
        area = np.cross(used[:, 1] - used[:, 0], used[:, 2] - used[:, 0])
        return part if np.isfinite(used).all() and area.any() else None
    except LimitError:
        raise
    except TexfError as error:
        remarks.append(f"primitive {number} of mesh {mesh} stays as it is: {error.message}")
        return None


def _pinned_materials(document, idle):
    """Return the materials whose images cannot be coded: something beside the coded primitives shows them, or animates them."""
    pinned = {primitive.get("material") for primitive in idle}
    for mesh in document.entries("meshes"):
        for primitive in mesh.get("primitives", []):
            pinned |= _alternatives(primitive) - {primitive.get("material")}
    for animation in document.entries("animations"):
        for channel in animation.get("channels", []):
            pointer = str(extensions(channel.get("target", {})).get("KHR_animation_pointer", {}).get("pointer", "")).split("/")
            if pointer[1:2] == ["materials"] and "KHR_texture_transform" in pointer and pointer[2].isdecimal():
                pinned.add(int(pointer[2]))
    for number, entry in enumerate(document.entries("materials")):
        if _SPECULAR_GLOSSINESS in extensions(entry):
            pinned.add(number)
    return pinned


def _materials_without_uv(document, parts, fields):
    """Return the materials of which a primitive lacks a UV set that an image needs: a stream would hold a single texel of it."""
    return {part.material for part in parts for info in fields[part.material].images.values()
            if f"TEXCOORD_{info.texcoord}" not in document.entries("meshes")[part.mesh]["primitives"][part.number]["attributes"]}


def _alternatives(primitive):
    """Return the materials of a primitive's variants."""
    mappings = extensions(primitive).get(VARIANTS, {}).get("mappings", [])
    return {mapping.get("material") for mapping in mappings if is_index(mapping.get("material"))}


def _channels(material):
    """Return the names of the channels that a Material has an image of."""
    return ((BASE_COLOUR.name,) if material.texture >= 0 else ()) + tuple(material.maps)


def _add_stored(document, parts, slots):
    """Fill in the attributes that are stored: those that no stream holds, and UVs of images that are not coded."""
    for part in parts:
        primitive = document.entries("meshes")[part.mesh]["primitives"][part.number]
        needed = set()
        for number in {part.material, *_alternatives(primitive)} - {None}:
            entry = document.entry("materials", number)
            coded = slots.get(number, ()) if number == part.material else ()
            infos = [slot_of(entry, BY_NAME[name]) for name in coded]
            for info in texture_infos(entry):
                if not any(info is coded_info for coded_info in infos):
                    usual = info.get("texCoord", 0)
                    transformed = extensions(info).get("KHR_texture_transform", {}).get("texCoord", usual)
                    needed |= {f"TEXCOORD_{usual}", f"TEXCOORD_{transformed}"}
        part.stored = tuple(name for name in primitive["attributes"] if name in needed
                            or not (name in FROM_STREAM or name.startswith("TEXCOORD_")))


def _reduced(material, slots):
    """Return a Material as the stream holds it: factors of its images stay in the file."""
    maps = {name: texture for name, texture in material.maps.items() if name in slots}
    parameters = {name: value for name, value in material.parameters.items()
                  if not any(BY_NAME[channel].over and BY_NAME[channel].parameter == name for channel in maps)}
    has_base = BASE_COLOUR.name in slots
    return Material(name=material.name, factor=np.ones(4) if has_base else material.factor,
                    texture=material.texture if has_base else -1, alpha_mode=material.alpha_mode,
                    alpha_cutoff=material.alpha_cutoff, double_sided=material.double_sided, unlit=material.unlit, maps=maps,
                    parameters=parameters)


def _place_parts(document, parts):
    """Place each part where the largest node that shows its mesh stands at rest; meshes that deform stay in mesh space."""
    worlds = _worlds(document)
    for part in parts:
        world = worlds.get(part.mesh)
        if world is None or part.has_targets or "JOINTS_0" in part.stored:
            continue
        if 1e-30 < np.linalg.det(world[:3, :3]) < 1e30 and np.linalg.cond(world[:3, :3]) < 1e4:
            part.place = world


def _worlds(document) -> dict[int, np.ndarray]:
    """Return the largest world matrix of the nodes that show a mesh, by mesh. Nodes on a cycle have none."""
    nodes = document.entries("nodes")
    children = {child for node in nodes for child in references(node, "children")}
    result: dict[int, np.ndarray] = {}
    sizes: dict[int, float] = {}
    pending: list[tuple[int, Any]] = [(n, np.eye(4)) for n in range(len(nodes)) if n not in children]
    seen: set[int] = set()
    while pending:
        number, above = pending.pop()
        if number in seen or number >= len(nodes):
            continue
        seen.add(number)
        world = above @ local_matrix(nodes[number])
        shown = world @ np.diag([*_instance_scale(document, nodes[number]), 1.0])
        mesh, size = nodes[number].get("mesh"), abs(np.linalg.det(shown[:3, :3]))
        if is_index(mesh) and np.isfinite(shown).all() and size > sizes.get(mesh, -1.0):
            result[mesh], sizes[mesh] = shown, size
        pending += [(child, world) for child in references(nodes[number], "children")]
    return result


def _instance_scale(document, node):
    """Return the scale of the largest instance that EXT_mesh_gpu_instancing makes of a node's mesh, float64 [3], not negative;
    ones without readable scales."""
    attributes = extensions(node).get(_INSTANCES, {})
    try:
        scales = np.abs(read_floats(document, part_of(attributes, "attributes")["SCALE"], ("VEC3",)).astype(np.float64))
    except (KeyError, TexfError):  # the file keeps the extension as it is
        return np.ones(3)
    return scales[np.nan_to_num(scales.prod(axis=1), posinf=0.0).argmax()]


def _grouped(parts, materials):
    """Return the parts of each stream: those that share images, directly or not, are in one; those whose vertices are kept are
    apart, and so are those of other sizes."""
    joined: dict[Any, Any] = {}

    def root(key):
        while joined.setdefault(key, key) != key:
            key = joined[key]
        return key

    keys = []
    for number, part in enumerate(parts):
        material = materials[part.material]
        shown = [material.texture, *material.maps.values()]
        keys.append(("part", number))
        for texture in shown:
            if texture >= 0:
                joined[root(("texture", texture))] = root(keys[-1])
    clusters: dict[Any, list[CodedPart]] = {}
    for key, part in zip(keys, parts, strict=True):
        clusters.setdefault(root(key), []).append(part)
    for number, cluster in enumerate(clusters.values()):
        for part in cluster:
            part.cluster = number
    sizes = {key: max(map(_size, cluster)) for key, cluster in clusters.items()}
    largest = max(sizes.values(), default=1.0)
    streams: dict[tuple, list[CodedPart]] = {}
    for key, cluster in clusters.items():
        kept = any(part.keeps_vertices for part in cluster)
        streams.setdefault((kept, int(math.log(largest / sizes[key], _SIZES))), []).extend(cluster)
    return [_at_rest(streams[key]) for key in sorted(streams)]


def clusters_of(parts: list[CodedPart]) -> list[list[CodedPart]]:
    """Return the parts of a stream as those of several, which share no images."""
    numbers = dict.fromkeys(part.cluster for part in parts)
    return [_at_rest([part for part in parts if part.cluster == number]) for number in numbers]


def _at_rest(parts):
    """Return the parts of a stream, in mesh space if they stand at one place: where that is does not matter."""
    if all(np.array_equal(part.place, parts[0].place) for part in parts):
        for part in parts:
            part.place = np.eye(4)
    return parts


def _size(part):
    """Return the longest side of a part's box in the stream's space."""
    points = np.asarray(part.part.positions, np.float64)[part.part.faces].reshape(-1, 3) @ part.place[:3, :3].T
    return float(np.ptp(points, axis=0).max())

