"""What a coarser level of a map costs and loses: a few pieces of the field are coded at its own fineness and a level coarser, and
looked up where the finer values are; bits and error are weighed as the quantiser weighs them (encoder only)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...field.query import query_field
from ...field.texels import TexelSupport

if TYPE_CHECKING:
    from ...field.keyed import Keyed
    from ...field.voxels import VoxelSupport
    from ..coder import Coder

PIECES, MOST_LEVELS = 6, 3
PIECE_CELLS = 1 << 12  # of a piece: 64 x 64 texels
MOST_MORE, ROUNDING = 2.0, 1 / 12  # the whole field may lose so many times what a piece does: pieces may miss a small detail
TRADE_OFF = 0.08  # squared steps that are worth a bit, as in the quantiser


def cheapest_level(plane: np.ndarray, support: VoxelSupport | TexelSupport, coder: Coder) -> tuple[int, list[float]]:
    """(levels to leave out, costs of those that were tried, by level, in bits a cell). plane: float32 [N, C] on the support."""
    pieces = list(_pieces(plane, support))
    costs, levels = [_cost(pieces, 0, coder)], 0
    while levels < min(support.depth - 4, MOST_LEVELS):
        costs.append(_cost(pieces, levels + 1, coder))
        if costs[-1] >= costs[-2]:
            break
        levels += 1
    while levels and _lost(plane, support, levels) > MOST_MORE * max(_lost(a, b, levels) for a, b in pieces) + ROUNDING:
        levels -= 1
    cells = sum(len(values) for values, _ in pieces)
    return levels, [round(cost / cells, 4) for cost in costs]


def _lost(plane, support, levels):
    """Mean squared error of a coarser level before it is coded."""
    coarse = support.coarser(levels)
    return float(((_at_centres(support, coarse, means(support, plane, levels)) - plane) ** 2).mean())


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


def _cost(pieces, levels, coder):
    """Bits and squared error of pieces that are coded so many levels coarser."""
    total, step = 0.0, _step(coder.qp)
    for values, support in pieces:
        coarse = support.coarser(levels)
        size, decoded = coder.size(means(support, values, levels), coarse, _variables(coarse, values))
        got = _at_centres(support, coarse, decoded) if levels else decoded
        error = float(((got.astype(np.float64) - values) ** 2).sum())
        total += 8 * size + error / step**2 / TRADE_OFF
    return total


def _variables(support, values):
    """What an attribute unit takes from elsewhere (bitstream.stream.attribute_variables)."""
    return {"resolution": int(np.max(support.size)), "Planar": int(support.planar), "NumComponents": values.shape[1]}


def means(support: Keyed, values: np.ndarray, levels: int) -> np.ndarray:
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
