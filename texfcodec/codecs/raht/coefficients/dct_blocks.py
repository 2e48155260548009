"""DCT blocks of planar supports (spec clause 7.11.4): complete squares of 8 x 8 texels, coded as a whole.

The cosine transform of the squares of a former JPEG file has only zeros and multiples of steps, unlike any other transform of it.
The mean of such a node is known three levels above the texels, so 63 coefficients of each component remain: the number of nonzero
coefficients is coded first, then the coefficients in zigzag order up to the last nonzero one.
"""

from collections import namedtuple

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import CLASSES, UNARY, _class, _escaped
from ..entropy.mixing import Model, _mixed_bit, new_model
from ..transform.octree import Level
from ..transform.quantise import MAX_MEAN
from .mixed_contexts import CONTEXTS as FIRST_CONTEXT
from .mixed_contexts import FINE, _fine, _sixteenths
from .mixed_contexts import REFINEMENT_SETS as FIRST_REFINEMENT
from .mixed_contexts import WEIGHT_SETS as FIRST_SET
from .planar import NORTH, NORTH_WEST, WEST, _sign_class

SIDE, SIZE = 8, 64
UP = 3  # levels from a block to its texels
BLOCK, PART = 1, 2  # entries of DctBlocks.whole
# 2**14 times the orthonormal transform: [frequency, place]
BASIS = np.rint(np.cos(np.outer(np.arange(SIDE), 2 * np.arange(SIDE) + 1) * np.pi / 16) * 2.0**13).astype(np.int64)
BASIS[0] = 5793
MAX_COEFFICIENT = 1 << 25
ZIGZAG = np.array(sorted(range(SIZE), key=lambda i: (i // 8 + i % 8, i // 8 if (i // 8 + i % 8) % 2 else i % 8)))
# Of the texel in row y and column x, entry 8 y + x, its place in Morton order
TEXEL = np.array([sum((x >> b & 1) << 2 * b | (y >> b & 1) << 2 * b + 1 for b in range(3)) for y in range(8) for x in range(8)])
# The encoder's rounding: at most 0.35 and 0.41 up, to 1 and to more. Other thresholds, and prices by how often a coefficient of
# its place was kept, are within 1 % of BD-rate on four images.
TO_ONE, TO_MORE = 0.35, 0.41
LEAST_SQUARES, MOST_SQUARES = 8, 512  # that jpeg_likeness looks at

_I, _SIGNED = UNARY + 1, 2 * CLASSES - 1
COUNT_SIZES = (3 * 64 * 64, 3 * 64 * 64, 3 * FINE * FINE * 64, 3 * 64 * 64)
ZERO_SIZES = (3 * 64 * 64, 3 * 64 * FINE, 3 * FINE * FINE * FINE, 3 * 64 * 3 * 3 * 3, 3 * 64 * FINE, 3 * FINE * FINE * FINE)
MORE_SIZES = (3 * _I * 64, 3 * _I * FINE * FINE, 3 * _I * FINE * FINE, 3 * _I * FINE * 4, 3 * _I * FINE * FINE)
SIGN_SIZES = (3 * 64 * 9, 3 * _SIGNED * _SIGNED * 4, 3 * 64 * 9, 3 * 64 * _SIGNED)
COUNT_MODELS, ZERO_MODELS, MORE_MODELS, SIGN_MODELS = (len(s) for s in (COUNT_SIZES, ZERO_SIZES, MORE_SIZES, SIGN_SIZES))
_BASES = FIRST_CONTEXT + np.cumsum([0, *COUNT_SIZES, *ZERO_SIZES, *MORE_SIZES, *SIGN_SIZES])
COUNT, ZERO, MORE, SIGN = _BASES[:4], _BASES[4:10], _BASES[10:15], _BASES[15:19]
# First and second weight sets, and refinement sets, that have the numbers of the first
SETS_COUNT, SETS_ZERO, SETS_MORE, SETS_SIGN, SETS = 0, 192, 384, 384 + 3 * _I, 576 + 3 * _I
SECOND_COUNT, SECOND_ZERO, SECOND_MORE, SECOND_SIGN, SECOND = SETS + np.cumsum([0, 3 * FINE, 3 * FINE, 3 * FINE, 12 * FINE])
CONTEXTS, WEIGHT_SETS, REFINEMENT_SETS = int(_BASES[19]), FIRST_SET + int(SECOND), FIRST_REFINEMENT + SETS

# DCT blocks of a level. whole: uint8 [n], BLOCK where a node is one, PART where it is a part of one, else 0; first: int64 [n], a
# node's first texel; texels: int32 [N, C], means of the texels of blocks; kept: int8 [n, C, 64], coefficients of blocks; counts:
# uint8 [n, C], how many of them are not zero. No rows where no node is whole.
DctBlocks = namedtuple("DctBlocks", "whole first texels kept counts")
# Scratch: q int64 [C, 64], coefficients by 8 v + u; west, north int64 [8], what is left of the border by v and u; beside int64
# [3], the blocks to the west, north and north-west or -1; rows float64 and sums int64 [8, 8], half transformed
DctScratch = namedtuple("DctScratch", "q west north beside rows sums")


def jpeg_likeness(keys: np.ndarray, values: np.ndarray) -> float:
    """Return how little the texels of an image look like decoded JPEG. The measure: of the DCT coefficients of complete 8x8
    squares, the number of magnitude 1 to 2 per coefficient below 1. A JPEG file's rounding leaves none between its steps and 0:
    the result is 0 to 0.1 on textures that were JPEG, 0.05 to 1 on others, and infinite if there are hardly any complete
    squares. values: int32 [N] on ascending planar keys int64 [N]."""
    square = keys >> 3 * UP
    first = np.flatnonzero(square[: 1 - SIZE] == square[SIZE - 1 :])
    if len(first) < LEAST_SQUARES:
        return np.inf
    some = first[np.linspace(0, len(first) - 1, min(MOST_SQUARES, len(first))).astype(int)]
    texels = values[some[:, None] + TEXEL].reshape(-1, SIDE, SIDE) / 2.0**12
    coefficients = np.abs(np.einsum("vy,nyx,ux->nvu", BASIS / 2.0**14, texels, BASIS / 2.0**14)).reshape(-1, SIZE)[:, 1:]
    small, between = int((coefficients < 1).sum()), int(((coefficients >= 1) & (coefficients < 2)).sum())
    return between / max(small, 1)


def new_dct_model() -> Model:
    """Model of a codeword with DCT blocks in its initial state."""
    return new_model(CONTEXTS, WEIGHT_SETS, REFINEMENT_SETS)


def new_dct_scratch(components: int) -> DctScratch:
    """Return a DctScratch, the arrays in which kernels code one 8x8 block, uninitialised."""
    zeros = lambda *shape: np.zeros(shape, np.int64)
    return DctScratch(zeros(components, SIZE), zeros(8), zeros(8), zeros(3), np.zeros((8, 8)), zeros(8, 8))


def no_dct_blocks(components: int) -> DctBlocks:
    """Return empty DctBlocks, for a level that has none."""
    return DctBlocks(np.zeros(0, np.uint8), np.zeros(0, np.int64), np.zeros((0, components), np.int32),
                     np.zeros((0, components, SIZE), np.int8), np.zeros((0, components), np.uint8))


def dct_blocks(levels: list[Level], depth: int, components: int, above: DctBlocks) -> tuple[DctBlocks, int]:
    """Find which octree nodes are 8x8 blocks that are coded by DCT, or parts of such: (DctBlocks of the nodes at `depth`; number
    of texels of each of their children, 0 if no node is whole). above: DctBlocks of the level above."""
    up, weight = len(levels) - 1 - depth, levels[depth].weight
    if up > UP or len(levels) <= UP:
        return no_dct_blocks(components), 0
    first = np.cumsum(weight) - weight
    if up == UP:
        texels = np.zeros((len(levels[-1]), components), np.int32)
        kept, counts = np.zeros((len(weight), components, SIZE), np.int8), np.zeros((len(weight), components), np.uint8)
        return DctBlocks((weight == SIZE).astype(np.uint8) * BLOCK, first, texels, kept, counts), SIZE // 4
    first_child = levels[depth - 1].first_child
    assert first_child is not None  # only the last level has none
    whole = np.repeat(np.where(above.whole, PART, 0).astype(np.uint8), np.diff(first_child))
    return above._replace(whole=whole, first=first), 4**up // 4


@kernel(forceinline=True)
def _signed_class(v, inverse):
    """Sign and class of an expected coefficient, 0..2 * CLASSES - 2."""
    size = _class(_sixteenths(v, inverse) >> 2)
    return CLASSES - 1 + (size if v >= 0 else -size)


@kernel(forceinline=True)
def _share(frequency, v):
    """Contribution of a coefficient v to the values at the border, half a texel beyond the outermost centres."""
    return v >> 1 if frequency else (181 * v) >> 9


@kernel(forceinline=True)
def _alone(frequency, v):
    """The coefficient whose contribution at the border is v."""
    return 2 * v if frequency else (181 * v) >> 6


@kernel
def _look_beside(p, begin, c, table, mean, dct, s):
    """Fills s.beside, and s.west and s.north from the texels of the blocks to the west and north. |texel| <= 2**22, so a sum is
    below 2**41."""
    texels, first = dct.texels, dct.first
    for j in range(3):
        q = np.int64(table[p, (WEST, NORTH, NORTH_WEST)[j]])
        s.beside[j] = q if q >= begin and dct.whole[q] else -1
    for frequency in range(8):
        west = north = np.int64(0)
        for i in range(8):
            if s.beside[0] >= 0:
                at = first[s.beside[0]]
                west += BASIS[frequency, i] * (3 * np.int64(texels[at + TEXEL[8 * i + 7], c]) - texels[at + TEXEL[8 * i + 6], c]
                                               - 2 * mean)
            if s.beside[1] >= 0:
                at = first[s.beside[1]]
                north += BASIS[frequency, i] * (3 * np.int64(texels[at + TEXEL[56 + i], c]) - texels[at + TEXEL[48 + i], c]
                                                - 2 * mean)
        s.west[frequency], s.north[frequency] = west >> 15, north >> 15


@kernel
def _count(encoding, coder, model, chosen, p, c, inverse, dct, s):
    """Codes the number of nonzero coefficients of s.q[c], or decodes it. Returns the number."""
    counts, where, sets, west, north, north_west = dct.counts, chosen.where, chosen.sets, s.beside[0], s.beside[1], s.beside[2]
    if west >= 0 and north >= 0:
        around = (np.int64(counts[west, c]) + counts[north, c] + 1) >> 1
    elif west >= 0 or north >= 0:
        around = np.int64(counts[max(west, north), c])
    else:
        around = np.int64(counts[p, 0]) if c else np.int64(32)
    if c:
        other = np.int64(counts[p, c - 1])
    else:
        other = np.int64(counts[north_west, 0]) if north_west >= 0 else np.int64(63)
    border, total = np.int64(0), np.int64(0)
    for i in range(8):
        border += abs(s.west[i]) + abs(s.north[i])
    border = _fine(_sixteenths(border, inverse) >> 3)
    for place in range(1, SIZE):
        total += 1 if s.q[c, place] else 0
    node = np.int64(1)
    for b in range(5, -1, -1):
        where[0] = COUNT[0] + (c * 64 + around) * 64 + node
        where[1] = COUNT[1] + (c * 64 + other) * 64 + node
        where[2] = COUNT[2] + ((c * FINE + border) * FINE + _fine(around)) * 64 + node
        where[3] = COUNT[3] + (c * 64 + (np.int64(counts[west, c]) if west >= 0 else around)) * 64 + node
        sets[0] = FIRST_SET + SETS_COUNT + c * 64 + node
        sets[1] = FIRST_SET + SECOND_COUNT + c * FINE + _fine(around)
        sets[2] = FIRST_REFINEMENT + SETS_COUNT + c * 64 + node
        node = 2 * node + _mixed_bit(encoding, coder, model, COUNT_MODELS, chosen, (total >> b) & 1)
    return node - 64


@kernel
def _dct_magnitude(encoding, coder, model, chosen, c, place, size, alike, expected, left, luma, magnitude):
    """Codes a magnitude >= 1, or decodes it. Returns the magnitude."""
    where, sets, coded = chosen.where, chosen.sets, np.int64(1)
    sets[1] = FIRST_SET + SECOND_MORE + c * FINE + size
    while coded <= UNARY + 1:
        bit = c * _I + coded - 1
        where[0] = MORE[0] + bit * 64 + place
        where[1] = MORE[1] + (bit * FINE + size) * FINE + alike
        where[2] = MORE[2] + (bit * FINE + expected) * FINE + _fine((place & 7) + (place >> 3))
        where[3] = MORE[3] + (bit * FINE + left) * 4 + min(luma, 3)
        where[4] = MORE[4] + (bit * FINE + alike) * FINE + expected
        sets[0] = FIRST_SET + SETS_MORE + bit
        sets[2] = FIRST_REFINEMENT + SETS_MORE + bit
        if not _mixed_bit(encoding, coder, model, MORE_MODELS, chosen, np.int64(1 if magnitude > coded else 0)):
            break
        coded += 1
    return coded if coded <= UNARY + 1 else _escaped(encoding, coder, magnitude)


@kernel
def _dct_component(encoding, coder, model, chosen, p, begin, c, step, inverse, table, mean, dct, s):
    """Codes the coefficients s.q[c] of block p, or decodes them into it. Stores them in dct.kept and dct.counts."""
    where, sets, q, kept = chosen.where, chosen.sets, s.q, dct.kept
    _look_beside(p, begin, c, table, mean, dct, s)
    left = _count(encoding, coder, model, chosen, p, c, inverse, dct, s)
    dct.counts[p, c] = left
    if not encoding:
        q[c, :] = 0
    for z in range(1, SIZE):
        if left == 0:
            break
        place = ZIGZAG[z]
        u, v = place & 7, place >> 3
        near, alike, signs = np.int64(0), np.int64(0), np.int64(0)
        for j in range(3):
            if s.beside[j] >= 0:
                other = np.int64(kept[s.beside[j], c, place])
                alike += (3 if j < 2 else 2) * abs(other)
                signs += (3, 1, 0)[j] * _sign_class(other)
        near += 2 * abs(q[c, place - 1]) if u > 0 else 0
        near += 2 * abs(q[c, place - 8]) if v > 0 else 0
        near += abs(q[c, place - 9]) if u > 0 and v > 0 else 0
        near += abs(q[c, place - 2]) if u > 1 else 0
        near += abs(q[c, place - 16]) if v > 1 else 0
        size, alike, rest = _fine(near), _fine(alike), _fine(np.int64(SIZE - 1 - z))
        west, north = _alone(u, s.west[v]), _alone(v, s.north[u])
        expected = _sixteenths(west, inverse), _sixteenths(north, inverse)
        expected = _fine((expected[0] if u == 0 else (expected[1] if v == 0 else (expected[0] + expected[1]) >> 1)) >> 1)
        first, second = abs(q[0, place]) if c > 0 else np.int64(0), abs(q[1, place]) if c > 1 else np.int64(0)
        wanted, nonzero = q[c, place], np.int64(1)
        if left < SIZE - z:
            where[0] = ZERO[0] + (c * 64 + z) * 64 + left
            where[1] = ZERO[1] + (c * 64 + place) * FINE + alike
            where[2] = ZERO[2] + ((c * FINE + size) * FINE + alike) * FINE + rest
            where[3] = ZERO[3] + (((c * 64 + place) * 3 + min(first, 2)) * 3 + min(second, 2)) * 3 + min(near, 2)
            where[4] = ZERO[4] + (c * 64 + place) * FINE + expected
            where[5] = ZERO[5] + ((c * FINE + expected) * FINE + _fine(left)) * FINE + rest
            sets[0] = FIRST_SET + SETS_ZERO + c * 64 + z
            sets[1] = FIRST_SET + SECOND_ZERO + c * FINE + _fine(left)
            sets[2] = FIRST_REFINEMENT + SETS_ZERO + c * 64 + z
            nonzero = _mixed_bit(encoding, coder, model, ZERO_MODELS, chosen, np.int64(1 if wanted != 0 else 0))
        if not nonzero:
            continue
        left -= 1
        kind = 0 if u == 0 else (1 if v == 0 else (2 if u + v < 4 else 3))
        lead = _sign_class(q[0, place]) if c > 0 else 0
        lead += 3 * _sign_class(q[1, place]) if c > 1 else 0
        from_west, from_north = _signed_class(west, inverse), _signed_class(north, inverse)
        where[0] = SIGN[0] + (c * 64 + place) * 9 + signs
        where[1] = SIGN[1] + ((c * _SIGNED + from_west) * _SIGNED + from_north) * 4 + kind
        where[2] = SIGN[2] + (c * 64 + place) * 9 + lead
        where[3] = SIGN[3] + (c * 64 + place) * _SIGNED + (from_west if u <= v else from_north)
        sets[0] = FIRST_SET + SETS_SIGN + c * 64 + place
        sets[1] = FIRST_SET + SECOND_SIGN + (c * FINE + expected) * 4 + kind
        sets[2] = FIRST_REFINEMENT + SETS_SIGN + c * 64 + place
        negative = _mixed_bit(encoding, coder, model, SIGN_MODELS, chosen, np.int64(1 if wanted < 0 else 0))
        magnitude = _dct_magnitude(encoding, coder, model, chosen, c, place, size, alike, expected, _fine(left), first,
                                   abs(wanted))
        q[c, place] = -magnitude if negative else magnitude
        value = _coefficient(q[c, place], step)
        s.west[v] -= _share(u, value)
        s.north[u] -= _share(v, value)
    for place in range(SIZE):
        kept[p, c, place] = min(max(q[c, place], -127), 127)


@kernel(forceinline=True)
def _coefficient(q, step):
    """A coefficient with 12 fractional bits. |q| < 2**26, step < 2**23."""
    return min(max(q * step, -MAX_COEFFICIENT), MAX_COEFFICIENT)


@kernel
def _inverse_dct(p, c, step, mean, dct, s):
    """Writes component c of the texels of block p. Sums are below 2**25 * 2**26 * 2**6."""
    q, sums, first = s.q, s.sums, dct.first[p]
    sums[:] = 0
    for place in range(1, SIZE):
        if q[c, place]:
            value = _coefficient(q[c, place], step)
            for x in range(8):
                sums[place >> 3, x] += value * BASIS[place & 7, x]
    for y in range(8):
        for x in range(8):
            total = np.int64(0)
            for v in range(8):
                total += sums[v, x] * BASIS[v, y]
            dct.texels[first + TEXEL[8 * y + x], c] = min(max(mean + ((total + (1 << 27)) >> 28), -MAX_MEAN), MAX_MEAN)


@kernel
def _quantise_block(p, c, step, mean, original, dct, s):
    """Fills s.q[c] from the texels to be coded, original int32 [N, C]."""
    first, rows = dct.first[p], s.rows
    for y in range(8):
        for u in range(8):
            rows[y, u] = 0.0
            for x in range(8):
                rows[y, u] += BASIS[u, x] * np.float64(original[first + TEXEL[8 * y + x], c] - mean)
    for place in range(SIZE):
        scaled = 0.0
        for y in range(8):
            scaled += BASIS[place >> 3, y] * rows[y, place & 7]
        scaled /= 2.0**28 * step
        size = np.int64(abs(scaled) + TO_ONE)
        size = np.int64(abs(scaled) + TO_MORE) if size > 1 else size
        s.q[c, place] = 0 if place == 0 else (size if scaled >= 0 else -size)


@kernel(inline="always")
def _dct_block(encoding, coder, model, chosen, p, begin, rules, blocks, original, s):
    """Codes block p, or decodes it. Writes its texels and the energies of its planes."""
    parent, dct, components = blocks.means.parent, blocks.dct, blocks.means.parent.shape[1]
    for c in range(components):
        mean, step = np.int64(parent[p, c]), rules.steps[c]
        if encoding:
            _quantise_block(p, c, step, mean, original, dct, s)
        _dct_component(encoding, coder, model, chosen, p, begin, c, step, rules.inverse[c], blocks.nodes.table, mean, dct, s)
        _inverse_dct(p, c, step, mean, dct, s)
    for k in range(min(components, 2)):
        c1, total = (1 if k == 0 else components), np.int64(0)
        for c in range(k, c1):
            for place in range(SIZE):
                total += abs(s.q[c, place])
        blocks.energy[p, k] = min(16 * total // ((SIZE - 1) * (c1 - k)), 255)


@kernel
def _close_dct_node(p, part, blocks):
    """Writes the means of the four children of node p, a block or a part of one, each of `part` texels. A part gets the energies
    of its block."""
    dct, child_mean = blocks.dct, blocks.means.child
    if dct.whole[p] == PART:
        blocks.energy[p, 0], blocks.energy[p, 1] = blocks.above[p, 0], blocks.above[p, 1]
    for j in range(4):
        begin = dct.first[p] + j * part
        for c in range(child_mean.shape[1]):
            total = np.int64(0)
            for i in range(begin, begin + part):
                total += dct.texels[i, c]
            child_mean[blocks.nodes.first_child[p] + j, c] = (2 * total + part) // (2 * part)


@kernel
def _enc_dct_level(coder, model, rules, blocks, wanted, s, begin, end):
    """Codes the DCT blocks among the nodes begin..end-1. Writes the means of their children, and of the children of parts of
    blocks, to means.child. The arguments are those of mixed._enc_mixed_level, which codes the other nodes afterwards."""
    for p in range(begin, end):
        if blocks.dct.whole[p] == BLOCK:
            _dct_block(True, coder, model, s.chosen, p, begin, rules, blocks, wanted.texels, s.dct)
        if blocks.dct.whole[p]:
            _close_dct_node(p, rules.part, blocks)


@kernel
def _dec_dct_level(coder, model, rules, blocks, s, begin, end):
    """Mirror of _enc_dct_level."""
    for p in range(begin, end):
        if blocks.dct.whole[p] == BLOCK:
            _dct_block(False, coder, model, s.chosen, p, begin, rules, blocks, blocks.means.child, s.dct)
        if blocks.dct.whole[p]:
            _close_dct_node(p, rules.part, blocks)
