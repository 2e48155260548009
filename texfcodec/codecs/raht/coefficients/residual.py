"""Residuals of the values (spec clause 7.9): the differences to the original, exact or within an error, with mixed contexts.

Encoder and decoder share one walk. The components of a voxel come in the order of component_order; the first helps to predict the
others.
"""

from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import _dec_escape, _enc_escape
from ..entropy.mixing import Model, _mixed_bit, new_chosen, new_model
from ..transform.octree import CELLS, CENTRE, Level, Nodes, _cells
from .mixed_contexts import FINE, _fine

BITS = 16  # of a magnitude that are coded with contexts, the first tells whether it is zero
MODELS, SIGN_MODELS = 6, 3
MAX_MAGNITUDE = 255
CROSS_FRACTION = 4
MAX_CROSS = 1 << CROSS_FRACTION
_BASES = np.cumsum([0, 3 * FINE * BITS, 3 * FINE * BITS, 3 * 16 * (FINE // 2) * BITS, 3 * FINE * BITS, 3 * 64 * BITS,
                    3 * 8 * FINE * BITS, 3 * 3 * 3, 3 * 16, 3 * 3 * 16])
SIZE, SIGN, CONTEXTS = _BASES[:6], _BASES[6:9], int(_BASES[9])
WEIGHT_SETS, REFINEMENT_SETS = 3 * BITS + 3 * FINE + 3 + 16, 3 * BITS + 3
_OFFSETS = [(4 >> (abs(x) + abs(y) + abs(z) - 1), 16 * x + 4 * y + z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)
            if (x, y, z) != (0, 0, 0)]
NEAR_WEIGHTS, NEAR_CELLS = np.array(sorted(_OFFSETS, key=lambda row: row[1] % 4 != 0)).T.copy()
PLANAR_NEAR = 8  # of them with z = 0, which come first
# Entries of the rows of a voxel's surroundings, by component
(ERRORS, MAGNITUDES, LARGEST, VARIATION) = range(4)

# What a walk over the residuals reads and fills. x, original: uint8 [N, C], before the residuals and what is wanted; y uint8
# [N, C], with them; k int16 [N, C], the residuals; cross: int64 [C]; order: of component_order; delta: largest error
Values = namedtuple("Values", "x original y k cross order delta")


@dataclass
class ResidualPlan:
    """The values that residuals after the transform must reach, within an error. delta: largest error per value; original: uint8
    [N, C]; inverse: function from means to values (7.8)."""

    delta: int
    original: np.ndarray = field(repr=False)
    inverse: Callable = field(repr=False)


def component_order(components: int) -> np.ndarray:
    """Return the numbers of a voxel's components in coding order: green first, because it predicts the others best."""
    return np.array([1, 0, 2] if components == 3 else range(components), np.int64)


def new_residual_model() -> Model:
    """Model of a slice's residuals in its initial state."""
    return new_model(CONTEXTS, WEIGHT_SETS, REFINEMENT_SETS)


@kernel(forceinline=True)
def _surroundings(v, first, centre, cells, planar, x, y, k, sums):
    """Fills sums int64 [4, C]. Returns (weight of the neighbours from `first` on that come before v, number of all neighbours).
    Weighted errors and weighted magnitudes of the former are below 2**15."""
    sums[:] = 0
    weight, count = np.int64(0), np.int64(0)
    for j in range(PLANAR_NEAR if planar else NEAR_CELLS.shape[0]):
        u = cells[centre + NEAR_CELLS[j]]
        if u < 0:
            continue
        count += 1
        for c in range(x.shape[1]):
            sums[VARIATION, c] += abs(np.int64(x[u, c]) - x[v, c])
        if first <= u < v:
            w = NEAR_WEIGHTS[j]
            weight += w
            for c in range(x.shape[1]):
                magnitude = abs(np.int64(k[u, c]))
                sums[ERRORS, c] += w * (np.int64(y[u, c]) - x[u, c])
                sums[MAGNITUDES, c] += w * magnitude
                sums[LARGEST, c] = max(sums[LARGEST, c], magnitude)
    return weight, count


@kernel(forceinline=True)
def _base(errors, weight):
    """Rounded mean error of the neighbours in sixteenths."""
    return (32 * errors + weight) // (2 * weight) if weight else np.int64(0)


@kernel(forceinline=True)
def _sign_class(v):
    return 0 if v == 0 else (1 if v > 0 else 2)


@kernel
def _residual_bits(encoding, coder, model, chosen, c, energy, activity, lead, second, largest, fraction, k):
    """Codes k of component c, or decodes it. Returns k. lead, second: k of the components coded before it, or 0."""
    where, sets = chosen.where, chosen.sets
    sets[1] = 3 * BITS + c * FINE + energy
    size, magnitude, negative = abs(k), np.int64(0), np.int64(0)
    beside = (c * 16 + min(abs(lead), 15)) * (FINE // 2) + (energy >> 1)
    while magnitude < BITS:
        i = magnitude
        where[0] = SIZE[0] + (c * FINE + energy) * BITS + i
        where[1] = SIZE[1] + (c * FINE + activity) * BITS + i
        where[2] = SIZE[2] + beside * BITS + i
        where[3] = SIZE[3] + (c * FINE + largest) * BITS + i
        where[4] = SIZE[4] + ((c * 8 + min(abs(lead), 7)) * 8 + min(abs(second), 7)) * BITS + i
        where[5] = SIZE[5] + ((c * 8 + (fraction >> 1)) * FINE + energy) * BITS + i
        sets[0] = sets[2] = c * BITS + i
        if not _mixed_bit(encoding, coder, model, MODELS, chosen, np.int64(1 if size > i else 0)):
            break
        magnitude += 1
        if i == 0:
            near = sets[1]
            where[0] = SIGN[0] + (c * 3 + _sign_class(lead)) * 3 + _sign_class(second)
            where[1] = SIGN[1] + c * 16 + fraction
            where[2] = SIGN[2] + (c * 3 + _sign_class(lead)) * 16 + fraction
            sets[0] = 3 * BITS + 3 * FINE + c
            sets[1] = 3 * BITS + 3 * FINE + 3 + fraction
            sets[2] = 3 * BITS + c
            negative = _mixed_bit(encoding, coder, model, SIGN_MODELS, chosen, np.int64(1 if k < 0 else 0))
            sets[1] = near
    if magnitude == BITS:
        if encoding:
            _enc_escape(coder.state, coder.buffer, size - BITS + 1)
            magnitude = size
        else:
            magnitude = min(_dec_escape(coder.state, coder.buffer, coder.end) + BITS - 1, np.int64(MAX_MAGNITUDE))
    return -magnitude if negative else magnitude


@kernel(allocates=True, inline="always")
def _residuals(encoding, coder, model, chosen, values, nodes, begin, stop):
    """Codes or decodes the residuals of the children of parents begin..stop-1, a whole slice. Fills values.y and values.k.
    Predictions are in 0..255, so |k| <= 255."""
    x, y, k, original, order, delta = values.x, values.y, values.k, values.original, values.order, values.delta
    cells, sums = np.empty(CELLS, np.int64), np.empty((4, x.shape[1]), np.int64)
    first, step = nodes.first_child[begin], 2 * delta + 1
    for p in range(begin, stop):
        _cells(p, 0, nodes.occupancy.shape[0], nodes.table, nodes.first_child, nodes.occupancy, nodes.planar, cells)
        for octant in range(8):
            if not (nodes.occupancy[p] >> octant) & 1:
                continue
            v = cells[CENTRE[octant]]
            weight, count = _surroundings(v, first, CENTRE[octant], cells, nodes.planar, x, y, k, sums)
            lead, second, surprise = np.int64(0), np.int64(0), np.int64(0)
            for j in range(order.shape[0]):
                c = order[j]
                base = _base(sums[ERRORS, c], weight)
                shift = base + ((values.cross[c] * surprise + 8) >> CROSS_FRACTION) + 8
                predicted = min(max(x[v, c] + (shift >> 4), 0), 255)
                energy = _fine(4 * sums[MAGNITUDES, c] // weight) if weight else np.int64(0)
                activity = _fine(sums[VARIATION, c] // max(count, 1))
                value = np.int64(0)
                if encoding:
                    d = np.int64(original[v, c]) - predicted
                    value = (abs(d) + delta) // step
                    value = -value if d < 0 else value
                value = _residual_bits(encoding, coder, model, chosen, c, energy, activity, lead, second,
                                       _fine(sums[LARGEST, c]), shift & 15, value)
                k[v, c] = value
                y[v, c] = min(max(predicted + value * step, 0), 255)
                if j == 0:
                    lead, surprise = value, 16 * (np.int64(y[v, c]) - x[v, c]) - base
                elif j == 1:
                    second = value


@kernel(allocates=True)
def _enc_residuals(coder, model, chosen, values, nodes, begin, stop):
    _residuals(True, coder, model, chosen, values, nodes, begin, stop)


@kernel(allocates=True)
def _dec_residuals(coder, model, chosen, values, nodes, begin, stop):
    _residuals(False, coder, model, chosen, values, nodes, begin, stop)


@kernel(allocates=True)
def _cross_sums(begin, stop, table, first_child, occupancy, planar, x, original, none, order, products):
    """Adds to products int64 [C] every component's surprise times the first component's, as if the original were decoded exactly.
    none: int16 [N, C] of zeros. |surprise| < 2**9."""
    cells, sums = np.empty(CELLS, np.int64), np.empty((4, x.shape[1]), np.int64)
    first = first_child[begin]
    for p in range(begin, stop):
        _cells(p, 0, occupancy.shape[0], table, first_child, occupancy, planar, cells)
        for octant in range(8):
            if not (occupancy[p] >> octant) & 1:
                continue
            v = cells[CENTRE[octant]]
            weight, _ = _surroundings(v, first, CENTRE[octant], cells, planar, x, original, none, sums)
            lead = np.int64(0)
            for j in range(order.shape[0]):
                c = order[j]
                surprise = 16 * (np.int64(original[v, c]) - x[v, c]) - _base(sums[ERRORS, c], weight)
                if j == 0:
                    lead = surprise
                products[c] += surprise * lead


def fit_cross(level: Level, table: np.ndarray, planar: int, x: np.ndarray, original: np.ndarray, ranges: list,
              run: Callable) -> list[int]:
    """Return by least squares how much of the first component's residual each component's prediction takes over: residual_cross
    [C]. level, table: Level and neighbour table of the voxels' parents; planar: as in Nodes; x: values before the residuals,
    original: their target, uint8 [N, C]; ranges: of parents, by slice; run: runs a list of jobs."""
    order, none = component_order(x.shape[1]), np.zeros(x.shape, np.int16)
    products = np.zeros((len(ranges), x.shape[1]), np.int64)
    run([partial(_cross_sums, *parents, table, level.first_child, level.occupancy, planar, x, original, none, order, row)
         for parents, row in zip(ranges, products, strict=True)])
    totals = [int(t) for t in products.sum(axis=0)]
    square = totals[order[0]]
    cross = [min(max((2 * MAX_CROSS * t + square) // (2 * square), 0), MAX_CROSS) if square else 0 for t in totals]
    cross[order[0]] = 0
    return cross


def code_residuals(coders: Sequence[Callable], level: Level, table: np.ndarray, planar: int, ranges: list, x: np.ndarray,
                   delta: int, cross: Sequence[int], original: np.ndarray, run: Callable) -> np.ndarray:
    """Code or decode the residuals of all slices and return the corrected values uint8 [N, C]. coders: for each slice a function
    of (walk, number of residuals) that calls walk(encoding, Coder, model); x: values before the residuals; delta: largest error;
    cross: residual_cross; original: the target, or x when decoding; the rest as in fit_cross()."""
    first_child = level.first_child
    assert first_child is not None
    nodes = Nodes(first_child, level.occupancy, level.weight, table, planar)
    values = Values(x, original, np.empty_like(x), np.empty(x.shape, np.int16), np.array(cross, np.int64),
                    component_order(x.shape[1]), delta)

    def job(coder, begin, stop):
        walk = lambda encoding, *coding: (_enc_residuals if encoding else _dec_residuals)(*coding, new_chosen(), values, nodes,
                                                                                        begin, stop)
        coder(walk, int(first_child[stop] - first_child[begin]) * x.shape[1])

    run([partial(job, coder, *parents) for coder, parents in zip(coders, ranges, strict=True)])
    return values.y
