"""Prediction of a block's children from the decoded neighbourhood (spec clause 7.3).

A child is predicted by a weighted mean of its own parent, of the seven parents that touch the child's corner of it and, where
those have been decoded before, of their children that touch the child. Seven weights form a kernel:
[parent, face parent, edge parent, corner parent, face child, edge child, corner child]. Neighbours of another colour than the
parent's weigh less, the less the farther they are away (a colour range, in steps).
"""

from collections import namedtuple
from itertools import product

import numpy as np

from ....core.kernel import kernel
from .octree import CELL_STEPS, CELLS, NEIGHBOUR_STEPS, NEIGHBOURS, _cells

KERNEL_SIZE = 7
# From smooth photographs to flat colours with sharp edges. BD-rate RGB against G-PCC over QP 28 and 40 on basket, scissors, cat,
# Mars, water bottle, before the tools of today and with 1 for the second's 4: smoothest -1, -13, -10, -10, +22 %; second -1,
# -16, -8, -9, +11 %; third +11, -9, +3, +1, 0 %; sharpest +57, +29, +38, +31, -21 %.
KERNELS = ((64, 32, 4, 1, 48, 16, 4), (64, 24, 4, 0, 32, 8, 0), (64, 12, 0, 0, 16, 4, 0), (64, 2, 0, 0, 4, 0, 0))
DEFAULT_KERNEL = KERNELS[1]
FALLOFF = np.array((64, 64, 63, 62, 60, 58, 56, 53, 50, 47, 43, 40, 36, 33, 30, 27, 24, 21, 18, 16, 13, 11, 10, 8, 7, 6, 5, 4, 3,
                    2, 2))
FALLOFF_SHIFT = 28
# Decoded means, int32 with 12 fractional bits: parent [n, C], whole; child [children, C], as far as the walk has come
Means = namedtuple("Means", "parent child")
# Scratch of a prediction: weight int64 [27] of the neighbouring parents; cells and cell_weight int64 [64]
Around = namedtuple("Around", "weight cells cell_weight")


def new_around() -> Around:
    """Around without meaning yet."""
    return Around(*(np.zeros(n, np.int64) for n in (NEIGHBOURS, CELLS, CELLS)))


def inverse_range(colour_range: int, step: int) -> int:
    """Factor from a colour difference to 2**28 entries of FALLOFF; 0 where the colour does not count."""
    return (1 << 32) // (colour_range * step) if colour_range else 0


@kernel(forceinline=True)
def _falloff(means, node, parent_mean, p, inverse):
    """Weight of a node's means beside those of parent p, in 1/64 (spec 7.3)."""
    difference = np.int64(0)
    for c in range(means.shape[1]):
        difference += abs(np.int64(means[node, c]) - parent_mean[p, c])
    return FALLOFF[min((difference * inverse) >> FALLOFF_SHIFT, FALLOFF.shape[0] - 1)]


def _touching():
    """For child o of a parent and the axes m = 1..7 that a step crosses: int64 [8, 8] the neighbour table's entry; of the
    children there that touch the child, int64 [8, 8, 4] the cells, int64 [8] how many, int64 [8, 8, 4] the kernel's entries."""
    across, cells, entries = np.zeros((8, 8), np.int64), np.zeros((8, 8, 4), np.int64), np.zeros((8, 8, 4), np.int64)
    counts = np.zeros(8, np.int64)
    for o, m in product(range(8), range(1, 8)):
        bits = [(o >> axis & 1, m >> axis & 1) for axis in range(3)]
        across[o, m] = 13 + sum(scale * crossed * (2 * bit - 1) for scale, (bit, crossed) in zip((9, 3, 1), bits, strict=True))
        axes = [[(3 * bit, 1)] if crossed else [(1 + bit, 0), (2 - bit, 1)] for bit, crossed in bits]
        places = list(product(*axes))
        counts[m] = len(places)
        for j, place in enumerate(places):
            cells[o, m, j] = sum(scale * x for scale, (x, _) in zip((16, 4, 1), place, strict=True))
            entries[o, m, j] = 3 + sum(step for _, step in place)
    return across, cells, counts, entries


ACROSS, TOUCHING_CELL, TOUCHING, TOUCHING_ENTRY = _touching()


@kernel
def _weigh_parents(p, first, table, parent_mean, inverse, planar, weight):
    """Fills weight int64 [27]: that of each neighbouring parent whose children are not decoded yet, 0 for the others."""
    for i in range(planar, NEIGHBOURS, NEIGHBOUR_STEPS[planar]):
        q = table[p, i]
        weight[i] = 0
        if q >= 0 and (q < first or q > p):
            weight[i] = _falloff(parent_mean, q, parent_mean, p, inverse) if inverse else 64


@kernel(forceinline=True)
def _predict(p, first, nodes, means, kernel, inverse, around, predicted):
    """Fills predicted int64 [8, C] for the children of parent p, 0 where there is none (spec 7.3.2).

    first: first parent of the slice; children of parents first..p-1 are decoded. The table's entries are below
    len(occupancy) = len(means.parent) by construction. kernel: int64 [7]; inverse: of inverse_range; around: scratch.
    |sum| < 27 * 64 * 255 * 2**23 < 2**42.
    """
    table, parent_mean, child_mean, planar = nodes.table, means.parent, means.child, nodes.planar
    weight, cells, cell_weight = around.weight, around.cells, around.cell_weight
    last = parent_mean.shape[1] - 1  # of two components, the second is summed twice: quicker than a loop over components
    skipped = 0 if kernel[6] else 1  # the last place of each m is a corner child, m = 7 the corner parent
    directions = 4 if planar else (7 if kernel[3] == 0 and kernel[6] == 0 else 8)
    _weigh_parents(p, first, table, parent_mean, inverse, planar, weight)
    _cells(p, first, p, table, nodes.first_child, nodes.occupancy, planar, cells)
    for i in range(planar, CELLS, CELL_STEPS[planar]):
        if cells[i] >= 0:
            cell_weight[i] = _falloff(child_mean, cells[i], parent_mean, p, inverse) if inverse else 64
    for octant in range(8):
        if not (nodes.occupancy[p] >> octant) & 1:
            predicted[octant] = 0
            continue
        total = 64 * kernel[0]
        a, b, c = total * parent_mean[p, 0], np.int64(0), np.int64(0)
        if last:
            b, c = total * parent_mean[p, 1], total * parent_mean[p, last]
        for m in range(1, directions):
            i = ACROSS[octant, m]
            if weight[i]:
                w, q = kernel[(m & 1) + ((m >> 1) & 1) + (m >> 2)] * weight[i], table[p, i]
                total += w
                a += w * parent_mean[q, 0]
                if last:
                    b += w * parent_mean[q, 1]
                    c += w * parent_mean[q, last]
                continue
            for j in range(TOUCHING[m] - skipped):
                cell = TOUCHING_CELL[octant, m, j]
                child = cells[cell]
                if child < 0:
                    continue
                w = kernel[TOUCHING_ENTRY[octant, m, j]] * cell_weight[cell]
                total += w
                a += w * child_mean[child, 0]
                if last:
                    b += w * child_mean[child, 1]
                    c += w * child_mean[child, last]
        predicted[octant, 0] = (2 * a + total) // (2 * total)
        if last:
            predicted[octant, 1] = (2 * b + total) // (2 * total)
            predicted[octant, last] = (2 * c + total) // (2 * total)
