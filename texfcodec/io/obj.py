"""Wavefront OBJ -> Scene: polygons become triangles, groups keep their materials, v points downwards; and decoded streams -> OBJ,
with the MTL file of mtl.py beside it if there are textures.

Own code rather than trimesh, which rebuilds vertices, ignores texture options and wrap, and takes 0.9 s to import.
numpy parses all rows of a statement together; only the sorting of rows is a Python loop.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..report import plural
from .file_search import find_file, in_encoding, missing_file, readings
from .images import TextureShelf
from .mtl import ObjMaterial, decode_text, material_names, read_mtl, scene_material
from .obj_colours import MRGB, VCOLOR, vertex_colours_of
from .opened import opened
from .parts import Notes, Part, assemble, no_triangles
from .polygons import counting, parse_numbers, triangulate
from .precision import decimal_digits
from .vertex_appearance import vertex_colours
from .visibility import turn_where_all_vanish
from .written_normals import are_lit, distinct_normals

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..texf import Texf
    from .output_textures import Textured

_SILENT = {"g", "s", "mg", "bevel", "c_interp", "d_interp", "lod"}  # groups, smoothing and how to draw curves
_RENDERING = {"shadow_obj", "trace_obj", "ctech", "stech"}
_SHAPES = {"p": "point", "l": "line", "curv": "free-form curve", "curv2": "free-form curve", "surf": "free-form surface"}
_OF_SHAPES = {"vp", "parm", "trim", "hole", "scrv", "sp", "end", "con", "bmat", "step", "cstype", "deg"}
_DATA = (b"v", b"vt", b"vn", b"f")
_CONTINUED = re.compile(rb"(?<![\x81-\xfe])\\\n")  # behind such a byte "\\" is half of a character of Shift-JIS, GBK or Big5


class _Statements:
    """The file sorted by statement: rows of v, vt, vn and f as bytes, and the state of the file at face rows."""

    def __init__(self, lines):
        self.lines = lines
        self.v, self.vt, self.vn, self.f = [], [], [], []
        self.relative = {}  # face row with a minus sign -> (v, vt and vn rows before it)
        self.runs = []  # (first face row, material name): usemtl holds until the next one
        self.libraries, self.objects = [], []
        self.colours = []  # (v rows before it, text) of each comment with colours
        self.shapes = {}  # what is there beside faces -> how many

    def line(self, statement, row):
        """Line number of the row-th v, vt or f, for messages."""
        numbers = [number for number, line in enumerate(self.lines, 1) if line.split(None, 1)[:1] == [statement]]
        return numbers[row] if row < len(numbers) else None


def read_obj(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of an .obj file as a Scene. folder: of its libraries and textures. Raises InputError TXF-I20 with the
    line."""
    rows = _sort(data, notes)
    if not rows.f:
        raise no_triangles(_beside_faces(rows))
    for kind, count in rows.shapes.items():
        notes.drop(plural(count, kind, kind + "s"))
    vertices = _floats(rows, b"v", rows.v, 3)
    corners, sizes = _corners(rows)
    triangles, polygon = triangulate(vertices[:, :3], corners[:, 0], sizes, notes)
    names, material = _face_materials(rows)
    library = _libraries(rows.libraries, folder, notes)
    shelf = TextureShelf(notes)
    chosen = _find_materials(names, library, notes)
    materials = [scene_material(item, folder, shelf) for item in chosen]
    turn_where_all_vanish(materials, "the MTL file", notes)
    _respell(materials, shelf.textures, notes.encoding)
    faces, texels, material = corners[triangles, 0], corners[triangles, 1], material[polygon]
    part = Part(vertices[:, :3], faces, material, _uv(rows, texels, material, chosen),
                vertex_colours_of(vertices, rows.colours, notes), "the OBJ file", normal=_normal(rows, corners[triangles, 2]))
    if not any(item.has_image for item in chosen) and rows.vt:
        notes.remark("no texture uses vt; it is left out")
    metadata = {"objects": [in_encoding(name, notes.encoding) for name in rows.objects]} if rows.objects else {}
    return assemble([part], materials, shelf.textures, notes, metadata)


def _respell(materials, textures, encoding):
    """Decode the names of materials and textures by the encoding that file names revealed."""
    for item in (*materials, *textures):
        item.name = in_encoding(item.name, encoding)


def _sort(data, notes):
    lines = _clean(data).split(b"\n")
    rows = _Statements(lines)
    v, vt, vn, f = rows.v, rows.vt, rows.vn, rows.f
    for line in lines:
        head = line[:2]
        if head == b"v ":
            v.append(line[2:])
        elif head == b"f ":
            if b"-" in line:
                rows.relative[len(f)] = len(v), len(vt), len(vn)
            f.append(line[2:])
        elif head == b"vt":
            vt.append(line[3:])
        elif head == b"vn":
            vn.append(line[3:])
        elif head[:1] == b"#":
            if line.startswith((MRGB, VCOLOR)):
                rows.colours.append((len(v), line))
        elif head:
            head, _, rest = line.partition(b" ")
            _other(rows, decode_text(head), decode_text(rest.strip()), notes)
    return rows


def _clean(data):
    """The text without tabs, indents, continued lines and comments in data, with line ends "\\n". The number of lines stays."""
    data = bytes(data).replace(b"\r\n", b"\n").replace(b"\t", b" ")
    if b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    if b"\\\n" in data:  # a continued line moves up, an empty one keeps the count
        parts = _CONTINUED.split(data)
        data = parts[0] + b"".join(_continued(part) for part in parts[1:])
    if b"\n " in data or data[:1] == b" ":
        data = b"\n".join(line.lstrip() for line in data.split(b"\n"))
    if data.count(b"#") > data.count(b"\n#") + (data[:1] == b"#"):
        data = b"\n".join(_uncommented(line) for line in data.split(b"\n"))
    return data


def _continued(part):
    rest, end, after = part.partition(b"\n")
    return b" " + rest + end + (b"\n" if end else b"") + after


def _uncommented(line):
    """The line without a comment if it is a statement of numbers; names may contain "#"."""
    return line.partition(b"#")[0] if b"#" in line and line.split(None, 1)[0] in _DATA else line


def _other(rows, head, rest, notes):
    if head == "usemtl":
        rows.runs.append((len(rows.f), rest))
    elif head == "mtllib":
        rows.libraries.append(rest)
    elif head == "o":
        if rest and len(rows.objects) < 1000:
            rows.objects.append(rest)
    elif head == "fo":  # as faces were called before version 3
        rows.f.append(rest.encode())
    elif head in _SHAPES:
        rows.shapes[_SHAPES[head]] = rows.shapes.get(_SHAPES[head], 0) + 1
    elif head in _RENDERING:
        notes.remark(f"OBJ statement '{head}' is left out")
    elif head not in _SILENT and head not in _OF_SHAPES:
        notes.drop(f"OBJ statement '{head[:20]}'")


def _beside_faces(rows):
    """Contents of a file without faces, in words."""
    shown = [plural(count, kind, kind + "s") for kind, count in rows.shapes.items()]
    return ", ".join(shown) or (plural(len(rows.v), "vertex", "vertices") + " without faces") * bool(rows.v)


def _face_materials(rows):
    """(material names in order of first use, int64 [rows] index into them); None is the default material."""
    starts = [0, *(start for start, _ in rows.runs)]
    lengths = np.diff([*starts, len(rows.f)])
    index: dict[str | None, int] = {}
    used = [index.setdefault(name, len(index)) if length else 0
            for name, length in zip([None, *(name for _, name in rows.runs)], lengths, strict=True)]
    return list(index), np.repeat(np.array(used, np.int64), lengths)


def _floats(rows, statement, texts, least, fill=np.nan):
    """Rows of numbers -> float64 [n, widest]. Rows have at least `least` numbers; `fill` stands for absent ones."""
    widths = np.array([len(text.split()) for text in texts])
    values = parse_numbers(b" ".join(texts), np.float64)
    if not len(texts):
        return np.zeros((0, least))
    if values is None or len(values) != widths.sum() or widths.min() < least:
        raise _bad_row(rows, statement, texts, least)
    if widths.min() == widths.max():
        return values.reshape(len(texts), -1)
    out = np.full((len(texts), int(widths.max())), fill)
    out[np.arange(out.shape[1]) < widths[:, None]] = values
    return out


def _bad_row(rows, statement, texts, least):
    """The error naming the first row that is not `least` or more numbers."""
    for row, text in enumerate(texts):
        values = parse_numbers(text, np.float64)
        if values is None or len(values) != len(text.split()) or len(values) < least:
            return _unreadable(rows, statement, row, text)
    return InputError("TXF-I20", "an OBJ statement cannot be read")


def _unreadable(rows, statement, row, text):
    return InputError("TXF-I20", "an OBJ statement cannot be read", line=rows.line(statement, row),
                      value=decode_text(statement + b" " + text)[:80])


def _corners(rows):
    """(int64 [C, 3] position, UV and normal indices from 0, the last two below 0 where absent; int64 [rows] corners per face)."""
    texts = rows.f
    joined = b"\n".join(texts) + b"\n"
    if any(hole in joined for hole in (b"//", b"/ ", b"/\n")):
        texts = [(text + b" ").replace(b"//", b"/0/").replace(b"/ ", b"/0 ") for text in texts]
    sizes = np.array([len(text.split()) for text in texts])
    slashes = np.array([text.count(b"/") for text in texts])
    out = np.zeros((int(sizes.sum()), 3), np.int64)
    starts = np.cumsum(sizes) - sizes
    left = sizes > 0
    for depth in (0, 1, 2):  # v, v/vt, v/vt/vn
        chosen = np.flatnonzero(left & (slashes == depth * sizes))
        if not len(chosen):
            continue
        values = _index_tuples(texts if len(chosen) == len(texts) else [texts[i] for i in chosen], depth)
        if values is None or len(values) != sizes[chosen].sum():
            raise _bad_face(rows, texts)
        where = np.repeat(starts[chosen], sizes[chosen]) + counting(sizes[chosen])
        out[where, : depth + 1] = values
        left[chosen] = False
    if left.any():
        raise _bad_face(rows, texts)
    return _from_zero(rows, out, sizes), sizes


def _index_tuples(texts, depth):
    """Rows of 'a/b/c' items with `depth` slashes each -> int64 [n, depth + 1]; None if they contain anything else."""
    text = b" ".join(b" ".join(texts).split()) + b" "
    values = parse_numbers(text.replace(b"/", b" "), np.int64)
    letters = np.frombuffer(text, np.uint8)
    separators = letters[(letters == 32) | (letters == 47)]
    if values is None or len(values) % (depth + 1) or (len(values) and len(separators) != len(values)):
        return None
    slots = separators[: len(values)].reshape(-1, depth + 1)
    if (slots[:, :depth] != 47).any() or (slots[:, depth] != 32).any():
        return None
    return values.reshape(-1, depth + 1)


def _from_zero(rows, corners, sizes):
    """OBJ counts from 1, and from the end so far with a minus sign -> indices from 0; an absent UV or normal becomes -1."""
    bad = np.flatnonzero(corners[:, 0] == 0)
    if len(bad):
        row = int(np.searchsorted(np.cumsum(sizes), bad[0], "right"))
        raise _unreadable(rows, b"f", row, rows.f[row])
    seen = np.zeros((len(sizes), 3), np.int64)
    if rows.relative:
        seen[list(rows.relative)] = list(rows.relative.values())
    before = np.repeat(seen, sizes, axis=0)
    return np.where(corners < 0, np.where(corners + before < 0, -2, corners + before), corners - 1)


def _bad_face(rows, texts):
    """The error naming the first face row that no pattern fits."""
    for row, text in enumerate(texts):
        depths = {item.count(b"/") for item in text.split()}
        if depths and (len(depths) > 1 or max(depths) > 2 or _index_tuples([text], max(depths)) is None):
            return _unreadable(rows, b"f", row, rows.f[row])
    return InputError("TXF-I20", "an OBJ face cannot be read")


def _uv(rows, indices, material, chosen):
    """UVs float64 [F, 3, 2], v downwards, with texture options applied; None without texture coordinates."""
    if not rows.vt:
        return None
    table = _floats(rows, b"vt", rows.vt, 1, fill=0.0)[:, :2]  # a lone u has v = 0
    table = np.pad(table, ((0, 0), (0, 2 - table.shape[1])))
    if indices.max() >= len(table) or indices.min() < -1:
        raise InputError("TXF-I13", "a face of the OBJ file refers to a texture coordinate that does not exist",
                         allowed=len(table))
    scale = np.array([item.uv_scale for item in chosen])[material][:, None]
    offset = np.array([item.uv_offset for item in chosen])[material][:, None]
    uv = table[indices] * scale + offset
    uv[..., 1] = 1.0 - uv[..., 1]
    uv[indices < 0] = 0.0
    return uv


def _normal(rows, indices):
    """Normals float64 [F, 3, 3], zero for corners without; None if no corner has any."""
    if not rows.vn or (indices < 0).all():
        return None
    table = _floats(rows, b"vn", rows.vn, 3)[:, :3]
    if indices.max() >= len(table) or indices.min() < -1:
        raise InputError("TXF-I13", "a face of the OBJ file refers to a normal that does not exist", allowed=len(table))
    return np.where((indices < 0)[..., None], 0.0, table[indices])


def _libraries(names, folder, notes):
    """All materials of the named libraries; a missing library is a fault. Without names, the library beside the OBJ file."""
    library = {}
    for name in dict.fromkeys(names):
        whole = find_file(folder, name, notes)
        for path in [whole] if whole else [find_file(folder, item, notes) for item in name.split()] or [None]:
            data = _library_bytes(path) if path else None
            if data is None:
                error = missing_file(name, "material file")
                notes.fault(str(error.code), f"{error.message}; its materials are white", f"material file '{name[:160]}'")
                continue
            library.update(read_mtl(data, notes))
    return library or _library_beside(notes)


def _library_beside(notes):
    """Materials of the MTL file with the name of the OBJ file, {} if it does not exist."""
    beside = notes.path.with_suffix(".mtl") if notes.path is not None and notes.path.name else None
    data = _library_bytes(beside) if beside is not None and beside.is_file() else None
    if beside is None or data is None:
        return {}
    opened(beside)
    notes.remark(f"materials are read from '{beside.name}', which the OBJ file does not name")
    return read_mtl(data, notes)


def _library_bytes(path):
    """Bytes of a material file, or None if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return None


def _find_materials(names, library, notes):
    """ObjMaterials by name; None is the default. An undefined name is looked up in other encodings, letter case and blanks; else
    its material is white and a loss."""
    similar: dict[str, set[str]] = {}
    for key in library if any(name is not None and name not in library for name in names) else ():
        for reading in (key, *readings(key)):
            similar.setdefault(_plain(reading), set()).add(key)
    return [_find_material(name, library, similar, notes) for name in names]


def _find_material(name, library, similar, notes):
    if name is None:
        return ObjMaterial("default", np.ones(4))
    if name in library:
        return library[name]
    keys = {key for reading in (name, *readings(name)) for key in similar.get(_plain(reading), ())}
    if len(keys) != 1:
        notes.lose(f"material '{name}' (not defined)", f"material '{name}' is not defined; it is white")
        return ObjMaterial(name, np.ones(4))
    key = keys.pop()
    notes.remark(f"material '{key}' of the MTL file is used for '{name}'")
    return library[key]


def _plain(name):
    return " ".join(name.strip("\"'").split()).casefold()


def write_obj_textured(texf: Texf, mesh: Textured, mtl_name: str) -> Iterator[bytes]:
    """Yield the pieces of an OBJ file with shading normals, and texture coordinates, v upwards, if there are images. mesh: the
    decoded stream's mesh with images; mtl_name: file name of the library."""
    yield f"# texfcodec\nmtllib {mtl_name}\n".encode()
    yield _write_rows(f"v {_number(texf)} {_number(texf)} {_number(texf)}\n", texf.positions)
    place = None
    if mesh.textures:
        uv, place = np.unique(mesh.corner_uv.reshape(-1, 2), axis=0, return_inverse=True)
        yield _write_rows("vt %.8g %.8g\n", np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1))
        place = place.reshape(-1, 3)
    normal = _normals_of(texf)
    yield _normal_rows(normal)
    names = material_names(texf, mesh)
    for number in np.unique(mesh.materials.face_row):
        yield f"usemtl {names[number]}\n".encode()
        yield _face_rows(mesh.materials.face_row == number, texf.faces, place, normal[1])


def write_obj_coloured(texf: Texf) -> Iterator[bytes]:
    """Yield the pieces of an OBJ file with colours at vertices, after the coordinates (sRGB, 0..1), as most tools read them, and
    shading normals."""
    vertex, index, _, rgba = vertex_colours(texf, with_material=False)
    yield b"# texfcodec\n"
    yield _write_rows(_coloured_line(texf), np.hstack([texf.positions[vertex], rgba[:, :3] / 255.0]))
    normal = _normals_of(texf)
    yield _normal_rows(normal)
    yield _face_rows(slice(None), index, None, normal[1])


def _normals_of(texf):
    """(normals [N, 3], index int64 [F, 3]), or (no rows, None) if no material is lit. Normals are always written, because readers
    differ in how they shade without vn."""
    return distinct_normals(texf) if len(texf.faces) and are_lit(texf) else (np.zeros((0, 3)), None)


def _normal_rows(normal):
    return _write_rows("vn %.4g %.4g %.4g\n", normal[0] + 0.0)


def _face_rows(chosen, vertex, uv, normal):
    """Lines of faces. vertex, uv, normal: indices int64 [F, 3] from 0; uv and normal may be None."""
    kinds = [index[chosen] + 1 for index in (vertex, uv, normal) if index is not None]
    corner = "%d" + ("/%d" if uv is not None else "/" if normal is not None else "") + "/%d" * (normal is not None)
    return _write_rows(f"f {corner} {corner} {corner}\n", np.stack(kinds, 2).reshape(-1, 3 * len(kinds)))


def write_obj_points(texf: Texf) -> Iterator[bytes]:
    """Yield the pieces of an OBJ file with the voxel centres of a decoded stream as points."""
    voxels = texf.voxels()
    yield b"# texfcodec\n"
    yield _write_rows(_coloured_line(texf), np.hstack([voxels["center"], voxels["rgba"][:, :3] / 255.0]))
    yield _write_rows("p %d\n", np.arange(1, len(voxels["rgba"]) + 1)[:, None])


def _number(texf):
    return f"%.{decimal_digits(texf)}g"


def _coloured_line(texf):
    return f"v {_number(texf)} {_number(texf)} {_number(texf)} %.4f %.4f %.4f\n"


def _write_rows(line, values, block=65536):
    """Format every row of values [N, k] by the same line."""
    parts = []
    for start in range(0, len(values), block):
        rows = values[start : start + block]
        parts.append((line * len(rows)) % tuple(rows.ravel().tolist()))
    return "".join(parts).encode()
