"""RAHT as a codec of the registry (codec_id 0, spec clauses 5.7.1 and 7)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ...errors import StreamError
from ..base import PROFILES, PlaneCodec, Reading
from .raht_options import RahtOptions
from .raht_syntax import CODEWORD, FILTER, RAHT, TRANSFORM_BT709

if TYPE_CHECKING:
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport


class Raht(PlaneCodec):
    """Region-adaptive hierarchical transform, prediction, context-adaptive arithmetic coding."""

    id, name = 0, "raht"
    purpose = "gives the smallest file"
    structures = (RAHT, CODEWORD, FILTER)
    options = frozenset({"rate", "qp", "target_bytes", "target_psnr", "target_psnr_of", "lossless", "max_error", "effort",
                         "chroma_qp_offset"})
    settings_type = RahtOptions
    kernels = ("codecs/raht/coefficients/mixed.py",)  # of the usual efforts
    small = ({"resolution": 64, "qp": 20}, {"resolution": 16, "max_error": 0}, {"resolution": 16, "effort": "fast"},
             {"support": "texels", "texel_size": 8})

    def enc(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, options: RahtOptions) -> tuple[dict, np.ndarray]:
        """Code a plane: (syntax values of raht_parameters, decoded values uint8 [N, C]). Three components are transformed as
        RGB; options.max_error bounds the error of every rounded value."""
        from .raht_values import raht_values
        from .tool_choice import code_plane

        colour = plane.shape[1] == 3
        coded, decoded = code_plane(plane, support, colour, options)
        return raht_values(coded, colour), decoded

    def run_kernels(self, encoding: bool = True) -> None:
        """Run the kernels of lossy coding once, so that their compiled code is cached: decode arbitrary bytes, then, if encoding,
        code values."""
        from .attribute_coder import CodedAttributes, Tools, dec_attributes, enc_attributes
        from .transform.filter import RINGS, stage_of

        keys, qp, tools = np.arange(64), [20] * 3, Tools(models=8, filters=1)
        stages = [stage_of(1, [1] * RINGS, 3)]
        made_up = CodedAttributes(qp, list(tools.kernel), 0, tools.models, stages, [0] * 3, 0, [0], [b""], [])
        for depth in (1, 2):  # one level has no tables of neighbours to be made
            dec_attributes(keys[: 8**depth], depth, made_up, np.zeros(8, np.uint8), [(0, 8)], depth)
        if encoding:
            enc_attributes(keys, 2, np.zeros((64, 3), np.int32), qp, tools)

    def dec(self, values: dict, support: VoxelSupport, levels: int, threads: int) -> np.ndarray:
        """Decode a plane without the `levels` finest octree levels: uint8 [n, C] on support.coarser(levels)."""
        return self._dec(values, support, levels, threads)

    def step(self, values: dict) -> float | None:
        """Return the quantiser's step in levels of 255, the smallest of the components. With residuals it is 2 d + 1 for the
        largest error d, or 0 if d is 0."""
        from .transform.quantise import step_of

        if values["residual"]:  # the largest error and 1
            return 2.0 * values["residual"] - 1 if values["residual"] > 1 else 0.0
        return min(step_of(qp) for qp in values["qp"]) / 4096

    def dec_watched(self, values: dict, support: VoxelSupport, threads: int) -> tuple[np.ndarray, Reading]:
        """Decode all levels and return (values uint8 [N, C], the Reading: bytes of codewords that were not needed, and wrong
        level_bytes)."""
        reached: list[list[int]] = []
        return self._dec(values, support, 0, threads, reached), _reading(values["codewords"], reached)

    def _dec(self, values, support, levels, threads, reached=None):
        """Values uint8 [n, C], as PlaneCodec.dec. reached: as in attribute_coder.dec_attributes()."""
        from .attribute_coder import dec_attributes, octree_of
        from .raht_values import coded_of
        from .transform.colour import inverse_colour, inverse_plain

        coded, spans = coded_of(values)
        bt709 = values["colour_transform"] == TRANSFORM_BT709
        if bt709 and len(coded.qp) != 3:
            raise StreamError("TXF-S04", "colour_transform needs three components", clause="5.7.1", offset=values["offset"])
        data, inverse = np.frombuffer(values["codeword_data"], np.uint8), inverse_colour if bt709 else inverse_plain
        stop = max(0, support.depth - levels)
        octree = octree_of(support) if support.planar == bool(coded.planar) else None
        return dec_attributes(support.keys, support.depth, coded, data, spans, stop, threads, inverse, reached, octree)

    def profile(self, values: dict) -> str:
        """Return the profile of the unit: "lossless" with residuals, else "base"."""
        return PROFILES[1 if values["residual"] else 0]

    def check(self, values: dict) -> None:
        """Raise StreamError if relations of clauses 5.7.1 to 5.7.3 between the syntax values are broken."""
        if any(f["filter_mask"] >> 5 * values["NumComponents"] for f in values["filters"]):
            raise StreamError("TXF-S04", "filter_mask is out of range", clause="5.7.3", offset=values["offset"],
                              allowed=f"< 2**{5 * values['NumComponents']}")
        if values["kernel"][0] == 0:
            raise StreamError("TXF-S04", "kernel[0] is out of range", clause="5.7.1", offset=values["offset"], allowed="1..255")
        depth, level = values["Depth"], values["slice_level"]
        if values["residual"] and depth == 0:
            raise StreamError("TXF-S04", "residual is out of range", clause="5.7.1", offset=values["offset"],
                              value=values["residual"], allowed=0)
        if level and level >= depth:
            raise StreamError("TXF-S04", "slice_level is out of range", clause="5.7.1", value=level, allowed=f"0..{depth - 1}")
        total = sum(c["codeword_length"] for c in values["codewords"])
        if total != len(values["codeword_data"]):
            raise StreamError("TXF-S10", "the codeword lengths do not add up to the data", clause="5.7.2", value=total,
                              allowed=len(values["codeword_data"]))

    def describe(self, values: dict) -> dict:
        """Return QPs, bytes of the codewords, slice_level, and bytes by octree level if the unit has a level index, else
        None."""
        return {"qp": values["qp"], "codeword_bytes": [c["codeword_length"] for c in values["codewords"]],
                "slice_level": values["slice_level"], "level_bytes": _level_bytes(values)}

    def info_lines(self, group: dict) -> Iterator[str]:
        """Yield the lines of texf-info: bytes, QP, number of codewords, and bytes by level. group: an entry of inspect()'s
        groups."""
        yield (f"field {group['field_index']}, group {group['group_index']} ({group['semantic']}): {group['bytes']} bytes, "
               f"qp {group['qp']}, {len(group['codeword_bytes'])} codewords")
        if group["level_bytes"] is not None:
            yield "  bytes by level, coarse to fine: " + " ".join(map(str, group["level_bytes"]))


def _reading(codewords, reached):
    """The Reading of codewords' syntax values. reached: as in attribute_coder.dec_attributes()."""
    unread = sum(max(0, word["codeword_length"] - ends[-1]) for word, ends in zip(codewords, reached, strict=True) if ends)
    said = [(word["level_bytes"], np.diff(ends, prepend=0).tolist()) for word, ends in zip(codewords, reached, strict=True)]
    return Reading(unread, sum(a != b for sent, read in said for a, b in zip(sent, read, strict=False)))


def _level_bytes(values):
    """Bytes by octree level over all codewords. With slices, the first codeword is the trunk above slice_level."""
    if not values["level_index"]:
        return None
    total = [0] * values["Depth"]
    for i, codeword in enumerate(values["codewords"]):
        first = values["slice_level"] if i else 0
        for level, count in enumerate(codeword["level_bytes"]):
            total[first + level] += count
    return total
