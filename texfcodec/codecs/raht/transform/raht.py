"""Region-adaptive hierarchical transform of one block, in the mean domain (spec clause 7.4).

A block is a node with its 2..8 children. Means are merged pairwise along z, y, x seen from the root: coefficient 0 splits z, 1..2
split y, 3..6 split x. A split exists if both sides do. A split of weights w1, w2 and difference d = mean2 - mean1 has the
orthonormal coefficient d * sqrt(w1 w2 / (w1 + w2)), so the quantiser's input equals RAHT's. The inverse is a lifting step that
rounding cannot make drift: mean1 = mean - w2 d / (w1 + w2), mean2 = mean1 + d.
"""

import numpy as np

from ....core.kernel import kernel
from .quantise import GAIN_FRACTION, _dequantise, _gain

SPLITS = 7
PLANAR_NODES = np.array((1, 3, 4))  # the splits of a block whose children all have z = 0
# Voxels from which on the encoder divides by the gain as the decoder rounds it: 0.02 % off here, 1.8 % at 30 million
EXACT_BELOW = 1 << 12


@kernel(forceinline=True)
def _tree_weights(first, occupancy, weight, tree):
    """Fills tree int64 [15]: weights of the root (0), the halves along z (1, 2), y (3..6) and x (7..14 = octants), 0 for empty
    ones. Returns the splits. Octant bit 0 is x, so leaf 7 + octant. first: first child; weight: int64, child weights."""
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
def _is_split(tree, node):
    return tree[2 * node + 1] != 0 and tree[2 * node + 2] != 0


@kernel
def _is_square(tree):
    """Return whether a block with z = 0 has all of its four children."""
    return _is_split(tree, 3) and _is_split(tree, 4)


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
def _rotate(scaled, component):
    """Encoder's side of planar_transform: replaces the splits along x by their sum and their difference (spec 7.11.1)."""
    a, b = scaled[3, component], scaled[4, component]
    scaled[3, component], scaled[4, component] = (a + b) * np.sqrt(0.5), (b - a) * np.sqrt(0.5)


@kernel(forceinline=True)
def _weighted_mean(tree, predicted, component):
    """Mean of the children's predictions, weighted by their voxels and rounded (spec 7.4.3). The sum stays < 2**51."""
    acc = np.int64(0)
    for octant in range(8):
        acc += tree[7 + octant] * predicted[octant, component]
    return (2 * acc + tree[0]) // (2 * tree[0])


@kernel
def _inverse(tree, q, component, mean, step, values, rotated=0):
    """Adds a block's coefficients to the predictions of its children, in one component of values int64 [15, C] (spec 7.4.3).

    mean: of the node, less the weighted mean of the predictions; tree: int64 [15]; q: int64 [7, C]; rotated: planar_transform,
    under which the splits along x of a square block are coded as their sum and difference (spec 7.11.1). weights <= 2**28 and
    values < 2**32, so sums stay < 2**62.
    """
    values[0, component] = mean
    rotated = 1 if rotated and _is_square(tree) else 0
    for node in range(7):
        w1, w2, v = tree[2 * node + 1], tree[2 * node + 2], values[node, component]
        level, half = q[node, component], 0
        if rotated and node > 2:
            level, half = (q[3, component] - q[4, component] if node == 3 else q[3, component] + q[4, component]), 1
        if w1 and w2 and level:
            d = _dequantise(level, step, w1, w2, half)
            v -= (2 * w2 * d + w1 + w2) // (2 * (w1 + w2))
            values[2 * node + 1, component] = v
            values[2 * node + 2, component] = v + d
        else:
            values[2 * node + 1, component] = v
            values[2 * node + 2, component] = v
