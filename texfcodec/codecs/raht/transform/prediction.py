"""Prediction of a block's children from the decoded neighbourhood (spec clause 7.3).

The prediction of a child is a weighted mean of its own parent, of the seven parents that touch the child's corner of it and, if
those were decoded before, of their children that touch the child. Seven weights form a kernel: [parent, face parent, edge parent,
corner parent, face child, edge child, corner child]. The weight of a neighbour decreases with the difference of its colour from
the parent's (a colour range, in steps).
"""

from collections import namedtuple
from itertools import product

import numpy as np

from ....core.integer import _ones
from ....core.kernel import kernel
from .octree import ADJACENT, ADJACENT_CELL, ADJACENT_PLACE, CENTRE, COLUMNS, CORNERS, DIRECTIONS, PLANAR_DIRECTIONS, STEPS

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


def inverse_range(colour_range: int, step: int) -> int:
    """Return the factor from a colour difference to an index into FALLOFF, the weights of predicting nodes, with 28 fractional
    bits; 0 if colour has no influence. colour_range: syntax element, in units of step, the quantiser's."""
    return (1 << 32) // (colour_range * step) if colour_range else 0


@kernel(forceinline=True)
def _falloff(means, node, parent_mean, p, inverse):
    """Weight of a node by its colour difference to parent p, in 1/64 (spec 7.3)."""
    difference = np.int64(0)
    for c in range(means.shape[1]):
        difference += abs(np.int64(means[node, c]) - parent_mean[p, c])
    return FALLOFF[min((difference * inverse) >> FALLOFF_SHIFT, FALLOFF.shape[0] - 1)]


def _touched():
    """Children that the neighbours of DIRECTIONS touch, int64 [26, 4], 4 >> s - 1 of them for a neighbour s steps away; the
    kernel's entries by place (ADJACENT_PLACE) and child, int64 [26, 4, 4]."""
    children, entries = np.zeros((len(DIRECTIONS), 4), np.int64), np.zeros((len(DIRECTIONS), 4, 4), np.int64)
    for k, i in enumerate(DIRECTIONS.tolist()):
        x, y, z = ((0, 1) if d == 1 else (d // 2,) for d in (i // 9, i // 3 % 3, i % 3))
        for t, (a, b, c) in enumerate(product(x, y, z)):
            children[k, t] = a + 2 * b + 4 * c
            for j in range(ADJACENT[i]):
                cell, own = int(ADJACENT_CELL[i, j]), int(CENTRE[children[k, t]])
                entries[k, j, t] = 3 + sum(cell // scale % 4 != own // scale % 4 for scale in (16, 4, 1))
    return children, entries


TOUCHED, TOUCHED_ENTRY = _touched()


@kernel(forceinline=True)
def _add(sums, octant, w, means, node):
    """Adds w and w times a node's means to sums[octant]. The second of two components is added twice, which is faster than a
    loop."""
    sums[octant, 3] += w
    sums[octant, 0] += w * means[node, 0]
    if means.shape[1] > 1:
        sums[octant, 1] += w * means[node, 1]
        sums[octant, 2] += w * means[node, means.shape[1] - 1]


@kernel(forceinline=True)
def _predict(p, first, nodes, means, kernel, inverse, sums, predicted):
    """Fills predicted int64 [8, C] for the children of parent p, 0 for absent ones (spec 7.3.2).

    first: first parent of the slice; children of parents first..p-1 are decoded. The table's entries are below len(occupancy) =
    len(means.parent) by construction. kernel: int64 [7]; inverse: of inverse_range; sums: int64 [8, 4], scratch: weighted means
    and, last, weights of every child. |sum| < 27 * 64 * 255 * 2**23 < 2**42.

    Each neighbour is visited once and adds to the children that it touches, because most neighbours on a surface are empty.
    """
    table, parent_mean, child_mean = nodes.table, means.parent, means.child
    own, last, octants = 64 * kernel[0], parent_mean.shape[1] - 1, 4 if nodes.planar else 8
    sums[0, 0], sums[0, 1], sums[0, 2], sums[0, 3] = 0, 0, 0, 0
    _add(sums, 0, own, parent_mean, p)
    for octant in range(1, octants):
        for i in range(4):
            sums[octant, i] = sums[0, i]
    directions = PLANAR_DIRECTIONS if nodes.planar else (CORNERS if kernel[3] == 0 and kernel[6] == 0 else DIRECTIONS.shape[0])
    for i in range(directions):
        entry = DIRECTIONS[i]
        q, touched = np.int64(table[p, COLUMNS[nodes.planar, entry]]), 4 >> (STEPS[i] - 1)
        if q < 0:
            continue
        if q < first or q > p:
            w = kernel[STEPS[i]] * (_falloff(parent_mean, q, parent_mean, p, inverse) if inverse else 64)
            for t in range(touched):
                _add(sums, TOUCHED[i, t], w, parent_mean, q)
            continue
        taken, child = np.int64(nodes.occupancy[q]), nodes.first_child[q]
        for j in range(ADJACENT[entry]):
            place = ADJACENT_PLACE[entry, j]
            if not (taken >> place) & 1:
                continue
            node = child + _ones(taken & ((1 << place) - 1))
            w = _falloff(child_mean, node, parent_mean, p, inverse) if inverse else 64
            for t in range(touched):
                _add(sums, TOUCHED[i, t], w * kernel[TOUCHED_ENTRY[i, j, t]], child_mean, node)
    for octant in range(octants):
        if not (nodes.occupancy[p] >> octant) & 1:
            predicted[octant] = 0
            continue
        total = sums[octant, 3]
        predicted[octant, 0] = (2 * sums[octant, 0] + total) // (2 * total)
        if last:
            predicted[octant, 1] = (2 * sums[octant, 1] + total) // (2 * total)
            predicted[octant, last] = (2 * sums[octant, 2] + total) // (2 * total)
