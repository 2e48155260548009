"""References in a glTF's JSON tree: where one entry names another by its number."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from ..gltf.carried import EXTENSION
from ..gltf.mesh import VARIANTS
from ..gltf.meshopt import EXTENSIONS as MESHOPT
from ..gltf.properties import is_index, malformed

DATA = ("accessors", "bufferViews", "images", "textures", "samplers")  # arrays whose entries may be removed and renumbered
_DRACO, _INSTANCES = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing"
# Extensions whose references to DATA are known here, or that have none.
_KNOWN = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_xmp", "KHR_lights_", "KHR_animation_pointer", "KHR_node_",
          _DRACO, "KHR_mesh_quantization", "MSFT_texture_dds", "MSFT_lod", _INSTANCES, EXTENSION, *MESHOPT)


# Shapes of what the tree holds: an object, whose key "*" stands for all others; an array; a type; the name of an array that a
# number refers to. Properties that are absent, or not listed, have any shape.
_VIEW, _ACCESSORS = {"bufferView": "bufferViews"}, {"*": "accessors"}
_TEXTURE_INFO = {"index": "textures", "extensions": {"KHR_texture_transform": {}}}
_MATERIAL: dict = {"*": "all that texture_infos() yields"}
_PRIMITIVE = {"attributes": _ACCESSORS, "targets": [_ACCESSORS], "indices": "accessors", "material": "materials", "extensions": {
    _DRACO: _VIEW, EXTENSION: {"splits": "accessors"}, VARIANTS: {"mappings": [{"material": "materials"}]}}}
_ANIMATION = {"samplers": [{"input": "accessors", "output": "accessors"}], "channels": [
    {"sampler": int, "target": {"path": str, "extensions": {"KHR_animation_pointer": {}}}}]}
_SHAPES: dict[str, list] = {
    "accessors": [_VIEW | {"type": str, "componentType": int, "sparse": {"indices": _VIEW, "values": _VIEW}}],
    "bufferViews": [{"byteLength": int, "extensions": dict.fromkeys((EXTENSION, *MESHOPT), {})}],
    "images": [_VIEW],
    "samplers": [{}],
    "textures": [{"sampler": "samplers", "source": "images", "extensions": {"*": {"source": "images"}}}],
    "materials": [_MATERIAL],
    "meshes": [{"primitives": [_PRIMITIVE]}],
    "skins": [{"inverseBindMatrices": "accessors"}],
    "animations": [_ANIMATION],
    "scenes": [{"extensions": {EXTENSION: _VIEW}}],
    "nodes": [{"extensions": {_INSTANCES: {"attributes": _ACCESSORS}}}],
    "extensions": [{EXTENSION: {"streams": ["bufferViews"]}}],
    "extensionsUsed": [str],
    "extensionsRequired": [str],
}


class Reference(NamedTuple):
    """owner[key] is the number of an entry of an array. kind: name of the array, such as "accessors"."""

    owner: Any
    key: Any
    kind: str

    @property
    def target(self) -> int:
        """Number of the entry."""
        return self.owner[self.key]


def has_unknown_references(root: dict) -> bool:
    """Return whether the file uses an extension that may refer to entries in a way that is not known here."""
    return any(not name.startswith(_KNOWN) for name in [*root.get("extensionsUsed", []), *extension_names(root)])


def extension_names(value: Any) -> Iterator[str]:
    """Yield the names of extensions in a tree, also of those that the file does not declare."""
    for key, child in value.items() if isinstance(value, dict) else ():
        if key == "extensions" and isinstance(child, dict):
            yield from child
    for child in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from extension_names(child)


def references(root: dict) -> Iterator[tuple[tuple[str, int], Reference]]:
    """Yield every reference to an entry of DATA, with the entry that has it.

    Parameters
    ----------
    root : dict
        The JSON tree.

    Yields
    ------
    tuple of (str, int) and Reference
        Array and number of the entry that holds the reference; the reference.

    Raises
    ------
    InputError
        TXF-I09 where the tree has other types than _SHAPES, or a reference is no number of an entry.
    """
    arrays = {kind: [root[kind]] if kind == "extensions" else root[kind] for kind in _SHAPES if kind in root}
    for kind, entries in arrays.items():
        if not isinstance(entries, list):
            raise malformed(f"'{kind}' is not an array")
    for kind, entries in arrays.items():
        for number in range(len(entries)):
            for reference in _walk(entries, number, _SHAPES[kind][0], kind):
                count = len(arrays.get(reference.kind, ()))
                if not is_index(reference.target) or reference.target >= count:
                    raise malformed(f"'{kind}' refers to {reference.kind} that are not there", value=str(reference.target)[:40],
                                    allowed=count - 1)
                if reference.kind in DATA:
                    yield (kind, number), reference


def _walk(owner, key, shape, name):
    """Yield the References in owner[key]. name: of the property, for messages."""
    value = owner[key]
    if isinstance(shape, str):
        yield Reference(owner, key, shape)
    elif isinstance(shape, type):
        if not isinstance(value, shape) or (shape is int and not is_index(value)):
            raise malformed(f"'{name}' has another type", value=str(value)[:40])
    elif isinstance(shape, list):
        if not isinstance(value, list):
            raise malformed(f"'{name}' is not an array")
        for number in range(len(value)):
            yield from _walk(value, number, shape[0], name)
    elif not isinstance(value, dict):
        raise malformed(f"'{name}' is not an object")
    elif shape is _MATERIAL:
        for info in texture_infos(value):
            yield from _walk([info], 0, _TEXTURE_INFO, name)
    else:
        for part in value if "*" in shape else [part for part in shape if part in value]:
            yield from _walk(value, part, shape[part] if part in shape else shape["*"], part)


def texture_infos(entry: Any) -> Iterator[dict]:
    """Yield the textureInfo objects of a material or a part of it, also those of extensions that are not known here."""
    for key, value in entry.items() if isinstance(entry, dict) else ():
        if key.endswith("Texture") and isinstance(value, dict) and "index" in value:
            yield value
        elif key != "extras":
            yield from texture_infos(value)


def reached(root: dict, kept: Iterable[tuple[str, int]] = ()) -> set[tuple[str, int]]:
    """Return the entries of DATA, as (array, number), that are reached from the entries of other arrays and from those in
    `kept`."""
    edges: dict[tuple[str, int], list[tuple[str, int]]] = {}
    for holder, reference in references(root):
        edges.setdefault(holder, []).append((reference.kind, reference.target))
    pending = [target for holder, targets in edges.items() if holder[0] not in DATA for target in targets] + list(kept)
    result: set[tuple[str, int]] = set()
    while pending:
        entry = pending.pop()
        if entry not in result:
            result.add(entry)
            pending += edges.get(entry, [])
    return result
