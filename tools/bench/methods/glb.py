"""Whole GLB files of rivals: the source as all of them get it, what its parts weigh, and the check of what came out.

Every rival codes the same: positions, faces, base colour (factors, images, and their UVs) with alpha where it shows, and vertex
colours where they say anything. Normals, tangents, other maps and names are left out, as uv.py leaves them out; our
side is to be coded with effects = "none". Vertices are the distinct pairs of position, UV and colour of a material.
"""

import hashlib
import json
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from texfcodec.scene.scene import ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material
from tools.bench.methods import hash_of

POSITION_BITS = 14
WHOLE, BARE = "whole.glb", "geometry.glb"
WRAPS = {WRAP_REPEAT: 10497, WRAP_CLAMP: 33071, WRAP_MIRROR: 33648}


@dataclass
class Source:
    """A Scene without its images, and these, as rivals code them. scene: its materials without maps and names; images: {content:
    uint8 [H, W, 3 or 4]} that faces use, each once; content: key of each texture's image, None if unused."""

    scene: object
    images: dict
    content: list

    @property
    def is_coloured(self):
        """Whether vertex colours say anything."""
        colour = self.scene.corner_color
        return colour is not None and bool((colour != 1).any())

    @property
    def sizes(self):
        """[(width, height)] of the images."""
        return [image.shape[1::-1] for image in self.images.values()]


def source_of(scene):
    """Return the Source of a Scene."""
    images, content, used = {}, [None] * len(scene.textures), np.unique(scene.face_material)
    shown = {m.texture for m in (scene.materials[n] for n in used) if m.alpha_mode != ALPHA_OPAQUE}
    for texture in sorted({scene.materials[n].texture for n in used} - {-1}):
        image = scene.textures[texture].image
        if texture not in shown or (image[:, :, 3] == 255).all():
            image = np.ascontiguousarray(image[:, :, :3])
        content[texture] = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()
        images.setdefault(content[texture], image)
    materials = [Material("", m.factor, m.texture, m.alpha_mode, m.alpha_cutoff, m.double_sided, m.unlit)
                 for m in scene.materials]
    return Source(replace(scene, materials=materials), images, content)


def document_of(source, coded=None):
    """Return the glTF Document of a Source. coded: {content: (image_write.ImageFormat, bytes)}, one per image; without it
    images, UVs and vertex colours are left out, and the geometry remains."""
    from texfcodec.io.gltf.material import extensions_of, write_material
    from texfcodec.io.gltf.packing import Plain
    from texfcodec.io.gltf.writer import Document

    document, scene, packing = Document({}), source.scene, Plain()
    textures = _add_textures(document, source, coded or {})
    low, high = scene.positions.min(axis=0), scene.positions.max(axis=0)
    box = SimpleNamespace(positions=scene.positions, origin=low, side=float((high - low).max()), position_bits=POSITION_BITS)
    positions, translation, scale = packing.positions(box, np.arange(len(scene.positions)))
    entries, primitives = [], []
    for number in np.unique(scene.face_material):
        columns, corners = _columns(source, positions, number, coded is not None)
        images = {"base_colour": textures[scene.materials[number].texture]} if "TEXCOORD_0" in columns else {}
        primitives.append(packing.primitive(document, columns, corners) | {"material": len(entries)})
        entries.append(write_material(scene.materials[number], images))
    for entry in entries:
        document.add("materials", entry)
    for name in extensions_of(entries):
        document.use_extension(name)
    document.add_mesh(primitives, translation, scale)
    return document


def _columns(source, positions, number, has_looks):
    """({attribute: Column of vertices}, vertex int64 [3 F] of each corner) of a material's faces."""
    from texfcodec.io.gltf.packing import Column
    from texfcodec.io.vertex_appearance import unique_corners

    scene = source.scene
    faces = scene.face_material == number
    columns = {"POSITION": Column(positions[scene.faces[faces]].reshape(-1, 3) + np.float32(0), "VEC3")}  # no -0
    if has_looks and scene.materials[number].texture >= 0:
        columns["TEXCOORD_0"] = Column(scene.corner_uv[faces].reshape(-1, 2).astype(np.float32) + np.float32(0), "VEC2")
    if has_looks and source.is_coloured:
        colour = np.clip(scene.corner_color[faces].reshape(-1, 4), 0, 1).astype(np.float64)
        columns["COLOR_0"] = Column(np.rint(colour * 65535).astype(np.uint16), "VEC4", True)
    bits = [c.values.view(np.int32) if c.values.dtype == np.float32 else c.values for c in columns.values()]
    first, corners = unique_corners(*(row for values in bits for row in values.T))
    return {name: column._replace(values=column.values[first]) for name, column in columns.items()}, corners


def _add_textures(document, source, coded):
    """Adds images, and a texture for each of the scene's that has one: {number there: number here}. Images are named by their
    size, which programs can select by."""
    images, numbers = {}, {}
    for content, (form, data) in coded.items():
        height, width = source.images[content].shape[:2]
        images[content] = document.add("images", {"name": f"{width}x{height}", "mimeType": form.mime,
                                                  "bufferView": document.add_view(data)})
        if form.extension:
            document.use_extension(form.extension, required=True)
    for number, (texture, content) in enumerate(zip(source.scene.textures, source.content, strict=True)):
        if content not in images:
            continue
        sampler = {"magFilter": 9729, "minFilter": 9987, "wrapS": WRAPS[texture.wrap[0]], "wrapT": WRAPS[texture.wrap[1]]}
        known, extension = document.json.get("samplers", []), coded[content][0].extension
        at, entry = known.index(sampler) if sampler in known else document.add("samplers", sampler), {"source": images[content]}
        entry = {"extensions": {extension: entry}} if extension else entry
        numbers[number] = document.add("textures", {"sampler": at} | entry)
    return numbers


def coded_images(source, name, quality=None):
    """Return {content: (ImageFormat, bytes)} of a Source's images. name: of IMAGE_FORMATS; quality: of its encoder."""
    from texfcodec.io.formats import IMAGE_FORMATS
    from texfcodec.io.images import encode_image

    form = IMAGE_FORMATS[name]
    return {content: (form, encode_image(image, form, quality)) for content, image in source.images.items()}


def write_document(document, path):
    """Write a Document as a GLB file."""
    from texfcodec.io.gltf.writer import glb

    Path(path).write_bytes(b"".join(glb(document)))


def checked(path, source=None, shrink=1, slack=0):
    """Load a GLB file that a program wrote, check it, and return its Scene. source: the Source it was made of, whose images must
    be there at 1 / shrink of their size, give or take slack pixels; None checks no images. Raises ValueError."""
    from texfcodec.errors import TexfError
    from texfcodec.io.load import load

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no {path.name}")
    if path.read_bytes()[:4] != b"glTF":
        raise ValueError(f"{path.name} is no GLB file")
    try:
        scene = load(path)
    except TexfError as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from error
    if source is not None:
        sizes, wanted = sorted({id(t.image): t.image.shape[1::-1] for t in scene.textures}.values()), sorted(source.sizes)
        off = np.abs(np.array(sizes) - np.array(wanted) / shrink) if len(sizes) == len(wanted) else np.inf
        if np.max(off, initial=0) > slack:
            raise ValueError(f"{path.name} has images of {sizes}, where those of {wanted} were to be divided by {shrink}")
    if not len(scene.faces):
        raise ValueError(f"{path.name} has no faces")
    return scene


def weights_of(path):
    """Return {"file", "container", "images"}: the bytes of a GLB file, of its header and JSON, and of its images."""
    data = Path(path).read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    root = json.loads(data[20 : 20 + length])
    images = sum(root["bufferViews"][image["bufferView"]]["byteLength"] for image in root.get("images", []))
    has_buffer = len(data) > 20 + length
    return {"file": len(data), "container": 20 + length + 8 * has_buffer, "images": images}


def scene_sha256(scene):
    """Return the hash_of() positions, faces, UVs and images of a Scene."""
    return hash_of(scene.positions, scene.faces, scene.corner_uv, *(t.image for t in scene.textures))


def facts_of(folder, scene):
    """Return the dict of Method.encode() for the files WHOLE and BARE in a folder. scene: as WHOLE was read.

    bytes: total is all of WHOLE; geometry is BARE, the file of the same program without images, UVs and colours, container
    included; texture is the difference: images, UVs, the vertices that seams split, and their JSON.
    """
    weights, geometry = weights_of(folder / WHOLE), weights_of(folder / BARE)["file"]
    return {"bytes": {"total": weights["file"], "geometry": geometry, "texture": weights["file"] - geometry,
                      "images": weights["images"]},
            "reconstruction_sha256": scene_sha256(scene), "container_bytes": weights["container"],
            "images": [list(t.image.shape[1::-1]) for t in scene.textures]}
