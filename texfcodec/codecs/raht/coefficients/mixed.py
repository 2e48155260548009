"""Coding of a plane of coefficients with mixed contexts (spec clause 7.5.5): one walk for encoder and decoder, and the choice."""

import numpy as np

from ....ground.kernel import kernel
from ..entropy.contexts import UNARY, _dec_escape, _enc_escape, _escape_cost
from ..entropy.mixing import _mixed_bit, _mixed_probability
from ..entropy.range_coder import RANGE, _adapt, _dec_split, _enc_split, _probability
from ..transform.raht import SPLITS, _is_split
from .mixed_contexts import SIGN_MODELS, _flag_contexts, _more_contexts, _sign_contexts, _zero_contexts

QUIET_SHIFT = 5  # a rare event: both estimates slow


@kernel(forceinline=True)
def _mixed_flag(encoding, state, buffer, end, model, models, f, quiet, where, sets, inputs, flag):
    """Codes the flag of a plane, or decodes and returns it. quiet: its direct context where the plane is quiet, else -1."""
    if quiet >= 0:
        bound = (state[RANGE] >> 16) * _probability(model.contexts, quiet)
        if encoding:
            _enc_split(state, buffer, bound, flag)
        else:
            flag = _dec_split(state, buffer, end, bound)
        _adapt(model.contexts, quiet, flag, QUIET_SHIFT)
        return flag
    _flag_contexts(f, where, sets)
    return _mixed_bit(encoding, state, buffer, end, model, models, where, sets, inputs, flag)


@kernel
def _flag_probability(model, models, f, quiet, where, sets, inputs):
    """Probability of a one in 2**-16 that _mixed_flag would code with now."""
    if quiet >= 0:
        return _probability(model.contexts, quiet)
    _flag_contexts(f, where, sets)
    return _mixed_probability(model, models, where, sets, inputs)


@kernel
def _mixed_magnitude(encoding, state, buffer, end, model, models, f, c, node, large, luma, expected, where, sets, inputs,
                     magnitude):
    """Codes a magnitude >= 1, or decodes and returns it."""
    for i in range(UNARY + 1):
        _more_contexts(f, c, node, i, large, luma, expected, where, sets)
        bit = 1 if magnitude - 1 > i else 0
        if not _mixed_bit(encoding, state, buffer, end, model, models, where, sets, inputs, bit):
            return np.int64(1 + i)
    if encoding:
        _enc_escape(state, buffer, magnitude - 1 - UNARY)
        return magnitude
    return _dec_escape(state, buffer, end) + UNARY + 1


@kernel
def _mixed_plane(encoding, state, buffer, end, model, models, f, tree, c0, c1, expected, down, where, sets, inputs, q):
    """Codes the coefficients q int64 [7, C] of components c0..c1-1 of a plane that has any, or decodes them into q."""
    left = 0
    for node in range(SPLITS):
        if _is_split(tree, node):
            left += c1 - c0
    some = False
    for c in range(c0, c1):
        ones, large = 0, 0
        for node in range(SPLITS):
            if not encoding:
                q[node, c] = 0
            if not _is_split(tree, node):
                continue
            left -= 1
            luma, size = abs(q[node, 0]) if c > 0 else 0, expected[node, c]
            nonzero = np.int64(1 if q[node, c] != 0 else 0)
            if left > 0 or some:
                _zero_contexts(f, c, node, ones, luma, left, size, where, sets)
                nonzero = _mixed_bit(encoding, state, buffer, end, model, models, where, sets, inputs, nonzero)
            elif not encoding:
                nonzero = np.int64(1)
            if not nonzero:
                continue
            _sign_contexts(f, c, node, q, size, down[node, c], where, sets)
            negative = _mixed_bit(encoding, state, buffer, end, model, min(models, SIGN_MODELS), where, sets, inputs,
                                  np.int64(1 if q[node, c] < 0 else 0))
            magnitude = _mixed_magnitude(encoding, state, buffer, end, model, models, f, c, node, large, luma, size, where, sets,
                                         inputs, abs(q[node, c]))
            q[node, c] = -magnitude if negative else magnitude
            some = True
            ones += 1
            large += 1 if magnitude > 1 else 0


@kernel
def _choose_mixed_plane(scaled, tree, model, models, f, p, c0, c1, lagrangian, bits_of, expected, where, sets, inputs, q):
    """Rate-distortion optimised quantisation of one plane into q, as direct._choose_plane; a sign is taken as one bit. p: 16-bit
    probability of the flag."""
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
            _zero_contexts(f, c, node, ones, luma, left, size, where, sets)
            p = _mixed_probability(model, models, where, sets, inputs)
            best = x * x * lagrangian
            cost_zero += best
            best += bits_of[(65536 - p) >> 4]
            rounded, choice = np.int64(x + 0.5), np.int64(0)
            price = np.float64(bits_of[p >> 4]) + 256.0
            magnitude = np.int64(1)
            while magnitude <= rounded:
                if magnitude - 1 <= UNARY:
                    _more_contexts(f, c, node, magnitude - 1, large, luma, size, where, sets)
                    p = _mixed_probability(model, models, where, sets, inputs)
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
    if any_left and cost < cost_zero:
        return 1
    for c in range(c0, c1):
        for node in range(SPLITS):
            q[node, c] = 0
    return 0
