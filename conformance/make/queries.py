"""Queries of the conformance vectors (clauses 8.1, 8.2 and 11.2): points, and every answer to them that is right.

The answers are those of reference/queries.py, in exact fractions. A point counts only where the answers that the clauses let
pass are a few: so close to centres and borders that rounding decides, that is looked up by asking its neighbourhood as well.
"""

import json
import random
from fractions import Fraction
from itertools import islice, product
from math import floor

from conformance.reference import decoder
from conformance.reference.attributes import de_interleave
from conformance.reference.neural import position_of
from conformance.reference.queries import Asked, blend, grid_point, lattice_point, minus, nearest, on_plane, trilinear
from conformance.reference.syntax import TEXELS

TOLERANCE, SAME = 0.01, Fraction(1, 1000)  # the tolerance of clause 8.2; nearer than the other, two answers are one
DECIMALS = 6
# Levels of detail at which a vector is asked.
ASKED = {
    "subset/k3": (0, 1), "subset/k33": (0, 2, 12), "subset/alpha_blend": (0,), "subset/two_fields": (0, 2),
    "subset/texels_repeat": (0, 2), "subset/texels_alpha": (0, 1), "subset/neural_resident": (0, 1), "subset/neural_hash": (0,),
    "uncommon/one_voxel": (0, 1), "uncommon/mixed_resolutions": (0, 4), "uncommon/voxel_boundaries": (0,),
    "uncommon/point_triangle": (0, 1), "uncommon/huge_coordinates": (0,), "uncommon/tiny_coordinates": (0,),
    "uncommon/maps_shift_voxels": (0, 2), "uncommon/texels_one": (0,), "uncommon/texels_tall": (0, 2),
    "uncommon/texels_clamp": (0, 1), "uncommon/texels_mirror": (0, 1), "uncommon/texels_repeat_mirror": (0,),
    "uncommon/texels_parts": (0, 2), "uncommon/texels_flat": (0,), "uncommon/texels_mixed": (0, 3),
    "uncommon/texels_low": (0,), "uncommon/maps_shift_texels": (0, 2), "uncommon/neural_two_fields": (0,),
    "uncommon/maps_neural": (0,), "uncommon/neural_shortest_waves": (0,), "uncommon/queries_sheets": (0, 1),
    "uncommon/queries_no_side": (0,), "uncommon/maps_some": (0,),
    "uncommon/queries_by_a_hair": (0,), "uncommon/queries_folds": (0, 3), "uncommon/queries_line": (0,),
    "uncommon/queries_far": (0,), "uncommon/queries_narrow": (0,),
}


class Places:
    """Where a stream may be queried: points of the world, as the binary64 nearest to what was meant."""

    def __init__(self, source, seed):
        self.source, self.header, self.random = source, source.header, random.Random(seed)
        self.last, self.cells = 2 ** self.header["position_bits"] - 1, 2 ** self.header["position_bits"]

    def world(self, lattice):
        """The point at lattice coordinates."""
        side = Fraction(self.header["side"])
        return tuple(float(Fraction(o) + side * Fraction(p) / self.last)
                     for o, p in zip(self.header["origin"], lattice, strict=True))

    def of_grid(self, grid, resolution):
        """The point at grid coordinates."""
        return self.world([Fraction(v) * self.cells / resolution for v in grid])

    def weights(self):
        """Of a point well inside a face."""
        cuts = sorted(self.random.sample(range(3, 61), 2))
        return [Fraction(n, 64) for n in (cuts[0], cuts[1] - cuts[0], 64 - cuts[1])]

    def some(self, things, count):
        return self.random.sample(things, min(count, len(things)))


# Candidates: (why, how many are wanted, (field, triangle, point), as many as there are).


def of_voxels(places, index):
    """Points that ask a field over voxels."""
    field, faces = places.source.texf["fields"][index], places.source.faces[index]
    size, scale = field["unit"]["resolution"], 1 << field["left_out"]
    cells, rng = places.source.cells[index][0], places.random
    at = lambda x: (index, 0, places.of_grid([v * scale for v in x], size))
    wide = -(-size // scale)
    raster = [[Fraction(rng.randrange(-3, 2 * wide + 4), 2) for _ in range(3)] for _ in range(100)]
    on_faces = lambda count: [places.world(blend(places.weights(), face[0])) for face in places.some(faces, count)]
    alone = [x for x in raster if trilinear(x, cells) is None]
    ties = (x for x in alone if len(nearest(x, cells)) > 1)
    return [
        ("the centre of a voxel", 3, [at([v + Fraction(1, 2) for v in voxel]) for voxel in places.some(sorted(cells), 3)]),
        *((f"midway between {2**n} centres", 3, [at(x) for x in midways(places, cells, n)]) for n in (1, 2, 3)),
        ("on the surface", 8, [(index, 0, point) for point in on_faces(8)]),
        ("a corner of a face", 2, [(index, 0, places.world(face[0][0])) for face in places.some(faces, 2)]),
        ("as near to several centres", 3, map(at, ties)),
        ("beside the surface", 3, [at([v + Fraction(3, 16) for v in x]) for x in alone[:30]]),
        ("a corner of the grid", 2, [at([0, 0, 0]), at([wide, wide, wide])]),
        ("far outside", 4, [at([v * wide for v in x]) for x in ((-5, 1, 9), (900, -700, 33), (2e4, 1e4, 0), (-1, 3, 1e4))]),
        ("further than 10^6 voxels", 2, [at([v * wide for v in x]) for x in ((3e9, -1e8, 2), (1e7, 2e7, 3e7))]),
    ]


def midways(places, cells, axes):
    """Points midway between the centres of 2**axes voxels, those with most of them active first."""
    middles = []
    for voxel in places.some(sorted(cells), 40):
        move = places.some([0, 1, 2], axes)
        shift = [int(axis in move) for axis in range(3)]
        around = list(product(*[range(d + 1) for d in shift]))
        active = sum(tuple(v + d for v, d in zip(voxel, corner, strict=True)) in cells for corner in around)
        middles.append((-active, [v + Fraction(1 + d, 2) for v, d in zip(voxel, shift, strict=True)]))
    return [x for _, x in sorted(middles, key=lambda pair: pair[0])]


def of_texels(places, index):
    """Points that ask a face of a field over texels."""
    unit, faces = places.source.texf["fields"][index]["unit"], places.source.faces[index]
    texel, sizes = 1 << unit["uv_fraction_bits"], (unit["width"], unit["height"])
    flat = {n for n, (_, uv) in enumerate(faces) if (uv[1][0] - uv[0][0]) * (uv[2][1] - uv[0][1]) ==
            (uv[1][1] - uv[0][1]) * (uv[2][0] - uv[0][0])}
    solid = [n for n, (corners, _) in enumerate(faces) if on_plane(corners[0], corners) is not None]
    at = lambda n, weights: (index, n, places.world(blend(weights, faces[n][0])))
    some = lambda count: places.some(solid, count)
    crossing = lambda step, shift: [at(n, w) for n in some(24) for axis in (0, 1)
                                    if (w := places_on(places, faces[n][1], axis, step(axis) * texel, shift * texel)) is not None]
    return [
        ("on a face", 8, [at(n, places.weights()) for n in some(8)]),
        ("on a face whose UVs have no area", 6, [at(n, places.weights()) for n in solid if n in flat for _ in range(3)]),
        ("a corner of a face", 3, [at(n, [0, 1, 0]) for n in some(3)]),
        ("on an edge of a face", 3, [at(n, [Fraction(5, 16), 0, Fraction(11, 16)]) for n in some(3)]),
        ("a border of texels", 5, crossing(lambda axis: 1, Fraction(0))),
        ("a line of centres of texels", 5, crossing(lambda axis: 1, Fraction(1, 2))),
        ("the border of the image", 6, crossing(lambda axis: sizes[axis], Fraction(0))),
        ("just inside the border of the image", 4, crossing(lambda axis: sizes[axis], Fraction(-1, 4))),
        ("just beyond the border of the image", 4, crossing(lambda axis: sizes[axis], Fraction(1, 4))),
        ("above a face", 3, [(index, n, places.world(above(faces[n][0], places.weights(), 1))) for n in some(3)]),
        ("beyond an edge of a face", 3, [at(n, [Fraction(3, 2), Fraction(1, 4), Fraction(-3, 4)]) for n in some(3)]),
        ("far from its face", 2, [(index, n, places.world(above(faces[n][0], places.weights(), 400))) for n in some(2)]),
    ]


def places_on(places, uv, axis, step, shift):
    """Weights of a point of a face where a UV is a multiple of step, plus shift; None where there is none."""
    third = Fraction(places.random.randrange(1, 16), 32)
    begin, end = ((1 - third) * uv[c][axis] + third * uv[2][axis] for c in (0, 1))
    first, last = -((shift - min(begin, end)) // step), floor((max(begin, end) - shift) / step)
    if begin == end or last < first:
        return None
    share = (places.random.randint(first, last) * step + shift - begin) / (end - begin)
    return [(1 - third) * (1 - share), (1 - third) * share, third]


def above(corners, weights, steps):
    """Lattice coordinates beside a point of a face, along its normal, in shares of its longest edge."""
    (ux, uy, uz), (vx, vy, vz) = (minus(corner, corners[0]) for corner in corners[1:])
    normal = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx]
    size = Fraction(max(map(abs, normal)), max(map(abs, (ux, uy, uz, vx, vy, vz))))
    return [p + steps * n / size for p, n in zip(blend(weights, corners), normal, strict=True)]


def of_networks(places, index):
    """Points that ask a field of a 3DNTC stream."""
    field, faces, rng = places.source.texf["fields"][index], places.source.faces[index], places.random
    size = field["unit"]["resolution"]
    voxels = [de_interleave(key) for key in field["keys"]]
    centres = [places.of_grid([Fraction(2 * v + 1, 2) * 2 ** field["left_out"] for v in voxel], size)
               for voxel in places.some(voxels, 3)]
    corners = [places.world(corner) for face in places.some(faces, 200) for corner in face[0]]
    outside = [(-1, 3, 1), (9, Fraction(1, 3), -2), (1, 1, 1), (Fraction(1, 2), 2**40, 0)]
    named = lambda points: ((index, 0, point) for point in points)
    decides = lambda point: order_decides(places.source.texf["neural"], index, point, places.header)
    return [
        ("the centre of a voxel", 3, named(centres)),
        ("on the surface", 5, named(places.world(blend(places.weights(), face[0])) for face in places.some(faces, 5))),
        ("where the order of 8.1 decides", 3, named(filter(decides, corners))),
        ("anywhere", 4, named(places.world([rng.randrange(places.cells) for _ in range(3)]) for _ in range(4))),
        ("outside", 4, named(places.world([Fraction(v) * places.last for v in x]) for x in outside)),
    ]


def order_decides(neural, index, point, header):
    """Whether binary64 and exact arithmetic give other positions (11.2), and these other answers."""
    exact = [floor(v) for v in grid_point(lattice_point(point, header), header["position_bits"], 2**24)]
    both = position_of(point, header), tuple(min(max(v, 0), 2**24 - 1) for v in exact)
    return both[0] != both[1] and neural.answer(index, both[0]) != neural.answer(index, both[1])


def of_no_side(places):
    """Points that ask faces of the only field of a stream whose side is 0, which are all one point of its lattice."""
    origin, (faces,) = places.header["origin"], places.source.faces
    count = len(faces)
    at = lambda n, *by: (0, n, tuple(o + d for o, d in zip(origin, by, strict=True)))
    return [
        ("the origin, side 0", 2, [at(n, 0, 0, 0) for n in range(count)]),
        ("beside the origin, side 0", 3, [at(n, 1, -2.5, 0.25) for n in range(count)]),
    ]


def by_a_hair(places):
    """Points of borders.far_from_small(), whose world is its lattice: nearer to one sheet by as much as 8.2 lets
    pass, or by a little more, and nearer to a sheet than to a small face."""
    most = Fraction(places.last, 2**14)
    between = lambda nearer: (-1, 0, (311.0, 207.0, float(300 - nearer * most / 2)))
    step = 1 + Fraction(1, 2 * places.last)  # half of what a side of 2**position_bits would make of it
    return [
        ("nearer to one by as much as passes", 1, [between(1 - Fraction(1, 2**20))]),
        ("nearer to one by a little more", 2, [between(step), between(-step)]),
        ("nearer to a sheet than to a small face", 4, [(-1, 0, (x, 0.0, z)) for x in (0.0, 1.0) for z in (45.0, 49.0)]),
    ]


def near_a_line(places):
    """Points of misread.without_area(), whose world is its lattice, whose nearest face is a line."""
    at = lambda *points: [(-1, 0, tuple(map(float, point))) for point in points]
    return [
        ("nearest to a face without area", 3, at((250, 161, 290), (520, 200, 290), (90, 60, 290))),
        ("beyond an end of a face without area", 2, at((740, 290, 350), (20, 50, 350))),
        ("nearer to a sheet than to a line", 1, at((250, 150, 40))),
    ]


def far_away(places):
    """Points of rules.far_from_small(), whose world is its lattice, so far that 2^-40 of the least distance decides."""
    above = lambda share: [(-1, 0, (311.0, 207.0, 600 + share * 600 * 2.0**40))]
    return [("nearer to one by less than passes so far", 1, above(1.25)), ("nearer to one by more than passes", 1, above(0.8))]


OF_THEIR_OWN = {"uncommon/queries_far": far_away, "uncommon/queries_by_a_hair": by_a_hair, "uncommon/queries_no_side": of_no_side,
                "uncommon/queries_line": near_a_line}


def of_nobody(places):
    """Points of which no face is known."""
    every, half = [face for faces in places.source.faces for face in faces], Fraction(1, 2)
    some = lambda count: places.some(every, count)
    on_face = lambda face: (-1, 0, places.world(blend(places.weights(), face[0])))
    between = [[(a + b) / Fraction(2) for a, b in zip(first[0][0], other[0][0], strict=True)] for first, other in
               zip(some(3), some(3), strict=False)]
    return [
        ("on the surface, no face known", 4, [on_face(face) for face in some(4)]),
        ("on an edge, no face known", 3, [(-1, 0, places.world(blend([half, half, 0], face[0]))) for face in some(3)]),
        ("between faces, no face known", 3, [(-1, 0, places.world(point)) for point in between]),
        ("far outside, no face known", 1, [(-1, 0, places.world([places.last * v for v in (40, -7, 3)]))]),
    ]


# Answers


def near(first, other):
    """Whether two answers are one."""
    return all(a is b is None or (a is not None and b is not None and abs(a - b) <= SAME)
               for a, b in zip(first, other, strict=True))


def settled(source, field, triangle, point):
    """All answers that are right; None where they are too many to be named."""
    right_answers = source.answers(field, triangle, point)
    if source.texf["neural"] is not None:
        return right_answers
    lattice, cells = lattice_point(point, source.header), 2 ** source.header["position_bits"]
    faces = [(field, triangle)] if field >= 0 else source.nearest_faces(lattice)
    beside = []
    for index, number in faces:
        part = source.texf["fields"][index]
        away = Fraction(1, 2**24) if part["support"] == TEXELS else Fraction(cells, part["unit"]["resolution"] << 20)
        moved = lambda by, away=away: [p + d * away for p, d in zip(lattice, by, strict=True)]
        right_answers += [a for by in product((-1, 0, 1), repeat=3) for a in source.of_face(index, number, moved(by))]
        beside += [a for s in product((-1, 1), repeat=3) for a in source.of_face(
            index, number, moved([s[0] * Fraction(1, 4), s[1] * Fraction(2, 3), s[2] * Fraction(1, 7)]))]
    out = []
    for answer in right_answers:
        if not any(near(answer, other) for other in out):
            out.append(answer)
    return out if len(out) <= 8 and all(any(near(answer, other) for other in out) for answer in beside) else None


def candidates(places, name):
    """Those of all fields, and without a face; or those that a vector has of its own."""
    source, out = places.source, []
    if name in OF_THEIR_OWN:
        return OF_THEIR_OWN[name](places)
    for index, field in enumerate(source.texf["fields"]):
        kind = of_networks if source.texf["neural"] is not None else of_texels if field["support"] == TEXELS else of_voxels
        out += kind(places, index)
    return out + of_nobody(places)


def queries_at(vector, lod, seed):
    """Queries of a vector's stream at one level of detail, as queries.json has them."""
    source, out = Asked(decoder.decode(vector.data, lod)), []
    for why, wanted, questions in candidates(Places(source, seed), vector.name):
        known = ((question, answers) for question in questions if (answers := settled(source, *question)) is not None)
        for (field, triangle, point), answers in islice(known, wanted):
            rounded = [[None if v is None else round(float(v), DECIMALS + 2) for v in answer] for answer in answers]
            out.append({"why": why, "field": field, "triangle": triangle, "point": [p.hex() for p in point],
                        "answers": rounded})
    return source, out


def queries_file(vector):
    """Content of queries.json, None where a vector is not asked."""
    if vector.name not in ASKED:
        return None
    by_lod = {lod: queries_at(vector, lod, n) for n, lod in enumerate(ASKED[vector.name])}
    (source, _), *_ = by_lod.values()
    tolerance = 0 if source.texf["neural"] is not None else TOLERANCE + 10**-DECIMALS
    lods = ",\n".join(f' "{lod}": [\n' + ",\n".join(f"  {json.dumps(q)}" for q in queries) + "\n ]"
                      for lod, (_, queries) in by_lod.items())
    head = f'{{"components": {json.dumps(source.components)}, "tolerance": {tolerance}, "lods": {{\n'
    return (head + lods + "\n}}\n").encode()
