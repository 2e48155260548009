"""Syntax of an attribute unit of RAHT (spec clauses 5.7.1 to 5.7.3)."""

from ...core.syntax_table import Derived, Structure
from ...core.syntax_table import Element as E
from ...field.extents import octree_depth
from .codewords import codeword_count, level_count

TRANSFORM_NONE, TRANSFORM_BT709 = 0, 1  # colour_transform


def _levels_of_codeword(values, index):
    return {"NumLevels": level_count(values["Depth"], values["slice_level"], index)}


CODEWORD = Structure("codeword_header", "5.7.2", (
    E("codeword_length", "v", 0),
    E("level_bytes", "v", 0, count="NumLevels", when=("level_index", lambda v: v["level_index"])),
), least=1)

FILTER = Structure("filter_stage", "5.7.3", (
    E("filter_mask", "u16", 0, (1 << 15) - 1),
    Derived("NumTaps", "(Planar > 0 ? 5 : 3) * (number of set bits of filter_mask)",
            lambda v: (5 if v["Planar"] else 3) * v["filter_mask"].bit_count()),
    E("filter_coefficients", "i8", count="NumTaps"),
), least=2)

RAHT = Structure("raht_parameters", "5.7.1", (
    E("colour_transform", "u8", 0, 1, registry=True),
    E("qp", "u8", 0, 63, count="NumComponents"),
    E("kernel", "u8", count="7"),
    E("colour_range", "u8"),
    E("num_models", "u8", 0, 8),
    E("planar_transform", "u8", 0, 1, when=("Planar > 0", lambda v: v["Planar"]), registry=True),
    E("dct_blocks", "u8", 0, 1, when=("Planar > 0 and num_models > 0", lambda v: v["Planar"] and v["num_models"]),
      registry=True),
    E("component_cross", "u8", 0, 16, when=("NumComponents > 1", lambda v: v["NumComponents"] > 1)),
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
