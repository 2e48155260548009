"""GLB that the page gets of a mesh: the file itself if GLTFLoader of three.js reads it, else a GLB of the Scene that was
loaded."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..io.gltf.material import extensions_of, write_material
from ..io.gltf.packing import ARRAY, INDEX
from ..io.gltf.writer import WRAP_CODES, Document, glb
from ..io.vertex_appearance import unique_corners
from ..render.lit_scene import SceneMaps
from ..scene.channels import BASE_COLOUR, BY_NAME
from ..scene.scene import Scene

MAGIC, JSON_CHUNK = b"glTF", 0x4E4F534A
# What GLTFLoader needs a decoder for that the page does not have, and what it no longer reads.
NOT_READ = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_texture_basisu",
            "MSFT_texture_dds", "KHR_materials_pbrSpecularGlossiness"}
SHARED = ("roughness", "metallic")  # channels of one image in glTF
NOT_SQUARES, SQUARES = (9729, 9987), (9728, 9728)  # filters of a sampler


def glb_of_asset(path: str, scene: Scene) -> bytes:
    """Return the bytes of a GLB of a mesh for the page: the file at path if three.js reads it as it is, else the Scene as a
    GLB."""
    own = Path(path).read_bytes() if path.lower().endswith(".glb") else b""
    return own if is_read(own) else glb_of_scene(scene)


def is_read(data: bytes) -> bool:
    """Return whether GLTFLoader of three.js reads these bytes as they are: a GLB that refers to no other file and uses no
    extension in NOT_READ."""
    try:
        magic, version, _, length, kind = struct.unpack_from("<4sIIII", data)
        document = json.loads(data[20 : 20 + length])
        named = [*document.get("buffers", ()), *document.get("images", ())]
        used = {*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())}
        return ((magic, version, kind) == (MAGIC, 2, JSON_CHUNK) and not used & NOT_READ
                and all(str(entry.get("uri", "data:"))[:5].lower() == "data:" for entry in named))
    except (struct.error, ValueError, TypeError, AttributeError):
        return False


def glb_of_scene(scene: Scene) -> bytes:
    """Return the bytes of a GLB of a Scene: each map with its own UVs, images as PNG, warnings in asset.extras.texf."""
    document = Document({"warnings": list(scene.warnings)})
    sets, textures = uv_sets(scene), list(scene.textures)
    entries = [_entry(scene, material, sets, textures) for material in scene.materials]
    for texture in textures:
        _add_texture(document, texture)
    for entry in entries:
        document.add("materials", entry)
    for name in extensions_of(entries):
        document.use_extension(name)
    if len(scene.faces):
        _add_mesh(document, scene, sets)
    return b"".join(glb(document))


def uv_sets(scene: Scene) -> list[np.ndarray]:
    """Return the distinct UV sets that the maps of a Scene use, float64 [F, 3, 2] each, that of base colour first."""
    sets = [scene.corner_uv]
    for uv in scene.map_uv.values():
        if not any(uv is other for other in sets):
            sets.append(uv)
    return sets


def _entry(scene, material, sets, textures):
    """The glTF material; a map with other UVs than the first names its set. textures: those of the Scene; gets an image that
    roughness and metallic share, if they have not one."""
    placed = {name: number for name, number in ({BASE_COLOUR.name: material.texture} | material.maps).items() if number >= 0}
    shared = {placed.get(name) for name in SHARED}
    if len(shared) > 1:
        placed |= {name: len(textures) for name in SHARED if name in placed}
        textures.append(_merged(scene, {name: material.maps[name] for name in SHARED if name in placed}))
    own = {name: next(i for i, uv in enumerate(sets) if uv is scene.map_uv.get(name, scene.corner_uv)) for name in placed}
    return write_material(material, placed, {name: number for name, number in own.items() if number})


def _merged(scene, maps):
    """A Texture with the columns of each channel of maps {name: number}, as large as the first; 255 elsewhere."""
    first = scene.textures[next(iter(maps.values()))]
    image = np.full_like(first.image, 255)
    height, width = image.shape[:2]
    for name, number in maps.items():
        other, columns = scene.textures[number].image, list(BY_NAME[name].columns)
        rows, places = np.arange(height) * len(other) // height, np.arange(width) * other.shape[1] // width
        image[..., columns] = other[rows[:, None], places][..., columns]
    return replace(first, image=image)


def _add_texture(document, texture):
    """An image as PNG, with its sampler."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(texture.image).save(file, "png", compress_level=6)
    magnified, minified = SQUARES if texture.nearest else NOT_SQUARES
    sampler = {"magFilter": magnified, "minFilter": minified, "wrapS": WRAP_CODES[texture.wrap[0]],
               "wrapT": WRAP_CODES[texture.wrap[1]]}
    image = {"name": texture.name, "mimeType": "image/png", "bufferView": document.add_view(file.getvalue())}
    document.add("textures", {"sampler": document.add("samplers", sampler), "source": document.add("images", image)})


def _add_mesh(document, scene, sets):
    """A primitive for each material, placed about the middle of the mesh so that float32 holds its details."""
    middle = (scene.positions.min(axis=0) + scene.positions.max(axis=0)) / 2
    positions = (scene.positions - middle).astype(np.float32)
    primitives, normals = [], SceneMaps(scene).corner_normal
    for number in np.unique(scene.face_material):
        chosen = scene.face_material == number
        columns = _columns(scene, sets, normals, chosen)
        corner = scene.faces[chosen].ravel()
        keys = (np.ascontiguousarray(column).view(np.int32).T for column in columns.values())
        first, index = unique_corners(corner, *(row for key in keys for row in key))
        attributes = {"POSITION": document.add_accessor(positions[corner[first]], "VEC3", ARRAY, bounds=True)}
        attributes |= {name: document.add_accessor(column[first], f"VEC{column.shape[1]}", ARRAY)
                       for name, column in columns.items()}
        indices = document.add_accessor(index.astype(np.uint32), "SCALAR", INDEX)
        primitives.append({"attributes": attributes, "indices": indices, "material": int(number)})
    document.add_mesh(primitives, middle.tolist(), None)


def _columns(scene, sets, normals, chosen):
    """Attributes of the corners of chosen faces by name, float32 [3 F, k]."""
    flat = lambda rows, size: np.nan_to_num(rows[chosen].reshape(-1, size), nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    columns = {f"TEXCOORD_{number}": flat(uv, 2) for number, uv in enumerate(sets)} | {"NORMAL": flat(normals, 3)}
    if scene.corner_tangent is not None and scene.corner_tangent[chosen].any(axis=2).all():
        columns["TANGENT"] = flat(scene.corner_tangent, 4)
    if scene.corner_color is not None:
        columns["COLOR_0"] = flat(scene.corner_color, 4)
    return columns
