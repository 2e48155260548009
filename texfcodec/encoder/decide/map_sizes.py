"""How fine the maps of a field have to be: a smooth one takes fewer bytes, and less time, on a coarser level of its support
(encoder only).

Rarely: the coder spends next to nothing on the fine levels of a smooth map, so that only effort "best" looks. Of some forty maps
of seven assets, at r01 and r03, two went coarser, for less than 100 bytes; looking took a tenth of the encoding.

A few pieces of the field are coded at its own fineness and a level coarser, and asked where the finer values are; bits and error
are weighed as the quantiser weighs them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...field.query import query_field
from ...field.texels import TexelSupport
from ...scene.channels import COLOURS
from ..map_planes import joined
from .plane_codec import codec_for, with_qp_of

if TYPE_CHECKING:
    from ...codecs.base import Codec, Source
    from ...field.voxels import VoxelSupport
    from ...options import EncodeOptions
    from ..source_field import SourceField

PIECES, MOST_LEVELS = 6, 3
PIECE_CELLS = 1 << 12  # of a piece: 64 x 64 texels
LEAST_CELLS = 1 << 12  # a field that is smaller stays as it is
MOST_MORE, ROUNDING = 2.0, 1 / 12  # the whole field may lose so many times what a piece does: pieces may miss a small detail
TRADE_OFF = 0.08  # squared steps that are worth a bit, as in the quantiser


def coarsen_maps(part: SourceField, source: Source, codec: Codec, options: EncodeOptions) -> list[dict]:
    """Brings the planes of a SourceField's maps to the level that suits each, and tells what was tried. source: what is coded;
    base colour and alpha stay. codec: one that codes planes."""
    told = []
    for group in source.groups:
        names = [channel.name for channel in group.channels if channel.name in part.planes]
        if group.channels[0] in COLOURS or not names:
            continue
        plane, shift = joined(part, group)
        levels, costs = _levels(plane, part.support.coarser(shift), codec, with_qp_of(group, options, source.scene.weights))
        if levels:
            support = part.support.coarser(shift)
            coarse = _means(support, plane, levels)
            part.planes |= {name: value for name, value in group.split(coarse).items() if name in names}
            part.shifts |= dict.fromkeys(names, shift + levels)
        told.append({"channels": names, "level_shift": shift + levels, "costs": costs})
    return told


def _levels(plane, support, codec, options):
    """(levels to leave out, costs of what was tried, by level, in bits a cell)."""
    idle = options.effort != "best" or codec_for(plane, codec) is not codec
    if idle or len(support) < LEAST_CELLS or options.qp is None or options.max_error is not None:
        return 0, []
    pieces = list(_pieces(plane, support))
    costs, levels = [_cost(pieces, 0, codec, options)], 0
    while levels < min(support.depth - 4, MOST_LEVELS):
        costs.append(_cost(pieces, levels + 1, codec, options))
        if costs[-1] >= costs[-2]:
            break
        levels += 1
    while levels and _lost(plane, support, levels) > MOST_MORE * max(_lost(*piece, levels) for piece in pieces) + ROUNDING:
        levels -= 1
    cells = sum(len(values) for values, _ in pieces)
    return levels, [round(cost / cells, 4) for cost in costs]


def _lost(plane, support, levels):
    """Mean squared error of a coarser level before it is coded."""
    coarse = support.coarser(levels)
    return float(((_at_centres(support, coarse, _means(support, plane, levels)) - plane) ** 2).mean())


def _step(qp):
    return 2.0 ** ((qp - 4) / 6)


def _pieces(plane: np.ndarray, support: VoxelSupport | TexelSupport) -> Iterator[tuple]:
    """(values, support) of evenly spread runs of neighbouring cells in Morton order, or of the whole field where it is small."""
    count = len(support)
    if count <= PIECES * PIECE_CELLS:
        yield plane, support
        return
    for begin in np.linspace(0, count - PIECE_CELLS, PIECES).astype(int):
        part = slice(begin, begin + PIECE_CELLS)
        yield np.ascontiguousarray(plane[part]), replace(support, keys=support.keys[part])


def _cost(pieces, levels, codec, options):
    """Bits and squared error of pieces that are coded so many levels coarser."""
    total, step = 0.0, _step(options.qp)
    for values, support in pieces:
        coarse = support.coarser(levels)
        made, decoded = codec.enc(_means(support, values, levels), coarse, options)
        got = _at_centres(support, coarse, decoded) if levels else decoded
        error = float(((got.astype(np.float64) - values) ** 2).sum())
        total += 8 * len(codec.write_parameters(made | _variables(coarse, values))) + error / step**2 / TRADE_OFF
    return total


def _variables(support, values):
    """What an attribute unit takes from elsewhere (bitstream.stream.attribute_variables)."""
    return {"resolution": int(np.max(support.size)), "Planar": int(support.planar), "NumComponents": values.shape[1]}


def _means(support, values, levels):
    """Means of values float32 [N, C] over the cells of support.coarser(levels), float32 [n, C]."""
    if not levels:
        return values
    first = np.flatnonzero(np.diff(support.keys >> 3 * levels, prepend=-1))
    counts = np.diff(np.append(first, len(values)))[:, None]
    return (np.add.reduceat(values.astype(np.float64), first, axis=0) / counts).astype(np.float32)


def _at_centres(support, coarse, values):
    """What a coarser level answers at the centres of the cells of a support, float32 [N, C]."""
    values = np.ascontiguousarray(values)
    if isinstance(support, TexelSupport):
        return coarse.query((support.xy() + 0.5) * (1 << support.level_shift), values)
    places = (support.xyz() + 0.5) / (1 << coarse.level_shift - support.level_shift)
    return query_field(places, coarse.size, coarse.keys, coarse.brick_map, values)[0]
