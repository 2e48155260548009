"""Every syntax structure of the bitstream but those of the codecs, which stand with these, as tables (ground/structure.py)."""

from ..codecs import our_codecs
from ..codecs.codec import PRIVATE_IDS
from ..ground.structure import Element as E
from ..ground.structure import Structure

SIGNATURE = b"\x89TXF\r\n\x1a\n"
VERSION = 0

UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE, UNIT_END = range(6)
ANCILLARY = 128  # unit types from here on may be skipped
UNIT_METADATA = 128
UNIT_NAMES = {
    UNIT_HEADER: "sequence_header",
    UNIT_MATERIALS: "materials",
    UNIT_FIELD: "field",
    UNIT_GEOMETRY: "geometry",
    UNIT_ATTRIBUTE: "attribute",
    UNIT_END: "end",
    UNIT_METADATA: "metadata",
}

CHANNEL_GROUP = Structure("channel_group", "5.3.1", (
    E("group_semantic", "u8", 0, 1),
    E("group_transfer", "u8", 0, 1),
    E("group_components", "u8", 1, 3),
))

SEQUENCE_HEADER = Structure("sequence_header", "5.3", (
    E("version", "u8"),
    E("position_bits", "u8", 8, 20),
    E("origin", "f64", count="3"),
    E("side", "f64", 0),
    E("num_vertices", "v", 0),
    E("num_faces", "v", 0),
    E("num_materials", "v", 0, 65536),
    E("num_fields", "v", 0, 256),
    E("num_geometry_units", "v", 0, 1 << 24),
    E("num_channel_groups", "u8", 1, 16),
    E("channel_groups", CHANNEL_GROUP, count="num_channel_groups"),
))

MATERIAL = Structure("material", "5.4.1", (
    E("name_length", "v", 0, 65535),
    E("material_name", "utf8", count="name_length"),
    E("alpha_mode", "u8", 0, 2),
    E("alpha_cutoff", "u16", when=("alpha_mode == 1", lambda v: v["alpha_mode"] == 1)),
    E("material_flags", "u8", 0, 3),
))

MATERIALS = Structure("materials", "5.4", (E("materials", MATERIAL, count="num_materials"),))

FIELD = Structure("field", "5.5", (
    E("field_index", "v", 0),
    E("resolution", "u16", 1, 8192),
    E("area_threshold", "u16"),
    E("num_voxels", "v", 0),
    E("voxels_crc", "u32"),
))

GEOMETRY = Structure("geometry", "5.6", (
    E("field_index", "v", 0),
    E("material_index", "v", 0),
    E("unit_vertices", "v", 3),
    E("unit_faces", "v", 1),
    E("draco_data", "bytes"),
))


ATTRIBUTE = Structure("attribute", "5.7", (
    E("field_index", "v", 0),
    E("group_index", "u8", 0, 15),
    E("codec_id", "u8"),
    E("codec_name_length", "u8", 1, when=("codec_id >= 192", lambda v: v["codec_id"] >= PRIVATE_IDS[0])),
    E("codec_name", "utf8", count="codec_name_length",
      when=("codec_id >= 192", lambda v: v["codec_id"] >= PRIVATE_IDS[0])),
    E("values_crc", "u32"),
))

METADATA = Structure("metadata", "5.8", (
    E("metadata_format", "u8", 0, 0),
    E("metadata_json", "bytes"),
))

END = Structure("end", "5.9", ())

UNITS = {
    UNIT_HEADER: SEQUENCE_HEADER,
    UNIT_MATERIALS: MATERIALS,
    UNIT_FIELD: FIELD,
    UNIT_GEOMETRY: GEOMETRY,
    UNIT_ATTRIBUTE: ATTRIBUTE,
    UNIT_END: END,
    UNIT_METADATA: METADATA,
}


def structures() -> list[Structure]:
    """Every syntax structure, those of our codecs among them, in the order of their clauses."""
    before = [SEQUENCE_HEADER, CHANNEL_GROUP, MATERIALS, MATERIAL, FIELD, GEOMETRY, ATTRIBUTE]
    return [*before, *(one for codec in our_codecs() for one in codec.structures), METADATA]
