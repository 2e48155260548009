"""Clause 7.11 in plain Python: what blocks of planar supports have besides."""

from naive.voxels import clip

LARGEST = 2**22
AROUND = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)]
CORNERS = ((-1, -1), (1, -1), (-1, 1))


def followed(nodes, block):
    """Clause 7.11.2: moves the predictions of components 1.. of the block. nodes: its LevelDecoder."""
    own, cross = nodes.level.mean[block.node], nodes.unit["component_cross"]
    around = [[a - b for a, b in zip(mean, own, strict=True)] for mean in surroundings(nodes, block.node)]
    spread = sum(d[0] * d[0] for d in around) + (nodes.steps[0] ** 2 >> 2)
    detail = nodes.spread_mean(block, 0, 0)
    for c in range(1, nodes.components):
        factor = clip(-512, 512, 16 * cross * sum(d[0] * d[c] for d in around) // spread)
        for octant, predicted in block.predicted.items():
            predicted[c] = clip(-LARGEST, LARGEST, predicted[c] + ((factor * detail[7 + octant] + 128) >> 8))


def surroundings(nodes, node):
    """Means of the blocks around that are not decoded, and of the children, nearest to the node, of those that are."""
    level, found = nodes.level, []
    x0, y0, _ = level.coordinates[node]
    for x, y in AROUND:
        other = level.neighbour(node, x, y, 0)
        if other is None:
            continue
        if other < nodes.first or other > node:
            found.append(level.mean[other])
            continue
        for child in level.children[other].values():
            cx, cy, _ = nodes.lower.coordinates[child]
            if 2 * x0 - 1 <= cx <= 2 * x0 + 2 and 2 * y0 - 1 <= cy <= 2 * y0 + 2:
                found.append(nodes.lower.mean[child])
    return found


def coefficient(nodes, node, c, n):
    """q of a block; 0 where the node is none."""
    q = nodes.level.q[node]
    return 0 if q is None else q[c][n]


def earlier(nodes, node, x, y, c, n):
    """Coefficient of a neighbour that was decoded before the node, else 0."""
    other = nodes.level.neighbour(node, x, y, 0)
    return 0 if other is None or not nodes.first <= other < node else coefficient(nodes, other, c, n)


def alike(nodes, node, c, n):
    """alike and alikeSigns of clause 7.11.3."""
    west, north = earlier(nodes, node, -1, 0, c, n), earlier(nodes, node, 0, -1, c, n)
    corners = sum(abs(earlier(nodes, node, x, y, c, n)) for x, y in CORNERS)
    above = nodes.upper.q[nodes.level.parent[node]] if nodes.upper else None
    above = 0 if above is None else above[c][n]
    digits = [min(abs(v), 2) for v in (west, north, corners, above)]
    sign = lambda v: 0 if v == 0 else 1 if v > 0 else 2
    return sum(d * 3**i for i, d in enumerate(reversed(digits))), 3 * sign(west) + sign(north)
