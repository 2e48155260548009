"""The rivals UV-Source and UV-Reparam: UVs by Draco, images by HEVC, AV1, AVIF, WebP, JPEG or JPEG XL. Base colour alone.

Bytes: "geometry" is what Draco needs for the positions alone at 14 bits, one mesh, as it is of our own streams; "uv" is what it
needs more with UVs, one mesh per material or one of all, whichever is smaller; "texture" are the images that faces use, each
content once. The total is the size of the files MESH and IMAGE, and the decoder has nothing else but what costs a file format a
few bytes: the box of the mesh and those of the UVs, sizes of images, the materials' names, factors and wrap modes. Handed through
for nothing, in the rivals' favour, are the material of each face and vertex colours beside textures.

UVs take uv_bits of the longer side of their material's box. "auto" is the paper's: 12 for images up to 2048 texels a side, 13
above; one more for every time that the box is twice as long as the image, where textures repeat.

"source" takes the source's UVs and images; "uvatlas" and "xatlas" a new parametrisation with one square image (parametrise.py),
which has as many texels as the source's images together unless `size` says otherwise. scale: of the sides of images.
"""

import hashlib
import json
from dataclasses import asdict

import numpy as np
from PIL import Image

from texfcodec.geometry.canonical import CanonicalCube, fit_cube
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import Method, image_codecs, method, parametrise, source_hash

DEFAULTS = {"parametrisation": "source", "codec": "hevc", "quality": 35, "chroma": "420", "uv_bits": "auto", "scale": 1.0,
            "size": 0, "seconds": parametrise.SECONDS}
UV_BITS, LARGE_UV_BITS, LARGE, MOST_UV_BITS = 12, 13, 2048, 20
MESH, IMAGE, LAYOUT, HANDED = "mesh{}.drc", "image{}.{}", "layout.json", "handed.npz"


@method("uv")
class Uv(Method):
    """Options and their defaults stand in DEFAULTS: parametrisation one of parametrise.PARAMETRISATIONS; codec, quality, chroma
    as image_codecs has them; uv_bits "auto" or a number; scale of the images' sides; size: side of a new atlas, 0 for as many
    texels as the source has; seconds: time limit of a new parametrisation."""

    options = tuple(DEFAULTS)

    def version(self):
        """The versions of all encoders, of open3d and of xatlas, and a hash of further files that results depend on."""
        from tools.bench import everyday_rivals

        found = dict.fromkeys(image_codecs.versions(codec) for codec in image_codecs.CODECS)
        code = source_hash(*(module.__file__ for module in (image_codecs, parametrise, everyday_rivals)))
        return " ".join([*found, parametrise.versions(), code])

    def missing(self, options):
        """As Method.missing."""
        options = DEFAULTS | options
        codec = image_codecs.missing(options["codec"]) if options["codec"] in image_codecs.CODECS else None
        return codec or parametrise.missing(options["parametrisation"])

    def warm_up(self, options, threads):
        """Loads the codec. LookupError, ValueError: as checked()."""
        options = checked(options)
        kind = options["codec"], options["quality"], options["chroma"], threads
        image_codecs.dec_image(image_codecs.enc_image(np.zeros((32, 32, 3), np.uint8), *kind), options["codec"], 32, 32)

    def encode(self, scene, options, folder, threads, report):
        """Writes MESH, IMAGE, LAYOUT and HANDED. LookupError: nothing has a texture. ValueError: an option is out of range.
        NoAtlas: there is no new parametrisation."""
        from tools.bench.everyday_rivals import positions_alone, rival_of

        options = checked(options)
        texels, seconds = parametrise.used_texels(scene), 0.0
        if options["parametrisation"] != parametrise.SOURCE_UVS:
            with report.stage("parametrisation"):
                side = max(round((options["size"] or parametrise.side_of(scene)) * options["scale"]), parametrise.LEAST_SIDE)
                request = parametrise.Request(options["parametrisation"], side, options["seconds"])
                scene, seconds = parametrise.reparametrised(scene, request, folder.parent, threads)
        rival, cube = rival_of(scene), fit_cube(scene.positions, parametrise.POSITION_BITS)
        with report.stage("mesh"):
            bits = uv_bits_of(rival, options)
            meshes, handed, facts = enc_meshes(rival, bits)
            positions = positions_alone(rival.lattice, rival.scene.faces)
        with report.stage("textures"):
            coded, sizes = enc_images(rival, options, threads)
        if rival.is_coloured:
            report.warnings.append("vertex colours are handed through as they are and not counted")
        for number, data in enumerate(meshes):
            (folder / MESH.format(number)).write_bytes(data)
        for number, data in enumerate(coded):
            (folder / IMAGE.format(number, options["codec"])).write_bytes(data)
        (folder / LAYOUT).write_text(json.dumps(facts | sizes | layout_of(rival, cube, options)), encoding="utf-8")
        np.savez(folder / HANDED, **handed)
        total, texture = sum(map(len, meshes)), sum(map(len, coded))
        with report.stage("reconstruction"):
            sha256 = self.values_sha256(decoded(folder))
        return {"bytes": {"total": total + texture, "geometry": positions, "uv": total - positions, "texture": texture},
                "reconstruction_sha256": sha256, **options, "uv_bits": bits, "meshes": len(meshes), "images": sizes["images"],
                "source_texels": texels, "parametrisation_seconds": seconds}

    def decode(self, folder, options, threads, report):
        """The Scene with decoded positions, UVs and images."""
        with report.stage("decode"):
            return decoded(folder)

    def values_sha256(self, decoded):
        """Over images, then positions and UVs of corners as little-endian float64."""
        total = hashlib.sha256()
        for texture in decoded.textures:
            total.update(np.ascontiguousarray(texture.image))
        for values in (decoded.positions[decoded.faces], decoded.corner_uv):
            total.update(np.ascontiguousarray(values, "<f8"))
        return total.hexdigest()


def checked(options):
    """All options with their defaults. ValueError: one is out of range; LookupError: something is not installed."""
    options = DEFAULTS | options
    image_codecs.check(options["codec"], options["quality"], options["chroma"])
    if options["parametrisation"] not in parametrise.PARAMETRISATIONS:
        raise ValueError(f"parametrisation must be one of {', '.join(parametrise.PARAMETRISATIONS)}, "
                         f"not {options['parametrisation']!r}")
    if sentence := parametrise.missing(options["parametrisation"]):
        raise LookupError(sentence)
    for name, low, high in (("scale", 1 / 64, 4), ("size", 0, parametrise.MOST_SIDE), ("seconds", 0.001, 1e6)):
        if isinstance(options[name], bool | str) or not low <= options[name] <= high:
            raise ValueError(f"{name} must be a number from {low:g} to {high:g}, not {options[name]!r}")
    if options["uv_bits"] != "auto" and options["uv_bits"] not in range(4, MOST_UV_BITS + 1):
        raise ValueError(f"uv_bits must be \"auto\" or a number from 4 to {MOST_UV_BITS}, not {options['uv_bits']!r}")
    return options


def uv_bits_of(rival, options):
    """Bits of the longer side of a UV box."""
    from tools.bench.everyday_rivals import uv_boxes

    if options["uv_bits"] != "auto":
        return options["uv_bits"]
    large = max(max(image.shape[:2]) for image in rival.images.values()) > LARGE
    textured = np.unique(rival.scene.face_material[rival.textured])
    tiles = uv_boxes(rival)[1][textured].max(initial=1.0)
    return min((LARGE_UV_BITS if large else UV_BITS) + max(int(np.ceil(np.log2(tiles) - 1e-3)), 0), MOST_UV_BITS)


# Meshes.


def enc_meshes(rival, bits):
    """(Draco bytes by mesh, {"face_material", "corner_color"} in the order of their faces, facts for LAYOUT): one mesh per
    material or one of all, whichever is smaller."""
    from tools.bench.everyday_rivals import dec_mesh, enc_mesh, quantise_uv, uv_boxes

    uv, material, faces = quantise_uv(rival, bits), rival.scene.face_material, rival.scene.faces

    def coded(chosen):
        has_uv = rival.textured[chosen].any()
        return enc_mesh(rival.lattice, faces[chosen], uv[chosen] if has_uv else None, bits, None), bits if has_uv else 0

    apart = [np.flatnonzero(material == m) for m in np.unique(material)]
    ways = [[np.arange(len(faces))]] + ([apart] if len(apart) > 1 else [])
    made = [[coded(chosen) for chosen in way] for way in ways]
    best = min(range(len(made)), key=lambda n: sum(len(data) for data, _ in made[n]))
    order, turns = [], []
    for chosen, (data, with_bits) in zip(ways[best], made[best], strict=True):
        positions, found = dec_mesh(data, with_bits)
        ours = np.concatenate([rival.lattice[faces[chosen]], uv[chosen]], axis=2)
        face, turn = parametrise.matched(ours[..., : 5 if with_bits else 3],
                                         positions if found is None else np.concatenate([positions, found], axis=2))
        order.append(chosen[face])
        turns.append(turn)
    order, turn = np.concatenate(order), np.concatenate(turns)
    colour = np.zeros((0, 3, 4), np.float32)
    if rival.is_coloured:
        colour = rival.scene.corner_color[order[:, None], (np.arange(3) + turn[:, None]) % 3]
    low, side = uv_boxes(rival)
    return ([data for data, _ in made[best]], {"face_material": material[order], "corner_color": colour},
            {"mesh_uv_bits": [b for _, b in made[best]], "uv_low": low.tolist(), "uv_side": side.tolist()})


def dec_meshes(folder, layout, handed):
    """(lattice int64 [V, 3], faces int64 [F, 3], corner UVs float64 [F, 3, 2]) of the files MESH."""
    from tools.bench.everyday_rivals import dec_mesh

    positions, shares = [], []
    for number, bits in enumerate(layout["mesh_uv_bits"]):
        corner, uv = dec_mesh((folder / MESH.format(number)).read_bytes(), bits)
        positions.append(corner)
        shares.append(np.zeros((len(corner), 3, 2)) if uv is None else uv / ((1 << bits) - 1))
    lattice, index = np.unique(np.concatenate(positions).reshape(-1, 3), axis=0, return_inverse=True)
    material = handed["face_material"]
    low, side = (np.array(layout[name])[material] for name in ("uv_low", "uv_side"))
    return lattice, index.reshape(-1, 3), low[:, None] + np.concatenate(shares) * side[:, None, None]


# Images.


def enc_images(rival, options, threads):
    """(bytes of each image, {"images": their [width, height]})."""
    kind, out, sizes = (options["codec"], options["quality"], options["chroma"], threads), [], []
    scale = options["scale"] if options["parametrisation"] == parametrise.SOURCE_UVS else 1
    for key, image in rival.images.items():
        image = image if key in rival.with_alpha else np.ascontiguousarray(image[..., :3])
        if scale != 1:
            size = [max(1, round(side * scale)) for side in image.shape[1::-1]]
            image = np.asarray(Image.fromarray(image).resize(size, Image.Resampling.LANCZOS))
        out.append(image_codecs.enc_image(image, *kind))
        sizes.append(image.shape[1::-1])
    return out, {"images": sizes}


def layout_of(rival, cube, options):
    """What else a file format would say, JSON-ready. cube: CanonicalCube of the lattice."""
    numbers = {key: number for number, key in enumerate(rival.images)}
    textures = [{"image": numbers.get(key, 0), "wrap": list(t.wrap), "name": t.name}
                for key, t in zip(rival.content, rival.scene.textures, strict=True)]
    materials = [{name: value for name, value in asdict(m).items() if name not in ("maps", "parameters", "normals")}
                 | {"factor": m.factor.tolist()} for m in rival.scene.materials]
    return {"codec": options["codec"], "textures": textures, "materials": materials, "cube": [cube.origin, cube.side]}


def decoded(folder):
    """The Scene of a folder's files."""
    layout = json.loads((folder / LAYOUT).read_text(encoding="utf-8"))
    with np.load(folder / HANDED) as file:
        handed = dict(file)
    lattice, faces, corner_uv = dec_meshes(folder, layout, handed)
    images = [image_codecs.dec_image((folder / IMAGE.format(number, layout["codec"])).read_bytes(), layout["codec"], *size)
              for number, size in enumerate(layout["images"])]
    textures = [Texture(images[t["image"]], tuple(t["wrap"]), t["name"]) for t in layout["textures"]]
    materials = [Material(**m | {"factor": np.array(m["factor"])}) for m in layout["materials"]]
    origin, side = layout["cube"]
    positions = CanonicalCube(tuple(origin), side, parametrise.POSITION_BITS).to_world(lattice)
    colour = handed["corner_color"] if len(handed["corner_color"]) else None
    return Scene(positions, faces, handed["face_material"], corner_uv, colour, materials, textures)
