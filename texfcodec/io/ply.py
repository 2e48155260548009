"""Stanford PLY -> Scene: polygons, triangle strips and range grids, colours, UVs per vertex or per face corner; and decoded
streams -> binary little-endian PLY with sRGB vertex colours.

Own code rather than trimesh, which costs 0.9 s to import and forgets the file's TextureFile comment in some layouts.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..report import plural
from ..scene.scene import WRAP_REPEAT, Material, Scene
from ..scene.srgb import to_bytes
from .colour_range import unit_colours
from .corner_maps import alpha_into, channel_named, vertex_maps
from .file_search import read_file
from .images import TextureShelf
from .parts import Notes, Part, assemble, drop_alpha, linear_rgba, no_triangles
from .ply_strips import grid_triangles, strip_triangles
from .ply_tables import indices_of, read_tables
from .polygons import triangulate
from .precision import float32_is_enough
from .vertex_appearance import vertex_colours
from .written_normals import are_lit, normals_at_vertices

if TYPE_CHECKING:
    from ..texf import Texf

_LISTS = ("vertex_indices", "vertex_index", "vertex_indexes", "vertexindices", "vertex_ids", "vertices", "indices", "index")
_WEDGES = ("texcoord", "texcoords", "texture_coordinates", "uv")  # lists of face corners
_CORNER_COLORS = ("color", "colors", "colour", "rgb", "rgba")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"), ("tex_u", "tex_v"), ("u0", "v0"),
             ("s0", "t0"), ("texcoord_u", "texcoord_v"), ("uv_u", "uv_v"))
_BASE = ("", "diffuse_", "vertex_", "face_", "color_", "colour_", "col_")  # of a base colour, likeliest first
_OTHER_COLORS = re.compile("ambient|specular|emiss|normal|tangent")
_NORMALS = ("nx", "ny", "nz")
# Measurements and numbers of points and faces that no picture shows.
_UNSEEN = re.compile(r"quality|confidence|intensity|value|radius|flags?|curvature\w*|labels?|\w*_?id|density|error|weight|"
                     r"selected|"
                     r"scalar_\w+|class(ification)?|\w*time\w*|[tb][xyz]|return_?num\w*|num\w*returns?|scan_?angle\w*|x0|y0|z0")
_UNSEEN_ELEMENTS = ("camera",)
_STRIPS = ("tristrips", "tristrip")
_GRIDS = ("range_grid",)
_EMISSIVE = ("emissive_red", "emissive_green", "emissive_blue")
_WRITTEN = ("red", "green", "blue", "alpha")


def read_ply(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of a .ply file as a Scene. folder: of its textures. Raises InputError TXF-I21."""
    header, tables = read_tables(data)
    vertex, face = tables.get("vertex", {}), tables.get("face", tables.get("faces", {}))
    if any(axis not in vertex or isinstance(vertex[axis], tuple) for axis in "xyz"):
        raise InputError("TXF-I21", "the PLY file has no vertices with x, y and z")
    points = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    maps, alpha = vertex_maps(_named_values(vertex), notes)
    shelf = TextureShelf(notes)
    materials = _materials(header, folder, shelf)
    uv, color, normal = _uv(vertex), alpha_into(_vertex_color(vertex, notes), alpha), _normal(vertex)
    parts = []
    if (lists := _index_list(face)) is not None and len(lists[0]):
        part = Part(points, lists[0], 0, uv, color, "the PLY file", normal=normal, maps=maps)
        parts.append(_polygons(part, vertex, face, materials, notes))
    strips = _strips(points, tables, header, notes)
    if len(strips):
        parts.append(Part(points, strips, 0, uv, color, "the PLY file", normal=normal, maps=maps))
    if not sum(len(part.faces) for part in parts):
        raise no_triangles(_instead(tables))
    for name in tables.keys() - {"vertex", "face", "faces", *_STRIPS, *_GRIDS}:
        _drop_element(name, tables[name], notes)
    _drop_rest(vertex, face, parts, header, notes)
    metadata = {"comments": header.comments} if header.comments else {}
    return assemble(parts, materials, shelf.textures, notes, metadata)


def _index_list(table):
    """(values, lengths) of the list of vertices, or None."""
    return next((table[name] for name in _LISTS if isinstance(table.get(name), tuple)), None)


def _polygons(part, vertex, face, materials, notes):
    """The Part, whose vertices have their properties, with triangles and the properties of faces."""
    indices, sizes = indices_of(part.faces), np.asarray(_index_list(face)[1], np.int64)
    corners, row_of = triangulate(part.positions, indices, sizes, notes)
    wedges, color = _corner_uv(face, sizes, corners, notes), _face_color(face, sizes, corners, row_of, notes)
    faces = indices[corners]
    if color is not None and part.color is not None:
        notes.drop("colours of faces (the vertices have colours too)")
    return replace(part, faces=faces, material=_face_material(vertex, face, faces, row_of, materials, notes),
                   uv=part.uv if wedges is None else wedges, color=color if part.color is None else part.color)


def _strips(points, tables, header, notes):
    """Triangles of strips and range grids, int64 [F, 3]."""
    faces = [np.zeros((0, 3), np.int64)]
    faces += [strip_triangles(*lists) for name in _STRIPS if (lists := _index_list(tables.get(name, {}))) is not None]
    for name in _GRIDS:
        lists = _index_list(tables.get(name, {}))
        if lists is not None:
            faces.append(grid_triangles(points, indices_of(lists[0]), lists[1], header.comments, notes))
    return np.concatenate(faces)


def _materials(header, folder, shelf):
    if not header.textures:
        return [Material("default")]
    return [Material(name, texture=shelf.put(name, lambda name=name: read_file(folder, name, shelf.notes), name,
                                             (WRAP_REPEAT, WRAP_REPEAT))) for name in header.textures]


def _face_material(vertex, face, faces, row_of, materials, notes):
    """Material of each face, int64 [F], or 0 for all: MeshLab's texnumber of the face, or of its first vertex. -1 is a face
    without an image; a material for such faces is appended to materials."""
    number = face.get("texnumber", vertex.get("texnumber"))
    if number is None or isinstance(number, tuple) or materials[0].texture < 0 and len(materials) == 1:
        return 0
    inside = (faces[:, 0] >= 0) & (faces[:, 0] < len(number))
    number = indices_of(np.asarray(number))[row_of if "texnumber" in face else np.where(inside, faces[:, 0], 0)]
    count = len(materials)
    beyond = (number >= count) | (number < -1)
    if beyond.any():
        notes.lose("textures of faces (numbers beyond the TextureFiles)",
                   plural(int(beyond.sum()), "face has", "faces have") + " a texnumber without a TextureFile; the first is used")
    if (number == -1).any():
        materials.append(Material("default"))
    return np.where(number == -1, count, np.where(beyond, 0, number))


def _corner_uv(face, sizes, corners, notes):
    """UVs float64 [F, 3, 2], v downwards, from MeshLab's list of texture coordinates; None without."""
    name = next((name for name in _WEDGES if isinstance(face.get(name), tuple)), None)
    if name is None or not len(face[name][0]):
        return None
    values, lengths = face[name]
    if not np.array_equal(lengths, 2 * sizes):
        notes.lose(f"texture coordinates of face corners (PLY property '{name}')",
                   f"PLY property '{name}' of face does not have two numbers for each corner; it is left out")
        return None
    return _turned(np.asarray(values, np.float64).reshape(-1, 2)[corners])


def _uv(vertex):
    """UVs float64 [V, 2], v downwards, or None."""
    plain = {name for name in vertex if not isinstance(vertex[name], tuple)}
    names = next((names for names in _UV_NAMES if plain.issuperset(names)), None)
    return None if names is None else _turned(np.stack([np.asarray(vertex[name], np.float64) for name in names], axis=1))


def _turned(uv):
    uv[..., 1] = 1.0 - uv[..., 1]
    return uv


def _color_names(table):
    """Property names of red, green, blue and any alpha of a base colour, or []."""
    plain = [name for name in table if not isinstance(table[name], tuple)]
    by_prefix: dict[str, list[str]] = {}
    for name in plain:
        for words in (("red", "green", "blue", "alpha"), ("r", "g", "b", "a")):
            before, here, after = name.rpartition(words[0])
            if not here or (len(words[0]) == 1 and (before[-1:].isalnum() or after[:1].isalnum())) or _OTHER_COLORS.search(name):
                continue
            names = [f"{before}{word}{after}" for word in words]
            if all(name in plain for name in names[:3]):
                by_prefix.setdefault(before, [name for name in names if name in plain])
    order = {before: number for number, before in enumerate(_BASE)}
    return min(by_prefix.items(), key=lambda item: order.get(item[0], len(_BASE)), default=("", []))[1]


def _coded(table, names, notes, what):
    """sRGB-coded colours from properties, [n, 3 or 4] in [0, 1]. Properties of the same type share a range. what: for remarks."""
    columns = [np.asarray(table[name]) for name in names]
    if len({column.dtype for column in columns}) == 1:
        return unit_colours(np.stack(columns, axis=1), notes, what)
    floats = [column for column in columns if column.dtype.kind == "f"]
    shared = iter(unit_colours(np.stack(floats, axis=1), notes, what).T if floats else ())
    return np.stack([next(shared) if column.dtype.kind == "f" else unit_colours(column[:, None], notes, what)[:, 0]
                     for column in columns], axis=1)


def _vertex_color(vertex, notes):
    """float32 linear RGBA [V, 4], or None."""
    names = _color_names(vertex)
    return linear_rgba(_coded(vertex, names, notes, "colours of vertices")) if names else None


def _named_values(vertex):
    """Properties of vertices that hold a channel, [V, 1] or, of emissive_red and so on, [V, 3], linear."""
    named = {name: np.asarray(vertex[name])[:, None] for name in _map_names(vertex)}
    if all(name in vertex for name in _EMISSIVE):
        coded = unit_colours(np.stack([np.asarray(vertex[name]) for name in _EMISSIVE], axis=1), Notes(), "")
        named["emissive"] = linear_rgba(coded)[:, :3]
    return named


def _map_names(vertex):
    """Names of properties that are one channel; alpha beside red, green and blue is of the colour."""
    return [name for name in vertex if not isinstance(vertex[name], tuple) and channel_named(name)
            and name not in _color_names(vertex)]


def _face_color(face, sizes, corners, row_of, notes):
    """float32 linear RGBA [F, 3, 4] from colours of faces or from a list of corner colours; None without."""
    names = _color_names(face)
    if names:
        return np.repeat(linear_rgba(_coded(face, names, notes, "colours of faces"))[row_of][:, None], 3, axis=1)
    for name in _CORNER_COLORS:
        values, lengths = face[name] if isinstance(face.get(name), tuple) else ((), ())
        width = next((width for width in (3, 4) if len(values) and np.array_equal(lengths, width * sizes)), None)
        if width:
            return linear_rgba(unit_colours(np.asarray(values).reshape(-1, width), notes, "colours of face corners"))[corners]
    return None


def _normal(vertex):
    """Normals float64 [V, 3], or None."""
    if any(name not in vertex or isinstance(vertex[name], tuple) for name in _NORMALS):
        return None
    return np.stack([np.asarray(vertex[name], np.float64) for name in _NORMALS], axis=1)


def _rows(table):
    """Number of rows of an element."""
    first = next(iter(table.values()), ())
    return len(first[1] if isinstance(first, tuple) else first)


def _instead(tables):
    """Contents of a file without triangles, in words."""
    vertex = tables["vertex"]
    if {"f_dc_0", "rot_0", "scale_0"} <= vertex.keys():
        return plural(_rows(vertex), "Gaussian splat", "Gaussian splats")
    others = [f"{_rows(table)} rows of '{name}'" for name, table in tables.items() if name != "vertex" and _rows(table)]
    return ", ".join([plural(_rows(vertex), "point", "points") + " without faces", *others]) if _rows(vertex) else ""


def _drop_element(name, table, notes):
    if name in _UNSEEN_ELEMENTS:
        notes.remark(f"PLY element '{name}' is left out")
    elif _rows(table):
        notes.drop(f"PLY element '{name}' ({plural(_rows(table), 'row', 'rows')})")


def _drop_rest(vertex, face, parts, header, notes):
    """Name the properties that are not read, and textures or texture coordinates that lack their counterpart."""
    for part in parts:
        drop_alpha(part.color, notes)
    has_uv = any(part.uv is not None for part in parts)
    if has_uv and not header.textures:
        notes.remark("texture coordinates are left out: the file names no TextureFile")
    if not has_uv and header.textures:
        notes.lose(f"texture '{header.textures[0][:160]}' (no texture coordinates)",
                   "the file names a texture but has no texture coordinates; UV (0, 0) is used")
    read = {*_map_names(vertex), *_EMISSIVE, *"xyz", *_LISTS, "texnumber", *_NORMALS, *_WEDGES,
            *(name for names in _UV_NAMES for name in names)}
    for table, kind in ((vertex, "vertex"), (face, "face")):
        known = {*read, *_color_names(table), *(_CORNER_COLORS if kind == "face" else ())}
        for name in table:
            if name not in known and _UNSEEN.fullmatch(name):
                notes.remark(f"PLY property '{name}' of {kind} is left out")
            elif name not in known:
                notes.drop(f"PLY property '{name}' of {kind}")


def write_ply_surface(texf: Texf) -> tuple[list, list[str]]:
    """Return (a PLY file as pieces of bytes, names of what it loses) of a decoded stream: the mesh with vertex colours, 8-bit
    sRGB, alpha only if the stream has any. Normals are written if no vertex has several, because splitting vertices would tear
    the surface."""
    vertex, index, _, rgba = vertex_colours(texf, with_material=False)
    faces = np.empty(len(index), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, index
    normals, dropped = None, []
    if len(index) and are_lit(texf):
        normals = normals_at_vertices(texf, index, len(vertex))
        dropped = ["the shading of hard edges"] * (normals is None)
    vertices, lines = _write_vertices(texf, texf.positions[vertex], to_bytes(rgba), normals)
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return [_write_header(lines), vertices.data, faces.data], dropped


def write_ply_points(texf: Texf) -> list:
    """Return a PLY file with a decoded stream's voxel centres and their colours, as pieces of bytes."""
    voxels = texf.voxels()
    vertices, lines = _write_vertices(texf, voxels["center"], voxels["rgba"])
    return [_write_header(lines), vertices.data]


def _write_vertices(texf, points, rgba, normals=None):
    """(packed vertex records, their header lines). Coordinates are double if float would lose the lattice."""
    kind, name = ("<f4", "float") if float32_is_enough(texf) else ("<f8", "double")
    channels = _WRITTEN[: 4 if texf.has_alpha else 3]
    fields = [("p", kind, 3), ("n", "<f4", 3), ("c", "u1", len(channels))]
    records = np.empty(len(points), np.dtype([f for f in fields if f[0] != "n" or normals is not None]))
    records["p"], records["c"] = points, rgba[:, : len(channels)]
    lines = [f"element vertex {len(points)}", *(f"property {name} {axis}" for axis in "xyz")]
    if normals is not None:
        records["n"] = normals
        lines += [f"property float {axis}" for axis in _NORMALS]
    return records, lines + [f"property uchar {channel}" for channel in channels]


def _write_header(lines):
    return "\n".join(["ply", "format binary_little_endian 1.0", "comment texfcodec", *lines, "end_header", ""]).encode()
