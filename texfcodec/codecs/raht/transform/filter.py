"""Adaptive Wiener filter on the decoded means of the voxels (spec clause 7.7): its application and the encoder's fit.

A voxel is moved towards the sums of its neighbours' differences across faces, edges and corners, with coefficients that depend on
how rough its surroundings are. The encoder takes those that bring the field nearest to the original, by least squares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ....core.integer import _ones32
from ....core.kernel import kernel
from ..coefficients.mixed_contexts import _sixteenths
from .octree import CELLS, CENTRE, Level, _cells
from .quantise import MAX_MEAN

CLASSES = 5
RINGS = 3
PLANAR_TAPS = 5  # faces and edges, the texels two away, faces and edges limited (7.11.3)
RING_SIZES = np.array((6, 12, 8))
_OFFSETS = [(abs(x) + abs(y) + abs(z), 16 * x + 4 * y + z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
RING_CELLS = np.array([([cell for away, cell in _OFFSETS if away == r] + 12 * [0])[:12] for r in (1, 2, 3)])
ROUGHNESS_BOUNDS = np.array((4, 8, 16, 32))
COEFFICIENT_FRACTION = 9
MAX_COEFFICIENT = 127
COEFFICIENT_BITS = 8 * RINGS  # what a class of a component costs in supports that are not planar
LIMIT_SHIFT = 2  # differences are limited to a quarter of a step
FACE_STEPS, EDGE_STEPS = np.array((-16, -4, 4, 16)), np.array((-20, -12, 12, 20))  # from cell to cell, z = 0
FACE_NODES = np.array((4, 10, 16, 22))  # of a node's neighbour table, z = 0
CHUNK = 1 << 13  # parents a task works on; fixed, so that the statistics do not depend on the number of threads


@dataclass
class FilterStage:
    """One stage. mask: which class * C + component have coefficients; coefficients: int64 [CLASSES, C, RINGS or
    PLANAR_TAPS], zero elsewhere."""

    mask: int
    coefficients: np.ndarray = field(repr=False)


def stage_of(mask: int, taps: Sequence[int], components: int) -> FilterStage:
    """FilterStage from the syntax elements of clause 5.7.3."""
    of_each = len(taps) // mask.bit_count() if mask else RINGS
    flat = np.zeros((CLASSES * components, of_each), np.int64)
    flat[[i for i in range(CLASSES * components) if mask >> i & 1]] = np.reshape(taps, (-1, of_each))
    return FilterStage(mask, flat.reshape(CLASSES, components, of_each))


def taps_of(stage: FilterStage) -> list[int]:
    """The coefficients of a stage as they stand in the stream."""
    flat = stage.coefficients.reshape(-1, stage.coefficients.shape[2])
    return [int(v) for i in range(len(flat)) if stage.mask >> i & 1 for v in flat[i]]


@kernel(forceinline=True)
def _rings(cells, octant, mean, ring):
    """Fills ring int64 [C, 3] for the child at `octant`; returns (its number, mean absolute luma difference)."""
    centre = CENTRE[octant]
    v, last = cells[centre], mean.shape[1] - 1  # of two components, the second is summed twice
    rough, count = np.int64(0), np.int64(0)
    for r in range(RINGS):
        a = b = c = np.int64(0)
        for j in range(RING_SIZES[r]):
            u = cells[centre + RING_CELLS[r, j]]
            count += 1 if u >= 0 else 0
            u = u if u >= 0 else v  # adds nothing; a branch here would be mispredicted half the time
            difference = np.int64(mean[u, 0]) - mean[v, 0]
            a += difference
            rough += abs(difference)
            if last:
                b += np.int64(mean[u, 1]) - mean[v, 1]
                c += np.int64(mean[u, last]) - mean[v, last]
        ring[0, r] = a
        if last:
            ring[1, r] = b
            ring[last, r] = c
    return v, rough // max(np.int64(1), count)


@kernel(forceinline=True)
def _limited(v, limit):
    return min(max(v, -limit), limit)


@kernel
def _planar_rings(p, octant, table, first_child, occupancy, cells, mean, limits, ring):
    """Fills ring int64 [C, PLANAR_TAPS] for the texel at `octant` of p; returns (its number, mean absolute luma difference).
    limits: int64 [C]. Sums of four differences, each < 2**23."""
    ring[:] = 0
    centre = CENTRE[octant]
    v = cells[centre]
    rough, count = np.int64(0), np.int64(0)
    for i in range(4):
        for tap in range(2):
            u = cells[centre + (FACE_STEPS[i] if tap == 0 else EDGE_STEPS[i])]
            if u < 0:
                continue
            count += 1
            rough += abs(np.int64(mean[u, 0]) - mean[v, 0])
            for c in range(mean.shape[1]):
                difference = np.int64(mean[u, c]) - mean[v, c]
                ring[c, tap] += difference
                ring[c, 3 + tap] += _limited(difference, limits[c])
        q = np.int64(table[p, FACE_NODES[i]])
        if q >= 0 and (occupancy[q] >> octant) & 1:
            u = first_child[q] + _ones32(np.int64(occupancy[q]) & ((1 << octant) - 1))
            for c in range(mean.shape[1]):
                ring[c, 2] += np.int64(mean[u, c]) - mean[v, c]
    return v, rough // max(np.int64(1), count)


@kernel
def _roughness_class(rough, inverse):
    sixteenths, cls = _sixteenths(rough, inverse), 0
    while cls < CLASSES - 1 and sixteenths >= ROUGHNESS_BOUNDS[cls]:
        cls += 1
    return cls


@kernel(allocates=True)
def _filter(begin, end, table, first_child, occupancy, mean, inverse, limits, coefficients, filtered):
    """Filters the children of parents begin..end-1. mean, filtered: int32 [N, C]; inverse: 2**32 // step of component 0; limits:
    int64 [C], of use with PLANAR_TAPS.
    |coefficient * ring| < 2**7 * 12 * 2**23."""
    taps = coefficients.shape[2]
    cells, ring = np.zeros(CELLS, np.int64), np.zeros((mean.shape[1], taps), np.int64)
    for p in range(begin, end):
        _cells(p, 0, occupancy.shape[0], table, first_child, occupancy, 1 if taps == PLANAR_TAPS else 0, cells)
        for octant in range(8):
            if not (occupancy[p] >> octant) & 1:
                continue
            if taps == PLANAR_TAPS:
                v, rough = _planar_rings(p, octant, table, first_child, occupancy, cells, mean, limits, ring)
            else:
                v, rough = _rings(cells, octant, mean, ring)
            cls = _roughness_class(rough, inverse)
            for c in range(mean.shape[1]):
                change = np.int64(1 << (COEFFICIENT_FRACTION - 1))
                for r in range(taps):
                    change += coefficients[cls, c, r] * ring[c, r]
                filtered[v, c] = min(max(mean[v, c] + (change >> COEFFICIENT_FRACTION), -MAX_MEAN), MAX_MEAN)


@kernel(allocates=True)
def _statistics(begin, end, table, first_child, occupancy, mean, original, inverse, limits, products, targets):
    """Adds up products float64 [CLASSES, C, T, T] of the T rings and targets float64 [CLASSES, C, T] of rings times error."""
    taps = targets.shape[2]
    cells, ring = np.zeros(CELLS, np.int64), np.zeros((mean.shape[1], taps), np.int64)
    for p in range(begin, end):
        _cells(p, 0, occupancy.shape[0], table, first_child, occupancy, 1 if taps == PLANAR_TAPS else 0, cells)
        for octant in range(8):
            if not (occupancy[p] >> octant) & 1:
                continue
            if taps == PLANAR_TAPS:
                v, rough = _planar_rings(p, octant, table, first_child, occupancy, cells, mean, limits, ring)
            else:
                v, rough = _rings(cells, octant, mean, ring)
            cls = _roughness_class(rough, inverse)
            for c in range(mean.shape[1]):
                error = np.float64(original[v, c]) - mean[v, c]
                for r in range(taps):
                    targets[cls, c, r] += ring[c, r] * error
                    for s in range(r + 1):
                        products[cls, c, r, s] += np.float64(ring[c, r]) * ring[c, s]


def _chunks(parents):
    return [(b, min(b + CHUNK, parents)) for b in range(0, parents, CHUNK)]


def apply_stage(stage: FilterStage, level: Level, table: np.ndarray, mean: np.ndarray, steps: np.ndarray,
                run: Callable) -> np.ndarray:
    """One stage over all voxels: int32 [N, C]. level, table: of their parents; steps: int64 [C]; run: function that runs a
    list of jobs."""
    filtered = np.empty_like(mean)
    factors = (1 << 32) // int(steps[0]), steps >> LIMIT_SHIFT, stage.coefficients
    run([partial(_filter, b, e, table, level.first_child, level.occupancy, mean, *factors, filtered)
         for b, e in _chunks(len(level))])
    return filtered


def _solve(products, targets):
    """Ridge solution of a symmetric system whose lower triangle is given, by elimination in plain floats: no linear-algebra
    library may decide a bit of the stream. The taps of planar supports differ so much that each has a ridge of its own."""
    n = range(len(targets))
    ridge = [1e-6 * float(np.trace(products))] * RINGS if len(n) == RINGS else [1 + 1e-6 * float(products[i, i]) for i in n]
    a = [[float(products[max(i, j), min(i, j)]) + (ridge[i] if i == j else 0.0) for j in n] for i in n]
    x = [float(t) for t in targets]
    for i in n:
        for j in range(i + 1, len(n)):
            factor = a[j][i] / a[i][i]
            a[j] = [u - factor * v for u, v in zip(a[j], a[i], strict=True)]
            x[j] -= factor * x[i]
    for i in reversed(n):
        x[i] = (x[i] - sum(a[i][j] * x[j] for j in range(i + 1, len(n)))) / a[i][i]
    return x


def fit_stage(level: Level, table: np.ndarray, mean: np.ndarray, original: np.ndarray, steps: np.ndarray, lagrangian: float,
              run: Callable, taps: int = RINGS) -> FilterStage | None:
    """The stage that brings mean nearest to original, int32 [N, C] both; None where nothing is worth its bits. steps: int64 [C];
    lagrangian: bits per squared step; taps: RINGS or PLANAR_TAPS."""
    components = mean.shape[1]
    chunks = _chunks(len(level))
    parts = [(np.zeros((CLASSES, components, taps, taps)), np.zeros((CLASSES, components, taps))) for _ in chunks]
    factors = (1 << 32) // int(steps[0]), steps >> LIMIT_SHIFT
    run([partial(_statistics, b, e, table, level.first_child, level.occupancy, mean, original, *factors, *part)
         for (b, e), part in zip(chunks, parts, strict=True)])
    mask, coefficients = 0, np.zeros((CLASSES, components, taps), np.int64)
    for k in range(CLASSES):
        for c in range(components):
            products, targets = sum(p[k, c] for p, _ in parts), sum(t[k, c] for _, t in parts)
            if not products.trace() > 0:
                continue
            unit = 1 << COEFFICIENT_FRACTION
            fitted = np.clip(np.rint(np.array(_solve(products, targets)) * unit), -MAX_COEFFICIENT, MAX_COEFFICIENT)
            x, full = fitted / unit, products + np.tril(products, -1).T
            gain = (2 * (targets * x).sum() - (full * x[:, None] * x[None, :]).sum()) / float(steps[c]) ** 2
            if gain * lagrangian > 8 * taps:
                mask |= 1 << (k * components + c)
                coefficients[k, c] = fitted
    return FilterStage(mask, coefficients) if mask else None
