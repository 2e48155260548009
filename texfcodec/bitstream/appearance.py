"""Checks channel groups, materials and attribute units against each other (spec clauses 5.3.1, 5.4.1 and 5.7)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..codecs.base import Group
from ..errors import InputError, StreamError, SupportError
from ..scene.channels import CHANNELS, COLOURS, MAPS, PARAMETERS, binary32, channel_over, channels_of
from ..scene.normal_rule import USUAL, rule_of
from ..scene.scene import Material
from .syntax import SUPPORT_TEXELS

if TYPE_CHECKING:
    from .stream_values import Stream


def material_of(values: dict) -> Material:
    """Build the Material from one material's syntax values (5.4.1). Its maps have texture -1: their values are in the fields of
    its faces."""
    flags, maps = values["material_flags"], values["material_channels"]
    parameters = {PARAMETERS[p["parameter_id"]].name: tuple(p["parameter_value"]) for p in values["parameters"]}
    rule = USUAL if values["normal_rule"] is None else rule_of(values["normal_rule"], values["normal_angle"])
    return Material(values["material_name"], alpha_mode=values["alpha_mode"], alpha_cutoff=(values["alpha_cutoff"] or 0) / 65535,
                    double_sided=bool(flags & 1), unlit=bool(flags & 2), parameters=parameters, normals=rule,
                    maps={channel.name: -1 for channel in MAPS if maps >> channel.semantic & 1})


def groups_of(coded: list[dict]) -> tuple[Group, ...]:
    """Build the channel Groups from their syntax values (5.3.1), which are checked already."""
    return tuple(Group(channels, grey=len(channels) == 1 and values["group_components"] < channels[0].components)
                 for values, channels in zip(coded, channels_of(coded), strict=True))


def check_groups(groups: list[dict]) -> None:
    """Check the syntax values of all channel groups: each semantic occurs once, and every group has the components of its
    semantics or the single component of a grey colour (5.3.1). Raises StreamError, SupportError."""
    semantics = [semantic for group in groups for semantic in group["group_semantics"]]
    if len(set(semantics)) != len(semantics):
        raise StreamError("TXF-S04", "two channels have the same group_semantics", clause="5.3.1", value=semantics)
    for group, channels in zip(groups, channels_of(groups), strict=True):
        components = sum(channel.components for channel in channels)
        grey = len(channels) == 1 and channels[0].srgb and group["group_components"] == 1
        if group["group_components"] != components and not grey:
            raise SupportError("TXF-U03", "a channel group with this number of components", clause="5.3.1",
                               value=group["group_components"], allowed=components)


def check_level_shift(values: dict, groups: list[dict], most: int) -> None:
    """Check the level_shift of an attribute unit: its plane is at most `most` levels coarser than its field, and a plane of base
    colour or alpha is not coarser at all (5.7). values: of the unit; groups: syntax values of all channel groups. Raises
    StreamError."""
    if {channel.semantic for channel in COLOURS} & {*groups[values["group_index"]]["group_semantics"]}:
        most = 0
    if values["level_shift"] > most:
        raise StreamError("TXF-S04", "level_shift is out of range", clause="5.7", offset=values["offset"],
                          value=values["level_shift"], allowed=f"0..{most}")


def check_material(values: dict) -> None:
    """Check the syntax values of one material: the channels that it names (5.4.1), and its parameters. Raises StreamError."""
    allowed = sum(1 << channel.semantic for channel in MAPS)
    if values["material_channels"] & ~allowed:
        raise StreamError("TXF-S04", "material_channels names a channel that no material has", clause="5.4.1",
                          value=values["material_channels"], allowed=f"bits of {allowed:#x}")
    _check_parameters(values["parameters"])


def _check_parameters(parameters):
    """Checks that parameters are in ascending order and differ from their defaults, so that a material has a single form
    (5.4.2)."""
    ids = [p["parameter_id"] for p in parameters]
    if any(a >= b for a, b in zip(ids, ids[1:], strict=False)):
        raise StreamError("TXF-S04", "the parameters of a material are not in ascending order", clause="5.4.2", value=ids)
    for p in parameters:
        if tuple(p["parameter_value"]) == PARAMETERS[p["parameter_id"]].default:
            raise StreamError("TXF-S04", "a parameter of a material has its default "
                                         "value", clause="5.4.2", value=p["parameter_id"])


def needed_groups(stream: Stream) -> list[list[int]]:
    """Return for each field the numbers of the channel groups that it must have planes of (5.7): the groups of base colour and
    alpha, and groups with a channel that a material of the field's faces names."""
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


def faults_of_appearance(stream: Stream) -> Iterator[StreamError]:
    """Yields an error for each broken rule: every field has the channels that the materials of its faces name, and no others
    (5.3.1, 5.4.1)."""
    groups = channels_of(stream.header["channel_groups"])
    present = {channel.name for channels in groups for channel in channels}
    used = set()
    for unit in stream.geometry:
        planar = stream.fields[unit["field_index"]]["support"] == SUPPORT_TEXELS
        maps = material_of(stream.materials[unit["material_index"]]).maps
        used |= {channel_over(name, planar).name for name in maps}
    if used - present:
        yield StreamError("TXF-S14", "a material names a channel that no group holds", clause="5.4.1",
                          value=sorted(used - present))
    idle = present - used - {channel.name for channel in COLOURS}
    if stream.fields and idle:
        yield StreamError("TXF-S14", "a channel group holds a channel that no material names", clause="5.3.1", value=sorted(idle))


def parameter_values(material: Material) -> list[dict]:
    """Syntax values of a material's parameters (5.4.2), in the order of their numbers, without those that equal the default in
    binary32. Raises InputError."""
    named = [(p, binary32(material.parameters[p.name])) for p in PARAMETERS if p.name in material.parameters]
    named = [(parameter, value) for parameter, value in named if value != parameter.default]
    for parameter, value in named:
        if len(value) != parameter.count or not all(map(math.isfinite, value)):
            raise InputError("TXF-I14", f"{parameter.name} of a material is not {parameter.count} finite numbers",
                             value=list(value), material=material.name)
    return [{"parameter_id": parameter.number, "parameter_value": list(value)} for parameter, value in named]


def channel_bits(material: Material) -> int:
    """Return material_channels (5.4.1) of a material, a bit for each channel that it has."""
    return sum(1 << channel.semantic for channel in MAPS if channel.name in material.maps)


assert len(CHANNELS) <= 56  # a bit each in material_channels, whose descriptor holds 56
