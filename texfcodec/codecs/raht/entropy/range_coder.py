"""Adaptive binary range coder (spec clause 7.6): byte-wise, 32-bit range, carry through a cached byte.

A coder lives in an int64 array so that a kernel can stop after any level and go on later: [LOW, RANGE, CACHE, PENDING, POS, FULL]
while encoding, [CODE, RANGE, -, -, POS, -] while decoding. A context is one row of an int32 table: two probabilities of a one in
units of 2**-22, a fast and a slow one, and a count of the symbols seen (up to 63): the first steps are those of a running mean.
"""

from collections import namedtuple

import numpy as np

from ....core.kernel import kernel

LOW, RANGE, CACHE, PENDING, POS, FULL = range(6)
CODE = LOW
PROBABILITY_BITS = 22
# Shifts 3 and 7 with this start: BD-rate -9.6 % on five reference clouds; 4 and 7: -9.1; 5 and 8: -8.2; counting to 7: -6.7
FAST_SHIFT = 3
MOST_SEEN = 63
RATE = np.array([(n + 1).bit_length() for n in range(MOST_SEEN + 1)])  # slow shift by symbols seen: 1, 2, 2, 3, ... 7
TOP = 1 << 24
START_BYTES = 4
# A coder on its way: state int64 [6]; buffer uint8, the output, or the unit's data; end: of the codeword in it while decoding
Coder = namedtuple("Coder", "state buffer end")


def new_contexts(count: int) -> np.ndarray:
    """Context table in its initial state (spec 7.6.1): int32 [count, 3]."""
    contexts = np.zeros((count, 3), np.int32)
    contexts[:, :2] = 1 << (PROBABILITY_BITS - 1)
    return contexts


@kernel
def _probability(contexts, ctx):
    """16-bit probability of a one, in 24..65512: both estimates averaged."""
    p = (np.int64(contexts[ctx, 0]) + contexts[ctx, 1]) >> (PROBABILITY_BITS - 15)
    return min(max(p, 24), 65512)


@kernel
def _adapt(contexts, ctx, bit, fast_shift):
    """Moves both estimates towards the symbol (spec 7.6.3)."""
    seen = contexts[ctx, 2]
    rate = RATE[seen]
    target = ((1 << PROBABILITY_BITS) - 1) * bit
    contexts[ctx, 0] += (target - contexts[ctx, 0]) >> min(rate, fast_shift)
    contexts[ctx, 1] += (target - contexts[ctx, 1]) >> rate
    contexts[ctx, 2] = min(seen + 1, MOST_SEEN)


def new_encoder() -> np.ndarray:
    """State of an encoder before its first symbol."""
    state = np.zeros(6, np.int64)
    state[RANGE] = 0xFFFFFFFF
    state[CACHE] = -1  # no byte yet
    return state


@kernel
def _put(state, out, byte):
    if state[POS] < out.shape[0]:
        out[state[POS]] = byte
        state[POS] += 1
    else:
        state[FULL] = 1


@kernel
def _shift_low(state, out):
    """Writes the top byte of LOW; bytes of 0xFF are held back until a carry can no longer pass through them."""
    carry = state[LOW] >> 32
    if carry or state[LOW] < 0xFF000000:
        if state[CACHE] >= 0:
            _put(state, out, (state[CACHE] + carry) & 0xFF)
        while state[PENDING] > 0:
            _put(state, out, (0xFF + carry) & 0xFF)
            state[PENDING] -= 1
        state[CACHE] = (state[LOW] >> 24) & 0xFF
    else:
        state[PENDING] += 1
    state[LOW] = (state[LOW] & 0x00FFFFFF) << 8


@kernel
def _enc_split(state, out, bound, bit):
    """Narrows the interval to its lower part [0, bound) for a one, to the rest for a zero."""
    if bit:
        state[RANGE] = bound
    else:
        state[LOW] += bound
        state[RANGE] -= bound
    while state[RANGE] < TOP:
        state[RANGE] <<= 8
        _shift_low(state, out)


@kernel
def _dec_split(state, data, end, bound):
    """Mirror of _enc_split: returns the bit. Bytes at or past end read as zero (spec 7.6.2)."""
    if state[CODE] < bound:
        bit = np.int64(1)
        state[RANGE] = bound
    else:
        bit = np.int64(0)
        state[CODE] -= bound
        state[RANGE] -= bound
    while state[RANGE] < TOP:
        state[RANGE] <<= 8
        byte = np.int64(0)
        if state[POS] < end and end <= data.shape[0]:
            byte = np.int64(data[state[POS]])
        state[CODE] = (state[CODE] << 8) | byte
        state[POS] += 1
    return bit


@kernel
def _enc_bit(state, out, contexts, ctx, bit):
    _enc_split(state, out, (state[RANGE] >> 16) * _probability(contexts, ctx), bit)
    _adapt(contexts, ctx, bit, FAST_SHIFT)


@kernel
def _dec_bit(state, data, end, contexts, ctx):
    bit = _dec_split(state, data, end, (state[RANGE] >> 16) * _probability(contexts, ctx))
    _adapt(contexts, ctx, bit, FAST_SHIFT)
    return bit


@kernel
def _enc_bypass(state, out, bit):
    _enc_split(state, out, state[RANGE] >> 1, bit)


@kernel
def _dec_bypass(state, data, end):
    return _dec_split(state, data, end, state[RANGE] >> 1)


@kernel
def _finish(state, out):
    """Picks the value in [LOW, LOW + RANGE) with the most trailing zero bits, so that the last bytes can be left out."""
    for bits in range(31, -1, -1):
        mask = (np.int64(1) << bits) - 1
        value = (state[LOW] + mask) & ~mask
        if value < state[LOW] + state[RANGE]:
            state[LOW] = value
            break
    for _ in range(5):
        _shift_low(state, out)


def finish(state: np.ndarray, out: np.ndarray) -> bytes:
    """End a codeword and return the bytes that the encoder has written to out, without trailing zeros (the decoder reads zeros
    past the end). state: of the encoder."""
    _finish(state, out)
    if state[FULL]:
        raise OverflowError("range coder output buffer is full")
    return out[: int(state[POS])].tobytes().rstrip(b"\0")


def new_decoder(data: np.ndarray, begin: int, end: int) -> np.ndarray:
    """Return the state of a decoder at the begin of the codeword data[begin:end], uint8; CODE already holds its first four
    bytes."""
    state = np.zeros(6, np.int64)
    head = bytes(data[begin : min(end, begin + START_BYTES)]).ljust(START_BYTES, b"\0")
    state[CODE] = min(int.from_bytes(head, "big"), 0xFFFFFFFE)  # below RANGE, where it then stays
    state[RANGE] = 0xFFFFFFFF
    state[POS] = begin + START_BYTES
    return state
