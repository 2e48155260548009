"""Decoded arrays by name, for NPZ files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..core.json_text import json_text
from ..scene.channels import ALPHA, BASE_COLOUR
from ..scene.srgb import to_bytes
from .atlas.texel_image import texel_image
from .vertex_appearance import vertex_colours
from .written_normals import are_lit

if TYPE_CHECKING:
    from ..texf import Texf


def arrays(texf: Texf, appearance: str) -> dict[str, Any]:
    """Return the arrays of an NPZ file by name. texf: decoded stream (Texf); appearance: as in save().

    Always: origin float64 [3], side, position_bits, resolution (voxels along the side in
    the finest field, 1 without voxels); materials, metadata, fields as
    JSON text.
    "vertex": positions float64 [U, 3], faces int64 [F, 3], vertex_material int64 [U], rgba uint8 [U, 4].
    "voxels" and "texture": voxel_xyz int32 [N, 3], voxel_field int32 [N], voxel_rgba uint8 [N, 4] of all fields over voxels.
    "voxels": voxel_center float64 [N, 3].
    "texture": lattice_positions int64 [V, 3], faces int64 [F, 3], face_material, face_field int64 [F].
    "texture", if a field is over texels: uv float64 [V, 2], in texels of the full image of the field, whose width and height are
    in fields; 0 for fields over voxels. For each field over texels, number n: field<n>_xy int32 [N, 2], column and row of the
    decoded texels; field<n>_rgba uint8 [N, 4]; field<n>_image uint8 [H, W, 3 or 4], their image with its gaps filled. A decoded
    texel is 2**level_shift full texels wide; level_shift is in fields.
    "texture", for each further channel c of a field: field<n>_<c> uint8 [M, C], and field<n>_<c>_at int32 [M, 2 or 3], the places
    of its values. corner_normal float32 [F, 3, 3]: shading normals, if a material is lit.
    """
    if appearance == "vertex":
        vertex, index, material, rgba = vertex_colours(texf, with_material=True)
        held = {"positions": texf.positions[vertex], "faces": index, "vertex_material": material, "rgba": to_bytes(rgba)}
    else:
        voxels = texf.voxels(centers=appearance == "voxels")
        held = {f"voxel_{name}": voxels[name] for name in ("xyz", "field", "rgba")}
        held |= {"voxel_center": voxels["center"]} if appearance == "voxels" else _surface(texf)
    texts = {"materials": [_material(m) for m in texf.materials], "metadata": texf.metadata,
             "fields": [_field(part.support) for part in texf.fields]}
    return held | {"origin": texf.origin, "side": texf.side, "position_bits": texf.position_bits,
                   "resolution": texf.resolution} | {name: json_text(value) for name, value in texts.items()}


def _surface(texf):
    held = {name: getattr(texf, name) for name in ("lattice_positions", "faces", "face_material", "face_field")}
    over_texels = [number for number, part in enumerate(texf.fields) if part.over_texels]
    if over_texels:
        held["uv"] = texf.uv
    for number in over_texels:
        part = texf.fields[number]
        held |= {f"field{number}_xy": part.support.xy(), f"field{number}_rgba": part.rgba,
                 f"field{number}_image": texel_image(texf, number)}
    for number, part in enumerate(texf.fields):
        for name in part.planes.keys() - {BASE_COLOUR.name, ALPHA.name}:
            support = part.support_of(name)
            held |= {f"field{number}_{name}": part.planes[name],
                     f"field{number}_{name}_at": support.xy() if part.over_texels else support.xyz()}
    if len(texf.faces) and are_lit(texf):
        held["corner_normal"] = texf.shading_normals()
    return held


def lost_maps(texf: Texf, appearance: str) -> list[str]:
    """Return the names of the maps and shading normals that arrays() leaves out; none for appearance "texture"."""
    if appearance == "texture":
        return []
    names = {name for part in texf.fields for name in part.planes} - {BASE_COLOUR.name, ALPHA.name}
    normals = ["shading normals"] * (appearance == "vertex" and len(texf.faces) > 0 and are_lit(texf))
    return [f"the map of {name.removesuffix('_object').replace('_', ' ')}" for name in sorted(names)] + normals


def _field(support):
    if not support.planar:
        return {"support": "voxels", "resolution": int(support.resolution), "level_shift": int(support.level_shift)}
    return {"support": "texels", "width": int(support.width), "height": int(support.height),
            "wrap": [int(mode) for mode in support.wrap], "level_shift": int(support.level_shift)}


def _material(material):
    return {
        "name": material.name,
        "alpha_mode": int(material.alpha_mode),
        "alpha_cutoff": float(material.alpha_cutoff),
        "double_sided": bool(material.double_sided),
        "unlit": bool(material.unlit),
        "maps": sorted(material.maps),
        "parameters": {name: list(value) for name, value in sorted(material.parameters.items())},
    }
