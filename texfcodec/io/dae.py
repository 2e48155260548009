"""COLLADA (.dae) -> Scene: pycollada parses; this file places meshes, splits polygons and chooses the base colour.

It uses pycollada directly, because trimesh fans polygons, takes the same UV set whatever the material binds, and drops silently
what pycollada could not read.
"""

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, SupportError
from ..report import plural
from ..scene.scene import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene
from ..scene.srgb import srgb_to_linear
from .authored_normals import place_normals
from .colour_range import unit_colours
from .file_search import read_file
from .images import TextureShelf
from .parts import Notes, Part, alpha_mode_of, assemble, check_face_count, linear_rgba, linearise_factors, no_triangles
from .placing import placing_of
from .polygons import triangulate
from .vertex_pools import VertexPools
from .visibility import turn_where_all_vanish

_WRAPS = {"WRAP": WRAP_REPEAT, "CLAMP": WRAP_CLAMP, "BORDER": WRAP_CLAMP, "NONE": WRAP_CLAMP, "MIRROR": WRAP_MIRROR}
# What exporters write of every material, and physical shading leaves out, but for textures and colours that are not grey.
_MATTE, _GREY = ("ambient", "shininess", "reflectivity", "index_of_refraction"), ("specular", "reflective")
_LINES = re.compile(rb"<((?:\w+:)?linestrips)\b(?:[^>]*/>|[^>]*>.*?</\1\s*>)", re.DOTALL)
_LOOKAT = re.compile(rb"<((?:\w+:)?)lookat\b[^>]*>([^<]*)</\1lookat\s*>")
_SAME = 1e-3  # of colours that are written with three digits
CAMERAS = "cameras are left out"
_USED_INPUTS = {"VERTEX", "TEXCOORD", "COLOR", "NORMAL"}


def read_dae(data: bytes, folder: Path, notes: Notes) -> Scene:
    """Read the bytes of a .dae file as a Scene. folder: where its images are. Errors: TXF-I24, SupportError TXF-I35 without
    pycollada."""
    document = _parse(_with_matrices(_without_lines(_with_points(bytes(data), notes), notes), notes))
    errors = _name_errors(document, notes)
    if document.scene is None:
        raise _nothing(errors, notes)
    asset = document.assetInfo
    placing = _placing(asset, notes)
    materials, parts, faces, pools = _ColladaMaterials(folder, notes), [], 0, VertexPools()
    for geometry in _geometries(document, notes):
        for primitive in geometry.original.primitives:
            part = _part(primitive, geometry, materials, (placing, pools), notes)
            if part is not None:
                parts.append(part)
                faces += len(part.faces)
                check_face_count(faces)
    if not faces:
        raise _nothing(errors, notes)
    _drop_rest(document, notes)
    turn_where_all_vanish(materials.rows, "the COLLADA file", notes)
    exporters = " ".join(str(contributor.authoring_tool) for contributor in asset.contributors)
    linearise_factors([material.factor for material in materials.rows], exporters, "COLLADA file", notes)
    metadata = {"source_up_axis": placing.up, "source_unit_in_metres": placing.metres}
    return assemble(parts, materials.rows, materials.shelf.textures, notes, metadata, pools)


def _placing(asset, notes):
    """The Placing of the document's axes and unit; without them COLLADA's defaults, Y_UP and a metre."""
    node = getattr(asset, "xmlnode", None)
    axis = None if node is None else node.find(".//{*}up_axis")
    up = ((axis.text or "") if axis is not None else "").strip().upper().removesuffix("_UP")
    return placing_of(up, asset.unitmeter, "the COLLADA file", notes)


def _without_lines(data, notes):
    """The document without line strips, because pycollada refuses meshes that have them."""
    count = len(_LINES.findall(data))
    if count:
        notes.drop(plural(count, "set of line strips", "sets of line strips"))
    return _LINES.sub(b"", data) if count else data


def _with_matrices(data, notes):
    """The document with a matrix in place of each lookat, of which pycollada makes one that places nothing."""

    def matrix(match):
        try:
            eye, interest, up = np.array(match[2].split(), np.float64).reshape(3, 3)
        except ValueError:
            return match[0]  # pycollada refuses it
        back = eye - interest
        right = np.cross(up, back)
        axes = np.column_stack([right, np.cross(back, right), back])
        lengths = np.linalg.norm(axes, axis=0)
        turned = lengths.all() and np.isfinite(lengths).all()
        if not turned:
            notes.lose("where a node looks (lookat)", "a lookat of the COLLADA file has no direction; its node is not turned")
        rows = np.vstack([np.column_stack([axes / lengths if turned else np.eye(3), eye]), [0, 0, 0, 1]])
        return b"<%bmatrix>%b</%bmatrix>" % (match[1], " ".join(map(repr, rows.ravel().tolist())).encode(), match[1])

    return _LOOKAT.sub(matrix, data)


def _parse(data):
    try:
        import collada
    except ImportError as error:
        raise SupportError("TXF-I35", "COLLADA files require the package pycollada: run pip install "
                                      '"texfcodec[formats]"') from error
    if re.search(rb"<!(DOCTYPE|ENTITY)", data.replace(b"\0", b"")):  # some XML parsers would read files that these name
        raise InputError("TXF-I24", "the COLLADA file has a document type declaration, which is not supported")
    try:
        return collada.Collada(io.BytesIO(data), ignore=[collada.DaeError])
    except (KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:  # pycollada raises what its parsers and numpy meet
        raise InputError("TXF-I24", "the COLLADA file is malformed", reason=f"{type(error).__name__}: {error}"[:200]) from error


def _with_points(data, notes):
    """The document with decimal points in place of the decimal commas that some exporters write in their users' language."""
    arrays = re.findall(rb"<float_array[^>]*>([^<]*)<", data)
    if not any(re.search(rb"\d,\d", array) and b"." not in array for array in arrays):
        return data
    notes.remark("numbers in the COLLADA file have decimal commas; they are read as decimal points")
    data = re.sub(rb">[-+0-9eE,\s]+<", lambda match: match[0].replace(b",", b"."), data)
    return re.sub(rb"""(\bmeter=["']\d+),(\d)""", rb"\1.\2", data)


def _name_errors(document, notes):
    """Texts of pycollada's errors on the surface; each is also a warning."""
    texts = []
    for error in document.errors:
        text = f"{type(error).__name__}: {getattr(error, 'msg', error)}".replace(" in effect `<built-in function id>`", "")[:120]
        if getattr(error, "msg", "").startswith("Camera "):
            notes.remark(CAMERAS)
        elif getattr(error, "msg", "").startswith("Light ") or "in light" in text:
            notes.drop("lights")
        else:
            texts.append(text)
            notes.lose(f"a part of the COLLADA file ({text})", f"a part of the COLLADA file is left out: {text}")
    return texts


def _nothing(errors, notes):
    """The error for a file without a readable surface. errors: of _name_errors()."""
    if not errors:
        return no_triangles(", ".join(notes.dropped))
    more = f", and {len(errors) - 1} more" if len(errors) > 1 else ""
    return InputError("TXF-I24", f"the COLLADA file is malformed: no part of its surface can be read ({errors[0]}{more})")


def _geometries(document, notes):
    """Bound geometries of the scene; geometries of skins are as stored."""
    yield from document.scene.objects("geometry")
    for controller in document.scene.objects("controller"):
        notes.drop("skin" if hasattr(controller, "joint_matrices") else "morph targets")
        notes.warn("controllers (skins, morphs) are not applied; their meshes are used as stored")
        geometry = getattr(controller, "geometry", None)
        if geometry is not None:
            yield geometry


def _part(source, geometry, materials, world, notes):
    """Triangles, polylist or polygons of a bound geometry -> Part in world space, or None without a surface. world: (Placing,
    VertexPools) of the document."""
    label = f"geometry '{geometry.original.id}'"
    if not (hasattr(source, "vcounts") or hasattr(source, "ntriangles")):
        notes.lose(f"lines of {label}", f"a part of {label} is not made of triangles or polygons; it is left out")
        return None
    if source.vertex is None or source.vertex_index is None:
        return None
    placing, pools = world
    matrix = placing.matrix @ np.asarray(geometry.matrix, np.float64)
    corners = np.asarray(source.vertex_index, np.int64).reshape(-1)
    sizes = np.asarray(source.vcounts, np.int64) if hasattr(source, "vcounts") else np.full(len(corners) // 3, 3)
    if (sizes < 0).any() or sizes.sum() != len(corners):
        raise InputError("TXF-I24", f"the counts of {label} do not match its indices", value=int(sizes.sum()),
                         allowed=len(corners))
    rows, corners = pools.take(id(source.vertex), source.vertex, corners)
    points = np.asarray(source.vertex if rows is None else source.vertex[rows], np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    triangles, _ = triangulate(points, corners, sizes, notes)
    row, texcoord = materials.of(geometry.materialnodebysymbol.get(source.material))
    uv, color = _uv(source, texcoord, triangles, label, notes), _color(source, triangles, label, notes)
    faces, normal = corners[triangles], _normal(source, triangles, matrix[:3, :3], label)
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces, uv, color, normal = (None if values is None else values[:, [0, 2, 1]] for values in (faces, uv, color, normal))
    for name in source.sources:
        if name not in _USED_INPUTS and source.sources[name]:
            notes.remark(f"COLLADA input '{name[:40]}' is left out")
    return Part(points, faces, row, uv, color, label, normal=normal, rows=rows)


def _values(source, kind, number, triangles, label):
    """Values of one input at the corners of triangles, float64 [F, 3, columns]."""
    offset, data = source.sources[kind][number][0], np.asarray(source.sources[kind][number][4].data)
    rows = source.index.reshape(-1, source.index.shape[-1])[:, offset][triangles]
    if rows.size and (rows.min() < 0 or rows.max() >= len(data)):
        raise InputError("TXF-I13", f"a face of {label} refers to a {kind} that does not exist", allowed=len(data))
    return np.asarray(data[rows], np.float64)


def _uv(source, texcoord, triangles, label, notes):
    """UVs float64 [F, 3, 2], v downwards, of the set that the material's texture is bound to; a remark names each other set."""
    inputs = source.sources.get("TEXCOORD", [])
    chosen = None
    if texcoord is not None and inputs:
        chosen = next((n for n, entry in enumerate(inputs) if str(entry[3]) == texcoord), 0)
    elif texcoord is not None:
        notes.lose(f"texture of {label} (no texture coordinates)",
                   f"{label} has no TEXCOORD for its texture; UV (0, 0) is used")
    for number in range(len(inputs)):
        if number != chosen:
            notes.remark(f"no image uses TEXCOORD_{number}; it is left out")
    if chosen is None:
        return None
    return _values(source, "TEXCOORD", chosen, triangles, label)[..., :2] * [1.0, -1.0] + [0.0, 1.0]


def _normal(source, triangles, linear, label):
    """Normals float64 [F, 3, 3] in world space, or None. linear: the node's linear map, float64 [3, 3]."""
    if not source.sources.get("NORMAL"):
        return None
    return place_normals(_values(source, "NORMAL", 0, triangles, label)[..., :3], linear)


def _color(source, triangles, label, notes):
    """float32 linear RGBA [F, 3, 4], or None. COLLADA does not define the coding; exporters write 8-bit colours, which are
    sRGB."""
    inputs = source.sources.get("COLOR", [])
    if not inputs:
        return None
    if len(inputs) > 1:
        notes.remark("COLOR_1 is left out")
    stored = _values(source, "COLOR", 0, triangles, label)
    return linear_rgba(unit_colours(stored[..., :4], notes, "colours of vertices"))


class _ColladaMaterials:
    """Scene materials by COLLADA material, and the UV set of each material's texture."""

    def __init__(self, folder, notes):
        self.folder, self.notes, self.shelf = folder, notes, TextureShelf(notes)
        self.rows, self._row_of = [], {}

    def of(self, node):
        """(index of the material, UV set number as text or None without a texture). node: pycollada's MaterialNode, or None."""
        material = getattr(node, "target", None)
        key = getattr(material, "id", None)
        if key not in self._row_of:
            self._row_of[key] = len(self.rows)
            self.rows.append(Material("default") if material is None else self._make(material))
        diffuse: Any = getattr(getattr(material, "effect", None), "diffuse", None)  # of pycollada, which has no types
        if not hasattr(diffuse, "sampler"):
            return self._row_of[key], None
        return self._row_of[key], next((str(chosen or 0) for symbol, _, chosen in node.inputs if symbol == diffuse.texcoord), "0")

    def _make(self, material):
        effect, name = material.effect, material.name or material.id or ""
        factor, texture, unlit = np.ones(4), -1, False
        if effect.shadingtype == "constant" and isinstance(effect.emission, tuple):  # has no diffuse: what shines is all there is
            factor[:3] = unit_colours(np.asarray(effect.emission, np.float64)[:3], self.notes, f"emission of '{name}'")
            unlit = True
        elif hasattr(effect.diffuse, "sampler"):
            sampler, path = effect.diffuse.sampler, effect.diffuse.sampler.surface.image.path
            texture = self.shelf.put(path, lambda: read_file(self.folder, path, self.notes), path, _wrap(sampler))
        elif effect.diffuse is not None:
            factor[:3] = unit_colours(np.asarray(effect.diffuse, np.float64)[:3], self.notes, f"diffuse of material '{name}'")
        factor[3] = self._opacity(effect, name)
        if not np.isfinite(factor).all():
            self.notes.lose(f"colour of material '{name}' (NaN or infinite)",
                            f"material '{name}' has a NaN or infinite colour; 1 is used instead")
        factor = np.clip(np.nan_to_num(factor, nan=1.0, posinf=1.0), 0.0, 1.0)
        return Material(name, factor, texture, alpha_mode_of(factor), double_sided=bool(effect.double_sided),
                        unlit=unlit, parameters={} if unlit else self._parameters(effect, name))

    def _parameters(self, effect, name):
        """Parameters of the Material: the effect's emission. A remark or a loss names the other properties."""
        emission = getattr(effect, "emission", None)
        parameters = {}
        if isinstance(emission, tuple) and np.isfinite(emission[:3]).all():
            light = np.clip(emission[:3], 0.0, 1.0)
            parameters = {"emissive": tuple(srgb_to_linear(light).tolist())} if light.any() else {}
        elif emission is not None:
            self.notes.drop(f"emission of material '{name}'")
        for key in (*_MATTE, *_GREY, "bumpmap"):
            value = getattr(effect, key, None)
            plain = isinstance(value, tuple | float | int) and (key in _MATTE or np.ptp(np.atleast_1d(value)[:3]) < _SAME)
            if value is not None and plain:
                self.notes.remark(f"{key} of COLLADA materials is left out")
            elif value is not None:
                self.notes.drop(f"{key} of material '{name}'")
        return parameters

    def _opacity(self, effect, name):
        """Alpha by the opaque modes A_ONE and RGB_ZERO of COLLADA 1.4. A separate alpha texture is not read but a named loss."""
        transparent, amount = effect.transparent, effect.transparency
        if hasattr(transparent, "sampler"):
            diffuse = getattr(effect.diffuse, "sampler", None)
            if diffuse is None or transparent.sampler.surface.image is not diffuse.surface.image:
                self.notes.drop(f"transparent of material '{name}'")
            return 1.0
        if transparent is None or effect.xmlnode is None or effect.xmlnode.find(".//{*}transparent") is None:
            return 1.0
        amount = 1.0 if amount is None or hasattr(amount, "sampler") else float(amount)
        if effect.opaque_mode == "RGB_ZERO":
            return 1.0 - amount * float(np.dot(transparent[:3], (0.212671, 0.715160, 0.072169)))
        return amount * float(transparent[3])


def _wrap(sampler):
    """(s, t) from the sampler's XML; pycollada keeps only its filters."""
    def mode(tag):
        element = None if sampler.xmlnode is None else sampler.xmlnode.find(".//{*}" + tag)
        return _WRAPS.get((element.text or "").strip() if element is not None else "WRAP", WRAP_REPEAT)

    return mode("wrap_s"), mode("wrap_t")


def _drop_rest(document, notes):
    for name in ("animations", "lights"):
        if len(getattr(document, name)):
            notes.drop(name)
    if len(document.cameras):
        notes.remark(CAMERAS)
    if len(document.scenes) > 1:
        notes.remark("scenes beside the default one are left out")
