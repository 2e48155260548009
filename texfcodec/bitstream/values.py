"""Converts the encoder's data to syntax values: header, materials, fields, attributes, metadata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..codecs.base import PRIVATE_IDS, Codec
from ..core.json_text import json_text
from ..field.keyed import keys_crc
from ..field.texels import TexelSupport
from ..field.voxels import VoxelSupport
from ..scene.channels import group_values
from ..scene.scene import ALPHA_MASK, Material
from .appearance import channel_bits, parameter_values
from .syntax import SUPPORT_TEXELS, SUPPORT_VOXELS, VERSION

if TYPE_CHECKING:
    from ..codecs.base import Group
    from ..geometry.surface import Surface
    from ..limits import Limits
    from ..report import Report
    from ..scene.normal_rule import NormalRule


def header_values(materials: list[Material], surface: Surface, geometry: list, num_fields: int, groups: Sequence[Group]) -> dict:
    """Return the syntax values of the sequence header (spec 5.3). materials: of the stream; surface: gives the canonical cube;
    geometry: the geometry units; groups: the coded channel groups. Raises InputError."""
    return {
        "version": VERSION, "position_bits": surface.cube.position_bits, "origin": surface.cube.origin, "side": surface.cube.side,
        "num_materials": len(materials), "num_fields": num_fields, "num_geometry_units": len(geometry),
        "num_channel_groups": len(groups),
        "channel_groups": [group_values(g.channels, g.grey) for g in groups],
    }


def material_values(material: Material, rule: NormalRule | None = None) -> dict:
    """Return the syntax values of one material (spec 5.4.1). rule: of its shading normals; None for the material's own. Raises
    InputError."""
    rule = material.normals if rule is None else rule
    name = material.name.encode("utf-8", "replace")[:65535].decode("utf-8", "ignore")
    parameters = parameter_values(material)
    cutoff = round(min(max(material.alpha_cutoff, 0.0), 1.0) * 65535)
    return {"name_length": len(name.encode("utf-8")), "material_name": name, "alpha_mode": material.alpha_mode,
            "alpha_cutoff": cutoff if material.alpha_mode == ALPHA_MASK else None,
            "material_flags": int(material.double_sided) | int(material.unlit) << 1, "normal_rule": rule.code,
            "normal_angle": rule.angle, "material_channels": channel_bits(material), "num_parameters": len(parameters),
            "parameters": parameters}


def field_values(number: int, support: VoxelSupport | TexelSupport, threshold: int) -> dict:
    """Return the syntax values of a field unit (spec 5.5). number: of the field; threshold: area threshold of the voxels, in
    1/256 voxel faces."""
    values = {"field_index": number, "num_keys": len(support), "keys_crc": keys_crc(support.keys)}
    if isinstance(support, VoxelSupport):
        return values | {"support": SUPPORT_VOXELS, "resolution": support.resolution, "area_threshold": threshold}
    return values | {"support": SUPPORT_TEXELS, "width": support.width, "height": support.height, "wrap_s": support.wrap[0],
                     "wrap_t": support.wrap[1], "uv_fraction_bits": support.fraction_bits}


def attribute_values(codec: Codec, field: int, group: int, checksum: int, values: dict, shift: int = 0) -> dict:
    """Return the syntax values of an attribute unit (spec 5.7). field, group: their numbers; checksum: CRC-32 of the decoded
    values; values: the codec's own parameters; shift: number of levels by which the plane is coarser than its field."""
    name = codec.name if codec.id in PRIVATE_IDS else ""
    return {"field_index": field, "group_index": group, "codec_id": codec.id, "codec_name_length": len(name.encode()),
            "codec_name": name, "level_shift": shift, "values_crc": checksum, **values}


def metadata_bytes(metadata: dict, limits: Limits, report: Report) -> bytes | None:
    """Return the metadata unit's JSON as bytes; None without metadata or if it exceeds the limit, which is then remarked in the
    report."""
    if not metadata:
        return None
    raw = json_text(metadata, ensure_ascii=False, separators=(",", ":"), sort_keys=True).encode("utf-8", "replace")
    if limits.metadata_bytes is not None and len(raw) > limits.metadata_bytes:
        report.remarks.append(f"the metadata, {len(raw)} bytes, exceed the limit and are left out")
        return None
    return raw
