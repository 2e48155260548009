"""The GPU-resident rival UV-Source/ASTC: the source's own UVs and its textures in ASTC blocks, as a GPU holds them: those of the
base colour, or the maps of whole materials with them, packed as glTF packs them (packed_maps.py).

What counts is what a GPU would have to hold beside the geometry: 16 bytes a block of every image that a face uses, without mips
and file headers, and two 16-bit numbers per vertex of a textured face. What is counted is what the decoder works with: it gets
the decoded blocks and the rounded UVs. Geometry is the source's and costs nothing. UV-Reparam/ASTC is the same with a new
parametrisation and one image of as many texels (parametrise.py), on geometry of 14 bits, which costs nothing either.

Needs astc-encoder-py, `pip install "texfcodec[baselines]"`; its "thorough" preset is quality 98.
"""

import pickle
from dataclasses import replace

import numpy as np

from texfcodec.scene.scene import Texture
from tools.bench.methods import (
    Method,
    checked_options,
    draco_mesh,
    hash_of,
    method,
    packed_maps,
    parametrise,
    source_hash,
    versions_of,
)
from tools.bench.methods.packed_maps import COLOUR, NORMAL, pack_maps, three_components, two_components
from tools.bench.methods.parametrise import PARAMETRISATIONS, SOURCE_UVS, Request, reparametrised, side_of

DEFAULTS = {"block": "6x6", "quality": 98, "uv_bytes": "uint16", "profile": "ldr", "maps": "none", "normals": "xy",
            "parametrisation": "source"}
BLOCKS = ("4x4", "5x4", "5x5", "6x5", "6x6", "8x5", "8x6", "8x8", "10x5", "10x6", "10x8", "10x10", "12x10", "12x12")
# Texels of colours stay sRGB-coded either way. The linear profile meets the figures known for bball_0001 best (3D-PSNR Y 44.5,
# 46.0, 47.7, 50.2 at 12x12, 10x10, 8x8, 6x6; at the same surface points it has 44.53, 45.92, 47.66, 50.24). The sRGB profile,
# always decoded to 8 bits, is the stronger rival: 44.63, 46.06, 47.86, 50.64.
PROFILES = {"ldr": "LDR", "srgb": "LDR_SRGB"}
BLOCK_BYTES, UV_STEPS = 16, 65535
HANDLING = {"uv_bytes": ("uint16", "none"), "maps": ("none", "all"), "parametrisation": PARAMETRISATIONS}  # of any image codec
CHOICES = {"block": BLOCKS, "profile": tuple(PROFILES), "normals": ("xy", "rgb"), **HANDLING}
LAYOUT, UVS, IMAGE = "layout.pickle", "uv.uint16", "image{}.blocks"


@method("astc")
class Astc(Method):
    """The source's textures in ASTC. Options, with defaults in DEFAULTS: block one of BLOCKS; quality 0 to 100; uv_bytes
    "uint16", or "none" for uncounted UVs as they are; profile one of PROFILES, for colours; maps "none", base colour alone, or
    "all" that show more than one value; normals "xy", two components with the encoder's own measure of angles, or "rgb";
    parametrisation one of PARAMETRISATIONS."""

    options = tuple(DEFAULTS)
    packages = ("astc-encoder-py",)  # what codes

    def codec(self, options, threads):
        """Return the Codec of single images under these options. Raises LookupError, ValueError as Codec."""
        return Codec(options, threads)

    def version(self):
        """The versions of what codes and of new parametrisations, and a hash of further files that results depend on."""
        files = (module.__file__ for module in (parametrise, packed_maps, draco_mesh))
        return f"{versions_of(*self.packages)} {parametrise.versions()} {source_hash(__file__, *files)}"

    def warm_up(self, options, threads):
        """Load the library by coding a small image. Raises LookupError if it is not installed."""
        codec = self.codec(options, threads)
        codec.dec_image(codec.enc_image(np.zeros((16, 16, 4), np.uint8)), 16, 16)

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene: IMAGE for each image and, if they count, UVS, files of just the counted bytes; LAYOUT holds what is
        passed on uncoded. Raises LookupError if no face has a texture, ValueError if an option is out of range."""
        codec = self.codec(options, threads)
        with report.stage("parametrisation"):
            scene = _asked_scene(scene, codec.options, folder.parent, threads)
        images, textures = used_textures(scene)
        packed, placed = pack_maps(scene)
        kinds = [COLOUR] * len(images) + [image.kind for image in packed]
        first, images = len(textures), [codec.shipped(image) for image in (*images, *(image.image for image in packed))]
        textures += [(len(images) - len(packed) + n, image.wrap, "+".join(image.names)) for n, image in enumerate(packed)]
        vertex_uv, corner_vertex = textured_vertices(scene)
        if scene.corner_color is not None and (scene.corner_color != 1).any():
            report.warnings.append("vertex colours are handed through as they are and not counted")
        materials = [replace(m, maps={name: first + n for name, n in placed[number].items()})
                     for number, m in enumerate(scene.materials)]
        layout = {"images": [image.shape[1::-1] for image in images], "kinds": kinds, "textures": textures, "uv_box": None,
                  "corner_vertex": corner_vertex, "scene": replace(scene, textures=[], materials=materials, map_uv={},
                                                                   corner_uv=np.zeros((len(scene.faces), 3, 2)), files={})}
        with report.stage("textures"):
            coded = [codec.enc_image(image, kind) for image, kind in zip(images, kinds, strict=True)]
        sizes = {"texture": sum(map(len, coded)), "uv": 0}
        if codec.options["uv_bytes"] == "uint16":
            layout["uv_box"] = box = uv_box(vertex_uv)
            steps = quantise_uv(vertex_uv, box)
            (folder / UVS).write_bytes(steps.tobytes())
            vertex_uv, sizes["uv"] = dequantise_uv(steps, box), steps.nbytes
        with report.stage("reconstruction"):
            decoded = [codec.dec_image(data, *size, kind)
                       for data, size, kind in zip(coded, layout["images"], kinds, strict=True)]
        for number, data in enumerate(coded):
            (folder / IMAGE.format(number)).write_bytes(data)
        layout["vertex_uv"] = None if layout["uv_box"] else vertex_uv
        (folder / LAYOUT).write_bytes(pickle.dumps(layout))
        return {"bytes": {"total": sum(sizes.values()), "geometry": 0, **sizes},
                "reconstruction_sha256": hash_of(*decoded, vertex_uv[corner_vertex]), **codec.options, "images": layout["images"],
                "uv_vertices": len(vertex_uv), "uv_box": layout["uv_box"]}

    def decode(self, folder, options, threads, report):
        """Return the Scene with the decoded textures, and the decoded UVs if these were counted."""
        codec, layout = self.codec(options, threads), pickle.loads((folder / LAYOUT).read_bytes())
        with report.stage("textures"):
            images = [codec.dec_image((folder / IMAGE.format(number)).read_bytes(), *size, kind)
                      for number, (size, kind) in enumerate(zip(layout["images"], layout["kinds"], strict=True))]
        vertex_uv, scene = layout["vertex_uv"], layout["scene"]
        if layout["uv_box"]:
            vertex_uv = dequantise_uv(np.fromfile(folder / UVS, "<u2").reshape(-1, 2), layout["uv_box"])
        scene.textures = [Texture(images[number], tuple(wrap), name) for number, wrap, name in layout["textures"]]
        scene.corner_uv[textured_faces(scene)] = vertex_uv[layout["corner_vertex"]]
        return scene

    def values_sha256(self, decoded):
        """Return the hash of the decoded images, in the order of their textures, then of the UVs of the textured faces."""
        images = {id(t.image): t.image for t in decoded.textures}
        return hash_of(*images.values(), decoded.corner_uv[textured_faces(decoded)])


def _asked_scene(scene, options, keep, threads):
    """A Scene with the maps and the parametrisation that options ask for. keep: folder for new parametrisations."""
    if options["parametrisation"] != SOURCE_UVS:
        if options["maps"] != "none":
            raise ValueError("a new parametrisation has the base colour alone, so that maps must be \"none\"")
        return reparametrised(scene, Request(options["parametrisation"], side_of(scene)), keep, threads)[0]
    if options["maps"] == "none":
        return replace(scene, materials=[replace(m, maps={}) for m in scene.materials])
    from tools.bench.map_errors import needed_maps

    return needed_maps(scene)


class Codec:
    """ASTC for single images. options: dict with keys of DEFAULTS; threads: of the library. Raises LookupError if the library is
    not installed, ValueError if an option is out of range."""

    def __init__(self, options, threads):
        self.options = checked_options(options, DEFAULTS, {}, CHOICES)
        quality = self.options["quality"]
        if isinstance(quality, bool | str) or not 0 <= quality <= 100:
            raise ValueError(f"quality must be a number from 0 to 100, not {quality!r}")
        try:
            import astc_encoder
        except ImportError as error:
            raise LookupError(f"astc needs astc-encoder-py, pip install \"texfcodec[baselines]\" brings it: {error}") from error
        self._lib, self._block = astc_encoder, block_of(self.options["block"])
        self._threads, self._contexts, self._rgba = threads, {}, astc_encoder.ASTCSwizzle.from_str("RGBA")
        self._context(COLOUR)

    def _context(self, kind):
        """The encoder's state for one kind of image."""
        if kind not in self._contexts:
            flags = self._lib.ASTCConfigFlags.MAP_NORMAL if self._is_xy(kind) else self._lib.ASTCConfigFlags(0)
            profile = self._lib.ASTCProfile[PROFILES[self.options["profile"] if kind == COLOUR else "ldr"]]
            config = self._lib.ASTCConfig(profile, *self._block, 1, self.options["quality"], flags)
            self._contexts[kind] = self._lib.ASTCContext(config, self._threads)
        return self._contexts[kind]

    def _is_xy(self, kind):
        return kind == NORMAL and self.options["normals"] == "xy"

    def shipped(self, image):
        """Return the image that is coded in place of a source image: the same."""
        return image

    def enc_image(self, image, kind=COLOUR):
        """Return the blocks (bytes) of an RGBA image uint8 [H, W, 4]. kind: of packed_maps: COLOUR, NORMAL or DATA."""
        height, width = image.shape[:2]
        image = two_components(image) if self._is_xy(kind) else image
        data = np.ascontiguousarray(image, np.uint8).tobytes()
        blocks = self._context(kind).compress(self._lib.ASTCImage(self._lib.ASTCType.U8, width, height, data=data), self._rgba)
        if len(blocks) != texture_bytes(width, height, self._block):
            raise ValueError(f"the encoder made {len(blocks)} bytes of an image of {width} x {height}")
        return blocks

    def dec_image(self, blocks, width, height, kind=COLOUR):
        """Return the RGBA image uint8 [H, W, 4] that blocks (bytes) hold. Raises ValueError if their number is wrong."""
        if len(blocks) != texture_bytes(width, height, self._block):
            raise ValueError(f"{len(blocks)} bytes are no image of {width} x {height} in blocks of {self.options['block']}")
        image = self._lib.ASTCImage(self._lib.ASTCType.U8, width, height)
        self._context(kind).decompress(blocks, image, self._rgba)
        decoded = np.frombuffer(image.data, np.uint8).reshape(height, width, 4)
        return three_components(decoded) if self._is_xy(kind) else decoded


def block_of(text):
    """Return (width, height) in texels of a block size such as "12x10"."""
    return tuple(int(side) for side in text.split("x"))


def texture_bytes(width, height, block):
    """Return the bytes of an image in blocks of (width, height) texels: whole blocks, no mips, no header."""
    return BLOCK_BYTES * -(-width // block[0]) * -(-height // block[1])


def textured_faces(scene):
    """Return a mask of the faces whose material has a texture, of base colour or a map, bool [F]."""
    return np.array([m.texture >= 0 or bool(m.maps) for m in scene.materials], bool)[scene.face_material]


def used_textures(scene):
    """Return the base-colour images of faces, uint8 [H, W, 4], each once, and [(index of its image, wrap, name)] of all
    textures.

    A texture that no face uses has index 0, which is never looked up. Raises LookupError if no face has a texture.
    """
    used = {scene.materials[m].texture for m in np.unique(scene.face_material)} - {-1}
    if not used:
        raise LookupError("no face has a base-colour texture, and ASTC codes nothing else, no vertex colours either")
    images = {id(scene.textures[t].image): scene.textures[t].image for t in sorted(used)}
    numbers = {key: number for number, key in enumerate(images)}
    textures = [(numbers.get(id(t.image), 0), t.wrap, t.name) for t in scene.textures]
    return list(images.values()), textures


def textured_vertices(scene):
    """Return a renderer's vertices, the distinct pairs of position and UV: UVs float64 [N, 2], and the vertex of each corner of
    the T textured faces, int64 [T, 3]."""
    faces = textured_faces(scene)
    rows = np.column_stack([scene.faces[faces].reshape(-1), scene.corner_uv[faces].reshape(-1, 2)])  # indices are exact < 2**53
    rows, vertex = np.unique(rows, axis=0, return_inverse=True)
    return rows[:, 1:], vertex.reshape(-1, 3)


def uv_box(uv):
    """Return [[low u, low v], [high u, high v]], integers: the unit square, grown by whole tiles until it holds uv, [N, 2]."""
    return [np.floor(uv.min(axis=0, initial=0)).tolist(), np.ceil(uv.max(axis=0, initial=1)).tolist()]


def quantise_uv(uv, box):
    """Return UVs float64 [N, 2] as little-endian uint16 [N, 2]; 0 and UV_STEPS are the sides of the box of uv_box()."""
    low, high = np.array(box)
    return np.rint((uv - low) / (high - low) * UV_STEPS).astype("<u2")


def dequantise_uv(steps, box):
    """Return UVs float64 [N, 2] of uint16 [N, 2], the inverse of quantise_uv(), with an error of at most half a step."""
    low, high = np.array(box)
    return low + steps.astype(np.float64) / UV_STEPS * (high - low)
