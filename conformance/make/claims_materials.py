"""What good conformance vectors claim of whole materials; claims.py has them all."""

import numpy as np

from texfcodec.bitstream.appearance import material_of
from texfcodec.bitstream.syntax import SUPPORT_TEXELS
from texfcodec.scene.channels import BY_NAME, CHANNELS, LARGEST, MAPS, PARAMETERS
from texfcodec.scene.effects import EFFECTS, effects_mask

NORMALS = {"texels": "normal", "voxels": "normal_object"}


def groups_of(case):
    """By group: names of its channels, joined by +."""
    return [" + ".join(channel.name for channel in group.channels) for group in case.texf.groups]


def materials_of(case):
    """Materials that are as they were read, those of no face too."""
    return [material_of(values) for values in case.stream.materials]


def has_every_channel(case, where):
    """All channels that a field on such a support may have are there, of one field on such a support."""
    wanted = {c.name for c in CHANNELS if c.over in ("", where) and c.name != "alpha"}
    (field,) = case.texf.fields
    return field.planes.keys() == wanted and field.over_texels == (where == "texels")


def lacks_maps(case, number):
    """It is the last field; no material of its faces names a map, and those of all fields before it do."""
    mapped = [{m for u in case.texf.units if u.field == n for m in case.texf.materials[u.material].maps}
              for n in range(len(case.texf.fields))]
    return len(mapped) == number + 1 and not mapped[number] and all(mapped[:number])


def numbers_of(case):
    """Every value of every parameter."""
    return [v for m in materials_of(case) for value in m.parameters.values() for v in value]


def has_neighbours_of_defaults(case):
    """Of every finite default, there are values that differ from it by one, up and down, in one number at a time."""
    there = {(name, value) for m in materials_of(case) for name, value in m.parameters.items()}
    beside = lambda p, at, by: tuple(float(np.float32(v + by * (i == at))) for i, v in enumerate(p.default))
    return all((p.name, beside(p, at, by)) in there for p in PARAMETERS if np.isfinite(p.default).all()
               for at in range(p.count) for by in (1, -1))


def is_shifted(case, levels):
    """A plane is so many levels coarser than its field, and has as many values as there are cells."""
    units = [u for u in case.stream.attributes if u["level_shift"] == levels]
    channels = [(case.texf.fields[u["field_index"]], c) for u in units for c in case.texf.groups[u["group_index"]].channels]
    counts = lambda field: len(np.unique(field.keys >> 3 * levels))
    return bool(units) and all(len(field.planes[c.name]) == counts(field) < len(field.keys) for field, c in channels)


def idle_names(case):
    """Channels that materials of no face name and no group holds."""
    there, seen = {c.name.removesuffix("_object") for c in case.texf.channels}, {u.material for u in case.texf.units}
    return {name for n, m in enumerate(materials_of(case)) if n not in seen for name in m.maps} - there


def is_grey(case, name):
    """The group of a channel has one component, which stands for three."""
    at = groups_of(case).index(name)
    planes = [field.planes[name] for field in case.texf.fields if name in field.planes]
    return case.header["channel_groups"][at]["group_components"] == 1 and BY_NAME[name].components == 3 \
        and all((plane == plane[:, :1]).all() and len(np.unique(plane)) > 1 for plane in planes)


# Claim -> predicate of the Case of claims.py and the arguments.
MATERIALS = {
    "maps of occlusion, roughness and metallic": lambda c: {"occlusion", "roughness", "metallic"} == {
        name for m in materials_of(c) for name in m.maps} and effects_mask(materials_of(c)) & 1 << 6,
    "every channel that {} may have": has_every_channel,
    "a group of {}": lambda c, names: names in groups_of(c),
    "groups of {} and of {}": lambda c, first, other: {first, other} < {*groups_of(c)},
    "groups of maps before base colour": lambda c: groups_of(c)[-1] == "base_colour" != groups_of(c)[0],
    "grey {}": is_grey,
    "three fields": lambda c: len(c.stream.fields) == 3,
    "the {} without maps": lambda c, which: lacks_maps(c, {"second": 1, "third": 2}[which]),
    "normals over texels and over voxels": lambda c: {*NORMALS.values()} <= {channel.name for channel in c.texf.channels}
        and {f["support"] == SUPPORT_TEXELS for f in c.stream.fields} == {True, False},
    "a group whose channels are those of two materials": lambda c: any(
        len(g.channels) > 1 and not any({ch.name for ch in g.channels} <= m.maps.keys() for m in materials_of(c))
        for g in c.texf.groups),
    "a material of no face names a channel that no group holds": lambda c: bool(idle_names(c)),
    "materials of no face with every rule": lambda c: {*range(7)} == {
        m["normal_rule"] for n, m in enumerate(c.stream.materials) if n not in {u.material for u in c.texf.units}},
    "names from all ends of UTF-8": lambda c: set("\0\x7f\x80\u07ff\u0800\ud7ff\ue000\uffff\U00010000\U0010ffff")
        <= set("".join(m["material_name"] for m in c.stream.materials)),
    "level_shift {}": is_shifted,
    "maps that are constant": lambda c: bool(c.constant) and not any(
        c.semantics[u["group_index"]] < 2 for u in c.constant),
    "every parameter": lambda c: any(m.parameters.keys() == {p.name for p in PARAMETERS} for m in materials_of(c)),
    "parameters one more and one less than their defaults": has_neighbours_of_defaults,
    "a material with {} alone": lambda c, name: [{*m.parameters} for m in materials_of(c)] == [{name}],
    "the largest and the least number of binary32": lambda c: {LARGEST, -LARGEST, 2.0**-149} <= {*numbers_of(c)},
    "every effect": lambda c: effects_mask(materials_of(c)) + 1 == 1 << len(EFFECTS),
    "no effect": lambda c: effects_mask(materials_of(c)) == 0,
    "an unlit material with maps": lambda c: any(m.unlit and m.maps for m in c.texf.materials),
    "nine outputs": lambda c: c.neural["NumOutputs"] == 9,
}
# Clause -> what a vector that lists it has to hold.
MATERIAL_CLAUSES = {
    "5.4.2": lambda c: any(m.parameters for m in materials_of(c)),
}
assert len(MAPS) == len(CHANNELS) - 4  # base colour, alpha and the channels over voxels are no maps of a material
