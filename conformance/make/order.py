"""Faulty conformance vectors of the order in which a stream is refused (clauses 4.3, 5.6 and 9.2)."""

from conformance.make.double_faults import placed_units
from conformance.make.faulty import A, F, G, H, M, base_stream, with_element, with_units
from conformance.make.good import stream_of
from conformance.make.normals import CODED, N, leaves, marked
from conformance.make.texels import Image, picture, ring, stream_of_parts
from conformance.make.texels_faulty import neural_over_texels
from texfcodec.core.syntax_walk import write_v

FAR = write_v(1 << 32)  # a number whose low 32 bits are 0
UNKNOWN = (A, 1, "codec_id", b"\7")


def with_bytes(data, *changes):
    """The stream with other bytes at the beginning of some elements: (unit type, number of the unit, element, bytes)."""
    units = placed_units(data)
    for kind, number, name, raw in changes:
        unit = [unit for unit in units if unit.kind == kind][number]
        offset = unit.places[name][0]
        unit.payload[offset : offset + len(raw)] = raw
    return stream_of([(unit.kind, bytes(unit.payload)) for unit in units])


def counts(base):
    """Arrays that their payload cannot hold, before a value of a registry in them."""
    eight = with_bytes(base, (H, 0, "num_materials", b"\x08"))
    few, nearly = (with_units(eight, lambda units, rest=rest: units.__setitem__(1, (M, b"\0\0\x18" + bytes(rest))))
                   for rest in (6, 36))
    strange = (H, 0, "channel_groups[1].group_semantics", b"\x17")
    return [
        ("count_of_materials", "eight materials in nine bytes, material_flags 24 in the first", "4.3", few, "TXF-S02"),
        ("count_of_materials_nearly", "eight materials in 39 bytes, material_flags 24 in the first", "4.3", nearly, "TXF-S02"),
        ("count_of_semantics", "three channels in two bytes, the first of them 23", "4.3",
         with_bytes(base, (H, 0, "channel_groups[1].num_semantics", b"\3"), strange), "TXF-S02"),
        ("count_of_groups", "three channel groups in six bytes, channel 23 in the second", "4.3",
         with_bytes(base, (H, 0, "num_channel_groups", b"\3"), strange), "TXF-S02"),
    ]


def steps(base):
    """Faults of step 5, and one of step 2, before what makes a stream unsupported."""
    _, _, _, joint, _ = neural_over_texels()[0]

    def cut(units):
        at = [kind for kind, _ in units].index(G)
        units[at] = (G, b"\x7f" + units[at][1][1:5])

    lines = [
        ("codec_before_field", "a geometry unit of no field that ends after unit_faces, and an unknown attribute codec",
         with_units(with_bytes(base, UNKNOWN), cut), "TXF-U02"),
        ("codec_before_material", "a material that is not there, and an unknown attribute codec",
         with_bytes(base, UNKNOWN, (G, 0, "material_index", b"\x7f")), "TXF-U02"),
        ("codec_before_field_index", "field units in another order, and an unknown attribute codec",
         with_bytes(base, UNKNOWN, (F, 0, "field_index", b"\1"), (F, 1, "field_index", b"\0")), "TXF-U02"),
        ("codec_before_texels", "3DNTC beside a field over texels, and an unknown attribute codec",
         with_units(joint, lambda units: units.insert(-1, (A, b"\0\0\7\0\0\0\0\0"))), "TXF-U02"),
        ("empty_before_critical", "an empty sequence header, and a unit of type 6",
         with_units(base, lambda units: units.__setitem__(slice(0, 1), [(H, b""), (6, b"")])), "TXF-S02"),
    ]
    return [(name, title, "9.2", data, code) for name, title, data, code in lines]


def groups():
    """Counts of coded normals, in a unit before the attribute unit, whose codec is unknown: none, which is out of range, and one,
    which 8.4.3 does not count, a later step."""
    units = placed_units(marked(leaves(), [(CODED, 0)]))
    units.insert(4, units.pop([unit.kind for unit in units].index(N)))
    base, unknown = stream_of([(unit.kind, bytes(unit.payload)) for unit in units]), (A, 0, "codec_id", b"\7")
    lines = [("groups_before_codec", "num_groups 0", b"\0", "TXF-S04"),
             ("codec_before_groups", "num_groups 1 in place of 22", b"\1", "TXF-U02")]
    return [(name, f"{title}, before an unknown codec", "9.2", with_bytes(base, (N, 0, "num_groups", count), unknown), code)
            for name, title, count, code in lines]


def rules(base):
    """Rules of step 4, before a later registry value in the same unit."""
    planar = stream_of_parts([Image(picture(8, 8, channels=4))], [ring((8, 8))], alpha=True)
    return [
        ("registry_before_rule", "a material that names alpha, and alpha_mode 3 of the next", "9.2",
         with_bytes(base, (M, 0, "materials[0].material_channels", b"\2"), (M, 0, "materials[1].alpha_mode", b"\3")), "TXF-U09"),
        ("registry_before_transform", "a colour transform of one component, and planar_transform 2", "9.2",
         with_bytes(planar, (A, 1, "colour_transform", b"\1"), (A, 1, "planar_transform", b"\2")), "TXF-U09"),
    ]


def faulty():
    """All of them, and two numbers that 32 bits would cut to 0."""
    base = base_stream()
    return [*counts(base), *steps(base), *groups(), *rules(base),
            ("geometry_field_far", "a geometry unit of field 2^32", "5.6", with_element(base, G, "field_index", FAR), "TXF-S09"),
            ("geometry_material_far", "material 2^32", "5.6", with_element(base, G, "material_index", FAR), "TXF-S09")]
