"""Coding of a plane of coefficients with direct contexts (spec clauses 7.5.2 to 7.5.4)."""

import numpy as np

from ....ground.kernel import kernel
from ..entropy.contexts import _cost, _dec_magnitude, _enc_magnitude, _magnitude_cost, _zero_context
from ..entropy.range_coder import _dec_bit, _enc_bit
from ..transform.raht import SPLITS, _is_split


@kernel
def _stage(node):
    return 0 if node == 0 else (1 if node < 3 else 2)


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
