"""Plain-Python oracles of single kernels: unlimited integers and fractions, no numpy, no numba, written from bitstream_spec.md.
Where the reference decoder has a function of its own for a rule, it is the oracle.

They are slow and follow the clauses, not the kernels; where a clause leaves the way open they take the most obvious one (a dict
for a look-up table, a loop over all voxels for a search).
"""

from collections import defaultdict
from fractions import Fraction
from itertools import product
from math import isqrt

from conformance.reference import attributes, mixing
from conformance.reference.attributes import tree_weights, values_of_node
from conformance.reference.filter import filter_stage as filter_stage
from conformance.reference.queries import voxel_answers
from conformance.reference.scales import STEP_TABLE as STEP_TABLE
from conformance.reference.scales import energy_class
from conformance.reference.scales import falloff as falloff
from conformance.reference.scales import step as step
from conformance.reference.voxels import add_triangle
from conformance.reference.voxels import frame as frame
from conformance.reference.voxels import morton_key as morton

# Order and look-up


def voxel_of(key):
    """Inverse of morton."""
    return tuple(sum(((key >> (3 * i + axis)) & 1) << i for i in range(16)) for axis in range(3))


# Voxelisation (6.1 to 6.4)


def double_area(u, v):
    """Length of the cross product of two edges, its components cut to 30 bits before they are squared (6.2)."""
    cross = [abs(u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]) for i in range(3)]
    shift = max(0, max(cross).bit_length() - 30)
    return isqrt(sum((c >> shift) ** 2 for c in cross)) << shift


def exact_double_area(u, v):
    """The same without the cut, rounded down."""
    cross = [u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3] for i in range(3)]
    return isqrt(sum(c * c for c in cross))


def voxelise(lattice, faces, bits, resolution, threshold=0):
    """Active voxels as a dict from Morton key to area weight."""
    weights = {}
    for face in faces:
        add_triangle(weights, sorted(tuple((p * resolution << 16) >> bits for p in lattice[v]) for v in face), resolution)
    return {key: weight for key, weight in sorted((morton(*voxel), weight) for voxel, weight in weights.items())
            if weight >= threshold << 24}


# Query (8.2)


def query(point, values):
    """(lowest, highest) admissible answer at a grid point. values: dict from voxel to a number."""
    answers = [answer for (answer,) in voxel_answers([Fraction(v) for v in point], {v: [n] for v, n in values.items()})]
    return min(answers), max(answers)


# Octree (7.1)


def level_nodes(keys, depth, level):
    """Nodes of a level as a dict from node value to its weight, ascending."""
    nodes = {}
    for key in keys:
        value = key >> 3 * (depth - level)
        nodes[value] = nodes.get(value, 0) + 1
    return nodes


def neighbours(values):
    """For every node of a level (ascending values) its 27 neighbours' indices, -1 where there is none."""
    place = {voxel_of(v): i for i, v in enumerate(values)}
    offsets = list(product((-1, 0, 1), repeat=3))
    return [[place.get(tuple(a + b for a, b in zip(voxel_of(v), d, strict=True)), -1) for d in offsets] for v in values]


def predict(node, first, parents, children, parent_mean, child_mean, kernel, colour_range=0, luma_step=1):
    """Predicted means of a node's children as a dict from octant to a list (7.3), found by coordinates.

    parents, children: ascending node values of two levels; node, first: indices of parents; parent_mean, child_mean: lists of
    lists per index, the latter right only for children of parents first..node-1. luma_step: the step of component 0.
    """
    weigh = lambda mean: falloff(mean, parent_mean[node], colour_range, luma_step)
    parent_place = {voxel_of(v): i for i, v in enumerate(parents)}
    child_place = {voxel_of(v): i for i, v in enumerate(children)}
    out = {}
    home = voxel_of(parents[node])
    for child in children:
        if child >> 3 != parents[node]:
            continue
        voxel = voxel_of(child)
        side = [2 * (v & 1) - 1 for v in voxel]  # towards the corner of the parent that the child touches
        terms = [(64 * kernel[0], parent_mean[node])]
        for move in product((0, 1), repeat=3):
            crossed = sum(move)
            other = parent_place.get(tuple(h + m * s for h, m, s in zip(home, move, side, strict=True)))
            if crossed == 0 or other is None:
                continue
            if not first <= other < node:
                terms.append((kernel[crossed] * weigh(parent_mean[other]), parent_mean[other]))
                continue
            for away in product((-1, 0, 1), repeat=3):  # touching voxels that lie in that parent
                touching = tuple(v + d for v, d in zip(voxel, away, strict=True))
                if touching in child_place and tuple(t >> 1 for t in touching) == voxel_of(parents[other]):
                    mean = child_mean[child_place[touching]]
                    terms.append((kernel[3 + sum(map(abs, away))] * weigh(mean), mean))
        total = sum(w for w, _ in terms)
        sums = [sum(w * mean[c] for w, mean in terms) for c in range(len(parent_mean[node]))]
        out[child & 7] = [(2 * s + total) // (2 * total) for s in sums]
    return out


# Transform (7.4)


def dequantise(q, step, w1, w2):
    """Difference of means that a coefficient stands for, as the clause says (7.4.2)."""
    gain = isqrt(((w1 + w2) << 34) // (w1 * w2))
    size = min(2**22 - 1, (min(abs(q), 2**22 - 1) * step * gain + 2**16) >> 17)
    return -size if q < 0 else size


def exact_difference_squared(q, step, w1, w2):
    """Square of the difference that exact arithmetic gives (a Fraction): (q step)**2 (w1 + w2) / (w1 w2)."""
    return Fraction((q * step) ** 2 * (w1 + w2), w1 * w2)


def inverse(weights, q, mean, predicted, step, exact=False):
    """Means of a block's children, a dict by octant (7.4.3), without the final clip.

    weights, predicted: dicts by octant; q: dict by split. exact: in fractions, with the same integer differences.
    """
    divide = Fraction if exact else lambda a, b: (2 * a + b) // (2 * b)
    tree = tree_weights(weights)
    value = {0: mean - divide(sum(weights[o] * predicted[o] for o in weights), tree[0])}
    for node in range(7):
        low, high = 2 * node + 1, 2 * node + 2
        if node not in value:
            continue
        w1, w2 = tree[low], tree[high]
        if w1 and w2:
            d = dequantise(q.get(node, 0), step, w1, w2)
            value[low] = value[node] - divide(w2 * d, w1 + w2)
            value[high] = value[low] + d
        elif w1 or w2:
            value[low if w1 else high] = value[node]
    return {octant: value[7 + octant] + predicted[octant] for octant in weights}


def forward(weights, residual):
    """Squares and signs of the orthonormal coefficients of a block's residual, dict by split: (sign, Fraction)."""
    tree, value, out = tree_weights(weights), {7 + o: Fraction(r) for o, r in residual.items()}, {}
    for node in range(6, -1, -1):
        low, high = 2 * node + 1, 2 * node + 2
        w1, w2 = tree[low], tree[high]
        if w1 and w2:
            d = value[high] - value[low]
            out[node] = ((d > 0) - (d < 0), d * d * Fraction(w1 * w2, w1 + w2))
            value[node] = (w1 * value[low] + w2 * value[high]) / (w1 + w2)
        elif w1 or w2:
            value[node] = value[low if w1 else high]
    return out


# Range decoder (7.6) and binarisation (7.5.4)


class RangeDecoder(attributes.RangeDecoder):
    """The decoder of clause 7.6 over bytes; contexts spring into being in their initial state."""

    def __init__(self, data):
        super().__init__(data)
        self.contexts = defaultdict(lambda: (2**21, 2**21, 0))

    def bit(self, ctx):
        return super().bit(self.contexts, ctx)

    def magnitude(self, component, strength, large):
        sign, size, ctx = self.bypass(), 1, 4620 + (component * 7 + strength) * 3 + min(large, 2)
        for i in range(15):
            if not self.bit(ctx):
                return -size if sign else size
            size, ctx = size + 1, 4683 + component * 14 + min(i, 13)
        size += self.escape() - 1
        return -size if sign else size


# Mixed bits (7.6.4)


def squash_table():
    """Squash(x) for x = -2816..2816."""
    return [mixing.squash(x) for x in range(-2816, 2817)]


def stretch_table():
    """Stretch(v) for v = 0..4095, each x searched for from the start."""
    squashed = squash_table()
    return [next((i - 2816 for i, p in enumerate(squashed) if p >= 16 * v + 8), 2816) for v in range(4096)]


def mixed_bit(bit, contexts, first, second, refinement):
    """(p, contexts, first, second, refinement): the probability of a one that a bit is coded with and all state after it.

    contexts: list of (fast, slow, count), one for every model in use; first, second: weight sets as (weights, count), the last
    weight for the constant input, more weights than models in use allowed (SIGN); refinement: 24 entries. All left unchanged.
    """
    sets, probabilities = [mixing.WeightSet(0), mixing.WeightSet(0)], []
    for own, (weights, count) in zip(sets, (first, second), strict=True):
        own.weight, own.count = list(weights), count
    contexts, refinement = list(contexts), list(refinement)
    mixing.mixed_bit(lambda p: probabilities.append(p) or bit, contexts, *sets, refinement)
    return probabilities[0], contexts, *((own.weight, own.count) for own in sets), refinement


def rgb_of(y, cb, cr):
    """Decoded means to 8-bit RGB (7.8.2)."""
    return tuple(values_of_node((y, cb, cr), 1))


# Surroundings (7.5.1)


def surroundings(block, first, values, energy, above):
    """(nearClass, farClass) of a block for one plane; values: ascending node values of the level, energy and above parallel."""
    place = {voxel_of(v): i for i, v in enumerate(values)}
    near, far = [], [(3, above[block])]
    for offset in product((-1, 0, 1), repeat=3):
        other = place.get(tuple(a + b for a, b in zip(voxel_of(values[block]), offset, strict=True)))
        entries = sum(map(abs, offset))
        if other is None or entries not in (1, 2):
            continue
        if first <= other < block:
            near.append((3 - entries, energy[other]))
        else:
            far.append((3 - entries, above[other]))
    mean = lambda terms: energy_class(-(-sum(w * e for w, e in terms) // sum(w for w, _ in terms))) if terms else 0
    return mean(near), mean(far)
