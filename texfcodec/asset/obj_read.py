"""Wavefront OBJ -> Scene: polygons fan out, groups keep their materials, v is turned downwards.

Own code rather than trimesh, which rebuilds vertices, knows no texture options and wrap, and costs 0.9 s to import.
Rows of one statement are parsed together by numpy; only their sorting is a Python loop.
"""

import numpy as np

from ..errors import InputError
from .image_read import TextureShelf, find_file
from .mtl_read import ObjMaterial, decode_text, read_mtl, scene_material
from .parts import Part, assemble, linear_rgba
from .polygons import counting, fan_triangles, parse_numbers

_SILENT = {"g", "s", "#"}


class _Statements:
    """The file sorted by statement: rows of v, vt and f as bytes, with what each face row must remember."""

    def __init__(self):
        self.v, self.vt, self.f = [], [], []
        self.seen = []  # per face row: (number of v rows, of vt rows before it), for negative indices
        self.material = []  # per face row: index into materials
        self.lines = {"v": [], "vt": [], "f": []}  # line numbers, for messages
        self.materials, self.libraries, self.objects = [], [], []


def read_obj(data, folder, notes):
    """bytes of an .obj file -> Scene. folder: where its libraries and textures are. Errors: TXF-I20 with the line."""
    rows = _sort(data, notes)
    if not rows.f:
        raise InputError("TXF-I15", "the input has no triangles")
    vertices = _floats(rows.v, rows.lines["v"], 3)
    corners, sizes = _corners(rows)
    faces_at, row_of = fan_triangles(sizes, notes)
    library = _libraries(rows.libraries, folder, notes)
    shelf = TextureShelf(notes)
    chosen = [_find_material(name, library, notes) for name in rows.materials]
    materials = [scene_material(material, folder, shelf) for material in chosen]
    material = np.array(rows.material, np.int64)[row_of]
    positions = corners[faces_at][..., 0]
    part = Part(vertices[:, :3], positions, material, _uv(rows, corners[faces_at][..., 1], material, chosen),
                _vertex_color(vertices), "the OBJ file")
    if not any(item.texture for item in chosen) and rows.vt:
        notes.drop("vt (no texture uses it)")
    metadata = {"objects": rows.objects} if rows.objects else {}
    return assemble([part], materials, shelf.textures, notes, metadata)


def _sort(data, notes):
    rows, current, index_of = _Statements(), None, {}
    for number, line in enumerate(bytes(data).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").split(b"\n"), 1):
        head, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if b"#" in rest and head in (b"v", b"vt", b"f"):
            rest = rest.partition(b"#")[0]
        if head == b"v":
            rows.v.append(rest)
            rows.lines["v"].append(number)
        elif head == b"f":
            if current not in index_of:
                index_of[current] = len(rows.materials)
                rows.materials.append(current)
            rows.f.append(rest)
            rows.seen.append((len(rows.v), len(rows.vt)))
            rows.material.append(index_of[current])
            rows.lines["f"].append(number)
        elif head == b"vt":
            rows.vt.append(rest)
            rows.lines["vt"].append(number)
        elif head == b"usemtl":
            current = decode_text(rest).strip()
        elif head:
            _other(rows, decode_text(head), decode_text(rest).strip(), notes)
    return rows


def _other(rows, head, rest, notes):
    if head == "mtllib":
        rows.libraries.append(rest)
    elif head == "o":
        if rest and len(rows.objects) < 1000:
            rows.objects.append(rest)
    elif head == "vn":
        notes.drop("NORMAL")
    elif head not in _SILENT and not head.startswith("#"):
        notes.drop(f"OBJ statement '{head[:20]}'")


def _floats(rows, lines, least, fill=np.nan):
    """Rows of numbers -> float64 [n, widest]; a row may lack columns beyond `least`, they are `fill` then."""
    widths = np.array([len(row.split()) for row in rows] or [0])
    widest = int(widths.max())
    values = parse_numbers(b" ".join(rows), np.float64)
    if values is None or len(values) != widths.sum() or (rows and widths.min() < least):
        raise _bad_row(rows, lines, float, least)
    out = np.full((len(rows), max(widest, least)), fill)
    if rows:
        out[np.arange(out.shape[1]) < widths[:, None]] = values
    return out


def _bad_row(rows, lines, kind, least):
    for row, line in zip(rows, lines, strict=True):
        try:
            if len([kind(item) for item in row.split()]) >= least:
                continue
        except ValueError:
            pass
        return InputError("TXF-I20", "an OBJ statement cannot be read", line=line, value=decode_text(row).strip()[:80])
    return InputError("TXF-I20", "an OBJ statement cannot be read")


def _corners(rows):
    """(int64 [C, 2] position and UV indices from 0, UV -1 where absent; int64 [rows] corners per face)."""
    texts = [(row.strip() + b" ").replace(b"//", b"/0/").replace(b"/ ", b"/0 ") for row in rows.f]
    sizes = np.array([len(text.split()) for text in texts])
    slashes = np.array([text.count(b"/") for text in texts])
    out = np.empty((int(sizes.sum()), 2), np.int64)
    starts = np.cumsum(sizes) - sizes
    for depth in (0, 1, 2):
        chosen = np.flatnonzero((slashes == depth * sizes) & (sizes > 0))
        if not len(chosen):
            continue
        values = parse_numbers(b"".join(texts[i] for i in chosen).replace(b"/", b" "), np.int64)
        even = all(item.count(b"/") == depth for i in chosen for item in texts[i].split())
        if values is None or not even or len(values) != sizes[chosen].sum() * (depth + 1):
            raise _bad_face(rows, texts)
        where = np.repeat(starts[chosen], sizes[chosen]) + counting(sizes[chosen])
        out[where] = np.pad(values.reshape(-1, depth + 1)[:, :2], ((0, 0), (0, max(1 - depth, 0))))
        slashes[chosen] = -1
    if (slashes[sizes > 0] >= 0).any():
        raise _bad_face(rows, texts)
    seen = np.repeat(np.array(rows.seen, np.int64), sizes, axis=0)
    _refuse_zero(rows, out, sizes)
    return np.where(out < 0, out + seen, out - 1), sizes


def _refuse_zero(rows, corners, sizes):
    if (corners[:, 0] == 0).any():
        row = int(np.repeat(np.arange(len(sizes)), sizes)[np.argmax(corners[:, 0] == 0)])
        raise InputError("TXF-I20", "an OBJ face names vertex 0; indices start at 1", line=rows.lines["f"][row])


def _bad_face(rows, texts):
    """The error naming the first face row that no pattern fits."""
    for text, line in zip(texts, rows.lines["f"], strict=True):
        items = [item.split(b"/") for item in text.split()]
        good = all(1 <= len(item) <= 3 and all(number.lstrip(b"+-").isdigit() for number in item) for item in items)
        if not good or len({len(item) for item in items}) > 1:
            return InputError("TXF-I20", "an OBJ face cannot be read", line=line, value=decode_text(text).strip()[:80])
    return InputError("TXF-I20", "an OBJ face cannot be read")


def _uv(rows, indices, material, chosen):
    """float64 [F, 3, 2] with v downwards, texture options applied; None without texture coordinates."""
    if not rows.vt:
        return None
    table = _floats(rows.vt, rows.lines["vt"], 1, fill=0.0)[:, :2]  # a lone u has v = 0
    table = np.pad(table, ((0, 0), (0, 2 - table.shape[1])))
    if indices.max() >= len(table) or indices.min() < -1:
        raise InputError("TXF-I13", "a face of the OBJ file names a texture coordinate that does not exist",
                         allowed=len(table))
    uv = np.where((indices >= 0)[..., None], table[indices], 0.0)
    scale = np.array([item.uv_scale for item in chosen])[material][:, None]
    offset = np.array([item.uv_offset for item in chosen])[material][:, None]
    uv = uv * scale + offset
    uv[..., 1] = 1.0 - uv[..., 1]
    return uv


def _vertex_color(vertices):
    """'v x y z r g b' -> float32 linear RGBA [V, 4]; white where a row has none. Values above 1 mean a 0..255 scale."""
    if vertices.shape[1] < 6:
        return None
    coded = np.where(np.isnan(vertices[:, 3:6]), 1.0, vertices[:, 3:6])
    present = ~np.isnan(vertices[:, 5])
    if (coded[present] > 1.0).any():
        coded[present] /= 255.0
    return linear_rgba(coded)


def _libraries(names, folder, notes):
    """All materials of the named libraries; a missing file is a fault."""
    found = {}
    for name in dict.fromkeys(names):
        paths = [find_file(folder, name)] if find_file(folder, name) else [find_file(folder, item) for item in name.split()]
        for path in paths:
            if path is None:
                notes.fault("TXF-I16", f"material file '{name}' is missing; its materials are white")
                continue
            found.update(read_mtl(path.read_bytes(), notes))
    return found


def _find_material(name, library, notes):
    if name is None:
        return ObjMaterial("default", np.ones(4))
    if name not in library:
        notes.warn(f"material '{name}' is not defined; it is white")
        return ObjMaterial(name, np.ones(4))
    return library[name]
