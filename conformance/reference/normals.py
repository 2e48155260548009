"""Clauses 8.4.3 and 8.4.4 in plain Python: groups of corners, and the normals that are coded for them."""

import struct
import zlib
from math import isqrt

from conformance.reference.attributes import RangeDecoder
from conformance.reference.bits import require
from conformance.reference.edges import brought, dot, normal


def decode_normals(unit, marked, units, materials):
    """The normals, three 16-bit integers each, as bytes. unit: of coded normals; marked: (edge, mark) of 8.4.2; units: decoded
    geometry units."""
    triangles, asking = [], []
    for part in units:
        for face in part["faces"]:
            triangles.append([tuple(part["lattice"][corner]) for corner in face])
            asking.append(materials[part["material"]]["normal_rule"] == 6)
    groups = groups_of(triangles, asking, {edge for edge, mark in marked if mark})
    require(len(groups) == unit["num_groups"], f"{len(groups)} groups are there, num_groups is {unit['num_groups']}")
    residuals = decode_residuals(unit["residual_data"], groups)
    normals = [bent(frame(triangles, group), *pair, unit["normal_step"]) for group, pair in zip(groups, residuals, strict=True)]
    data = b"".join(struct.pack("<3h", *vector) for vector in normals)
    require(zlib.crc32(data) == unit["normals_crc"], "normals_crc does not match")
    return data


def turned(place):
    """What positions are compared by."""
    return place[::-1]


def oriented(triangle):
    """A face's positions, from the least on."""
    start = min(range(3), key=lambda i: turned(triangle[i]))
    return [turned(triangle[(start + i) % 3]) for i in range(3)]


def groups_of(triangles, asking, sharp):
    """Groups of corners (face, number), in order."""
    whole = [f for f, triangle in enumerate(triangles) if len(set(triangle)) == 3]
    at_edge, same = {}, {}
    for f in whole:
        places = [turned(place) for place in triangles[f]]
        for i in range(3):
            at_edge.setdefault(tuple(sorted((places[i], places[i - 1]))), []).append(f)
        same.setdefault(tuple(oriented(triangles[f])), []).append(f)
    linked = {(f, i): set() for f in whole for i in range(3)}

    def link(f, other, places):
        for place in places:
            a, b = ((g, [turned(p) for p in triangles[g]].index(place)) for g in (f, other))
            linked[a].add(b)
            linked[b].add(a)

    for edge, faces in at_edge.items():
        if 2 <= len(faces) <= 8 and edge not in sharp:
            for n, f in enumerate(faces):
                for other in faces[n + 1:]:
                    if len(faces) == 2 or dot(normal(*triangles[f]), normal(*triangles[other])) >= 0:
                        link(f, other, edge)
    for places, faces in same.items():
        for other in faces[1:]:
            link(faces[0], other, places)
    order = lambda corner: (turned(triangles[corner[0]][corner[1]]), oriented(triangles[corner[0]]))
    groups, taken = [], set()
    for corner in sorted((corner for corner in linked if asking[corner[0]]), key=order):
        if corner not in taken:
            group, left = {corner}, [corner]
            while left:
                new = linked[left.pop()] - group
                group |= new
                left += new
            taken |= group
            groups.append(group)
    return groups


def frame(triangles, group):
    """(x, y, z)."""
    total = [0, 0, 0]
    for f, i in group:
        here, following, last = (triangles[f][(i + k) % 3] for k in range(3))
        u, w = (brought([b - a for a, b in zip(here, place, strict=True)]) for place in (following, last))
        s, d = isqrt(dot(cross(u, w), cross(u, w))), dot(u, w)
        t = (s << 12) // max(1, s + abs(d))
        a = t + ((3 * t * (4096 - t) * (2 * t - 4096)) >> 27)
        weight = 8192 - a if d < 0 else a
        total = [sum_ + weight * component for sum_, component in zip(total, unit_of(normal(*triangles[f])), strict=True)]
    z = unit_of(brought(total)) if any(total) else [0, 0, 1 << 14]
    least = min(range(3), key=lambda k: abs(z[k]))
    x = unit_of(cross(z, [int(k == least) for k in range(3)]))
    return x, [component >> 14 for component in cross(z, x)], z


def decode_residuals(data, groups):
    """(i, j) of every group."""
    decoder, table = RangeDecoder(data), [(1 << 21, 1 << 21, 0)] * 165
    number_of = {corner: g for g, group in enumerate(groups) for corner in group}
    sizes, out = [], []

    def number(m, zero):
        if decoder.bit(table, 17 * m + zero) == 0:
            return 0
        negative, v = decoder.bypass(), 1
        while v <= 14 and decoder.bit(table, 17 * m + 3 + v - 1) == 1:
            v += 1
        if v == 15:
            k, rest = 0, 1
            while k < 12 and decoder.bit(table, 153 + k) == 1:
                k += 1
            for _ in range(k):
                rest = 2 * rest + decoder.bypass()
            v += rest - 1
        return -v if negative else v

    for g, group in enumerate(groups):
        near = [number_of.get((f, (i + turn) % 3), g) for f, i in group for turn in (1, 2)]
        known = [sizes[other] for other in near if other < g]
        m = min(7, (2 * sum(known) // len(known)).bit_length()) if known else 8
        i = number(m, 0)
        j = number(m, 2 if i else 1)
        sizes.append(abs(i) + abs(j))
        out.append((i, j))
    return out


def bent(axes, i, j, step):
    """The normal of a group."""
    p, q = i * step, j * step
    r = (p * p + q * q) >> 14
    weights = 2 * p, 2 * q, (1 << 14) - r
    return unit_of(brought([sum(weight * axis[k] for weight, axis in zip(weights, axes, strict=True)) for k in range(3)]))


def cross(u, v):
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def unit_of(vector):
    return [(component << 14) // max(1, isqrt(dot(vector, vector))) for component in vector]
