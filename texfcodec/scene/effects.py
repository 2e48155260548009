"""Material effects that a renderer evaluates: one table (docs/design/materials.md), which syntax, analysis and renderer read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .channels import PARAMETER_BY_NAME

if TYPE_CHECKING:
    from .scene import Material

ALPHA_MASK, ALPHA_BLEND = 1, 2


@dataclass(frozen=True)
class Condition:
    """A condition on a material: text for the documents, and code."""

    text: str
    holds: Callable[[Material], bool]

    def __call__(self, material: Material) -> bool:
        """Return whether the material fulfils it."""
        return self.holds(material)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A shading effect that materials may need, such as clearcoat.

    Attributes
    ----------
    bit : int
        Number of its bit in a mask.
    name : str
        Its name in this package.
    used : function (Material) -> bool
        Whether a material needs it.
    channels, parameters : tuple of str
        Channels whose maps it reads; parameters that it reads.
    """

    name: str
    bit: int
    used: Condition
    channels: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    @property
    def mask(self) -> int:
        """The bit as a number."""
        return 1 << self.bit


def parameter(material: Material, name: str) -> tuple[float, ...]:
    """Return a material's parameter, or its default.

    Parameters
    ----------
    material : Material
        Holds the parameters that are not the default.
    name : str
        Of a row of channels.PARAMETERS.

    Returns
    -------
    tuple of float
        Its components.
    """
    return material.parameters.get(name, PARAMETER_BY_NAME[name].default)


_LIT = Condition("not unlit", lambda m: not m.unlit)


def _above_zero(name):
    several = "a value of " if PARAMETER_BY_NAME[name].count > 1 else ""
    return Condition(f"{several}{name} > 0", lambda m: max(parameter(m, name)) > 0)


def _mapped(name, scale):
    return Condition(f"{name} is named, {scale} is not 0", lambda m: name in m.maps and parameter(m, scale) != (0.0,))


def _given(*names, maps=()):
    there = lambda m: any(name in m.parameters for name in names) or any(name in m.maps for name in maps)
    named = "" if not maps else f", or {' or '.join(maps)} is named"
    return Condition(f"{' or '.join(names)} is there{named}", there)


def _all(*conditions):
    return Condition("; ".join(c.text for c in conditions), lambda m: all(c(m) for c in conditions))


_MASK = Condition("alpha_mode is 1", lambda m: m.alpha_mode == ALPHA_MASK)
_BLEND = Condition("alpha_mode is 2", lambda m: m.alpha_mode == ALPHA_BLEND)
_DOUBLE_SIDED = Condition("double-sided", lambda m: m.double_sided)
_CLEARCOAT, _THICK = _all(_LIT, _above_zero("clearcoat")), _all(_LIT, _above_zero("thickness"))
EFFECTS = tuple(Effect(bit=bit, **row) for bit, row in enumerate((
    {"name": "lit", "used": _LIT, "channels": ("roughness",), "parameters": ("roughness",)},
    {"name": "mask", "used": _MASK},
    {"name": "blend", "used": _BLEND},
    {"name": "double_sided", "used": _DOUBLE_SIDED},
    {"name": "metal", "used": _all(_LIT, _above_zero("metallic")), "channels": ("metallic",), "parameters": ("metallic",)},
    {"name": "normal_map", "used": _all(_LIT, _mapped("normal", "normal_scale")), "channels": ("normal",),
     "parameters": ("normal_scale",)},
    {"name": "occlusion", "used": _all(_LIT, _mapped("occlusion", "occlusion_strength")), "channels": ("occlusion",),
     "parameters": ("occlusion_strength",)},
    {"name": "emission", "used": _all(_LIT, _above_zero("emissive"), _above_zero("emissive_strength")),
     "channels": ("emissive",), "parameters": ("emissive", "emissive_strength")},
    {"name": "clearcoat", "used": _CLEARCOAT, "channels": ("clearcoat", "clearcoat_roughness"),
     "parameters": ("clearcoat", "clearcoat_roughness")},
    {"name": "clearcoat_normal_map", "used": _all(_CLEARCOAT, _mapped("clearcoat_normal", "clearcoat_normal_scale")),
     "channels": ("clearcoat_normal",), "parameters": ("clearcoat_normal_scale",)},
    {"name": "sheen", "used": _all(_LIT, _above_zero("sheen_colour")), "channels": ("sheen_colour", "sheen_roughness"),
     "parameters": ("sheen_colour", "sheen_roughness")},
    {"name": "specular", "used": _all(_LIT, _given("specular", "specular_colour", maps=("specular", "specular_colour"))),
     "channels": ("specular", "specular_colour"), "parameters": ("specular", "specular_colour")},
    {"name": "transmission", "used": _all(_LIT, _above_zero("transmission")), "channels": ("transmission",),
     "parameters": ("transmission",)},
    {"name": "volume", "used": _THICK, "channels": ("thickness",),
     "parameters": ("thickness", "attenuation_distance", "attenuation_colour")},
    {"name": "iridescence", "used": _all(_LIT, _above_zero("iridescence")), "channels": ("iridescence", "iridescence_thickness"),
     "parameters": ("iridescence", "iridescence_ior", "iridescence_thickness_minimum", "iridescence_thickness_maximum")},
    {"name": "anisotropy", "used": _all(_LIT, _above_zero("anisotropy")), "channels": ("anisotropy",),
     "parameters": ("anisotropy", "anisotropy_rotation")},
    {"name": "diffuse_transmission", "used": _all(_LIT, _above_zero("diffuse_transmission")),
     "channels": ("diffuse_transmission", "diffuse_transmission_colour"),
     "parameters": ("diffuse_transmission", "diffuse_transmission_colour")},
    {"name": "dispersion", "used": _all(_THICK, _above_zero("dispersion")), "parameters": ("dispersion",)},
    {"name": "ior", "used": _all(_LIT, _given("ior")), "parameters": ("ior",)},
)))
BY_NAME = {effect.name: effect for effect in EFFECTS}
EFFECT_OF = {name: effect for effect in EFFECTS for name in effect.channels}  # by channel


def effects_of(material: Material) -> tuple[Effect, ...]:
    """Return the shading effects that a material needs.

    Parameters
    ----------
    material : Material
        Its maps, parameters and alpha mode decide.

    Returns
    -------
    tuple of Effect
        In the order of the table.
    """
    return tuple(effect for effect in EFFECTS if effect.used(material))


def without(material: Material, effect: Effect) -> Material:
    """Return a copy of a material without the maps and parameters that an effect reads.

    Parameters
    ----------
    material : Material
        Stays as it is.
    effect : Effect
        The effect to take out.

    Returns
    -------
    Material
        The copy. If the effect is metal, its metallic factor is an explicit 0, because glTF's default is all metal.
    """
    maps = {name: texture for name, texture in material.maps.items() if name not in effect.channels}
    parameters = {name: value for name, value in material.parameters.items() if name not in effect.parameters}
    bare = replace(material, maps=maps, parameters=parameters)
    if "metallic" in effect.parameters and effect.used(bare):
        bare.parameters["metallic"] = (0.0,)
    return bare


def effects_mask(materials: Iterable[Material]) -> int:
    """Return the effects that any of the materials needs, as a bit mask.

    Parameters
    ----------
    materials : iterable of Material
        Any number.

    Returns
    -------
    int
        The bitwise or of Effect.mask.
    """
    mask = 0
    for material in materials:
        for effect in effects_of(material):
            mask |= effect.mask
    return mask


def in_words(mask: int) -> list[str]:
    """Return the names of the effects whose bits are set in a mask.

    Parameters
    ----------
    mask : int
        As of effects_mask().

    Returns
    -------
    list of str
        In the order of the table.
    """
    return [effect.name for effect in EFFECTS if mask & effect.mask]
