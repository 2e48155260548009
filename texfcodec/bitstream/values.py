"""Syntax elements from the data at hand: header, materials, metadata, and the RAHT parameters there and back."""

import json

import numpy as np

from ..asset.scene import ALPHA_MASK, ALPHA_OPAQUE
from ..codecs.raht.codec import CodedAttributes
from ..codecs.raht.transform.colour import TRANSFORM_BT709, TRANSFORM_NONE
from ..codecs.raht.transform.filter import stage_of, taps_of
from .syntax import SEMANTIC_ALPHA, SEMANTIC_BASE_COLOUR, TRANSFER_LINEAR, TRANSFER_SRGB, VERSION

LEVEL_INDEX_BYTES = 4096  # smaller attribute units do without their per-level byte counts


def header_values(scene, surface, geometry, num_fields):
    """Values of the sequence header (spec 5.3); alpha is coded only where a material in use is not opaque."""
    groups = [{"group_semantic": SEMANTIC_BASE_COLOUR, "group_transfer": TRANSFER_SRGB, "group_components": 3}]
    if any(scene.materials[m].alpha_mode != ALPHA_OPAQUE for m in np.unique(surface.material)):
        groups.append({"group_semantic": SEMANTIC_ALPHA, "group_transfer": TRANSFER_LINEAR, "group_components": 1})
    return {
        "version": VERSION, "position_bits": surface.cube.position_bits, "origin": surface.cube.origin, "side": surface.cube.side,
        "num_vertices": sum(g["unit_vertices"] for g in geometry), "num_faces": len(surface.faces),
        "num_materials": len(scene.materials), "num_fields": num_fields,
        "num_geometry_units": len(geometry), "num_channel_groups": len(groups), "channel_groups": groups,
    }


def material_values(material):
    """Values of one material (spec 5.4.1)."""
    name = material.name.encode("utf-8", "replace")[:65535].decode("utf-8", "ignore")
    cutoff = round(min(max(material.alpha_cutoff, 0.0), 1.0) * 65535)
    return {"name_length": len(name.encode("utf-8")), "material_name": name, "alpha_mode": material.alpha_mode,
            "alpha_cutoff": cutoff if material.alpha_mode == ALPHA_MASK else None,
            "material_flags": int(material.double_sided) | int(material.unlit) << 1}


def metadata_bytes(metadata, options, report):
    """The metadata unit's JSON, or None where there is nothing or more than the limit."""
    if not metadata:
        return None
    raw = json.dumps(metadata, ensure_ascii=False, separators=(",", ":"), sort_keys=True).encode("utf-8", "replace")
    if options.limits.metadata_bytes is not None and len(raw) > options.limits.metadata_bytes:
        report.warnings.append(f"metadata of {len(raw)} bytes are over the limit and were left out")
        report.dropped.append("metadata")
        return None
    return raw


def raht_values(coded, colour):
    """Syntax values of raht_parameters (spec 5.7.1) for CodedAttributes; colour: whether the BT.709 transform was used."""
    lengths = [len(c) for c in coded.codewords]
    return {
        "colour_transform": TRANSFORM_BT709 if colour else TRANSFORM_NONE, "qp": coded.qp, "kernel": coded.kernel,
        "colour_range": coded.colour_range, "num_models": coded.models, "num_filters": len(coded.filters),
        "filters": [{"filter_mask": s.mask, "filter_coefficients": taps_of(s)} for s in coded.filters],
        "residual": coded.residual, "residual_cross": coded.residual_cross,
        "root_mean": coded.root, "slice_level": coded.slice_level, "num_slices": len(coded.slice_first),
        "slice_step": np.diff(coded.slice_first).tolist(), "level_index": int(sum(lengths) >= LEVEL_INDEX_BYTES),
        "codewords": [{"codeword_length": n, "level_bytes": b} for n, b in zip(lengths, coded.level_bytes, strict=True)],
        "codeword_data": b"".join(coded.codewords),
    }


def coded_of(values):
    """(CodedAttributes without its codewords, their (begin, end) in codeword_data) of an attribute unit's syntax values."""
    components = len(values["qp"])
    filters = [stage_of(f["filter_mask"], f["filter_coefficients"], components) for f in values["filters"]]
    first = np.cumsum([0, *values["slice_step"]]).tolist()
    ends = np.cumsum([c["codeword_length"] for c in values["codewords"]], dtype=np.int64).tolist()
    coded = CodedAttributes(values["qp"], values["kernel"], values["colour_range"], values["num_models"], filters,
                            values["root_mean"], values["slice_level"], first, [], [],
                            values["residual"], values["residual_cross"])
    return coded, list(zip([0, *ends], ends, strict=False))
