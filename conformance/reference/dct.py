"""Clause 7.11.4 in plain Python: blocks of 8 x 8 texels that are decoded at once."""

from conformance.reference.mixing import MixedTable
from conformance.reference.scales import energy_class, fine, sign_of, sixteenths
from conformance.reference.voxels import clip

COUNT, ZERO, MORE, SIGN = range(4)
WEIGHT_SETS, REFINEMENT_SETS = 873, 621
COSINE = (8192, 8035, 7568, 6811, 5793, 4551, 3135, 1598, 0)
PLACES = [(u, v) for u in range(8) for v in range(8)]
ZIGZAG = sorted(PLACES, key=lambda p: (sum(p), p[0] if sum(p) % 2 == 0 else p[1]))


def basis(f, x):
    if f == 0:
        return 5793
    m = (2 * x + 1) * f % 32
    m = min(m, 32 - m)
    return COSINE[m] if m <= 8 else -COSINE[16 - m]


def share(f, a):
    return a >> 1 if f > 0 else (181 * a) >> 9


def alone(f, a):
    return 2 * a if f > 0 else (181 * a) >> 6


class DctBlock:
    """A DCT block: q[c] by (u, v) and texels by (x, y) and component."""

    def __init__(self, nodes, node):
        """nodes: the LevelDecoder."""
        self.nodes, self.node, self.mean = nodes, node, nodes.level.mean[node]
        self.q, self.count, self.texels = [], [], {(x, y): [] for x in range(8) for y in range(8)}
        self.west, self.north, self.corner = (self.beside(x, y) for x, y in ((-1, 0), (0, -1), (-1, -1)))

    def beside(self, x, y):
        """W, N or X: a DCT block of this range, or None."""
        other = self.nodes.level.neighbour(self.node, x, y, 0)
        return None if other is None or other < self.nodes.first else self.nodes.level.dct.get(other)

    def decode(self):
        for c, scale in enumerate(self.nodes.steps):
            self.component(c, scale)

    def bit(self, kind, numbers, first, second):
        return self.nodes.table.dct.bit(self.nodes.decoder, kind, numbers, first, second, first)

    def component(self, c, scale):
        q = {place: 0 for place in PLACES}
        self.q.append(q)
        west, north = self.borders(c)
        left = self.parse_count(c, scale, west, north)
        self.count.append(left)
        value = {}
        for z in range(1, 64):
            if left == 0:
                break
            u, v = ZIGZAG[z]
            at = Coefficient(self, c, scale, z, left, alone(u, west[v]), alone(v, north[u]))
            if left < 64 - z and at.nonzero() == 0:
                continue
            left -= 1
            sign = -1 if at.sign() else 1
            q[u, v] = sign * at.magnitude(left)
            value[u, v] = clip(-(2**25), 2**25, q[u, v] * scale)
            west[v] -= share(u, value[u, v])
            north[u] -= share(v, value[u, v])
        for (x, y), texel in self.texels.items():
            total = sum(a * basis(u, x) * basis(v, y) for (u, v), a in value.items())
            texel.append(clip(-(2**22), 2**22, self.mean[c] + ((total + 2**27) >> 28)))

    def borders(self, c):
        """west and north before any coefficient is known."""
        edge = lambda last, before: 3 * last[c] - before[c] - 2 * self.mean[c]
        sums = lambda edges: [sum(basis(f, i) * e for i, e in enumerate(edges)) >> 15 for f in range(8)]
        west = [edge(self.west.texels[7, i], self.west.texels[6, i]) for i in range(8)] if self.west else [0] * 8
        north = [edge(self.north.texels[i, 7], self.north.texels[i, 6]) for i in range(8)] if self.north else [0] * 8
        return sums(west), sums(north)

    def parse_count(self, c, scale, west, north):
        counts = [block.count[c] for block in (self.west, self.north) if block]
        if counts:
            around = (sum(counts) + len(counts) - 1) // len(counts)
        else:
            around = self.count[0] if c > 0 else 32
        if c > 0:
            other = self.count[c - 1]
        else:
            other = self.corner.count[0] if self.corner else 63
        last = self.west.count[c] if self.west else around
        border = fine(sixteenths(sum(map(abs, west + north)), scale) >> 3)
        node = 1
        for _ in range(6):
            numbers = [
                (c, around, node),
                (c, other, node),
                (c, border, fine(around), node),
                (c, last, node),
            ]
            node = 2 * node + self.bit(COUNT, numbers, c * 64 + node, 621 + c * 12 + fine(around))
        return node - 64


class Coefficient:
    """The bits of one coefficient."""

    def __init__(self, block, c, scale, z, left, west, north):
        """west, north: the coefficient that would be left alone for either border."""
        u, v = ZIGZAG[z]
        self.block, self.c, self.z, self.left, self.place = block, c, z, left, 8 * v + u
        self.u, self.v = u, v
        there = lambda other: other.q[c][u, v] if other else 0
        before = [there(other) for other in (block.west, block.north, block.corner)]
        self.alike = fine(sum(w * abs(q) for w, q in zip((3, 3, 2), before, strict=True)))
        self.signs = 3 * sign_of(before[0]) + sign_of(before[1])
        lower = lambda x, y: abs(block.q[c].get((u - x, v - y), 0))
        self.near = 2 * lower(1, 0) + 2 * lower(0, 1) + lower(1, 1) + lower(2, 0) + lower(0, 2)
        self.size, self.rest = fine(self.near), fine(63 - z)
        sizes = sixteenths(west, scale), sixteenths(north, scale)
        self.expected = fine((sizes[0] if u == 0 else sizes[1] if v == 0 else sum(sizes) >> 1) >> 1)
        signed = lambda size, a: 6 + energy_class(size >> 2) * (-1 if a < 0 else 1)
        self.from_west, self.from_north = signed(sizes[0], west), signed(sizes[1], north)
        self.first, self.second = (block.q[i][u, v] if i < c else 0 for i in (0, 1))
        self.kind = 0 if u == 0 else 1 if v == 0 else 2 if u + v < 4 else 3

    def nonzero(self):
        c, place, left = self.c, self.place, self.left
        numbers = [
            (c, self.z, left),
            (c, place, self.alike),
            (c, self.size, self.alike, self.rest),
            (c, place, min(abs(self.first), 2), min(abs(self.second), 2), min(self.near, 2)),
            (c, place, self.expected),
            (c, self.expected, fine(left), self.rest),
        ]
        return self.block.bit(ZERO, numbers, 192 + c * 64 + self.z, 657 + c * 12 + fine(left))

    def sign(self):
        c, place = self.c, self.place
        numbers = [
            (c, place, self.signs),
            (c, self.from_west, self.from_north, self.kind),
            (c, place, sign_of(self.first), sign_of(self.second)),
            (c, place, self.from_west if self.u <= self.v else self.from_north),
        ]
        return self.block.bit(SIGN, numbers, 429 + c * 64 + place, 729 + (c * 12 + self.expected) * 4 + self.kind)

    def magnitude(self, left):
        """left: coefficients other than zero after this one."""
        c = self.c
        for i in range(15):
            numbers = [
                (c, i, self.place),
                (c, i, self.size, self.alike),
                (c, i, self.expected, fine(self.u + self.v)),
                (c, i, fine(left), min(abs(self.first), 3)),
                (c, i, self.alike, self.expected),
            ]
            if self.block.bit(MORE, numbers, 384 + c * 15 + i, 693 + c * 12 + self.size) == 0:
                return i + 1
        return 15 + self.block.nodes.decoder.escape()


def decode_blocks(nodes, end):
    """The DCT blocks of a range; gives the means and energies of all nodes below them."""
    level, table = nodes.level, nodes.table
    table.dct = table.dct or MixedTable(6, WEIGHT_SETS, REFINEMENT_SETS)
    for node in range(nodes.first, end):
        if level.weight[node] != 64:
            continue
        block = level.dct[node] = DctBlock(nodes, node)
        block.decode()
        planes = [block.q[:1], block.q[1:]] if nodes.components > 1 else [block.q]
        energy = [min(255, 16 * sum(abs(a) for q in plane for a in q.values()) // (63 * len(plane))) for plane in planes]
        spread(nodes.levels, nodes.d, node, block.texels, tuple((energy + [0])[:2]))


def spread(levels, d, node, texels, energy):
    """Means of the nodes below a node, whose texels are given by their places in it, and their energies."""
    levels[d].energy[node] = energy
    if d + 1 == len(levels):
        return
    side = 2 ** (len(levels) - 2 - d)
    for octant, child in levels[d].children[node].items():
        x0, y0 = (octant & 1) * side, (octant >> 1) * side
        own = {(x, y): texels[x0 + x, y0 + y] for x in range(side) for y in range(side)}
        n = len(own)
        levels[d + 1].mean[child] = [(2 * s + n) // (2 * n) for s in map(sum, zip(*own.values(), strict=True))]
        levels[d + 1].known.add(child)
        spread(levels, d + 1, child, own, energy)
