"""glTF materials -> Scene materials: the base colour is kept, everything else is named as dropped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...errors import SupportError
from ..scene import ALPHA_BLEND, ALPHA_MASK, ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material
from .gltf_document import Document, extensions, integer, malformed, name_of, numbers, part, title

if TYPE_CHECKING:
    from .image_read import TextureShelf

_WRAPS = {10497: WRAP_REPEAT, 33071: WRAP_CLAMP, 33648: WRAP_MIRROR}
_ALPHA = {"OPAQUE": ALPHA_OPAQUE, "MASK": ALPHA_MASK, "BLEND": ALPHA_BLEND}
_READABLE_SOURCES = ("EXT_texture_webp", "EXT_texture_avif")
_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
_NEAREST = 9728
_HANDLED = {"name", "extras", "extensions", "pbrMetallicRoughness", "alphaMode", "alphaCutoff", "doubleSided"}
_DEFAULTS = {"metallicFactor": 1, "roughnessFactor": 1, "emissiveFactor": [0, 0, 0]}  # saying these says nothing
_HANDLED_PBR = {"baseColorFactor", "baseColorTexture", "extras", "extensions"}


@dataclass
class BaseColor:
    """Where one material's base colour comes from.

    factor: float64 [4] linear; texture: index into the file's textures or None; texcoord: UV set;
    transform: float64 [2, 3] applied to (u, v, 1), or None for identity.
    """

    factor: np.ndarray
    texture: int | None = None
    texcoord: int = 0
    transform: np.ndarray | None = None


def read_base_color(document: Document, index: int | None) -> BaseColor:
    """Material index (None: glTF's default material) -> BaseColor."""
    if index is None:
        return BaseColor(np.ones(4))
    entry = document.entry("materials", index)
    glossy = part(extensions(entry), _SPECULAR_GLOSSINESS)
    pbr = part(entry, "pbrMetallicRoughness")
    if "diffuseFactor" in glossy or "diffuseTexture" in glossy:
        document.notes.warn(f"material {title(entry, index)} uses {_SPECULAR_GLOSSINESS}; its diffuse becomes base colour")
        factor, info = numbers(glossy, "diffuseFactor", (1.0,) * 4), part(glossy, "diffuseTexture")
    else:
        factor, info = numbers(pbr, "baseColorFactor", (1.0,) * 4), part(pbr, "baseColorTexture")
    color = BaseColor(np.array(factor))
    if info:
        color.texture = integer(info, "index", low=0)
        color.texcoord, color.transform = _texture_coordinates(info)
    return color


def _texture_coordinates(info):
    """(UV set, transform) of a textureInfo.

    KHR_texture_transform turns UVs counter-clockwise as seen in the image, that is with v downwards; the GLSL listing
    in its text shows the transpose, an acknowledged slip (KhronosGroup/glTF issue 1563): every viewer does it as here.
    """
    transform = part(extensions(info), "KHR_texture_transform")
    texcoord = integer(info, "texCoord", 0, low=0)
    if not transform:
        return texcoord, None
    offset, angle = numbers(transform, "offset", (0.0, 0.0)), numbers(transform, "rotation", 0.0)
    scale = numbers(transform, "scale", (1.0, 1.0))
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([[cos * scale[0], sin * scale[1], offset[0]], [-sin * scale[0], cos * scale[1], offset[1]]])
    return integer(transform, "texCoord", texcoord, low=0), matrix


def read_material(document: Document, index: int | None, color: BaseColor, shelf: TextureShelf) -> Material:
    """Material index with its BaseColor -> Material; its texture is put on the shelf, its other properties are named."""
    if index is None:
        return Material("default")
    entry = document.entry("materials", index)
    name = f"material {title(entry, index)}"
    _drop_properties(document, entry, name)
    texture = -1
    if color.texture is not None:
        texture = _put_texture(document, color.texture, shelf)
    return Material(
        name=name_of(entry),
        factor=np.clip(color.factor, 0.0, 1.0),
        texture=texture,
        alpha_mode=_alpha_mode(document, entry, name),
        alpha_cutoff=numbers(entry, "alphaCutoff", 0.5),
        double_sided=entry.get("doubleSided") is True,
        unlit="KHR_materials_unlit" in extensions(entry),
    )


def _alpha_mode(document, entry, name):
    mode = entry.get("alphaMode", "OPAQUE")
    if mode not in ("OPAQUE", "MASK", "BLEND"):
        document.notes.warn(f"{name} has the unknown alphaMode {str(mode)[:40]!r}; OPAQUE takes its place")
    return _ALPHA.get(mode if isinstance(mode, str) else "", ALPHA_OPAQUE)


def _put_texture(document, index, shelf):
    entry = document.entry("textures", index)
    image = _source_image(document, entry, index)
    source = document.entry("images", image)
    uri = source.get("uri")
    fallback = uri if isinstance(uri, str) and uri[:5].lower() != "data:" else f"image {image}"
    name = name_of(source) or name_of(entry) or fallback
    wrap = _wrap(document, entry, name)
    return shelf.put(image, lambda: document.image_bytes(image), name, wrap)


def _source_image(document, entry, index):
    for name in _READABLE_SOURCES:
        source = part(extensions(entry), name).get("source")
        if source is not None:
            return source
    basis = part(extensions(entry), "KHR_texture_basisu").get("source")
    if "source" not in entry and basis is not None:  # a PNG or JPEG beside it is the better picture, and needs no package
        return basis
    if "source" not in entry:
        names = ", ".join(extensions(entry)) or "nothing"
        raise SupportError("TXF-I32", f"texture {title(entry, index)} has no PNG, JPEG, WebP, AVIF or KTX2 source", value=names)
    return entry["source"]


def _wrap(document, entry, name):
    if "sampler" not in entry:
        return WRAP_REPEAT, WRAP_REPEAT
    sampler = document.entry("samplers", entry["sampler"])
    wrap = sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)
    if not all(isinstance(mode, int) and mode in _WRAPS for mode in wrap):
        raise malformed("a sampler has an unknown wrap mode", value=str(wrap)[:40])
    if sampler.get("magFilter") == _NEAREST:
        document.notes.drop(f"NEAREST filter of texture '{name}'")
    return _WRAPS[wrap[0]], _WRAPS[wrap[1]]


def _drop_properties(document, entry, name):
    """Name every property of a material that is not coded."""
    drop = document.notes.drop
    for table, handled in ((part(entry, "pbrMetallicRoughness"), _HANDLED_PBR), (entry, _HANDLED)):
        for key, value in table.items():
            if key not in handled and _DEFAULTS.get(key) != value:
                drop(f"{key} of {name}")
    for extension in extensions(entry):
        if extension == "KHR_materials_unlit":
            continue
        handled = ("diffuseFactor", "diffuseTexture") if extension == _SPECULAR_GLOSSINESS else ()
        if extension != _SPECULAR_GLOSSINESS:
            drop(f"extension {extension} of {name}")
        for key in part(extensions(entry), extension):
            if key not in handled and (handled or key.endswith("Texture")):
                drop(f"{extension}.{key} of {name}")
