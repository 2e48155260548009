"""The bundled sample: a fluted vase on a plinth, its neck wound by a torus knot, built by code and textured with photographs.

The photographs are in the scikit-image wheel (extra texfcodec[demo]; nothing is fetched); all of them are in the public domain or
CC0. The parts cover the difficulties of a loader: wrap modes repeat, mirror and clamp, UVs outside [0, 1], a texture with a
factor, a factor alone, vertex colours, and surfaces that nearly touch.

    python -m texfcodec.demo.asset OUT.glb
"""

import io
import json
import os
import struct
import sys
from os import PathLike

import numpy as np

from ..errors import SupportError
from ..metrics.pchip import Pchip
from ..scene.scene import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene, Texture

VASE, KNOT, PLINTH, TRAY, GLAZE, FEET = range(6)  # materials

# Profiles from the lower to the upper pole, (radius, height) in metres, y up; the vase goes up outside and comes down inside.
_VASE_OUTSIDE = [(0.030, 0.081), (0.052, 0.083), (0.062, 0.100), (0.098, 0.165), (0.092, 0.215),
                 (0.052, 0.262), (0.040, 0.292), (0.048, 0.325), (0.066, 0.345), (0.069, 0.348)]  # fmt: skip
_VASE_INSIDE = [(0.064, 0.348), (0.044, 0.325), (0.035, 0.292), (0.046, 0.260), (0.085, 0.215),
                (0.090, 0.165), (0.055, 0.103), (0.030, 0.091)]  # fmt: skip
_PLINTH = [(0, 0.030), (0.098, 0.030), (0.108, 0.035), (0.110, 0.040), (0.110, 0.052), (0.100, 0.056),
           (0.098, 0.070), (0.104, 0.074), (0.103, 0.078), (0.098, 0.080), (0, 0.080)]  # fmt: skip
_PLINTH_ROWS = [GLAZE] + [PLINTH] * 8 + [TRAY]


def make_sample() -> Scene:
    """The sample as a Scene: seven closed parts, six materials, four textures, about 17,000 faces.

    Each part is a closed, consistently oriented surface of its own. All coordinates and colours are multiples of 1e-6 rounded
    to float32, so that the scene is the same on every machine and survives a GLB unchanged.
    """
    parts = [_vase(), _knot(), _plinth(), *(_foot(x, z) for x in (-0.08, 0.08) for z in (-0.08, 0.08))]
    starts = np.cumsum([0] + [len(points) for points, *_ in parts[:-1]])
    positions = _as_float32(np.concatenate([points for points, *_ in parts]))
    faces = np.concatenate([corners + start for (_, corners, *_), start in zip(parts, starts, strict=True)])
    corner_uv = np.concatenate([uv for _, _, uv, _ in parts])
    material = np.concatenate([m for *_, m in parts])
    tray, feet = material == TRAY, material == FEET
    corner_uv[tray] = 0.5 + positions[faces[tray]][:, :, [0, 2]] * [3.2, 4.8]  # seen from above; the photograph is 3 : 2
    corner_uv[(material == GLAZE) | feet] = 0
    color = np.ones((len(faces), 3, 4))
    color[feet, :, :3] = _rainbow(positions[faces[feet]])
    return Scene(
        positions=positions,
        faces=faces,
        face_material=material,
        corner_uv=_as_float32(corner_uv),
        corner_color=_as_float32(color).astype(np.float32),
        materials=[
            Material("vase", texture=0),
            Material("knot", texture=1),
            Material("plinth", factor=np.array([0.85, 0.42, 0.25, 1.0]), texture=2),
            Material("tray", texture=3),
            Material("glaze", factor=np.array([0.05, 0.12, 0.30, 1.0])),
            Material("feet"),
        ],
        textures=[
            _photograph("astronaut", WRAP_MIRROR),
            _photograph("chelsea", WRAP_MIRROR),
            _photograph("brick", WRAP_REPEAT),
            _photograph("coffee", WRAP_CLAMP),
        ],
        metadata={"name": "texfcodec sample"},
    )


def _vase():
    outside, inside = _smooth(_VASE_OUTSIDE, 49), _smooth(_VASE_INSIDE, 26)
    profile = np.vstack([[0, outside[0, 1]], outside, inside, [0, inside[-1, 1]]])
    rows = np.array([GLAZE] + [VASE] * 48 + [GLAZE] * 27)
    angle = _angles(64)
    belly = np.exp(-(((profile[:, 1] - 0.18) / 0.05) ** 2))
    flutes = 1 + 0.05 * belly[:, None] * np.cos(9 * angle + 25 * profile[:, 1:])
    along = np.clip((np.arange(len(profile)) - 1) / 48, 0, 1)  # even steps of arc length, top of the image at the lip
    return _sheet(_revolve(profile, flutes), _grid_uv(1 - along, np.linspace(-0.5, 1.5, 65)), rows)


def _plinth():
    profile, angle = np.array(_PLINTH), _angles(64)
    squircle = (np.abs(np.cos(angle)) ** 8 + np.abs(np.sin(angle)) ** 8) ** -0.125
    along = np.cumsum(np.r_[0, np.hypot(*np.diff(profile, axis=0).T)]) - profile[1, 0]
    uv = _grid_uv(0.3 - along / 0.13, np.linspace(-2, 4, 65))
    return _sheet(_revolve(profile, np.broadcast_to(squircle, (len(profile), 64))), uv, np.array(_PLINTH_ROWS))


def _foot(x, z):
    polar = np.linspace(0, np.pi, 11)
    profile = 0.018 * np.stack([np.sin(polar), 1 - np.cos(polar)], axis=1)
    profile[[0, -1], 0] = 0
    points = _revolve(profile, np.ones((11, 16))) + [x, 0, z]
    return _sheet(points, np.zeros((11, 17, 2)), np.full(10, FEET))


def _knot(turns=3, winds=7, rows=360, columns=8):
    """A (turns, winds) torus knot round the neck; its section is an ellipse that twists on the way, as in a rope."""
    t, around = _angles(rows)[:, None], _angles(columns)
    turn, wind = turns * t, winds * t
    spoke = np.hstack([np.cos(turn), 0 * t, np.sin(turn)])
    tangent_of_turn = np.hstack([-np.sin(turn), 0 * t, np.cos(turn)])
    up = np.array([0.0, 1.0, 0.0])
    out = np.cos(wind) * spoke + np.sin(wind) * up  # normal of the torus, and so of the curve that lies in it
    ring = 0.080 + 0.017 * np.cos(wind)
    centre = ring * spoke + 0.017 * np.sin(wind) * up + [0, 0.292, 0]
    tangent = turns * ring * tangent_of_turn + winds * 0.017 * (np.cos(wind) * up - np.sin(wind) * spoke)
    side = np.cross(tangent / np.linalg.norm(tangent, axis=1, keepdims=True), out)
    radius = 0.0066 * (1 + 0.25 * np.cos(2 * around + 24 * t))[..., None]
    section = np.cos(around)[:, None] * out[:, None] + np.sin(around)[:, None] * side[:, None]
    uv = _grid_uv(np.linspace(0, 2, columns + 1), np.linspace(0, 20, rows + 1), transpose=True)
    return _sheet(centre[:, None] + radius * section, uv, np.full(rows, KNOT))


def _angles(count):
    return np.arange(count) * (2 * np.pi / count)


def _smooth(control, count):
    """`count` points at even steps of arc length on a curve without overshoot through the control points."""
    control = np.array(control)
    knots = np.cumsum(np.r_[0, np.hypot(*np.diff(control, axis=0).T)])
    fine = Pchip(knots, control)(np.linspace(0, knots[-1], 2000))
    length = np.cumsum(np.r_[0, np.hypot(*np.diff(fine, axis=0).T)])
    even = np.linspace(0, length[-1], count)
    return np.stack([np.interp(even, length, fine[:, i]) for i in (0, 1)], axis=1)


def _revolve(profile, shape):
    """Points [R, C, 3] of a surface of revolution. profile: [R, 2] of (radius, height); shape: [R, C] factors on the radius."""
    angle = _angles(shape.shape[1])
    radius = profile[:, :1] * shape
    return np.stack([radius * np.cos(angle), np.broadcast_to(profile[:, 1:], shape.shape), radius * np.sin(angle)], axis=2)


def _grid_uv(v, u, transpose=False):
    """[len(v), len(u), 2] of (u, v); transposed, rows run along u."""
    uv = np.stack(np.meshgrid(u, v), axis=2)
    return uv.swapaxes(0, 1) if transpose else uv


def _sheet(points, uv, row_material):
    """Close a grid of points [R, C, 3] into (positions, faces, corner_uv, face_material), facing outwards.

    Columns always close; rows close when there is a material for each of the R steps, otherwise the first and last row are
    poles (one vertex each). uv: [rows, C + 1, 2], with the closing row or column repeated.
    """
    rows, columns = points.shape[:2]
    ids = np.arange(rows * columns).reshape(rows, columns)
    if len(row_material) == rows:
        ids = np.vstack([ids, ids[:1]])
    else:
        ids[0], ids[-1] = ids[0, 0], ids[-1, 0]
    ids = np.hstack([ids, ids[:, :1]])
    r, c = (index.ravel() for index in np.indices((len(ids) - 1, columns)))
    corner_row = np.stack([r, r + 1, r + 1, r, r + 1, r], axis=1).reshape(-1, 3)
    corner_column = np.stack([c, c, c + 1, c, c + 1, c + 1], axis=1).reshape(-1, 3)
    faces, corner_uv, material = ids[corner_row, corner_column], uv[corner_row, corner_column], np.repeat(row_material[r], 2)
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    kept, faces = np.unique(faces[whole], return_inverse=True)
    positions, faces = points.reshape(-1, 3)[kept], faces.reshape(-1, 3).astype(np.int64)
    a, b, d = np.moveaxis(positions[faces], 1, 0)
    outwards = slice(None) if (a * np.cross(b, d)).sum() > 0 else slice(None, None, -1)
    return positions, faces[:, outwards], corner_uv[whole][:, outwards], material[whole].astype(np.int64)


def _rainbow(points):
    """Linear RGB of direction and height, continuous over each foot."""
    turn = np.arctan2(points[..., 2], points[..., 0]) + 90 * points[..., 1]
    return 0.5 + 0.45 * np.cos(turn[..., None] - np.array([0, 2, 4]) * (np.pi / 3))


def _as_float32(values):
    """Values rounded to 1e-6, which hides differences between machines' sines, then to float32."""
    return np.round(values, 6).astype(np.float32).astype(np.float64)


def _photograph(name, wrap):
    try:
        import skimage.data
    except ImportError:
        raise ImportError('the photographs of the demo asset come with scikit-image: pip install "texfcodec[demo]"') from None
    image = getattr(skimage.data, name)()
    image = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]
    return Texture(np.concatenate([image, np.full_like(image[..., :1], 255)], axis=2), (wrap, wrap), name)


def write_sample(path: str | PathLike) -> None:
    """Write the demo's textured vase (make_sample) to path as a self-contained GLB (glTF 2.0), completely or not at all."""
    part = f"{os.fspath(path)}.part"
    try:
        with open(part, "wb") as file:
            file.write(_Glb(make_sample()).tobytes())
        os.replace(part, path)
    finally:
        if os.path.exists(part):
            os.remove(part)


def write_or_explain(path: str | PathLike) -> None:
    """Write the demo's vase as write_sample() does, for a command line: without scikit-image print one line on stderr and exit
    with the code for missing support."""
    try:
        write_sample(path)
    except ImportError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(SupportError.exit_code)


class _Glb:
    """A GLB of an opaque Scene with one primitive per material, for the sample only; io/gltf/writer.py is the general writer."""

    _COMPONENT = {"f": (5126, "<f4"), "u": (5125, "<u4")}
    _WRAP = {WRAP_REPEAT: 10497, WRAP_CLAMP: 33071, WRAP_MIRROR: 33648}

    def __init__(self, scene):
        self.binary = bytearray()
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        primitives = [self._primitive(scene, m) for m in range(len(scene.materials))]
        self.json = {
            "asset": {"version": "2.0", "generator": "texfcodec sample"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": scene.metadata["name"]}],
            "meshes": [{"primitives": primitives}],
            "materials": [self._material(m) for m in scene.materials],
            "textures": [{"source": i, "sampler": i} for i in range(len(scene.textures))],
            "samplers": [{"wrapS": self._WRAP[t.wrap[0]], "wrapT": self._WRAP[t.wrap[1]]} for t in scene.textures],
            "images": [{"name": t.name, "mimeType": "image/png", "bufferView": self._png(t)} for t in scene.textures],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.binary)}],
        }

    def tobytes(self):
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _primitive(self, scene, m):
        chosen = scene.face_material == m
        textured, coloured = scene.materials[m].texture >= 0, bool((scene.corner_color[chosen] != 1).any())
        corners = [scene.positions[scene.faces[chosen]], scene.corner_uv[chosen], scene.corner_color[chosen]]
        rows = np.concatenate([c.reshape(-1, c.shape[2]) for c in corners], axis=1)
        vertices, index = np.unique(rows, axis=0, return_inverse=True)
        attributes = {"POSITION": self._accessor(vertices[:, :3], "VEC3", "f", 34962, bounds=True)}
        if textured:
            attributes["TEXCOORD_0"] = self._accessor(vertices[:, 3:5], "VEC2", "f", 34962)
        if coloured:
            attributes["COLOR_0"] = self._accessor(vertices[:, 5:], "VEC4", "f", 34962)
        return {"attributes": attributes, "indices": self._accessor(index.ravel(), "SCALAR", "u", 34963), "material": m}

    def _material(self, material):
        surface = {"baseColorFactor": [float(x) for x in material.factor], "metallicFactor": 0.0}
        if material.texture >= 0:
            surface["baseColorTexture"] = {"index": material.texture}
        return {"name": material.name, "pbrMetallicRoughness": surface}

    def _png(self, texture):
        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(texture.image[..., :3])).save(buffer, "PNG", optimize=True)
        return self._view(buffer.getvalue())

    def _accessor(self, values, kind, component, target, bounds=False):
        code, dtype = self._COMPONENT[component]
        values = values.astype(dtype)
        accessor = {"bufferView": self._view(values.tobytes(), target), "componentType": code, "count": len(values), "type": kind}
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def _view(self, data, target=None):
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.views.append(view | ({"target": target} if target else {}))
        self.binary += data + bytes(-len(data) % 4)
        return len(self.views) - 1


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m texfcodec.demo.asset OUT.glb")
    write_or_explain(sys.argv[1])
