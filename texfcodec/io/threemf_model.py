"""The XML of a 3MF model part -> plain objects and property groups (3MF core 1.3, materials 1.2, production 1.1)."""

from dataclasses import dataclass, field
from typing import IO
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, LimitError
from .parts import MAX_FACES, Notes

_SILENT = {"model", "resources", "object", "mesh", "vertices", "vertex", "triangles", "triangle", "components", "component",
           "build", "item", "metadata", "metadatagroup", "base", "color", "tex2coord"}
_WRAPS = ("wrap", "mirror", "clamp", "none")


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
