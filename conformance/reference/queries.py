"""Clauses 8.1, 8.2 and 11.2 in plain Python: what points ask of a decoded asset, in exact fractions.

Where a clause lets several answers pass, since centres or faces are equally near, all of them are given.
"""

import struct
from fractions import Fraction
from itertools import product
from math import floor, isqrt, lcm, nan

from conformance.reference.attributes import de_interleave
from conformance.reference.decoder import triangles_of_field, uv_rows
from conformance.reference.neural import position_of
from conformance.reference.syntax import TEXELS
from conformance.reference.texels import bilinear
from conformance.reference.voxels import clip

FAR = 10**6
EQUALLY_NEAR = Fraction(1, 2**20)  # of a voxel
FACES_EQUALLY_NEAR = Fraction(1, 2**14)  # of side


def lattice_point(point, header):
    """Clause 8.1: the lattice coordinates of a world point, without rounding; 0 where side is 0."""
    side, last = Fraction(header["side"]), 2 ** header["position_bits"] - 1
    return [(Fraction(p) - Fraction(o)) / side * last if side > 0 else Fraction(0)
            for p, o in zip(point, header["origin"], strict=True)]


def grid_point(lattice, position_bits, resolution):
    """Clause 8.1: the grid coordinates of a point given by its lattice coordinates."""
    return [p * resolution / 2**position_bits for p in lattice]


def root(square):
    """The square root of a fraction, rounded down to a multiple of 2^-60."""
    return Fraction(isqrt(floor(square * 2**120)), 2**60)


def dot(a, b):
    return sum(p * q for p, q in zip(a, b, strict=True))


def minus(a, b):
    return [p - q for p, q in zip(a, b, strict=True)]


def blend(weights, corners):
    """Sum of weight * corner, divided by the sum of the weights."""
    return [Fraction(dot(weights, column)) / sum(weights) for column in zip(*corners, strict=True)]


def whole(x):
    """(one, the coordinates times one as integers), which are quicker to count with than fractions."""
    one = lcm(*(Fraction(v).denominator for v in x))
    return one, [int(v * one) for v in x]


# Clause 8.2.1


def trilinear(x, cells):
    """The weighted mean of the cells whose centres surround x, None where none with a weight is active. cells: dict from voxel to
    components."""
    one, at = whole([v - Fraction(1, 2) for v in x])
    base, asked = [p // one for p in at], []
    for corner in product((0, 1), repeat=3):
        voxel, weight = tuple(b + d for b, d in zip(base, corner, strict=True)), 1
        for p, d in zip(at, corner, strict=True):
            weight *= p % one if d == 1 else one - p % one
        if weight > 0 and voxel in cells:
            asked.append((weight, cells[voxel]))
    return blend(*zip(*asked, strict=True)) if asked else None


def nearest(x, cells):
    """The values of all cells whose centres are as near to x as any, or as good as that."""
    one, at = whole([v - Fraction(1, 2) for v in x])
    away = {voxel: sum((v * one - p) ** 2 for v, p in zip(voxel, at, strict=True)) for voxel in cells}
    last = (root(min(away.values())) + EQUALLY_NEAR * one) ** 2
    return [cells[voxel] for voxel, square in away.items() if square <= last]


def voxel_answers(x, cells):
    """All answers at x, in the grid of the level at hand."""
    x = [clip(-FAR, FAR, v) for v in x]
    answer = trilinear(x, cells)
    return nearest(x, cells) if answer is None else [answer]


# Clause 8.2.2


def on_plane(point, corners):
    """Weights, in any unit, of the point of the face's plane that is nearest; None where the face has no area."""
    u, v, d = (minus(corner, corners[0]) for corner in (corners[1], corners[2], point))
    uu, uv, vv, ud, vd = dot(u, u), dot(u, v), dot(v, v), dot(u, d), dot(v, d)
    area, second, third = uu * vv - uv * uv, vv * ud - uv * vd, uu * vd - uv * ud
    return [area - second - third, second, third] if area > 0 else None


def on_edge(point, corners, a):
    """Weights, in any unit, of the point of the edge from corner a to the next that is nearest."""
    b, weights = (a + 1) % 3, [0, 0, 0]
    along = minus(corners[b], corners[a])
    length = dot(along, along)
    beyond = clip(0, length, dot(minus(point, corners[a]), along))
    weights[a], weights[b] = max(length, 1) - beyond, beyond
    return weights


def nearest_on_face(point, corners):
    """(squared distance, weights of the corners) of the point of the face that is nearest to the asked one."""
    one, point = whole(point)
    corners = [[p * one for p in corner] for corner in corners]
    weights = on_plane(point, corners)
    inside = weights is not None and min(weights) >= 0
    found = []
    for candidate in [weights] if inside else [on_edge(point, corners, a) for a in range(3)]:
        away = [dot(candidate, column) for column in zip(*(minus(corner, point) for corner in corners), strict=True)]
        found.append((Fraction(dot(away, away), (sum(candidate) * one) ** 2), candidate))
    return min(found, key=lambda pair: pair[0])


def texel_answer(lattice, face, field, cells, level):
    """The answer of a face (corners, UVs) to a point at lattice coordinates. field: as clause 5.5 names its elements."""
    _, weights = nearest_on_face(lattice, face[0])
    uv = [n / 2 ** field["uv_fraction_bits"] for n in blend(weights, face[1])]
    return bilinear(uv, field, cells, level)


# Clause 8.2


class Asked:
    """A decoded asset (decoder.decode) that points ask."""

    def __init__(self, texf):
        self.texf, self.header = texf, texf["header"]
        self.components = [group["components"] for group in self.header["channel_groups"]]
        self.cells = [{g: self.cells_of(field, g) for g in field["values"]} for field in texf["fields"]]
        self.faces = [self.faces_of(i, field) for i, field in enumerate(texf["fields"])]

    def level(self, field, group):
        """Clauses 8.2 and 8.3: the level of detail of a unit's values."""
        return max(field["left_out"], field["shifts"].get(group, 0))

    def cells_of(self, field, group):
        """Dict from a voxel, or a texel's column and row, of the values' level to their components."""
        further = self.level(field, group) - field["left_out"]
        keys, values = sorted({key >> 3 * further for key in field["keys"]}), field["values"][group]
        count, axes = self.components[group], 2 if field["support"] == TEXELS else 3
        return {de_interleave(key)[:axes]: list(values[count * n : count * n + count]) for n, key in enumerate(keys)}

    def faces_of(self, index, field):
        """(corners, UVs or None) of the faces of a field; of those over texels in the order of the rows of clause 9."""
        if field["support"] != TEXELS:
            return [(corners, None) for corners in triangles_of_field(self.texf["units"], index)]
        corners = [[row[at : at + 5] for at in (2, 7, 12)] for row in uv_rows(self.texf["units"], index)]
        return [([c[:3] for c in face], [c[3:] for c in face]) for face in corners]

    def nearest_faces(self, lattice):
        """(field, number of the face) of all faces that are as near as any, or as good as that."""
        last, found = 2 ** self.header["position_bits"] - 1, []
        for i, faces in enumerate(self.faces):
            found += [(root(nearest_on_face(lattice, corners)[0]), i, n) for n, (corners, _) in enumerate(faces)]
        least = min(found)[0]
        return [(i, n) for away, i, n in found if away <= least + max(FACES_EQUALLY_NEAR * last, least / 2**40)]

    def answers(self, field, triangle, point):
        """All answers to a point: of each, the components of all groups one after the other, None for those of a group that the
        field has no values of. field: -1 where no face is known; triangle: number of the face in a field over texels."""
        lattice = lattice_point(point, self.header)
        faces = [(field, triangle)] if field >= 0 else self.nearest_faces(lattice)
        if self.texf["neural"] is not None:
            position = position_of(point, self.header)
            return [[Fraction(v, 256) for v in self.texf["neural"].answer(i, position)] for i in sorted({i for i, _ in faces})]
        return [answer for i, n in faces for answer in self.of_face(i, n, lattice)]

    def of_face(self, index, triangle, lattice):
        """As answers(), of a field over voxels or a face over texels, without 3DNTC, at lattice coordinates."""
        field, options = self.texf["fields"][index], []
        for group, count in enumerate(self.components):
            cells, level = self.cells[index].get(group), self.level(field, group)
            if cells is None:
                options.append([[None] * count])
            elif field["support"] == TEXELS:
                options.append([texel_answer(lattice, self.faces[index][triangle], field["unit"], cells, level)])
            else:
                x = grid_point(lattice, self.header["position_bits"], field["unit"]["resolution"])
                options.append(voxel_answers([v / 2**level for v in x], cells))
        return [sum(parts, []) for parts in product(*options)]


def read_queries(data):
    """(field, triangle, point) of every 40 bytes."""
    return [(field, triangle, point) for field, triangle, *point in struct.iter_unpack("<2q3d", data)]


def answer_files(texf, queries):
    """File name -> bytes: by group, the first answer to every query, binary64; not a number where there is none."""
    asked, out = Asked(texf), {}
    found = [asked.answers(*query)[0] for query in queries]
    for group, count in enumerate(asked.components):
        first = sum(asked.components[:group])
        numbers = [nan if v is None else float(v) for answer in found for v in answer[first : first + count]]
        out[f"group{group}_answers"] = struct.pack(f"<{len(numbers)}d", *numbers)
    return out
