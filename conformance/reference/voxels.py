"""Clause 6 in plain Python: which voxels the surface touches, and with how much of its area."""

from math import isqrt


def clip(low, high, value):
    """Clause 4.1."""
    return max(low, min(high, value))


def morton_key(x, y, z):
    """Clause 6.4."""
    key = 0
    for i in range(max(x, y, z).bit_length()):
        key |= ((x >> i & 1) | (y >> i & 1) << 1 | (z >> i & 1) << 2) << (3 * i)
    return key


def active_voxels(triangles, position_bits, resolution, area_threshold):
    """Ascending Morton keys of the active voxels; triangles: corner triples of lattice positions (x, y, z)."""
    weights = {}
    for corners in triangles:
        grid = [tuple((p * resolution << 16) >> position_bits for p in corner) for corner in corners]
        add_triangle(weights, sorted(grid), resolution)
    return sorted(morton_key(*voxel) for voxel, weight in weights.items() if weight >= area_threshold << 24)


def reach(u, v):
    """Clause 6.2, step 2."""
    return max(abs(p - q) for p, q in zip(u, v, strict=True))


def frame(a, b, c):
    """Clause 6.2: start, end, apex, columns, rows and unit of a triangle with sorted corners."""
    if reach(a, b) >= reach(a, c) and reach(a, b) >= reach(b, c):
        start, end, apex = a, b, c
    elif reach(a, c) >= reach(b, c):
        start, end, apex = a, c, b
    else:
        start, end, apex = b, c, a
    base = reach(start, end)
    if base == 0:
        return start, end, apex, 1, 1, 0
    ux, uy, uz = (q - p for p, q in zip(start, end, strict=True))
    vx, vy, vz = (q - p for p, q in zip(start, apex, strict=True))
    cross = [abs(uy * vz - uz * vy), abs(uz * vx - ux * vz), abs(ux * vy - uy * vx)]
    shift = 0
    while max(cross) >> shift >= 2**30:
        shift += 1
    area = isqrt(sum((n >> shift) ** 2 for n in cross)) << shift
    columns = max(1, (2 * base + 2**16 - 1) >> 16)
    rows = max(1, (2 * (area // base) + 2**16 - 1) >> 16)
    return start, end, apex, columns, rows, area // (rows * rows)


def add_triangle(weights, corners, resolution):
    """Clause 6.3: adds the triangle's samples to weights, a dict from voxel (x, y, z) to area weight."""
    start, end, apex, columns, rows, unit = frame(*corners)
    for j in range(rows):
        offset = 0 if columns > 4 * rows else 1
        left = 2 * rows - 2 * j - offset
        count = max(1, (columns * left + 2 * rows - 1) // (2 * rows))
        first = [(s + ((t - s) * (2 * j + offset)) // (2 * rows)) << 16 for s, t in zip(start, apex, strict=True)]
        half = [((((e - s) * left) // (2 * rows)) << 16) // (2 * count) for s, e in zip(start, end, strict=True)]
        share = (unit * (2 * rows - 2 * j - 1)) // (2 * count)
        for i in range(count):
            voxel = tuple(clip(0, resolution - 1, (f + (2 * i + 1) * h) >> 32) for f, h in zip(first, half, strict=True))
            weights[voxel] = weights.get(voxel, 0) + share
