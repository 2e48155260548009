"""STL, OFF and 3MF -> Scene by trimesh. This module refuses files that trimesh would misread or crash on, and names what is lost.

trimesh ignores trailing and missing facets, lines and objects, takes all parts of a 3MF as the same, and has no bound on nesting.
"""

import io
import logging
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, LimitError, SupportError, TexfError
from ..report import plural
from ..scene.scene import Scene
from .mtl import decode_text
from .parts import Notes, check_face_count, no_triangles
from .placing import placing_of
from .polygons import parse_numbers
from .trimesh_object import read_trimesh
from .vertex_appearance import unique_corners

MAX_PART = 1 << 29  # bytes of the unpacked archive
MAX_INSTANCES = 1 << 16  # objects and components placed; nesting lets a small file ask for any number
_FACET, _START = 50, 84  # bytes of a facet; of the header and the count before the first one
_OFF_HEADER = re.compile(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b", re.IGNORECASE)
_METRES = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
_GEOMETRY = {"model", "resources", "object", "mesh", "vertices", "vertex", "triangles", "triangle", "components", "component",
             "build", "item"}
_REMARKS = {
    "stl": "of an STL the triangles, the colours of facets and the names of solids are read: normals of facets are left out",
    "off": "of an OFF the polygons are read, cut as if they were convex: colours, normals and texture coordinates are left out",
    "3mf": "of a 3MF the placed triangles are read: textures, colours, materials, metadata and print settings are left out",
}


def _malformed(kind, what, **details):
    return InputError("TXF-I24" if kind == "3mf" else "TXF-I23", f"the {kind.upper()} file is malformed: {what}", **details)


def _parsed(data, suffix, notes):
    """The trimesh.Scene of bytes, unprocessed. Any exception of trimesh means a malformed file."""
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else Python prints its warnings with their tracebacks
    try:
        import trimesh

        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix, process=False)
    except ImportError as error:
        raise SupportError("TXF-I35", "3MF files require the packages lxml and networkx: run pip install "
                                      '"texfcodec[formats]"') from error
    except MemoryError:
        raise
    except Exception as error:
        raise _malformed(suffix, "trimesh cannot read it", reason=f"{type(error).__name__}: {error}"[:200]) from error
    notes.remark(_REMARKS[suffix])
    return scene


def read_stl(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of an .stl file as a Scene; equal corners become one vertex. folder: unused, an STL names no file. Raises
    InputError TXF-I23."""
    counted = _START + _FACET * int.from_bytes(data[80:_START], "little")
    is_binary = len(data) == counted or data[:512].lstrip()[:5].lower() != b"solid"
    data, facets = _whole_binary(data, notes) if is_binary else _whole_text(data)
    solids = _parsed(data, "stl", notes)
    if sum(len(mesh.faces) for mesh in solids.geometry.values()) != facets:
        raise _malformed("stl", "a facet does not have three vertices of three numbers", allowed=facets)
    for mesh in solids.geometry.values():
        _weld(mesh)
        if is_binary:
            _paint(mesh, data[:80], notes)
    scene = read_trimesh(solids, notes)
    names = [str(mesh.metadata.get("name", "")) for mesh in solids.geometry.values()]
    named = [name[:500] for name in names if name and not name.startswith("geometry_")]  # which trimesh calls those without one
    scene.metadata = {"solids": named[:1000]} if named else {}
    return scene


def _whole_binary(data, notes):
    """(bytes up to the last facet, number of facets)."""
    facets = int.from_bytes(data[80:_START], "little")
    needed = _START + _FACET * facets
    if len(data) < needed:
        raise _malformed("stl", "it ends before its last facet", value=len(data), allowed=needed)
    if len(data) > needed:
        notes.remark(plural(len(data) - needed, "byte", "bytes") + " after the last facet, ignored")
    return data[:needed], facets


def _whole_text(data):
    """(text in UTF-8 with line ends that trimesh knows, number of facets)."""
    facets = len(re.findall(rb"endfacet", data, re.IGNORECASE))
    if not re.search(rb"endsolid", data, re.IGNORECASE):
        raise _malformed("stl", "it ends before its endsolid")
    return re.sub("\r\n?", "\n", decode_text(data)).encode(), facets


def _weld(mesh):
    """Merge corners with equal bits, in order of first use; trimesh would merge corners within a tolerance."""
    points = np.asarray(mesh.vertices, np.float64) + 0.0  # -0 becomes 0, which is the same place
    first, index = unique_corners(*points.view(np.int64).T)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    mesh.faces = rank[index][mesh.faces]
    mesh.vertices = points[first[order]]


def _paint(mesh, header, notes):
    """Set colours of facets, 5 bits a channel: red comes first in the Magics dialect, blue in VisCAM's. Facets without a colour
    have that of the header in Magics, else white."""
    attribute, place = mesh.face_attributes.pop("stl"), header.find(b"COLOR=")
    magics = 0 <= place <= 70
    own = (attribute >> 15 == 0) if magics else (attribute >> 15 == 1)
    if magics or own.any():
        channels = [np.rint((attribute >> shift & 31) * (255 / 31)) for shift in ((0, 5, 10) if magics else (10, 5, 0))]
        others = list(header[place + 6 : place + 10]) if magics else [255] * 4
        own_colors = np.stack([*channels, np.full(len(own), 255)], axis=1)
        mesh.visual.face_colors = np.where(own[:, None], own_colors, others).astype(np.uint8)
    elif attribute.any():
        notes.drop("attribute bytes of facets")
    if b"MATERIAL=" in header:
        notes.drop("MATERIAL of the STL header")


def read_off(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of an .off file as a Scene. folder: unused, an OFF names no file. Raises InputError TXF-I23."""
    text = re.sub(rb"#[^\r\n]*", b"", decode_text(data).encode())
    header = _OFF_HEADER.match(text)
    uv, color, normal, four, many = (bool(mark) for mark in header.groups()) if header else (False,) * 5
    if four or many or b"BINARY" in text[:40].upper():
        raise _malformed("off", "only text with three coordinates is supported")
    lines = [line for line in text[header.end() if header else 0 :].splitlines() if line.strip()]
    counts = parse_numbers(lines[0], np.float64) if lines else None
    if counts is None or len(counts) < 2 or not (np.isfinite(counts).all() and (counts == np.floor(counts)).all()):
        raise _malformed("off", "the line of counts is missing")
    vertices, faces = int(counts[0]), int(counts[1])
    if vertices < 0 or faces < 0 or 1 + vertices + faces > len(lines):
        raise _malformed("off", "it has fewer lines than its counts", value=len(lines), allowed=1 + vertices + faces)
    if not vertices or not faces:
        raise no_triangles((plural(vertices, "point", "points") + " without faces") * bool(vertices))
    columns = max(len(line.split()) for line in lines[1 : 1 + vertices])
    if columns > 3 + 3 * normal + 2 * uv:
        notes.drop("colours of vertices" if color else "numbers after the positions of vertices")
    _check_polygons([line.split() for line in lines[1 + vertices : 1 + vertices + faces]], notes)
    body = b"\n".join([b"OFF", b"%d %d 0" % (vertices, faces), *lines[1 : 1 + vertices + faces]])
    return read_trimesh(next(iter(_parsed(body, "off", notes).geometry.values())), notes)


def _check_polygons(rows, notes):
    sizes = np.array([int(row[0]) for row in rows])
    rest = np.array([len(row) for row in rows]) - 1 - sizes
    if sizes.min() < 0 or rest.min() < 0:
        raise _malformed("off", "a face line is shorter than its count", face=int(np.argmax((sizes < 0) | (rest < 0))))
    if rest.any():
        notes.drop("colours of faces")
    if (small := int((sizes < 3).sum())):
        notes.drop(plural(small, "face", "faces") + " with fewer than three corners")
    if (sizes > 4).any():
        notes.lose("the outline of concave polygons, cut as if they were convex",
                   "polygons of more than four corners are cut from their first corner, which is wrong where they are concave")


def read_3mf(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of a .3mf file as a Scene with Y up, in metres. folder: unused, all files are in the archive.
    Errors: TXF-I24, TXF-I19, TXF-I41, SupportError TXF-I35 without lxml and networkx."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if (size := sum(entry.file_size for entry in archive.infolist())) > MAX_PART:
                raise LimitError("TXF-I41", "the 3MF file unpacks to too many bytes", value=size, allowed=MAX_PART)
            name = next((name for name in archive.namelist() if "3d/3dmodel.model" in name.lower()), None)
            if name is None:
                raise _malformed("3mf", "it has no part 3D/3dmodel.model")
            unit, faces = _survey(io.BytesIO(archive.read(name)), notes)
    except (TexfError, MemoryError):
        raise
    except Exception as error:  # of the archive, of unpacking and of XML: a dozen types
        raise _malformed("3mf", "it is not a ZIP archive of XML", reason=f"{type(error).__name__}: {error}"[:200]) from error
    if not faces:
        raise no_triangles()
    placed = _parsed(data, "3mf", notes)
    placed.apply_transform(placing_of("Z", _METRES.get(unit.strip().lower(), 1e-3), "the 3MF file", notes).matrix)
    scene = read_trimesh(placed, notes)
    if len(scene.faces) != faces:
        raise _malformed("3mf", "trimesh reads another number of triangles than it places", value=len(scene.faces),
                         allowed=faces)
    scene.metadata["source_unit"] = unit
    return scene


def _survey(part, notes):
    """(unit, number of placed triangles) of a model part, by a single pass over its XML. Names contents that trimesh leaves
    out."""
    unit, objects, items = "millimeter", {}, []
    for event, element in ElementTree.iterparse(part, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start":
            unit = element.get("unit", unit) if tag == "model" else unit
        elif tag == "object":
            kind, name = element.get("type", "model"), element.get("name") or element.attrib["id"]
            triangles = sum(1 for child in element.iter() if child.tag.endswith("}triangle"))
            objects[element.attrib["id"]] = (triangles, list(_references(element, "}component")))
            if kind not in ("model", "surface"):
                notes.lose(f"the type {kind[:40]} of object '{name[:80]}'",
                           f"object '{name[:80]}' is a {kind[:40]} of the print; it is read as part of the surface")
            element.clear()
        elif tag == "build":
            items = list(_references(element, "}item"))
        elif tag not in _GEOMETRY and not tag.startswith("metadata"):
            notes.drop(f"3MF element '{tag[:40]}'")
    return unit, _placed_faces(objects, items)


def _references(element: Any, ending: str) -> Iterator[str]:
    """Ids of the objects that components or items name."""
    for child in element.iter():
        if child.tag.endswith(ending):
            if any(key.endswith("}path") for key in child.attrib):  # trimesh reads all objects of that part as this one
                raise SupportError("TXF-I31", "the 3MF file has objects in several parts, which is not supported")
            yield child.attrib["objectid"]


def _placed_faces(objects, items):
    """Number of triangles of all instances, before any is placed."""
    stack: list[tuple[str, tuple]] = [(key, ()) for key in items]
    faces = instances = 0
    while stack:
        key, above = stack.pop()
        instances += 1
        if instances > MAX_INSTANCES:
            raise LimitError("TXF-I41", "the 3MF file places too many objects", value=instances, allowed=MAX_INSTANCES)
        if key not in objects:
            raise _malformed("3mf", "it places an object that does not exist", value=key[:40])
        if key in above:
            raise InputError("TXF-I19", "the node graph is not a tree: an object contains itself", value=key[:40])
        faces += objects[key][0]
        check_face_count(faces)
        stack += [(child, (*above, key)) for child in objects[key][1]]
    return faces
