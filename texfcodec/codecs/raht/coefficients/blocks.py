"""Coding of one octree level of one slice, block by block (spec clause 7.2): the encoder's and the decoder's inner loop."""

import numpy as np

from ....ground.kernel import kernel
from ..entropy.contexts import _block_context, _class, _classes, _surroundings
from ..entropy.mixing import MAX_MODELS
from ..entropy.range_coder import _dec_bit, _enc_bit
from ..transform.octree import CELLS
from ..transform.prediction import _predict
from ..transform.quantise import MAX_MEAN
from ..transform.raht import SPLITS, _forward, _inverse, _tree_weights, _weighted_mean
from .direct import _choose_plane, _dec_plane, _enc_plane
from .mixed import _choose_mixed_plane, _flag_probability, _mixed_flag, _mixed_plane
from .mixed_contexts import FEATURES, LEVEL, LUMA2, PLANES, _features, _is_quiet, _quiet_context, _slopes
from .mixed_contexts import SPLITS as SPLITS_FEATURE

ENERGY_SCALE = 16
# A transform keeps power: below this, in squared steps, no coefficient rounds to 1 (0.25, less what the gain's rounding is worth)
SURELY_ZERO = 0.24


@kernel
def _plane_energy(q, c0, c1, splits):
    total = np.int64(0)
    for node in range(SPLITS):
        for c in range(c0, c1):
            total += abs(q[node, c])
    return min(ENERGY_SCALE * total // (splits * (c1 - c0)), 255)


@kernel(forceinline=True)
def _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, shift, flags, values, child_mean):
    """Writes the decoded means of a block's children, child being the first (spec 7.4.3). shift: int64 [C], weighted means of the
    predictions; values: int64 [15, C], scratch."""
    components = parent_mean.shape[1]
    for c in range(components):
        shift[c] = parent_mean[p, c] - shift[c]
        if flags[min(c, 1)]:
            _inverse(tree, q, c, shift[c], steps[c], values)
    for octant in range(8):
        if tree[7 + octant]:
            for c in range(components):
                v = predicted[octant, c] + (values[7 + octant, c] if flags[min(c, 1)] else shift[c])
                child_mean[child, c] = min(max(v, -MAX_MEAN), MAX_MEAN)
            child += 1


@kernel
def _copy_only_child(child, p, parent_mean, above, child_mean, energy):
    """A node with one child hands its mean and its energies on."""
    for c in range(parent_mean.shape[1]):
        child_mean[child, c] = parent_mean[p, c]
    energy[p, 0] = above[p, 0]
    energy[p, 1] = above[p, 1]


@kernel(forceinline=True)
def _block_features(p, begin, k, splits, level, flag, table, energy, above, sums, parent_mean, predicted, shift, tree, inverse,
                    f):
    """All features of plane k for mixed coding (spec 7.5.5); flag: whether luma has coefficients."""
    f[LEVEL], f[SPLITS_FEATURE], f[PLANES] = level, splits, 2 * k + flag
    f[LUMA2] = min(_class(np.int64(energy[p, 0])), 5) if k else 0
    _features(p, begin, table, energy, above, k, sums, parent_mean, predicted, shift, tree, inverse, f)


@kernel
def _inverses(steps):
    """2**32 // step of each component."""
    inverse = np.empty_like(steps)
    for c in range(steps.shape[0]):
        inverse[c] = (1 << 32) // steps[c]
    return inverse


@kernel
def _enc_level(state, out, model, models, begin, end_node, level, steps, kernel, colour_inverse, lagrangian, bits_of, first_child,
               occupancy, child_weight, table, above, energy, parent_mean, original, child_mean):
    """Codes the children of parents begin..end_node-1 and leaves their reconstruction in child_mean int32 [children, C].

    original: int32 [children, C], the means to be coded. The other arrays are those of _dec_level.
    """
    components = parent_mean.shape[1]
    tree, halves, spread = np.zeros(15, np.int64), np.zeros(15, np.int64), np.zeros(15, np.float64)
    q, predicted = np.zeros((SPLITS, components), np.int64), np.zeros((8, components), np.int64)
    residual, scaled = np.zeros((8, components), np.float64), np.zeros((SPLITS, components), np.float64)
    classes, flags, sums, shift = np.zeros(2, np.int64), np.zeros(2, np.int64), np.zeros(6, np.int64), np.zeros(3, np.int64)
    f, where, sets = np.zeros(FEATURES, np.int64), np.zeros(MAX_MODELS, np.int64), np.zeros(3, np.int64)
    inputs = np.zeros(MAX_MODELS, np.int64)
    near, cells, cell_weight = np.empty(27, np.int64), np.empty(CELLS, np.int64), np.empty(CELLS, np.int64)
    values = np.zeros((15, components), np.int64)
    expected, down, inverse = np.zeros_like(q), np.zeros_like(q), _inverses(steps)
    for p in range(begin, end_node):
        child = first_child[p]
        splits = _tree_weights(child, np.int64(occupancy[p]), child_weight, tree)
        if splits == 0:
            _copy_only_child(child, p, parent_mean, above, child_mean, energy)
            continue
        _predict(p, begin, table, first_child, occupancy, parent_mean, child_mean, kernel, colour_inverse, near, cells,
                 cell_weight, predicted)
        _surroundings(p, begin, table, energy, above, sums)
        for k in range(1 if components == 1 else 2):
            c0, c1 = k, (1 if k == 0 else components)
            largest = 0.0
            for c in range(c0, c1):
                n, power = child, 0.0
                for octant in range(8):
                    if tree[7 + octant]:
                        residual[octant, c] = original[n, c] - predicted[octant, c]
                        power += tree[7 + octant] * residual[octant, c] ** 2
                        n += 1
                shift[c] = _weighted_mean(tree, predicted, c)
                for node in range(SPLITS):
                    q[node, c], scaled[node, c] = 0, 0.0
                if power >= SURELY_ZERO * np.float64(steps[c]) ** 2:
                    _forward(tree, residual, c, spread, scaled, np.float64(steps[c]))
                    for node in range(SPLITS):
                        largest = max(largest, abs(scaled[node, c]))
            flag, flags[k] = flags[0] if k else 0, 0
            if models:
                quiet = _quiet_context(sums, k, level, splits, flag) if _is_quiet(sums, k) else -1
                if quiet < 0 or largest >= 0.5:
                    _block_features(p, begin, k, splits, level, flag, table, energy, above, sums, parent_mean, predicted, shift,
                                    tree, inverse, f)
                if largest >= 0.5:
                    for c in range(c0, c1):
                        _slopes(tree, predicted, c, inverse, halves, expected, down)
                    probability = _flag_probability(model, models, f, quiet, where, sets, inputs)
                    flags[k] = _choose_mixed_plane(scaled, tree, model, models, f, probability, c0, c1, lagrangian, bits_of,
                                                   expected, where, sets, inputs, q)
                _mixed_flag(True, state, out, 0, model, models, f, quiet, where, sets, inputs, flags[k])
                if flags[k]:
                    _mixed_plane(True, state, out, 0, model, models, f, tree, c0, c1, expected, down, where, sets, inputs, q)
            else:
                _classes(sums, k, classes)
                flag_ctx, strength = _block_context(k, level, splits, flag, classes[0], classes[1]), max(classes[0], classes[1])
                if largest >= 0.5:
                    flags[k] = _choose_plane(scaled, tree, model.contexts, flag_ctx, c0, c1, level, strength, lagrangian, bits_of,
                                             q)
                _enc_bit(state, out, model.contexts, flag_ctx, flags[k])
                if flags[k]:
                    _enc_plane(state, out, model.contexts, tree, splits, c0, c1, level, strength, q)
            energy[p, k] = _plane_energy(q, c0, c1, splits)
        _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, shift, flags, values, child_mean)


@kernel
def _dec_level(state, data, end, model, models, begin, end_node, level, steps, kernel, colour_inverse, first_child, occupancy,
               child_weight, table, above, energy, parent_mean, child_mean):
    """Decodes the children of parents begin..end_node-1 into child_mean int32 [children, C] (spec 7.2).

    state, model: this slice's coder; models: 0 for direct contexts; data: uint8, the unit; level: level class; steps: int64 [C];
    kernel: int64 [7]; colour_inverse: of inverse_range. first_child, occupancy, table, above, energy, parent_mean: per parent;
    child_weight: per child. All indices come from the octree, none from the stream; context numbers are bounded by construction
    (contexts.py, mixed_contexts.py).
    """
    components = parent_mean.shape[1]
    tree, halves = np.zeros(15, np.int64), np.zeros(15, np.int64)
    q, predicted = np.zeros((SPLITS, components), np.int64), np.zeros((8, components), np.int64)
    classes, flags, sums, shift = np.zeros(2, np.int64), np.zeros(2, np.int64), np.zeros(6, np.int64), np.zeros(3, np.int64)
    f, where, sets = np.zeros(FEATURES, np.int64), np.zeros(MAX_MODELS, np.int64), np.zeros(3, np.int64)
    inputs = np.zeros(MAX_MODELS, np.int64)
    near, cells, cell_weight = np.empty(27, np.int64), np.empty(CELLS, np.int64), np.empty(CELLS, np.int64)
    values = np.zeros((15, components), np.int64)
    expected, down, inverse = np.zeros_like(q), np.zeros_like(q), _inverses(steps)
    for p in range(begin, end_node):
        child = first_child[p]
        splits = _tree_weights(child, np.int64(occupancy[p]), child_weight, tree)
        if splits == 0:
            _copy_only_child(child, p, parent_mean, above, child_mean, energy)
            continue
        _predict(p, begin, table, first_child, occupancy, parent_mean, child_mean, kernel, colour_inverse, near, cells,
                 cell_weight, predicted)
        _surroundings(p, begin, table, energy, above, sums)
        for k in range(1 if components == 1 else 2):
            c0, c1 = k, (1 if k == 0 else components)
            for c in range(c0, c1):
                shift[c] = _weighted_mean(tree, predicted, c)
                for node in range(SPLITS):
                    q[node, c] = 0
            flag = flags[0] if k else 0
            if models:
                quiet = _quiet_context(sums, k, level, splits, flag) if _is_quiet(sums, k) else -1
                if quiet < 0:
                    _block_features(p, begin, k, splits, level, flag, table, energy, above, sums, parent_mean, predicted, shift,
                                    tree, inverse, f)
                flags[k] = _mixed_flag(False, state, data, end, model, models, f, quiet, where, sets, inputs, 0)
                if flags[k]:
                    if quiet >= 0:
                        _block_features(p, begin, k, splits, level, flag, table, energy, above, sums, parent_mean, predicted,
                                        shift, tree, inverse, f)
                    for c in range(c0, c1):
                        _slopes(tree, predicted, c, inverse, halves, expected, down)
                    _mixed_plane(False, state, data, end, model, models, f, tree, c0, c1, expected, down, where, sets, inputs, q)
            else:
                _classes(sums, k, classes)
                flag_ctx = _block_context(k, level, splits, flag, classes[0], classes[1])
                flags[k] = _dec_bit(state, data, end, model.contexts, flag_ctx)
                if flags[k]:
                    strength = max(classes[0], classes[1])
                    _dec_plane(state, data, end, model.contexts, tree, splits, c0, c1, level, strength, q)
            energy[p, k] = _plane_energy(q, c0, c1, splits)
        _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, shift, flags, values, child_mean)
