"""The faulty conformance vectors of whole materials (clauses 5.3.1, 5.4.1, 5.4.2 and 5.7)."""

import zlib

import numpy as np

from conformance.make.faulty import A, H, M, with_element, with_units, with_values
from conformance.make.good import parsed, units_of
from conformance.make.materials import bare, groups, over_texels, over_voxels, painted, with_networks
from conformance.make.texels import Grid, ring, stream_of_parts
from texfcodec.scene.channels import BY_NAME, PARAMETERS
from texfcodec.scene.scene import ALPHA_BLEND, Material

FIRST = "materials[0]."


def base_stream():
    """A field over voxels: base colour, roughness with metallic, emissive; a material with parameters."""
    material = painted("roughness", "metallic", "emissive", roughness=(0.5,), emissive=(1.0, 0.5, 0.25))
    return over_voxels([material], groups("roughness+metallic", "emissive"), 9)


def binary32(*values):
    """Bytes of numbers as parameter_value has them."""
    return np.array(values, "<f4").tobytes()


def channel_groups():
    """Clauses 5.3 and 5.3.1."""
    base = base_stream()
    semantics = lambda group, *numbers: with_element(base, H, f"channel_groups[{group}].group_semantics", bytes(numbers))
    lines = [
        ("num_semantics_0", "a channel group of no channels", "5.3.1",
         with_units(base, lambda units: units.__setitem__(0, (H, units[0][1][:-3] + b"\0\1"))), "TXF-S04"),
        ("num_semantics_4", "a channel group of four channels", "5.3.1",
         with_element(base, H, "channel_groups[1].num_semantics", bytes([4, 8, 9])), "TXF-S04"),
        ("group_components_0", "a channel group of no components", "5.3.1",
         with_element(base, H, "channel_groups[1].group_components", b"\0"), "TXF-S04"),
        ("semantics_23", "a channel that nobody knows", "5.3.1", semantics(1, 5, 23), "TXF-U09"),
        ("semantics_twice", "one channel twice in a group", "5.3.1", semantics(1, 5, 5), "TXF-S04"),
        ("semantics_in_two", "one channel in two groups", "5.3.1", semantics(1, 5, 7), "TXF-S04"),
        ("num_channel_groups_24", "more groups than there are channels", "5.3",
         with_element(base, H, "num_channel_groups", b"\x18"), "TXF-U09"),
    ]
    grey = with_element(base, H, "channel_groups[1].group_components", b"\1")
    wide = with_element(base, H, "channel_groups[2].group_components", b"\2")
    linear = over_texels([painted("anisotropy")], groups("anisotropy"), (9, 7))
    unsupported = [
        ("components_of_two", "one component for roughness and metallic", "5.3.1", grey, "TXF-U03"),
        ("components_of_emissive", "two components for a colour", "5.3.1", wide, "TXF-U03"),
        ("components_of_anisotropy", "one component for three that are no colour", "5.3.1",
         with_element(linear, H, "channel_groups[1].group_components", b"\1"), "TXF-U03"),
    ]
    return [*lines, *unsupported]


def appearance():
    """What materials and groups say of each other: TXF-S14."""
    base = base_stream()
    named = lambda data, number, change: with_values(data, lambda stream: stream.materials[number].update(
        material_channels=stream.materials[number]["material_channels"] ^ change))
    texels = over_texels([painted("normal")], groups("normal"), (9, 7))
    object_space = with_element(texels, H, "channel_groups[1].group_semantics", b"\3")
    bit = lambda name: 1 << BY_NAME[name].semantic
    lines = [
        ("channel_without_group", "a material names a channel that no group holds", "5.4.1", named(base, 0, bit("occlusion")),
         "TXF-S14"),
        ("group_without_channel", "a group holds a channel that no material names", "5.3.1", named(base, 0, bit("metallic")),
         "TXF-S14"),
    ]
    components = [("normal_components", "two components for a normal of object space", "5.3.1", object_space, "TXF-U03")]
    return [*lines, *components]


def materials():
    """Clauses 5.4.1 and 5.4.2."""
    base, bare_one = base_stream(), over_voxels([Material("bare")], groups(), 9)
    roughness, emissive = (next(p.number for p in PARAMETERS if p.name == name) for name in ("roughness", "emissive"))
    element = lambda name, raw: with_element(base, M, FIRST + name, raw)
    first, second = "parameters[0].parameter_", "parameters[1].parameter_"
    bits = lambda number: with_element(bare_one, M, FIRST + "material_channels", _v(1 << number))
    lines = [
        *((f"material_channel_{number}", f"a material names channel {number}", "5.4.1", bits(number), code)
          for number, code in ((0, "TXF-S04"), (1, "TXF-S04"), (3, "TXF-S04"), (11, "TXF-S04"), (23, "TXF-U09"))),
        ("num_parameters_28", "more parameters than there are", "5.4.1", element("num_parameters", b"\x1c"), "TXF-U09"),
        ("num_parameters_3", "the unit ends before the third parameter", "5.4.1", element("num_parameters", b"\3"), "TXF-S02"),
        ("parameter_id_27", "a parameter that nobody knows", "5.4.2", element(second + "id", b"\x1b"), "TXF-U09"),
        ("parameter_order", "parameters out of order", "5.4.2", _swapped(base), "TXF-S04"),
        ("parameter_twice", "a parameter twice", "5.4.2", _twice(base), "TXF-S04"),
        ("parameter_nan", "a parameter that is not a number", "4.3", element(first + "value", binary32(np.nan)), "TXF-S04"),
        ("parameter_infinite", "an infinite parameter", "4.3", element(second + "value", binary32(1, -np.inf, 0)), "TXF-S04"),
        ("parameter_default", "a parameter that is its default", "5.4.2", element(first + "value", binary32(1)), "TXF-S04"),
        ("parameter_minus_zero", "a parameter that is its default but for the sign of 0", "5.4.2",
         element(second + "value", binary32(0, -0.0, 0)), "TXF-S04"),
        ("parameter_cut", "the unit ends in parameter_value", "5.4.2", _cut(base), "TXF-S02"),
    ]
    assert (roughness, emissive) == (2, 4)
    return lines


def _v(value):
    """Bytes of a number of descriptor v."""
    out = []
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _swapped(data):
    return with_values(data, lambda stream: stream.materials[0]["parameters"].reverse())


def _twice(data):
    return with_values(data, lambda stream: stream.materials[0].update(
        num_parameters=3, parameters=[stream.materials[0]["parameters"][i] for i in (0, 1, 1)]))


def _cut(data):
    at = next(i for i, (kind, _) in enumerate(units_of(data)) if kind == M)
    return with_units(data, lambda units: units.__setitem__(at, (M, units[at][1][:-2])))


def planes():
    """Clause 5.7: which attribute units there are, and how coarse they may be."""
    base = base_stream()
    units = lambda data, edit: with_values(data, lambda stream: edit(stream.attributes))
    veil, roughness = Material("veil", alpha_mode=ALPHA_BLEND), painted("roughness")
    alpha, with_alpha = groups("alpha"), groups("roughness+alpha")
    shifted_one = lambda material, coded, group, by=1, **more: over_voxels([material], coded, 9, shifts={(0, group): by}, **more)
    small = ring((8, 8))
    two = stream_of_parts([Grid(9), Grid(6)], [bare(small), bare(small, field=1, material=1)],
                          [painted("roughness"), Material("plain")], groups=groups("roughness"), constants=((0, 1),))
    of_second = parsed(two).fields[1]["num_keys"]
    other = lambda unit: unit | {"field_index": 1, "values_crc": zlib.crc32(bytes(unit["plane_value"]) * of_second)}
    shifted = over_voxels([painted("roughness")], groups("roughness"), 9, shifts={(0, 1): 1}, constants=((0, 1),))
    shift = lambda data, levels, number: with_element(data, A, "level_shift", bytes([levels]), number)
    return [
        ("map_unit_missing", "no unit of a map that a field needs", "5.7", units(base, lambda listed: listed.pop()), "TXF-S11"),
        ("map_unit_first", "the unit of a map before that of base colour", "5.7", units(base, lambda listed: listed.reverse()),
         "TXF-S11"),
        ("map_unit_more", "a unit of a map for a field that needs none", "5.7",
         units(two, lambda listed: listed.append(other(listed[1]))), "TXF-S11"),
        ("map_unit_other", "the unit of a map for the field that needs none", "5.7",
         units(two, lambda listed: listed.append(other(listed.pop(1)))), "TXF-S11"),
        ("level_shift_14", "level_shift 14", "5.7", shift(base, 14, 1), "TXF-S04"),
        ("level_shift_over", "level_shift is more than the levels of the field", "5.7",
         shifted_one(roughness, groups("roughness"), 1, 5, constants=((0, 1),)), "TXF-S04"),
        ("level_shift_colour", "level_shift 1 of base colour", "5.7", shifted_one(roughness, groups("roughness"), 0),
         "TXF-S04"),
        ("level_shift_alpha", "level_shift 1 of alpha", "5.7", shifted_one(veil, alpha, 1), "TXF-S04"),
        ("level_shift_with_alpha", "level_shift 1 of a group of roughness and alpha", "5.7",
         shifted_one(roughness, with_alpha, 1), "TXF-S04"),
        ("level_shift_0", "level_shift is 0 for what was coded with 1", "7.10", shift(shifted, 0, 1), "TXF-S32"),
        ("neural_level_shift", "3DNTC: level_shift 1", "5.7", shift(with_networks()[0][3], 1, 0), "TXF-S04"),
    ]


def faulty():
    """Clauses 5.3 to 5.7."""
    return channel_groups() + appearance() + materials() + planes()
