"""Names of the effects of a decoded stream's materials that a format cannot hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..scene.effects import EFFECTS, Condition

if TYPE_CHECKING:
    from ..scene.scene import Material
    from ..texf import Texf

IN_MTL = frozenset({"roughness", "alpha mode BLEND", "metalness", "normal map", "emission"})  # the rest is lost in an OBJ
IN_COLOURS: frozenset[str] = frozenset()  # of a format that has colours at vertices and no materials
_WORDS = {"mask": "alpha mode MASK", "blend": "alpha mode BLEND", "metal": "metalness", "double_sided": "double-sidedness",
          "normal_map": "normal map", "clearcoat_normal_map": "clearcoat normal map", "occlusion": "occlusion map",
          "diffuse_transmission": "diffuse transmission", "specular": "specular reflection", "ior": "index of refraction"}
_ROUGH = Condition("not unlit; roughness is there or named",
                   lambda m: not m.unlit and ("roughness" in m.parameters or "roughness" in m.maps))
_KINDS = (("unlit flag", Condition("unlit", lambda m: m.unlit)), ("roughness", _ROUGH),
          *((_WORDS.get(effect.name, effect.name), effect.used) for effect in EFFECTS if effect.name != "lit"))
_NAMED = 3  # materials in a name


def lost_effects(texf: Texf, held: frozenset[str]) -> list[str]:
    """Return the names of the effects that a stream's faces show and a format cannot hold, such as "clearcoat of material
    'door'". held: effects that the format can hold, IN_MTL or IN_COLOURS."""
    shown = [texf.materials[number] for number in np.unique(texf.face_material).tolist()]
    names = []
    for words, needs in _KINDS:
        bearers = [_called(material) for material in shown if needs(material)] if words not in held else []
        if bearers:
            names.append(f"{words} of {', '.join(bearers[:_NAMED])}" + _others(len(bearers) - _NAMED))
    return names


def _called(material: Material) -> str:
    return f"material '{material.name}'" if material.name else "a material without a name"


def _others(count):
    return "" if count <= 0 else f" and {count} other{'s' * (count > 1)}"
