"""Clauses 7.5.5 and 7.6.4 in plain Python: bits whose probability several models give together, and the flags of quiet planes."""

from conformance.reference.planar import alike
from conformance.reference.scales import energy_class, fine, half, sign_of, sixteenths, surrounding_classes
from conformance.reference.voxels import clip

FLAG, ZERO, MORE, SIGN = range(4)
WEIGHT_SETS, REFINEMENT_SETS, QUIET_CONTEXTS = 224, 139, 256
SQUASH_TABLE = (
    1, 2, 3, 5, 8, 13, 22, 36, 60, 98, 162, 267, 439, 720, 1179,
    1921, 3108, 4971, 7812, 11955, 17625, 24743, 32768, 40793, 47911, 53581, 57724, 60565, 62428, 63615,
    64357, 64816, 65097, 65269, 65374, 65438, 65476, 65500, 65514, 65523, 65528, 65531, 65533, 65534, 65535,
)  # fmt: skip
FACES = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))


# Clause 7.6.4


def squash(x):
    """Probability of a one in units of 2^-16."""
    t = x + 2816
    j, r = t // 128, t % 128
    return (SQUASH_TABLE[j] * (128 - r) + SQUASH_TABLE[min(j + 1, 44)] * r + 64) >> 7


def stretch_table():
    """Stretch(v) for v = 0..4095; Squash never falls, so one walk finds every least x."""
    table, x = [], -2816
    for v in range(4096):
        while x < 2816 and squash(x) < 16 * v + 8:
            x += 1
        table.append(x)
    return table


STRETCH = stretch_table()


class WeightSet:
    """M weights and the bias, the last of `weight`, which goes with the constant input 256, and how often they were used."""

    def __init__(self, num_models):
        self.weight, self.count = [13107] * num_models + [0], 0

    def output(self, s):
        """x1 or x2; s ends with the input of the bias, the rest of s may be fewer than the models."""
        total = sum(w * i for w, i in zip(self.weight, s[:-1], strict=False)) + self.weight[-1] * s[-1]
        return clip(-2816, 2816, total >> 16)

    def learn(self, s, y, bit):
        error = (65536 * bit - squash(y)) * (16 + 1536 // (16 + self.count))
        for i, at in enumerate([*range(len(s) - 1), -1]):
            self.weight[at] = clip(-(2**20), 2**20, self.weight[at] + ((s[i] * error + 2**19) >> 20))
        self.count = min(self.count + 1, 1521)


def new_refinement():
    """A refinement set in its initial state."""
    return [squash(min(256 * j - 2816, 2816)) << 6 for j in range(24)]


def adapted(context, bit, largest_rate):
    """A context (fast, slow, count) after a bit: 7.6.3 with largest_rate for the 3 in Min(rate, 3)."""
    fast, slow, count = context
    rate, target = (count + 1).bit_length(), bit * (2**22 - 1)
    return fast + ((target - fast) >> min(rate, largest_rate)), slow + ((target - slow) >> rate), min(count + 1, 63)


def mixed_bit(split, contexts, a, b, refinement):
    """DecodeMixed but for the range decoder: split takes p and gives the bit. Changes its last four arguments in place."""
    s = [STRETCH[(fast + slow) >> 11] for fast, slow, _ in contexts] + [256]
    x1, x2 = a.output(s), b.output(s)
    x = (x1 + x2) >> 1
    j, r = (x + 2816) >> 8, (x + 2816) & 255
    refined = (refinement[j] * (256 - r) + refinement[j + 1] * r) >> 14
    bit = split(clip(8, 65528, (squash(x) + refined) >> 1))
    a.learn(s, x1, bit)
    b.learn(s, x2, bit)
    contexts[:] = [adapted(context, bit, 4) for context in contexts]
    j += r >= 128
    refinement[j] += (bit * (2**22 - 1) - refinement[j]) >> 6
    return bit


class MixedTable:
    """What adapts while bits of several models are decoded: contexts by (kind, model, number), weight sets, refinement sets."""

    def __init__(self, num_models, weight_sets=WEIGHT_SETS, refinement_sets=REFINEMENT_SETS):
        self.num_models, self.contexts, self.quiet = num_models, {}, [(2**21, 2**21, 0)] * QUIET_CONTEXTS
        self.dct = None  # the table of DCT blocks, from the first one on
        self.weight_sets = [WeightSet(num_models) for _ in range(weight_sets)]
        self.refinements = [new_refinement() for _ in range(refinement_sets)]

    def bit(self, decoder, kind, numbers, first, second, refinement):
        """numbers: what the context number of each model is made of; first, second, refinement: numbers of the sets."""
        keys = [(kind, model, number) for model, number in enumerate(numbers[: self.num_models])]
        contexts = [self.contexts.get(key, (2**21, 2**21, 0)) for key in keys]
        split = lambda p: decoder.split((decoder.range >> 16) * p)
        bit = mixed_bit(split, contexts, self.weight_sets[first], self.weight_sets[second], self.refinements[refinement])
        self.contexts.update(zip(keys, contexts, strict=True))
        return bit


# Clause 7.5.5


class MixedBits:
    """The bits of one plane of one block, each with its models and sets; a stand-in for DirectBits."""

    def __init__(self, nodes, block, k, plane):
        """nodes: the LevelDecoder, block: its Block, plane: the components."""
        self.nodes, self.block, self.k, self.L = nodes, block, k, nodes.level_class
        self.splits, self.size = len(block.splits), min(len(block.splits), 3) - 1
        above = nodes.above(block.node)[k]
        near, near_weight, far, far_weight = nodes.surroundings(block.node, k)
        self.quiet, self.near_exists = near == far == 0, int(near_weight > 0)
        self.near_class, self.far_class = surrounding_classes(near, near_weight, far, far_weight)
        self.strength = max(self.near_class, self.far_class)
        self.near2 = fine((2 * near + near_weight - 1) // near_weight) if near_weight > 0 else 0
        self.far2, self.own = fine((2 * far + far_weight - 1) // far_weight), fine(2 * above)
        self.b = 2 * k + (block.flag[0] if k == 1 else 0)
        self.luma2 = min(energy_class(block.energy[0]), 5) if k == 1 else 0
        self.earlier = sum(4**axis * self.earlier_energy(axis) for axis in range(3))
        self.set_activity(plane, near_weight)
        self.expectations = {}

    def earlier_energy(self, axis):
        """e of the block behind along an axis."""
        direction = [-(i == axis) for i in range(3)]
        other = self.nodes.level.neighbour(self.block.node, *direction)
        if other is None or other < self.nodes.first:
            return 0
        energy = self.nodes.level.energy[other][self.k]
        return 1 if energy == 0 else 2 if energy < 8 else 3

    def set_activity(self, plane, near_weight):
        """around, rough, active and peak."""
        block, level = self.block, self.nodes.level
        faces = [level.neighbour(block.node, *d) for d in FACES]
        faces = [level.mean[other] for other in faces if other is not None]
        own, h, scale = level.mean[block.node], half(block.weights[0] >> 2), self.nodes.steps[plane[0]]
        variation = sum(abs(mean[c] - own[c]) for mean in faces for c in plane)
        deviations = [abs(block.predicted[octant][c] - block.shift(c)) for octant in block.children for c in plane]
        self.around = len(faces) + (8 if near_weight > 0 else 0)
        share = lambda total, terms: fine(sixteenths(total, scale) // (terms * len(plane)))
        self.rough = share(variation << h, max(len(faces), 1))
        self.active = share(sum(deviations) << (h + 1), self.splits + 1)
        self.peak = fine(sixteenths(max(deviations) << h, scale))

    def expect(self, c, n):
        """(expected, down) of a coefficient."""
        if (c, n) not in self.expectations:
            slope = self.slope(c, n)
            if n > 2 and self.nodes.is_rotated(self.block):
                upper, lower = self.slope(c, 3), self.slope(c, 4)
                slope = (181 * (lower + upper if n == 3 else lower - upper)) >> 8
            self.expectations[c, n] = fine(sixteenths(slope, self.nodes.steps[c])), int(slope < 0)
        return self.expectations[c, n]

    def slope(self, c, n):
        w = min(self.block.weights[2 * n + 1], self.block.weights[2 * n + 2])
        return (self.block.predicted_mean(2 * n + 2, c) - self.block.predicted_mean(2 * n + 1, c)) << half(w)

    def alike(self, at):
        """alike and alikeSigns of clause 7.11.2, or None where the support is not planar."""
        return alike(self.nodes, self.block.node, at.c, at.n) if self.nodes.unit["planar"] else None

    def earlier_sign(self, c, n, component):
        """s0 and s1 of coefficient n of component c."""
        return sign_of(self.block.q[component][n] if component < c else 0)

    def decode(self, kind, numbers, first, second, refinement):
        return self.nodes.table.bit(self.nodes.decoder, kind, numbers, first, second, refinement)

    def flag(self):
        b, L, near, far = self.b, self.L, self.near_class, self.far_class
        if self.quiet:
            number = ((b * 4 + L) * 8 + self.splits) * 2 + self.near_exists
            return self.nodes.decoder.bit(self.nodes.table.quiet, number, largest_rate=5)
        numbers = [
            (b, L, self.size, near, far),
            (b, L, self.active, near),
            (b, self.far2, self.near2, self.splits),
            (b, L, self.earlier, self.size),
            (b, L, self.rough, self.active),
            (b, self.own, self.splits, self.luma2),
            (b, L, self.peak, self.far2),
            (b, self.around, self.active, near),
        ]
        return self.decode(FLAG, numbers, (self.k * 4 + L) * 2 + b % 2, 100 + b * 7 + near, b * 7 + far)

    def nonzero(self, at):
        c, n, z, L, st, luma2 = at.c, at.n, min(at.ones, 2), self.L, self.strength, self.luma2
        expected, _ = self.expect(c, n)
        numbers = [
            (c, L, at.stage, z, st, min(at.luma, 2)),
            (c, n, expected, z, self.near_class),
            (c, self.far2, self.near2, z),
            (c, self.splits, min(at.left, 7), z, L),
            (c, self.active, expected, L),
            (c, min(at.luma, 3), luma2, n, z),
            (c, self.rough, self.active, z),
            (c, L, self.around, expected),
        ]
        sets = 16 + (c * 4 + L) * 3 + z, 128 + (c * 3 + at.stage) * 7 + st, 28 + (c * 3 + z) * 7 + st
        if (planar := self.alike(at)) is not None:
            numbers[7] = (c, n, planar[0], z)
        return self.decode(ZERO, numbers, *sets)

    def sign(self, at):
        c, n = at.c, at.n
        expected, down = self.expect(c, n)
        s0, s1 = (self.earlier_sign(c, n, component) for component in (0, 1))
        numbers = [
            (c, down, expected, self.L),
            (c, s0, s1),
            (c, n, s0, down),
            (c, s0, s1, down, expected),
        ]
        if (planar := self.alike(at)) is not None:
            numbers[1] = (c, n, planar[1], s0)
        return self.decode(SIGN, numbers, 97 + c, 212 + expected, 136 + c)

    def more(self, at, i):
        c, n, g, L, i3, l3 = at.c, at.n, min(at.large, 2), self.L, min(i, 3), min(at.luma, 3)
        expected, _ = self.expect(c, n)
        numbers = [
            (c, i, self.strength, g),
            (c, i, expected, L),
            (c, i3, self.far2, self.near2),
            (c, i, n, l3),
            (c, i3, self.active, self.rough),
            (c, i, self.luma2, l3),
            (c, i, self.around),
            (c, i, L, g),
        ]
        if (planar := self.alike(at)) is not None:
            numbers[6] = (c, i, n // 2, planar[0])
        return self.decode(MORE, numbers, 52 + c * 15 + i, 191 + c * 7 + self.strength, 91 + c * 15 + i)
