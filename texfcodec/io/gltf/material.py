"""glTF materials -> Scene materials, and back: maps and parameters of the core and of extensions by the tables of channels.py;
all other properties are named as dropped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scene.channels import BASE_COLOUR, MAPS, PARAMETERS, PBR, binary32
from ...scene.scene import ALPHA_MASK, ALPHA_NAMES, ALPHA_OPAQUE, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material
from ..colour_range import clipped
from .document import Document
from .properties import extensions, integer, malformed, name_of, numbers, part, title

if TYPE_CHECKING:
    from ...scene.channels import Channel
    from ..images import TextureShelf

WRAPS = {10497: WRAP_REPEAT, 33071: WRAP_CLAMP, 33648: WRAP_MIRROR}
_READABLE_SOURCES = ("EXT_texture_webp", "EXT_texture_avif")
UNLIT = "KHR_materials_unlit"
_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
_NEAREST = 9728
_OF_MATERIAL = ("name", PBR, "alphaMode", "alphaCutoff", "doubleSided")


@dataclass
class TextureInfo:
    """A material's reference to an image. texture: index into the file's textures; texcoord: UV set; transform: float64 [2, 3]
    applied to (u, v, 1), or None for identity."""

    texture: int
    texcoord: int = 0
    transform: np.ndarray | None = None

    def same_uv(self, other: TextureInfo) -> bool:
        """Return whether both have the same UVs."""
        if self.transform is None or other.transform is None:
            return self.texcoord == other.texcoord and self.transform is other.transform
        return self.texcoord == other.texcoord and bool(np.array_equal(self.transform, other.transform))


@dataclass
class MaterialFields:
    """The surface of a glTF material. factor: base colour, float64 [4] linear; images: TextureInfo by channel name, base colour
    among them, in the order of channels.CHANNELS; parameters: as in scene.scene.Material."""

    factor: np.ndarray
    images: dict[str, TextureInfo]
    parameters: dict[str, tuple[float, ...]]

    @property
    def leading(self) -> TextureInfo | None:
        """The image whose UVs are the material's."""
        return next(iter(self.images.values()), None)

    def others(self) -> dict[str, TextureInfo]:
        """Images with other UVs than the leading image, by channel name."""
        first = self.leading
        return {name: info for name, info in self.images.items() if first is not None and not info.same_uv(first)}


def read_material_fields(document: Document, index: int | None) -> MaterialFields:
    """Read the factor, maps and parameters of a glTF material. index: of the material, None for glTF's default."""
    if index is None:
        return MaterialFields(np.ones(4), {}, {})
    entry = document.entry("materials", index)
    glossy = part(extensions(entry), _SPECULAR_GLOSSINESS)
    images = {channel.name: _texture_info(info) for channel in (BASE_COLOUR, *MAPS) if (info := slot_of(entry, channel))}
    if "diffuseFactor" in glossy or "diffuseTexture" in glossy:
        document.notes.warn(f"material {title(entry, index)} uses {_SPECULAR_GLOSSINESS}; its diffuse becomes the base colour")
        factor = numbers(glossy, "diffuseFactor", (1.0,) * 4)
        images.pop(BASE_COLOUR.name, None)
        if glossy.get("diffuseTexture"):
            images = {BASE_COLOUR.name: _texture_info(part(glossy, "diffuseTexture")), **images}
        parameters = _parameters(entry) | {"metallic": (0.0,)}
    else:
        factor, parameters = numbers(part(entry, PBR), "baseColorFactor", (1.0,) * 4), _parameters(entry)
    return MaterialFields(np.array(factor), images, parameters)


def _part_of(entry, extension):
    """The object in a material that holds an extension's properties. extension: its name, PBR, or "" for the material itself."""
    if not extension:
        return entry
    return part(entry, PBR) if extension == PBR else part(extensions(entry), extension)


def slot_of(entry: dict, channel: Channel) -> dict:
    """The textureInfo of a channel, or {}."""
    return part(_part_of(entry, channel.extension), channel.slot)


def _parameters(entry):
    """Values of all stated parameters that differ from their default, by name."""
    values = {}
    for parameter in PARAMETERS:
        owner, key = _part_of(entry, parameter.extension), parameter.key
        if "." in key:
            owner, key = part(owner, key.partition(".")[0]), key.partition(".")[2]
        if key not in owner:
            continue
        default = parameter.default if parameter.count > 1 else parameter.default[0]
        value = numbers(owner, key, default)
        value = binary32(value if parameter.count > 1 else (value,))
        if value != parameter.default:
            values[parameter.name] = value
    return values


def _texture_info(info):
    texcoord, transform = _texture_coordinates(info)
    return TextureInfo(integer(info, "index", low=0), texcoord, transform)


def _texture_coordinates(info):
    """(UV set, transform) of a textureInfo.

    KHR_texture_transform rotates UVs counter-clockwise as seen in the image, that is with v downwards. The GLSL listing in its
    text shows the transpose, an acknowledged error (KhronosGroup/glTF issue 1563); every viewer does the same as this.
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


def read_material(document: Document, index: int | None, fields: MaterialFields, shelf: TextureShelf) -> Material:
    """Return the Material of a glTF material. index, fields: of read_material_fields(); shelf: receives its textures; messages
    name the properties that are left out."""
    if index is None:
        return Material("default")
    entry = document.entry("materials", index)
    name = f"material {title(entry, index)}"
    _drop_properties(document, entry, name)
    placed = {channel: _put_texture(document, info.texture, channel, shelf) for channel, info in fields.images.items()}
    return Material(
        name=name_of(entry),
        factor=clipped(fields.factor[None], document.notes, f"base colour factor of {name}")[0],
        texture=placed.pop(BASE_COLOUR.name, -1),
        alpha_mode=_alpha_mode(document, entry, name),
        alpha_cutoff=numbers(entry, "alphaCutoff", 0.5),
        double_sided=entry.get("doubleSided") is True,
        unlit=UNLIT in extensions(entry),
        maps={channel: texture for channel, texture in placed.items() if texture >= 0},
        parameters=fields.parameters,
    )


def _alpha_mode(document, entry, name):
    mode = entry.get("alphaMode", ALPHA_NAMES[ALPHA_OPAQUE])
    if mode not in ALPHA_NAMES:
        document.notes.lose(f"alphaMode of {name} (unknown)",
                            f"{name} has the unknown alphaMode {str(mode)[:40]!r}; OPAQUE is used instead")
        return ALPHA_OPAQUE
    return ALPHA_NAMES.index(mode)


def _put_texture(document, index, channel, shelf):
    entry = document.entry("textures", index)
    image = _source_image(entry)
    if image is None:
        what, names = channel.replace("_", " "), ", ".join(extensions(entry)) or "nothing"
        document.notes.fault("TXF-I28", f"texture {title(entry, index)} has no image in a supported format; {what} is drawn "
                                        "without it", f"texture {title(entry, index)} of {what}", value=names)
        return -1
    source = document.entry("images", image)
    uri = source.get("uri")
    fallback = uri if isinstance(uri, str) and uri[:5].lower() != "data:" else f"image {image}"
    name = name_of(source) or name_of(entry) or fallback
    wrap, nearest = _sampler(document, entry)
    return shelf.put(image, lambda: document.image_bytes(image), name, wrap, channel, nearest)


def _source_image(entry):
    """Index of the image that a texture is read from; None if all its formats are unsupported."""
    for name in _READABLE_SOURCES:
        source = part(extensions(entry), name).get("source")
        if source is not None:
            return source
    if "source" in entry:
        return entry["source"]
    basis = part(extensions(entry), "KHR_texture_basisu").get("source")  # a PNG or JPEG beside it is the better picture
    return part(extensions(entry), "MSFT_texture_dds").get("source") if basis is None else basis


def _sampler(document, entry):
    """((wrap s, wrap t), whether magnification is nearest) of a texture."""
    if "sampler" not in entry:
        return (WRAP_REPEAT, WRAP_REPEAT), False
    sampler = document.entry("samplers", entry["sampler"])
    wrap = sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)
    if not all(isinstance(mode, int) and mode in WRAPS for mode in wrap):
        raise malformed("a sampler has an unknown wrap mode", value=str(wrap)[:40])
    return (WRAPS[wrap[0]], WRAPS[wrap[1]]), sampler.get("magFilter") == _NEAREST


def _drop_properties(document, entry, name):
    """Name every property of a material that is not carried."""
    drop, kept = document.notes.drop, _kept_keys()
    tables = {"": entry, PBR: part(entry, PBR)} | {e: part(extensions(entry), e) for e in extensions(entry)}
    for extension, table in tables.items():
        if extension not in kept:
            drop(f"extension {extension} of {name}")
        for key in table:
            if extension in kept and key not in kept[extension]:
                drop(f"{extension + '.' if extension not in ('', PBR) else ''}{key} of {name}")
            elif extension not in kept and key.endswith("Texture"):
                drop(f"{extension}.{key} of {name}")


@lru_cache(maxsize=1)
def _kept_keys():
    """Keys of a material that are read, by extension, PBR, or "" for the material itself."""
    kept = {"": set(_OF_MATERIAL), PBR: {"baseColorFactor"}, UNLIT: set(),
            _SPECULAR_GLOSSINESS: {"diffuseFactor", "diffuseTexture"}}
    for parameter in PARAMETERS:
        kept.setdefault(parameter.extension, set()).add(parameter.key.partition(".")[0])
    for channel in (BASE_COLOUR, *MAPS):
        kept.setdefault(channel.extension, set()).add(channel.slot)
    return {place: keys | {"extras", "extensions"} for place, keys in kept.items()}


def write_material(material: Material, textures: dict[str, int], sets: dict[str, int] | None = None) -> dict:
    """Return a material as glTF's JSON dict. textures: index of the glTF texture by channel name, base colour among them, for
    channels that have an image; sets: number of the UV set (TEXCOORD_n) by channel name, 0 for channels that are not in it."""
    slots = {name: {"index": index} for name, index in textures.items()}
    for name in (sets or {}).keys() & slots.keys():
        slots[name]["texCoord"] = (sets or {})[name]
    out: dict[str, Any] = {PBR: {}}
    if material.name:
        out["name"] = material.name
    if any(value != 1 for value in material.factor):
        out[PBR]["baseColorFactor"] = [float(value) for value in material.factor]
    if BASE_COLOUR.name in textures:
        out[PBR]["baseColorTexture"] = slots[BASE_COLOUR.name]
    for channel in MAPS:
        if channel.name in textures:
            _write_place(out, channel.extension)[channel.slot] = slots[channel.name]
    for parameter in PARAMETERS:
        if parameter.name in material.parameters:
            _write_parameter(out, parameter, material.parameters[parameter.name])
    if material.alpha_mode != ALPHA_OPAQUE:
        out["alphaMode"] = ALPHA_NAMES[material.alpha_mode]
    if material.alpha_mode == ALPHA_MASK:
        out["alphaCutoff"] = float(material.alpha_cutoff)
    if material.double_sided:
        out["doubleSided"] = True
    if material.unlit:
        out.setdefault("extensions", {})[UNLIT] = {}
    return out


def extensions_of(entries: list[dict]) -> list[str]:
    """Return the names of the extensions that glTF materials use, in alphabetical order. entries: their JSON dicts."""
    return sorted({name for entry in entries for name in entry.get("extensions", {})})


def _write_place(out, extension):
    """Entry that _part_of() reads, in a dict under construction: absent objects are added."""
    if extension in ("", PBR):
        return out[PBR] if extension else out
    return out.setdefault("extensions", {}).setdefault(extension, {})


def _write_parameter(out, parameter, value):
    """Write a parameter to its place in glTF. Parameters of an absent texture, and values that JSON cannot hold, are left out."""
    if not all(math.isfinite(v) for v in value):
        return
    entry = [float(v) for v in value] if parameter.count > 1 else float(value[0])
    slot, _, key = parameter.key.rpartition(".")
    if not slot:
        _write_place(out, parameter.extension)[key] = entry
    elif _write_has_slot(out, parameter.extension, slot):
        _write_place(out, parameter.extension)[slot][key] = entry


def _write_has_slot(out, extension, slot):
    place = out if not extension else out.get("extensions", {}).get(extension, {})
    return slot in place
