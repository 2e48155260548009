"""Converts CodedAttributes to syntax values of raht_parameters (spec clauses 5.7.1 to 5.7.3) and back."""

import numpy as np

from .attribute_coder import CodedAttributes
from .raht_syntax import TRANSFORM_BT709, TRANSFORM_NONE
from .transform.filter import stage_of, taps_of

LEVEL_INDEX_BYTES = 4096  # smaller attribute units do without their per-level byte counts


def raht_values(coded: CodedAttributes, colour: bool) -> dict:
    """Return the syntax values of raht_parameters (spec 5.7.1) for coded attributes. colour: whether the BT.709 transform was
    used."""
    lengths = [len(c) for c in coded.codewords]
    return {
        "colour_transform": TRANSFORM_BT709 if colour else TRANSFORM_NONE, "qp": coded.qp, "kernel": coded.kernel,
        "colour_range": coded.colour_range, "num_models": coded.models, "Planar": coded.planar,
        "planar_transform": coded.planar_transform, "dct_blocks": coded.dct_blocks, "component_cross": coded.component_cross,
        "num_filters": len(coded.filters),
        "filters": [{"filter_mask": s.mask, "filter_coefficients": taps_of(s)} for s in coded.filters],
        "residual": coded.residual, "residual_cross": coded.residual_cross,
        "root_mean": coded.root, "slice_level": coded.slice_level, "num_slices": len(coded.slice_first),
        "slice_step": np.diff(coded.slice_first).tolist(), "level_index": int(sum(lengths) >= LEVEL_INDEX_BYTES),
        "codewords": [{"codeword_length": n, "level_bytes": b} for n, b in zip(lengths, coded.level_bytes, strict=True)],
        "codeword_data": b"".join(coded.codewords),
    }


def coded_of(values: dict) -> tuple[CodedAttributes, list[tuple[int, int]]]:
    """Return (CodedAttributes without codewords; (begin, end) of each codeword in codeword_data). values: syntax values of an
    attribute unit; the mirror of raht_values()."""
    components = len(values["qp"])
    filters = [stage_of(f["filter_mask"], f["filter_coefficients"], components) for f in values["filters"]]
    first = np.cumsum([0, *values["slice_step"]]).tolist()
    ends = np.cumsum([c["codeword_length"] for c in values["codewords"]], dtype=np.int64).tolist()
    coded = CodedAttributes(values["qp"], values["kernel"], values["colour_range"], values["num_models"], filters,
                            values["root_mean"], values["slice_level"], first, [], [],
                            values["residual"], values["residual_cross"], values["Planar"], values["planar_transform"] or 0,
                            values["component_cross"] or 0, values["dct_blocks"] or 0)
    return coded, list(zip([0, *ends], ends, strict=False))
