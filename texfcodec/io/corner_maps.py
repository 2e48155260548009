"""Channels given at vertices, such as glTF's _METALLIC: their names, their values, and the materials that show them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..report import plural
from ..scene.channels import ALPHA, BASE_COLOUR, BY_NAME, CORNER_MAPS, PARAMETER_BY_NAME
from .colour_range import clipped, unit_colours

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .parts import Notes, Part

# Further names by what generators and exporters write; a channel's own name is accepted in any case.
ALIASES = {"metalness": "metallic", "metallicity": "metallic", "rough": "roughness", "ao": "occlusion",
           "ambient_occlusion": "occlusion", "emission": "emissive", "emissive_color": "emissive", "emissive_colour": "emissive",
           "opacity": "alpha", "base_color": "base_colour", "basecolor": "base_colour", "albedo": "base_colour"}


def channel_named(name: str) -> str:
    """Return the channel that an attribute's name stands for: one of CORNER_MAPS or "alpha"; "" for any other name. Case and
    leading underscores do not count."""
    channel = any_channel_named(name)
    return "" if channel == BASE_COLOUR.name else channel


def any_channel_named(name: str) -> str:
    """Return the same, or "base_colour"."""
    plain = name.strip("_").lower().replace(" ", "_")
    channel = ALIASES.get(plain, plain)
    return channel if channel in CORNER_MAPS or channel in (ALPHA.name, BASE_COLOUR.name) else ""


def vertex_maps(named: dict[str, np.ndarray], notes: Notes) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Return (channels by name, float32 [V, C] in 0..1, linear; alpha float32 [V], or None) of attributes at vertices.

    named: [V, k] by name, as channel_named() knows them; integers and floats beyond 1 are scaled as colours are. Attributes with
    fewer components than their channel, or a channel's second one, are named in notes.
    """
    maps: dict[str, np.ndarray] = {}
    for name, values in named.items():
        channel = BY_NAME[channel_named(name)]
        if values.shape[1] < channel.components or channel.name in maps:
            notes.drop(f"attribute {name} ({values.shape[1]} components, or given twice)")
            continue
        unit = unit_colours(values[:, : channel.components, None], notes, f"values of {name}")[..., 0]
        bad = np.isnan(unit)
        if bad.any():
            count = int(bad.any(axis=1).sum())
            notes.lose(f"values of {name} (NaN)",
                       plural(count, "vertex has", "vertices have") + f" NaN in {name}; 1 is used instead")
            unit[bad] = 1.0
        maps[channel.name] = unit.astype(np.float32)
    alpha = maps.pop(ALPHA.name, None)
    return maps, None if alpha is None else alpha[:, 0]


def alpha_into(color: np.ndarray | None, alpha: np.ndarray | None) -> np.ndarray | None:
    """Return colours [V, 4] or [F, 3, 4] with alpha float32 [V] multiplied in; colours at corners keep their own."""
    if alpha is None or (color is not None and color.ndim == 3):
        return color
    out = np.ones((len(alpha), 4), np.float32) if color is None else color.copy()
    out[:, 3] *= alpha
    return out


def fill_corner_maps(scene: Scene, parts: list[Part], notes: Notes) -> None:
    """Fill scene.corner_map and the materials' maps from the maps of Parts. An image of the channel goes before: its material's
    values at vertices are named and left out. The factor of the channel becomes 1; faces of the same material without values get
    the factor instead."""
    names = sorted({name for part in parts for name in part.maps})
    for name in names:
        values = np.ones((len(scene.faces), 3, BY_NAME[name].components), np.float32)
        given, row = np.zeros(len(scene.faces), bool), 0
        for part in parts:
            rows = slice(row, row + len(part.faces))
            row = rows.stop
            if name in part.maps:
                values[rows] = part.maps[name][part.faces] if part.maps[name].ndim == 2 else part.maps[name]
                given[rows] = True
        scene.corner_map[name] = _shown(scene, name, values, given, notes)
        if all(material.maps.get(name) != -1 for material in scene.materials):
            del scene.corner_map[name]


def _shown(scene, name, values, given, notes):
    """Values at corners, once materials refer to them."""
    clipped_values = clipped(values, notes, f"values of {name} at vertices").astype(np.float32)
    parameter = PARAMETER_BY_NAME.get(BY_NAME[name].parameter)
    for number in np.unique(scene.face_material[given]):
        material, own = scene.materials[number], scene.face_material == number
        if material.maps.get(name, -1) >= 0:
            notes.remark(f"{name} at vertices of material '{material.name}' is left out: the material has an image of it")
            clipped_values[own] = 1.0
            continue
        material.maps[name] = -1
        if parameter is not None:
            factor = material.parameters.pop(parameter.name, parameter.default)
            clipped_values[own & ~given] = np.clip(factor, 0.0, 1.0)
            if parameter.default != (1.0,) * parameter.count:
                material.parameters[parameter.name] = (1.0,) * parameter.count
    return clipped_values
