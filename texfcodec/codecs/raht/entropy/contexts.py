"""Binarisation and context selection of the coefficients of a block (spec clause 7.5).

Every block has two energies, luma and chroma: 16 * (sum of |q|) / (number of coefficients), at most 255. The energies of the
neighbours decoded before on the same level and of the level above select the contexts.
"""

import numpy as np

from ....core.kernel import kernel
from ..transform.octree import COLUMNS, CORNERS, DIRECTIONS, PLANAR_DIRECTIONS, STEPS
from .range_coder import _dec_bit, _dec_bypass, _enc_bit, _enc_bypass, _probability

CLASSES = 7  # energy classes
LEVELS = 4  # level classes: voxels, one above, two above, the rest
N_BLOCK = 2 * LEVELS * 3 * 2 * CLASSES * CLASSES
N_ZERO = 3 * LEVELS * 3 * 3 * CLASSES * 3
N_MORE = 3 * CLASSES * 3
UNARY = 14
N_UNARY = 3 * UNARY
BLOCK_BASE = 0
ZERO_BASE = BLOCK_BASE + N_BLOCK
MORE_BASE = ZERO_BASE + N_ZERO
UNARY_BASE = MORE_BASE + N_MORE
CONTEXTS = UNARY_BASE + N_UNARY
MAX_PREFIX = 24  # of the Exp-Golomb escape: |q| < 2**25 + 15; clipped when dequantised


@kernel(forceinline=True)
def _class(e):
    """Energy class of 0 <= e (16 units per coefficient magnitude)."""
    if e == 0:
        return 0
    if e <= 1:
        return 1
    if e <= 3:
        return 2
    if e <= 6:
        return 3
    if e <= 12:
        return 4
    if e <= 28:
        return 5
    return 6


@kernel(forceinline=True)
def _surroundings(p, first, table, planar, energy, above, sums):
    """Fills sums int64 [6] with the weighted energies around block p: near (own level, decoded neighbours) of luma and chroma,
    far (level above) of luma and chroma, and the weights near and far.

    energy: uint8 [n, 2] of the blocks of this level, valid for first..p-1; above: uint8 [n, 2], energy of the block that each
    parent came from.
    """
    near_luma, near_chroma, near_weight = np.int64(0), np.int64(0), np.int64(0)
    far_luma, far_chroma, far_weight = 3 * np.int64(above[p, 0]), 3 * np.int64(above[p, 1]), np.int64(3)
    for i in range(PLANAR_DIRECTIONS if planar else CORNERS):
        q = np.int64(table[p, COLUMNS[planar, DIRECTIONS[i]]])
        if q < 0:
            continue
        w = 3 - STEPS[i]
        if first <= q < p:
            near_luma += w * energy[q, 0]
            near_chroma += w * energy[q, 1]
            near_weight += w
        else:
            far_luma += w * above[q, 0]
            far_chroma += w * above[q, 1]
            far_weight += w
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = near_luma, near_chroma, far_luma, far_chroma, near_weight, far_weight


@kernel
def _classes(sums, k):
    """(class of the own level, class of the level above) for plane k, from the sums of _surroundings."""
    near = _class((sums[k] + sums[4] - 1) // sums[4]) if sums[4] else 0
    return near, _class((sums[2 + k] + sums[5] - 1) // sums[5])


@kernel
def _block_context(k, level, n_coefficients, flag, near, far):
    size = min(n_coefficients, 3) - 1
    return BLOCK_BASE + ((((k * LEVELS + level) * 3 + size) * 2 + flag) * CLASSES + near) * CLASSES + far


@kernel
def _zero_context(c, level, stage, ones, strength, luma):
    """Context of "this coefficient is not zero". c: component; stage: 0..2; ones: nonzero coefficients so far in this component,
    capped at 2; luma: min(|q luma|, 2)."""
    return ZERO_BASE + ((((c * LEVELS + level) * 3 + stage) * 3 + min(ones, 2)) * CLASSES + strength) * 3 + min(luma, 2)


@kernel
def _more_context(c, strength, large):
    return MORE_BASE + (c * CLASSES + strength) * 3 + min(large, 2)


@kernel
def _enc_escape(state, out, rest):
    """Writes rest >= 1, the remainder of a magnitude, as an Exp-Golomb code."""
    bits = 0
    while (rest >> (bits + 1)) > 0:
        bits += 1
    for _ in range(bits):
        _enc_bypass(state, out, 1)
    _enc_bypass(state, out, 0)
    for b in range(bits - 1, -1, -1):
        _enc_bypass(state, out, (rest >> b) & 1)


@kernel
def _dec_escape(state, data, end):
    """Mirror of _enc_escape. A longer prefix is cut at MAX_PREFIX."""
    bits = 0
    while bits < MAX_PREFIX and _dec_bypass(state, data, end):
        bits += 1
    rest = np.int64(1)
    for _ in range(bits):
        rest = (rest << 1) | _dec_bypass(state, data, end)
    return rest


@kernel(inline="always")
def _escaped(encoding, coder, magnitude):
    """Codes a magnitude above UNARY + 1 after its bits with contexts, or decodes it. Returns the magnitude."""
    if encoding:
        _enc_escape(coder.state, coder.buffer, magnitude - 1 - UNARY)
    else:
        magnitude = _dec_escape(coder.state, coder.buffer, coder.end) + UNARY + 1
    return magnitude


@kernel
def _escape_cost(rest):
    """Cost of _enc_escape in 2**-8 bit."""
    bits = 0
    while (rest >> (bits + 1)) > 0:
        bits += 1
    return 256 * (2 * bits + 1)


@kernel
def _enc_magnitude(state, out, contexts, c, strength, large, magnitude, sign):
    """Codes |q| >= 1 and its sign."""
    _enc_bypass(state, out, sign)
    ctx = _more_context(c, strength, large)
    rest = magnitude - 1
    i = 0
    while i <= UNARY:
        bit = 1 if rest > i else 0
        _enc_bit(state, out, contexts, ctx, bit)
        if not bit:
            return
        ctx = UNARY_BASE + c * UNARY + min(i, UNARY - 1)
        i += 1
    _enc_escape(state, out, rest - UNARY)


@kernel
def _dec_magnitude(state, data, end, contexts, c, strength, large):
    """Mirror of _enc_magnitude: the signed value."""
    sign = _dec_bypass(state, data, end)
    ctx = _more_context(c, strength, large)
    magnitude = np.int64(1)
    i = 0
    while i <= UNARY:
        if not _dec_bit(state, data, end, contexts, ctx):
            return -magnitude if sign else magnitude
        magnitude += 1
        ctx = UNARY_BASE + c * UNARY + min(i, UNARY - 1)
        i += 1
    magnitude += _dec_escape(state, data, end) - 1
    return -magnitude if sign else magnitude


@kernel
def _cost(contexts, ctx, bit, bits_of):
    """Cost of a symbol in 2**-8 bit, without coding it. bits_of: int64 [4097], -256 log2(i / 4096)."""
    p = _probability(contexts, ctx)
    return bits_of[(p if bit else 65536 - p) >> 4]


@kernel
def _magnitude_cost(contexts, c, strength, large, magnitude, bits_of):
    """Cost of _enc_magnitude in 2**-8 bit."""
    cost = np.int64(256)
    ctx = _more_context(c, strength, large)
    rest = magnitude - 1
    i = 0
    while i <= UNARY:
        bit = 1 if rest > i else 0
        cost += _cost(contexts, ctx, bit, bits_of)
        if not bit:
            return cost
        ctx = UNARY_BASE + c * UNARY + min(i, UNARY - 1)
        i += 1
    return cost + _escape_cost(rest - UNARY)
