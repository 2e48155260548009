"""Region-adaptive hierarchical transform of one block, in the mean domain (spec clause 7.4).

A block is a node with its 2..8 children. Means are merged pairwise along z, y, x seen from the root: coefficient 0 splits z,
1..2 split y, 3..6 split x; a split exists where both sides do. A split of weights w1, w2 and difference d = mean2 - mean1 has
the orthonormal coefficient d * sqrt(w1 w2 / (w1 + w2)), so the quantiser sees what RAHT's does, while the inverse is a lifting
step that no rounding can drift away from: mean1 = mean - w2 d / (w1 + w2), mean2 = mean1 + d.
"""

import numpy as np

from ..kernel import kernel
from .quantise import GAIN_FRACTION, _dequantise, _gain

SPLITS = 7
# Voxels from which on the encoder divides by the gain as the decoder rounds it: 0.02 % off here, 1.8 % at 30 million
EXACT_BELOW = 1 << 12


@kernel
def _tree_weights(first, occupancy, weight, tree):
    """Fills tree int64 [15]: weights of the root (0), the halves along z (1, 2), y (3..6) and x (7..14 = octants), 0 where
    nothing is. Octant bit 0 is x, so leaf 7 + octant. first: first child; weight: int64, child weights. Returns the splits."""
    child = first
    for octant in range(8):
        if (occupancy >> octant) & 1:
            tree[7 + octant] = weight[child]
            child += 1
        else:
            tree[7 + octant] = 0
    for node in range(6, -1, -1):
        tree[node] = tree[2 * node + 1] + tree[2 * node + 2]
    return child - first - 1


@kernel
def _forward(tree, residual, component, values, scaled, step):
    """Encoder's transform of one component: residual float64 [8, C] -> scaled float64 [7, C], coefficients in steps.

    values: float64 [15], scratch.
    """
    for octant in range(8):
        values[7 + octant] = residual[octant, component] if tree[7 + octant] else 0.0
    for node in range(6, -1, -1):
        w1, w2 = tree[2 * node + 1], tree[2 * node + 2]
        v1, v2 = values[2 * node + 1], values[2 * node + 2]
        scaled[node, component] = 0.0
        if w1 and w2:
            values[node] = (w1 * v1 + w2 * v2) / (w1 + w2)
            if w1 + w2 < EXACT_BELOW:
                scaled[node, component] = (v2 - v1) * np.sqrt(w1 * w2 / (w1 + w2)) / step
            else:
                scaled[node, component] = (v2 - v1) * 2.0**GAIN_FRACTION / _gain(w1, w2) / step
        else:
            values[node] = v1 if w1 else v2


@kernel
def _inverse(tree, q, component, mean, predicted, step, coded, values):
    """Children's means of one component, left in values[7:15] (spec 7.4.3).

    The prediction is shifted so that its weighted mean is the node's own mean; coefficients add differences to it.
    tree: int64 [15]; q: int64 [7, C]; predicted: int64 [8, C]; coded: whether any q of this component is not zero.
    weights < 2**27 and values < 2**32, so sums stay < 2**62.
    """
    total = tree[0]
    acc = np.int64(0)
    for octant in range(8):
        if tree[7 + octant]:
            acc += tree[7 + octant] * predicted[octant, component]
    shift = mean - (2 * acc + total) // (2 * total)
    if not coded:
        for octant in range(8):
            if tree[7 + octant]:
                values[7 + octant] = predicted[octant, component] + shift
        return
    values[0] = shift
    for node in range(7):
        w1, w2 = tree[2 * node + 1], tree[2 * node + 2]
        if w1 and w2:
            d = np.int64(0)
            if q[node, component]:
                d = _dequantise(q[node, component], step, w1, w2)
            values[2 * node + 1] = values[node] - (2 * w2 * d + w1 + w2) // (2 * (w1 + w2))
            values[2 * node + 2] = values[2 * node + 1] + d
        elif w1:
            values[2 * node + 1] = values[node]
        elif w2:
            values[2 * node + 2] = values[node]
    for octant in range(8):
        if tree[7 + octant]:
            values[7 + octant] += predicted[octant, component]
