"""Prediction of the other components from the first (spec clause 7.4.4). Once component 0 of a block is decoded, the predictions
of the others move with it, in the ratio in which they move with it around the block."""

import numpy as np

from ....core.integer import _ones
from ....core.kernel import kernel
from ..transform.octree import ADJACENT, ADJACENT_PLACE, COLUMNS, NEIGHBOUR_STEPS, NEIGHBOURS
from ..transform.quantise import MAX_MEAN
from ..transform.raht import _inverse

LEAST_SPREAD = 2  # a spread of so many quarter steps squared, log2, draws the factor to 0
CROSS_FRACTION = 8
MAX_FACTOR = 512  # 2 with CROSS_FRACTION bits


@kernel(forceinline=True)
def _add_products(means, node, parent_mean, p, products):
    """Adds to products int64 [C] each component's difference between a node and parent p, multiplied by that of component 0. At
    most 82 such products, each < 2**46."""
    lead = np.int64(means[node, 0]) - parent_mean[p, 0]
    for c in range(products.shape[0]):
        products[c] += lead * (np.int64(means[node, c]) - parent_mean[p, c])


@kernel(forceinline=True)
def _follow(p, first, rules, blocks, s):
    """Moves the predictions of components 1.. of block p by the coefficients of component 0, times their slope over the
    surroundings (spec 7.4.4). The numerator of a factor is < 2**53 * 2**8, the details < 2**25."""
    mean, child_mean, table, tree, products = blocks.means.parent, blocks.means.child, blocks.nodes.table, s.tree, s.products
    planar = blocks.nodes.planar
    products[:] = 0
    for i in range(planar, NEIGHBOURS, NEIGHBOUR_STEPS[planar]):
        q = np.int64(table[p, COLUMNS[planar, i]])
        if q < 0 or q == p:
            continue
        if q < first or q > p:
            _add_products(mean, q, mean, p, products)
            continue
        taken, child = np.int64(blocks.nodes.occupancy[q]), blocks.nodes.first_child[q]
        for j in range(ADJACENT[i]):
            place = ADJACENT_PLACE[i, j]
            if (taken >> place) & 1:
                _add_products(child_mean, child + _ones(taken & ((1 << place) - 1)), mean, p, products)
    spread = products[0] + ((rules.steps[0] * rules.steps[0]) >> LEAST_SPREAD)
    _inverse(tree, s.q, 0, np.int64(0), rules.steps[0], s.values, rules.rotated)
    for c in range(1, products.shape[0]):
        factor = min(max((products[c] * rules.cross << 4) // spread, -MAX_FACTOR), MAX_FACTOR)
        for octant in range(8):
            if tree[7 + octant]:
                v = s.predicted[octant, c] + ((factor * s.values[7 + octant, 0] + (1 << (CROSS_FRACTION - 1))) >> CROSS_FRACTION)
                s.predicted[octant, c] = min(max(v, -MAX_MEAN), MAX_MEAN)
