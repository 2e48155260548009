"""Units of values that are better coded at another QP than the requested one: images of few colours are coded exactly if that is
cheap, and an image that its own file had already coded gets no more bytes than that file (encoder only)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...scene.channels import COLOURS
from ..decision import Decision
from .coder import LAST_QP

if TYPE_CHECKING:
    from ...codecs.base import Codec, Source
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport
    from .coder import Coder
    from .source_field import SourceField

FEW_COLOURS, QUICK_LOOK = 256, 4096  # colours of a palette; values looked at before all are
EXACT_BYTES = 200  # what exact values may always cost: squares of a few colours are to come back as they were
SAMPLE, RUNS = 8, 4  # part of the values, in so many runs, from which the bytes of exact ones are estimated
LEAST_SAMPLE, HOPELESS = 1 << 13, 2.5  # values in a sample; times what exact values may cost, from which on they are not tried
BITS_PER_QP = 0.17  # log2 of attribute bytes that a step of QP takes away
MOST_TRIES = 4  # codings with a coarser QP before the bytes of the source's image count as out of reach
LEAST_SAVED = 200  # bytes that a unit may take over those of its image: what a unit of any QP takes is no quality
MOST_COARSER = 18  # QP, a step of eight times the requested one


@dataclass(frozen=True, kw_only=True)
class CodedUnit:
    """A coded attribute unit. codec: its codec; values: of its syntax elements; bytes: of its values; plane: float32 [n, C],
    before coding; decoded: uint8 [n, C]."""

    codec: Codec
    values: dict
    bytes: int
    plane: np.ndarray
    decoded: np.ndarray


def has_few_colours(plane: np.ndarray) -> bool:
    """Return whether the rows of values, float32 [N, C] in 0..255, have at most FEW_COLOURS different colours after rounding."""
    quick = plane[:: max(1, len(plane) // QUICK_LOOK)]
    return all(_kinds(part) <= FEW_COLOURS for part in (quick, plane))


def _kinds(plane):
    packed = np.rint(plane).astype(np.int64) @ (1 << 8 * np.arange(plane.shape[1], dtype=np.int64))
    return len(np.unique(packed))


def estimated_bytes(plane: np.ndarray, support: VoxelSupport | TexelSupport, coder: Coder) -> float:
    """Return an estimate of the bytes of values, float32 [N, C] on the keys of a support, coded exactly: that of a sample of
    them; 0 if they are too few to have one."""
    if len(plane) < SAMPLE * LEAST_SAMPLE:
        return 0.0
    run = len(plane) // (SAMPLE * RUNS)
    rows = (np.linspace(0, len(plane) - run, RUNS).astype(int)[:, None] + np.arange(run)).ravel()
    sample = replace(support, keys=support.keys[rows])
    return len(plane) / len(rows) * coder.exactly().roughly().size(np.ascontiguousarray(plane[rows]), sample)[0]


def choose_qp(first: CodedUnit, code: Callable[[Coder], CodedUnit], coder: Coder, worth: float, budget: float | None,
              exact_bytes: Callable[[], float]) -> Decision[CodedUnit]:
    """Return the Decision on a coded attribute unit: the first, which has the coder's QP, or the same values coded exactly or
    coarser.

    code: function that codes the same values with another coder; worth: bytes that a squared error of the unit's values is
    worth; budget: bytes of the image files behind the unit, None if these set no quality; exact_bytes: estimates the bytes of
    exact values. The first stays if nothing is gained. The evidence says why the QP is not the requested one.
    """
    if coder.qp is None or not first.bytes:
        return Decision(first, {})
    error = float(((first.decoded - np.rint(first.plane)) ** 2).mean())
    if error and has_few_colours(first.plane):
        most = first.bytes + max(EXACT_BYTES, worth * error)
        if exact_bytes() <= HOPELESS * most:
            exact = code(coder.exactly())
            if exact.bytes <= most:
                return Decision(exact, {"exact": True, "bytes_at_qp": first.bytes})
    if budget is None or first.bytes <= budget + LEAST_SAVED:
        return Decision(first, {})
    return _within(first, code, coder, budget)


def _within(first, code, coder, budget):
    """Return the Decision on the finest coding, among coarser ones, within a budget; on the coarsest tried if none is."""
    most = budget + LEAST_SAVED
    units, at, low, high = {coder.qp: first}, coder.qp, coder.qp, min(coder.qp + MOST_COARSER, LAST_QP) + 1
    while high - low > 1 and len(units) <= MOST_TRIES:  # low takes more than that, high no more
        guess = at + math.ceil(math.log2(max(units[at].bytes, 1) / most) / BITS_PER_QP)
        at = min(max(guess, low + 1), high - 1)
        units[at] = code(coder.at(qp=at))
        low, high = (low, at) if units[at].bytes <= most else (at, high)
    qp = high if high in units else low
    if qp == coder.qp:
        return Decision(first, {})
    return Decision(units[qp], {"qp": qp, "bytes_at_qp": first.bytes, "source_image_bytes": round(budget)})


def image_budgets(source: Source, fields: list[SourceField]) -> dict[tuple[int, int], float]:
    """Return the bytes of the lossy image files whose texels each attribute unit holds, by (field, group). An image behind
    several units gives each a part, by number of values. A unit with a lossless image or vertex colours behind it has no budget:
    they set no quality."""
    sizes: dict[int, int | None] = {}
    behind: dict[int, dict[tuple[int, int], int]] = {}
    for number, part in enumerate(fields):
        used = source.materials_of(number)
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
    """Return textures that some materials have for the channels of a group."""
    textures = set()
    for material, channel in ((m, c) for m in materials for c in group.channels):
        textures.add(material.texture if channel in COLOURS else material.maps.get(channel.material_name, -1))
    return [scene.textures[t] for t in sorted(textures) if t >= 0]
