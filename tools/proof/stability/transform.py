"""Cases of the attribute transform: fixed point against exact rationals, quantisation, and values that are hard to code."""

import math
from fractions import Fraction
from functools import partial
from itertools import pairwise

import numpy as np

from oracles import kernels as oracles
from texfcodec.codecs.raht.attribute_coder import Tools, dec_attributes, enc_attributes
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.codecs.raht.transform.quantise import MAX_DIFFERENCE, MAX_MEAN, _dequantise, step_of
from texfcodec.codecs.raht.transform.raht import EXACT_BELOW, _forward, _inverse, _tree_weights, _weighted_mean
from texfcodec.field.morton import decode_morton, encode_morton
from tools.proof.stability.case import Case, Draws

GROUP = "Transform and quantisation"
UNIT = 4096  # a level in fixed point
LEVELS = 13
ULPS_A_LEVEL = 2
REACHABLE, BEYOND = 1 << 28, 1 << 40
SPREAD = 0x9E3779B1  # odd: its multiples visit every colour once
DROPPED = 4.0  # steps that the encoder may leave out of a coefficient


def divided(draw: Draws, total: int) -> dict:
    """A weight of at least 1 for each of one to eight octants, `total` together; some halve, some are lopsided."""
    count = draw.integer(1, min(8, total))
    cuts = sorted({max(1, min(total - 1, int(total * draw.unit() ** draw.pick((1, 8, 30))))) for _ in range(count - 1)})
    if total == 1:
        cuts = []
    parts = [b - a for a, b in pairwise([0, *cuts, total])]
    first = draw.integer(0, 8 - len(parts))
    return {first + i: part for i, part in enumerate(parts)}


def rebuilt(weights: dict, q: list, mean: int, predicted: dict, step: int) -> dict:
    """Means of a block's children by octant, from the kernels of the codec."""
    tree, values, guess = np.zeros(15, np.int64), np.zeros((15, 1), np.int64), np.zeros((8, 1), np.int64)
    _tree_weights(0, np.int64(sum(1 << o for o in weights)), np.array([weights[o] for o in sorted(weights)], np.int64), tree)
    for octant, value in predicted.items():
        guess[octant] = value
    _inverse(tree, np.array(q, np.int64)[:, None], 0, mean - _weighted_mean(tree, guess, 0), step, values)
    return {o: int(values[7 + o, 0]) + predicted[o] for o in weights}


def levels_down(draw: Draws, total: int, children: object) -> list:
    """The error in ulps after each of 13 levels, of the child that is furthest off, against exact rationals with the same
    coefficients. children: function as rebuilt()."""
    fixed = draw.integer(0, 255 * UNIT)
    exact, errors = Fraction(fixed), []
    for _ in range(LEVELS):
        weights, step = divided(draw, total), step_of(draw.integer(0, 30))
        q = draw.integers((7,), -9, 9).tolist()
        predicted = {o: fixed + draw.integer(-UNIT, UNIT) for o in weights}
        got = children(weights, q, fixed, predicted, step)
        want = oracles.inverse(weights, dict(enumerate(q)), exact, predicted, step, exact=True)
        worst = max(weights, key=lambda o: abs(got[o] - want[o]))
        errors.append(float(abs(got[worst] - want[worst])))
        fixed, exact, total = got[worst], want[worst], weights[worst]
    return errors


def in_plain_integers(weights: dict, q: list, mean: int, predicted: dict, step: int) -> dict:
    """As rebuilt(), by the clause in integers of any size: what weights beyond 64 bits would get."""
    return oracles.inverse(weights, dict(enumerate(q)), mean, predicted, step)


def thirteen_levels(total: int, children: object, draw: Draws) -> float:
    """The largest error on the way down, as a share of what so many levels allow, in ulps of the last."""
    errors = levels_down(draw, total, children)
    return max(error * LEVELS / (level + 1) for level, error in enumerate(errors))


def difference_of_halves(draw: Draws) -> float:
    """How far a decoded difference is below the exact one, in parts of one over the gain; infinite where it is above."""
    q, qp = int(draw.power(0, 6.6)), draw.integer(0, 63)
    w1, w2 = (min(int(draw.power(0, 8.13)), 1 << 27) for _ in range(2))
    got = int(_dequantise(q, step_of(qp), w1, w2))
    exact = math.sqrt(oracles.exact_difference_squared(q, step_of(qp), w1, w2))
    if got == MAX_DIFFERENCE:
        return 0.0 if exact > MAX_DIFFERENCE - 1 else np.inf
    if got > exact * (1 + 1e-12) + 0.5:
        return np.inf
    return (exact - got - 0.5) / exact * math.sqrt((w1 + w2) / (w1 * w2)) * 2**17


def large_halves(draw: Draws) -> float:
    """What is left of a difference of two large halves after coding, in half steps of the decoder's gain."""
    w1, w2 = (draw.integer(EXACT_BELOW, 1 << 20) << draw.integer(0, 7) for _ in range(2))
    difference, step = draw.integer(-255 * UNIT, 255 * UNIT), step_of(draw.integer(0, 63))
    tree, weights = np.zeros(15, np.int64), np.array([w1, w2], np.int64)
    _tree_weights(0, np.int64(0b10001), weights, tree)
    residual, scaled, values = np.zeros((8, 1)), np.zeros((7, 1)), np.zeros((15, 1), np.int64)
    residual[4] = difference
    _forward(tree, residual, 0, np.zeros(15), scaled, float(step))
    _inverse(tree, np.rint(scaled).astype(np.int64), 0, 0, step, values)
    gain = math.isqrt(((w1 + w2) << 34) // (w1 * w2))
    return (abs(int(values[11, 0] - values[7, 0]) - difference) - 0.5) / (step * gain / 2**17 / 2)


# Values that are hard to code


def hard_keys(draw: Draws) -> tuple[np.ndarray, int]:
    """(Morton keys, depth) of a full cube, a plane, a shell, a line, a few voxels far apart, or any."""
    kind, rng = draw.integer(0, 5), draw.generator()
    if kind == 0:
        return np.arange(8**3), 3
    if kind == 4:
        return np.unique(encode_morton(rng.integers(0, 1 << 13, (draw.integer(1, 60), 3)))), 13
    depth = draw.integer(1, 4)
    side = 1 << depth
    xyz = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    shell = np.abs(np.linalg.norm(xyz - (side - 1) / 2, axis=1) - side * 0.45) < 0.6
    chosen = (None, xyz[:, 2] == 0, shell, (xyz[:, 1:] == 1).all(axis=1), None, rng.random(len(xyz)) < 0.3)[kind]
    xyz = xyz[chosen]
    return np.sort(encode_morton(xyz if len(xyz) else np.zeros((1, 3), np.int64))), depth


def values_of(content: str, keys: np.ndarray, components: int, draw: Draws) -> np.ndarray:
    """Values int32 [N, C] with 12 fractional bits."""
    low, high = sorted(draw.integers((2,), 0, 255).tolist())
    rng, xyz = draw.generator(), decode_morton(keys)
    if content == "constant":
        return np.full((len(keys), components), high * UNIT, np.int32)
    if content == "checkerboard":
        return np.repeat(np.where(xyz.sum(axis=1) & 1, low, high)[:, None] * UNIT, components, axis=1).astype(np.int32)
    if content == "single outlier":
        values = np.full((len(keys), components), low * UNIT, np.int32)
        values[rng.integers(0, len(keys))] = high * UNIT
        return values
    return rng.integers(0, 255 * UNIT + 1, (len(keys), components)).astype(np.int32)


def decoded(keys: np.ndarray, depth: int, values: np.ndarray, qp: list, models: int) -> np.ndarray:
    """What a decoder has of values, float64; infinite where it is not what the encoder said."""
    coded, expected = enc_attributes(keys, depth, values, qp, Tools(models=models))
    data = np.frombuffer(b"".join(coded.codewords), np.uint8)
    ends = np.cumsum([0, *map(len, coded.codewords)]).tolist()
    got = dec_attributes(keys, depth, coded, data, list(pairwise(ends)), depth)
    return got.astype(np.float64) if np.array_equal(got, expected) else np.full(values.shape, np.inf)


def amplified(keys: np.ndarray, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """(How many steps a voxel may move where every coefficient above it is a step off; what rounding may add, in ulps)."""
    moved, rounding = np.zeros(len(keys)), np.full(len(keys), ULPS_A_LEVEL * depth, np.float64)
    for bit in range(3 * depth):
        _, at, own = np.unique(keys >> bit, return_inverse=True, return_counts=True)
        _, above, both = np.unique(keys >> bit + 1, return_inverse=True, return_counts=True)
        w, total = own[at].astype(np.float64), both[above].astype(np.float64)
        other = total - w
        split = other > 0
        gain = np.sqrt(total / np.maximum(w * other, 1)) * 2**17
        moved += np.where(split, np.sqrt(other / (w * total)), 0)
        rounding += np.where(split, other / total * (512 * UNIT / gain), 0)  # a difference is below 512 levels
    return moved, rounding


def coefficient_error(content: str, draw: Draws) -> float:
    """How many steps each coefficient above the worst voxel would have to be off."""
    keys, depth = hard_keys(draw)
    components, qp = draw.pick((1, 3)), draw.pick((0, 63, draw.integer(0, 63)))
    values = values_of(content, keys, components, draw)
    got = decoded(keys, depth, values, [qp] * components, draw.pick((0, 6)))
    if content == "constant":
        return float(np.abs(got - values).max())
    moved, rounding = amplified(keys, depth)
    left = np.maximum(np.abs(got - values).max(axis=1) - rounding, 0)
    return float((left / np.maximum(moved * step_of(qp), 1e-9)).max()) if moved.any() else float(left.max())


def colour_round_trip(draw: Draws) -> float:
    """How many of all 2^24 colours (in tests, of some) come back otherwise, with the transform and without."""
    count = draw.size(1 << 17, 1 << 24, 1 << 24)
    first, wrong = draw.integer(0, (1 << 24) - 1), 0
    for begin in range(0, count, 1 << 17):
        number = (first + SPREAD * np.arange(begin, begin + (1 << 17))) & 0xFFFFFF
        rgb = np.stack([number >> 16, number >> 8 & 255, number & 255], axis=1)
        for forward, inverse in ((forward_colour, inverse_colour), (forward_plain, inverse_plain)):
            wrong += int((inverse(forward(rgb)) != rgb).any(axis=1).sum())
    return float(wrong)


def colours_of_any_means(draw: Draws) -> float:
    """Colours of means anywhere in their range that are not those of plain integers."""
    means = [[draw.integer(-MAX_MEAN, MAX_MEAN) >> draw.integer(0, 12) for _ in range(3)] for _ in range(40)]
    return float((inverse_colour(np.array(means, np.int32)) != [oracles.rgb_of(*m) for m in means]).any(axis=1).sum())


STEPS = "steps a coefficient"
WHY_CODED = ("A voxel's error is its parent's and what the splits above it add: the error of a coefficient times sqrt(w2 / (w1 "
             "(w1 + w2))), and 2 ulps a level (7.4.3). The encoder rounds, takes one less, or drops a coefficient or a plane "
             "where that saves bits. A squared step is worth 20 bits to it and a decision costs at most 13: 4 steps are worth "
             "320, more than they and all zeros of a plane of 14 can cost. What is shown is the error that every coefficient "
             "above the worst voxel would need.")
CASES = (
    Case("weights to 2^28, 13 levels", GROUP,
         "the kernels of a block, one below the other, weights from 2^28 voxels down to one",
         26, "ulps of 1/4096 level",
         "Each level rounds the mean of the predictions and up to three splits, half an ulp each: 2 ulps a level, 26 for the 13 "
         "that a tree has (7.4.3). num_keys is at most 2^28 (5.5), so no weight is larger.",
         partial(thirteen_levels, REACHABLE, rebuilt)),
    Case("weights to 2^40, 13 levels", GROUP,
         "the same by the clause in unlimited integers, from 2^40 voxels",
         26, "ulps of 1/4096 level",
         "The bound does not depend on the weights: rounded division is off by half an ulp whatever it divides by. Only the "
         "gain needs the limit (next row).",
         partial(thirteen_levels, BEYOND, in_plain_integers)),
    Case("gain of large weights", GROUP,
         "differences that coefficients stand for, weights to 2^27 each, all QPs",
         1, "parts of 1 / gain",
         "gain is rounded down (7.4.2), so a difference is short by less than one part in gain, and half an ulp. With 2^28 "
         "voxels gain is 16 at least; at 2^40 it would be 0, one more reason for the limit of num_keys.",
         difference_of_halves, 60),
    Case("large halves, coded", GROUP,
         "differences of two halves of 2^12 to 2^27 voxels through quantiser and decoder",
         1 + 1e-06, "half steps",
         "From 4096 voxels on the encoder divides by the gain as the decoder rounds it, so the loss of the row above does not "
         "count: what is left is half a step.",
         large_halves, 60),
    Case("constant values", GROUP,
         "one value on cubes, planes, shells, lines and scattered voxels, all QPs",
         0, "ulps of 1/4096 level",
         "Every prediction is a weighted mean of equal numbers, which rounding leaves alone (7.3), so no residual is ever "
         "coded.",
         partial(coefficient_error, "constant"), 10, False),
    *(Case(f"{content} values", GROUP,
           f"{content}, any two levels, on cubes, planes, shells, lines and scattered voxels, QP 0 to 63 and both ends, direct "
           "and mixed contexts",
           DROPPED, STEPS,
           WHY_CODED,
           partial(coefficient_error, content), 10)
      for content in ("checkerboard", "single outlier", "white noise")),
    Case("colour round trip", GROUP,
         "all 2^24 colours through BT.709 and back, and without it",
         0, "other colours",
         "The forward transform rounds to 1/4096 level, which the inverse makes at most 0.0004 levels (1 + 1.8556, over 8192): "
         "far from the half that would change a value (7.8.2).",
         colour_round_trip, 2, False, True),
    Case("colours of any means", GROUP,
         "means to both ends of their range",
         0, "other colours",
         "65536 * 2^22 + 121608 * 2^22 < 2^41 (7.8.2): no product leaves 64 bits, so the kernel is the clause.",
         colours_of_any_means, 10),
)
