"""Clause 7.11 in plain Python: what blocks of planar supports have besides."""

from conformance.reference.scales import sign_of

CORNERS = ((-1, -1), (1, -1), (-1, 1))


def coefficient(nodes, node, c, n):
    """q of a block; 0 where the node is none."""
    q = nodes.level.q[node]
    return 0 if q is None else q[c][n]


def earlier(nodes, node, x, y, c, n):
    """Coefficient of a neighbour that was decoded before the node, else 0."""
    other = nodes.level.neighbour(node, x, y, 0)
    return 0 if other is None or not nodes.first <= other < node else coefficient(nodes, other, c, n)


def alike(nodes, node, c, n):
    """alike and alikeSigns of clause 7.11.2."""
    west, north = earlier(nodes, node, -1, 0, c, n), earlier(nodes, node, 0, -1, c, n)
    corners = sum(abs(earlier(nodes, node, x, y, c, n)) for x, y in CORNERS)
    above = nodes.upper.q[nodes.level.parent[node]] if nodes.upper else None
    above = 0 if above is None else above[c][n]
    digits = [min(abs(v), 2) for v in (west, north, corners, above)]
    return sum(d * 3**i for i, d in enumerate(reversed(digits))), 3 * sign_of(west) + sign_of(north)
