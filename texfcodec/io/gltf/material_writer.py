"""glTF materials out: the dict of a material with its textures, by the tables of channels.py."""

from __future__ import annotations

import math
from typing import Any

from ...scene.channels import BASE_COLOUR, MAPS, PARAMETERS, PBR
from ...scene.scene import ALPHA_BLEND, ALPHA_MASK, Material

UNLIT = "KHR_materials_unlit"


def material_entry(material: Material, textures: dict[str, int]) -> dict:
    """glTF dict of a material. textures: index of the glTF texture by channel name, base colour among them, for those that have
    an image; the material's factor and parameters say the rest."""
    out: dict[str, Any] = {PBR: {}}
    if material.name:
        out["name"] = material.name
    if any(value != 1 for value in material.factor):
        out[PBR]["baseColorFactor"] = [float(value) for value in material.factor]
    if BASE_COLOUR.name in textures:
        out[PBR]["baseColorTexture"] = {"index": textures[BASE_COLOUR.name]}
    for channel in MAPS:
        if channel.name in textures:
            _place(out, channel.extension)[channel.slot] = {"index": textures[channel.name]}
    for parameter in PARAMETERS:
        if parameter.name in material.parameters:
            _write_parameter(out, parameter, material.parameters[parameter.name])
    if material.alpha_mode == ALPHA_MASK:
        out["alphaMode"], out["alphaCutoff"] = "MASK", float(material.alpha_cutoff)
    if material.alpha_mode == ALPHA_BLEND:
        out["alphaMode"] = "BLEND"
    if material.double_sided:
        out["doubleSided"] = True
    if material.unlit:
        out.setdefault("extensions", {})[UNLIT] = {}
    return out


def extensions_of(entries: list[dict]) -> list[str]:
    """Extensions that glTF materials use, in alphabetical order."""
    return sorted({name for entry in entries for name in entry.get("extensions", {})})


def _place(out, extension):
    """Where a material holds what belongs to an extension, to pbrMetallicRoughness or, "", to itself."""
    if extension in ("", PBR):
        return out[PBR] if extension else out
    return out.setdefault("extensions", {}).setdefault(extension, {})


def _write_parameter(out, parameter, value):
    """Puts a parameter where glTF has it; one of a texture that is not there says nothing, nor does what JSON cannot hold."""
    if not all(math.isfinite(v) for v in value):
        return
    entry = [float(v) for v in value] if parameter.count > 1 else float(value[0])
    slot, _, key = parameter.key.rpartition(".")
    if not slot:
        _place(out, parameter.extension)[key] = entry
    elif _has_slot(out, parameter.extension, slot):
        _place(out, parameter.extension)[slot][key] = entry


def _has_slot(out, extension, slot):
    place = out if not extension else out.get("extensions", {}).get(extension, {})
    return slot in place
