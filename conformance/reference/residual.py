"""Clause 7.9 in plain Python: the residuals of the values."""

from itertools import product

from conformance.reference.mixing import MixedTable
from conformance.reference.scales import fine, sign_of
from conformance.reference.voxels import clip

SIZE, SIGN = range(2)
WEIGHT_SETS, REFINEMENT_SETS = 103, 51
DIRECTIONS = [(d, 8 >> sum(map(abs, d))) for d in product((-1, 0, 1), repeat=3) if any(d)]  # with the weight w


class ResidualSlice:
    """One slice: its range decoder and what adapts. Fills y and k, lists by voxel and component, from x."""

    def __init__(self, decoder, delta, cross, level, x, y, k):
        self.decoder, self.step, self.cross, self.level = decoder, 2 * delta + 1, cross, level
        self.x, self.y, self.k = x, y, k
        self.table = MixedTable(6, WEIGHT_SETS, REFINEMENT_SETS)

    def run(self, first, end):
        order = [1, 0, 2] if len(self.cross) == 3 else [*range(len(self.cross))]
        for v in range(first, end):
            near = [(self.level.neighbour(v, *d), w) for d, w in DIRECTIONS]
            near = [(u, w) for u, w in near if u is not None]
            earlier = [(u, w) for u, w in near if first <= u < v]
            surprise, before = 0, []
            for c in order:
                base = self.base(earlier, c)
                before.append(self.component(v, c, near, earlier, base, surprise, before))
                if c == order[0]:
                    surprise = 16 * (self.y[v][c] - self.x[v][c]) - base

    def base(self, earlier, c):
        total = sum(w for _, w in earlier)
        return (32 * sum(w * (self.y[u][c] - self.x[u][c]) for u, w in earlier) + total) // (2 * total) if earlier else 0

    def component(self, v, c, near, earlier, base, surprise, before):
        """Decodes k(v, c), sets y(v, c)."""
        shift = base + ((self.cross[c] * surprise + 8) >> 4) + 8
        predicted = clip(0, 255, self.x[v][c] + (shift >> 4))
        lead, second = (*before, 0, 0)[:2]
        sizes = [(abs(self.k[u][c]), w) for u, w in earlier]
        energy = fine(4 * sum(w * size for size, w in sizes) // sum(w for _, w in sizes)) if sizes else 0
        largest = fine(max((size for size, _ in sizes), default=0))
        activity = fine(sum(abs(self.x[u][c] - self.x[v][c]) for u, _ in near) // max(1, len(near)))
        k = self.parse(c, energy, activity, largest, lead, second, shift & 15)
        self.k[v][c], self.y[v][c] = k, clip(0, 255, predicted + k * self.step)
        return k

    def parse(self, c, energy, activity, largest, lead, second, fraction):
        magnitude = negative = 0
        l7, s7 = min(abs(lead), 7), min(abs(second), 7)
        while magnitude < 16:
            i = magnitude
            numbers = [
                (c, energy, i),
                (c, activity, i),
                (c, min(abs(lead), 15), energy >> 1, i),
                (c, largest, i),
                (c, l7, s7, i),
                (c, fraction >> 1, energy, i),
            ]
            if self.table.bit(self.decoder, SIZE, numbers, c * 16 + i, 48 + c * 12 + energy, c * 16 + i) == 0:
                break
            magnitude += 1
            if magnitude == 1:
                numbers = [
                    (c, sign_of(lead), sign_of(second)),
                    (c, fraction),
                    (c, sign_of(lead), fraction),
                ]
                negative = self.table.bit(self.decoder, SIGN, numbers, 84 + c, 87 + fraction, 48 + c)
        if magnitude == 16:
            magnitude = min(255, 15 + self.decoder.escape())
        return -magnitude if negative else magnitude


def with_residuals(unit, level, values, ranges, decoders):
    """Clause 7.9: the final values, bytes by voxel. values: bytes of 7.8 by voxel; ranges: of the voxels, by slice."""
    x = [list(value) for value in values]
    y, k = [list(value) for value in x], [[0] * len(value) for value in x]
    for decoder, (first, end) in zip(decoders, ranges, strict=True):
        ResidualSlice(decoder, unit["residual"] - 1, unit["residual_cross"], level, x, y, k).run(first, end)
    return [bytes(value) for value in y]
