"""The conformance vectors of the constant codec (clause 5.7.6) and of private codecs (clause 5.7), good and faulty."""

import zlib

import numpy as np

from conformance.make.faulty import A, spliced, with_element, with_units, with_values
from conformance.make.good import (
    encoded,
    mixed_resolutions,
    one_voxel,
    parsed,
    scene_of,
    split_by_material,
    torus,
    two_sheets,
    units_of,
    written,
)
from texfcodec import decode
from texfcodec.bitstream.values import attribute_values
from texfcodec.codecs import codec_of
from texfcodec.scene.scene import ALPHA_BLEND, Material

CONSTANT = codec_of("constant")
VEIL = Material("veil", alpha_mode=ALPHA_BLEND)
PRIVATE = b"\xc8"  # codec_id 200


def painted(colour=None, alpha=None, material=None):
    """A torus, in one colour (linear RGB) where that is given, of one alpha where that is."""
    positions, faces, colours = torus(12, 6)
    if colour is not None:
        colours[:, :3] = colour
    if alpha is not None:
        colours[:, 3] = alpha
    return scene_of(positions, faces, colours, [material or Material("skin")])


def levelled(data, planes):
    """The stream with constant units. planes: plane_value by (field_index, group_index)."""
    stream, fields = parsed(data), decode(data).fields
    for i, unit in enumerate(stream.attributes):
        place = unit["field_index"], unit["group_index"]
        if place in planes:
            crc = zlib.crc32(bytes(planes[place]) * len(fields[place[0]].keys))
            stream.attributes[i] = attribute_values(CONSTANT, *place, crc, {"plane_value": list(planes[place])})
    return written(stream)


def subset():
    """What the encoder writes of planes of one value."""
    return [
        ("constant", [("{} constant", "colour")], ("5.7.6", "8.3"), encoded(painted((0.5, 0.2, 0.05)), resolution=20, qp=30),
         (0, 1, 3, 9)),
        ("constant_alpha", ["colour and alpha", ("{} constant beside RAHT {}", "alpha", "colour")], ("5.7", "5.7.6"),
         encoded(painted(alpha=0.4, material=VEIL), resolution=20, qp=30), (0, 1)),
    ]


def uncommon():
    """What a decoder meets seldom, and what only another encoder would write."""
    sheets = split_by_material(encoded(two_sheets(), resolution=21, qp=30))
    return [
        ("constant_two_groups", ["colour and alpha", ("{} constant", "both"), "values of 0 and 255"], ("5.7", "5.7.6"),
         levelled(encoded(painted(material=VEIL), resolution=14, qp=30), {(0, 0): (0, 255, 0), (0, 1): (255,)}), (0, 2)),
        ("constant_colour", ["colour and alpha", ("{} constant beside RAHT {}", "colour", "alpha")], ("5.7", "5.7.6", "7.8.1"),
         levelled(encoded(painted(material=VEIL), resolution=14, qp=30), {(0, 0): (1, 128, 254)}), (0, 1)),
        ("constant_second_field", ["two fields", "the second constant"], ("5.7", "5.7.6", "8.3"),
         levelled(sheets, {(1, 0): (200, 30, 61)}), (0, 2)),
        ("constant_resolutions", ["fields of different K", "all constant"], ("5.7.6", "8.3"),
         levelled(mixed_resolutions(), {(0, 0): (9, 8, 7), (1, 0): (9, 8, 7)}), (0, 1, 4, 5)),
        ("constant_one_voxel", [("K = {}", 1), ("{} constant", "colour")], ("5.7.6", "8.3"),
         levelled(one_voxel(), {(0, 0): (3, 2, 1)}), (0, 1)),
    ]


def faulty():
    """Clauses 5.7 and 5.7.6."""
    veiled = encoded(painted((0.5, 0.2, 0.05), material=VEIL), resolution=12, qp=46)  # constant colour, then RAHT alpha
    uniform = encoded(painted((0.5, 0.2, 0.05)), resolution=12, qp=46)
    colour, alpha = parsed(veiled).attributes
    assert (colour["codec_id"], alpha["codec_id"]) == (CONSTANT.id, 0)
    at = next(i for i, (kind, _) in enumerate(units_of(veiled)) if kind == A)

    def payload(change):
        return with_units(veiled, lambda units: units.__setitem__(at, (A, change(units[at][1]))))

    def another(stream):
        stream.attributes[0]["plane_value"][2] += 1

    def strange(name, length=None):
        return with_element(uniform, A, "codec_id", PRIVATE + bytes([len(name) if length is None else length]) + name)

    lines = [
        ("constant_cut", "the unit ends in plane_value", "5.7.6", payload(lambda raw: raw[:-1]), "TXF-S02"),
        ("constant_without_value", "the unit ends before plane_value", "5.7.6", payload(lambda raw: raw[:-3]), "TXF-S02"),
        ("constant_left_over", "a byte after plane_value", "5.7.6", payload(lambda raw: raw + b"\0"), "TXF-S08"),
        ("constant_value", "another plane_value", "7.10", with_values(veiled, another), "TXF-S32"),
        ("constant_values_crc", "a constant plane with the values_crc of a single voxel", "7.10",
         with_element(uniform, A, "values_crc", np.array(zlib.crc32(bytes(colour["plane_value"])), "<u4").tobytes()), "TXF-S32"),
        ("constant_twice", "a constant unit is there twice", "5.7",
         with_units(veiled, lambda units: units.insert(at, units[at])), "TXF-S11"),
        ("constant_missing", "a constant unit is missing beside a RAHT unit", "5.7",
         with_units(veiled, lambda units: units.pop(at)), "TXF-S11"),
        ("constant_order", "a RAHT unit of group 1 before the constant one of group 0", "5.7",
         with_units(veiled, lambda units: units.insert(at, units.pop(at + 1))), "TXF-S11"),
        ("constant_group", "a constant unit of a group that is not there", "5.7", with_element(uniform, A, "group_index", b"\1"),
         "TXF-S09"),
        ("codec_name_empty", "a private codec without a name", "5.7", strange(b""), "TXF-S04"),
        ("codec_name_not_utf8", "a private codec's name that is not UTF-8", "4.3", strange(b"\xc0\xaf"), "TXF-S06"),
        ("codec_name_too_long", "a private codec's name that goes past its unit", "5.7", strange(b"long", 255), "TXF-S02"),
    ]
    lines.append(("private_codec_level_shift", "level_shift 14 of a private codec", "9.2", spliced(strange(b"x"), A, 5, b"\x0e"),
                  "TXF-S04"))
    unknown = [
        ("private_codec", "a private codec that nobody has", "5.7", strange("nobody's, ü".encode()), "TXF-U07"),
        ("private_codec_letter", "a private codec whose name is one letter", "5.7", strange(b"x"), "TXF-U07"),
        ("codec_id_192", "the first codec_id that has a name", "5.7",
         with_element(uniform, A, "codec_id", b"\xc0\x12a name of 18 bytes"), "TXF-U07"),
        ("codec_id_191", "the last codec_id that has no name", "5.7", with_element(uniform, A, "codec_id", b"\xbf"), "TXF-U02"),
    ]
    return [*lines, *unknown]
