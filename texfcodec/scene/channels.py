"""Meanings of coded values: one table of channels (spec clause 5.3.1) and one of parameters (5.4.2), read by loader, analysis,
transfer, syntax, codecs, fields, renderer and writers."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .scene import ALPHA_OPAQUE

COLUMNS = 4  # of what a surface point answers when its colour is asked: red, green, blue, alpha
FULL = 255  # what a column holds that no channel gives
LARGEST = float(np.finfo(np.float32).max)  # finite parameter
PBR, TEXTURE_INFOS = "pbrMetallicRoughness", ("normalTexture", "occlusionTexture", "emissiveTexture")


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One or a few numbers that a material has for its whole surface (clause 5.4.2).

    Attributes
    ----------
    name, number : str, int
        Its name in this package, and its number in the stream.
    extension, key : str
        Its place in glTF; "" for the material itself.
    default : tuple of float
        glTF's value if it is absent, in binary32.
    """

    name: str
    number: int
    extension: str
    key: str
    default: tuple[float, ...]

    @property
    def count(self) -> int:
        """Number of components."""
        return len(self.default)


def binary32(values: Iterable[float]) -> tuple[float, ...]:
    """Round numbers to binary32 (IEEE single precision), in which a stream holds them.

    Parameters
    ----------
    values : sequence of float
        Any numbers.

    Returns
    -------
    tuple of float
        The rounded numbers. Finite numbers beyond the range become the largest number in it; NaN and infinity are kept.
    """
    return tuple(float(np.float32(v if math.isinf(v) else min(max(v, -LARGEST), LARGEST))) for v in values)


def _parameters(*rows):
    return tuple(Parameter(name=name, number=number, extension=extension, key=key, default=binary32(default))
                 for number, (name, extension, key, default) in enumerate(rows))


_CLEARCOAT, _SHEEN, _SPECULAR = "KHR_materials_clearcoat", "KHR_materials_sheen", "KHR_materials_specular"
_TRANSMISSION, _VOLUME, _IRIDESCENCE = "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_iridescence"
_ANISOTROPY, _DIFFUSE = "KHR_materials_anisotropy", "KHR_materials_diffuse_transmission"
ONE, BLACK, WHITE = (1.0,), (0.0,) * 3, (1.0,) * 3
ZERO = (0.0,)
PARAMETERS = _parameters(
    ("normal_scale", "", "normalTexture.scale", ONE),
    ("occlusion_strength", "", "occlusionTexture.strength", ONE),
    ("roughness", PBR, "roughnessFactor", ONE),
    ("metallic", PBR, "metallicFactor", ONE),
    ("emissive", "", "emissiveFactor", BLACK),
    ("emissive_strength", "KHR_materials_emissive_strength", "emissiveStrength", ONE),
    ("clearcoat", _CLEARCOAT, "clearcoatFactor", ZERO),
    ("clearcoat_roughness", _CLEARCOAT, "clearcoatRoughnessFactor", ZERO),
    ("clearcoat_normal_scale", _CLEARCOAT, "clearcoatNormalTexture.scale", ONE),
    ("sheen_colour", _SHEEN, "sheenColorFactor", BLACK),
    ("sheen_roughness", _SHEEN, "sheenRoughnessFactor", ZERO),
    ("specular", _SPECULAR, "specularFactor", ONE),
    ("specular_colour", _SPECULAR, "specularColorFactor", WHITE),
    ("transmission", _TRANSMISSION, "transmissionFactor", ZERO),
    ("thickness", _VOLUME, "thicknessFactor", ZERO),
    ("attenuation_distance", _VOLUME, "attenuationDistance", (math.inf,)),
    ("attenuation_colour", _VOLUME, "attenuationColor", WHITE),
    ("iridescence", _IRIDESCENCE, "iridescenceFactor", ZERO),
    ("iridescence_ior", _IRIDESCENCE, "iridescenceIor", (1.3,)),
    ("iridescence_thickness_minimum", _IRIDESCENCE, "iridescenceThicknessMinimum", (100.0,)),
    ("iridescence_thickness_maximum", _IRIDESCENCE, "iridescenceThicknessMaximum", (400.0,)),
    ("anisotropy", _ANISOTROPY, "anisotropyStrength", ZERO),
    ("anisotropy_rotation", _ANISOTROPY, "anisotropyRotation", ZERO),
    ("diffuse_transmission", _DIFFUSE, "diffuseTransmissionFactor", ZERO),
    ("diffuse_transmission_colour", _DIFFUSE, "diffuseTransmissionColorFactor", WHITE),
    ("ior", "KHR_materials_ior", "ior", (1.5,)),
    ("dispersion", "KHR_materials_dispersion", "dispersion", ZERO),
)
PARAMETER_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}
EXTENSIONS = frozenset(parameter.extension for parameter in PARAMETERS) - {"", PBR}


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One quantity that a field or a material's map has values of, such as base colour or roughness.

    Attributes
    ----------
    name : str
        Its name in this package.
    semantic, components : int
        As in the stream's channel groups.
    srgb : bool
        Whether values are sRGB-coded colour.
    extension, slot : str
        The glTF texture of the channel.
    columns : tuple of int
        Its components in that image, 0..3 for red, green, blue and alpha.
    parameter : str
        The factor of its values; "" if the factor is in the values (base colour) or there is none.
    unit : str
        Of its error, "dB" or "degrees".
    over : str
        "texels" or "voxels" if the values are defined on this support alone, "" for both.
    weight : float
        Effect of a squared error of its values on a shaded picture, as a multiple of the effect in base colour
        (docs/design/materials.md).
    """

    name: str
    semantic: int
    components: int
    srgb: bool = False
    extension: str = ""
    slot: str
    columns: tuple[int, ...]
    parameter: str = ""
    unit: str = "dB"
    over: str = ""
    weight: float = 1.0

    @property
    def material_name(self) -> str:
        """The channel's name in a material, which is the same for both supports."""
        return self.name.removesuffix(_OBJECT)


_OBJECT = "_object"  # ending of the names of channels over voxels that stand for a tangent-space one
_RED, _GREEN, _BLUE, _ALPHA, _RGB = (0,), (1,), (2,), (3,), (0, 1, 2)


def _colour(semantic: int, name: str, extension: str, slot: str, parameter: str = "", weight: float = 1.0) -> Channel:
    return Channel(semantic=semantic, name=name, components=3, srgb=True, extension=extension, slot=slot, columns=_RGB,
                   parameter=parameter, weight=weight)


def _scalar(semantic: int, name: str, extension: str, slot: str, columns: tuple[int, ...], weight: float = 1.0,
            parameter: str | None = None) -> Channel:
    """A channel of one component; its parameter has its name unless another is given."""
    return Channel(semantic=semantic, name=name, components=1, extension=extension, slot=slot, columns=columns,
                   parameter=name if parameter is None else parameter, weight=weight)


def _normal(semantic: int, name: str, extension: str, slot: str, over: str, weight: float) -> Channel:
    """A channel of normals; over voxels the parameter is in the values."""
    planar = over == "texels"
    return Channel(semantic=semantic, name=name if planar else name + _OBJECT, components=2 if planar else 3, extension=extension,
                   slot=slot, columns=_RGB[:2] if planar else _RGB, parameter=f"{name}_scale" if planar else "", unit="degrees",
                   over=over, weight=weight)


CHANNELS = (
    _colour(0, "base_colour", PBR, "baseColorTexture"),
    _scalar(1, "alpha", PBR, "baseColorTexture", _ALPHA, parameter=""),
    _normal(2, "normal", "", "normalTexture", "texels", 6.5),
    _normal(3, "normal", "", "normalTexture", "voxels", 4.3),
    _scalar(4, "occlusion", "", "occlusionTexture", _RED, 0.06, parameter="occlusion_strength"),
    _scalar(5, "roughness", PBR, "metallicRoughnessTexture", _GREEN, 0.1),
    _scalar(6, "metallic", PBR, "metallicRoughnessTexture", _BLUE, 0.03),
    _colour(7, "emissive", "", "emissiveTexture", "emissive", 0.35),
    _scalar(8, "clearcoat", _CLEARCOAT, "clearcoatTexture", _RED, 0.1),
    _scalar(9, "clearcoat_roughness", _CLEARCOAT, "clearcoatRoughnessTexture", _GREEN, 0.1),
    _normal(10, "clearcoat_normal", _CLEARCOAT, "clearcoatNormalTexture", "texels", 2.0),
    _normal(11, "clearcoat_normal", _CLEARCOAT, "clearcoatNormalTexture", "voxels", 1.3),
    _colour(12, "sheen_colour", _SHEEN, "sheenColorTexture", "sheen_colour", 0.08),
    _scalar(13, "sheen_roughness", _SHEEN, "sheenRoughnessTexture", _ALPHA, 0.015),
    _scalar(14, "specular", _SPECULAR, "specularTexture", _ALPHA, 0.1),
    _colour(15, "specular_colour", _SPECULAR, "specularColorTexture", "specular_colour", 0.1),
    _scalar(16, "transmission", _TRANSMISSION, "transmissionTexture", _RED, 0.3),
    _scalar(17, "thickness", _VOLUME, "thicknessTexture", _GREEN, 0.03),
    _scalar(18, "iridescence", _IRIDESCENCE, "iridescenceTexture", _RED, 0.1),
    _scalar(19, "iridescence_thickness", _IRIDESCENCE, "iridescenceThicknessTexture", _GREEN, 0.1, parameter=""),
    Channel(semantic=20, name="anisotropy", components=3, extension=_ANISOTROPY, slot="anisotropyTexture", columns=_RGB,
            parameter="anisotropy", weight=0.1),
    _scalar(21, "diffuse_transmission", _DIFFUSE, "diffuseTransmissionTexture", _ALPHA, 0.2),
    _colour(22, "diffuse_transmission_colour", _DIFFUSE, "diffuseTransmissionColorTexture", "diffuse_transmission_colour",
            0.3),
)
BY_NAME = {channel.name: channel for channel in CHANNELS}
BASE_COLOUR, ALPHA = CHANNELS[:2]
COLOURS = (BASE_COLOUR, ALPHA)  # what every material has, its factor in the values
MAPS = tuple(channel for channel in CHANNELS[2:] if not channel.name.endswith(_OBJECT))  # what a material may have a map of
MAP_NAMES = frozenset(channel.name for channel in MAPS)
NORMAL_MAPS = frozenset(channel.name for channel in MAPS if channel.unit == "degrees")
CORNER_MAPS = MAP_NAMES - NORMAL_MAPS - {"anisotropy"}  # what may be given at face corners; directions need UVs


# Channels that share an image in glTF; a component of it that no channel fills is 255
PACKED_IMAGES = (("base_colour", "alpha"), ("occlusion", "roughness", "metallic"), ("normal",), ("emissive",),
                 ("clearcoat", "clearcoat_roughness"), ("clearcoat_normal",), ("sheen_colour", "sheen_roughness"),
                 ("specular_colour", "specular"), ("transmission", "thickness"), ("iridescence", "iridescence_thickness"),
                 ("anisotropy",), ("diffuse_transmission_colour", "diffuse_transmission"))


def channel_over(name: str, planar: bool) -> Channel:
    """Return the channel under which a field stores a material's channel; it differs for normals over voxels.

    Parameters
    ----------
    name : str
        The channel's name in a material.
    planar : bool
        Whether the field is over texels, not voxels.

    Returns
    -------
    Channel
        An entry of the table.
    """
    channel = BY_NAME[name]
    return BY_NAME[name + _OBJECT] if channel.over == "texels" and not planar else channel


def channels_of(groups: Iterable[dict]) -> tuple[tuple[Channel, ...], ...]:
    """Return the channels that each of a stream's channel groups codes together.

    Parameters
    ----------
    groups : list of dict
        Syntax elements of each group by name, already checked.

    Returns
    -------
    tuple of tuple of Channel
        A tuple for each group.
    """
    return tuple(tuple(CHANNELS[semantic] for semantic in group["group_semantics"]) for group in groups)


def group_values(channels: Sequence[Channel], grey: bool = False) -> dict:
    """Return the syntax elements that describe a channel group in a stream (5.3.1).

    Parameters
    ----------
    channels : sequence of Channel
        The group's channels.
    grey : bool
        Whether one component stands for all components of its only channel.

    Returns
    -------
    dict
        Values of the syntax elements by name.
    """
    components = 1 if grey else sum(channel.components for channel in channels)
    return {"num_semantics": len(channels), "group_semantics": [channel.semantic for channel in channels],
            "group_components": components}


def needs_alpha(materials: Iterable) -> bool:
    """Return whether any material uses alpha.

    Parameters
    ----------
    materials : iterable of Material
        The materials that faces have.

    Returns
    -------
    bool
        True if any is masked or blended.
    """
    return any(material.alpha_mode != ALPHA_OPAQUE for material in materials)


def join_planes(planes: dict, count: int) -> np.ndarray:
    """Join the planes of base colour and alpha to RGBA.

    Parameters
    ----------
    planes : dict of str to uint8 [count, C]
        Values of each channel by its name; other channels are ignored.
    count : int
        Number of values of each plane.

    Returns
    -------
    uint8 [count, 4]
        RGBA; columns without a plane are FULL.
    """
    out = np.full((count, COLUMNS), FULL, np.uint8)
    for channel in COLOURS:
        if channel.name in planes:
            out[:, list(channel.columns)] = planes[channel.name]
    return out
