"""Clause 8.4.2 in plain Python: the edges that faces share, how far they fold, and their marks."""

import zlib

from conformance.reference.attributes import RangeDecoder
from conformance.reference.bits import require

STEPS = (4090, 4065, 3973, 3617, 3072, 2404, 1692, 1024, 274, 4)


def decode_marks(unit, units, materials):
    """The marks as bytes. unit: of sharp edges; units: decoded geometry units."""
    edges = marked_edges(units, materials)
    require(len(edges) == unit["num_edges"], f"{len(edges)} edges are there, num_edges is {unit['num_edges']}")
    decoder, table, met, marks = RangeDecoder(unit["marks_data"]), [(1 << 21, 1 << 21, 0)] * 2016, {}, []
    for (a, b), triangles in edges:
        (edges_a, sharp_a), (edges_b, sharp_b) = met.get(a, (0, 0)), met.get(b, (0, 0))
        s = min(2, sharp_a, sharp_b) * 3 + min(2, max(sharp_a, sharp_b))
        c = min(3, edges_a, edges_b) * 4 + min(3, max(edges_a, edges_b))
        mark = decoder.bit(table, (fold(triangles) * 9 + s) * 16 + c)
        met[a], met[b] = (edges_a + 1, sharp_a + mark), (edges_b + 1, sharp_b + mark)
        marks.append(mark)
    require(zlib.crc32(bytes(marks)) == unit["marks_crc"], "marks_crc does not match")
    return bytes(marks)


def marked_edges(units, materials):
    """((lesser position, greater one) as (z, y, x), triangles of positions (x, y, z)) of each edge with a mark, in order."""
    triangles_at, marked = {}, set()
    for unit in units:
        for face in unit["faces"]:
            triangle = [tuple(unit["lattice"][corner]) for corner in face]
            turned = [place[::-1] for place in triangle]
            for edge in [tuple(sorted((turned[i], turned[i - 1]))) for i in range(3)] if len(set(turned)) == 3 else []:
                triangles_at.setdefault(edge, []).append(triangle)
                if materials[unit["material"]]["normal_rule"] >= 3:
                    marked.add(edge)
    return [(edge, triangles_at[edge]) for edge in sorted(marked) if 2 <= len(triangles_at[edge]) <= 8]


def fold(triangles):
    """0 to 13."""
    if len(triangles) > 2:
        return 13
    n, m = (normal(*triangle) for triangle in triangles)
    if not any(n) or not any(m):
        return 12
    d = dot(n, m)
    q = d * d // (dot(n, n) * dot(m, m) >> 12)
    found = sum(step > q for step in STEPS)
    return 11 if found < 10 and d < 0 else found


def dot(n, m):
    return sum(a * b for a, b in zip(n, m, strict=True))


def normal(p0, p1, p2):
    """The cross product, its largest component of 14 bits."""
    u, v = [b - a for a, b in zip(p0, p1, strict=True)], [b - a for a, b in zip(p0, p2, strict=True)]
    return brought([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def brought(vector):
    """The vector, its largest component of 14 bits."""
    shift = max(map(abs, vector)).bit_length() - 14
    return [component >> shift if shift > 0 else component << -shift for component in vector]
