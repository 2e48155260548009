"""Channel groups, materials and attribute units, checked against each other (spec clauses 5.3.1, 5.4.1 and 5.7)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..asset.normal_rule import USUAL, rule_of
from ..asset.scene import Material
from ..channels import CHANNELS, COLOURS, MAPS, PARAMETER_BY_NAME, PARAMETERS, channel_over, channels_of
from ..effects import effects_mask
from ..errors import StreamError, SupportError
from .syntax import SUPPORT_TEXELS

if TYPE_CHECKING:
    from .stream import Stream


def material_of(values: dict) -> Material:
    """The Material of one material's values (5.4.1); -1 stands for the texture of a map that its faces have in their field."""
    flags, maps = values["material_flags"], values["material_channels"]
    parameters = {PARAMETERS[p["parameter_id"]].name: tuple(p["parameter_value"]) for p in values["parameters"]}
    rule = USUAL if values["normal_rule"] is None else rule_of(values["normal_rule"], values["normal_angle"])
    return Material(values["material_name"], alpha_mode=values["alpha_mode"], alpha_cutoff=(values["alpha_cutoff"] or 0) / 65535,
                    double_sided=bool(flags & 1), unlit=bool(flags & 2), parameters=parameters, normals=rule,
                    maps={channel.name: -1 for channel in MAPS if maps >> channel.semantic & 1})


def check_groups(groups: list[dict]) -> None:
    """Each semantic once, and every group with the components of its semantics, or one of a grey colour (5.3.1)."""
    semantics = [semantic for group in groups for semantic in group["group_semantics"]]
    if len(set(semantics)) != len(semantics):
        raise StreamError("TXF-S04", "two channels have the same group_semantics", clause="5.3.1", value=semantics)
    for group, channels in zip(groups, channels_of(groups), strict=True):
        components = sum(channel.components for channel in channels)
        grey = len(channels) == 1 and channels[0].srgb and group["group_components"] == 1
        if group["group_components"] != components and not grey:
            raise SupportError("TXF-U03", "a channel group with this number of components", clause="5.3.1",
                               value=group["group_components"], allowed=components)


def check_material(values: dict) -> None:
    """Channels that a material may name, and parameters that stand in order, each once and none of them a default (5.4.1)."""
    allowed = sum(1 << channel.semantic for channel in MAPS)
    if values["material_channels"] & ~allowed:
        raise StreamError("TXF-S04", "material_channels names a channel that no material has", clause="5.4.1",
                          value=values["material_channels"], allowed=f"bits of {allowed:#x}")
    ids = [p["parameter_id"] for p in values["parameters"]]
    if any(a >= b for a, b in zip(ids, ids[1:], strict=False)):
        raise StreamError("TXF-S04", "the parameters of a material are not in ascending order", clause="5.4.2", value=ids)


def needed_groups(stream: Stream) -> list[list[int]]:
    """Numbers of the channel groups that each field has planes of (5.7): those of base colour and alpha, and those with a channel
    that a material of its faces names."""
    groups = channels_of(stream.header["channel_groups"])
    everywhere = {channel.name for channel in COLOURS}
    materials: list[set] = [set() for _ in stream.fields]
    for unit in stream.geometry:
        materials[unit["field_index"]].add(unit["material_index"])
    out = []
    for field, used in zip(stream.fields, materials, strict=True):
        maps = {name for number in used for name in material_of(stream.materials[number]).maps}
        named = everywhere | {channel_over(name, field["support"] == SUPPORT_TEXELS).name for name in maps}
        out.append([g for g, channels in enumerate(groups) if named & {channel.name for channel in channels}])
    return out


def check_appearance(stream: Stream) -> None:
    """What materials name is there for every field that has faces of them, nothing is there that none names, and the effects are
    those of the materials (5.3, 5.4.1). Attribute units have been checked against needed_groups()."""
    groups = channels_of(stream.header["channel_groups"])
    present = {channel.name for channels in groups for channel in channels}
    used = set()
    for unit in stream.geometry:
        planar = stream.fields[unit["field_index"]]["support"] == SUPPORT_TEXELS
        maps = material_of(stream.materials[unit["material_index"]]).maps
        used |= {channel_over(name, planar).name for name in maps}
    if used - present:
        raise StreamError("TXF-S14", "a material names a channel that no group holds", clause="5.4.1",
                          value=sorted(used - present))
    idle = present - used - {channel.name for channel in COLOURS}
    if stream.fields and idle:
        raise StreamError("TXF-S14", "a channel group holds a channel that no material names", clause="5.3.1", value=sorted(idle))
    named = effects_mask(material_of(values) for values in stream.materials)
    if stream.header["effects"] != named:
        raise StreamError("TXF-S14", "effects are not those of the materials", clause="5.3.2", value=stream.header["effects"],
                          allowed=named)


def parameter_values(material: Material) -> list[dict]:
    """Syntax values of a material's parameters (5.4.2), in the order of their numbers."""
    named = sorted((PARAMETER_BY_NAME[name].number, value) for name, value in material.parameters.items())
    return [{"parameter_id": number, "parameter_value": [float(v) for v in value]} for number, value in named]


def channel_bits(material: Material) -> int:
    """material_channels of a material (5.4.1)."""
    return sum(1 << channel.semantic for channel in MAPS if channel.name in material.maps)


assert len(CHANNELS) <= 56  # a bit each in material_channels, whose descriptor holds 56
