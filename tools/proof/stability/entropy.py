"""Cases of the entropy coder: very long runs, the skew of bits, and the state of kernel and oracle side by side."""

import math

import numpy as np

from conformance.reference import mixing
from oracles import kernels as oracles
from texfcodec.codecs.raht.entropy.mixing import LIMIT, MAX_MODELS, _dec_mixed_bit, _enc_mixed_bit, new_chosen, new_model
from texfcodec.codecs.raht.entropy.range_coder import (
    FULL,
    PROBABILITY_BITS,
    RANGE,
    TOP,
    Coder,
    _dec_bit,
    _dec_bypass,
    _enc_bit,
    _enc_bypass,
    _probability,
    finish,
    new_contexts,
    new_decoder,
    new_encoder,
)
from texfcodec.core.kernel import kernel
from tools.proof.stability.case import Case, Draws

GROUP = "Entropy coding"
CONTEXTS = 8  # of each model
THRESHOLDS = (0, 1, 16, 2000, 32768, 63536, 65520, 65535, 65536)  # of 65536 bits, how many are ones
LARGEST = (1 << PROBABILITY_BITS) - 1
INPUTS = MAX_MODELS + 1  # with the bias
LOST = -math.log2(1 - 2.0**-8)  # bits a symbol


@kernel
def _next_bit(place, regimes, length):
    """The next bit of a run: place int64 [2] holds the state of a generator and the number of the bit; every `length` bits comes
    another of the thresholds regimes int64 [R], -1 for bits that alternate."""
    place[0] = (place[0] * 1103515245 + 12345) & 0x7FFFFFFF
    threshold = regimes[(place[1] // length) % regimes.shape[0]]
    place[1] += 1
    return place[1] & 1 if threshold < 0 else (1 if (place[0] >> 8) & 65535 < threshold else 0)


@kernel
def _mix_run(encoding, n, coder, model, m, place, regimes, length, chosen):
    """Codes n bits of a run, or decodes them. Returns the largest magnitude of a weight, -1 where something is out of its range
    or decoded otherwise."""
    largest = np.int64(0)
    for _ in range(n):
        bit = _next_bit(place, regimes, length)
        for i in range(m):
            chosen.where[i] = CONTEXTS * i + (place[0] >> (i + 3)) % CONTEXTS
        chosen.sets[0], chosen.sets[1], chosen.sets[2] = place[0] >> 20 & 1, 2 + (place[0] >> 21 & 1), place[0] >> 22 & 1
        if encoding:
            _enc_mixed_bit(coder, model, m, chosen, bit)
        elif _dec_mixed_bit(coder, model, m, chosen) != bit:
            return np.int64(-1)
        for s in range(2):
            for i in range(MAX_MODELS + 1):
                largest = max(largest, abs(model.weights[chosen.sets[s], i]))
        for i in range(m):
            fast, slow = model.contexts[chosen.where[i], 0], model.contexts[chosen.where[i], 1]
            if min(fast, slow) < 0 or max(fast, slow) > LARGEST:
                return np.int64(-1)
        if coder.state[RANGE] < TOP or coder.state[RANGE] >> 32 or (not encoding and coder.state[0] >= coder.state[RANGE]):
            return np.int64(-1)
    return largest


@kernel
def _plain_run(encoding, n, state, buffer, end, contexts, place, regimes, length, information):
    """As _mix_run with single contexts, every 64th bit without one; adds to information [1] what the bits ought to cost. Returns
    0, -1 where a bit is decoded otherwise or the state leaves its range."""
    for i in range(n):
        bit, ctx = _next_bit(place, regimes, length), (place[0] >> 5) % CONTEXTS
        plain = i % 64 == 63
        p = 0.5 if plain else _probability(contexts, ctx) / 65536.0
        information[0] -= np.log2(p if bit else 1 - p)
        if encoding and plain:
            _enc_bypass(state, buffer, bit)
        elif encoding:
            _enc_bit(state, buffer, contexts, ctx, bit)
        elif (_dec_bypass(state, buffer, end) if plain else _dec_bit(state, buffer, end, contexts, ctx)) != bit:
            return np.int64(-1)
        if state[RANGE] < TOP or state[RANGE] >> 32 or (not encoding and state[0] >= state[RANGE]):
            return np.int64(-1)
    return np.int64(0)


def run_of(draw: Draws) -> tuple:
    """(place, thresholds, bits between them) of a run: constant, skewed, alternating, even, and changes between these."""
    regimes = [draw.pick((*THRESHOLDS, -1)) for _ in range(draw.integer(1, 4))]
    seed, length = draw.integer(1, 1 << 30), int(draw.power(0, 6))
    return lambda: np.array([seed, 0], np.int64), np.array(regimes, np.int64), length


def long_mixing(draw: Draws) -> float:
    """Bits of the largest sum of nine products in a long run; infinite where a bit comes back otherwise or a state leaves its
    range."""
    n, m = draw.size(1 << 12, 1 << 24, 1 << 31), draw.integer(1, MAX_MODELS)
    place, regimes, length = run_of(draw)
    out = np.empty(n // 4 + 4096, np.uint8)
    coder, model = Coder(new_encoder(), out, 0), new_model(CONTEXTS * m, 4, 2)
    largest = _mix_run(True, n, coder, model, m, place(), regimes, length, new_chosen())
    if largest < 0:
        return np.inf
    if not coder.state[FULL]:
        data = np.frombuffer(finish(coder.state, out) + b"\0", np.uint8).copy()
        decoder, again = Coder(new_decoder(data, 0, len(data)), data, len(data)), new_model(CONTEXTS * m, 4, 2)
        if _mix_run(False, n, decoder, again, m, place(), regimes, length, new_chosen()) != largest:
            return np.inf
        if not all(np.array_equal(a, b) for a, b in zip(model, again, strict=True)):
            return np.inf
    if model.refinement.min() < 0 or model.refinement.max() > LARGEST:
        return np.inf
    return math.log2(INPUTS * int(largest) * LIMIT)


def long_coding(draw: Draws) -> float:
    """Bits a symbol that a codeword is longer than its bits' probabilities say, less 40 for its end; infinite where a bit comes
    back otherwise."""
    n = draw.size(1 << 12, 1 << 24, 1 << 31)
    place, regimes, length = run_of(draw)
    out, state, information = np.empty(n // 4 + 4096, np.uint8), new_encoder(), np.zeros(1)
    if _plain_run(True, n, state, out, 0, new_contexts(CONTEXTS), place(), regimes, length, information) or state[FULL]:
        return np.inf
    data = finish(state, out)
    buffer = np.frombuffer(data + b"\0", np.uint8).copy()
    decoder, end = new_decoder(buffer, 0, len(data)), len(data)
    if _plain_run(False, n, decoder, buffer, end, new_contexts(CONTEXTS), place(), regimes, length, np.zeros(1)):
        return np.inf
    return max(0.0, (8 * len(data) - 40 - float(information[0])) / n)


def coded_alike(draw: Draws) -> float:
    """Bits that the oracle decodes otherwise, and entries of its contexts that are others at the end."""
    rng, n = draw.generator(), draw.integer(1, 600)
    skew = draw.pick((0.5, 0.02, 0.98, 0.0, 1.0))
    symbols = [(int(c), int(b)) for c, b in zip(rng.integers(-1, 8, n), rng.random(n) < skew, strict=True)]
    state, out, contexts = new_encoder(), np.empty(4 * n + 64, np.uint8), new_contexts(8)
    for ctx, bit in symbols:
        if ctx < 0:
            _enc_bypass(state, out, bit)
        else:
            _enc_bit(state, out, contexts, ctx, bit)
    plain = oracles.RangeDecoder(finish(state, out))
    wrong = sum((plain.bypass() if ctx < 0 else plain.bit(ctx)) != bit for ctx, bit in symbols)
    want = [plain.contexts.get(i, (2**21, 2**21, 0)) for i in range(8)]
    return float(wrong + (contexts != want).sum())


def mixed_alike(draw: Draws) -> float:
    """Entries of contexts, weights and refinement that are not the oracle's after a run of mixed bits."""
    m, (place, regimes, length), n = draw.integer(1, MAX_MODELS), run_of(draw), draw.integer(1, 300)
    place, out = place(), np.empty(8192, np.uint8)
    coder, model, chosen = Coder(new_encoder(), out, 0), new_model(CONTEXTS * m, 2, 1), new_chosen()
    contexts, sets, refinement = {}, [mixing.WeightSet(m), mixing.WeightSet(m)], mixing.new_refinement()
    chosen.sets[:] = 0, 1, 0
    for _ in range(n):
        bit = int(_next_bit(place, regimes, length))
        where = [CONTEXTS * i + (int(place[0]) >> (i + 3)) % CONTEXTS for i in range(m)]
        chosen.where[:m] = where
        _enc_mixed_bit(coder, model, m, chosen, bit)
        own = [contexts.get(ctx, (2**21, 2**21, 0)) for ctx in where]
        mixing.mixed_bit(lambda p, bit=bit: bit, own, *sets, refinement)
        contexts.update(zip(where, own, strict=True))
    wrong = sum(tuple(model.contexts[ctx].tolist()) != state for ctx, state in contexts.items())
    for number, one in enumerate(sets):
        wrong += [*model.weights[number, :m].tolist(), int(model.weights[number, -1])] != one.weight
        wrong += int(model.uses[number]) != one.count
    return float(wrong + (model.refinement[0] != refinement).sum())


RUNS = "constant, skewed, alternating and even bits and changes between them"
CASES = (
    Case("mixing, long runs", GROUP,
         f"2^24 bits a run (2^31 with --most), {RUNS}, one to eight models, encoded and decoded",
         35, "bits of a sum",
         "Weights are at most 2^20 (7.6.4), so eight products with 2816 and one with 256 stay below 2^35. Contexts and "
         "refinements move towards 0 or 2^22 - 1 by a part of the way and stay between; coder and decoder end in one state.",
         long_mixing, 12, True, True),
    Case("range coder, long runs", GROUP,
         f"2^24 bits a run (2^31 with --most), {RUNS}",
         LOST, "bits a symbol",
         "range >> 16 is at least 256 and rounded down, so a bit loses at most one part in 256 of its share (7.6.2): 0.00565 "
         "bits. The end of a codeword takes 40 bits at most.",
         long_coding, 12, True, True),
    Case("range coder and oracle", GROUP,
         "bits in any contexts and without one, of any skew",
         0, "entries that differ",
         "7.6.3 in 64-bit integers: estimates are below 2^22, range times probability below 2^32.",
         coded_alike, 20),
    Case("mixing and oracle", GROUP,
         f"up to 300 bits of such runs: {RUNS}",
         0, "entries that differ",
         "7.6.4 in 64-bit integers: an input times an error and a sum of nine products are below 2^35.",
         mixed_alike, 12),
)
