"""Which terms of the shading a material uses, decided by its parameters and maps, and what each of them asks for: one table."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

LARGEST = 65504.0  # of any parameter; what is beyond counts as this
TURN = "anisotropy_rotation"  # the one parameter that may be negative
# Parameters of a material by name, as glTF leaves them where a file says nothing.
DEFAULTS: dict[str, tuple[float, ...]] = {
    "roughness": (1,), "metallic": (1,), "occlusion_strength": (1,), "emissive": (0, 0, 0), "emissive_strength": (1,),
    "ior": (1.5,), "specular": (1,), "specular_colour": (1, 1, 1), "clearcoat": (0,), "clearcoat_roughness": (0,),
    "sheen_colour": (0, 0, 0), "sheen_roughness": (0,), "transmission": (0,), "thickness": (0,), "dispersion": (0,),
    "attenuation_distance": (math.inf,), "attenuation_colour": (1, 1, 1), "iridescence": (0,), "iridescence_ior": (1.3,),
    "iridescence_thickness": (100, 400), "anisotropy": (0,), TURN: (0,), "diffuse_transmission": (0,),
    "diffuse_transmission_colour": (1, 1, 1),
}
CONSTANTS = {"base_colour": (1.0, 1.0, 1.0), "occlusion": (1.0,), "iridescence_thickness": (1.0,)}  # of channels without a factor


@dataclass(frozen=True, kw_only=True)
class Effect:
    """channels: what it reads beyond base_colour, metallic and roughness; used: function of a material's parameters (all of them)
    and the names of the channels that it has maps of."""

    name: str
    channels: tuple[str, ...]
    used: Callable[[Mapping, Collection], bool]


def _any(*names):
    return lambda p, channels: any(value > 0 for name in names for value in p[name])


EFFECTS = (
    Effect(name="occlusion", channels=("occlusion",),
           used=lambda p, channels: "occlusion" in channels and p["occlusion_strength"][0] > 0),
    Effect(name="emission", channels=("emissive",),
           used=lambda p, channels: max(p["emissive"]) > 0 and p["emissive_strength"][0] > 0),
    Effect(name="specular", channels=("specular", "specular_colour"),
           used=lambda p, channels: any(p[n] != DEFAULTS[n] for n in ("ior", "specular", "specular_colour"))
           or not {"specular", "specular_colour"}.isdisjoint(channels)),
    Effect(name="clearcoat", channels=("clearcoat", "clearcoat_roughness", "clearcoat_normal"), used=_any("clearcoat")),
    Effect(name="sheen", channels=("sheen_colour", "sheen_roughness"), used=_any("sheen_colour")),
    Effect(name="transmission", channels=("transmission",), used=_any("transmission")),
    Effect(name="volume", channels=("thickness",),
           used=lambda p, channels: p["thickness"][0] > 0 and (p["transmission"][0] > 0 or p["diffuse_transmission"][0] > 0)),
    Effect(name="dispersion", channels=(),
           used=lambda p, channels: min(p["dispersion"] + p["thickness"] + p["transmission"]) > 0),
    Effect(name="iridescence", channels=("iridescence", "iridescence_thickness"), used=_any("iridescence")),
    Effect(name="anisotropy", channels=("anisotropy",), used=_any("anisotropy")),
    Effect(name="diffuse_transmission", channels=("diffuse_transmission", "diffuse_transmission_colour"),
           used=_any("diffuse_transmission")),
)
UNLIT = frozenset({"unlit"})  # alone: an unlit material uses nothing else


def full_parameters(parameters: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """Every parameter of a material, from those that differ from DEFAULTS; one with a value that is not a number, or of another
    length, counts as the default, negative ones as 0 (rotation excepted), values above LARGEST as LARGEST (distance excepted)."""
    out = dict(DEFAULTS)
    for name, default in DEFAULTS.items():
        given = tuple(float(value) for value in parameters.get(name, default))
        if len(given) == len(default) and not any(math.isnan(value) for value in given):
            low, high = (-LARGEST if name == TURN else 0.0), (math.inf if default == (math.inf,) else LARGEST)
            out[name] = tuple(min(max(value, low), high) for value in given)
    return out


def effects_of(parameters: Mapping[str, Sequence[float]], channels: Collection[str] = (), unlit: bool = False) -> frozenset[str]:
    """Names of the effects that a material uses. parameters: those that differ from the default; channels: names of its maps."""
    if unlit:
        return UNLIT
    full = full_parameters(parameters)
    return frozenset(effect.name for effect in EFFECTS if effect.used(full, channels))


@dataclass(kw_only=True)
class ShadingTable:
    """What shading asks of materials. parameters: of each one, those that differ from DEFAULTS; channels: names of the channels
    that each has maps of; unlit: bool each. Made from these: effects, one frozenset each; values: parameter -> float32 [K, C]."""

    parameters: Sequence[Mapping[str, Sequence[float]]]
    channels: Sequence[Collection[str]]
    unlit: Sequence[bool]
    effects: list[frozenset[str]] = field(init=False)
    values: dict[str, np.ndarray] = field(init=False)

    def __post_init__(self):
        each = zip(self.parameters, self.channels, self.unlit, strict=True)
        self.effects = [effects_of(*one) for one in each]
        full = [full_parameters(one) for one in self.parameters]
        self.values = {name: np.array([p[name] for p in full], np.float32).reshape(len(full), len(default))
                       for name, default in DEFAULTS.items()}

    @property
    def is_lit(self) -> bool:
        """Whether any material asks for light; a scene without one is drawn as it is without shading."""
        return any(effects != UNLIT for effects in self.effects)

    def wanted_channels(self) -> frozenset[str]:
        """Names of the channels, with a map in some material, that shading reads: those of the core where lit, and of each effect
        in use."""
        wanted = {"base_colour"} if self.effects else set()
        for effects, channels in zip(self.effects, self.channels, strict=True):
            if effects != UNLIT:
                read = {"metallic", "roughness", "normal"}.union(*(e.channels for e in EFFECTS if e.name in effects))
                wanted |= read & set(channels)
        return frozenset(wanted)

    def constant(self, name: str, material: np.ndarray) -> np.ndarray:
        """Values float32 [M, C] of a channel that has no map, of materials [M]: the factor, or what glTF says a missing map
        holds."""
        if name in CONSTANTS:
            return np.broadcast_to(np.array(CONSTANTS[name], np.float32), (len(material), len(CONSTANTS[name])))
        if name == "anisotropy":
            strength = self.values[name][material]
            return np.hstack([np.ones_like(strength), np.full_like(strength, 0.5), strength])
        return self.values[name][material]

    def final(self, name: str, material: np.ndarray, texel: np.ndarray) -> np.ndarray:
        """Final values float32 [M, C] of a channel from its map's values texel [M, C] (linear, 0..1), of materials [M] that have
        that map: map times factor; occlusion mixed with 1 by its strength; of anisotropy only the strength has a factor."""
        texel = np.asarray(texel, np.float32)
        if name == "occlusion":
            return 1 + self.values["occlusion_strength"][material] * (texel - 1)
        if name == "anisotropy":
            return np.hstack([texel[:, :2], texel[:, 2:] * self.values[name][material]])
        return texel if name in CONSTANTS else texel * self.values[name][material]
