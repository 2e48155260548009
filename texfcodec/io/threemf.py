"""3MF -> Scene: objects placed by the build, textures, colour groups and base materials of the materials extension (3MF core 1.3,
materials 1.2, production 1.1).

Own code rather than trimesh, which reads the geometry alone and wants lxml and networkx for it.
"""

import io
import posixpath
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, LimitError
from ..scene.scene import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene
from .file_search import missing_file
from .images import TextureShelf
from .parts import MAX_FACES, Notes, Part, alpha_mode_of, assemble, check_face_count, drop_alpha, linear_rgba
from .placing import placing_of
from .visibility import turn_where_all_vanish

MAX_PART = 1 << 29  # bytes of one unpacked part of the archive
MAX_INSTANCES = 1 << 16  # objects and components placed; nesting lets a small file ask for any number
_METRES = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
_WRAPS = {"wrap": WRAP_REPEAT, "mirror": WRAP_MIRROR, "clamp": WRAP_CLAMP, "none": WRAP_CLAMP}
_SILENT = {"model", "resources", "object", "mesh", "vertices", "vertex", "triangles", "triangle", "components", "component",
           "build", "item", "metadata", "metadatagroup", "base", "color", "tex2coord"}
_RELATIONS, _ROOT = "_rels/.rels", "3D/3dmodel.model"


@dataclass
class Body:
    """One object. vertices: float64 [V, 3]; triangles: int64 [F, 3]; properties: (group id or None, three indices) of each
    triangle; components: (path or None, object id, float64 [4, 4] acting on columns); pid, pindex: the object's own property."""

    name: str = ""
    kind: str = "model"
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    properties: list = field(default_factory=list)
    components: list = field(default_factory=list)
    pid: str | None = None
    pindex: int = 0


@dataclass
class Group:
    """A property group. kind: "basematerials", "colorgroup" or "texture2dgroup"; rows: (name, RGBA) pairs, RGBA in [0, 1],
    or (u, v) with v upwards; texture: id of its texture2d."""

    kind: str
    rows: list = field(default_factory=list)
    texture: str | None = None


@dataclass
class Model:
    """One model part. textures: id -> (path in the archive, tile style of u, of v); items: (path, object id, matrix);
    nearest: paths of textures with that filter."""

    unit: str = "millimeter"
    bodies: dict = field(default_factory=dict)
    groups: dict = field(default_factory=dict)
    textures: dict = field(default_factory=dict)
    items: list = field(default_factory=list)
    metadata: dict = field(default_factory=dict)
    nearest: list = field(default_factory=list)


def malformed(what: str, **details: object) -> InputError:
    """The error for a 3MF package that does not follow its specification."""
    return InputError("TXF-I24", f"the 3MF file is malformed: {what}", **details)


class _Archive:
    """The ZIP file, its model parts parsed once each; names are compared without case and leading slash."""

    def __init__(self, data, notes):
        self.notes, self.used, self._models = notes, set(), {}
        try:
            self.zip = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, NotImplementedError, UnicodeError, OSError) as error:
            raise malformed("it is not a readable ZIP archive", reason=str(error)[:100]) from error
        self.entries = {_key(entry.filename): entry for entry in self.zip.infolist() if not entry.is_dir()}

    def read(self, name):
        """bytes of a part, or None where there is none; LimitError TXF-I41 beyond MAX_PART."""
        entry = self.entries.get(_key(name))
        if entry is None:
            return None
        if entry.file_size > MAX_PART:
            raise LimitError("TXF-I41", "part of the 3MF file unpacks to too many bytes", value=entry.file_size,
                             allowed=MAX_PART)
        self.used.add(_key(name))
        try:
            return self.zip.read(entry)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
            raise malformed(f"its part '{name[:80]}' cannot be unpacked", reason=str(error)[:100]) from error

    def model(self, name):
        """Model of a part; its key names it in `bodies` that stand in several parts."""
        if _key(name) not in self._models:
            data = self.read(name)
            if data is None:
                raise malformed(f"its part '{name[:80]}' is missing")
            self._models[_key(name)] = read_model(io.BytesIO(data), self.notes)
        return self._models[_key(name)]

    def root(self):
        """Name of the model part that the package's relationships name as its start."""
        data = self.read(_RELATIONS)
        try:
            for element in ElementTree.fromstring(data or b"<none/>"):
                if element.get("Type", "").endswith("/3dmodel") and element.get("Target"):
                    return element.get("Target")
        except (ElementTree.ParseError, LookupError, ValueError) as error:  # the last two: encodings that are none, or not read
            raise malformed("its relationships are not XML", reason=str(error)[:100]) from error
        return _ROOT

    def drop_unused(self):
        """Name the parts that nothing asked for: print settings, thumbnails, slices."""
        for key in self.entries.keys() - self.used:
            if not key.endswith(".rels") and key != "[content_types].xml":
                self.notes.remark(f"3MF part '{self.entries[key].filename[:100]}' is left out")


def _key(name):
    return posixpath.normpath(name.replace("\\", "/").lstrip("/")).lower()


def read_3mf(data: bytes, folder: Path, notes: Notes) -> Scene:
    """bytes of a .3mf file -> Scene. folder: not needed, all is in the archive. Errors: TXF-I24, TXF-I19, TXF-I41."""
    archive = _Archive(data, notes)
    start = archive.root()
    model = archive.model(start)
    shelf, look = TextureShelf(notes), _Look()
    parts, faces = [], 0
    placing = placing_of("Z", _METRES.get(model.unit.strip().lower(), 1e-3), "the 3MF file", notes)
    for name, body, matrix in _placed(archive, start, model):
        parts.append(_part(archive, name, body, placing.matrix @ matrix, look, shelf))
        faces += len(body.triangles)
        check_face_count(faces)
    archive.drop_unused()
    turn_where_all_vanish(look.plain, "the 3MF file", notes)
    metadata = {"source_unit": model.unit, **({"3mf": model.metadata} if model.metadata else {})}
    return assemble(parts, look.materials or [Material("default")], shelf.textures, notes, metadata)


def _placed(archive, start, model):
    """(name of the part, Body, world matrix) of everything with triangles, in the order of the build."""
    above: tuple = ()
    stack = [(path or start, key, matrix, above) for path, key, matrix in reversed(model.items)]
    count = 0
    while stack:
        name, key, matrix, above = stack.pop()
        count += 1
        if count > MAX_INSTANCES:
            raise LimitError("TXF-I41", "the 3MF file places too many objects", value=count, allowed=MAX_INSTANCES)
        body = archive.model(name).bodies.get(key)
        if body is None:
            raise malformed("it places an object that does not exist", value=str(key)[:40])
        if (name, key) in above:
            raise InputError("TXF-I19", "the node graph is not a tree: an object contains itself", value=str(key)[:40])
        if body.kind not in ("model", "surface"):
            archive.notes.drop(f"object '{body.name or key}' of the type {body.kind[:40]}")
        elif len(body.triangles):
            yield name, body, matrix
        for path, child, inner in reversed(body.components):
            stack.append((path or name, child, matrix @ inner, (*above, (name, key))))


class _Look:
    """Scene materials under construction, one for each property that shows in another way."""

    def __init__(self):
        self.materials, self._rows = [], {}

    @property
    def plain(self):
        """Materials of base materials, whose alpha comes from a displaycolor."""
        return [self.materials[row] for key, row in self._rows.items() if len(key) == 3]

    def row(self, key, make):
        """Index of the material of this key."""
        if key not in self._rows:
            self._rows[key] = len(self.materials)
            self.materials.append(make())
        return self._rows[key]


def _part(archive, name, body, matrix, look, shelf):
    """Body in world space; every triangle takes its look from the property group that it names."""
    count, groups = len(body.triangles), archive.model(name).groups
    material, uv, color = np.zeros(count, np.int64), np.zeros((count, 3, 2)), np.ones((count, 3, 4), np.float32)
    rows_of: dict[tuple[str | None, int | None], list[int]] = {}
    corners = np.array([indices for _, indices in body.properties], np.int64).reshape(-1, 3)
    for row, (pid, indices) in enumerate(body.properties):
        group = groups.get(pid)
        first = indices[0] if group is not None and group.kind == "basematerials" else None
        rows_of.setdefault((pid, first), []).append(row)
    colored = False
    for (pid, first), rows in rows_of.items():
        group = groups.get(pid)
        if group is None:
            if pid is not None:
                archive.notes.lose(f"property group '{pid[:40]}' (missing or not supported)",
                                   f"property group '{pid[:40]}' is missing or not supported; its faces are white")
            material[rows] = look.row((), lambda: Material("default"))
            continue
        table = _table(group, corners[rows])
        if group.kind == "texture2dgroup":
            material[rows] = look.row((name, pid), lambda g=group: _textured(archive, name, g, shelf))
            uv[rows] = table
        elif group.kind == "colorgroup":
            material[rows] = look.row((), lambda: Material("default"))
            color[rows], colored = linear_rgba(table), True
            drop_alpha(color[rows] if table[..., 3].any() else None, archive.notes)
        else:
            material[rows] = look.row((name, pid, first), lambda g=group, k=first: _plain(*g.rows[k]))
    points = body.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    triangles = body.triangles if np.linalg.det(matrix[:3, :3]) >= 0 else body.triangles[:, [0, 2, 1]]
    if triangles is not body.triangles:
        uv, color = uv[:, [0, 2, 1]], color[:, [0, 2, 1]]
    label = f"object '{body.name}'" if body.name else "the 3MF file"
    return Part(points, triangles, material, uv, color if colored else None, label)


def _table(group, indices):
    """Rows of the group at each corner [n, 3]: UVs with v downwards, or RGBA."""
    if indices.min() < 0 or indices.max() >= len(group.rows):
        raise malformed("a triangle refers to a property that does not exist", value=int(indices.max()),
                        allowed=len(group.rows) - 1)
    if group.kind == "texture2dgroup":
        return (np.array(group.rows) * [1, -1] + [0, 1])[indices]
    return np.array([rgba for _, rgba in group.rows])[indices]


def _textured(archive, name, group, shelf):
    model = archive.model(name)
    entry = model.textures.get(group.texture)
    if entry is None:
        raise malformed("a texture group refers to a texture that does not exist", value=str(group.texture)[:40])
    path, *styles = entry

    def fetch():
        data = archive.read(path)
        if data is None:
            raise missing_file(path)
        return data

    label = posixpath.basename(path)
    wrap = tuple(_WRAPS[style] for style in styles)
    return Material(label, texture=shelf.put(_key(path), fetch, label, wrap, nearest=path in model.nearest))


def _plain(name, rgba):
    factor = linear_rgba(np.array(rgba)).astype(np.float64)
    return Material(name, factor, alpha_mode=alpha_mode_of(factor))



def read_model(stream: IO[bytes], notes: Notes) -> Model:
    """Open binary stream of one model part -> Model. Errors: TXF-I24, LimitError TXF-I41 too many triangles."""
    model = Model()
    try:
        for event, element in ElementTree.iterparse(stream, events=("start", "end")):
            tag = element.tag.rpartition("}")[2]
            if event == "start":
                if tag == "model":
                    model.unit = element.get("unit", model.unit)
            elif tag in _ENDS:
                _ENDS[tag](model, element)
                element.clear()
            elif tag not in _SILENT:
                notes.drop(f"3MF element '{tag[:40]}'")
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise malformed("an attribute is missing or unreadable", reason=f"{type(error).__name__}: {error}"[:100]) from error
    except (ElementTree.ParseError, LookupError) as error:  # LookupError: an encoding that is none
        raise malformed("a model part is not XML", reason=str(error)[:100]) from error
    return model


def _children(element, tag):
    return [child for child in element.iter() if child.tag.rpartition("}")[2] == tag]


def _end_object(model, element):
    body = Body(element.get("name", ""), element.get("type", "model"), pid=element.get("pid"),
                pindex=int(element.get("pindex", 0)))
    body.vertices = np.array([[float(vertex.get(axis)) for axis in "xyz"] for vertex in _children(element, "vertex")],
                             np.float64).reshape(-1, 3)
    triangles = _children(element, "triangle")
    if len(triangles) > MAX_FACES:
        raise LimitError("TXF-I41", "the input has too many faces", value=len(triangles), allowed=MAX_FACES)
    body.triangles = np.array([[int(row.get(corner)) for corner in ("v1", "v2", "v3")] for row in triangles],
                              np.int64).reshape(-1, 3)
    body.properties = [_property(row, body) for row in triangles]
    for component in _children(element, "component"):
        body.components.append((_path(component), component.attrib["objectid"], _matrix(component.get("transform"))))
    model.bodies[element.attrib["id"]] = body


def _property(row, body):
    """(group id or None, index at each corner): a missing p1 means the object's, a missing p2 or p3 means p1."""
    if row.get("p1") is None:
        return body.pid, (body.pindex,) * 3
    first = int(row.get("p1"))
    return row.get("pid", body.pid), (first, int(row.get("p2", first)), int(row.get("p3", first)))


def _end_build(model, element):
    for item in _children(element, "item"):
        model.items.append((_path(item), item.attrib["objectid"], _matrix(item.get("transform"))))


def _end_basematerials(model, element):
    rows = [(base.get("name", ""), _rgba(base.get("displaycolor", "#FFFFFF"))) for base in _children(element, "base")]
    model.groups[element.attrib["id"]] = Group("basematerials", rows)


def _end_colorgroup(model, element):
    rows = [("", _rgba(color.attrib["color"])) for color in _children(element, "color")]
    model.groups[element.attrib["id"]] = Group("colorgroup", rows)


def _end_texture2dgroup(model, element):
    rows = [(float(row.attrib["u"]), float(row.attrib["v"])) for row in _children(element, "tex2coord")]
    model.groups[element.attrib["id"]] = Group("texture2dgroup", rows, element.attrib["texid"])


def _end_texture2d(model, element):
    if element.get("filter") == "nearest":
        model.nearest.append(element.attrib["path"])
    styles = tuple(element.get(f"tilestyle{axis}", "wrap") for axis in "uv")
    if any(style not in _WRAPS for style in styles):
        raise malformed("a texture has an unknown tile style", value=str(styles)[:40])
    model.textures[element.attrib["id"]] = (element.attrib["path"], *styles)


def _end_metadata(model, element):
    if element.get("name") and element.text and len(model.metadata) < 100:
        model.metadata[element.get("name")[:100]] = element.text.strip()[:500]


_ENDS = {"object": _end_object, "build": _end_build, "basematerials": _end_basematerials, "colorgroup": _end_colorgroup,
         "texture2dgroup": _end_texture2dgroup, "texture2d": _end_texture2d, "metadata": _end_metadata}


def _path(element):
    """The production extension's path to another model part, or None."""
    return next((value for key, value in element.attrib.items() if key.rpartition("}")[2] == "path"), None)


def _matrix(text):
    """Twelve numbers, rows acting on row vectors -> float64 [4, 4] acting on columns."""
    if text is None:
        return np.eye(4)
    rows = np.array([float(number) for number in text.split()])
    if rows.size != 12:
        raise malformed("a transform is not twelve numbers", value=text[:60])
    matrix = np.eye(4)
    matrix[:3] = rows.reshape(4, 3).T
    return matrix


def _rgba(text):
    """"#RRGGBB" or "#RRGGBBAA" -> four floats in [0, 1], sRGB-coded."""
    if len(text) not in (7, 9) or text[0] != "#":
        raise malformed("a colour is not #RRGGBB or #RRGGBBAA", value=text[:20])
    return tuple(byte / 255.0 for byte in bytes.fromhex(text[1:].ljust(8, "F" if len(text) == 7 else "0")))
