"""Steps that the level kernels of direct.py and mixed.py share (spec clause 7.2): opening a block before its planes are coded,
and closing it with the means of its children."""

from collections import namedtuple

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import _surroundings
from ..entropy.mixing import new_chosen
from ..transform.prediction import _predict
from ..transform.quantise import MAX_MEAN
from ..transform.raht import SPLITS, _forward, _inverse, _is_square, _rotate, _tree_weights, _weighted_mean
from .dct_blocks import new_dct_scratch
from .following import _follow
from .mixed_contexts import FEATURES
from .planar import _keep

ENERGY_SCALE = 16
# A transform keeps power: below this, in squared steps, no coefficient rounds to 1 (0.25, less what the gain's rounding is worth)
SURELY_ZERO = 0.24

# What holds for a level. level: its class; models: 0 for direct contexts; steps, inverse: int64 [C], inverse 2**32 // step;
# kernel: int64 [7]; colour_inverse: of inverse_range; rotated, cross: planar_transform and component_cross; part: texels of a
# child of a node in a DCT block, 0 where there are none
Rules = namedtuple("Rules", "level models steps inverse kernel colour_inverse rotated cross part")
# The blocks of a level, one per parent. nodes: Nodes; means: Means; above, energy: uint8 [n, 2], energies of the block that each
# parent came from, and of the blocks themselves, as far as the walk has come; kept_above, kept: of new_kept, likewise; dct:
# DctBlocks. All indices come from the octree, none from the stream.
Blocks = namedtuple("Blocks", "nodes means above energy kept_above kept dct")
# The encoder's side. original: int32 [children, C], the means to be coded, texels: int32 [N, C], those of the last level;
# lagrangian: 256 / lambda; bits_of: int64 [4097], -256 log2(i / 4096)
Wanted = namedtuple("Wanted", "original texels lagrangian bits_of")
# A block in the making. tree: of _tree_weights; q int64 [7, C], coefficients; predicted int64 [8, C]; shift int64 [C], weighted
# means of the predictions; flags int64 [2], whether a plane has coefficients; sums int64 [6], of _surroundings; values int64
# [15, C]; f int64 [FEATURES]; halves int64 [15], expected, down int64 [7, C], of _slopes; alike, alike_signs int64 [7, C], of
# _look_around; products int64 [C], of _follow; around int64 [8, 4], of _predict; chosen: Chosen; dct: DctScratch; residual
# float64 [8, C], scaled float64 [7, C], spread float64 [15]: the encoder's
Scratch = namedtuple("Scratch", "tree q predicted shift flags sums values f halves expected down alike alike_signs products "
                                "around chosen dct residual scaled spread")


def new_scratch(components: int) -> Scratch:
    """Return a Scratch, the arrays in which kernels code one block, uninitialised."""
    whole = [(15,), (SPLITS, components), (8, components), (components,), (2,), (6,), (15, components), (FEATURES,), (15,),
             *4 * [(SPLITS, components)], (components,), (8, 4)]
    real = [(8, components), (SPLITS, components), (15,)]
    return Scratch._make([*(np.zeros(shape, np.int64) for shape in whole), new_chosen(),
                          new_dct_scratch(components), *(np.zeros(shape) for shape in real)])


@kernel
def _plane_energy(q, c0, c1, splits):
    total = np.int64(0)
    for node in range(SPLITS):
        for c in range(c0, c1):
            total += abs(q[node, c])
    return min(ENERGY_SCALE * total // (splits * (c1 - c0)), 255)


@kernel(forceinline=True)
def _open_block(p, first, rules, blocks, s):
    """Fills tree, predicted and sums of block p. Returns its splits. A node with one child passes its mean and its energies
    on."""
    nodes, means = blocks.nodes, blocks.means
    child = nodes.first_child[p]
    splits = _tree_weights(child, np.int64(nodes.occupancy[p]), nodes.weight, s.tree)
    if splits == 0:
        for c in range(means.parent.shape[1]):
            means.child[child, c] = means.parent[p, c]
        blocks.energy[p, 0] = blocks.above[p, 0]
        blocks.energy[p, 1] = blocks.above[p, 1]
    else:
        _predict(p, first, nodes, means, rules.kernel, rules.colour_inverse, s.around, s.predicted)
        _surroundings(p, first, nodes.table, nodes.planar, blocks.energy, blocks.above, s.sums)
    return splits


@kernel(forceinline=True)
def _scale_plane(child, c0, c1, rules, original, s):
    """Fills scaled for components c0..c1-1 of the block whose first child is `child`. Returns the largest coefficient, in
    steps."""
    largest, tree, residual, scaled = 0.0, s.tree, s.residual, s.scaled
    for c in range(c0, c1):
        n, power = child, 0.0
        for octant in range(8):
            if tree[7 + octant]:
                residual[octant, c] = original[n, c] - s.predicted[octant, c]
                power += tree[7 + octant] * residual[octant, c] ** 2
                n += 1
        for node in range(SPLITS):
            scaled[node, c] = 0.0
        if power >= SURELY_ZERO * np.float64(rules.steps[c]) ** 2:
            _forward(tree, residual, c, s.spread, scaled, np.float64(rules.steps[c]))
            if rules.rotated and _is_square(tree):
                _rotate(scaled, c)
            for node in range(SPLITS):
                largest = max(largest, abs(scaled[node, c]))
    return largest


@kernel(forceinline=True)
def _clear_plane(p, first, k, c1, rules, blocks, s):
    """Sets the coefficients in components k..c1-1 of plane k to 0, and s.shift to the weighted means of the predictions."""
    if k and rules.cross and s.flags[0]:
        _follow(p, first, rules, blocks, s)
    for c in range(k, c1):
        s.shift[c] = _weighted_mean(s.tree, s.predicted, c)
        for node in range(SPLITS):
            s.q[node, c] = 0


@kernel(forceinline=True)
def _close_block(p, rules, blocks, s):
    """Writes the decoded means of the children of block p (spec 7.4.3)."""
    mean, child_mean, child, tree = blocks.means.parent, blocks.means.child, blocks.nodes.first_child[p], s.tree
    components = mean.shape[1]
    if blocks.nodes.planar and rules.models:
        _keep(p, blocks, s)
    for c in range(components):
        s.shift[c] = mean[p, c] - s.shift[c]
        if s.flags[min(c, 1)]:
            _inverse(tree, s.q, c, s.shift[c], rules.steps[c], s.values, rules.rotated)
    for octant in range(8):
        if tree[7 + octant]:
            for c in range(components):
                v = s.predicted[octant, c] + (s.values[7 + octant, c] if s.flags[min(c, 1)] else s.shift[c])
                child_mean[child, c] = min(max(v, -MAX_MEAN), MAX_MEAN)
            child += 1
