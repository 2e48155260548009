"""Every syntax structure of the bitstream as a table; reader, writer, texf-info and the tables of the spec walk over these.

Descriptors: u8 u16 u32 f64 (little endian), i32, v (unsigned LEB128, at most 8 bytes), bytes (the rest of the payload, or `count`
bytes), utf8 (`count` bytes). A Derived entry computes a named variable from what was read; it takes no bytes.
"""

from dataclasses import dataclass
from typing import Any

from ..codecs.neural.layout import WAVE_INPUTS, parameter_count
from ..codecs.raht.layout import codeword_count, level_count, octree_depth

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

SEMANTIC_BASE_COLOUR, SEMANTIC_ALPHA = 0, 1
COMPONENTS = {SEMANTIC_BASE_COLOUR: 3, SEMANTIC_ALPHA: 1}
TRANSFER_LINEAR, TRANSFER_SRGB = 0, 1
CODEC_RAHT, CODEC_3DNTC = range(2)
FORM_RESIDENT, FORM_TRANSPORT = range(2)

V_MAX = (1 << 56) - 1


@dataclass(frozen=True)
class Element:
    """One syntax element. low/high: allowed range; count: None for a scalar, else the name of a value (array length);
    when: (text, function of the values) or None; each: for an array of structures, function (values, index) -> variables that
    item `index` needs."""

    name: str
    descriptor: Any
    low: int | None = None
    high: int | None = None
    count: str | None = None
    when: tuple | None = None
    each: Any = None


@dataclass(frozen=True)
class Derived:
    """A variable computed while reading: text for the spec, function of the values read so far."""

    name: str
    text: str
    value: Any


@dataclass(frozen=True)
class Structure:
    name: str
    clause: str
    elements: tuple


E = Element

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


def _levels_of_codeword(values, index):
    return {"NumLevels": level_count(values["Depth"], values["slice_level"], index)}


CODEWORD = Structure("codeword_header", "5.7.2", (
    E("codeword_length", "v", 0),
    E("level_bytes", "v", 0, count="NumLevels", when=("level_index", lambda v: v["level_index"])),
))

FILTER = Structure("filter_stage", "5.7.3", (
    E("filter_mask", "u16", 0, (1 << 15) - 1),
    Derived("NumTaps", "3 * (number of set bits of filter_mask)", lambda v: 3 * v["filter_mask"].bit_count()),
    E("filter_coefficients", "i8", count="NumTaps"),
))

RAHT = Structure("raht_parameters", "5.7.1", (
    E("colour_transform", "u8", 0, 1),
    E("qp", "u8", 0, 63, count="NumComponents"),
    E("kernel", "u8", count="7"),
    E("colour_range", "u8"),
    E("num_models", "u8", 0, 8),
    E("num_filters", "u8", 0, 3),
    E("filters", FILTER, count="num_filters"),
    E("residual", "u8", 0, 128),
    E("residual_cross", "u8", 0, 16, count="NumComponents", when=("residual > 0", lambda v: v["residual"] > 0)),
    E("root_mean", "i32", -(1 << 20), 1 << 20, count="NumComponents"),
    Derived("Depth", "Ceil(Log2(resolution))", lambda v: octree_depth(v["resolution"])),
    E("slice_level", "u8", 0, 12),
    E("num_slices", "v", 1, 64, when=("slice_level > 0", lambda v: v["slice_level"] > 0)),
    Derived("NumSlices", "slice_level > 0 ? num_slices : 1", lambda v: v["num_slices"] if v["slice_level"] else 1),
    Derived("NumSteps", "NumSlices - 1", lambda v: v["NumSlices"] - 1),
    E("slice_step", "v", 1, count="NumSteps"),
    Derived("NumCodewords", "Depth == 0 ? 0 : (slice_level > 0 ? 1 + NumSlices : 1)",
            lambda v: codeword_count(v["Depth"], v["slice_level"], v["NumSlices"])),
    E("level_index", "u8", 0, 1),
    E("codewords", CODEWORD, count="NumCodewords", each=_levels_of_codeword),
    E("codeword_data", "bytes"),
))

ATTRIBUTE = Structure("attribute", "5.7", (
    E("field_index", "v", 0),
    E("group_index", "u8", 0, 15),
    E("codec_id", "u8"),
    E("values_crc", "u32"),
))

LATENT_LEVEL = Structure("latent_level", "5.7.5", (
    E("level_resolution", "u16", 1, 8192),
    E("table_log2", "u8", 0, 24),
    E("latent_threshold", "u16"),
    Derived("NumCounts", "table_log2 == 0 ? num_fields : 0", lambda v: 0 if v["table_log2"] else v["num_fields"]),
    E("num_latents", "v", 1, count="NumCounts"),
    Derived("NumRows", "table_log2 == 0 ? sum of num_latents : 2^table_log2",
            lambda v: 1 << v["table_log2"] if v["table_log2"] else sum(v["num_latents"])),
))


def _network_widths(values):
    inputs = values["num_levels"] * values["num_features"] + WAVE_INPUTS * values["wave_octaves"]
    return [inputs, *values["hidden_width"], values["NumOutputs"]]


NEURAL = Structure("neural_parameters", "5.7.4", (
    E("form", "u8", 0, 1),
    E("num_features", "u8", 2, 64),
    E("wave_octaves", "u8", 0, 8),
    E("first_wave", "u16", 1, 16384),
    E("num_hidden", "u8", 1, 4),
    E("hidden_width", "u8", 1, 128, count="num_hidden"),
    E("num_levels", "u8", 1, 4),
    E("latent_levels", LATENT_LEVEL, count="num_levels"),
    Derived("Widths", "num_levels * num_features + 6 * wave_octaves, hidden_width[0], hidden_width[1], ..., NumOutputs",
            _network_widths),
    Derived("ParameterBytes", "2 * (sum over i = 0..num_hidden of (Widths[i] + 1) * Widths[i + 1])",
            lambda v: 2 * parameter_count(v["Widths"])),
    E("network_data", "bytes", count="ParameterBytes"),
    E("latent_data", "bytes"),
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
CODECS = {CODEC_RAHT: RAHT, CODEC_3DNTC: NEURAL}
STRUCTURES = (SEQUENCE_HEADER, CHANNEL_GROUP, MATERIALS, MATERIAL, FIELD, GEOMETRY, ATTRIBUTE, RAHT, CODEWORD, FILTER, NEURAL,
              LATENT_LEVEL, METADATA)
