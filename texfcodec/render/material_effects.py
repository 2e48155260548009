"""Inputs of shading from materials: valid parameters, the effects that they use, and the channels that these read."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..scene.channels import BY_NAME, PARAMETERS, binary32
from ..scene.effects import BY_NAME as EFFECT_BY_NAME
from ..scene.effects import effects_of
from ..scene.factors import factor_of, neutral_values, with_factor
from ..scene.scene import Material

LARGEST = 65504.0  # of any parameter; what is beyond counts as this
TURN = "anisotropy_rotation"  # the one parameter that may be negative
# Effects that change which terms are called, an unlit material having none; the others are in values, normals or alpha.
TERMS = frozenset({"lit", "occlusion", "emission", "clearcoat", "sheen", "specular", "ior", "transmission", "volume",
                   "dispersion", "iridescence", "anisotropy", "diffuse_transmission"})


def sound_parameters(parameters: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """Return a material's parameters with invalid values replaced, without those that are the default.

    Parameters
    ----------
    parameters : mapping of str to sequence of float
        By name; any values.

    Returns
    -------
    dict
        A parameter with a NaN or of another length counts as the default, negative values as 0 (rotation excepted), values above
        LARGEST as LARGEST (distance excepted).
    """
    out = {}
    for parameter in PARAMETERS:
        given = tuple(float(value) for value in parameters.get(parameter.name, parameter.default))
        if len(given) == parameter.count and not any(math.isnan(value) for value in given):
            low, high = (-LARGEST if parameter.name == TURN else 0.0), (math.inf if parameter.default == (math.inf,) else LARGEST)
            value = tuple(min(max(value, low), high) for value in given)
            if value != parameter.default:
                out[parameter.name] = value
    return out


def shading_effects(material: Material) -> frozenset[str]:
    """Names of the visible effects of a material (texfcodec.scene.effects).

    Parameters
    ----------
    material : Material
        With valid parameters.

    Returns
    -------
    frozenset of str
        Without the effects of a volume if no light passes the material's surface.
    """
    names = {effect.name for effect in effects_of(material)}
    if "transmission" not in names:
        names -= {"dispersion"} if "diffuse_transmission" in names else {"dispersion", "volume"}
    return frozenset(names)


class ShadingTable:
    """Effects and parameters of materials, as arrays for shading.

    Parameters
    ----------
    materials : sequence of Material
        Any; their parameters are made valid.

    Attributes
    ----------
    effects : list of frozenset of str
        Names of the effects of each material.
    values : dict of str to float32 [K, C]
        Values of each parameter by its name, a row for each of the K materials.
    """

    def __init__(self, materials: Sequence[Material]) -> None:
        self.materials = [replace(m, parameters=sound_parameters(m.parameters)) for m in materials]
        self.effects = [shading_effects(m) for m in self.materials]
        self.values = {p.name: np.array([binary32(factor_of(m.parameters, p.name)) for m in self.materials], np.float32)
                       .reshape(-1, p.count) for p in PARAMETERS}

    @property
    def is_lit(self) -> bool:
        """True if any material is lit; a scene without such a material looks the same with and without shading."""
        return any("lit" in effects for effects in self.effects)

    def wanted_channels(self, numbers: Collection[int] | None = None) -> frozenset[str]:
        """Return the channels, beside base colour, that must be sampled: those with a map that the effects of their material
        read.

        numbers: indices of the visible materials, None for all.
        """
        wanted: set[str] = set()
        for number in range(len(self.effects)) if numbers is None else numbers:
            read = {name for effect in self.effects[number] for name in EFFECT_BY_NAME[effect].channels}
            wanted |= read & set(self.materials[number].maps)
        return frozenset(wanted)

    def final(self, name: str, material: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the values float32 [M, C] that shading uses of a channel: its map's, share, times its factor. name: of the
        channel; share: [M, C] linear, 0..1; material: [M], index of each point's material."""
        parameter = BY_NAME[name].parameter
        return with_factor(name, np.asarray(share, np.float32), self.values[parameter][material] if parameter else None)

    def constant(self, name: str, material: np.ndarray) -> np.ndarray:
        """Return the values float32 [M, C] that shading uses of a channel without a map: its factor. material: as in final()."""
        share = np.array(neutral_values(name), np.float32) / np.float32(255)
        return self.final(name, material, np.broadcast_to(share, (len(material), len(share))))
