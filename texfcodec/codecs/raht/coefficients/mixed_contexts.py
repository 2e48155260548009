"""Features of a block that are known before its coefficients, and the contexts of mixed coding that follow from them (spec clause
7.5.5)."""

import numpy as np

from ....core.kernel import kernel
from ..entropy.contexts import CLASSES, LEVELS, UNARY, _class
from ..entropy.mixing import Model, new_model
from ..transform.octree import COLUMNS
from ..transform.raht import _is_square
from .planar import ALIKE, ALIKE_SIGNS

FINE = 12
FINE_BOUNDS = (1, 2, 4, 6, 8, 12, 16, 24, 36, 56, 96)
FINE_TABLE = np.searchsorted(FINE_BOUNDS, np.arange(FINE_BOUNDS[-1] + 1), side="right").astype(np.uint8)
RECIPROCAL = np.array([0, *(-((-1 << 20) // d) for d in range(1, 32))])
STEPS_SHIFT = 28  # of |v| * (2**32 // step) to sixteenths of a step
ROOT_HALF = 181  # sqrt(1/2) in 1/256
FACES = np.array((4, 10, 12, 14, 16, 22))
PLANAR_FACES = FACES % 3 == 1  # those with z = 0
EARLIER = 3  # the first three faces come before the block
# Entries of the array of features
(LEVEL, SPLITS, NEAR, FAR, STRENGTH, NEAR2, FAR2, OWN, AROUND, EARLIER_FACES, ROUGH, ACTIVE, PEAK, PLANES, LUMA2,
 PLANAR) = range(16)
FEATURES = 16
_I = UNARY + 1  # bits of a magnitude that are coded with contexts
FLAG_SIZES = (4 * LEVELS * 3 * CLASSES * CLASSES, 4 * LEVELS * FINE * CLASSES, 4 * FINE * FINE * 8, 4 * LEVELS * 64 * 3,
              4 * LEVELS * FINE * FINE, 4 * FINE * 8 * 6, 4 * LEVELS * FINE * FINE, 4 * 16 * FINE * CLASSES)
ZERO_SIZES = (3 * LEVELS * 3 * 3 * CLASSES * 3, 3 * 7 * FINE * 3 * CLASSES, 3 * FINE * FINE * 3, 3 * 8 * 8 * 3 * LEVELS,
              3 * FINE * FINE * LEVELS, 3 * 4 * 6 * 7 * 3, 3 * FINE * FINE * 3, 3 * LEVELS * 16 * FINE)
MORE_SIZES = (3 * _I * CLASSES * 3, 3 * _I * FINE * LEVELS, 3 * 4 * FINE * FINE, 3 * _I * 7 * 4, 3 * 4 * FINE * FINE,
              3 * _I * 6 * 4, 3 * _I * 16, 3 * _I * LEVELS * 3)
SIGN_SIZES = (3 * 2 * FINE * LEVELS, 3 * 3 * 3, 3 * 7 * 3 * 2, 3 * 3 * 3 * 2 * FINE)
SIGN_MODELS = len(SIGN_SIZES)
QUIET_SIZE = 4 * LEVELS * 8 * 2
# Of the models that are others in planar supports (7.11.2)
ALIKE_SIZES = (3 * 7 * ALIKE * 3, 3 * _I * 3 * ALIKE, 3 * 7 * ALIKE_SIGNS * 3)
_BASES = np.cumsum([0, *FLAG_SIZES, *ZERO_SIZES, *MORE_SIZES, *SIGN_SIZES, QUIET_SIZE, *ALIKE_SIZES])
FLAG, ZERO, MORE, SIGN, QUIET = _BASES[:8], _BASES[8:16], _BASES[16:24], _BASES[24:28], int(_BASES[28])
ALIKE_ZERO, ALIKE_MORE, ALIKE_SIGN = (int(base) for base in _BASES[29:32])
CONTEXTS = int(_BASES[-1])
WEIGHT_SETS, REFINEMENT_SETS = 224, 139


def new_mixed_model() -> Model:
    """Model of a codeword in its initial state."""
    return new_model(CONTEXTS, WEIGHT_SETS, REFINEMENT_SETS)


@kernel(forceinline=True)
def _fine(v):
    return np.int64(FINE_TABLE[min(v, 96)])


@kernel(forceinline=True)
def _sixteenths(v, inverse):
    """|v| in sixteenths of a step; inverse: 2**32 // step. |v| < 2**40, inverse < 2**21."""
    return (abs(v) * inverse) >> STEPS_SHIFT


@kernel(forceinline=True)
def _per(v, divisor):
    """min(v, 2**14 - 1) // divisor for 0 <= v, 1 <= divisor < 32, by a multiplication that is exact in this range."""
    return (min(v, (1 << 14) - 1) * RECIPROCAL[divisor]) >> 20


@kernel(forceinline=True)
def _half(w):
    """floor(log2(sqrt(w))) for w >= 1, and 0 for w = 0."""
    n = 0
    while w > 3:
        w >>= 2
        n += 1
    return n


@kernel(forceinline=True)
def _features(p, first, k, splits, flag, rules, blocks, s):
    """Fills s.f for plane k of block p. flag: whether luma has coefficients; rules, blocks, s: as in blocks.py."""
    f, sums, tree, predicted, shift = s.f, s.sums, s.tree, s.predicted, s.shift
    parent_mean, table, energy, inverse = blocks.means.parent, blocks.nodes.table, blocks.energy, rules.inverse
    f[LEVEL], f[SPLITS], f[PLANES], f[PLANAR] = rules.level, splits, 2 * k + flag, blocks.nodes.planar
    f[LUMA2] = min(_class(np.int64(energy[p, 0])), 5) if k else 0
    near, near_weight, far, far_weight = sums[k], sums[4], sums[2 + k], sums[5]
    f[NEAR] = _class(_per(near + near_weight - 1, near_weight)) if near_weight else 0
    f[FAR] = _class(_per(far + far_weight - 1, far_weight))
    f[STRENGTH] = max(f[NEAR], f[FAR])
    f[NEAR2] = _fine(_per(2 * near + near_weight - 1, near_weight)) if near_weight else 0
    f[FAR2] = _fine(_per(2 * far + far_weight - 1, far_weight))
    f[OWN] = _fine(2 * np.int64(blocks.above[p, k]))
    c0, c1 = k, (1 if k == 0 else parent_mean.shape[1])
    faces, earlier, variation = 0, 0, np.int64(0)
    planar = blocks.nodes.planar
    for i in range(6):
        if planar and not PLANAR_FACES[i]:
            continue
        q = table[p, COLUMNS[planar, FACES[i]]]
        if q < 0:
            continue
        faces += 1
        for c in range(c0, c1):
            variation += abs(np.int64(parent_mean[q, c]) - parent_mean[p, c])
        if i < EARLIER and q >= first:
            e = energy[q, k]
            earlier |= (1 if e == 0 else (2 if e < 8 else 3)) << (2 * i)
    f[EARLIER_FACES] = earlier
    f[AROUND] = faces + (8 if near_weight else 0)
    h = _half(tree[0] >> 2)
    f[ROUGH] = _fine(_per(_sixteenths(variation << h, inverse[c0]), max(faces, 1) * (c1 - c0)))
    total, peak = np.int64(0), np.int64(0)
    for c in range(c0, c1):
        for octant in range(8):
            deviation = abs(predicted[octant, c] - shift[c]) if tree[7 + octant] else np.int64(0)
            total += deviation
            peak = max(peak, deviation)
    f[ACTIVE] = _fine(_per(_sixteenths(total << (h + 1), inverse[c0]), (f[SPLITS] + 1) * (c1 - c0)))
    f[PEAK] = _fine(_sixteenths(peak << h, inverse[c0]))


@kernel
def _slopes(tree, predicted, c, inverse, sums, expected, down, rotated):
    """Fills expected and down, int64 [7, C], for the splits of component c: size class and sign of the prediction's own
    coefficients. sums: int64 [15], scratch; rotated: planar_transform. A slope is < 2**37."""
    rotated, other = 1 if rotated and _is_square(tree) else 0, np.int64(0)
    for octant in range(8):
        sums[7 + octant] = tree[7 + octant] * predicted[octant, c]
    for node in range(6, -1, -1):
        sums[node] = sums[2 * node + 1] + sums[2 * node + 2]
        w1, w2 = tree[2 * node + 1], tree[2 * node + 2]
        if w1 and w2:
            slope = (sums[2 * node + 2] // w2 - sums[2 * node + 1] // w1) << _half(min(w1, w2))
            if rotated and node == 4:
                other = slope
                continue
            if rotated and node == 3:
                slope, other = ((other + slope) * ROOT_HALF) >> 8, ((other - slope) * ROOT_HALF) >> 8
                expected[4, c] = _fine(_sixteenths(other, inverse[c]))
                down[4, c] = 1 if other < 0 else 0
            expected[node, c] = _fine(_sixteenths(slope, inverse[c]))
            down[node, c] = 1 if slope < 0 else 0


@kernel(forceinline=True)
def _is_quiet(sums, k):
    """Return whether no surrounding block has coefficients in plane k. sums: of _surroundings."""
    return sums[k] == 0 and sums[2 + k] == 0


@kernel(forceinline=True)
def _quiet_context(sums, k, level, splits, flag):
    """Context of the flag of a quiet plane."""
    return QUIET + (((2 * k + flag) * LEVELS + level) * 8 + splits) * 2 + (1 if sums[4] else 0)


@kernel
def _flag_contexts(f, where, sets):
    """Contexts of a plane's flag. f[PLANES]: 0 luma, 2 and 3 chroma without and with coefficients in luma."""
    b, level, size = f[PLANES], f[LEVEL], min(f[SPLITS], 3) - 1
    bl = b * LEVELS + level
    where[0] = FLAG[0] + ((bl * 3 + size) * CLASSES + f[NEAR]) * CLASSES + f[FAR]
    where[1] = FLAG[1] + (bl * FINE + f[ACTIVE]) * CLASSES + f[NEAR]
    where[2] = FLAG[2] + ((b * FINE + f[FAR2]) * FINE + f[NEAR2]) * 8 + f[SPLITS]
    where[3] = FLAG[3] + (bl * 64 + f[EARLIER_FACES]) * 3 + size
    where[4] = FLAG[4] + (bl * FINE + f[ROUGH]) * FINE + f[ACTIVE]
    where[5] = FLAG[5] + ((b * FINE + f[OWN]) * 8 + f[SPLITS]) * 6 + f[LUMA2]
    where[6] = FLAG[6] + (bl * FINE + f[PEAK]) * FINE + f[FAR2]
    where[7] = FLAG[7] + ((b * 16 + f[AROUND]) * FINE + f[ACTIVE]) * CLASSES + f[NEAR]
    sets[0] = ((b >> 1) * LEVELS + level) * 2 + (b & 1)
    sets[1] = 100 + b * CLASSES + f[NEAR]
    sets[2] = b * CLASSES + f[FAR]


@kernel
def _zero_contexts(f, c, node, ones, luma, left, expected, alike, where, sets):
    """Contexts of "this coefficient is not zero"; ones, luma, left: see clause 7.5.3."""
    level, stage, z = f[LEVEL], 0 if node == 0 else (1 if node < 3 else 2), min(ones, 2)
    cl = c * LEVELS + level
    where[0] = ZERO[0] + (((cl * 3 + stage) * 3 + z) * CLASSES + f[STRENGTH]) * 3 + min(luma, 2)
    where[1] = ZERO[1] + (((c * 7 + node) * FINE + expected) * 3 + z) * CLASSES + f[NEAR]
    where[2] = ZERO[2] + ((c * FINE + f[FAR2]) * FINE + f[NEAR2]) * 3 + z
    where[3] = ZERO[3] + (((c * 8 + f[SPLITS]) * 8 + min(left, 7)) * 3 + z) * LEVELS + level
    where[4] = ZERO[4] + ((c * FINE + f[ACTIVE]) * FINE + expected) * LEVELS + level
    where[5] = ZERO[5] + (((c * 4 + min(luma, 3)) * 6 + f[LUMA2]) * 7 + node) * 3 + z
    where[6] = ZERO[6] + ((c * FINE + f[ROUGH]) * FINE + f[ACTIVE]) * 3 + z
    if f[PLANAR]:
        where[7] = ALIKE_ZERO + ((c * 7 + node) * ALIKE + alike) * 3 + z
    else:
        where[7] = ZERO[7] + (cl * 16 + f[AROUND]) * FINE + expected
    sets[0] = 16 + cl * 3 + z
    sets[1] = 128 + (c * 3 + stage) * CLASSES + f[STRENGTH]
    sets[2] = 28 + (c * 3 + z) * CLASSES + f[STRENGTH]


@kernel
def _more_contexts(f, c, node, i, large, luma, expected, alike, where, sets):
    """Contexts of bit i of a magnitude, i <= UNARY."""
    level, ci, i3 = f[LEVEL], c * _I + i, c * 4 + min(i, 3)
    where[0] = MORE[0] + (ci * CLASSES + f[STRENGTH]) * 3 + min(large, 2)
    where[1] = MORE[1] + (ci * FINE + expected) * LEVELS + level
    where[2] = MORE[2] + (i3 * FINE + f[FAR2]) * FINE + f[NEAR2]
    where[3] = MORE[3] + (ci * 7 + node) * 4 + min(luma, 3)
    where[4] = MORE[4] + (i3 * FINE + f[ACTIVE]) * FINE + f[ROUGH]
    where[5] = MORE[5] + (ci * 6 + f[LUMA2]) * 4 + min(luma, 3)
    where[6] = ALIKE_MORE + (ci * 3 + (node >> 1)) * ALIKE + alike if f[PLANAR] else MORE[6] + ci * 16 + f[AROUND]
    where[7] = MORE[7] + (ci * LEVELS + level) * 3 + min(large, 2)
    sets[0] = 52 + ci
    sets[1] = 191 + c * CLASSES + f[STRENGTH]
    sets[2] = 91 + ci


@kernel
def _sign_class(q, node, c, before):
    """0, 1 or 2 for zero, positive or negative q[node, c]; 0 if component c is not coded before `before`."""
    if c >= before or q[node, c] == 0:
        return 0
    return 1 if q[node, c] > 0 else 2


@kernel
def _sign_contexts(f, c, node, q, expected, down, alike, where, sets):
    """Contexts of a sign; q: int64 [7, C], the coefficients so far."""
    s0, s1 = _sign_class(q, node, 0, c), _sign_class(q, node, 1, c)
    where[0] = SIGN[0] + ((c * 2 + down) * FINE + expected) * LEVELS + f[LEVEL]
    where[1] = ALIKE_SIGN + ((c * 7 + node) * ALIKE_SIGNS + alike) * 3 + s0 if f[PLANAR] else SIGN[1] + (c * 3 + s0) * 3 + s1
    where[2] = SIGN[2] + ((c * 7 + node) * 3 + s0) * 2 + down
    where[3] = SIGN[3] + (((c * 3 + s0) * 3 + s1) * 2 + down) * FINE + expected
    sets[0] = 97 + c
    sets[1] = 212 + expected
    sets[2] = 136 + c
