"""Adaptive binary range coder (spec clause 7.6): byte-wise, 32-bit range, carry through a cached byte.

A coder lives in an int64 array so that a kernel can stop after any level and go on later: [LOW, RANGE, CACHE, PENDING, POS, FULL]
while encoding, [CODE, RANGE, -, -, POS, -] while decoding. A context is one row of an int64 table: two probabilities of a one in
units of 2**-22, a fast and a slow one, and a count of the symbols seen (up to 7) that makes the first steps large.
"""

import numpy as np
from numba import njit

LOW, RANGE, CACHE, PENDING, POS, FULL = range(6)
CODE = LOW
PROBABILITY_BITS = 22
FAST_SHIFT, SLOW_SHIFT = 4, 7
TOP = 1 << 24
START_BYTES = 4


def new_contexts(count):
    """Context table in its initial state (spec 7.6.1): int64 [count, 3]."""
    contexts = np.zeros((count, 3), np.int64)
    contexts[:, :2] = 1 << (PROBABILITY_BITS - 1)
    return contexts


@njit(cache=True, nogil=True)
def _probability(contexts, ctx):
    """16-bit probability of a one, in 24..65512: both estimates averaged."""
    p = (contexts[ctx, 0] + contexts[ctx, 1]) >> (PROBABILITY_BITS - 15)
    return min(max(p, 24), 65512)


@njit(cache=True, nogil=True)
def _adapt(contexts, ctx, bit):
    """Moves both estimates towards the symbol (spec 7.6.3)."""
    seen = contexts[ctx, 2]
    target = ((1 << PROBABILITY_BITS) - 1) * bit
    contexts[ctx, 0] += (target - contexts[ctx, 0]) >> min(seen + 1, FAST_SHIFT)
    contexts[ctx, 1] += (target - contexts[ctx, 1]) >> min(seen + 1, SLOW_SHIFT)
    if seen < SLOW_SHIFT:
        contexts[ctx, 2] = seen + 1


def new_encoder():
    """State of a fresh encoder."""
    state = np.zeros(6, np.int64)
    state[RANGE] = 0xFFFFFFFF
    state[CACHE] = -1  # no byte yet
    return state


@njit(cache=True, nogil=True)
def _put(state, out, byte):
    if state[POS] < out.shape[0]:
        out[state[POS]] = byte
        state[POS] += 1
    else:
        state[FULL] = 1


@njit(cache=True, nogil=True)
def _shift_low(state, out):
    """Moves the top byte of LOW out; bytes of 0xFF wait until it is known whether a carry passes through them."""
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _enc_bit(state, out, contexts, ctx, bit):
    _enc_split(state, out, (state[RANGE] >> 16) * _probability(contexts, ctx), bit)
    _adapt(contexts, ctx, bit)


@njit(cache=True, nogil=True)
def _dec_bit(state, data, end, contexts, ctx):
    bit = _dec_split(state, data, end, (state[RANGE] >> 16) * _probability(contexts, ctx))
    _adapt(contexts, ctx, bit)
    return bit


@njit(cache=True, nogil=True)
def _enc_bypass(state, out, bit):
    _enc_split(state, out, state[RANGE] >> 1, bit)


@njit(cache=True, nogil=True)
def _dec_bypass(state, data, end):
    return _dec_split(state, data, end, state[RANGE] >> 1)


@njit(cache=True, nogil=True)
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


def finish(state, out):
    """Ends a codeword. Returns its bytes in out without trailing zeros (the decoder reads zeros past the end)."""
    _finish(state, out)
    if state[FULL]:
        raise OverflowError("range coder output buffer is full")
    return out[: int(state[POS])].tobytes().rstrip(b"\0")


def new_decoder(data, begin, end):
    """State of a decoder for the codeword data[begin:end] (uint8): the first four bytes are in CODE already."""
    state = np.zeros(6, np.int64)
    head = bytes(data[begin : min(end, begin + START_BYTES)]).ljust(START_BYTES, b"\0")
    state[CODE] = min(int.from_bytes(head, "big"), 0xFFFFFFFE)  # below RANGE, where it then stays
    state[RANGE] = 0xFFFFFFFF
    state[POS] = begin + START_BYTES
    return state
