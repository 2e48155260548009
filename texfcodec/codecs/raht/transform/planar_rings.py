"""Inputs of the filter of clause 7.11.3 at a texel: the sums of its neighbours' differences across faces and edges, the same sums
of limited differences, and those of the texels two away.

The texels of a square of 8 x 8 and of a border of two around it are laid out as a picture. A neighbour is then at a fixed offset,
and loops have no branches.
"""

from collections import namedtuple
from itertools import product
from typing import Any

import numpy as np

from ....core.kernel import kernel
from ....field.morton import compact, encode_morton
from .quantise import MAX_MEAN
from .rings import COEFFICIENT_FRACTION, _count, _roughness_class

PLANAR_TAPS = 5  # faces, edges, the texels two away, faces limited, edges limited
SIDE, BORDER = 8, 2
BITS = 3 * 3  # of a key, within its square
WIDTH = SIDE + 2 * BORDER
AREA = WIDTH * WIDTH
FIRST = BORDER * WIDTH + BORDER  # place of a square's first texel
SPAN = (SIDE - 1) * WIDTH + SIDE  # from there to its last
SQUARES = 128  # that a task works on; fixed, so that the statistics do not depend on the number of threads
PER_COUNT = np.array([0, *((1 << 32) // n + 1 for n in range(1, 9))])  # v // n = v * PER_COUNT[n] >> 32 for v < 2**29
OFFSETS = tuple(product((-1, 0, 1), repeat=2))
OWN = 4  # the square itself
# Scratch. there: int32 [AREA + 1], -1 where a texel is, else 0; values: int32 [C, AREA + 1], of no meaning where none is; the
# others are of _sum_up, classes int64 [SPAN]
Picture = namedtuple("Picture", "there values sums sizes counts classes")


def _places():
    """int64 [9, 512]: position in the picture of a texel of the neighbouring square in direction 0..8 of OFFSETS, by the last
    bits of its key; AREA if it is outside."""
    low = np.arange(1 << BITS)
    places = []
    for dx, dy in OFFSETS:
        x, y = (compact(low >> axis) + BORDER + SIDE * d for axis, d in ((0, dx), (1, dy)))
        inside = (0 <= x) & (x < WIDTH) & (0 <= y) & (y < WIDTH)
        places.append(np.where(inside, WIDTH * y + x, AREA))
    return np.array(places)


PLACES = _places()
TEXELS = SIDE * SIDE  # of a whole square; these are in the order of their keys, those with z = 0
_IN_WHOLE = PLACES[:, compact(np.arange(1 << BITS) >> 2) == 0]
INSIDE = (_IN_WHOLE < AREA).sum(axis=1)  # texels of a whole neighbour in the picture
NUMBERS = np.argsort(_IN_WHOLE == AREA, axis=1, kind="stable")  # these first
PLACES_IN_WHOLE = np.take_along_axis(_IN_WHOLE, NUMBERS, axis=1)


@kernel(forceinline=True)
def _limited(v, limit):
    """v, limit: int32, so that a vector holds eight."""
    return np.int32(min(max(v, np.int32(-limit)), limit))


@kernel
def _lay_out(square, keys, first, near, mean, there, values):
    """Writes a square and its border to the picture. there: -1 at texels, else 0."""
    there[:] = 0
    last = mean.shape[1] - 1
    for d in range(9):
        q = near[square, d]
        if q < 0:
            continue
        whole = first[q + 1] - first[q] == TEXELS
        for i in range(INSIDE[d] if whole else first[q + 1] - first[q]):
            v = first[q] + (NUMBERS[d, i] if whole else i)
            place = PLACES_IN_WHOLE[d, i] if whole else PLACES[d, keys[v] & ((1 << BITS) - 1)]
            if place == AREA:
                continue
            there[place] = -1
            values[0, place] = mean[v, 0]
            if last:
                values[1, place] = mean[v, 1]
                values[last, place] = mean[v, last]


@kernel(forceinline=True)
def _difference(own, i, there, values):
    """Difference of a place to `own`, int32; 0 without a texel."""
    return np.int32((values[i] - own) & there[i])


@kernel
def _sum_up(limit, there, values, sums, sizes, counts):
    """Fills sums int32 [PLANAR_TAPS * SPAN] for the places from the square's first texel to its last, sizes int32 [SPAN] with the
    sums of absolute differences and counts int32 [SPAN] with their number. Each difference is < 2**24."""
    for j in range(SPAN):
        own = values[j + FIRST]
        n, s = _difference(own, j + FIRST - WIDTH, there, values), _difference(own, j + FIRST + WIDTH, there, values)
        w, e = _difference(own, j + FIRST - 1, there, values), _difference(own, j + FIRST + 1, there, values)
        sums[j] = n + s + w + e
        sums[j + 3 * SPAN] = _limited(n, limit) + _limited(s, limit) + _limited(w, limit) + _limited(e, limit)
        sizes[j] = abs(n) + abs(s) + abs(w) + abs(e)
        counts[j] = -(there[j + FIRST - WIDTH] + there[j + FIRST + WIDTH] + there[j + FIRST - 1] + there[j + FIRST + 1])
    for j in range(SPAN):
        own = values[j + FIRST]
        n, s = _difference(own, j + FIRST - WIDTH - 1, there, values), _difference(own, j + FIRST + WIDTH - 1, there, values)
        w, e = _difference(own, j + FIRST - WIDTH + 1, there, values), _difference(own, j + FIRST + WIDTH + 1, there, values)
        sums[j + SPAN] = n + s + w + e
        sums[j + 4 * SPAN] = _limited(n, limit) + _limited(s, limit) + _limited(w, limit) + _limited(e, limit)
        sizes[j] += abs(n) + abs(s) + abs(w) + abs(e)
        counts[j] -= (there[j + FIRST - WIDTH - 1] + there[j + FIRST + WIDTH - 1] + there[j + FIRST - WIDTH + 1]
                      + there[j + FIRST + WIDTH + 1])
    for j in range(SPAN):
        own = values[j + FIRST]
        sums[j + 2 * SPAN] = (_difference(own, j + FIRST - 2 * WIDTH, there, values)
                              + _difference(own, j + FIRST + 2 * WIDTH, there, values)
                              + _difference(own, j + FIRST - 2, there, values) + _difference(own, j + FIRST + 2, there, values))


@kernel(forceinline=True)
def _look_at(square, keys, first, near, mean, limits, inverse, picture):
    """Fills a Picture with sums and classes of a square."""
    _lay_out(square, keys, first, near, mean, picture.there, picture.values)
    for c in range(mean.shape[1] - 1, -1, -1):  # classes are of component 0
        _sum_up(np.int32(limits[c]), picture.there, picture.values[c], picture.sums[c], picture.sizes, picture.counts)
    for j in range(SPAN):
        picture.classes[j] = _roughness_class((picture.sizes[j] * PER_COUNT[picture.counts[j]]) >> 32, inverse)


@kernel(forceinline=True)
def _rings_of(v, keys, picture, rings):
    """Fills rings int64 [C, PLANAR_TAPS] for texel v of the picture's square. Returns the texel's class."""
    j = PLACES[OWN, keys[v] & ((1 << BITS) - 1)] - FIRST
    for c in range(rings.shape[0]):
        for tap in range(PLANAR_TAPS):
            rings[c, tap] = picture.sums[c, tap * SPAN + j]
    return picture.classes[j]


@kernel
def _filter(begin, end, keys, first, near, mean, inverse, limits, coefficients, filtered, picture, rings):
    """Filters the texels of squares begin..end-1. mean, filtered: int32 [N, C]; inverse: 2**32 // step of component 0; limits:
    int64 [C]; picture, rings: scratch."""
    for square in range(begin, end):
        _look_at(square, keys, first, near, mean, limits, inverse, picture)
        for v in range(first[square], first[square + 1]):
            j = PLACES[OWN, keys[v] & ((1 << BITS) - 1)] - FIRST
            for c in range(mean.shape[1]):
                change = np.int64(1 << (COEFFICIENT_FRACTION - 1))
                for tap in range(PLANAR_TAPS):
                    change += coefficients[picture.classes[j], c, tap] * picture.sums[c, tap * SPAN + j]
                filtered[v, c] = min(max(mean[v, c] + (change >> COEFFICIENT_FRACTION), -MAX_MEAN), MAX_MEAN)


@kernel
def _statistics(begin, end, keys, first, near, mean, inverse, limits, original, products, targets, picture, rings):
    """Adds to products and targets as _count does, for the texels that _filter takes."""
    for square in range(begin, end):
        _look_at(square, keys, first, near, mean, limits, inverse, picture)
        for v in range(first[square], first[square + 1]):
            _count(v, mean, original, _rings_of(v, keys, picture, rings), PLANAR_TAPS, rings, products,
                   targets)


def _scratch(components):
    zeros = lambda *shape: np.zeros(shape, np.int32)
    return (Picture(zeros(AREA + 1), zeros(components, AREA + 1), zeros(components, PLANAR_TAPS * SPAN), zeros(SPAN), zeros(SPAN),
                    np.zeros(SPAN, np.int64)), np.zeros((components, PLANAR_TAPS), np.int64))


class TexelRings:
    """Texels around each texel, which the filter reads. keys: int64 [N], their ascending Morton keys, z = 0."""

    taps, pieces = PLANAR_TAPS, SQUARES

    def __init__(self, keys: np.ndarray) -> None:
        squares = keys >> BITS
        first = np.flatnonzero(np.diff(squares, prepend=-1))
        squares = squares[first]
        x, y = compact(squares), compact(squares >> 1)
        near = np.full((len(squares), len(OFFSETS)), -1, np.int64)
        for d, (dx, dy) in enumerate(OFFSETS):
            beside = np.stack([x + dx, y + dy, np.zeros_like(x)], axis=1)
            neighbours = encode_morton(np.maximum(beside, 0))
            at = np.minimum(np.searchsorted(squares, neighbours), len(squares) - 1)
            near[:, d] = np.where((squares[at] == neighbours) & (beside.min(axis=1) >= 0), at, -1)
        self.size, self.around = len(squares), (keys, np.append(first, len(keys)), near)

    def filter(self, begin: int, end: int, mean: np.ndarray, *arguments: Any) -> None:
        """Filter the texels of squares begin..end-1 (aligned squares of texels, in Morton order). mean: int32 [N, C], decoded;
        arguments: inverse, limits, coefficients and filtered of _filter, the last of which receives the result."""
        _filter(begin, end, *self.around, mean, *arguments, *_scratch(mean.shape[1]))

    def statistics(self, begin: int, end: int, mean: np.ndarray, *arguments: Any) -> None:
        """Add what a fit of coefficients needs of squares begin..end-1 to the sums products and targets. mean: int32 [N, C],
        decoded; arguments: inverse, limits, original, products and targets of _statistics."""
        _statistics(begin, end, *self.around, mean, *arguments, *_scratch(mean.shape[1]))
