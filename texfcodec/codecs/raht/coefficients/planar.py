"""What the blocks of a planar support have besides (spec clause 7.11): a block there has at most four children, with z = 0.

The other components follow what component 0 has told about a block; and contexts know the coefficients of the same split in the
blocks around, which a surface in space seldom has.
"""

import numpy as np

from ....core.kernel import kernel
from ..transform.octree import CELLS, NEIGHBOURS
from ..transform.quantise import MAX_MEAN
from ..transform.raht import PLANAR_NODES, _inverse

LEAST_SPREAD = 2  # a spread of so many quarter steps squared, log2, draws the factor to 0
CROSS_FRACTION = 8
MAX_FACTOR = 512  # 2 with CROSS_FRACTION bits
MOST = 2  # larger coefficients are alike
ALIKE, ALIKE_SIGNS = (MOST + 1) ** 4, 9  # values of Scratch.alike and Scratch.alike_signs
WEST, NORTH, NORTH_WEST, NORTH_EAST, SOUTH_WEST = 4, 10, 1, 19, 7  # of a block in its neighbour table


def new_kept(nodes: int, components: int, planar: int) -> np.ndarray:
    """Coefficients of blocks that later ones look at: zeros int8 [nodes, 3, C], no rows where the support is not planar."""
    return np.zeros((nodes if planar else 0, len(PLANAR_NODES), components), np.int8)


@kernel(forceinline=True, allocates=False)
def _keep(p, blocks, s):
    """Leaves the coefficients of block p, cut to -MOST..MOST, for the blocks after it and below it."""
    for c in range(s.q.shape[1]):
        for j in range(PLANAR_NODES.shape[0]):
            blocks.kept[p, j, c] = min(max(s.q[PLANAR_NODES[j], c], -MOST), MOST)


@kernel(forceinline=True, allocates=False)
def _sign_class(v):
    return 0 if v == 0 else (1 if v > 0 else 2)


@kernel(forceinline=True, allocates=False)
def _look_around(p, first, c0, c1, blocks, s):
    """Fills s.alike and s.alike_signs, int64 [7, C], for the splits of components c0..c1-1 (spec 7.11.3)."""
    table, kept = blocks.nodes.table, blocks.kept
    for c in range(c0, c1):
        for j in range(PLANAR_NODES.shape[0]):
            west = north = corners = np.int64(0)
            q = np.int64(table[p, WEST])
            if q >= first:
                west = np.int64(kept[q, j, c])
            q = np.int64(table[p, NORTH])
            if q >= first:
                north = np.int64(kept[q, j, c])
            for i in (NORTH_WEST, NORTH_EAST, SOUTH_WEST):
                q = np.int64(table[p, i])
                if first <= q < p:
                    corners += abs(np.int64(kept[q, j, c]))
            node, above = PLANAR_NODES[j], abs(np.int64(blocks.kept_above[p, j, c]))
            s.alike[node, c] = 27 * abs(west) + 9 * abs(north) + 3 * min(corners, np.int64(MOST)) + above
            s.alike_signs[node, c] = 3 * _sign_class(west) + _sign_class(north)


@kernel(forceinline=True, allocates=False)
def _add_products(means, node, parent_mean, p, products):
    """Adds to products int64 [C] the products of a node's differences to parent p, each with that of component 0: 20 of them
    at most, each < 2**46."""
    lead = np.int64(means[node, 0]) - parent_mean[p, 0]
    for c in range(products.shape[0]):
        products[c] += lead * (np.int64(means[node, c]) - parent_mean[p, c])


@kernel(forceinline=True, allocates=False)
def _follow(p, first, rules, blocks, s):
    """Moves the predictions of components 1.. of block p with the coefficients of component 0, by the slope that they have over
    its surroundings (spec 7.11.2). The numerator of a factor is < 2**51 * 2**9, the details < 2**25."""
    mean, child_mean, table, tree, products = blocks.means.parent, blocks.means.child, blocks.nodes.table, s.tree, s.products
    products[:] = 0
    for i in range(NEIGHBOURS):
        q = np.int64(table[p, i])
        if q >= 0 and (q < first or q > p):
            _add_products(mean, q, mean, p, products)
    for i in range(CELLS):
        q = s.around.cells[i]
        if q >= 0:
            _add_products(child_mean, q, mean, p, products)
    spread = products[0] + ((rules.steps[0] * rules.steps[0]) >> LEAST_SPREAD)
    _inverse(tree, s.q, 0, np.int64(0), rules.steps[0], s.values, rules.rotated)
    for c in range(1, products.shape[0]):
        factor = min(max((products[c] * rules.cross << 4) // spread, -MAX_FACTOR), MAX_FACTOR)
        for octant in range(4):
            if tree[7 + octant]:
                v = s.predicted[octant, c] + ((factor * s.values[7 + octant, 0] + (1 << (CROSS_FRACTION - 1))) >> CROSS_FRACTION)
                s.predicted[octant, c] = min(max(v, -MAX_MEAN), MAX_MEAN)
