"""What a renderer has to evaluate: one table of effects (spec clause 5.3.2), read by syntax, analysis, renderer and reports."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from .channels import PARAMETER_BY_NAME

ALPHA_MASK, ALPHA_BLEND = 1, 2


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One bit of the stream's effects. used: whether a material, asset.scene.Material, needs it; channels: those whose maps it
    reads; parameters: what else it reads."""

    name: str
    bit: int
    used: Callable[[Any], bool]
    channels: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    @property
    def mask(self) -> int:
        """The bit as a number."""
        return 1 << self.bit


def parameter(material: Any, name: str) -> tuple[float, ...]:
    """A material's parameter, or its default."""
    return material.parameters.get(name, PARAMETER_BY_NAME[name].default)


def _above_zero(name):
    return lambda m: not m.unlit and max(parameter(m, name)) > 0


def _mapped(name, scale):
    return lambda m: not m.unlit and name in m.maps and parameter(m, scale) != (0.0,)


def _set(*names):
    return lambda m: not m.unlit and any(name in m.parameters for name in names)


def _with(first, second):
    return lambda m: first(m) and second(m)


_CLEARCOAT, _THICK = _above_zero("clearcoat"), _above_zero("thickness")
EFFECTS = tuple(Effect(bit=bit, **row) for bit, row in enumerate((
    {"name": "lit", "used": lambda m: not m.unlit, "channels": ("roughness",), "parameters": ("roughness",)},
    {"name": "mask", "used": lambda m: m.alpha_mode == ALPHA_MASK},
    {"name": "blend", "used": lambda m: m.alpha_mode == ALPHA_BLEND},
    {"name": "double_sided", "used": lambda m: m.double_sided},
    {"name": "metal", "used": _above_zero("metallic"), "channels": ("metallic",), "parameters": ("metallic",)},
    {"name": "normal_map", "used": _mapped("normal", "normal_scale"), "channels": ("normal",), "parameters": ("normal_scale",)},
    {"name": "occlusion", "used": _mapped("occlusion", "occlusion_strength"), "channels": ("occlusion",),
     "parameters": ("occlusion_strength",)},
    {"name": "emission", "used": _with(_above_zero("emissive"), _above_zero("emissive_strength")), "channels": ("emissive",),
     "parameters": ("emissive", "emissive_strength")},
    {"name": "clearcoat", "used": _CLEARCOAT, "channels": ("clearcoat", "clearcoat_roughness"),
     "parameters": ("clearcoat", "clearcoat_roughness")},
    {"name": "clearcoat_normal_map", "used": _with(_CLEARCOAT, _mapped("clearcoat_normal", "clearcoat_normal_scale")),
     "channels": ("clearcoat_normal",), "parameters": ("clearcoat_normal_scale",)},
    {"name": "sheen", "used": _above_zero("sheen_colour"), "channels": ("sheen_colour", "sheen_roughness"),
     "parameters": ("sheen_colour", "sheen_roughness")},
    {"name": "specular", "used": lambda m: not m.unlit and bool({"specular", "specular_colour"} & {*m.parameters, *m.maps}),
     "channels": ("specular", "specular_colour"), "parameters": ("specular", "specular_colour")},
    {"name": "transmission", "used": _above_zero("transmission"), "channels": ("transmission",),
     "parameters": ("transmission",)},
    {"name": "volume", "used": _THICK, "channels": ("thickness",),
     "parameters": ("thickness", "attenuation_distance", "attenuation_colour")},
    {"name": "iridescence", "used": _above_zero("iridescence"), "channels": ("iridescence", "iridescence_thickness"),
     "parameters": ("iridescence", "iridescence_ior", "iridescence_thickness_minimum", "iridescence_thickness_maximum")},
    {"name": "anisotropy", "used": _above_zero("anisotropy"), "channels": ("anisotropy",),
     "parameters": ("anisotropy", "anisotropy_rotation")},
    {"name": "diffuse_transmission", "used": _above_zero("diffuse_transmission"),
     "channels": ("diffuse_transmission", "diffuse_transmission_colour"),
     "parameters": ("diffuse_transmission", "diffuse_transmission_colour")},
    {"name": "dispersion", "used": _with(_THICK, _above_zero("dispersion")), "parameters": ("dispersion",)},
    {"name": "ior", "used": _set("ior"), "parameters": ("ior",)},
)))
BY_NAME = {effect.name: effect for effect in EFFECTS}
EFFECT_OF = {name: effect for effect in EFFECTS for name in effect.channels}  # by channel


def effects_of(material: Any) -> tuple[Effect, ...]:
    """What a material, asset.scene.Material, needs."""
    return tuple(effect for effect in EFFECTS if effect.used(material))


def effects_mask(materials: Iterable[Any]) -> int:
    """The bits of all that materials need together."""
    mask = 0
    for material in materials:
        for effect in effects_of(material):
            mask |= effect.mask
    return mask


def in_words(mask: int) -> list[str]:
    """Names of the effects whose bits are set."""
    return [effect.name for effect in EFFECTS if mask & effect.mask]
