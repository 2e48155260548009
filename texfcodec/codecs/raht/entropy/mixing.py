"""Logistic mixing of context models (spec clause 7.6.4): adaptive bits whose probability several models determine together.

Each model gives the probability of its context as the logarithm of the odds. Two weight sets each form a weighted sum, and the
mean of both sums is the mixed probability. A refinement set corrects it by the observed frequencies at such probabilities.
"""

from collections import namedtuple
from itertools import pairwise

import numpy as np

from ....core.kernel import kernel
from .range_coder import PROBABILITY_BITS, RANGE, _adapt, _dec_split, _enc_split, new_contexts

# contexts: int32 [n, 3] (range_coder); weights: int64 [sets, MAX_MODELS + 1]; uses: int64 [sets]; refinement: int64 [sets, 24]
Model = namedtuple("Model", "contexts weights uses refinement")
# What the next bit is coded with, scratch of a walk: where int64 [MAX_MODELS], its contexts; sets int64 [3], two weight sets and
# a refinement set; inputs int64 [MAX_MODELS], what the contexts say
Chosen = namedtuple("Chosen", "where sets inputs")
MAX_MODELS = 8
LIMIT = 2816  # 11 nats in 1/256
BIAS = 256
MAX_WEIGHT = 1 << 20  # 16
FIRST_WEIGHT = 13107  # 0.2: BD-rate RGB on five clouds -26.5 % with 0.25, -25.4 with 0.35 (slower learning)
LEAST = 8  # 2**-16: no probability is below
FAST_SHIFT = 4
REFINEMENT_SHIFT = 6
REFINEMENT_POINTS = 24
MOST_USES = 1521  # from here on the rate of learning stays
LEARNING = 16 + 1536 // (16 + np.arange(MOST_USES + 1))  # by uses; a division here took a tenth of the decoder's time
# round(65536 / (1 + exp(-x))) for x = -11, -10.5, ..., 11
SQUASH_POINTS = (1, 2, 3, 5, 8, 13, 22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743, 32768,
                 40793, 47911, 53581, 57724, 60565, 62428, 63615, 64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514,
                 65523, 65528, 65531, 65533, 65534, 65535)


def _squash_table():
    inner = [(a * (128 - r) + b * r + 64) >> 7 for a, b in pairwise(SQUASH_POINTS) for r in range(128)]
    return np.array([*inner, SQUASH_POINTS[-1]], np.int32)


SQUASH = _squash_table()  # probability in 2**-16 of x = index - LIMIT
STRETCH = (np.searchsorted(SQUASH, 16 * np.arange(4096) + 8).clip(0, 2 * LIMIT) - LIMIT).astype(np.int16)


def new_model(contexts: int, weight_sets: int, refinement_sets: int) -> Model:
    """Return the adaptive Model of a codeword in its initial state, with so many contexts, sets of mixing weights, and sets of
    refinement of the mixed probability."""
    weights = np.full((weight_sets, MAX_MODELS + 1), FIRST_WEIGHT, np.int64)
    weights[:, MAX_MODELS] = 0
    points = SQUASH[np.minimum(256 * np.arange(REFINEMENT_POINTS), 2 * LIMIT)].astype(np.int64) << (PROBABILITY_BITS - 16)
    return Model(new_contexts(contexts), weights, np.zeros(weight_sets, np.int64), np.tile(points, (refinement_sets, 1)))


def new_chosen() -> Chosen:
    """An uninitialised Chosen."""
    return Chosen(np.zeros(MAX_MODELS, np.int64), np.zeros(3, np.int64), np.zeros(MAX_MODELS, np.int64))


def copy_model(model: Model) -> Model:
    """Return an independent copy of a model, to code again from its state."""
    return Model(*(a.copy() for a in model))


@kernel(forceinline=True)
def _weigh(model, m, chosen):
    """Fills chosen.inputs from the contexts chosen.where[0..m-1], the rest with 0. Returns the sums of the weight sets
    chosen.sets[0] and [1]."""
    a = BIAS * model.weights[chosen.sets[0], MAX_MODELS]
    b = BIAS * model.weights[chosen.sets[1], MAX_MODELS]
    for i in range(MAX_MODELS):
        if i >= m:
            chosen.inputs[i] = 0
            continue
        ctx = chosen.where[i]
        s = np.int64(STRETCH[(model.contexts[ctx, 0] + model.contexts[ctx, 1]) >> (PROBABILITY_BITS - 11)])
        chosen.inputs[i] = s
        a += model.weights[chosen.sets[0], i] * s
        b += model.weights[chosen.sets[1], i] * s
    return min(max(a >> 16, -LIMIT), LIMIT), min(max(b >> 16, -LIMIT), LIMIT)


@kernel(forceinline=True)
def _refined(model, s, x):
    """Final probability of a one in 2**-16, from the mixed logarithm x and refinement set s."""
    j, r = (x + LIMIT) >> 8, (x + LIMIT) & 255
    refined = (model.refinement[s, j] * (256 - r) + model.refinement[s, j + 1] * r) >> (PROBABILITY_BITS - 8)
    return min(max((SQUASH[x + LIMIT] + refined) >> 1, LEAST), 65536 - LEAST)


@kernel(forceinline=True)
def _moved(weight, change):
    return min(max(weight + ((change + (1 << 19)) >> 20), -MAX_WEIGHT), MAX_WEIGHT)


@kernel(forceinline=True)
def _move_four(weights, s, i, inputs, error):
    """Moves weights i..i+3 of a set. All are read before the first is written, so that four go at once."""
    a, b, c, d = weights[s, i], weights[s, i + 1], weights[s, i + 2], weights[s, i + 3]
    x, y, z, w = inputs[i], inputs[i + 1], inputs[i + 2], inputs[i + 3]
    a, b, c, d = _moved(a, x * error), _moved(b, y * error), _moved(c, z * error), _moved(d, w * error)
    weights[s, i], weights[s, i + 1], weights[s, i + 2], weights[s, i + 3] = a, b, c, d


@kernel(forceinline=True)
def _learn(model, m, chosen, a, b, bit):
    """Adapts weights, contexts and refinement to the symbol. Weights of inputs from m on do not change, because those inputs are
    0."""
    for half in range(2):
        s = chosen.sets[half]
        uses = model.uses[s]
        error = ((bit << 16) - SQUASH[(a if half == 0 else b) + LIMIT]) * LEARNING[uses]
        _move_four(model.weights, s, 0, chosen.inputs, error)
        _move_four(model.weights, s, 4, chosen.inputs, error)
        model.weights[s, MAX_MODELS] = _moved(model.weights[s, MAX_MODELS], BIAS * error)
        model.uses[s] = min(uses + 1, MOST_USES)
    for i in range(m):
        _adapt(model.contexts, chosen.where[i], bit, FAST_SHIFT)
    x = ((a + b) >> 1) + LIMIT
    j = (x + 128) >> 8
    model.refinement[chosen.sets[2], j] += (((1 << PROBABILITY_BITS) - 1) * bit - model.refinement[chosen.sets[2], j]
                                            ) >> REFINEMENT_SHIFT


@kernel
def _enc_mixed_bit(coder, model, m, chosen, bit):
    a, b = _weigh(model, m, chosen)
    _enc_split(coder.state, coder.buffer, (coder.state[RANGE] >> 16) * _refined(model, chosen.sets[2], (a + b) >> 1), bit)
    _learn(model, m, chosen, a, b, bit)


@kernel
def _dec_mixed_bit(coder, model, m, chosen):
    a, b = _weigh(model, m, chosen)
    bound = (coder.state[RANGE] >> 16) * _refined(model, chosen.sets[2], (a + b) >> 1)
    bit = _dec_split(coder.state, coder.buffer, coder.end, bound)
    _learn(model, m, chosen, a, b, bit)
    return bit


@kernel(inline="always")
def _mixed_bit(encoding, coder, model, m, chosen, bit):
    """Codes `bit` with m models, or decodes it. Returns the bit."""
    if encoding:
        _enc_mixed_bit(coder, model, m, chosen, bit)
    else:
        bit = _dec_mixed_bit(coder, model, m, chosen)
    return bit


@kernel
def _mixed_probability(model, m, chosen):
    """Probability of a one in 2**-16 that _mixed_bit would code with now."""
    a, b = _weigh(model, m, chosen)
    return _refined(model, chosen.sets[2], (a + b) >> 1)
