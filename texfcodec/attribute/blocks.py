"""Coding of one octree level of one slice, block by block (spec clause 7.2): the encoder's and the decoder's inner loop."""

import numpy as np

from ..kernel import kernel
from .contexts import (
    _block_context,
    _cost,
    _dec_magnitude,
    _enc_magnitude,
    _magnitude_cost,
    _surroundings,
    _zero_context,
)
from .prediction import _predict
from .quantise import MAX_MEAN
from .raht import SPLITS, _forward, _inverse, _tree_weights
from .range_coder import _dec_bit, _enc_bit

ENERGY_SCALE = 16


@kernel
def _stage(node):
    return 0 if node == 0 else (1 if node < 3 else 2)


@kernel
def _is_split(tree, node):
    return tree[2 * node + 1] != 0 and tree[2 * node + 2] != 0


@kernel
def _plane_energy(q, c0, c1, splits):
    total = np.int64(0)
    for node in range(SPLITS):
        for c in range(c0, c1):
            total += abs(q[node, c])
    return min(ENERGY_SCALE * total // (splits * (c1 - c0)), 255)


@kernel
def _choose_plane(scaled, tree, contexts, flag_ctx, c0, c1, level, strength, lagrangian, bits_of, q):
    """Rate-distortion optimised quantisation of one plane into q; returns whether anything is left of it.

    Distortion is in squared steps, price in 2**-8 bit from the coder's present state; lagrangian = 256 / lambda.
    """
    cost_zero = np.float64(_cost(contexts, flag_ctx, 0, bits_of))
    cost = np.float64(_cost(contexts, flag_ctx, 1, bits_of))
    any_left = False
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            q[node, c] = 0
            if not _is_split(tree, node):
                continue
            x = abs(scaled[node, c])
            luma = abs(q[node, 0]) if c > 0 else 0
            ctx = _zero_context(c, level, _stage(node), ones, strength, luma)
            best = x * x * lagrangian
            cost_zero += best
            best += _cost(contexts, ctx, 0, bits_of)
            rounded = np.int64(x + 0.5)
            choice = np.int64(0)
            if rounded > 0:
                one = _cost(contexts, ctx, 1, bits_of)
                for candidate in range(max(1, rounded - 1), rounded + 1):
                    j = (x - candidate) ** 2 * lagrangian + one
                    j += _magnitude_cost(contexts, c, strength, large, candidate, bits_of)
                    if j < best:
                        best, choice = j, candidate
            cost += best
            if choice:
                any_left = True
                ones += 1
                large += 1 if choice > 1 else 0
                q[node, c] = choice if scaled[node, c] >= 0 else -choice
    if any_left and cost < cost_zero:
        return 1
    for c in range(c0, c1):
        for node in range(SPLITS):
            q[node, c] = 0
    return 0


@kernel
def _enc_plane(state, out, contexts, tree, splits, c0, c1, level, strength, q):
    """Codes a plane that has a nonzero coefficient; the last flag is left out when all before it were zero (spec 7.5.3)."""
    left = splits * (c1 - c0)
    some = False
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            if not _is_split(tree, node):
                continue
            left -= 1
            magnitude = abs(q[node, c])
            if left > 0 or some:
                luma = abs(q[node, 0]) if c > 0 else 0
                ctx = _zero_context(c, level, _stage(node), ones, strength, luma)
                _enc_bit(state, out, contexts, ctx, 1 if magnitude else 0)
            if magnitude:
                _enc_magnitude(state, out, contexts, c, strength, large, magnitude, 1 if q[node, c] < 0 else 0)
                some = True
                ones += 1
                large += 1 if magnitude > 1 else 0


@kernel
def _dec_plane(state, data, end, contexts, tree, splits, c0, c1, level, strength, q):
    """Mirror of _enc_plane: fills q for components c0..c1-1."""
    left = splits * (c1 - c0)
    some = False
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            q[node, c] = 0
            if not _is_split(tree, node):
                continue
            left -= 1
            nonzero = np.int64(1)
            if left > 0 or some:
                luma = abs(q[node, 0]) if c > 0 else 0
                ctx = _zero_context(c, level, _stage(node), ones, strength, luma)
                nonzero = _dec_bit(state, data, end, contexts, ctx)
            if nonzero:
                q[node, c] = _dec_magnitude(state, data, end, contexts, c, strength, large)
                some = True
                ones += 1
                large += 1 if abs(q[node, c]) > 1 else 0


@kernel
def _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, flags, values, child_mean):
    """Writes the decoded means of a block's children, child being the first."""
    for c in range(parent_mean.shape[1]):
        _inverse(tree, q, c, parent_mean[p, c], predicted, steps[c], flags[min(c, 1)], values)
        n = child
        for octant in range(8):
            if tree[7 + octant]:
                child_mean[n, c] = min(max(values[7 + octant], -MAX_MEAN), MAX_MEAN)
                n += 1


@kernel
def _copy_only_child(child, p, parent_mean, above, child_mean, energy):
    """A node with one child hands its mean and its energies on."""
    for c in range(parent_mean.shape[1]):
        child_mean[child, c] = parent_mean[p, c]
    energy[p, 0] = above[p, 0]
    energy[p, 1] = above[p, 1]


@kernel
def _enc_level(state, out, contexts, begin, end_node, level, steps, kernel, lagrangian, bits_of, first_child, occupancy,
               child_weight, table, above, energy, parent_mean, original, child_mean):
    """Codes the children of parents begin..end_node-1 and leaves their reconstruction in child_mean int64 [children, C].

    original: int64 [children, C], the means to be coded. The other arrays are those of _dec_level.
    """
    components = parent_mean.shape[1]
    tree, values, spread = np.zeros(15, np.int64), np.zeros(15, np.int64), np.zeros(15, np.float64)
    q, predicted = np.zeros((SPLITS, components), np.int64), np.zeros((8, components), np.int64)
    residual, scaled = np.zeros((8, components), np.float64), np.zeros((SPLITS, components), np.float64)
    classes, flags = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for p in range(begin, end_node):
        child = first_child[p]
        splits = _tree_weights(child, np.int64(occupancy[p]), child_weight, tree)
        if splits == 0:
            _copy_only_child(child, p, parent_mean, above, child_mean, energy)
            continue
        _predict(p, begin, table, first_child, occupancy, parent_mean, child_mean, kernel, predicted)
        for k in range(1 if components == 1 else 2):
            c0, c1 = k, (1 if k == 0 else components)
            largest = 0.0
            for c in range(c0, c1):
                n = child
                for octant in range(8):
                    if tree[7 + octant]:
                        residual[octant, c] = original[n, c] - predicted[octant, c]
                        n += 1
                _forward(tree, residual, c, spread, scaled, np.float64(steps[c]))
                for node in range(SPLITS):
                    q[node, c] = 0
                    largest = max(largest, abs(scaled[node, c]))
            _surroundings(p, begin, table, energy, above, k, classes)
            flag_ctx = _block_context(k, level, splits, flags[0] if k else 0, classes[0], classes[1])
            strength = max(classes[0], classes[1])
            flags[k] = 0
            if largest >= 0.5:
                flags[k] = _choose_plane(scaled, tree, contexts, flag_ctx, c0, c1, level, strength, lagrangian, bits_of, q)
            _enc_bit(state, out, contexts, flag_ctx, flags[k])
            if flags[k]:
                _enc_plane(state, out, contexts, tree, splits, c0, c1, level, strength, q)
            energy[p, k] = _plane_energy(q, c0, c1, splits)
        _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, flags, values, child_mean)


@kernel
def _dec_level(state, data, end, contexts, begin, end_node, level, steps, kernel, first_child, occupancy, child_weight, table,
               above, energy, parent_mean, child_mean):
    """Decodes the children of parents begin..end_node-1 into child_mean int64 [children, C] (spec 7.2).

    state, contexts: this slice's coder; data: uint8, the unit; level: level class; steps: int64 [C]; kernel: int64 [7].
    first_child, occupancy, table, above, energy, parent_mean: per parent; child_weight: per child. All indices come from the
    octree, none from the stream; context numbers are bounded by construction (contexts.py).
    """
    components = parent_mean.shape[1]
    tree, values = np.zeros(15, np.int64), np.zeros(15, np.int64)
    q, predicted = np.zeros((SPLITS, components), np.int64), np.zeros((8, components), np.int64)
    classes, flags = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for p in range(begin, end_node):
        child = first_child[p]
        splits = _tree_weights(child, np.int64(occupancy[p]), child_weight, tree)
        if splits == 0:
            _copy_only_child(child, p, parent_mean, above, child_mean, energy)
            continue
        _predict(p, begin, table, first_child, occupancy, parent_mean, child_mean, kernel, predicted)
        for k in range(1 if components == 1 else 2):
            c0, c1 = k, (1 if k == 0 else components)
            for c in range(c0, c1):
                for node in range(SPLITS):
                    q[node, c] = 0
            _surroundings(p, begin, table, energy, above, k, classes)
            flag_ctx = _block_context(k, level, splits, flags[0] if k else 0, classes[0], classes[1])
            flags[k] = _dec_bit(state, data, end, contexts, flag_ctx)
            if flags[k]:
                strength = max(classes[0], classes[1])
                _dec_plane(state, data, end, contexts, tree, splits, c0, c1, level, strength, q)
            energy[p, k] = _plane_energy(q, c0, c1, splits)
        _rebuild_children(child, p, tree, q, steps, parent_mean, predicted, flags, values, child_mean)
