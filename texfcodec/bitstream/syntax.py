"""Syntax tables of the bitstream's structures (core/syntax_table.py). Tables of codecs are in their own modules."""

from ..codecs import our_codecs
from ..codecs.base import PRIVATE_IDS
from ..core.syntax_table import Derived, Structure
from ..core.syntax_table import Element as E
from ..field.extents import MAX_SIDE
from ..geometry.draco import MAX_UV_BITS
from ..scene.channels import CHANNELS, PARAMETERS
from ..scene.normal_rule import IN_STREAM, MOST_ANGLE
from ..scene.scene import ALPHA_BLEND, ALPHA_MASK

SIGNATURE = b"\x89TXF\r\n\x1a\n"
VERSION = 1

UNIT_HEADER, UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_ATTRIBUTE, UNIT_END = range(6)
SUPPORT_VOXELS, SUPPORT_TEXELS = range(2)
MAX_UV_ORIGIN = 1 << 25  # steps
MAX_KEYS = 1 << 28  # of a field: what 64 bits suffice for (clause 10)
ANCILLARY = 128  # unit types from here on may be skipped
UNIT_METADATA, UNIT_SHARP_EDGES, UNIT_CODED_NORMALS = 128, 129, 130
METADATA_JSON = 0  # metadata_format
UNIT_NAMES = {
    UNIT_HEADER: "sequence_header",
    UNIT_MATERIALS: "materials",
    UNIT_FIELD: "field",
    UNIT_GEOMETRY: "geometry",
    UNIT_ATTRIBUTE: "attribute",
    UNIT_END: "end",
    UNIT_METADATA: "metadata",
    UNIT_SHARP_EDGES: "sharp_edges",
    UNIT_CODED_NORMALS: "coded_normals",
}

MAX_GROUPS = len(CHANNELS)

CHANNEL_GROUP = Structure("channel_group", "5.3.1", (
    E("num_semantics", "u8", 1, 3),
    E("group_semantics", "u8", 0, len(CHANNELS) - 1, count="num_semantics", registry=True),
    E("group_components", "u8", 1, 3),
), least=3)

SEQUENCE_HEADER = Structure("sequence_header", "5.3", (
    E("version", "u8"),
    E("position_bits", "u8", 8, 20),
    E("origin", "f64", count="3"),
    E("side", "f64", 0),
    E("num_materials", "v", 0, 65536),
    E("num_fields", "v", 0, 256),
    E("num_geometry_units", "v", 0, 1 << 24),
    E("num_channel_groups", "u8", 1, MAX_GROUPS, registry=True),
    E("channel_groups", CHANNEL_GROUP, count="num_channel_groups"),
))

PARAMETER = Structure("parameter", "5.4.2", (
    E("parameter_id", "u8", 0, len(PARAMETERS) - 1, registry=True),
    Derived("NumValues", "number of values of parameter parameter_id", lambda v: PARAMETERS[v["parameter_id"]].count),
    E("parameter_value", "f32", count="NumValues"),
), least=5)
FLAG_UNLIT = 2
_LIT = ("(material_flags & 2) == 0", lambda v: not v["material_flags"] & FLAG_UNLIT)

MATERIAL = Structure("material", "5.4.1", (
    E("name_length", "v", 0, 65535),
    E("material_name", "utf8", count="name_length"),
    E("alpha_mode", "u8", 0, ALPHA_BLEND, registry=True),
    E("alpha_cutoff", "u16", when=("alpha_mode == 1", lambda v: v["alpha_mode"] == ALPHA_MASK)),
    E("material_flags", "u8", 0, 3, registry=True),
    E("normal_rule", "u8", 0, IN_STREAM.code, when=_LIT, registry=True),
    E("normal_angle", "u8", 0, MOST_ANGLE, when=_LIT),
    E("material_channels", "v", 0, (1 << len(CHANNELS)) - 1, registry=True),
    E("num_parameters", "u8", 0, len(PARAMETERS), registry=True),
    E("parameters", PARAMETER, count="num_parameters"),
), least=5)

MATERIALS = Structure("materials", "5.4", (E("materials", MATERIAL, count="num_materials"),))

_VOXELS = ("support == 0", lambda v: v["support"] == SUPPORT_VOXELS)
_TEXELS = ("support == 1", lambda v: v["support"] == SUPPORT_TEXELS)
_WITH_UV = ("Support == 1", lambda v: v["Support"] == SUPPORT_TEXELS)
_QUANTISED = ("Support == 1 and uv_bits > 0", lambda v: v["Support"] == SUPPORT_TEXELS and v["uv_bits"] > 0)

FIELD = Structure("field", "5.5", (
    E("field_index", "v", 0),
    E("support", "u8", 0, 1, registry=True),
    E("resolution", "u16", 1, 8192, when=_VOXELS),
    E("area_threshold", "u16", when=_VOXELS),
    E("width", "u16", 1, MAX_SIDE, when=_TEXELS),
    E("height", "u16", 1, MAX_SIDE, when=_TEXELS),
    E("wrap_s", "u8", 0, 2, when=_TEXELS, registry=True),
    E("wrap_t", "u8", 0, 2, when=_TEXELS, registry=True),
    E("uv_fraction_bits", "u8", 0, 8, when=_TEXELS),
    E("num_keys", "v", 1, MAX_KEYS),
    E("keys_crc", "u32"),
))

GEOMETRY = Structure("geometry", "5.6", (
    E("field_index", "v", 0),
    E("material_index", "v", 0),
    E("unit_vertices", "v", 3),
    E("unit_faces", "v", 1),
    Derived("Support", "support of field field_index", lambda v: (v["supports"][v["field_index"] :] or [SUPPORT_VOXELS])[0]),
    E("uv_origin", "i32", 1 - MAX_UV_ORIGIN, MAX_UV_ORIGIN - 1, count="2", when=_WITH_UV),
    E("uv_bits", "u8", 0, MAX_UV_BITS, when=_WITH_UV),
    E("uv_range", "v", 1, (1 << MAX_UV_BITS) - 1, when=_QUANTISED),
    E("geometry_crc", "u32"),
    E("draco_data", "bytes"),
))


ATTRIBUTE = Structure("attribute", "5.7", (
    E("field_index", "v", 0),
    E("group_index", "u8", 0, MAX_GROUPS - 1),
    E("codec_id", "u8"),
    E("codec_name_length", "u8", 1, when=("codec_id >= 192", lambda v: v["codec_id"] >= PRIVATE_IDS[0])),
    E("codec_name", "utf8", count="codec_name_length",
      when=("codec_id >= 192", lambda v: v["codec_id"] >= PRIVATE_IDS[0])),
    E("level_shift", "u8", 0, 13),
    E("values_crc", "u32"),
))

METADATA = Structure("metadata", "5.8", (
    E("metadata_format", "u8"),
    E("metadata_json", "bytes"),
))

SHARP_EDGES = Structure("sharp_edges", "5.10", (
    E("num_edges", "v", 1),
    E("marks_crc", "u32"),
    E("marks_data", "bytes"),
))

CODED_NORMALS = Structure("coded_normals", "5.11", (
    E("num_groups", "v", 1),
    E("normal_step", "u16", 1, 4096),
    E("normals_crc", "u32"),
    E("residual_data", "bytes"),
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
    UNIT_SHARP_EDGES: SHARP_EDGES,
    UNIT_CODED_NORMALS: CODED_NORMALS,
}


def structures() -> list[Structure]:
    """All syntax structures, including those of our codecs, in the order of their clauses."""
    before = [SEQUENCE_HEADER, CHANNEL_GROUP, MATERIALS, MATERIAL, PARAMETER, FIELD, GEOMETRY, ATTRIBUTE]
    of_codecs = [structure for codec in our_codecs() for structure in codec.structures]
    return [*before, *of_codecs, METADATA, SHARP_EDGES, CODED_NORMALS]
