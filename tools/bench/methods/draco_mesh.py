"""A mesh by Draco as rivals have it: positions on the lattice that our own streams have, and what stands at corners as integers.

UVs become integers that span all their bits in every material (the longer side does), so that Draco's own quantisation gives
them back exactly; vertex colours are linear integers; normals are Draco's octahedra, TANGENTs a generic attribute of four
components. No method: uv.py and others take from it.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from texfcodec.encoder.values.shown_maps import SAME_FRAME, frame_rotation
from texfcodec.geometry.draco import COMPRESSION_LEVEL
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.scene.channels import BY_NAME, channel_over
from texfcodec.scene.scene import ALPHA_OPAQUE, Scene

POSITION_BITS = 14
FRAMES = ("corner_normal", "corner_tangent")
GENERIC, COLOUR_ID, TANGENT_ID = 4, 0, 1  # the type of Draco's generic attributes, and our ids of two
ALPHA = 3


@dataclass
class Rival:
    """An asset as rivals code it. scene: the source with the lattice's positions and faces; lattice: int64 [V, 3]; images:
    {content: uint8 [H, W, 4]} that faces use, each once; content: key of each texture's image, None if unused; columns:
    {content: columns of the image that are read}; with_maps: whether maps are coded too."""

    scene: Scene
    lattice: np.ndarray
    images: dict
    content: list
    columns: dict
    with_maps: bool = False

    @property
    def textured(self):
        """bool [F]: faces whose material has an image."""
        return np.array([bool(_images_of(m, self.with_maps)) for m in self.scene.materials], bool)[self.scene.face_material]

    @property
    def is_coloured(self):
        """Whether vertex colours say anything."""
        colour = self.scene.corner_color
        return colour is not None and bool((colour != 1).any())


def _images_of(material, with_maps):
    """{texture: columns that are referenced} of a Material."""
    referenced = {}
    if material.texture >= 0:
        referenced[material.texture] = {0, 1, 2} | ({ALPHA} if material.alpha_mode != ALPHA_OPAQUE else set())
    for name, texture in material.maps.items() if with_maps else ():
        columns = {0, 1, 2} if BY_NAME[name].unit == "degrees" else channel_over(name, True).columns
        referenced[texture] = referenced.get(texture, set()) | set(columns)
    return referenced


def rival_of(scene, position_bits=POSITION_BITS, with_maps=False):
    """Return the Rival of a Scene on a lattice of position_bits. with_maps: whether maps are coded besides base colour."""
    surface = make_surface(scene, EncodeOptions(position_bits=position_bits))
    pick = surface.origin_face
    colour = None if scene.corner_color is None else scene.corner_color[pick]
    frames = {name: None if (frame := getattr(scene, name)) is None else frame[pick] for name in FRAMES}
    placed = replace(scene, positions=surface.cube.to_world(surface.lattice), faces=surface.faces,
                     face_material=surface.material, corner_uv=scene.corner_uv[pick], corner_color=colour,
                     map_uv={name: uv[pick] for name, uv in scene.map_uv.items()}, **frames)
    images, content, columns = {}, [None] * len(scene.textures), {}
    for material in (scene.materials[m] for m in np.unique(surface.material)):
        for texture, referenced in _images_of(material, with_maps).items():
            image = scene.textures[texture].image
            key = content[texture] = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()
            images[key] = image
            seen = ALPHA in referenced and (with_maps or (image[:, :, ALPHA] != 255).any())
            columns[key] = columns.get(key, set()) | (referenced if seen else referenced - {ALPHA})
    return Rival(placed, surface.lattice, images, content, columns, with_maps)


def upright(scene):
    """Return the Scene with green and TANGENT signs flipped for normal maps whose faces all have TANGENTs that mirror the frame
    viewers derive from UVs. A rival can then omit TANGENTs."""
    if scene.corner_tangent is None:
        return scene
    surface, users = make_surface(scene, EncodeOptions()), {}
    for number, material in enumerate(scene.materials):
        for name, texture in material.maps.items():
            if BY_NAME[name].unit == "degrees":
                users.setdefault(texture, set()).add(number)
    turns = {n: frame_rotation(scene, surface, np.flatnonzero(surface.material == n)) for n in set().union(*users.values(), ())}
    over = {n for n, turn in turns.items() if turn is not None and np.abs(turn - np.diag([1, -1])).max() <= SAME_FRAME}
    own = [t for t, numbers in users.items() if numbers <= over]
    if not own or any(numbers & over and not numbers <= over for numbers in users.values()):
        return scene
    tangent, textures = scene.corner_tangent.copy(), list(scene.textures)
    tangent[np.isin(scene.face_material, list(over)), :, 3] *= -1
    for t in own:
        image = textures[t].image.copy()
        image[..., 1] = 255 - image[..., 1]
        textures[t] = replace(textures[t], image=image)
    return replace(scene, corner_tangent=tangent, textures=textures)


def uv_boxes(rival):
    """Return the UV bounding squares of the materials: low corners float64 [m, 2] and sides float64 [m]; a side of 0 is 1."""
    scene, count = rival.scene, len(rival.scene.materials)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for corner in range(3):
        np.minimum.at(low, scene.face_material, scene.corner_uv[:, corner])
        np.maximum.at(high, scene.face_material, scene.corner_uv[:, corner])
    low, high = np.where(np.isfinite(low), low, 0), np.where(np.isfinite(high), high, 0)
    side = (high - low).max(axis=1)
    return low, np.where(side > 0, side, 1.0)


def quantise_uv(rival, bits):
    """Return UVs as int64 [F, 3, 2] in 0..2**bits - 1 over the box of each material (uv_boxes); 0 on faces without a texture."""
    low, side = uv_boxes(rival)
    material = rival.scene.face_material[:, None]
    share = (rival.scene.corner_uv - low[material]) / side[material][..., None]
    return np.floor(share * ((1 << bits) - 1) + 0.5).astype(np.int64) * rival.textured[:, None, None]


def dequantise_uv(rival, uv, bits):
    """Return UVs float64 [F, 3, 2] of the integers of quantise_uv()."""
    low, side = uv_boxes(rival)
    material = rival.scene.face_material[:, None]
    return low[material] + uv / ((1 << bits) - 1) * side[material][..., None]


def quantise_colour(rival, bits):
    """Return linear vertex colours as int64 [F, 3, 4] in 0..2**bits - 1; alpha is 1 where it is not visible."""
    scene, most = rival.scene, (1 << bits) - 1
    colour = np.rint(np.clip(scene.corner_color, 0, 1).astype(np.float64) * most).astype(np.int64)
    opaque = np.array([m.alpha_mode == ALPHA_OPAQUE for m in scene.materials])[scene.face_material]
    colour[opaque, :, 3] = most
    return colour


def positions_alone(lattice, faces):
    """Return the bytes that Draco needs for positions int64 [V, 3] and faces int64 [F, 3] as one mesh: the geometry of all
    methods that are compared by texture bytes."""
    return len(enc_mesh(lattice, faces))


def enc_mesh(lattice, faces, parts=None, bits=None):
    """Return the bytes of one Draco mesh whose vertices are the distinct corners. lattice: int64 [V, 3]; faces: int64 [F, 3];
    parts: corner attributes: "uv" int64 [F, 3, 2], "normal" float [F, 3, 3], "colour" int64 [F, 3, 4], coded without a constant
    alpha, "tangent" int64 [F, 3, 4]; bits: {"uv", "normal"}."""
    import DracoPy

    columns = {name: part.reshape(-1, part.shape[2]) for name, part in {"vertex": faces[..., None], **(parts or {})}.items()}
    rows, index = np.unique(np.hstack(list(columns.values())), axis=0, return_inverse=True)
    ends = np.cumsum([column.shape[1] for column in columns.values()])[:-1]
    columns = dict(zip(columns, np.split(rows, ends, axis=1), strict=True))
    options, generic = {}, {}
    if "uv" in columns:
        options |= {"tex_coord": columns["uv"].astype(np.float64), "tex_coord_quantization_bits": bits["uv"]}
    if "colour" in columns:
        values = columns["colour"][:, : 4 if np.ptp(columns["colour"][:, ALPHA]) else 3]
        small = values.max(initial=0) < 256
        options |= {"colors": values.astype(np.uint8)} if small else {}
        generic |= {} if small else {COLOUR_ID: values.astype(np.uint16)}
    if "normal" in columns:
        options |= {"normals": columns["normal"].astype(np.float64), "normal_quantization_bits": bits["normal"]}
    if "tangent" in columns:
        generic[TANGENT_ID] = columns["tangent"].astype(np.uint16)
    points = lattice[columns["vertex"][:, 0].astype(np.int64)].astype(np.uint32)
    return DracoPy.encode(points, compression_level=COMPRESSION_LEVEL, faces=index.reshape(-1, 3).astype(np.uint32),
                          preserve_order=False, create_metadata=False, generic_attributes=generic or None, **options)


def dec_mesh(data):
    """Return the corner attributes of enc_mesh()'s bytes: {"vertex": positions int64 [F, 3, 3], and of "uv", "colour" (3 or 4
    columns), "normal", "tangent" those coded}. Ends the program if Draco changes integers."""
    import DracoPy

    mesh = DracoPy.decode(data)
    faces = np.asarray(mesh.faces, np.int64)
    generic = {a["unique_id"]: a["data"] for a in mesh.attributes if a["attribute_type"] == GENERIC}
    attributes = {"vertex": mesh.points, "uv": mesh.tex_coord, "normal": mesh.normals, "tangent": generic.get(TANGENT_ID),
                  "colour": mesh.colors if mesh.colors is not None else generic.get(COLOUR_ID)}
    out = {}
    for name, values in attributes.items():
        if values is None or not np.size(values):
            continue
        values = np.asarray(values, np.float64)
        if name != "normal":
            if np.abs(values - np.rint(values)).max(initial=0) > 1 / 16:
                raise SystemExit(f"Draco's {name} are no integers")
            values = np.rint(values).astype(np.int64)
        out[name] = values[faces]
    return out


# Normals and tangents.


def octahedral(normals, bits):
    """Return normals float32 [..., 3] as Draco decodes them at these bits: each is coded and decoded by Draco, in order."""
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
    """Return glTF TANGENTs float32 [F, 3, 4] as int64 in 0..2**bits - 1."""
    return np.rint((np.clip(tangents.astype(np.float64), -1, 1) + 1) / 2 * ((1 << bits) - 1)).astype(np.int64)


def dequantise_tangent(steps, bits):
    """Return TANGENTs float32 [F, 3, 4] of quantise_tangent()'s integers: unit vectors and a sign; 0 for none."""
    direction, hand = np.split(steps / ((1 << bits) - 1) * 2 - 1, [3], axis=2)
    length = np.linalg.norm(direction, axis=2, keepdims=True)
    there = length > 0.5
    tangent = np.dstack([direction / np.where(there, length, 1), np.sign(hand)])
    return np.where(there, tangent, 0).astype(np.float32)
