"""glTF meshes -> Parts in mesh space: attributes, indices, strips and fans, Draco, morph defaults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, SupportError
from ..corner_maps import alpha_into, channel_named, vertex_maps
from ..parts import Part
from ..vertex_pools import VertexPools
from .accessor import normalized_floats, read_accessor, read_floats
from .document import Document
from .left_out import name_extension
from .properties import extensions, integer, malformed, part, title

if TYPE_CHECKING:
    from .material import MaterialFields, TextureInfo

_DRACO = "KHR_draco_mesh_compression"
# Types of Draco's values, which DracoPy hands out as 32 bits: what is normalised goes by the number of its bits.
_DRACO_TYPES = {1: np.int8, 2: np.uint8, 3: np.int16, 4: np.uint16, 5: np.int32, 6: np.uint32, 9: np.float32, 10: np.float64}
VARIANTS = "KHR_materials_variants"  # the file's own materials are what is shown
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_STORED = ("SCALAR", "VEC2", "VEC3", "VEC4")  # types of attributes that are stored beside a stream
_SPLATS, _SPLATS_EXTENSION = "Gaussian splats", "gaussian_splatting"
_MODE_NAMES = {0: "points", 1: "lines", 2: "line loop", 3: "line strip"}


class MeshReader:
    """Reads each mesh once, for any number of nodes.

    material_fields_of: material index or None -> MaterialFields; is_posed: whether morph targets move tangents. After reading,
    `materials` lists the used material indices in order of first use (None is glTF's default), and Part.material is an index into
    it; `pools` has the vertex pools that the Parts take their used vertices from; `beside` counts the primitives that are not
    triangles, by kind.
    """

    def __init__(self, document: Document, material_fields_of: Callable[[Any], MaterialFields], is_posed: bool = False) -> None:
        self.document, self.material_fields_of, self.is_posed = document, material_fields_of, is_posed
        self._slots: dict[int | None, int] = {}
        self._meshes: dict[tuple[int, bool], list[Part]] = {}
        self.pools = VertexPools()
        self.beside: Counter[str] = Counter()
        self._shared = Counter(_draco_view(primitive) for mesh in document.entries("meshes")
                               for primitive in _primitives(mesh))
        self._draco: dict[int, Any] = {}
        self._used_uv: set[str] = set()
        self._found_uv: set[str] = set()

    def read(self, index: int, skinned: bool = False) -> list[Part]:
        """Mesh index -> list of Part in mesh space. skinned: whether the Parts get joints and weights."""
        if (index, skinned) not in self._meshes:
            entry = self.document.entry("meshes", index)
            primitives = entry.get("primitives")
            if not isinstance(primitives, list) or not all(isinstance(primitive, dict) for primitive in primitives):
                raise malformed(f"mesh {title(entry, index)} has no array of primitives")
            label = f"mesh {title(entry, index)}"
            parts = [self._primitive(entry, primitive, f"{label} primitive {n}", skinned)
                     for n, primitive in enumerate(primitives)]
            self._meshes[index, skinned] = [mesh_part for mesh_part in parts if mesh_part is not None]
        return self._meshes[index, skinned]

    def unposed(self, index: int, number: int) -> Part | None:
        """Primitive `number` of a mesh in mesh space, before morph targets and skin; None if it has no triangles."""
        entry = self.document.entry("meshes", index)
        primitive = {key: value for key, value in entry["primitives"][number].items() if key != "targets"}
        return self._primitive(entry, primitive, f"mesh {title(entry, index)} primitive {number}", skinned=False)

    def stored(self, index: int, number: int) -> dict[str | tuple[int, str], np.ndarray]:
        """Attributes of a primitive by name, and its morph targets by (number, name): [V, width] of all its vertices in their
        stored types. Raises InputError TXF-I09 if they differ in count, or what reading them raises."""
        entry = self.document.entry("meshes", index)
        primitive, label = entry["primitives"][number], f"mesh {title(entry, index)} primitive {number}"
        source = self._source(primitive, label)
        values: dict[Any, np.ndarray] = {name: source.stored(name, _STORED) for name in source.names}
        for n, target in enumerate(primitive.get("targets", ())):
            values |= {(n, name): read_accessor(self.document, accessor, _STORED) for name, accessor in target.items()}
        if len({len(rows) for rows in values.values()}) > 1 or any(rows.dtype == np.float64 for rows in values.values()):
            raise malformed(f"{label} has attributes of different counts, or in float64")
        return values

    def drop_unused_uv(self) -> None:
        """Name the UV sets that no image uses."""
        for name in sorted(self._found_uv - self._used_uv):
            self.document.notes.remark(f"no image uses {name}; it is left out")

    def _primitive(self, mesh, primitive, label, skinned):
        mode = integer(primitive, "mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            kind = _SPLATS if any(_SPLATS_EXTENSION in name for name in extensions(primitive)) else _MODE_NAMES.get(mode, mode)
            self.beside[str(kind)] += 1
            self.document.notes.lose(f"{label} ({kind})", f"{label} is not made of triangles ({kind}); it is left out")
            return None
        source = self._source(primitive, label)
        if not source.has("POSITION"):
            self.document.notes.remark(f"{label} has no POSITION; it is left out")
            return None
        stored = source.stored("POSITION", ("VEC3",))
        indices = source.indices()
        if indices is None:
            indices = np.arange(len(stored), dtype=np.int64)
        faces = self._triangles(indices, mode if not source.is_triangles else _TRIANGLES, label)
        source.count = len(stored)
        source.rows, faces = self.pools.take(source.pool, stored, faces)
        positions = source.floats("POSITION", ("VEC3",))
        material = primitive.get("material")
        fields = self.material_fields_of(material)
        self._drop_attributes(primitive, label, skinned)
        result = Part(self._morphed(mesh, primitive, positions, source), faces, self._slot(material),
                      self._uv(source, fields.leading, label), self._vertex_color(source, label), label,
                      {name: self._uv(source, info, label) for name, info in fields.others().items()})
        result.rows = source.rows
        named = {name: source.floats(name, _STORED) for name in self._named_values(primitive)}
        result.maps, alpha = vertex_maps(named, self.document.notes)
        result.color = alpha_into(result.color, alpha)
        if source.has("NORMAL"):  # without it, TANGENT says nothing (section 3.7.2.1)
            result.normal = self._morphed(mesh, primitive, source.floats("NORMAL", ("VEC3",)), source, "NORMAL")
            result.tangent = source.floats("TANGENT", ("VEC4",)) if source.has("TANGENT") else None
            if self.is_posed and result.tangent is not None:
                turned = self._morphed(mesh, primitive, result.tangent[:, :3], source, "TANGENT")
                result.tangent = np.column_stack([turned, result.tangent[:, 3]])
        if skinned:
            result.influences = _influences(source)
        return result

    def _source(self, primitive, label):
        """The primitive's _Plain or _Draco. Draco data that several primitives share are decoded once."""
        if _DRACO not in extensions(primitive):
            return _Plain(self.document, primitive, label)
        view = _draco_view(primitive)
        mesh = self._draco.get(view)
        source = _Draco(self.document, primitive, label, mesh)
        self._draco = {v: mesh for v, mesh in self._draco.items() if self._shared[v] > 1}  # and the last
        self._draco[view] = source.mesh
        return source

    def _slot(self, material):
        return self._slots.setdefault(material, len(self._slots))

    @property
    def materials(self) -> list[int | None]:
        return list(self._slots)

    def _triangles(self, indices, mode, label):
        """Index list -> triangles [F, 3]; strips and fans by glTF 2.0 section 3.7.2.1."""
        if mode == _TRIANGLES:
            if len(indices) % 3:
                self.document.notes.remark(f"{label} ends in an incomplete triangle; it is left out")
            return indices[: len(indices) // 3 * 3].reshape(-1, 3)
        i = np.arange(max(len(indices) - 2, 0))
        if mode == _STRIP:
            return np.stack([indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]], axis=1)
        return np.stack([indices[i + 1], indices[i + 2], indices[np.zeros_like(i)]], axis=1)

    def _uv(self, source, info: TextureInfo | None, label):
        """UVs float [V, 2] of a texture, transformed; None without a texture or without UVs."""
        if info is None:
            return None
        name = f"TEXCOORD_{info.texcoord}"
        if not source.has(name):
            self.document.notes.lose(f"{name} of {label} (missing)", f"{label} has no {name} for its texture; UV (0, 0) is used")
            return None
        self._used_uv.add(name)
        uv = source.floats(name, ("VEC2",))
        if info.transform is None:
            return uv
        return np.asarray(uv, np.float64) @ info.transform[:, :2].T + info.transform[:, 2]

    def _vertex_color(self, source, label):
        """float32 linear RGBA [V, 4], or None."""
        if not source.has("COLOR_0"):
            return None
        stored = source.floats("COLOR_0", ("VEC3", "VEC4"), normalized=True)
        color = np.ones((len(stored), 4), np.float32)
        color[:, : stored.shape[1]] = stored
        return color

    def _named_values(self, primitive):
        """Names of attributes that hold a channel, such as _METALLIC."""
        return [name for name in part(primitive, "attributes") if name.startswith("_") and channel_named(name)]

    def _drop_attributes(self, primitive, label, skinned):
        named = self._named_values(primitive)
        for name in part(primitive, "attributes"):
            if name in named:
                continue
            if name.startswith("TEXCOORD_"):
                self._found_uv.add(name)
            elif name not in ("POSITION", "COLOR_0", "NORMAL", "TANGENT") and not (skinned and _is_of_skin(name)):
                self.document.notes.remark(f"attribute {name} is left out")
        for name in extensions(primitive):
            if name not in (_DRACO, VARIANTS):
                name_extension(self.document.notes, name, label)

    def _morphed(self, mesh, primitive, values, source, name="POSITION"):
        """Values of an attribute with the mesh's default morph weights applied (section 3.7.2.2); the targets are dropped."""
        targets = primitive.get("targets")
        if not targets:
            return values
        self.document.notes.drop("morph targets")
        weights = mesh.get("weights", [])
        if not isinstance(targets, list) or not isinstance(weights, list):
            raise malformed("morph targets or weights are not arrays")
        for target, weight in zip(targets, weights, strict=False):
            if weight and isinstance(target, dict) and name in target:
                if self.document.entry("accessors", target[name]).get("count") != source.count:
                    raise malformed("a morph target differs in count from its mesh")
                delta = read_floats(self.document, target[name], ("VEC3",), rows=source.rows)
                values = values + float(weight) * np.asarray(delta, np.float64)
        return values


def _is_of_skin(name):
    return name.startswith(("JOINTS_", "WEIGHTS_"))


def _influences(source):
    """(joints, weights) of all sets of a primitive, float64 [V, 4 n] each; None without a valid set."""
    sets, number = [], 0
    while source.has(f"JOINTS_{number}") and source.has(f"WEIGHTS_{number}"):
        if any(source.count_of(f"{name}_{number}") != source.count for name in ("JOINTS", "WEIGHTS")):
            return None
        sets.append((source.floats(f"JOINTS_{number}", ("VEC4",), False), source.floats(f"WEIGHTS_{number}", ("VEC4",), True)))
        number += 1
    if not sets:
        return None
    joints, weights = (np.concatenate(values, axis=1).astype(np.float64) for values in zip(*sets, strict=True))
    return joints, weights


def _primitives(mesh):
    primitives = mesh.get("primitives")
    return [entry for entry in primitives if isinstance(entry, dict)] if isinstance(primitives, list) else []


def _draco_view(primitive):
    """Index of the bufferView of a primitive's Draco data, or None."""
    table = primitive.get("extensions")
    packed = table.get(_DRACO) if isinstance(table, dict) else None
    view = packed.get("bufferView") if isinstance(packed, dict) else None
    return view if isinstance(view, int) else None


class _Plain:
    """Attributes and indices in accessors. count: number of all vertices; rows: vertices that floats() returns, None for all;
    pool: key of the vertex pool."""

    is_triangles = False

    def __init__(self, document, primitive, label):
        self.document, self.primitive, self.label = document, primitive, label
        self.names = part(primitive, "attributes")
        self.count, self.rows = None, None

    @property
    def pool(self):
        return "accessor", self.names["POSITION"]

    def stored(self, name, kinds):
        """An attribute of all vertices in its stored type."""
        return read_accessor(self.document, self.names[name], kinds)

    def has(self, name):
        return name in self.names

    def count_of(self, name):
        """Number of values of an attribute."""
        return self.document.entry("accessors", self.names[name]).get("count")

    def floats(self, name, kinds, normalized=None):
        if self.count_of(name) != self.count:
            raise malformed(f"{self.label} has attributes of different counts")
        return read_floats(self.document, self.names[name], kinds, normalized, self.rows)

    def indices(self):
        if "indices" not in self.primitive:
            return None
        indices = read_accessor(self.document, self.primitive["indices"], ("SCALAR",))[:, 0]
        if indices.dtype.kind != "u":
            raise malformed("indices are not unsigned integers")
        return indices


class _Draco(_Plain):
    """Attributes and indices in Draco data (KHR_draco_mesh_compression), by DracoPy; other attributes are in accessors."""

    is_triangles = True

    def __init__(self, document, primitive, label, mesh):
        super().__init__(document, primitive, label)
        self.compressed = part(extensions(primitive), _DRACO)
        self.ids = part(self.compressed, "attributes")
        self.mesh = mesh or _decode_draco(document.view(self.compressed.get("bufferView"))[0])

    @property
    def pool(self):
        return "Draco", self.compressed["bufferView"]

    def stored(self, name, kinds):
        if name not in self.ids:
            return super().stored(name, kinds)
        matches = [entry for entry in self.mesh.attributes if entry["unique_id"] == self.ids[name]]
        if not matches:
            raise InputError("TXF-I12", f"the Draco data has no attribute {name}")
        data = np.asarray(matches[0]["data"]).astype(_DRACO_TYPES.get(matches[0]["data_type"], np.float32))
        if data.ndim != 2 or f"VEC{data.shape[1]}" not in kinds:
            raise InputError("TXF-I12", f"the Draco attribute {name} has an unexpected shape")
        return data

    def floats(self, name, kinds, normalized=None):
        if name not in self.ids:
            return super().floats(name, kinds, normalized)
        data = self.stored(name, kinds)
        if len(data) != self.count:
            raise malformed(f"{self.label} has attributes of different counts")
        data = data if self.rows is None else data[self.rows]
        if normalized is None:
            normalized = self.document.entry("accessors", self.names[name]).get("normalized", False)
        return normalized_floats(data) if normalized else data

    def indices(self):
        return np.asarray(self.mesh.faces).reshape(-1)


def _decode_draco(data):
    try:
        import DracoPy
    except ImportError as error:
        raise SupportError("TXF-I34", f"{_DRACO} requires the package DracoPy") from error
    try:
        mesh = DracoPy.decode(bytes(data))
    except Exception as error:  # DracoPy derives its errors from Exception directly
        raise InputError("TXF-I12", "the Draco data cannot be decoded", reason=str(error)[:200]) from error
    if getattr(mesh, "faces", None) is None:
        raise InputError("TXF-I12", "the Draco data has no triangles")
    return mesh
