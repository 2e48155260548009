"""Clause 7 in plain Python: octree, prediction, transform, contexts, range decoder."""

from math import isqrt

from naive.bits import require
from naive.voxels import clip

STEP_TABLE = (2580, 2896, 3251, 3649, 4096, 4598)
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

    def bit(self, table, number):
        """Clause 7.6.3; table[number] is (fast, slow, count)."""
        fast, slow, count = table[number]
        bit = self.split((self.range >> 16) * clip(24, 65512, (fast + slow) >> 7))
        target = bit * (2**22 - 1)
        fast += (target - fast) >> min((count + 1).bit_length(), 3)
        slow += (target - slow) >> (count + 1).bit_length()
        table[number] = (fast, slow, min(count + 1, 63))
        return bit


def decode_values(unit, keys, lod=0):
    """Clause 7.2 and 7.7: the values as bytes, component by component; lod counts the levels left out."""
    depth = unit["depth"]
    levels = octree(keys, depth)
    levels[0].mean[0] = unit["root_mean"]
    whole = lambda level: [(0, len(level.values))]
    decoders = [RangeDecoder(codeword) for codeword in unit["codewords"]]
    tables = [[(2**21, 2**21, 0)] * 4725 for _ in decoders[:1]]
    if unit["slice_level"] > 0:
        starts = unit["slice_first"]
        require(starts[-1] < len(levels[unit["slice_level"]].values), "a slice begins past the last node of its level")
    for d in range(depth - min(lod, depth)):
        if unit["slice_level"] == 0 or d < unit["slice_level"]:
            ranges, used = whole(levels[d]), slice(0, 1)
        elif d == unit["slice_level"]:
            ranges = list(zip(starts, starts[1:] + [len(levels[d].values)], strict=True))
            tables += [list(tables[0]) for _ in ranges]
            used = slice(1, None)
        else:
            ranges = [children_of_range(levels[d - 1], first, end) for first, end in ranges]
        for (first, end), decoder, table in zip(ranges, decoders[used], tables[used], strict=True):
            LevelDecoder(unit, levels, d, first, decoder, table).run(end)
    return b"".join(values_of_node(mean, unit["colour_transform"]) for mean in levels[depth - min(lod, depth)].mean)


def children_of_range(level, first, end):
    numbers = [child for node in range(first, end) for child in level.children[node].values()]
    return min(numbers), max(numbers) + 1


def values_of_node(mean, colour_transform):
    """Clause 7.7."""
    if colour_transform == 0:
        return bytes(clip(0, 255, (m + 2**11) >> 12) for m in mean)
    y, cb, cr = mean
    red = (65536 * y + 103206 * cr + 2**27) >> 28
    green = (65536 * y - 12276 * cb - 30679 * cr + 2**27) >> 28
    blue = (65536 * y + 121608 * cb + 2**27) >> 28
    return bytes(clip(0, 255, value) for value in (red, green, blue))


class LevelDecoder:
    """One range of one level: gives the means of the children of its nodes."""

    def __init__(self, unit, levels, d, first, decoder, table):
        self.unit, self.first, self.decoder, self.table = unit, first, decoder, table
        self.upper, self.level, self.lower = levels[d - 1] if d > 0 else None, levels[d], levels[d + 1]
        self.level_class = min(unit["depth"] - 1 - d, 3)
        self.components = unit["components"]

    def run(self, end):
        for node in range(self.first, end):
            children = self.level.children[node]
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
        weights = tree_weights({octant: self.lower.weight[child] for octant, child in children.items()})
        splits = [n for n in range(7) if weights[2 * n + 1] > 0 and weights[2 * n + 2] > 0]
        q = [[0] * 7 for _ in range(self.components)]
        planes = [[0]] if self.components == 1 else [[0], list(range(1, self.components))]
        energy, flag = [0, 0], 0
        for k, plane in enumerate(planes):
            flag = self.parse_plane(node, k, plane, splits, q, flag)
            total = sum(abs(q[c][n]) for c in plane for n in splits)
            energy[k] = min(255, 16 * total // (len(splits) * len(plane)))
        self.level.energy[node] = tuple(energy)
        means = [self.reconstruct(node, c, children, weights, splits, q[c], predicted) for c in range(self.components)]
        for octant, child in children.items():
            self.lower.mean[child] = [of_octant[octant] for of_octant in means]

    # Clause 7.3

    def predict(self, node, octant):
        kernel, level, lower = self.unit["kernel"], self.level, self.lower
        o = [octant & 1, octant >> 1 & 1, octant >> 2 & 1]
        terms = [(kernel[0], level.mean[node])]
        for m in range(1, 8):
            bits = [m & 1, m >> 1 & 1, m >> 2 & 1]
            other = level.neighbour(node, *(b * (2 * side - 1) for b, side in zip(bits, o, strict=True)))
            if other is None:
                continue
            if other < self.first or other > node:
                terms.append((kernel[sum(bits)], level.mean[other]))
                continue
            for p, child in level.children[other].items():
                x = p ^ octant
                if x & m == m:
                    terms.append((kernel[3 + sum(bits) + (x & ~m & 7).bit_count()], lower.mean[child]))
        total = sum(w for w, _ in terms)
        sums = [sum(w * mean[c] for w, mean in terms) for c in range(self.components)]
        return [(2 * s + total) // (2 * total) for s in sums]

    # Clause 7.4

    def reconstruct(self, node, c, children, weights, splits, q, predicted):
        total = weights[0]
        acc = sum(self.lower.weight[child] * predicted[octant][c] for octant, child in children.items())
        v = [None] * 15
        v[0] = self.level.mean[node][c] - (2 * acc + total) // (2 * total)
        for n in range(7):
            w1, w2 = weights[2 * n + 1], weights[2 * n + 2]
            if n in splits:
                d = dequantise(q[n], self.unit["qp"][c], w1, w2)
                v[2 * n + 1] = v[n] - (2 * w2 * d + w1 + w2) // (2 * (w1 + w2))
                v[2 * n + 2] = v[2 * n + 1] + d
            elif w1 > 0:
                v[2 * n + 1] = v[n]
            elif w2 > 0:
                v[2 * n + 2] = v[n]
        return {octant: clip(-LARGEST, LARGEST, v[7 + octant] + predicted[octant][c]) for octant in children}

    # Clause 7.5

    def surroundings(self, node, k):
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
        near_class = energy_class((near + near_weight - 1) // near_weight) if near_weight > 0 else 0
        return near_class, energy_class((far + far_weight - 1) // far_weight)

    def parse_plane(self, node, k, plane, splits, q, flag0):
        near_class, far_class = self.surroundings(node, k)
        strength, size = max(near_class, far_class), min(len(splits), 3) - 1
        first_part = ((k * 4 + self.level_class) * 3 + size) * 2 + (flag0 if k == 1 else 0)
        flag = self.decoder.bit(self.table, (first_part * 7 + near_class) * 7 + far_class)
        if flag == 0:
            return flag
        left, some = len(splits) * len(plane), False
        for c in plane:
            ones = large = 0
            for n in splits:
                left -= 1
                stage = 0 if n == 0 else 1 if n < 3 else 2
                luma = abs(q[0][n]) if c > 0 else 0
                zero_ctx = ((c * 4 + self.level_class) * 3 + stage) * 3 + min(ones, 2)
                zero_ctx = 2352 + (zero_ctx * 7 + strength) * 3 + min(luma, 2)
                if (left > 0 or some) and self.decoder.bit(self.table, zero_ctx) == 0:
                    continue
                q[c][n] = self.parse_magnitude(c, large, strength)
                some = True
                ones += 1
                large += abs(q[c][n]) > 1
        return flag

    def parse_magnitude(self, c, large, strength):
        sign = -1 if self.decoder.bypass() else 1
        magnitude, ctx = 1, 4620 + (c * 7 + strength) * 3 + min(large, 2)
        for i in range(15):
            if self.decoder.bit(self.table, ctx) == 0:
                return sign * magnitude
            magnitude += 1
            ctx = 4683 + c * 14 + min(i, 13)
        bits, rest = 0, 1
        while bits < 24 and self.decoder.bypass() == 1:
            bits += 1
        for _ in range(bits):
            rest = 2 * rest + self.decoder.bypass()
        return sign * (magnitude + rest - 1)


def tree_weights(weight_of_octant):
    """Clause 7.4.1: W of the 15 nodes of a block."""
    weights = [0] * 7 + [weight_of_octant.get(octant, 0) for octant in range(8)]
    for n in range(6, -1, -1):
        weights[n] = weights[2 * n + 1] + weights[2 * n + 2]
    return weights


def dequantise(q, qp, w1, w2):
    """Clause 7.4.2."""
    step = STEP_TABLE[qp % 6] << (qp // 6)
    gain = isqrt(((w1 + w2) << 34) // (w1 * w2))
    difference = min(LARGEST - 1, (min(abs(q), LARGEST - 1) * step * gain + 2**16) >> 17)
    return -difference if q < 0 else difference


def energy_class(e):
    """Clause 7.5.1."""
    for number, last in enumerate((0, 1, 3, 6, 12, 28)):
        if e <= last:
            return number
    return 6
