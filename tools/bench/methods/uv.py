"""The rivals UV-Source and UV-Reparam: UVs by Draco, images by HEVC, AV1, AVIF, WebP, JPEG or JPEG XL. Base colour alone, or all
that is seen in light.

Bytes: "geometry" is what Draco needs for the positions alone at 14 bits, one mesh, as it is of our own streams; "uv" is what it
needs more for all that stands at corners, one mesh per material or one of all, whichever is smaller; "texture" are the images
that faces use, each content once. The total is the size of the files MESH and IMAGE, and the decoder has nothing else but what
costs a file format a few bytes: the box of the mesh and those of the UVs, sizes of images, the materials' names, factors and wrap
modes. Handed through for nothing, in the rivals' favour, are the material of each face and, without colour_bits, vertex colours.

UVs take uv_bits of the longer side of their material's box. "auto" is the paper's: 12 for images up to 2048 texels a side, 13
above; one more for every time that the box is twice as long as the image, where textures repeat.

"source" takes the source's UVs and images; "uvatlas" and "xatlas" a new parametrisation with one square image (parametrise.py),
which has as many texels as the source's images together unless `size` says otherwise. scale: of the sides of images.

What a user of everyday tools has is colour_bits with the codecs avif6, webp4 and jpeg. With maps = "all" every map that shows
more than one value is coded, each image at the same quality and, with chroma = "best", at the better of both subsamplings;
columns that nothing asks are flat, one alone is grey. normal_bits are those of Draco's octahedra; without tangent_bits viewers
make TANGENTs, and maps that the file's turn over are turned back first.
"""

import pickle
from dataclasses import replace

import numpy as np
from PIL import Image

from texfcodec.geometry.canonical import fit_cube
from texfcodec.scene.scene import Material, Scene, Texture
from tools.bench.methods import Method, draco_mesh, hash_of, image_codecs, method, parametrise, source_hash
from tools.bench.methods.draco_mesh import dec_mesh, enc_mesh, positions_alone, quantise_uv, rival_of, uv_boxes

DEFAULTS = {"parametrisation": "source", "codec": "hevc", "quality": 35, "chroma": "420", "uv_bits": "auto", "scale": 1.0,
            "size": 0, "seconds": parametrise.SECONDS, "colour_bits": 0, "maps": "none", "normal_bits": 0, "tangent_bits": 0}
UV_BITS, LARGE_UV_BITS, LARGE, MOST_UV_BITS = 12, 13, 2048, 20
CORNER_BITS = {"colour_bits": 12, "normal_bits": 16, "tangent_bits": 16}  # the most of each
MESH, IMAGE, LAYOUT = "mesh{}.drc", "image{}.{}", "layout.pickle"
WORTH = 0.8  # of a smaller image: bytes, times the error to this power


@method("uv")
class Uv(Method):
    """A mesh with UVs by Draco and images by a codec. Options, with defaults in DEFAULTS: parametrisation one of
    parametrise.PARAMETRISATIONS; codec, quality, chroma as of image_codecs, or chroma "best"; uv_bits "auto" or a number; scale
    of the images' sides; size: side of a new atlas, 0 for as many texels as the source has; seconds: limit of a new
    parametrisation; maps "none" or "all"; colour_bits, normal_bits, tangent_bits: of corner attributes, 0 for none."""

    options = tuple(DEFAULTS)

    def version(self):
        """The versions of all encoders, of open3d and of xatlas, and a hash of further files that results depend on."""
        versions = dict.fromkeys(image_codecs.versions(codec) for codec in image_codecs.CODECS)
        code = source_hash(*(module.__file__ for module in (image_codecs, parametrise, draco_mesh)))
        return " ".join([*versions, parametrise.versions(), code])

    def missing(self, options):
        """Return a sentence on what the codec or the parametrisation needs that is not installed; None if nothing is missing."""
        options = DEFAULTS | options
        codec = image_codecs.missing(options["codec"]) if options["codec"] in image_codecs.CODECS else None
        return codec or parametrise.missing(options["parametrisation"])

    def warm_up(self, options, threads):
        """Load the codec. Raises LookupError, ValueError as checked()."""
        options = checked(options)
        kind = options["codec"], options["quality"], options["chroma"].replace("best", "420"), threads
        image_codecs.dec_image(image_codecs.enc_image(np.zeros((32, 32, 3), np.uint8), *kind), options["codec"], 32, 32)

    def encode(self, scene, options, folder, threads, report):
        """Code a Scene into MESH, IMAGE and LAYOUT. Raises LookupError if nothing has a texture, ValueError if an option is out
        of range, NoAtlas without a new parametrisation."""
        options = checked(options)
        if options["maps"] == "all":
            scene = shown_in_light(scene)
        bare = options["colour_bits"] and not any(m.texture >= 0 for m in scene.materials)
        texels, seconds = 0 if bare else parametrise.used_texels(scene), 0.0
        if options["parametrisation"] != parametrise.SOURCE_UVS:
            with report.stage("parametrisation"):
                side = max(round((options["size"] or parametrise.side_of(scene)) * options["scale"]), parametrise.LEAST_SIDE)
                request = parametrise.Request(options["parametrisation"], side, options["seconds"])
                scene, seconds = parametrise.reparametrised(scene, request, folder.parent, threads)
        rival, cube = rival_of(scene, with_maps=options["maps"] == "all"), fit_cube(scene.positions, parametrise.POSITION_BITS)
        with report.stage("mesh"):
            bits = uv_bits_of(rival, options)
            meshes, facts = enc_meshes(rival, bits, options)
            positions = positions_alone(rival.lattice, rival.scene.faces)
        with report.stage("textures"):
            coded, sizes = enc_images(rival, options, threads)
        if rival.is_coloured and not options["colour_bits"]:
            report.warnings.append("vertex colours are handed through as they are and not counted")
        for number, data in enumerate(meshes):
            (folder / MESH.format(number)).write_bytes(data)
        for number, data in enumerate(coded):
            (folder / IMAGE.format(number, options["codec"])).write_bytes(data)
        (folder / LAYOUT).write_bytes(pickle.dumps(facts | sizes | handed_through(rival, options, cube)))
        total, texture = sum(map(len, meshes)), sum(map(len, coded))
        with report.stage("reconstruction"):
            sha256 = self.values_sha256(decoded(folder))
        return {"bytes": {"total": total + texture, "geometry": positions, "uv": total - positions, "texture": texture},
                "reconstruction_sha256": sha256, **options, "uv_bits": bits, "meshes": len(meshes), "images": sizes["images"],
                "source_texels": texels, "parametrisation_seconds": seconds}

    def decode(self, folder, options, threads, report):
        """Return the Scene with decoded positions, UVs and images."""
        with report.stage("decode"):
            return decoded(folder)

    def values_sha256(self, decoded):
        """Return the hash of a decoded Scene's images, then of the positions and UVs of its corners."""
        return hash_of(*(texture.image for texture in decoded.textures), decoded.positions[decoded.faces], decoded.corner_uv)


def checked(options):
    """Return all options with defaults. Raises ValueError if one is out of range, LookupError if something is not installed."""
    options = DEFAULTS | options
    image_codecs.check(options["codec"], options["quality"], options["chroma"].replace("best", "420"))
    if options["maps"] not in ("none", "all"):
        raise ValueError(f"maps must be none or all, not {options['maps']!r}")
    for name, most in CORNER_BITS.items():
        if type(options[name]) is not int or not 0 <= options[name] <= most:
            raise ValueError(f"{name} must be a whole number from 0 to {most}, not {options[name]!r}")
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
    """Return the number of bits for the longer side of a UV box: options["uv_bits"], or by the image sizes and UV tiles."""
    if options["uv_bits"] != "auto":
        return options["uv_bits"]
    large = max((max(image.shape[:2]) for image in rival.images.values()), default=0) > LARGE
    textured = np.unique(rival.scene.face_material[rival.textured])
    tiles = uv_boxes(rival)[1][textured].max(initial=1.0)
    return min((LARGE_UV_BITS if large else UV_BITS) + max(int(np.ceil(np.log2(tiles) - 1e-3)), 0), MOST_UV_BITS)


# Meshes.


def shown_in_light(scene):
    """Return the Scene with the maps that shading needs, upright (draco_mesh). Raises LookupError if a map has its own UVs."""
    from tools.bench.map_errors import needed_maps

    scene = needed_maps(scene)
    if scene.map_uv:
        raise LookupError("maps with UVs of their own are not counted here")
    return draco_mesh.upright(scene)


def corner_parts(rival, bits, options):
    """Return ({name: corner attribute}, {name: bits}) of a Rival, as enc_mesh() takes them. bits: of UVs."""
    scene, parts = rival.scene, {"uv": quantise_uv(rival, bits)}
    if options["colour_bits"] and rival.is_coloured:
        parts["colour"] = draco_mesh.quantise_colour(rival, options["colour_bits"])
    if options["normal_bits"] and scene.corner_normal is not None:
        parts["normal"] = draco_mesh.octahedral(scene.corner_normal, options["normal_bits"])
        if options["tangent_bits"] and scene.corner_tangent is not None:
            parts["tangent"] = draco_mesh.quantise_tangent(scene.corner_tangent, options["tangent_bits"])
    return parts, {"uv": bits, "normal": options["normal_bits"]}


def enc_meshes(rival, bits, options):
    """Return ([Draco bytes], entries for LAYOUT) of one mesh per material or one for all, whichever is smaller. bits: of UVs."""
    material, faces = rival.scene.face_material, rival.scene.faces
    parts, part_bits = corner_parts(rival, bits, options)

    def coded(chosen):
        attributes = {name: part[chosen] for name, part in parts.items() if name != "uv" or rival.textured[chosen].any()}
        return enc_mesh(rival.lattice, faces[chosen], attributes, part_bits)

    apart = [np.flatnonzero(material == m) for m in np.unique(material)]
    ways = [[np.arange(len(faces))]] + ([apart] if len(apart) > 1 else [])
    meshes = [[coded(chosen) for chosen in way] for way in ways]
    best = min(range(len(meshes)), key=lambda n: sum(map(len, meshes[n])))
    order, turns = [], []
    for chosen, data in zip(ways[best], meshes[best], strict=True):
        back = dec_mesh(data)
        ours = np.concatenate([rival.lattice[faces[chosen]], *([parts["uv"][chosen]] if "uv" in back else [])], axis=2)
        face, turn = parametrise.matched(ours, np.concatenate([back[name] for name in ("vertex", "uv") if name in back], axis=2))
        order.append(chosen[face])
        turns.append(turn)
    order, turn = np.concatenate(order), np.concatenate(turns)
    colour = None
    if rival.is_coloured and "colour" not in parts:
        colour = rival.scene.corner_color[order[:, None], (np.arange(3) + turn[:, None]) % 3]
    low, side = uv_boxes(rival)
    alpha = float(parts["colour"][0, 0, 3]) / ((1 << options["colour_bits"]) - 1) if "colour" in parts else 1.0
    return meshes[best], {"meshes": len(meshes[best]), "uv_bits": bits, "uv_low": low, "uv_side": side, "colour_alpha": alpha,
                          "face_material": material[order], "corner_color": colour}


def dec_meshes(folder, layout):
    """Return (lattice int64 [V, 3], faces int64 [F, 3], {"corner_uv" and further fields of a Scene}) from the files MESH."""
    meshes = [dec_mesh((folder / MESH.format(number)).read_bytes()) for number in range(layout["meshes"])]
    corners = np.concatenate([mesh["vertex"] for mesh in meshes])
    lattice, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    low, side = (layout[name][layout["face_material"]] for name in ("uv_low", "uv_side"))
    share = np.concatenate([mesh.get("uv", np.zeros((len(mesh["vertex"]), 3, 2))) for mesh in meshes])
    attributes = {"corner_uv": low[:, None] + share / ((1 << layout["uv_bits"]) - 1) * side[:, None, None],
                  "corner_color": layout["corner_color"]}
    if "colour" in meshes[0]:
        colours = [np.full((len(mesh["vertex"]), 3, 4), layout["colour_alpha"], np.float32) for mesh in meshes]
        for mesh, colour in zip(meshes, colours, strict=True):
            colour[..., : mesh["colour"].shape[2]] = mesh["colour"] / ((1 << layout["colour_bits"]) - 1)
        attributes["corner_color"] = np.concatenate(colours)
    if "normal" in meshes[0]:
        attributes["corner_normal"] = np.concatenate([mesh["normal"] for mesh in meshes]).astype(np.float32)
    if "tangent" in meshes[0]:
        tangent = np.concatenate([mesh["tangent"] for mesh in meshes])
        attributes["corner_tangent"] = draco_mesh.dequantise_tangent(tangent, layout["tangent_bits"])
    return lattice, index.reshape(-1, 3), attributes


# Images.


def enc_images(rival, options, threads):
    """Return ([bytes of each image], {"images": [[width, height]]}) of a Rival."""
    images = images_of(rival, options)
    return ([_coded(image, components, options, threads) for image, components in images],
            {"images": [image.shape[1::-1] for image, _ in images]})


def images_of(rival, options):
    """Return [(image uint8 [H, W, 3 or 4], its components that are read)] of a Rival. Unread columns are flat; a single one is
    grey."""
    out = []
    scale = options["scale"] if options["parametrisation"] == parametrise.SOURCE_UVS else 1
    for key, image in rival.images.items():
        components = sorted(rival.columns[key])
        if rival.with_maps:
            image = image.copy()
            image[..., [c for c in range(3) if c not in components]] = 0
            if len(components) == 1 and components != [3]:
                image[..., :3] = image[..., components]
        image = np.ascontiguousarray(image if 3 in components else image[..., :3])
        if scale != 1:
            image = resized(image, [max(1, round(side * scale)) for side in image.shape[1::-1]], rival.with_maps)
        out.append((image, components))
    return out


def resized(image, size, alpha_is_data):
    """Return an image uint8 [H, W, 3 or 4] resized to (width, height). alpha_is_data: resize alpha apart, because Pillow weighs
    colours by it."""
    parts = (slice(3), 3) if alpha_is_data and image.shape[2] == 4 else (slice(None),)
    small = (Image.fromarray(np.ascontiguousarray(image[..., part])).resize(size, Image.Resampling.LANCZOS) for part in parts)
    return np.dstack([np.asarray(part) for part in small])


def _coded(image, components, options, threads):
    codec, quality = options["codec"], options["quality"]
    chroma = better_chroma(image, components, options, threads) if options["chroma"] == "best" else options["chroma"]
    return image_codecs.enc_image(image, codec, quality, chroma, threads)


def better_chroma(image, components, options, threads=1):
    """Return the one of image_codecs.CHROMAS that saves more than it loses on an image at codec and quality of options."""
    codec, quality, chromas = options["codec"], options["quality"], image_codecs.CHROMAS
    ways = [image_codecs.enc_image(image, codec, quality, chroma, threads) for chroma in chromas]
    seen = [image_codecs.dec_image(data, codec, *image.shape[1::-1])[..., components].astype(np.float32) for data in ways]
    truth = image[..., [min(c, image.shape[2] - 1) for c in components]]
    costs = [len(data) * max(float(((decoded - truth) ** 2).mean()), 1e-3) ** WORTH
             for data, decoded in zip(ways, seen, strict=True)]
    return chromas[int(np.argmin(costs))]


def handed_through(rival, options, cube):
    """Return the further facts that a file format would hold, for LAYOUT, uncounted. cube: CanonicalCube of the lattice."""
    numbers = {key: number for number, key in enumerate(rival.images)}
    textures = [(numbers.get(key, 0), t.wrap, t.name) for key, t in zip(rival.content, rival.scene.textures, strict=True)]
    bare = {"normals": Material().normals} | ({} if rival.with_maps else {"maps": {}, "parameters": {}})
    return {"textures": textures, "materials": [replace(m, **bare) for m in rival.scene.materials], "cube": cube,
            **{name: options[name] for name in ("codec", "colour_bits", "tangent_bits")}}


def decoded(folder):
    """Return the Scene decoded from the files in a folder."""
    layout = pickle.loads((folder / LAYOUT).read_bytes())
    images = [image_codecs.dec_image((folder / IMAGE.format(number, layout["codec"])).read_bytes(), layout["codec"], *size)
              for number, size in enumerate(layout["images"])]
    return scene_of(layout, dec_meshes(folder, layout), images)


def scene_of(layout, mesh, images):
    """Return the Scene of a dec_meshes() result and decoded images, uint8 [H, W, 4] each."""
    lattice, faces, attributes = mesh
    textures = [Texture(images[number], wrap, name) for number, wrap, name in layout["textures"]] if images else []
    base = {name: attributes[name] for name in ("corner_uv", "corner_color")}
    scene = Scene(layout["cube"].to_world(lattice), faces, layout["face_material"], *base.values(), layout["materials"], textures)
    for name in attributes.keys() - base.keys():
        setattr(scene, name, attributes[name])
    return scene
