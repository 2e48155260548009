"""Clauses 5.3.1, 5.4 and the last part of 5.7 in plain Python: channel groups, materials, what each field needs."""

import struct

from conformance.reference.bits import known, require

# Semantic -> components, of 5.3.1; those that may be grey.
COMPONENTS = (3, 1, 2, 3, 1, 1, 1, 3, 1, 1, 2, 3, 3, 1, 1, 3, 1, 1, 1, 1, 3, 1, 3)
COLOURED = {0, 7, 12, 15, 22}
EVERYWHERE = {0, 1}  # base colour and alpha
OVER_VOXELS = {2: 3, 10: 11}  # what a channel over voxels stands for over texels
NAMEABLE = sum(1 << semantic for semantic in range(23) if semantic not in (0, 1, 3, 11))

# parameter_id -> values where it is not there, of 5.4.2.
DEFAULTS = [
    [1], [1], [1], [1], [0, 0, 0], [1], [0], [0], [1], [0, 0, 0], [0], [1], [1, 1, 1], [0], [0], [float("inf")], [1, 1, 1], [0],
    list(struct.unpack("<f", struct.pack("<f", 1.3))), [100], [400], [0], [0], [0], [1, 1, 1], [1.5], [0],
]


def read_channel_group(reader):
    """Clause 5.3.1; possible: the numbers of components that its semantics allow."""
    semantics = [known("group_semantics", reader.u8("group_semantics"), 22)
                 for _ in range(reader.count_of("group_semantics", reader.u8("num_semantics", 1, 3), 1))]
    grey = {1} if len(semantics) == 1 and semantics[0] in COLOURED else set()
    return {"semantics": semantics, "components": reader.u8("group_components", 1, 3),
            "possible": grey | {sum(COMPONENTS[semantic] for semantic in semantics)}}


def read_material(reader):
    """Clauses 5.4.1 and 5.4.2."""
    material = {"name": reader.utf8(reader.v("name_length", high=65535), "material_name")}
    material["alpha_mode"] = known("alpha_mode", reader.u8("alpha_mode"), 2)
    if material["alpha_mode"] == 1:
        material["alpha_cutoff"] = reader.u16("alpha_cutoff")
    material["flags"] = known("material_flags", reader.u8("material_flags"), 3)
    material |= {"normal_rule": 0, "normal_angle": 45}
    if material["flags"] & 2 == 0:
        material["normal_rule"] = known("normal_rule", reader.u8("normal_rule"), 6)
        material["normal_angle"] = reader.u8("normal_angle", 0, 180)
    material["named"] = known("material_channels", reader.v("material_channels"), 2**23 - 1)
    material["channels"] = {semantic for semantic in range(23) if material["named"] >> semantic & 1}
    num_parameters = known("num_parameters", reader.u8("num_parameters"), len(DEFAULTS))
    material["listed"] = [read_parameter(reader) for _ in range(reader.count_of("parameters", num_parameters, 5))]
    material["parameters"] = dict(material["listed"])
    return material


def read_parameter(reader):
    """Clause 5.4.2: number and values."""
    number = known("parameter_id", reader.u8("parameter_id"), len(DEFAULTS) - 1)
    return number, [reader.f32("parameter_value") for _ in DEFAULTS[number]]


def check_material(material):
    """The rules of 5.4.1 and 5.4.2 on what read_material() has read."""
    require(material["named"] & ~NAMEABLE == 0, f"material_channels is {material['named']:#x}")
    numbers = [number for number, _ in material["listed"]]
    require(all(a < b for a, b in zip(numbers, numbers[1:], strict=False)), "parameter_id does not grow")
    require(all(value != DEFAULTS[number] for number, value in material["listed"]), "a parameter is its default")


def channels_on(material, support):
    """Clause 5.3.1: semantics of the channels that faces of a material have in a field over voxels (0) or texels."""
    return {OVER_VOXELS.get(semantic, semantic) if support == 0 else semantic for semantic in material["channels"]}


def named_by_field(materials, fields, geometry):
    """Semantics that the materials of each field's faces name."""
    named = [set() for _ in fields]
    for unit in geometry:
        number = unit["field_index"]
        named[number] |= channels_on(materials[unit["material_index"]], fields[number]["support"])
    return named


def needed_groups(header, materials, fields, geometry):
    """Clause 5.7: the pairs (field_index, group_index) that have an attribute unit, in order."""
    groups = [set(group["semantics"]) for group in header["channel_groups"]]
    named = named_by_field(materials, fields, geometry)
    return [(i, g) for i, mine in enumerate(named) for g, group in enumerate(groups) if group & (mine | EVERYWHERE)]


def check_appearance(header, materials, fields, geometry):
    """Clauses 5.3.1 and 5.4.1: channels that are named are there, others are not."""
    there = {semantic for group in header["channel_groups"] for semantic in group["semantics"]}
    named = set().union(*named_by_field(materials, fields, geometry))
    require(named <= there, f"materials name the channels {sorted(named - there)}, which no group holds")
    require(not fields or there <= named | EVERYWHERE, f"nobody names the channels {sorted(there - named - EVERYWHERE)}")
