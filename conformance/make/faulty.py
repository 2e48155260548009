"""The faulty conformance vectors: good streams, each with one lie and correct checksums (or with the one checksum that lies)."""

import zlib
from contextlib import contextmanager

import numpy as np

from conformance.make.good import (
    empty,
    encoded,
    one_voxel,
    parsed,
    recoded,
    scene_of,
    split_by_material,
    stream_of,
    torus,
    two_sheets,
    units_of,
    values_of,
    with_checksum,
    written,
)
from conformance.make.texels import BITS, Grid, Image, Patch, picture, ring, sheet, stream_of_parts
from texfcodec import Limits, decode
from texfcodec.bitstream.stream import read_stream
from texfcodec.bitstream.syntax import (
    SIGNATURE,
    UNIT_ATTRIBUTE,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_NAMES,
)
from texfcodec.bitstream.units import write_unit
from texfcodec.codecs.raht.raht_syntax import RAHT
from texfcodec.core.syntax_walk import write_v
from texfcodec.scene.scene import ALPHA_BLEND, Material

STRANGER = 200  # an ancillary unit that nobody knows
H, M, F, G, A, E = UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE, UNIT_END


def base_stream():
    """Two fields, colour and alpha, metadata: what most faults are put into."""
    scene = two_sheets()
    scene.materials[1].alpha_mode = ALPHA_BLEND
    scene.metadata = {"copyright": "none"}
    return split_by_material(encoded(scene, resolution=12, qp=46))


def simple_stream():
    """One field, colour only."""
    return encoded(scene_of(*torus(12, 6), [Material("skin", alpha_mode=0)]), resolution=12, qp=46)


def sliced_stream():
    """One field in several slices."""
    return recoded(encoded(scene_of(*torus(12, 6)), resolution=18, qp=46),
                   slices={"WHOLE_VOXELS": 1, "SLICE_VOXELS": 100, "SLICE_NODES": 12})


def with_index():
    """One field of one level, with the level index."""
    return recoded(encoded(scene_of(*torus(8, 5)), resolution=2, qp=30), index=True)


def flat_stream(**tools):
    """One field of one colour, coded by RAHT: no coefficient and no residual is there, whatever steps and kernels are."""
    patch = ring((8, 8))
    return stream_of_parts([Grid(9, constant=False)], [Patch(patch.lattice, patch.faces)], **tools)


def beyond_the_lattice():
    """One field, in order but for a position of 2^position_bits."""
    patch = ring((8, 8))
    patch.lattice[np.argmax(patch.lattice[:, 0]), 0] = 1 << BITS
    return stream_of_parts([Grid(6)], [Patch(patch.lattice, patch.faces)])


def narrow_stream():
    """One field over texels, on positions below 128, which may have any position_bits."""
    patch = sheet([(0, 0), (99, 8), (90, 70), (0, 0), (90, 70), (3, 66)])
    patch.lattice = patch.lattice // 8
    return stream_of_parts([Image(picture(9, 7))], [patch])


@contextmanager
def allowing(structure, name, **bounds):
    """While it lasts, an element has another bound, `low` or `high`, for a stream that is in order but for that."""
    (element,) = [element for element in structure.elements if element.name == name]
    allowed = {bound: getattr(element, bound) for bound in bounds}
    for bound, value in bounds.items():
        object.__setattr__(element, bound, value)
    try:
        yield
    finally:
        for bound, value in allowed.items():
            object.__setattr__(element, bound, value)


def stream_of_slices(number):
    """A sliced stream in so many slices, even where that is more than num_slices allows."""
    with allowing(RAHT, "num_slices", high=number):
        return recoded(encoded(scene_of(*torus(12, 6)), resolution=18, qp=46),
                       slices={"_plan_slices": lambda levels, _: (4, [i * len(levels[4]) // number for i in range(number)])})


def slices_from(level):
    """An image so wide that it has 14 levels, a few of its texels in slices that begin at a level, even one beyond slice_level's
    range."""
    uv = [(8, 3), (300, 8), (120, 0), (143000, 8), (143900, 3), (143500, 0)]
    with allowing(RAHT, "slice_level", high=level):
        return stream_of_parts([Image(picture(9000, 1, noise=9))], [sheet(uv)],
                               slices={"_plan_slices": lambda levels, _: (level, [0, len(levels[level]) // 2])})


# Ways of spoiling a stream


def with_element(data, unit_type, name, raw, number=0):
    """The stream with other bytes for one element of the `number`-th unit of a type; the unit's length and checksum are right."""
    trace = []
    read_stream(data, Limits(), trace)
    unit, rows = [(unit, rows) for unit, rows in trace if unit.type == unit_type][number]
    ((offset, size),) = [(offset, size) for element, offset, size, _ in rows if element == name]
    payload = data[unit.begin : offset] + raw + data[offset + size : unit.end]
    return data[: unit.start] + write_unit(unit_type, payload) + data[unit.stop :]


def spliced(data, unit_type, offset, raw, number=0):
    """The stream with other bytes at an offset of a unit's payload, below 0 from its end. The payload may be wrong already."""
    units = units_of(data)
    at = [n for n, (kind, _) in enumerate(units) if kind == unit_type][number]
    payload = units[at][1]
    offset += len(payload) if offset < 0 else 0
    units[at] = unit_type, payload[:offset] + raw + payload[offset + len(raw) :]
    return stream_of(units)


def with_values(data, edit):
    """The stream whose values (Stream) `edit` has changed, written by the tables."""
    stream = parsed(data)
    edit(stream)
    return written(stream)


def with_header(data, **changes):
    """The stream with other numbers in its sequence header."""
    return with_values(data, lambda stream: stream.header.update(changes))


def with_units(data, edit):
    """The stream whose list of (type, payload) `edit` has changed in place."""
    units = units_of(data)
    edit(units)
    return stream_of(units)


def place(data, unit_type, number=0):
    """(start, stop) of the `number`-th unit of a type in the stream's bytes."""
    at, elements = len(SIGNATURE), []
    for kind, payload in units_of(data):
        size = len(write_unit(kind, payload))
        elements += [(at, at + size)] if kind == unit_type else []
        at += size
    return elements[number]


def flipped(data, unit_type, number=0):
    """The stream with one bit of a unit's payload turned over; where it is empty, of its checksum."""
    start, stop = place(data, unit_type, number)
    at = (start + stop - 4) // 2 + 1 if stop - start > 6 else stop - 1
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


def framed(data, unit_type, raw_length, payload):
    """The stream with a further unit before its end unit whose unit_length stands there as given."""
    body = bytes([unit_type]) + raw_length + payload
    start, _ = place(data, UNIT_END)
    return data[:start] + body + zlib.crc32(body).to_bytes(4, "little") + data[start:]


def with_draco(data, substream, **changes):
    """The stream with another Draco substream in its only geometry unit; `changes` are the unit's counts."""

    def edit(stream):
        (unit,) = stream.geometry
        unit.update(draco_data=substream, **changes)

    return with_values(data, edit)


def with_right_crc(data):
    """The stream with the geometry_crc of what its only geometry unit decodes to."""
    return with_values(data, lambda stream: stream.geometry[0].update(with_checksum(stream.geometry[0])))


def draco_counts(substream, vertices=0, faces=0):
    """The substream with its own counts of vertices and faces changed by so much: (bytes, vertices, faces)."""
    at, numbers = 12, []
    for change in (vertices, faces):
        number = shift = 0
        while True:
            byte = substream[at]
            number, shift, at = number | (byte & 127) << shift, shift + 7, at + 1
            if byte < 128:
                break
        numbers.append(number + change)
    return substream[:12] + write_v(numbers[0]) + write_v(numbers[1]) + substream[at:], *numbers


# The cases


def framing():
    """Clauses 5.1 and 5.2."""
    base = base_stream()
    strange = with_units(base, lambda units: units.insert(2, (STRANGER, b"what a later version has to say")))
    cut = lambda unit_type, part: base[: round(place(base, unit_type)[0] * (1 - part) + place(base, unit_type)[1] * part)]
    swap = lambda units, i, j: units.__setitem__(slice(None), [units[{i: j, j: i}.get(n, n)] for n in range(len(units))])
    first = lambda units, kind: [unit_type for unit_type, _ in units].index(kind)
    lines = [
        ("magic", "a wrong signature", "5.1", b"\x89TXG" + base[4:], "TXF-S01"),
        ("magic_newline", "a signature that a text transfer has changed", "5.1", base.replace(b"\r\n\x1a\n", b"\n\x1a\n", 1),
         "TXF-S01"),
        ("no_bytes", "an empty file", "5.1", b"", "TXF-S01"),
        ("cut_signature", "ends in the signature", "5.1", base[:5], "TXF-S01"),
        ("cut_after_signature", "ends after the signature", "5.1", base[:8], "TXF-S02"),
        ("cut_header", "ends in the sequence header", "5.2", cut(H, 0.5), "TXF-S02"),
        ("cut_geometry", "ends in a geometry unit", "5.2", cut(G, 0.6), "TXF-S02"),
        ("cut_attribute", "ends in an attribute unit", "5.2", cut(A, 0.9), "TXF-S02"),
        ("cut_end", "lacks the end unit", "5.1", cut(E, 0), "TXF-S02"),
        ("cut_last_byte", "lacks its last byte", "5.2", base[:-1], "TXF-S02"),
        ("trailing_byte", "a byte after the end unit", "5.1", base + b"\0", "TXF-S08"),
        ("trailing_unit", "a unit after the end unit", "5.1", base + write_unit(STRANGER, b""), "TXF-S08"),
        *((f"crc_{UNIT_NAMES[kind]}", f"a flipped bit in a unit of type {kind}", "5.2", flipped(base, kind), "TXF-S03")
          for kind in (H, M, F, G, A, E, UNIT_METADATA)),
        ("crc_unknown", "a flipped bit in an unknown ancillary unit", "5.2", flipped(strange, STRANGER), "TXF-S03"),
        ("no_header", "the first unit is not the sequence header", "5.2", with_units(base, lambda units: units.pop(0)),
         "TXF-S07"),
        ("ancillary_first", "an ancillary unit before the sequence header", "5.2",
         with_units(base, lambda units: units.insert(0, (STRANGER, b""))), "TXF-S07"),
        ("two_headers", "a second sequence header", "5.2", with_units(base, lambda units: units.insert(1, units[0])), "TXF-S07"),
        ("units_out_of_order", "a geometry unit before the last field unit", "5.2",
         with_units(base, lambda units: swap(units, first(units, G), first(units, G) - 1)), "TXF-S07"),
        ("two_materials_units", "a second materials unit", "5.2", with_units(base, lambda units: units.insert(1, units[1])),
         "TXF-S07"),
        ("no_materials_unit", "no materials unit", "5.2", with_units(base, lambda units: units.pop(1)), "TXF-S11"),
        ("two_metadata", "a second metadata unit", "5.2",
         with_units(base, lambda units: units.insert(-1, (UNIT_METADATA, b"\0{}"))), "TXF-S07"),
        ("two_metadata_formats", "a second metadata unit, of another metadata_format", "5.2",
         with_units(base, lambda units: units.insert(-1, (UNIT_METADATA, b"\x01{}"))), "TXF-S07"),
        ("length_not_shortest", "unit_length in two bytes where one would do", "4.3", framed(base, STRANGER, b"\x85\0", b"12345"),
         "TXF-S05"),
        ("length_nine_bytes", "a number in nine bytes, on which nothing depends", "4.3",
         with_element(with_index(), A, "codewords[0].level_bytes", b"\x80" * 8 + b"\x01"), "TXF-S05"),
        ("length_too_large", "unit_length beyond the file", "5.2", framed(base, STRANGER, write_v(1 << 55), b""), "TXF-S02"),
        ("end_payload", "a payload in the end unit", "5.9", with_units(base, lambda units: units.__setitem__(-1, (E, b"\0"))),
         "TXF-S08"),
        ("unit_left_over", "a byte too many in a unit", "5.2",
         with_units(base, lambda units: units.__setitem__(0, (H, units[0][1] + b"\0"))), "TXF-S08"),
        ("unit_too_short", "a byte too few in a unit", "5.2",
         with_units(base, lambda units: units.__setitem__(0, (H, units[0][1][:-1]))), "TXF-S02"),
    ]
    unknown = with_units(base, lambda units: units.insert(-1, (6, b"critical")))
    nothing = with_values(empty(), _no_materials)
    lines += [
        ("empty_without_materials", "an empty mesh of no materials without a materials unit", "5.2",
         with_units(nothing, lambda units: units.pop(1)), "TXF-S11"),
        ("empty_two_materials", "an empty mesh of no materials with two materials units", "5.2",
         with_units(nothing, lambda units: units.insert(1, units[1])), "TXF-S07"),
    ]
    return [*lines, ("unknown_critical_unit", "a unit of type 6", "5.2", unknown, "TXF-U01")]


def header_and_materials():
    """Clauses 5.3 and 5.4."""
    base, simple, narrow = base_stream(), simple_stream(), narrow_stream()
    header = parsed(base).header
    more = lambda name, by=1: with_header(base, **{name: header[name] + by})
    nan, minus = np.array([np.nan], "<f8").tobytes(), np.array([-1.0], "<f8").tobytes()
    material = parsed(base).materials[0]["material_name"].encode()
    lines = [
        ("position_bits_7", "position_bits 7", "5.3", with_element(narrow, H, "position_bits", b"\7"), "TXF-S04"),
        ("position_bits_21", "position_bits 21", "5.3", with_element(narrow, H, "position_bits", b"\x15"), "TXF-S04"),
        ("origin_nan", "an origin that is not a number", "4.3", with_element(base, H, "origin", nan * 3), "TXF-S04"),
        ("side_negative", "a negative side", "5.3", with_element(base, H, "side", minus), "TXF-S04"),
        ("num_materials", "num_materials is more than there are", "5.4", with_element(base, H, "num_materials", b"\3"),
         "TXF-S02"),
        ("num_materials_65537", "num_materials is out of range", "5.3", with_element(base, H, "num_materials", b"\x81\x80\4"),
         "TXF-S04"),
        ("num_fields", "num_fields is more than there are", "5.2", more("num_fields"), "TXF-S11"),
        ("num_geometry_units", "num_geometry_units is less than there are", "5.2", more("num_geometry_units", -1), "TXF-S11"),
        ("num_channel_groups_0", "no channel group", "5.3", with_units(narrow, _no_groups), "TXF-S04"),
        ("group_semantics", "an entry of group_semantics out of range", "5.3.1",
         with_element(base, H, "channel_groups[0].group_semantics", b"\x17"), "TXF-U09"),
        ("group_components_4", "four components", "5.3.1", with_element(base, H, "channel_groups[0].group_components", b"\4"),
         "TXF-S04"),
        ("alpha_mode", "alpha_mode 3", "5.4.1", with_element(base, M, "materials[0].alpha_mode", b"\3"), "TXF-U09"),
        ("material_flags", "an unknown material flag", "5.4.1", with_element(base, M, "materials[0].material_flags", b"\4"),
         "TXF-U09"),
        ("name_not_utf8", "a name that is not UTF-8", "4.3",
         with_element(base, M, "materials[0].material_name", b"\xc0\xaf".ljust(len(material), b"x")), "TXF-S06"),
        ("name_too_long", "a name that goes past its unit", "5.4.1", with_element(base, M, "materials[0].name_length", b"\x7f"),
         "TXF-S02"),
        ("num_fields_not_shortest", "a number that is not in its shortest form", "4.3",
         with_element(simple, H, "num_fields", b"\x81\0"), "TXF-S05"),
    ]
    twice = with_element(base, H, "channel_groups[1].group_semantics", b"\0")
    lines.append(("group_semantics_twice", "two base colours", "5.3.1", twice, "TXF-S04"))
    newer, stop = with_element(base, H, "version", b"\2"), place(base, F)[1]
    broken = newer[: stop - 1] + bytes([newer[stop - 1] ^ 1]) + newer[stop:]
    header_stop = place(base, H)[1]
    lines.append(("version_crc", "version 2 and a wrong checksum of the sequence header", "9.2",
                  newer[: header_stop - 1] + bytes([newer[header_stop - 1] ^ 1]) + newer[header_stop:], "TXF-S03"))
    lines.append(("reserved_first", "the first unit is of a reserved type", "9.2",
                  with_units(base, lambda units: units.insert(0, (6, b""))), "TXF-S07"))
    unsupported = [("version", "version 2", "5.3", newer, "TXF-U04"),
                   ("version_0", "version 0", "5.3", with_element(base, H, "version", b"\0"), "TXF-U04"),
                   ("version_broken", "version 2 and a wrong checksum of a unit after the header", "9.2", broken, "TXF-U04"),
                   ("alpha_components", "an alpha group of two components", "5.3.1", _two_alphas(base), "TXF-U03")]
    two, strange = _two_alphas(base), with_element(base, H, "num_channel_groups", b"\x18")
    lines += [
        ("side_before_components", "a negative side and an alpha group of two components", "9.2", spliced(two, H, 26, minus),
         "TXF-S04"),
        ("components_before_left_over", "an alpha group of two components and a byte too many in the header", "9.2",
         spliced(two, H, len(units_of(two)[0][1]), b"\0"), "TXF-U03"),
        ("side_before_groups", "a negative side and 24 channel groups", "9.2",
         spliced(strange, H, 26, minus), "TXF-S04"),
        ("groups_before_group", "24 channel groups and a group of four components", "9.2",
         spliced(strange, H, -1, b"\4"), "TXF-U09"),
    ]
    limit = [("unit_vertices_huge", "2^50 vertices", "10", with_element(simple, G, "unit_vertices", write_v(1 << 50)), "TXF-L02"),
             ("num_keys_huge", "2^28 voxels", "10", with_element(simple, F, "num_keys", write_v(1 << 28)), "TXF-L04")]
    return [*lines, *unsupported, *limit]


def fields_and_geometry():
    """Clauses 5.5, 5.6 and 6.4."""
    base, simple = base_stream(), simple_stream()
    voxels = parsed(simple).fields[0]["num_keys"]
    lines = [
        ("resolution_0", "K = 0", "5.5", with_element(simple, F, "resolution", b"\0\0"), "TXF-S04"),
        ("resolution_8193", "K = 8193", "5.5", with_element(simple, F, "resolution", b"\1\x20"), "TXF-S04"),
        ("resolution", "another K than the voxels were made for", "6.4", with_element(simple, F, "resolution", b"\x0d\0"),
         "TXF-S30"),
        ("area_threshold", "another area_threshold than the voxels were kept by", "6.4",
         with_element(simple, F, "area_threshold", b"\xff\xff"), "TXF-S30"),
        ("num_keys_over", "2^28 + 1 voxels", "5.5", with_element(simple, F, "num_keys", write_v((1 << 28) + 1)), "TXF-S04"),
        ("num_keys_0", "num_keys is 0 over voxels", "5.5", with_element(simple, F, "num_keys", b"\0"), "TXF-S04"),
        ("num_keys", "num_keys is one too many", "6.4", with_element(simple, F, "num_keys", write_v(voxels + 1)),
         "TXF-S30"),
        ("keys_crc", "a wrong keys_crc", "6.4", with_element(simple, F, "keys_crc", b"\1\2\3\4"), "TXF-S30"),
        ("field_order", "field_index 1 before 0", "5.5", with_values(base, lambda stream: stream.fields.reverse()), "TXF-S11"),
        ("field_without_geometry", "both geometry units belong to field 0", "5.5", with_element(base, G, "field_index", b"\0", 1),
         "TXF-S11"),
        ("geometry_field", "a geometry unit of a field that is not there", "5.6", with_element(base, G, "field_index", b"\2", 1),
         "TXF-S09"),
        ("geometry_material", "a material that is not there", "5.6", with_element(base, G, "material_index", b"\2", 1),
         "TXF-S09"),
        ("unit_vertices_2", "two vertices", "5.6", with_element(simple, G, "unit_vertices", b"\2"), "TXF-S04"),
        ("unit_faces_0", "no face", "5.6", with_element(simple, G, "unit_faces", b"\0"), "TXF-S04"),
    ]
    return lines + draco_cases(simple)


def draco_cases(simple):
    """Clause 5.6: Draco substreams that are not what the unit says."""
    import DracoPy

    (unit,) = parsed(simple).geometry
    good = bytes(unit["draco_data"])
    mesh = DracoPy.decode(good)
    points, faces, colours = mesh.points, mesh.faces, np.full((len(mesh.points), 3), 9, np.uint8)
    own = {"unit_vertices": len(points), "unit_faces": len(faces)}
    lied = lambda **by: dict(zip(("substream", "unit_vertices", "unit_faces"), draco_counts(good, **by), strict=True))
    case = lambda name, title, substream, code, **changes: (name, title, "5.6", with_draco(simple, substream, **(own | changes)),
                                                            code)
    return [
        case("draco_point_cloud", "a Draco point cloud", DracoPy.encode(points), "TXF-S20"),
        case("draco_sequential", "a Draco mesh that is not edgebreaker", DracoPy.encode(points, faces, preserve_order=True),
             "TXF-S20"),
        case("draco_version", "Draco bitstream 2.1", good[:6] + b"\1" + good[7:], "TXF-S20"),
        case("draco_traversal", "traversal type 1", good[:11] + b"\1" + good[12:], "TXF-S20"),
        case("draco_quantised", "quantised positions", DracoPy.encode(points.astype(np.float32), faces, compression_level=10),
             "TXF-S20"),
        case("draco_two_attributes", "colours beside the positions",
             DracoPy.encode(points, faces, compression_level=10, colors=colours), "TXF-S20"),
        case("draco_cut", "a Draco substream that ends early", good[: len(good) // 2], "TXF-S22"),
        case("draco_own_faces", "another number of faces in Draco's own header", lied(faces=-1)["substream"], "TXF-S21"),
        ("draco_faces", "one face fewer than is coded, everywhere", "5.6", with_draco(simple, **lied(faces=-1)), "TXF-S22"),
        ("draco_many_faces", "2^40 faces in Draco's own header", "5.6", with_draco(simple, lied(faces=1 << 40)["substream"]),
         "TXF-S21"),
        ("draco_vertices", "one vertex more than is coded, everywhere", "5.6", with_draco(simple, **lied(vertices=1)), "TXF-S21"),
        ("geometry_crc", "a wrong geometry_crc", "5.6.3", with_element(simple, G, "geometry_crc", b"\1\2\3\4"), "TXF-S24"),
        ("geometry_moved", "a position is one step off and no voxel tells", "5.6.3", with_draco(simple, _moved(points, faces)),
         "TXF-S24"),
        ("draco_position", "a position that is not below 2^position_bits", "5.6", beyond_the_lattice(), "TXF-S23"),
    ]


def _moved(points, faces):
    """Draco data of a mesh of which one position is a step away, so little that its voxels stay."""
    import DracoPy

    points = points.copy()
    points[len(points) // 2, 0] += 1
    return DracoPy.encode(points, faces, compression_level=10, create_metadata=False)


def attributes():
    """Clause 5.7 and the checks of clause 7."""
    base, simple, sliced = base_stream(), simple_stream(), sliced_stream()
    last = [unit_type for unit_type, _ in units_of(base)].index(UNIT_METADATA) - 1
    swap = lambda units: units.__setitem__(slice(last - 1, last + 1), [units[last], units[last - 1]])
    edited = lambda edit: with_values(simple, lambda stream: edit(stream.attributes[0]))
    many = lambda edit: with_values(sliced, lambda stream: edit(stream.attributes[0]))
    longer = lambda unit: unit["codewords"][0].update(codeword_length=unit["codewords"][0]["codeword_length"] + 1)
    flat = flat_stream()
    kernel, steps = parsed(flat).attributes[0]["kernel"], parsed(sliced).attributes[0]["slice_step"]
    root = np.array([1 << 21, 0, 0], "<i4").tobytes()
    lines = [
        ("attribute_order", "the last two attribute units change places", "5.7", with_units(base, swap), "TXF-S11"),
        ("attribute_missing", "an attribute unit is missing", "5.7", with_units(base, lambda units: units.pop(last - 1)),
         "TXF-S11"),
        ("attribute_twice", "an attribute unit is there twice", "5.7",
         with_units(base, lambda units: units.insert(last - 1, units[last - 1])), "TXF-S11"),
        ("attribute_field", "an attribute unit of a field that is not there", "5.7",
         with_element(simple, A, "field_index", b"\1"), "TXF-S09"),
        ("attribute_group", "an attribute unit of a group that is not there", "5.7",
         with_element(simple, A, "group_index", b"\1"), "TXF-S09"),
        ("values_crc", "a wrong values_crc", "7.10", with_element(simple, A, "values_crc", b"\1\2\3\4"), "TXF-S32"),
        ("codeword_bit", "a flipped bit in a codeword", "7.10", edited(_flip_codeword), "TXF-S32"),
        ("qp_64", "qp 64", "5.7.1", with_element(flat, A, "qp", b"\x40\0\0"), "TXF-S04"),
        ("kernel_0", "kernel[0] = 0", "5.7.1", with_element(flat, A, "kernel", bytes([0, *kernel[1:]])), "TXF-S04"),
        ("num_models_9", "num_models 9", "5.7.1", with_element(recoded(simple, models=8), A, "num_models", b"\11"), "TXF-S04"),
        ("residual_129", "residual 129", "5.7.1", with_element(flat_stream(models=6, max_error=127), A, "residual", b"\x81"),
         "TXF-S04"),
        ("residual_without_levels", "a residual where K is 1", "5.7.1",
         with_values(one_voxel(), lambda stream: stream.attributes[0].update(residual=1, residual_cross=[0, 0, 0])), "TXF-S04"),
        ("num_filters_4", "num_filters 4", "5.7.1", with_element(flat, A, "num_filters", b"\4" + bytes(8)), "TXF-S04"),
        ("filter_of_no_component", "a filter_mask bit of a component that is not there", "5.7.3",
         with_values(base, lambda stream: stream.attributes[1].update(
             num_filters=1, filters=[{"filter_mask": 1 << 5, "filter_coefficients": [1, 2, 3]}])), "TXF-S04"),
        ("root_mean", "a root_mean out of range", "5.7.1", with_element(simple, A, "root_mean", root), "TXF-S04"),
        ("transform_of_alpha", "a colour transform of one component", "5.7.1",
         with_element(base, A, "colour_transform", b"\1", 1), "TXF-S04"),
        ("colour_transform_2", "colour_transform 2", "5.7.1", with_element(simple, A, "colour_transform", b"\2"), "TXF-U09"),
        ("slice_level", "slice_level is Depth", "5.7.1", with_element(sliced, A, "slice_level", b"\5"), "TXF-S04"),
        ("slice_level_13", "slice_level 13", "5.7.1", slices_from(13), "TXF-S04"),
        ("num_slices_65", "65 slices", "5.7.1", stream_of_slices(65), "TXF-S04"),
        ("num_slices_0", "no slice", "5.7.1", with_element(sliced, A, "num_slices", b"\0"), "TXF-S04"),
        ("slice_step_0", "a slice without nodes", "5.7.1",
         with_element(sliced, A, "slice_step", b"\0" + b"".join(map(write_v, steps[1:]))), "TXF-S04"),
        ("slice_past_the_end", "a slice that begins past the last node", "5.7.1", many(lambda unit: unit["slice_step"].append(
            unit["slice_step"].pop() + 1000)), "TXF-S12"),
        ("slice_far_past_the_end", "slices that begin beyond 2^60", "5.7.1",
         many(lambda unit: unit.update(slice_step=[(1 << 56) - 1] * len(unit["slice_step"]))), "TXF-S12"),
        ("level_index_2", "level_index 2", "5.7.1", with_element(one_voxel(), A, "level_index", b"\2"), "TXF-S04"),
        ("codeword_length", "codeword lengths that do not add up", "5.7.2", edited(longer), "TXF-S10"),
        ("codeword_length_less", "a byte after the last codeword", "5.7.2",
         edited(lambda unit: unit.update(codeword_data=bytes(unit["codeword_data"]) + b"\0")), "TXF-S10"),
        ("codeword_length_huge", "a codeword of 2^55 bytes", "5.7.2",
         edited(lambda unit: unit["codewords"][0].update(codeword_length=1 << 55)), "TXF-S10"),
    ]
    unknown = with_element(base, A, "codec_id", b"\x07", 1)
    return lines + [
        ("codec_id", "an unknown attribute codec", "5.7", unknown, "TXF-U02"),
        ("level_shift_before_codec", "level_shift 14 of an unknown attribute codec", "9.2", spliced(unknown, A, 3, b"\x0e", 1),
         "TXF-S04"),
        ("names_before_codec", "a field that is not there, of an unknown attribute codec", "9.2",
         spliced(unknown, A, 0, b"\2", 1), "TXF-S09"),
    ]


def _no_groups(units):
    """Takes the only channel group, of four bytes with their number, off the header, and its attribute unit."""
    units[0] = (H, units[0][1][:-4] + b"\0")
    del units[[kind for kind, _ in units].index(A)]


def _no_materials(stream):
    stream.materials = []
    stream.header.update(num_materials=0)


def _two_alphas(data):
    """Alpha of two components, in order but for what the header says of it."""
    stream = parsed(data)
    stream.header["channel_groups"][1]["group_components"] = 2
    for unit, number in ((stream.attributes[1], 0), (stream.attributes[3], 1)):
        unit.update(qp=unit["qp"] * 2, root_mean=unit["root_mean"] * 2, component_cross=0)
        unit["values_crc"] = zlib.crc32(values_of(unit, decode(data).fields[number].keys))
    return written(stream)


def _flip_codeword(unit):
    data = bytearray(unit["codeword_data"])
    data[len(data) // 3] ^= 0x40
    unit["codeword_data"] = bytes(data)


def faulty():
    """All faulty vectors."""
    return framing() + header_and_materials() + fields_and_geometry() + attributes()
