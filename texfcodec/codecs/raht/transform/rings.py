"""Inputs of the filter of clause 7.7 at a voxel: the sums of its neighbours' differences, ring by ring, and the local
roughness."""

from typing import Any

import numpy as np

from ....core.integer import _ones
from ....core.kernel import kernel
from ..coefficients.mixed_contexts import _sixteenths
from .octree import CELLS, CENTRE, Level, _cells
from .quantise import MAX_MEAN

CLASSES = 5
ROUGHNESS_BOUNDS = np.array((4, 8, 16, 32))
COEFFICIENT_FRACTION = 9
RINGS = 3  # across faces, edges and corners
CHUNK = 1 << 13  # parents a task works on; fixed, so that the statistics do not depend on the number of threads
# Of each ring its cells, one bit each, among the 43 from the first neighbour of child 0 to its last
RING_MASKS = np.array([sum(1 << 16 * x + 4 * y + z for x in range(3) for y in range(3) for z in range(3)
                           if abs(x - 1) + abs(y - 1) + abs(z - 1) == away) for away in (1, 2, 3)])


@kernel(forceinline=True)
def _roughness_class(rough, inverse):
    """Class of a mean absolute luma difference; inverse: 2**32 // step of component 0."""
    sixteenths, cls = _sixteenths(rough, inverse), 0
    for bound in ROUGHNESS_BOUNDS:
        cls += 1 if sixteenths >= bound else 0
    return cls


@kernel(forceinline=True)
def _move(v, mean, coefficients, cls, taps, rings, filtered):
    """Filters voxel v. rings: int64 [C, taps]. |coefficient * ring| < 2**7 * 12 * 2**23."""
    for c in range(mean.shape[1]):
        change = np.int64(1 << (COEFFICIENT_FRACTION - 1))
        for r in range(taps):
            change += coefficients[cls, c, r] * rings[c, r]
        filtered[v, c] = min(max(mean[v, c] + (change >> COEFFICIENT_FRACTION), -MAX_MEAN), MAX_MEAN)


@kernel(forceinline=True)
def _count(v, mean, original, cls, taps, rings, products, targets):
    """Adds the products of the rings of voxel v, int64 [C, taps], to products float64 [CLASSES, C, taps, taps] and, times the
    voxel's error, to targets float64 [CLASSES, C, taps]."""
    for c in range(mean.shape[1]):
        error = np.float64(original[v, c]) - mean[v, c]
        for r in range(taps):
            targets[cls, c, r] += rings[c, r] * error
            for s in range(r + 1):
                products[cls, c, r, s] += np.float64(rings[c, r]) * rings[c, s]


@kernel(forceinline=True)
def _rings(cells, taken, octant, mean, rings):
    """Fills rings int64 [C, RINGS] for the child at `octant`. Returns (its number, mean absolute luma difference). cells, taken:
    of _cells."""
    before, last = CENTRE[octant] - CENTRE[0], mean.shape[1] - 1  # of two components, the second is summed twice
    v, near = cells[CENTRE[octant]], taken >> before
    rough, count = np.int64(0), np.int64(0)
    for r in range(RINGS):
        a = b = c = np.int64(0)
        left = near & RING_MASKS[r]
        count += _ones(left)
        while left:
            u = cells[before + _ones((left & -left) - 1)]
            left &= left - 1
            difference = np.int64(mean[u, 0]) - mean[v, 0]
            a += difference
            rough += abs(difference)
            if last:
                b += np.int64(mean[u, 1]) - mean[v, 1]
                c += np.int64(mean[u, last]) - mean[v, last]
        rings[0, r] = a
        if last:
            rings[1, r] = b
            rings[last, r] = c
    return v, rough // max(np.int64(1), count)


@kernel(allocates=True)
def _filter(begin, end, table, first_child, occupancy, mean, inverse, limits, coefficients, filtered):
    """Filters the children of parents begin..end-1. mean, filtered: int32 [N, C]; inverse: 2**32 // step of component 0; limits:
    unused, as planar_rings._filter has it."""
    cells, rings = np.zeros(CELLS, np.int64), np.zeros((mean.shape[1], RINGS), np.int64)
    for p in range(begin, end):
        taken = _cells(p, 0, occupancy.shape[0], table, first_child, occupancy, 0, cells)
        for octant in range(8):
            if (occupancy[p] >> octant) & 1:
                v, rough = _rings(cells, taken, octant, mean, rings)
                _move(v, mean, coefficients, _roughness_class(rough, inverse), RINGS, rings, filtered)


@kernel(allocates=True)
def _statistics(begin, end, table, first_child, occupancy, mean, inverse, limits, original, products, targets):
    """Adds to products and targets as _count does, for the voxels that _filter takes."""
    cells, rings = np.zeros(CELLS, np.int64), np.zeros((mean.shape[1], RINGS), np.int64)
    for p in range(begin, end):
        taken = _cells(p, 0, occupancy.shape[0], table, first_child, occupancy, 0, cells)
        for octant in range(8):
            if (occupancy[p] >> octant) & 1:
                v, rough = _rings(cells, taken, octant, mean, rings)
                _count(v, mean, original, _roughness_class(rough, inverse), RINGS, rings, products, targets)


class VoxelRings:
    """Voxels around each voxel, in rings by distance, which the filter reads. level, table: Level and neighbour table of the
    voxels' parents."""

    taps, pieces = RINGS, CHUNK

    def __init__(self, level: Level, table: np.ndarray) -> None:
        self.size, self.around = len(level), (table, level.first_child, level.occupancy)

    def filter(self, begin: int, end: int, *arguments: Any) -> None:
        """Filter the voxels whose parents are begin..end-1. arguments: mean (decoded), inverse, limits, coefficients and
        filtered of _filter, the last of which receives the result."""
        _filter(begin, end, *self.around, *arguments)

    def statistics(self, begin: int, end: int, *arguments: Any) -> None:
        """Add what a fit of coefficients needs of the voxels whose parents are begin..end-1 to the sums products and targets.
        arguments: mean (decoded), inverse, limits, original, products and targets of _statistics."""
        _statistics(begin, end, *self.around, *arguments)
