"""Coding of a level with direct contexts (spec clauses 7.2 and 7.5.2 to 7.5.4)."""

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import _block_context, _classes, _cost, _dec_magnitude, _enc_magnitude, _magnitude_cost, _zero_context
from ..entropy.range_coder import _dec_bit, _enc_bit
from ..transform.raht import SPLITS, _is_split
from .blocks import _clear_plane, _close_block, _open_block, _plane_energy, _scale_plane


@kernel
def _enc_direct_level(coder, model, rules, blocks, wanted, s, begin, end):
    """Codes the children of parents begin..end-1 and writes their reconstruction to means.child. coder: Coder; model: Model;
    rules, blocks, wanted, s: Rules, Blocks, Wanted and Scratch of blocks.py. Context numbers are bounded by construction
    (contexts.py)."""
    components, energy, contexts = blocks.means.parent.shape[1], blocks.energy, model.contexts
    for p in range(begin, end):
        splits = _open_block(p, begin, rules, blocks, s)
        if splits == 0:
            continue
        for k in range(min(components, 2)):
            c0, c1 = k, (1 if k == 0 else components)
            _clear_plane(p, begin, k, c1, rules, blocks, s)
            largest = _scale_plane(blocks.nodes.first_child[p], c0, c1, rules, wanted.original, s)
            near, far = _classes(s.sums, k)
            strength, coded = max(near, far), 0
            flag_ctx = _block_context(k, rules.level, splits, s.flags[0] if k else 0, near, far)
            if largest >= 0.5:
                coded = _choose_plane(contexts, flag_ctx, c0, c1, rules.level, strength, wanted, s)
            s.flags[k] = coded
            _enc_bit(coder.state, coder.buffer, contexts, flag_ctx, coded)
            if coded:
                _enc_plane(coder, contexts, splits, c0, c1, rules.level, strength, s.tree, s.q)
            energy[p, k] = _plane_energy(s.q, c0, c1, splits) if s.flags[k] else 0
        _close_block(p, rules, blocks, s)


@kernel
def _dec_direct_level(coder, model, rules, blocks, s, begin, end):
    """Mirror of _enc_direct_level."""
    components, energy, contexts = blocks.means.parent.shape[1], blocks.energy, model.contexts
    for p in range(begin, end):
        splits = _open_block(p, begin, rules, blocks, s)
        if splits == 0:
            continue
        for k in range(min(components, 2)):
            c0, c1 = k, (1 if k == 0 else components)
            _clear_plane(p, begin, k, c1, rules, blocks, s)
            near, far = _classes(s.sums, k)
            flag_ctx = _block_context(k, rules.level, splits, s.flags[0] if k else 0, near, far)
            s.flags[k] = _dec_bit(coder.state, coder.buffer, coder.end, contexts, flag_ctx)
            if s.flags[k]:
                _dec_plane(coder, contexts, splits, c0, c1, rules.level, max(near, far), s.tree, s.q)
            energy[p, k] = _plane_energy(s.q, c0, c1, splits) if s.flags[k] else 0
        _close_block(p, rules, blocks, s)


@kernel
def _stage(node):
    return 0 if node == 0 else (1 if node < 3 else 2)


@kernel(forceinline=True)
def _choose_plane(contexts, flag_ctx, c0, c1, level, strength, wanted, s):
    """Rate-distortion optimised quantisation of one plane into q. Returns whether any coefficient is nonzero.

    Distortion is in squared steps, cost in 2**-8 bit from the coder's present state.
    """
    scaled, tree, q, lagrangian, bits_of = s.scaled, s.tree, s.q, wanted.lagrangian, wanted.bits_of
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
                nonzero_cost = _cost(contexts, ctx, 1, bits_of)
                for candidate in range(max(np.int64(1), rounded - 1), rounded + 1):
                    j = (x - candidate) ** 2 * lagrangian + nonzero_cost
                    j += _magnitude_cost(contexts, c, strength, large, candidate, bits_of)
                    if j < best:
                        best, choice = j, np.int64(candidate)
            cost += best
            if choice:
                any_left = True
                ones += 1
                large += 1 if choice > 1 else 0
                q[node, c] = choice if scaled[node, c] >= 0 else -choice
    kept = 1 if any_left and cost < cost_zero else 0
    for c in range(c0, c1):
        for node in range(SPLITS):
            q[node, c] *= kept
    return kept


@kernel(forceinline=True)
def _enc_plane(coder, contexts, splits, c0, c1, level, strength, tree, q):
    """Codes a plane that has a nonzero coefficient; the last flag is omitted if all before it were zero (spec 7.5.3)."""
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
                _enc_bit(coder.state, coder.buffer, contexts, ctx, 1 if magnitude else 0)
            if magnitude:
                _enc_magnitude(coder.state, coder.buffer, contexts, c, strength, large, magnitude, 1 if q[node, c] < 0 else 0)
                some = True
                ones += 1
                large += 1 if magnitude > 1 else 0


@kernel(forceinline=True)
def _dec_plane(coder, contexts, splits, c0, c1, level, strength, tree, q):
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
                nonzero = _dec_bit(coder.state, coder.buffer, coder.end, contexts, ctx)
            if nonzero:
                q[node, c] = _dec_magnitude(coder.state, coder.buffer, coder.end, contexts, c, strength, large)
                some = True
                ones += 1
                large += 1 if abs(q[node, c]) > 1 else 0
