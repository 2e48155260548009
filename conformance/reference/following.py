"""Clause 7.4.4 in plain Python: components that follow the first."""

from itertools import product

from conformance.reference.voxels import clip

LARGEST = 2**22
AROUND = [offsets for offsets in product((-1, 0, 1), repeat=3) if any(offsets)]


def followed(nodes, block):
    """Clause 7.4.4: moves the predictions of components 1.. of the block. nodes: its LevelDecoder."""
    own, cross = nodes.level.mean[block.node], nodes.unit["component_cross"]
    around = [[a - b for a, b in zip(mean, own, strict=True)] for mean in surroundings(nodes, block.node)]
    spread = sum(d[0] * d[0] for d in around) + (nodes.steps[0] ** 2 >> 2)
    detail = nodes.spread_mean(block, 0, 0)
    for c in range(1, nodes.components):
        factor = clip(-512, 512, 16 * cross * sum(d[0] * d[c] for d in around) // spread)
        for octant, predicted in block.predicted.items():
            predicted[c] = clip(-LARGEST, LARGEST, predicted[c] + ((factor * detail[7 + octant] + 128) >> 8))


def surroundings(nodes, node):
    """Means of the blocks around that are not decoded, and of the children that touch the node, of those that are."""
    level, found = nodes.level, []
    least = [2 * x - 1 for x in level.coordinates[node]]
    for offsets in AROUND:
        other = level.neighbour(node, *offsets)
        if other is None:
            continue
        if other < nodes.first or other > node:
            found.append(level.mean[other])
            continue
        for child in level.children[other].values():
            if all(a <= x <= a + 3 for a, x in zip(least, nodes.lower.coordinates[child], strict=True)):
                found.append(nodes.lower.mean[child])
    return found
