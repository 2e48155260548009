"""Clause 7 in plain Python: octree, prediction, transform, contexts, range decoder."""

import struct
import zlib
from copy import deepcopy
from math import isqrt
from types import SimpleNamespace

from conformance.reference.bits import require
from conformance.reference.dct import decode_blocks
from conformance.reference.filter import filter_stage
from conformance.reference.following import followed
from conformance.reference.mixing import MixedBits, MixedTable, adapted
from conformance.reference.residual import with_residuals
from conformance.reference.scales import falloff, step, surrounding_classes
from conformance.reference.voxels import clip

LARGEST = 2**22
DIRECTIONS = [
    (x, y, z, 3 - (abs(x) + abs(y) + abs(z)))  # the last is the weight w of 7.5.1
    for x in (-1, 0, 1)
    for y in (-1, 0, 1)
    for z in (-1, 0, 1)
    if abs(x) + abs(y) + abs(z) in (1, 2)
]


class Level:
    """Clause 7.1: the nodes of one level; everything is a list by node number, `where` finds numbers by coordinates."""

    def __init__(self, values):
        self.values = values
        self.coordinates = [de_interleave(value) for value in values]
        self.where = {xyz: number for number, xyz in enumerate(self.coordinates)}
        self.parent = [0] * len(values)
        self.children = [{} for _ in values]  # octant -> node number in the next level
        self.weight = [1] * len(values)
        self.mean = [None] * len(values)
        self.energy = [(0, 0)] * len(values)
        self.q = [None] * len(values)  # of blocks: by component, by split
        self.dct, self.known = {}, set()  # DCT blocks by node; nodes below one

    def neighbour(self, node, dx, dy, dz):
        x, y, z = self.coordinates[node]
        return self.where.get((x + dx, y + dy, z + dz))


def de_interleave(value):
    """Coordinates of a node from its value, which is a Morton key of its level."""
    return tuple(sum((value >> (3 * i + axis) & 1) << i for i in range(14)) for axis in range(3))


def octree(keys, depth):
    """Levels 0 to depth over the ascending keys."""
    levels = [Level(sorted({key >> (3 * (depth - l)) for key in keys})) for l in range(depth + 1)]
    for upper, lower in reversed(list(zip(levels, levels[1:], strict=False))):
        number_of = {value: number for number, value in enumerate(upper.values)}
        upper.weight = [0] * len(upper.values)
        for number, value in enumerate(lower.values):
            above = lower.parent[number] = number_of[value >> 3]
            upper.children[above][value & 7] = number
            upper.weight[above] += lower.weight[number]
    return levels


class RangeDecoder:
    """Clause 7.6.2."""

    def __init__(self, codeword):
        self.codeword, self.at, self.range, self.code = codeword, 0, 2**32 - 1, 0
        for _ in range(4):
            self.code = self.code * 256 + self.next_byte()
        self.code = min(self.code, 2**32 - 2)

    def next_byte(self):
        self.at += 1
        return self.codeword[self.at - 1] if self.at <= len(self.codeword) else 0

    def split(self, bound):
        if self.code < bound:
            bit, self.range = 1, bound
        else:
            bit, self.code, self.range = 0, self.code - bound, self.range - bound
        while self.range < 2**24:
            self.range, self.code = self.range * 256, self.code * 256 + self.next_byte()
        return bit

    def bypass(self):
        return self.split(self.range >> 1)

    def escape(self):
        """rest of clause 7.5.4."""
        zeros, rest = 0, 1
        while zeros < 24 and self.bypass() == 1:
            zeros += 1
        for _ in range(zeros):
            rest = 2 * rest + self.bypass()
        return rest

    def bit(self, table, number, largest_rate=3):
        """Clause 7.6.3; table[number] is (fast, slow, count)."""
        fast, slow, _ = table[number]
        bit = self.split((self.range >> 16) * clip(24, 65512, (fast + slow) >> 7))
        table[number] = adapted(table[number], bit, largest_rate)
        return bit


def decode_values(unit, keys, lod=0, checks=None):
    """Clauses 7.2 and 7.7 to 7.9: the values as bytes, component by component; lod counts the levels left out. Appends to checks
    the CRC-32 of the means of every level."""
    means, levels, ranges, decoders = decode_means(unit, keys, lod)
    if checks is not None:
        checks += [zlib.crc32(struct.pack(f"<{len(mean)}i", *mean)) for mean in (sum(of, []) for of in means)]
    values = [values_of_node(mean, unit["colour_transform"]) for mean in means[-1]]
    if unit["residual"] > 0 and min(lod, unit["depth"]) == 0:
        values = with_residuals(unit, levels[-1], values, ranges, decoders)
    return b"".join(values)


def decode_means(unit, keys, lod=0):
    """Clauses 7.2 and 7.7: by level that is decoded the means of its nodes, lists by component; these levels, and the ranges of
    the last one with their range decoders."""
    depth = unit["depth"]
    left_out = min(lod, depth)
    levels = octree(keys, depth)
    levels[0].mean[0] = unit["root_mean"]
    whole = lambda level: [(0, len(level.values))]
    decoders = [RangeDecoder(codeword) for codeword in unit["codewords"]]
    models = unit["num_models"]
    tables = [MixedTable(models) if models > 0 else [(2**21, 2**21, 0)] * 4725 for _ in decoders[:1]]
    if unit["slice_level"] > 0:
        starts = unit["slice_first"]
        require(starts[-1] < len(levels[unit["slice_level"]].values), "a slice begins past the last node of its level")
    ranges, used = whole(levels[0]), slice(0, 1)
    for d in range(depth - left_out):
        if unit["slice_level"] == 0 or d < unit["slice_level"]:
            ranges, used = whole(levels[d]), slice(0, 1)
        elif d == unit["slice_level"]:
            ranges = list(zip(starts, starts[1:] + [len(levels[d].values)], strict=True))
            tables += [deepcopy(tables[0]) for _ in ranges]
            used = slice(1, None)
        else:
            ranges = [children_of_range(levels[d - 1], first, end) for first, end in ranges]
        for (first, end), decoder, table in zip(ranges, decoders[used], tables[used], strict=True):
            LevelDecoder(unit, levels, d, first, decoder, table).run(end)
    means = [level.mean for level in levels[: depth - left_out + 1]]
    if left_out > 0:
        return means, levels, None, None
    ranges = [children_of_range(levels[depth - 1], first, end) for first, end in ranges] if depth > 0 else ranges
    return [*means[:-1], filtered_means(unit, levels[depth])], levels, ranges, decoders[used]


def filtered_means(unit, level):
    """Clause 7.7: the means of the voxels, in their order, after all stages."""
    means = dict(zip(level.coordinates, level.mean, strict=True))
    for stage in unit["filters"]:
        means = filter_stage(means, stage["mask"], stage["coefficients"], [step(qp) for qp in unit["qp"]], unit["planar"])
    return list(means.values())


def children_of_range(level, first, end):
    numbers = [child for node in range(first, end) for child in level.children[node].values()]
    return min(numbers), max(numbers) + 1


def values_of_node(mean, colour_transform):
    """Clause 7.8."""
    if colour_transform == 0:
        return bytes(clip(0, 255, (m + 2**11) >> 12) for m in mean)
    y, cb, cr = mean
    red = (65536 * y + 103206 * cr + 2**27) >> 28
    green = (65536 * y - 12276 * cb - 30679 * cr + 2**27) >> 28
    blue = (65536 * y + 121608 * cb + 2**27) >> 28
    return bytes(clip(0, 255, value) for value in (red, green, blue))


class Block:
    """A node with two children or more, and what of it is known so far."""

    def __init__(self, node, children, predicted, child_weight, components):
        self.node, self.children, self.predicted, self.child_weight = node, children, predicted, child_weight
        self.weights = tree_weights(child_weight)
        self.splits = [n for n in range(7) if self.weights[2 * n + 1] > 0 and self.weights[2 * n + 2] > 0]
        self.q = [[0] * 7 for _ in range(components)]
        self.energy, self.flag = [0, 0], [0, 0]  # by plane

    def weighted(self, c, octants):
        return sum(self.child_weight[octant] * self.predicted[octant][c] for octant in octants)

    def shift(self, c):
        """Clause 7.4.3: by how much the predictions miss the mean, were that 0."""
        total = self.weights[0]
        return (2 * self.weighted(c, self.children) + total) // (2 * total)

    def predicted_mean(self, i, c):
        """Pm of clause 7.5.5, i > 0."""
        first, count = ((i - 1) * 4, 4) if i < 3 else ((i - 3) * 2, 2) if i < 7 else (i - 7, 1)
        octants = [octant for octant in range(first, first + count) if octant in self.children]
        return self.weighted(c, octants) // self.weights[i]


class LevelDecoder:
    """One range of one level: gives the means of the children of its nodes."""

    def __init__(self, unit, levels, d, first, decoder, table):
        self.unit, self.levels, self.d, self.first, self.decoder, self.table = unit, levels, d, first, decoder, table
        self.upper, self.level, self.lower = levels[d - 1] if d > 0 else None, levels[d], levels[d + 1]
        self.level_class = min(unit["depth"] - 1 - d, 3)
        self.components, self.steps = unit["components"], [step(qp) for qp in unit["qp"]]
        self.bits_of_plane = MixedBits if unit["num_models"] > 0 else DirectBits

    def run(self, end):
        if self.unit["dct_blocks"] > 0 and self.unit["depth"] - self.d == 3:
            decode_blocks(self, end)
        for node in range(self.first, end):
            children = self.level.children[node]
            if node in self.level.dct or node in self.level.known:
                continue
            if len(children) == 1:
                (child,) = children.values()
                self.lower.mean[child] = self.level.mean[node]
                self.level.energy[node] = self.above(node)
            else:
                self.block(node, children)

    def above(self, node):
        return self.upper.energy[self.level.parent[node]] if self.upper else (0, 0)

    def block(self, node, children):
        predicted = {octant: self.predict(node, octant) for octant in children}
        child_weight = {octant: self.lower.weight[child] for octant, child in children.items()}
        block = Block(node, children, predicted, child_weight, self.components)
        planes = [[0]] if self.components == 1 else [[0], list(range(1, self.components))]
        for k, plane in enumerate(planes):
            if k == 1 and self.unit["component_cross"] > 0 and block.flag[0] == 1:
                followed(self, block)
            self.parse_plane(block, k, plane)
            total = sum(abs(block.q[c][n]) for c in plane for n in block.splits)
            block.energy[k] = min(255, 16 * total // (len(block.splits) * len(plane)))
        self.level.energy[node] = tuple(block.energy)
        self.level.q[node] = block.q
        means = [self.reconstruct(block, c) for c in range(self.components)]
        for octant, child in children.items():
            self.lower.mean[child] = [of_octant[octant] for of_octant in means]

    # Clause 7.3

    def predict(self, node, octant):
        kernel, level, lower = self.unit["kernel"], self.level, self.lower
        o = [octant & 1, octant >> 1 & 1, octant >> 2 & 1]
        weigh = lambda mean: falloff(mean, level.mean[node], self.unit["colour_range"], self.steps[0])
        terms = [(64 * kernel[0], level.mean[node])]
        for m in range(1, 8):
            bits = [m & 1, m >> 1 & 1, m >> 2 & 1]
            other = level.neighbour(node, *(b * (2 * side - 1) for b, side in zip(bits, o, strict=True)))
            if other is None:
                continue
            if other < self.first or other > node:
                terms.append((kernel[sum(bits)] * weigh(level.mean[other]), level.mean[other]))
                continue
            for p, child in level.children[other].items():
                x = p ^ octant
                if x & m == m:
                    distance = sum(bits) + (x & ~m & 7).bit_count()
                    terms.append((kernel[3 + distance] * weigh(lower.mean[child]), lower.mean[child]))
        total = sum(w for w, _ in terms)
        sums = [sum(w * mean[c] for w, mean in terms) for c in range(self.components)]
        return [(2 * s + total) // (2 * total) for s in sums]

    # Clause 7.4

    def reconstruct(self, block, c):
        v = self.spread_mean(block, c, self.level.mean[block.node][c] - block.shift(c))
        return {octant: clip(-LARGEST, LARGEST, v[7 + octant] + block.predicted[octant][c]) for octant in block.children}

    def spread_mean(self, block, c, mean):
        """V of clause 7.4.3, of which V(0) is given."""
        weights, v = block.weights, [None] * 15
        v[0] = mean
        for n in range(7):
            w1, w2 = weights[2 * n + 1], weights[2 * n + 2]
            if n in block.splits:
                d = dequantise(*self.rotated(block, c, n), self.unit["qp"][c], w1, w2)
                v[2 * n + 1] = v[n] - (2 * w2 * d + w1 + w2) // (2 * (w1 + w2))
                v[2 * n + 2] = v[2 * n + 1] + d
            elif w1 > 0:
                v[2 * n + 1] = v[n]
            elif w2 > 0:
                v[2 * n + 2] = v[n]
        return v

    def rotated(self, block, c, n):
        """(q, half) of a split: clause 7.11.1."""
        q = block.q[c]
        if n < 3 or not self.is_rotated(block):
            return q[n], 0
        return (q[3] - q[4] if n == 3 else q[3] + q[4]), 1

    def is_rotated(self, block):
        return self.unit["planar_transform"] > 0 and 3 in block.splits and 4 in block.splits

    # Clause 7.5

    def surroundings(self, node, k):
        """near, nearWeight, far, farWeight of 7.5.1."""
        near = near_weight = 0
        far, far_weight = 3 * self.above(node)[k], 3
        for dx, dy, dz, w in DIRECTIONS:
            other = self.level.neighbour(node, dx, dy, dz)
            if other is None:
                continue
            if self.first <= other < node:
                near += w * self.level.energy[other][k]
                near_weight += w
            else:
                far += w * self.above(other)[k]
                far_weight += w
        return near, near_weight, far, far_weight

    def parse_plane(self, block, k, plane):
        """Clause 7.5.3, with the contexts of 7.5.2 or 7.5.5."""
        bits = self.bits_of_plane(self, block, k, plane)
        block.flag[k] = bits.flag()
        if block.flag[k] == 0:
            return
        left, some = len(block.splits) * len(plane), False
        for c in plane:
            ones = large = 0
            for n in block.splits:
                left -= 1
                stage = 0 if n == 0 else 1 if n < 3 else 2
                luma = abs(block.q[0][n]) if c > 0 else 0
                at = SimpleNamespace(c=c, n=n, stage=stage, ones=ones, large=large, luma=luma, left=left)
                if (left > 0 or some) and bits.nonzero(at) == 0:
                    continue
                block.q[c][n] = self.parse_magnitude(bits, at)
                some = True
                ones += 1
                large += abs(block.q[c][n]) > 1

    def parse_magnitude(self, bits, at):
        """Clause 7.5.4."""
        sign, magnitude = -1 if bits.sign(at) else 1, 1
        for i in range(15):
            if bits.more(at, i) == 0:
                return sign * magnitude
            magnitude += 1
        return sign * (magnitude + self.decoder.escape() - 1)


class DirectBits:
    """The bits of one plane of one block with the contexts of clause 7.5.2."""

    def __init__(self, nodes, block, k, plane):
        self.nodes, self.k, self.level_class = nodes, k, nodes.level_class
        self.size, self.luma_flag = min(len(block.splits), 3) - 1, block.flag[0] if k == 1 else 0
        self.near_class, self.far_class = surrounding_classes(*nodes.surroundings(block.node, k))
        self.strength = max(self.near_class, self.far_class)

    def decode(self, number):
        return self.nodes.decoder.bit(self.nodes.table, number)

    def flag(self):
        first_part = ((self.k * 4 + self.level_class) * 3 + self.size) * 2 + self.luma_flag
        return self.decode((first_part * 7 + self.near_class) * 7 + self.far_class)

    def nonzero(self, at):
        first_part = ((at.c * 4 + self.level_class) * 3 + at.stage) * 3 + min(at.ones, 2)
        return self.decode(2352 + (first_part * 7 + self.strength) * 3 + min(at.luma, 2))

    def sign(self, at):
        return self.nodes.decoder.bypass()

    def more(self, at, i):
        """Bit i of a magnitude: the first has MoreCtx, each further one the UnaryCtx of the bit before."""
        if i == 0:
            return self.decode(4620 + (at.c * 7 + self.strength) * 3 + min(at.large, 2))
        return self.decode(4683 + at.c * 14 + min(i - 1, 13))


def tree_weights(weight_of_octant):
    """Clause 7.4.1: W of the 15 nodes of a block."""
    weights = [0] * 7 + [weight_of_octant.get(octant, 0) for octant in range(8)]
    for n in range(6, -1, -1):
        weights[n] = weights[2 * n + 1] + weights[2 * n + 2]
    return weights


def dequantise(q, half, qp, w1, w2):
    """Clauses 7.4.2 and 7.11.1; half: 1 for a coefficient that was rotated."""
    gain = isqrt(((w1 + w2) << (34 - half)) // (w1 * w2))
    difference = min(LARGEST - 1, (min(abs(q), LARGEST - 1) * step(qp) * gain + 2**16) >> 17)
    return -difference if q < 0 else difference
