"""glTF files -> Scene: the node graph, its meshes and materials, and the names of what is left out.

Own code rather than trimesh, which drops COLOR_0 beside a material, ignores KHR_texture_transform and wrap modes, and takes 0.9 s
to import.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError, SupportError, TexfError
from ...report import plural
from ..authored_normals import place_normals, place_tangents
from ..container.layout import is_container
from ..images import TextureShelf
from ..parts import Notes, Part, assemble, check_face_count, no_triangles
from .carried import EXTENSION, read_carried
from .document import open_document
from .left_out import name_extension, name_joined, name_left_out, name_variants
from .material import read_material, read_material_fields
from .mesh import VARIANTS, MeshReader
from .properties import extensions, integer, is_index, malformed, name_of, numbers, title
from .skin import Rest

if TYPE_CHECKING:
    from ...scene.scene import Scene
    from .document import Document

MAX_METADATA = 1 << 16  # bytes of JSON; larger extras are left behind with a name
CAMERAS = "cameras are left out"
LIGHTS = "KHR_lights_punctual"
_HONOURED = {"KHR_texture_transform", "EXT_texture_webp", "EXT_texture_avif", "KHR_draco_mesh_compression",
             "KHR_mesh_quantization", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness",
             "KHR_texture_basisu", "MSFT_texture_dds", "EXT_meshopt_compression", "KHR_meshopt_compression", EXTENSION}
_HARMLESS_WHEN_REQUIRED = ("KHR_materials_", "KHR_lights_punctual", "KHR_xmp", "EXT_lights_", "KHR_animation_pointer")


def read_gltf(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Bytes of a .glb or .gltf file -> Scene. A stream that the file carries is read in place of its meshes. folder: base of
    relative URIs. Raises errors with codes of findings.py."""
    document = open_document(data, folder, notes)
    check_required(document)
    if is_container(document.root):
        return _scene_of_container(document)
    scene = _scene_of_stream(document)
    return scene_of_nodes(document) if scene is None else scene


def _scene_of_container(document):
    """The Scene of a file whose primitives are coded in streams."""
    from ...decoder import decode_stream
    from ...options import DecodeOptions
    from ...report import Report
    from ..container.expand import expanded

    options = DecodeOptions(limits=document.notes.limits)
    return read_gltf(expanded(document, lambda stream: decode_stream(stream, options, Report()), "png"), Path(), document.notes)


def _scene_of_stream(document):
    """The Scene of the stream that the default scene carries; None if there is no stream, or if it cannot be decoded."""
    from ...decoder import decode_stream
    from ...options import DecodeOptions
    from ...report import Report
    from ..save import as_glb

    notes = document.notes
    try:
        stream = read_carried(document)
        if stream is None:
            return None
        report = Report()
        texf = decode_stream(stream, DecodeOptions(limits=notes.limits), report)
        written, save_report = as_glb(texf, texture_format="png")
        scene = read_gltf(written, Path(), Notes(notes.strict, notes.limits))
    except TexfError as error:
        notes.fault("TXF-I25", f"the carried stream cannot be decoded ({error}); its fallback is read", "the carried stream")
        return None
    size = plural(len(stream), "byte", "bytes")
    notes.remark(f"the carried stream ({size}) is read instead of its fallback")
    scene.warnings = [*notes.warnings, *report.warnings, *save_report["warnings"], *scene.warnings]
    scene.remarks = [*notes.remarks, *save_report["remarks"], *scene.remarks]
    scene.metadata = texf.metadata
    return scene


def scene_of_nodes(document: Document, is_posed: bool = False) -> Scene:
    """Return the Scene of the meshes that the default scene's nodes show. is_posed: whether morph weights move tangents too."""
    material_fields, notes = {}, document.notes

    def material_fields_of(material):
        if material is not None and not is_index(material):
            raise malformed("a material reference is not an index", value=str(material)[:40])
        if material not in material_fields:
            material_fields[material] = read_material_fields(document, material)
        return material_fields[material]

    meshes = MeshReader(document, material_fields_of, is_posed)
    parts, shown = _read_nodes(document, meshes)
    if not any(len(part.faces) for part in parts):
        raise no_triangles(", ".join(f"{plural(n, 'primitive', 'primitives')} of {kind}" for kind, n in meshes.beside.items()))
    meshes.drop_unused_uv()
    shelf = TextureShelf(notes)
    materials = [read_material(document, index, material_fields[index], shelf) for index in meshes.materials]
    _drop_rest(document, meshes.materials)
    showing = [node["mesh"] for index in shown if "mesh" in (node := document.entry("nodes", index))]
    name_joined(notes, len(showing), len(set(showing)))
    metadata = _metadata(document, shown)
    scene = assemble(parts, materials, shelf.textures, notes, metadata, meshes.pools)
    scene.flat = True  # section 3.7.2.1: what has no normals is flat
    return scene


def check_required(document: Document) -> None:
    """Raise SupportError TXF-I31 if the file requires an extension that is not supported."""
    required = document.root.get("extensionsRequired", [])
    if not isinstance(required, list):
        raise malformed("'extensionsRequired' is not an array")
    for name in required:
        if name not in _HONOURED and not str(name).startswith(_HARMLESS_WHEN_REQUIRED):
            raise SupportError("TXF-I31", "the file requires an extension that is not supported", value=str(name)[:80])


def _read_nodes(document, meshes):
    """(Parts in world space, indices of the nodes walked), depth first in file order."""
    parts, seen, faces = [], set(), 0
    stack = [(index, np.eye(4)) for index in reversed(_roots(document))]
    order, rest = [], Rest(document, local_matrix, references)
    while stack:
        index, above = stack.pop()
        node = document.entry("nodes", index)
        if index in seen:
            raise InputError("TXF-I19", "the node graph is not a tree: a node has two parents", value=index)
        seen.add(index)
        order.append(index)
        world = above @ local_matrix(node)
        if "mesh" in node:
            mesh_parts = meshes.read(_reference(node, "mesh"), skinned="skin" in node)
            placed = rest.posed(mesh_parts, node["skin"], f"node {title(node, index)}") if "skin" in node else None
            placed = placed or [place(part, world) for part in mesh_parts]
            parts += placed
            faces += sum(len(part.faces) for part in placed)
            check_face_count(faces)
        _drop_node_properties(document, node, index)
        stack += [(child, world) for child in reversed(references(node, "children"))]
    return parts, order


def _roots(document):
    """Root node indices of the default scene; in a file without scenes, all nodes without a parent."""
    scenes = document.entries("scenes")
    if not scenes:
        children = {child for node in document.entries("nodes") for child in references(node, "children")}
        return [index for index in range(len(document.entries("nodes"))) if index not in children]
    if "scene" not in document.root and len(scenes) > 1:
        document.notes.lose(f"scenes beside the first ({len(scenes)} without a default)",
                            f"the file has {len(scenes)} scenes but no default; the first is used")
    chosen = integer(document.root, "scene", 0, low=0)
    for index, scene in enumerate(scenes):
        if index != chosen:
            document.notes.remark(f"scene {title(scene, index)} is not the default and is left out")
    return references(document.entry("scenes", chosen), "nodes")


def _reference(entry, key):
    if not is_index(entry[key]):
        raise malformed(f"'{key}' is not an index", value=str(entry[key])[:40])
    return entry[key]


def references(entry: dict, key: str) -> list[int]:
    """entry[key] as a list of indices, [] if absent."""
    indices = entry.get(key, [])
    if not isinstance(indices, list) or not all(is_index(index) for index in indices):
        raise malformed(f"'{key}' is not an array of indices")
    return indices


def local_matrix(node: dict) -> np.ndarray:
    """float64 [4, 4] acting on columns; glTF 2.0 section 3.5.3."""
    if "matrix" in node:
        return np.array(numbers(node, "matrix", (0.0,) * 16)).reshape(4, 4).T
    x, y, z, w = numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))
    length = x * x + y * y + z * z + w * w
    s = 2.0 / length if length > 1e-300 else 0.0  # dividing by the squared length also normalises the quaternion
    rotation = np.array([
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * numbers(node, "scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = numbers(node, "translation", (0.0, 0.0, 0.0))
    return matrix


def place(part: Part, world: np.ndarray) -> Part:
    """The Part in world space; a mirroring transform reverses the winding (section 3.5.3)."""
    points = np.asarray(part.positions, np.float64)
    faces = part.faces
    if not np.array_equal(world, np.eye(4)):
        points = points @ world[:3, :3].T + world[:3, 3]
    if np.linalg.det(world[:3, :3]) < 0:
        faces = faces[:, [0, 2, 1]]
    return replace(part, positions=points, faces=faces, normal=place_normals(part.normal, world[:3, :3]),
                   tangent=place_tangents(part.tangent, world[:3, :3]))


def _drop_node_properties(document, node, index):
    name = f"node {title(node, index)}"
    if "skin" in node:
        document.notes.drop("skin")
    if "camera" in node:
        document.notes.remark(CAMERAS)
    if "weights" in node:
        document.notes.drop(f"morph weights of {name}")
    for extension in extensions(node):
        if extension == LIGHTS:
            document.notes.drop(extension)
        else:
            name_extension(document.notes, extension, name)


def _drop_rest(document, used_materials):
    """Name the contents of the file that are not shown meshes."""
    drop = document.notes.drop
    for index, animation in enumerate(document.entries("animations")):
        drop(f"animation {title(animation, index)}")
    if document.entries("cameras"):
        document.notes.remark(CAMERAS)
    if document.entries("skins"):
        drop("skin")
    used = set(used_materials)
    for index, material in enumerate(document.entries("materials")):
        if index not in used:
            document.notes.remark(f"no face uses material {title(material, index)}; it is left out")
    for extension in extensions(document.root):
        if extension == VARIANTS:
            name_variants(document, extension)
        elif extension == LIGHTS:
            drop(extension)
        else:
            name_extension(document.notes, extension, "the file")
    name_left_out(document)


def _metadata(document, shown):
    """Names and extras as a JSON-able dict of at most MAX_METADATA bytes; larger extras are named as dropped."""
    asset = document.root.get("asset")
    asset = asset if isinstance(asset, dict) else {}
    metadata = {key: asset[key] for key in ("generator", "copyright") if isinstance(asset.get(key), str)}
    nodes = document.entries("nodes")
    for kind, entries in (("nodes", [nodes[index] for index in shown]), ("meshes", document.entries("meshes"))):
        names = [name_of(entry) for entry in entries if name_of(entry)]
        if names:
            metadata[kind] = names
    extras = _extras(document, asset)
    if extras:
        metadata["extras"] = extras
    for key in ("extras", "nodes", "meshes", "copyright", "generator"):
        if key in metadata and len(json.dumps(metadata)) > MAX_METADATA:
            del metadata[key]
            document.notes.remark(f"{key} is left out: the metadata is larger than {MAX_METADATA} bytes")
    return metadata


def _extras(document, asset):
    extras = {"asset": asset["extras"]} if asset.get("extras") else {}
    for kind in ("scenes", "nodes", "meshes", "materials"):
        named = {name_of(entry) or str(index): entry["extras"]
                 for index, entry in enumerate(document.entries(kind)) if entry.get("extras")}
        if named:
            extras[kind] = named
    return extras
