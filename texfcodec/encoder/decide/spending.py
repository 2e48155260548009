"""Where the QP that was asked for is not what a unit of values should be coded with: images of few colours are worth coding
exactly where that is cheap, and an image that its own file had already coded is not worth more bytes than that file (encoder
only)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ...scene.channels import COLOURS
from .plane_codec import LAST_QP

if TYPE_CHECKING:
    from ...codecs.base import Codec, Source
    from ...options import EncodeOptions
    from ..source_field import SourceField

FEW_COLOURS, QUICK_LOOK = 256, 4096  # colours of a palette; values looked at before all are
EXACT_BYTES, EXACT_SHARE = 200, 0.01  # what exact values may cost: bytes, or this share of the stream
BITS_PER_QP = 0.17  # log2 of attribute bytes that a step of QP takes away
MOST_TRIES = 4  # codings with a coarser QP before the bytes of the source's image count as out of reach
LEAST_SAVED = 200  # bytes over its image's from which a unit is coded again: what a unit of any QP takes is no quality
MOST_COARSER = 18  # QP, a step of eight times the one that was asked for


@dataclass(kw_only=True)
class CodedUnit:
    """An attribute unit and what it holds. codec: its codec; values: of its syntax elements; bytes: that its values take; plane:
    float32 [n, C], what was coded; decoded: uint8 [n, C]; spending: what the report says where the QP was not followed."""

    codec: Codec
    values: dict
    bytes: int
    plane: np.ndarray
    decoded: np.ndarray
    spending: dict = field(default_factory=dict)


def has_few_colours(plane: np.ndarray) -> bool:
    """Whether the rows of values, float32 [N, C] in 0..255, are of at most FEW_COLOURS kinds once they are rounded."""
    quick = plane[:: max(1, len(plane) // QUICK_LOOK)]
    return all(_kinds(part) <= FEW_COLOURS for part in (quick, plane))


def _kinds(plane):
    packed = np.rint(plane).astype(np.int64) @ (1 << 8 * np.arange(plane.shape[1], dtype=np.int64))
    return len(np.unique(packed))


def spend(first: CodedUnit, code: Callable[[EncodeOptions], CodedUnit], options: EncodeOptions, others: int,
          budget: float | None) -> CodedUnit:
    """The unit that is kept in place of the first, which has the QP that was asked for.

    code: codes the same values with other options; others: bytes of the stream beside this unit; budget: bytes that the image
    files behind it have, None where they say nothing. Returns first where nothing is gained."""
    if options.qp is None or not first.bytes:
        return first
    if has_few_colours(first.plane) and (first.decoded != np.rint(first.plane)).any():
        exact = code(replace(options, qp=None, max_error=0))
        more = exact.bytes - first.bytes
        if more <= max(EXACT_BYTES, EXACT_SHARE * (others + first.bytes)):
            exact.spending = {"exact": True, "bytes_at_qp": first.bytes}
            return exact
    return first if budget is None or first.bytes <= budget + LEAST_SAVED else _within(first, code, options, budget)


def _within(first, code, options, budget):
    """The finest of a few coarser codings that takes no more than a budget; the last one where none does."""
    unit, qp, last = first, options.qp, min(options.qp + MOST_COARSER, LAST_QP)
    if qp >= last:
        return first
    for _ in range(MOST_TRIES):
        qp = min(qp + max(1, math.ceil(math.log2(unit.bytes / budget) / BITS_PER_QP)), last)
        unit = code(replace(options, qp=qp))
        if unit.bytes <= budget or qp == last:
            break
    unit.spending = {"qp": qp, "bytes_at_qp": first.bytes, "source_image_bytes": round(budget)}
    return unit


def image_budgets(source: Source, fields: list[SourceField]) -> dict[tuple[int, int], float]:
    """Bytes of the lossy image files behind each unit, by (field, group). An image behind several units gives each a part, by
    values. A unit with a lossless image or vertex colours behind it has none: they set no quality."""
    sizes: dict[int, int | None] = {}
    behind: dict[int, dict[tuple[int, int], int]] = {}
    for number, part in enumerate(fields):
        used = [source.scene.materials[m] for m in np.unique(source.surface.material[source.face_field == number])]
        for place, group in enumerate(source.groups):
            for texture in _textures_behind(source.scene, used, group):
                sizes[id(texture.image)] = texture.lossy_bytes
                behind.setdefault(id(texture.image), {})[number, place] = len(part.support) * group.components
    unbounded = {unit for image, units in behind.items() if sizes[image] is None for unit in units}
    if source.scene.corner_color is not None:
        unbounded |= {(number, 0) for number in range(len(fields))}
    budgets: dict[tuple[int, int], float] = {}
    for image, units in behind.items():
        for unit, values in units.items():
            if unit not in unbounded:
                budgets[unit] = budgets.get(unit, 0.0) + (sizes[image] or 0) * values / sum(units.values())
    return budgets


def _textures_behind(scene, materials, group):
    """Textures that some materials have for the channels of a group."""
    found = set()
    for material, channel in ((m, c) for m in materials for c in group.channels):
        found.add(material.texture if channel in COLOURS else material.maps.get(channel.material_name, -1))
    return [scene.textures[t] for t in sorted(found) if t >= 0]
