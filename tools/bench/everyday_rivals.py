"""What everyday.py stands our streams against: GLB with Draco, UVs and vertex colours included, and ordinary images.

One asset is coded with every codec of CODECS, scale and quality, and looked at in the metric's views. Draco gets the integers
that texfcodec.geometry gets; UVs become integers that span all their bits in every material (the longer side does), so that
Draco's own quantisation gives them back exactly. JPEG is Pillow's, which needs more bytes than MozJPEG; ETC1S is left out: no
package that this project installs can encode it.
"""

import hashlib
import io
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from texfcodec.geometry.draco import COMPRESSION_LEVEL
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.scene.scene import ALPHA_OPAQUE, Scene
from tools.bench.everyday_views import MetricViews

POSITION_BITS, UV_BITS = 14, (10, 12, 14)
# {codec: {scale: qualities}}; scale 2 is half the width and height. Spread as in the curves that were there before this tool.
CODECS = {
    "avif": {1: (3, 15, 30, 45, 60, 72, 84, 92), 2: (12, 30, 50, 70, 85), 4: (30, 60, 85)},
    "webp": {1: (5, 20, 45, 70, 88, 95), 2: (20, 60, 88), 4: (50, 90)},
    "jpeg": {1: (12, 30, 55, 75, 88), 2: (35, 75)},
}
COLOUR_BITS, TEXTURED_COLOUR_BITS, FINE_COLOUR_BITS = (3, 4, 5, 6, 7, 8), (5, 8), (10, 12)
SPEED, METHOD = 6, 4  # of AVIF and WebP
FRAMES = ("corner_normal", "corner_tangent")
TANGENT_ID = 1  # of Draco's generic attribute


@dataclass
class Rival:
    """One asset on its lattice. scene: with the lattice's positions and faces, and all else of the source; lattice: int64
    [V, 3]; images: {content: uint8 [H, W, 4]} of what faces use, each once; content: that of each texture, None where unused;
    with_alpha: contents whose alpha shows."""

    scene: Scene
    lattice: np.ndarray
    images: dict
    content: list
    with_alpha: set

    @property
    def textured(self):
        """bool [F]: faces whose material has a texture."""
        return np.array([m.texture >= 0 for m in self.scene.materials], bool)[self.scene.face_material]

    @property
    def is_coloured(self):
        """Whether vertex colours say anything."""
        colour = self.scene.corner_color
        return colour is not None and bool((colour != 1).any())


def rival_of(scene, position_bits=POSITION_BITS):
    """The Rival of a Scene."""
    surface = make_surface(scene, EncodeOptions(position_bits=position_bits))
    pick = surface.origin_face
    colour = None if scene.corner_color is None else scene.corner_color[pick]
    frames = {name: None if (frame := getattr(scene, name)) is None else frame[pick] for name in FRAMES}
    placed = replace(scene, positions=surface.cube.to_world(surface.lattice), faces=surface.faces,
                     face_material=surface.material, corner_uv=scene.corner_uv[pick], corner_color=colour,
                     map_uv={name: uv[pick] for name, uv in scene.map_uv.items()}, **frames)
    images, content, with_alpha = {}, [None] * len(scene.textures), set()
    for material in (scene.materials[m] for m in np.unique(surface.material)):
        if material.texture < 0:
            continue
        image = scene.textures[material.texture].image
        key = content[material.texture] = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()
        images[key] = image
        if material.alpha_mode != ALPHA_OPAQUE and (image[:, :, 3] != 255).any():
            with_alpha.add(key)
    return Rival(placed, surface.lattice, images, content, with_alpha)


def curves(scene, name, codecs=None, uv_bits=UV_BITS, threads=1, on_point=None):
    """The rival curves of a Scene: {"asset", "faces", "textures", "draco_bytes", "ceiling", "points"}, see everyday.py.

    codecs: as CODECS, which is the default; on_point: called with every point as it is made.
    """
    rival, codecs = rival_of(scene), CODECS if codecs is None else codecs
    views = MetricViews(scene, rival.scene, threads)
    meshes = meshes_of(rival, uv_bits)
    out = {"asset": name, "faces": len(scene.faces), "textures": [list(i.shape[1::-1]) for i in rival.images.values()],
           "draco_bytes": {"positions only": draco_bytes(rival, None, None)} | {mesh.title: mesh.size for mesh in meshes},
           "ceiling": {mesh.label: views.psnr(mesh.scene) for mesh in meshes}, "points": []}
    for codec, scale, quality in plan(rival, codecs):
        decoded, size = coded_images(rival, codec, scale, quality, threads)
        for mesh in meshes:
            point = {"codec": codec, "scale": scale, "quality": quality, "uv_bits": mesh.uv_bits}
            point |= {} if mesh.colour_bits is None else {"colour_bits": mesh.colour_bits}
            point |= {"image_bytes": size, "total_bytes": mesh.size + size}
            out["points"].append(point | views.psnr(with_images(mesh.scene, rival, decoded)))
            if on_point:
                on_point(out["points"][-1])
    if not rival.images:
        out["points"] = [{"codec": "draco", "scale": 1, "quality": mesh.colour_bits or 0, "uv_bits": 0, "image_bytes": 0,
                          "total_bytes": mesh.size, **out["ceiling"][mesh.label]} for mesh in meshes]
    return out


def plan(rival, codecs):
    """(codec, scale, quality) of every coding of the images; nothing where there are none. JPEG has no alpha."""
    return [(codec, scale, quality) for codec, scales in codecs.items() for scale, qualities in scales.items()
            for quality in qualities if rival.images and not (codec == "jpeg" and rival.with_alpha)]


# Geometry, UVs and vertex colours.


@dataclass
class Mesh:
    """What one choice of bits makes of an asset. scene: with quantised UVs and colours, images as in the source; size: Draco
    bytes; uv_bits: 0 where no face has a texture; colour_bits: None where there are no vertex colours."""

    scene: Scene
    size: int
    uv_bits: int
    colour_bits: int | None

    @property
    def title(self):
        """Its name in "draco_bytes"."""
        parts = [f"{self.uv_bits}-bit UVs"] if self.uv_bits else []
        parts += [] if self.colour_bits is None else [f"{self.colour_bits}-bit colours"]
        return f"with {' and '.join(parts) or 'nothing else'}"

    @property
    def label(self):
        """Its name in "ceiling": the UV bits, and the colour bits where there are any."""
        return str(self.uv_bits) if self.colour_bits is None else f"{self.uv_bits} {self.colour_bits}"


def meshes_of(rival, uv_bits):
    """A Mesh for every choice of bits that makes sense for the asset."""
    colour_bits = [None]
    if rival.is_coloured:
        colour_bits = TEXTURED_COLOUR_BITS if rival.images else COLOUR_BITS
        colour_bits = list(colour_bits) + ([] if rival.images or colours_fit(rival, 8) else list(FINE_COLOUR_BITS))
    return [mesh_of(rival, bits if rival.images else 0, colours) for bits in (uv_bits if rival.images else (0,))
            for colours in colour_bits]


def mesh_of(rival, uv_bits, colour_bits):
    """The Mesh of a choice of bits."""
    scene = rival.scene
    uv = quantise_uv(rival, uv_bits) if uv_bits else None
    colour = None if colour_bits is None else quantise_colour(rival, colour_bits)
    corner_uv = scene.corner_uv if uv is None else dequantise_uv(rival, uv, uv_bits)
    corner_color = scene.corner_color if colour is None else (colour / ((1 << colour_bits) - 1)).astype(np.float32)
    return Mesh(replace(scene, corner_uv=corner_uv, corner_color=corner_color), draco_bytes(rival, (uv, uv_bits), colour),
                uv_bits, colour_bits)


def uv_boxes(rival):
    """(low float64 [m, 2], side float64 [m]) of the UVs of each material; a side of 0 is 1."""
    scene, count = rival.scene, len(rival.scene.materials)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for corner in range(3):
        np.minimum.at(low, scene.face_material, scene.corner_uv[:, corner])
        np.maximum.at(high, scene.face_material, scene.corner_uv[:, corner])
    low, high = np.where(np.isfinite(low), low, 0), np.where(np.isfinite(high), high, 0)
    side = (high - low).max(axis=1)
    return low, np.where(side > 0, side, 1.0)


def quantise_uv(rival, bits):
    """UVs as int64 [F, 3, 2] in 0..2**bits - 1, the longer side of every material's box taking all of it; 0 on faces without a
    texture."""
    low, side = uv_boxes(rival)
    material = rival.scene.face_material[:, None]
    share = (rival.scene.corner_uv - low[material]) / side[material][..., None]
    return np.floor(share * ((1 << bits) - 1) + 0.5).astype(np.int64) * rival.textured[:, None, None]


def dequantise_uv(rival, uv, bits):
    """UVs float64 [F, 3, 2] of quantise_uv's integers."""
    low, side = uv_boxes(rival)
    material = rival.scene.face_material[:, None]
    return low[material] + uv / ((1 << bits) - 1) * side[material][..., None]


def quantise_colour(rival, bits):
    """Vertex colours as int64 [F, 3, 4] in 0..2**bits - 1: linear, as a GLB has them; alpha 1 where nobody sees it."""
    scene, most = rival.scene, (1 << bits) - 1
    colour = np.rint(np.clip(scene.corner_color, 0, 1).astype(np.float64) * most).astype(np.int64)
    opaque = np.array([m.alpha_mode == ALPHA_OPAQUE for m in scene.materials])[scene.face_material]
    colour[opaque, :, 3] = most
    return colour


def colours_fit(rival, bits):
    """Whether so many bits give the vertex colours back, to a thousandth of a step."""
    steps = np.clip(rival.scene.corner_color, 0, 1).astype(np.float64) * ((1 << bits) - 1)
    return bool(np.abs(steps - np.rint(steps)).max() < 1e-3)


def draco_bytes(rival, uv, colour, frames=None):
    """Draco bytes of the asset: one mesh per material or one of all, whichever is smaller. uv: (int64 [F, 3, 2] or None, bits),
    or None; colour: int64 [F, 3, 4] or None; frames: CornerFrames or None."""
    uv, uv_bits = uv or (None, 0)
    material, textured = rival.scene.face_material, rival.textured

    def size(faces):
        ours = None if uv is None or not textured[faces].any() else uv[faces]
        return len(enc_mesh(rival.lattice, rival.scene.faces[faces], ours, uv_bits, None if colour is None else colour[faces],
                            None if frames is None else frames.of(faces)))

    together = size(np.ones(len(material), bool))
    used = np.unique(material)
    return together if len(used) == 1 else min(together, sum(size(material == m) for m in used))


def positions_alone(lattice, faces):
    """Draco bytes of positions and faces alone, int64 [V, 3] and [F, 3], as one mesh: what every method that is compared by its
    texture bytes counts as geometry."""
    return len(enc_mesh(lattice, faces, None, 0, None))


def enc_mesh(lattice, faces, uv, uv_bits, colour, frames=None):
    """One Draco mesh. lattice: int64 [V, 3]; faces: int64 [F, 3]; uv: int64 [F, 3, 2] of uv_bits, or None; colour: int64 [F, 3,
    4] or None, without its alpha where that is constant; frames: CornerFrames or None. Draco's vertices are the distinct
    corners."""
    import DracoPy

    parts = {"vertex": faces[..., None], "uv": uv, "colour": colour} | (frames.parts if frames is not None else {})
    parts = {name: part.reshape(-1, part.shape[2]) for name, part in parts.items() if part is not None}
    rows, index = np.unique(np.hstack(list(parts.values())), axis=0, return_inverse=True)
    parts = dict(zip(parts, np.split(rows, np.cumsum([part.shape[1] for part in parts.values()])[:-1], axis=1), strict=True))
    options, generic = {}, {}
    if uv is not None:
        options |= {"tex_coord": parts["uv"].astype(np.float64), "tex_coord_quantization_bits": uv_bits}
    if colour is not None:
        values = parts["colour"] if np.ptp(colour[:, :, 3]) else parts["colour"][:, :3]
        small = values.max(initial=0) < 256
        options |= {"colors": values.astype(np.uint8)} if small else {}
        generic |= {} if small else {0: values.astype(np.uint16)}
    if "normal" in parts:
        options |= {"normals": parts["normal"].astype(np.float64), "normal_quantization_bits": frames.normal_bits}
    if "tangent" in parts:
        generic[TANGENT_ID] = parts["tangent"].astype(np.uint16)
    return DracoPy.encode(lattice[parts["vertex"][:, 0].astype(np.int64)].astype(np.uint32), compression_level=COMPRESSION_LEVEL,
                          faces=index.reshape(-1, 3).astype(np.uint32), preserve_order=False, create_metadata=False,
                          generic_attributes=generic or None, **options)


def dec_mesh(data, uv_bits):
    """(positions int64 [F, 3, 3], UVs int64 [F, 3, 2] or None) of enc_mesh's bytes, by corner. Ends the program where Draco does
    not give integers back."""
    import DracoPy

    mesh = DracoPy.decode(data)
    faces, positions = np.asarray(mesh.faces, np.int64), np.asarray(mesh.points)
    if not uv_bits:
        return positions.astype(np.int64)[faces], None
    uv = np.asarray(mesh.tex_coord, np.float64)
    whole = np.rint(uv)
    if np.abs(uv - whole).max(initial=0) > 1 / 16:
        raise SystemExit("Draco's UVs are no integers")
    return positions.astype(np.int64)[faces], whole.astype(np.int64)[faces]


# Normals and tangents.


@dataclass
class CornerFrames:
    """What Draco has of shading at corners. normal: float32 [F, 3, 3], what its octahedra of normal_bits give back; tangent:
    int64 [F, 3, 4], steps of glTF's TANGENT, or None."""

    normal: np.ndarray
    normal_bits: int
    tangent: np.ndarray | None = None

    @property
    def parts(self):
        """The attributes by name."""
        return {"normal": self.normal, "tangent": self.tangent}

    def of(self, faces):
        """Those of the chosen faces, bool [F]."""
        return replace(self, normal=self.normal[faces], tangent=None if self.tangent is None else self.tangent[faces])


def octahedral(normals, bits):
    """Normals float32 [..., 3] as Draco gives them back: coded and decoded by Draco itself, in order, one of a kind."""
    import DracoPy

    rows, index = np.unique(normals.reshape(-1, 3), axis=0, return_inverse=True)
    count = len(rows)
    faces = np.minimum(np.arange(-(-count // 3) * 3), count - 1).reshape(-1, 3).astype(np.uint32)
    places = np.column_stack([np.arange(count), np.zeros((count, 2), np.int64)]).astype(np.uint32)
    mesh = DracoPy.decode(DracoPy.encode(places, faces=faces, normals=rows.astype(np.float64), normal_quantization_bits=bits,
                                         preserve_order=True))
    if not np.array_equal(np.asarray(mesh.points)[:, 0], places[:, 0]):
        raise SystemExit("Draco has changed the order of normals")
    return np.asarray(mesh.normals, np.float32)[index.ravel()].reshape(normals.shape)


def quantise_tangent(tangents, bits):
    """glTF's TANGENT, float32 [F, 3, 4], as int64 in 0..2**bits - 1."""
    return np.rint((np.clip(tangents.astype(np.float64), -1, 1) + 1) / 2 * ((1 << bits) - 1)).astype(np.int64)


def dequantise_tangent(steps, bits):
    """TANGENT float32 [F, 3, 4] of quantise_tangent's integers: unit directions and a sign; zero where there was none."""
    direction, hand = np.split(steps / ((1 << bits) - 1) * 2 - 1, [3], axis=2)
    length = np.linalg.norm(direction, axis=2, keepdims=True)
    there = length > 0.5
    tangent = np.dstack([direction / np.where(there, length, 1), np.sign(hand)])
    return np.where(there, tangent, 0).astype(np.float32)


# Images.


def coded_images(rival, codec, scale, quality, threads):
    """({content: decoded uint8 [H, W, 4]}, bytes of all): every image at the same quality."""
    decoded, total = {}, 0
    for key, image in rival.images.items():
        data = enc_image(shrunk(image, scale, key in rival.with_alpha), codec, quality, threads)
        decoded[key] = dec_image(data)
        total += len(data)
    return decoded, total


def shrunk(image, scale, with_alpha):
    """The image as a Pillow one, grey, RGB or RGBA as little as it needs, at 1 / scale of its width and height."""
    picture = Image.fromarray(image if with_alpha else np.ascontiguousarray(image[:, :, :3]))
    if not with_alpha and (image[:, :, :1] == image[:, :, 1:3]).all():
        picture = picture.getchannel(0)
    if scale == 1:
        return picture
    return picture.resize([max(1, round(side / scale)) for side in picture.size], Image.Resampling.LANCZOS)


def enc_image(picture, codec, quality, threads=1):
    """Bytes of a Pillow image."""
    grey = picture.mode == "L"
    options = {"avif": {"speed": SPEED, "subsampling": "4:0:0" if grey else "4:2:0", "max_threads": threads},
               "webp": {"method": METHOD}, "jpeg": {"optimize": True, "progressive": True, "subsampling": 0 if grey else 2}}
    out = io.BytesIO()
    picture.save(out, codec.upper(), quality=quality, **options[codec])
    return out.getvalue()


def dec_image(data):
    """The image uint8 [H, W, 4] of enc_image's bytes."""
    return np.ascontiguousarray(Image.open(io.BytesIO(data)).convert("RGBA"))


def with_images(scene, rival, decoded):
    """The scene with decoded images, {content: uint8 [H, W, 4]}."""
    textures = [texture if key is None else replace(texture, image=decoded[key])
                for texture, key in zip(scene.textures, rival.content, strict=True)]
    return replace(scene, textures=textures)


