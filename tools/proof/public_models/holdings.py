"""What a source holds beside its look, and which of it a decoded file does not: the table against which reports are read."""

import json
import re
import struct

from texfcodec.io.gltf.document import CHUNK_JSON, GLB_MAGIC

NEAREST, LINEAR = 9728, 9729
SLOTS = (("normalTexture", r"normal.?(texture|map)"), ("occlusionTexture", r"occlusion"), ("emissiveTexture", r"emissive"),
         ("metallicRoughnessTexture", r"metallic|roughness"))
# Extensions that another way of writing the same look replaces, and those with a row of their own below.
REPLACED = {"KHR_texture_transform", "EXT_texture_webp", "EXT_texture_avif", "KHR_texture_basisu", "MSFT_texture_dds",
            "KHR_draco_mesh_compression", "KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression",
            "KHR_materials_variants", "KHR_lights_punctual"}


def _entries(entry, key):
    """The objects in an array of a JSON object, whatever else a broken file has there."""
    entries = entry.get(key)
    return [item for item in entries if isinstance(item, dict)] if isinstance(entries, list) else []


def _objects(root):
    """Every object of a JSON tree."""
    stack = [root]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            yield item
        stack += item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()


def _primitives(root):
    return [primitive for mesh in _entries(root, "meshes") for primitive in _entries(mesh, "primitives")]


def _extensions(root):
    """Names of the extensions that are used anywhere in a JSON tree."""
    return {name for item in _objects(root) if isinstance(item.get("extensions"), dict) for name in item["extensions"]}


def _has_slot(root, slot):
    return any(slot in item for entry in _entries(root, "materials") for item in _objects(entry))


def _has_extras(root):
    kept = root.get("asset", {}).get("extras", {})  # where a decoded GLB has the metadata of its stream
    return "extras" in (kept.get("texf") or {} if isinstance(kept, dict) else {}) or any(
        entry.get("extras") for kind in ("nodes", "meshes", "materials", "scenes") for entry in _entries(root, kind))


# What a glTF file may hold, the words that name it in a report, and whether a JSON tree has it.
TABLE = (
    ("animations", r"animation", lambda root: _entries(root, "animations")),
    ("skins", r"skin|joint", lambda root: any("skin" in node for node in _entries(root, "nodes"))),
    ("morph targets", r"morph|target", lambda root: any(p.get("targets") for p in _primitives(root))),
    ("variants", r"variant", lambda root: "KHR_materials_variants" in _extensions(root)),
    ("node tree", r"\bnodes?\b|hierarchy", lambda root: sum("mesh" in node for node in _entries(root, "nodes")) > 1),
    ("cameras", r"camera", lambda root: any("camera" in node for node in _entries(root, "nodes"))),
    ("lights", r"light", lambda root: "KHR_lights_punctual" in _extensions(root)),
    ("extras", r"extras", _has_extras),
    ("points or lines", r"triangles|points|lines", lambda root: any(p.get("mode", 4) < 4 for p in _primitives(root))),
    ("other scenes", r"scene", lambda root: len(_entries(root, "scenes")) > 1),
    ("nearest filter", r"nearest|filter", lambda root: any(s.get("magFilter") == NEAREST for s in _entries(root, "samplers"))),
    ("filter without mip levels", r"minfilter|mip",
     lambda root: any(s.get("minFilter") in (NEAREST, LINEAR) for s in _entries(root, "samplers"))),
    ("copyright", r"copyright", lambda root: isinstance(root.get("asset"), dict) and root["asset"].get("copyright")),
    *((slot, words, lambda root, slot=slot: _has_slot(root, slot)) for slot, words in SLOTS),
)
IN_COLLADA = (("animations", r"animation", b"<animation[ >]"), ("cameras", r"camera", b"<instance_camera"),
              ("lights", r"light", b"<instance_light"), ("skins", r"skin|controller", b"<instance_controller"))


def unnamed_things(source, mesh):
    """Return [[thing, words that name it]] that a source file has and a decoded GLB has not. source, mesh: Path."""
    if source.suffix.lower() == ".dae":
        data = source.read_bytes()
        return [[thing, words] for thing, words, tag in IN_COLLADA if re.search(tag, data)]
    roots = [json_of(path) for path in (source, mesh)]
    if source.suffix.lower() not in (".glb", ".gltf") or not all(isinstance(root, dict) for root in roots):
        return []
    before, after = roots
    lost = [[thing, words] for thing, words, has in TABLE if has(before) and not has(after)]
    lost += [[f"extension {name}", f"{name}|{name.split('_')[-1]}"]
             for name in sorted(_extensions(before) - _extensions(after) - REPLACED)]
    return lost + [[f"attribute {name}", name] for name in _lost_attributes(before, after)]


def _lost_attributes(before, after):
    """Attributes of vertices that show in no picture: UVs that no image uses, further colours, those of an application."""
    names, there = ({name for p in _primitives(root) for name in p.get("attributes", {})} for root in (before, after))
    used = {f"TEXCOORD_{number}" for number in _uv_sets(before)}
    extra = {name for name in names if name.startswith("_") or re.fullmatch(r"COLOR_[1-9]\d*", name)}
    return sorted(extra - there) + sorted(name for name in names - used if name.startswith("TEXCOORD_"))


def _uv_sets(root):
    """Numbers of the UV sets that textures of the materials use."""
    uses = [item for entry in _entries(root, "materials") for item in _objects(entry) if "index" in item]
    return {use.get("extensions", {}).get("KHR_texture_transform", {}).get("texCoord", use.get("texCoord", 0)) for use in uses}


def json_of(path):
    """Return the JSON tree of a .glb or .gltf file; None if it has none."""
    data = path.read_bytes()
    if data[:4] == GLB_MAGIC:
        length, kind = struct.unpack_from("<II", data, 12)
        data = data[20 : 20 + length] if kind == CHUNK_JSON else b""
    try:
        return json.loads(data.decode("utf-8-sig"))
    except ValueError:
        return None
