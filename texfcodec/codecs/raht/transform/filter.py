"""Adaptive Wiener filter on the decoded means of the voxels (spec clause 7.7): its application and the encoder's fit.

A voxel moves by the weighted sums of its neighbours' differences across faces, edges and corners. The coefficients depend on the
local roughness. The encoder fits them to the original by least squares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from .octree import Octree
from .planar_rings import TexelRings
from .rings import CLASSES, COEFFICIENT_FRACTION, RINGS, VoxelRings

MAX_COEFFICIENT = 127
COEFFICIENT_BITS = 8 * RINGS  # what a class of a component costs in supports that are not planar
LIMIT_SHIFT = 2  # differences are limited to a quarter of a step
# Pieces that a fit looks at, at least; else one of EVERY. All pieces take 10 to 20 bytes less or more of half a million.
FEWEST, EVERY = 16, 4
AT_ONCE = 8  # pieces that a task filters; of a fit each is a task, because sums of floats depend on it


@dataclass
class FilterStage:
    """Coefficients of one stage of the filter after decoding (7.7). mask: bit class * C + component is set if that pair has
    coefficients; coefficients: int64 [CLASSES, C, RINGS or PLANAR_TAPS], zero elsewhere."""

    mask: int
    coefficients: np.ndarray = field(repr=False)


def stage_of(mask: int, taps: Sequence[int], components: int) -> FilterStage:
    """Build the FilterStage from the syntax elements of clause 5.7.3. mask: filter_mask; taps: filter_coefficients; components:
    C of the values."""
    of_each = len(taps) // mask.bit_count() if mask else RINGS
    flat = np.zeros((CLASSES * components, of_each), np.int64)
    flat[[i for i in range(CLASSES * components) if mask >> i & 1]] = np.reshape(taps, (-1, of_each))
    return FilterStage(mask, flat.reshape(CLASSES, components, of_each))


def taps_of(stage: FilterStage) -> list[int]:
    """Return the coefficients of a stage in stream order, filter_coefficients."""
    flat = stage.coefficients.reshape(-1, stage.coefficients.shape[2])
    return [int(v) for i in range(len(flat)) if stage.mask >> i & 1 for v in flat[i]]


def rings_of(octree: Octree) -> VoxelRings | TexelRings:
    """Return the neighbourhoods that the filter reads, in rings around each voxel or texel, cached in the octree. The octree has
    at least two levels."""
    if octree.rings is None:
        octree.rings = (TexelRings(octree.keys) if octree.planar
                        else VoxelRings(octree.levels[-2], octree.table(len(octree.levels) - 2)))
    return octree.rings


def _pieces(rings, at_once=1):
    size = at_once * rings.pieces
    return [(b, min(b + size, rings.size)) for b in range(0, rings.size, size)]


def apply_stage(stage: FilterStage, rings: VoxelRings | TexelRings, mean: np.ndarray, steps: np.ndarray,
                run: Callable) -> np.ndarray:
    """Filter the decoded means of all voxels or texels by one stage: int32 [N, C]. rings: of rings_of(); mean: int32 [N, C];
    steps: int64 [C], quantiser steps; run: runs a list of jobs."""
    if not stage.mask:
        return mean
    filtered = np.empty_like(mean)
    factors = (1 << 32) // int(steps[0]), steps >> LIMIT_SHIFT, stage.coefficients
    run([partial(rings.filter, b, e, mean, *factors, filtered) for b, e in _pieces(rings, AT_ONCE)])
    return filtered


def _solve(products, targets):
    """Ridge solution of a symmetric system, given its lower triangle, by elimination in plain floats: no linear-algebra library
    may determine a bit of the stream. The taps of planar supports differ so much that each has its own ridge."""
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


def fit_stage(rings: VoxelRings | TexelRings, mean: np.ndarray, original: np.ndarray, steps: np.ndarray, lagrangian: float,
              run: Callable) -> FilterStage | None:
    """Fit the stage that brings mean nearest to original, both int32 [N, C]; None if no coefficients are worth their bits.
    rings: of rings_of(); steps: int64 [C], quantiser steps; lagrangian: bits per squared step; run: runs a list of jobs."""
    components, taps, pieces = mean.shape[1], rings.taps, _pieces(rings)
    every = min(max(len(pieces) // FEWEST, 1), EVERY)
    pieces = pieces[every // 2 :: every]
    parts = [(np.zeros((CLASSES, components, taps, taps)), np.zeros((CLASSES, components, taps))) for _ in pieces]
    factors = (1 << 32) // int(steps[0]), steps >> LIMIT_SHIFT, original
    run([partial(rings.statistics, b, e, mean, *factors, *part) for (b, e), part in zip(pieces, parts, strict=True)])
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
            if every * gain * lagrangian > 8 * taps:
                mask |= 1 << (k * components + c)
                coefficients[k, c] = fitted
    return FilterStage(mask, coefficients) if mask else None
