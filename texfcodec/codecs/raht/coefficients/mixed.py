"""Coding of a level with mixed contexts (spec clauses 7.2 and 7.5.5): one walk over a plane for encoder and decoder, and the
encoder's choice of coefficients."""

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import UNARY, _escape_cost, _escaped
from ..entropy.mixing import _mixed_bit, _mixed_probability
from ..entropy.range_coder import RANGE, _adapt, _dec_split, _enc_split, _probability
from ..transform.raht import SPLITS, _is_split
from .blocks import _clear_plane, _close_block, _open_block, _plane_energy, _scale_plane
from .mixed_contexts import (
    SIGN_MODELS,
    _features,
    _flag_contexts,
    _is_quiet,
    _more_contexts,
    _quiet_context,
    _sign_contexts,
    _slopes,
    _zero_contexts,
)
from .planar import _look_around

QUIET_SHIFT = 5  # a rare event: both estimates slow


@kernel
def _enc_mixed_level(coder, model, rules, blocks, wanted, s, begin, end):
    """Codes the children of parents begin..end-1 and writes their reconstruction to means.child. coder: Coder; model: Model;
    rules, blocks, wanted, s: Rules, Blocks, Wanted and Scratch of blocks.py. Context numbers are bounded by construction
    (mixed_contexts.py)."""
    components, energy, models, chosen = blocks.means.parent.shape[1], blocks.energy, rules.models, s.chosen
    for p in range(begin, end):
        if rules.part and blocks.dct.whole[p]:  # dct_blocks.py has it
            continue
        splits = _open_block(p, begin, rules, blocks, s)
        if splits == 0:
            continue
        for k in range(min(components, 2)):
            c0, c1 = k, (1 if k == 0 else components)
            _clear_plane(p, begin, k, c1, rules, blocks, s)
            largest = _scale_plane(blocks.nodes.first_child[p], c0, c1, rules, wanted.original, s)
            flag, coded = s.flags[0] if k else 0, 0
            quiet = _quiet_context(s.sums, k, rules.level, splits, flag) if _is_quiet(s.sums, k) else -1
            if quiet < 0 or largest >= 0.5:
                _features(p, begin, k, splits, flag, rules, blocks, s)
            if largest >= 0.5:
                if blocks.nodes.planar:
                    _look_around(p, begin, c0, c1, blocks, s)
                for c in range(c0, c1):
                    _slopes(s.tree, s.predicted, c, rules.inverse, s.halves, s.expected, s.down, rules.rotated)
                coded = _choose_mixed_plane(model, models, _flag_probability(model, models, quiet, s), c0, c1, wanted, s)
            s.flags[k] = coded
            if quiet >= 0:
                _quiet_flag(True, coder, model.contexts, quiet, coded)
            else:
                _flag_contexts(s.f, chosen.where, chosen.sets)
                _mixed_bit(True, coder, model, models, chosen, coded)
            if coded:
                _enc_mixed_plane(coder, model, models, c0, c1, s)
            energy[p, k] = _plane_energy(s.q, c0, c1, splits) if s.flags[k] else 0
        _close_block(p, rules, blocks, s)


@kernel
def _dec_mixed_level(coder, model, rules, blocks, s, begin, end):
    """Mirror of _enc_mixed_level. The features of a quiet plane are computed only if it has coefficients."""
    components, energy, models, chosen = blocks.means.parent.shape[1], blocks.energy, rules.models, s.chosen
    for p in range(begin, end):
        if rules.part and blocks.dct.whole[p]:  # dct_blocks.py has it
            continue
        splits = _open_block(p, begin, rules, blocks, s)
        if splits == 0:
            continue
        for k in range(min(components, 2)):
            c0, c1 = k, (1 if k == 0 else components)
            _clear_plane(p, begin, k, c1, rules, blocks, s)
            flag, coded = s.flags[0] if k else 0, np.int64(0)
            quiet = _quiet_context(s.sums, k, rules.level, splits, flag) if _is_quiet(s.sums, k) else -1
            if quiet >= 0:
                coded = _quiet_flag(False, coder, model.contexts, quiet, 0)
            if quiet < 0 or coded:
                _features(p, begin, k, splits, flag, rules, blocks, s)
                if quiet < 0:
                    _flag_contexts(s.f, chosen.where, chosen.sets)
                    coded = _mixed_bit(False, coder, model, models, chosen, 0)
            s.flags[k] = coded
            if coded:
                if blocks.nodes.planar:
                    _look_around(p, begin, c0, c1, blocks, s)
                for c in range(c0, c1):
                    _slopes(s.tree, s.predicted, c, rules.inverse, s.halves, s.expected, s.down, rules.rotated)
                _dec_mixed_plane(coder, model, models, c0, c1, s)
            energy[p, k] = _plane_energy(s.q, c0, c1, splits) if s.flags[k] else 0
        _close_block(p, rules, blocks, s)


@kernel(inline="always")
def _quiet_flag(encoding, coder, contexts, quiet, flag):
    """Codes the flag of a quiet plane with its direct context, or decodes it. Returns the flag."""
    bound = (coder.state[RANGE] >> 16) * _probability(contexts, quiet)
    if encoding:
        _enc_split(coder.state, coder.buffer, bound, flag)
    else:
        flag = _dec_split(coder.state, coder.buffer, coder.end, bound)
    _adapt(contexts, quiet, flag, QUIET_SHIFT)
    return flag


@kernel(forceinline=True)
def _flag_probability(model, models, quiet, s):
    """Probability of a one in 2**-16 for the flag, in the present state. quiet: its direct context, or -1."""
    if quiet >= 0:
        p = _probability(model.contexts, quiet)
    else:
        _flag_contexts(s.f, s.chosen.where, s.chosen.sets)
        p = _mixed_probability(model, models, s.chosen)
    return p


@kernel(inline="always")
def _mixed_magnitude(encoding, coder, model, models, c, node, large, luma, s, magnitude):
    """Codes a magnitude >= 1, or decodes it. Returns the magnitude."""
    coded = np.int64(1)
    while coded <= UNARY + 1:
        _more_contexts(s.f, c, node, coded - 1, large, luma, s.expected[node, c], s.alike[node, c], s.chosen.where,
                       s.chosen.sets)
        if not _mixed_bit(encoding, coder, model, models, s.chosen, 1 if magnitude > coded else 0):
            break
        coded += 1
    return coded if coded <= UNARY + 1 else _escaped(encoding, coder, magnitude)


@kernel(inline="always")
def _mixed_plane(encoding, coder, model, models, c0, c1, s):
    """Codes the coefficients s.q of components c0..c1-1 of a plane with nonzero coefficients, or decodes them into s.q."""
    q, chosen = s.q, s.chosen
    left = 0
    for node in range(SPLITS):
        if _is_split(s.tree, node):
            left += c1 - c0
    some = False
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            if not _is_split(s.tree, node):
                continue
            left -= 1
            luma, size = abs(q[node, 0]) if c > 0 else 0, s.expected[node, c]
            nonzero = np.int64(1 if q[node, c] != 0 else 0)
            if left > 0 or some:
                _zero_contexts(s.f, c, node, ones, luma, left, size, s.alike[node, c], chosen.where, chosen.sets)
                nonzero = _mixed_bit(encoding, coder, model, models, chosen, nonzero)
            elif not encoding:
                nonzero = np.int64(1)
            if not nonzero:
                continue
            _sign_contexts(s.f, c, node, q, size, s.down[node, c], s.alike_signs[node, c], chosen.where, chosen.sets)
            negative = _mixed_bit(encoding, coder, model, min(models, SIGN_MODELS), chosen, np.int64(1 if q[node, c] < 0 else 0))
            magnitude = _mixed_magnitude(encoding, coder, model, models, c, node, large, luma, s, abs(q[node, c]))
            q[node, c] = -magnitude if negative else magnitude
            some = True
            ones += 1
            large += 1 if magnitude > 1 else 0


@kernel
def _enc_mixed_plane(coder, model, models, c0, c1, s):
    _mixed_plane(True, coder, model, models, c0, c1, s)


@kernel
def _dec_mixed_plane(coder, model, models, c0, c1, s):
    _mixed_plane(False, coder, model, models, c0, c1, s)


@kernel(forceinline=True)
def _choose_mixed_plane(model, models, p, c0, c1, wanted, s):
    """Rate-distortion optimised quantisation of one plane into s.q, as direct._choose_plane. A sign counts as one bit. p: 16-bit
    probability of the flag."""
    scaled, tree, q, f, expected, chosen = s.scaled, s.tree, s.q, s.f, s.expected, s.chosen
    lagrangian, bits_of = wanted.lagrangian, wanted.bits_of
    cost_zero, cost = np.float64(bits_of[(65536 - p) >> 4]), np.float64(bits_of[p >> 4])
    left, any_left = 0, False
    for node in range(SPLITS):
        if _is_split(tree, node):
            left += c1 - c0
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            q[node, c] = 0
            if not _is_split(tree, node):
                continue
            left -= 1
            x, luma, size = abs(scaled[node, c]), abs(q[node, 0]) if c > 0 else 0, expected[node, c]
            _zero_contexts(f, c, node, ones, luma, left, size, s.alike[node, c], chosen.where, chosen.sets)
            p = _mixed_probability(model, models, chosen)
            best = x * x * lagrangian
            cost_zero += best
            best += bits_of[(65536 - p) >> 4]
            rounded, choice = np.int64(x + 0.5), np.int64(0)
            price = np.float64(bits_of[p >> 4]) + 256.0
            magnitude = np.int64(1)
            while magnitude <= rounded:
                if magnitude - 1 <= UNARY:
                    _more_contexts(f, c, node, magnitude - 1, large, luma, size, s.alike[node, c], chosen.where, chosen.sets)
                    p = _mixed_probability(model, models, chosen)
                else:  # far out, the nearest is taken
                    magnitude = rounded
                    p = np.int64(0)
                    price += _escape_cost(rounded - 1 - UNARY)
                if magnitude >= rounded - 1:
                    j = (x - magnitude) ** 2 * lagrangian + price + bits_of[(65536 - p) >> 4]
                    if j < best:
                        best, choice = j, magnitude
                price += bits_of[p >> 4]
                magnitude += 1
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
