"""References in a glTF's JSON tree: where one entry names another by its number."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from ..gltf.carried import EXTENSION
from ..gltf.meshopt import EXTENSIONS as MESHOPT

DATA = ("accessors", "bufferViews", "images", "textures", "samplers")  # arrays whose entries may be removed and renumbered
_DRACO, _INSTANCES = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing"
# Extensions whose references to DATA are known here, or that have none.
_KNOWN = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_xmp", "KHR_lights_", "KHR_animation_pointer", "KHR_node_",
          _DRACO, "KHR_mesh_quantization", "MSFT_texture_dds", "MSFT_lod", _INSTANCES, EXTENSION, *MESHOPT)


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
    used = root.get("extensionsUsed", [])
    return any(not str(name).startswith(_KNOWN) for name in used) if isinstance(used, list) else True


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
    """
    for kind, walk in _WALKS.items():
        for number, entry in enumerate(root.get(kind, [])):
            for reference in walk(entry):
                if isinstance(reference.target, int):
                    yield (kind, number), reference
    streams = _extension(root, EXTENSION).get("streams", [])
    for at in range(len(streams)):
        yield ("", 0), Reference(streams, at, "bufferViews")


def _extension(entry, name):
    """Return an extension's object, {} if absent."""
    table = entry.get("extensions")
    entry = table.get(name) if isinstance(table, dict) else None
    return entry if isinstance(entry, dict) else {}


def _keys(entry, kind, *keys):
    """Return references of an object by these keys, if it has them."""
    return [Reference(entry, key, kind) for key in keys if isinstance(entry, dict) and key in entry]


def _of_accessor(entry):
    sparse = entry.get("sparse", {})
    return [reference for owner in (entry, sparse.get("indices"), sparse.get("values"))
            for reference in _keys(owner, "bufferViews", "bufferView")]


def _of_texture(entry):
    named = entry.get("extensions", {})
    return _keys(entry, "samplers", "sampler") + [reference for owner in (entry, *named.values())
                                                  for reference in _keys(owner, "images", "source")]


def texture_infos(entry: Any) -> Iterator[dict]:
    """Yield the textureInfo objects of a material or a part of it, also those of extensions that are not known here."""
    for key, value in entry.items() if isinstance(entry, dict) else ():
        if key.endswith("Texture") and isinstance(value, dict) and "index" in value:
            yield value
        elif key != "extras":
            yield from texture_infos(value)


def _of_mesh(entry):
    for primitive in entry.get("primitives", []):
        for attributes in (primitive.get("attributes", {}), *primitive.get("targets", [])):
            yield from _keys(attributes, "accessors", *attributes)
        yield from _keys(primitive, "accessors", "indices")
        yield from _keys(_extension(primitive, _DRACO), "bufferViews", "bufferView")
        yield from _keys(_extension(primitive, EXTENSION), "accessors", "splits")


def _of_node(entry):
    attributes = _extension(entry, _INSTANCES).get("attributes", {})
    return _keys(attributes, "accessors", *attributes)


_WALKS = {
    "accessors": _of_accessor,
    "images": lambda entry: _keys(entry, "bufferViews", "bufferView"),
    "textures": _of_texture,
    "materials": lambda entry: [Reference(info, "index", "textures") for info in texture_infos(entry)],
    "meshes": _of_mesh,
    "skins": lambda entry: _keys(entry, "accessors", "inverseBindMatrices"),
    "animations": lambda entry: [reference for sampler in entry.get("samplers", [])
                                 for reference in _keys(sampler, "accessors", "input", "output")],
    "nodes": _of_node,
}


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
