"""Properties of a glTF file that a stream does not carry, each named in a message.

TABLE is glTF 2.0's schema with the fate of each property. Readers name those of materials, primitives and nodes; this module
walks the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .carried import EXTENSION
from .properties import extensions, name_of

if TYPE_CHECKING:
    from ..parts import Notes
    from .document import Document

CARRIED = "carried"  # in the stream, as it is or as what it makes of the surface
LAYOUT = "layout"  # how the file stores something; nothing to carry
LABEL = "label"  # a name of something that a stream has no counterpart of
NAMED = "named"  # not carried, and named by whoever reads it

_LABELLED = {"name": LABEL}
TABLE: dict[str, dict[str, str]] = {
    "file": {"asset": ">asset", "scene": CARRIED, "scenes": ">scenes", "nodes": ">nodes", "meshes": ">meshes",
             "materials": ">materials", "textures": ">textures", "images": ">images", "samplers": ">samplers",
             "accessors": ">accessors", "bufferViews": ">bufferViews", "buffers": ">buffers", "cameras": NAMED,
             "animations": NAMED, "skins": NAMED, "extensionsUsed": LAYOUT, "extensionsRequired": LAYOUT},
    "asset": {"version": LAYOUT, "minVersion": LAYOUT, "generator": CARRIED, "copyright": CARRIED},
    "scenes": {"nodes": CARRIED, **_LABELLED},
    "nodes": {"name": CARRIED, "children": NAMED, "matrix": CARRIED, "translation": CARRIED, "rotation": CARRIED,
              "scale": CARRIED, "mesh": CARRIED, "skin": NAMED, "camera": NAMED, "weights": NAMED},
    "meshes": {"name": CARRIED, "primitives": ">primitives", "weights": CARRIED},
    "primitives": {"attributes": CARRIED, "indices": LAYOUT, "material": CARRIED, "mode": LAYOUT, "targets": NAMED},
    "materials": {key: CARRIED for key in ("name", "alphaMode", "alphaCutoff", "doubleSided", "emissiveFactor")}
    | {"pbrMetallicRoughness": ">parts of materials", "normalTexture": ">texture infos", "occlusionTexture": ">texture infos",
       "emissiveTexture": ">texture infos"},
    "parts of materials": {},  # their properties are named in gltf_material
    "texture infos": {"index": CARRIED, "texCoord": CARRIED, "scale": CARRIED, "strength": CARRIED},
    "textures": {"source": LAYOUT, "sampler": CARRIED, **_LABELLED},
    "images": {"uri": LAYOUT, "bufferView": LAYOUT, "mimeType": LAYOUT, "name": CARRIED},
    "samplers": {"wrapS": CARRIED, "wrapT": CARRIED, "magFilter": CARRIED, "minFilter": NAMED, **_LABELLED},
    "accessors": {key: LAYOUT for key in ("bufferView", "byteOffset", "componentType", "normalized", "count", "type", "max",
                                          "min")}
    | {"sparse": ">sparse accessors", **_LABELLED},
    "sparse accessors": {"count": LAYOUT, "indices": ">parts of sparse accessors", "values": ">parts of sparse accessors"},
    "parts of sparse accessors": {"bufferView": LAYOUT, "byteOffset": LAYOUT, "componentType": LAYOUT},
    "bufferViews": {key: LAYOUT for key in ("buffer", "byteOffset", "byteLength", "byteStride", "target")} | _LABELLED,
    "buffers": {"uri": LAYOUT, "byteLength": LAYOUT, **_LABELLED},
}
# Extensions that are read, by the kind of their place; those of materials are channels.PARAMETERS and channels.MAPS.
READ = {"bufferViews": {"EXT_meshopt_compression", "KHR_meshopt_compression"},
        "buffers": {"EXT_meshopt_compression", "KHR_meshopt_compression"},
        "texture infos": {"KHR_texture_transform"},
        "scenes": {EXTENSION},
        "textures": {"KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds"}}
UNSEEN = ("KHR_xmp", "EXT_mesh_manifold")  # what they say changes no picture
_ELSEWHERE = ("file", "nodes", "primitives", "materials")  # whose extensions the readers name, one by one
_LOOSE = ("materials", "parts of materials")  # whose unknown properties the readers name, too
_EXTRAS_CARRIED = ("asset", "scenes", "nodes", "meshes", "materials")  # as metadata
_WITHOUT_LEVELS = 9729  # minFilter: LINEAR
_SHARP_WHEN_SMALL = (9728, 9984, 9986)  # minFilter: NEAREST within a mip level


def name_extension(notes: Notes, extension: str, where: str) -> None:
    """Record in notes that a glTF extension is not carried into the stream: as dropped, or in a remark if it changes no picture.
    where: its place in the message, such as "node 'x'"."""
    if extension.startswith(UNSEEN):
        notes.remark(f"extension {extension} of {where} is left out")
    else:
        notes.drop(f"extension {extension} of {where}")


def name_left_out(document: Document) -> None:
    """Record in document.notes every property, extension and extra that is not carried into the stream, by TABLE."""
    _walk(document.root, "file", document.notes)


def _walk(entry: Any, kind: str, notes: Notes) -> None:
    if isinstance(entry, list):
        for item in entry:
            _walk(item, kind, notes)
        return
    if not isinstance(entry, dict):  # where it matters a reader has refused it
        return
    for key, value in entry.items():
        fate = TABLE[kind].get(key, "")
        if fate[:1] == ">":
            _walk(value, fate[1:], notes)
        elif key == "extensions":
            _walk_extensions(entry, kind, notes)
        elif key == "extras":
            if value and kind not in _EXTRAS_CARRIED:
                notes.remark(f"extras of {_the(kind)} are left out")
        elif kind in _LOOSE and key.endswith("Texture"):
            _walk(value, "texture infos", notes)
        elif not fate and kind not in _LOOSE:
            notes.remark(f"property '{key[:40]}' of {_the(kind)} is left out")
        elif key == "minFilter" and value in _SHARP_WHEN_SMALL:
            notes.remark("minFilter NEAREST of samplers is left out: decoded textures are smooth where they are small")
        elif key == "minFilter" and value == _WITHOUT_LEVELS:
            notes.remark("minFilter LINEAR of samplers is left out: decoded textures have mip levels")


def _walk_extensions(entry, kind, notes):
    for name, table in extensions(entry).items():
        if kind in _LOOSE:
            _walk(table, "parts of materials", notes)
        if kind not in _ELSEWHERE and name not in READ.get(kind, ()):
            name_extension(notes, name, _the(kind))


def _the(kind):
    return f"the {kind}" if kind in ("file", "asset") else kind


def name_variants(document: Document, extension: str) -> None:
    """Record in document.notes that material variants are dropped; the file's own materials are carried. extension: the name
    of the extension that lists them."""
    listed = extensions(document.root)[extension]
    variants = listed.get("variants") if isinstance(listed, dict) else None
    names = [name_of(entry) for entry in variants if isinstance(entry, dict)] if isinstance(variants, list) else []
    shown = ", ".join(f"'{name}'" for name in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    if names:
        document.notes.drop(f"material variants {shown}")
    else:
        document.notes.remark(f"extension {extension} of the file is left out")


def name_joined(notes: Notes, nodes: int, meshes: int) -> None:
    """Remark that several nodes become a single mesh. nodes: number of nodes with a mesh; meshes: number of different meshes."""
    if nodes > 1:
        several = f"{meshes} meshes" if meshes > 1 else "a mesh"
        notes.remark(f"{nodes} nodes that show {several} become one mesh in world space; their names stay, as metadata, "
                     "their tree does not")
