"""Conformance vectors for single rules, and for the borders of rules, that no other vector holds, as mutants of the reference
decoder have shown: the number that a rule still takes, and the one that it does not take any more.

Probabilities at their ends take many symbols alike, and a sample on a border takes corners that were searched for.
"""

import struct
import zlib
from itertools import combinations

import numpy as np

from conformance.make.faulty import slices_from
from conformance.make.good import (
    empty,
    encoded,
    of_triangles,
    parsed,
    recoded,
    scene_of,
    stream_of,
    torus,
    units_of,
    with_codeword,
    written,
)
from conformance.make.materials import painted
from conformance.make.normals import MARKED_BY_AREA, marked
from conformance.make.texels import CLAMPED, Grid, Image, Patch, picture, ring, sheet, stream_of_parts
from texfcodec.bitstream.values import material_values
from texfcodec.codecs.base import Group
from texfcodec.geometry.edges import FOLDS, NORMAL_BITS, NUM_FOLDS
from texfcodec.scene.channels import BASE_COLOUR, CHANNELS, PARAMETERS, group_values

GREY = [Group((BASE_COLOUR,), True)]
LAST = (1 << 20) - 1
SPAN = [(0, LAST, 0), (LAST, LAST, LAST), (LAST, 0, LAST)]  # a triangle from end to end of the lattice


def spotted(size, every):
    """A picture of one colour, uint8 [H, W, 3], with spots of three greys that are so many texels apart."""
    out = np.full((size[1] * size[0], 3), 90, np.uint8)
    place = np.arange(0, len(out), every)
    out[place] = np.array([20, 240, 130], np.uint8)[place % 3, None]
    return out.reshape(size[1], size[0], 3)


def nearly_flat(size, every):
    """A picture of 90, uint8 [H, W, 3], with spots of 91: too little for their neighbours to expect anything of it."""
    out = np.full((size[1] * size[0], 3), 90, np.uint8)
    out[every // 2 :: every] = 91
    return out.reshape(size[1], size[0], 3)


def grainy(size):
    """Noise of 90 to 92, uint8 [H, W, 3]: slopes so small that the rounding of a mean tells."""
    return np.random.default_rng(7).integers(90, 93, (size[1], size[0], 3)).astype(np.uint8)


def two_values(size, every):
    """Noise of 0 and 255, uint8 [H, W, 3], with spots of 249 that are so many texels apart."""
    out = np.random.default_rng(5).choice(np.array([0, 255], np.uint8), (size[1] * size[0], 1)).repeat(3, 1)
    out[::every] = 249
    return out.reshape(size[1], size[0], 3)


def surprising():
    """A picture, uint8 [64, 64, 3], of blocks of 2 x 2 whose three coefficients differ in their signs alone, but for a few that
    are larger, and one block without any: each comes as a surprise when all models are as sure as they can be."""
    signs = np.random.default_rng(1).choice((-1.0, 1.0), (1024, 3))
    signs[65::131, 0] *= 2.6
    signs[500] = 0
    waves = np.array([[[1, 1, 1], [1, -1, -1]], [[-1, 1, -1], [-1, -1, 1]]])
    out = np.einsum("ijk,abk->iajb", signs.reshape(32, 32, 3), waves).reshape(64, 64, 1)
    return (128 + 15 * out).repeat(3, 2).astype(np.uint8)


def on_ring(image, **more):
    """A stream of an image on a ring."""
    return stream_of_parts([Image(image)], [ring(image.shape[1::-1])], **more)


def rounded_twice():
    """B = 20, K = 16: a triangle one of whose samples would lie in another voxel if half (6.3) were rounded once, and one that
    spans the cube."""
    return of_triangles([(164262, 262144, 418757), (39672, 262146, 478751), (161712, 262143, 458756), *SPAN], area_threshold=0)


def beside_clamped():
    """On a clamped image a face that asks a quarter of it, by corners so far beside that they ask half of that once they are
    clamped, and one of which nothing but what stands beside the image is asked."""
    uv = 16 * np.array([(8, 8), (40, 8), (8, 40), (40, 2), (60, 2), (60, 3)])
    return stream_of_parts([Image(picture(16, 16), CLAMPED)], [sheet(uv)])


def sheets():
    """Two sheets over texels one above the other, and between them, nearer to the first, one over voxels that touches it."""
    texel = 16
    first = sheet([(0, 0), (9 * texel, 8), (9 * texel, 7 * texel), (0, 0), (9 * texel, 7 * texel), (-3 * texel, 6 * texel)])
    second = sheet([(5, 5), (8 * texel, 9), (7 * texel, 6 * texel), (5, 5), (7 * texel, 6 * texel), (9, 5 * texel)], field=2)
    between = sheet(np.zeros((6, 2)), field=1)
    second.lattice = second.lattice + [0, 0, 600]
    between.lattice, between.uv = between.lattice + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 80], [0, 0, 80]]), None
    fields = [Image(picture(9, 7), CLAMPED), Grid(7), Image(picture(8, 6, seed=3))]
    return stream_of_parts(fields, [first, between, second])


def by_a_hair():
    """B = 20, K = 16: in a voxel each, triangles whose area weight is exactly area_threshold, and one or two below it, so that an
    area (6.2) that is rounded otherwise tells. The largest component of the last one's cross product is 2^30."""
    voxel = np.array([1 << 16, 0, 0])
    corners = np.array([[(131272, 138624, 131272), (146629, 131272, 188154), (132652, 147512, 195493)],
                        [(131272, 131272, 131272), (155443, 134752, 133374), (161327, 158117, 184365)] + 3 * voxel,
                        [(131272, 131272, 133284), (191013, 147823, 131272), (146763, 153537, 145585)] + 6 * voxel, SPAN])
    return of_triangles(corners, area_threshold=40)


def a_quarter_off():
    """UVs whose floats stand a quarter beside their numbers, as far as 5.6.2 lets them: above in u, below in v."""
    uv = [(0, 0), (255, 7), (250, 200), (0, 0), (250, 200), (3, 255)]
    return beginning_at(stream_of_parts([Image(picture(9, 7))], [sheet(uv, bits=8)]), (0.25, -0.25))


def beginning_at(data, least):
    """The stream whose only geometry unit's floats are larger by two numbers, which Draco adds to what it has quantised."""
    stream = parsed(data)
    (unit,) = stream.geometry
    as_coded = lambda begin: struct.pack("<3fB", *begin, unit["uv_range"], unit["uv_bits"])
    assert bytes(unit["draco_data"]).count(as_coded((0, 0))) == 1
    unit["draco_data"] = bytes(unit["draco_data"]).replace(as_coded((0, 0)), as_coded(least))
    return written(stream)


def on_a_bound():
    """A codeword whose first number is the bound of its first bit, which is a zero then (7.6.2)."""
    noise = np.random.default_rng(13).integers(0, 256, 300, np.uint8).tobytes()
    small = recoded(encoded(scene_of(*torus(12, 6)), resolution=8, qp=46))
    return with_codeword(small, (65535 * 32768).to_bytes(4, "big") + noise, [40, 50, 30])


def payload_of(kind, crc):
    """A payload of four bytes with which the checksum of a unit of a type is crc."""
    register = crc ^ 0xFFFFFFFF
    for _ in range(32):  # backwards, bit by bit
        register = (register ^ 0xEDB88320) << 1 | 1 if register >> 31 else register << 1
    return (register ^ zlib.crc32(bytes([kind, 4])) ^ 0xFFFFFFFF).to_bytes(4, "little")


def checksums_at_their_ends():
    """Unknown units whose checksums are the least and the largest."""
    units = units_of(encoded(scene_of(*torus(12, 6)), resolution=6, qp=46))
    return stream_of([*units[:-1], (200, payload_of(200, 0)), (201, payload_of(201, 0xFFFFFFFF)), units[-1]])


def long_numbers():
    """The numbers of the level index as large as they can be; no decoder needs them."""
    stream = parsed(recoded(encoded(scene_of(*torus(12, 6)), resolution=6, qp=46), index=True))
    for codeword in stream.attributes[0]["codewords"]:
        codeword["level_bytes"] = [(1 << 56) - 1] * len(codeword["level_bytes"])
    return written(stream)


def of_nothing(materials, **header):
    """An empty mesh with materials, which no face has."""
    stream = parsed(empty())
    stream.materials = [material_values(material) for material in materials]
    stream.header.update(num_materials=len(materials), **header)
    return written(stream)


def beside_defaults():
    """Materials whose parameters have a value that is by one more, or by one less, than its default."""
    beside = lambda values, at, by: tuple(v + by * (i == min(at, len(values) - 1)) for i, v in enumerate(values))
    return of_nothing([painted(**{p.name: beside(p.default, at, by) for p in PARAMETERS if np.isfinite(p.default).all()})
                       for at in range(3) for by in (1, -1)])


def every_group():
    """A group for every channel, which no field asks for."""
    groups = [group_values(*Group((channel,))) for channel in CHANNELS]
    return of_nothing([painted(specular_colour=(1.0, 0.5, 1.0))], num_channel_groups=len(groups), channel_groups=groups)


def far_from_small():
    """Sheets at z 0 and 600 in two fields, and a face with edges of one step of the lattice at z 100, all flat; a world point is
    its lattice position."""
    flat = lambda z, size, **more: Patch(np.array([[0, 0, z], [size, 0, z], [0, size, z]]), np.array([[0, 1, 2]]), **more)
    patches = [flat(0, 1000), flat(600, 1000, field=1), flat(100, 1, field=2)]
    stream = parsed(stream_of_parts([Grid(4), Grid(4, (200, 30, 60)), Grid(4, (10, 20, 220))], patches))
    stream.header.update(origin=[0.0, 0.0, 0.0], side=float((1 << stream.header["position_bits"]) - 1))
    return written(stream)


def slanted():
    """Eight slanted triangles of UVs, so far apart that no texel is asked by two; on faces that share no corner."""
    random = np.random.default_rng(5)
    corners = random.integers(3 * 16, 9 * 16, (8, 3, 2)) + 12 * 16 * np.stack([np.arange(8) % 4, np.arange(8) // 4], 1)[:, None]
    lattice = np.array([[0, 0, 0], [100, 0, 10], [0, 90, 30]]) + 120 * np.arange(8)[:, None, None]
    faces = Patch(lattice.reshape(-1, 3), np.arange(24).reshape(8, 3), corners)
    return stream_of_parts([Image(picture(48, 24), CLAMPED)], [faces])


def without_side():
    """A surface of a few steps of the lattice, all of which is in one point of the world. A point of its first edge is nearest
    to the lattice's 0."""
    small = sheet([(0, 0), (9 * 16, 8), (8 * 16, 7 * 16), (0, 0), (8 * 16, 7 * 16), (3, 6 * 16)])
    small.lattice = np.array([[0, 6, 4], [10, 0, 4], [12, 12, 4], [2, 14, 9]])
    stream = parsed(stream_of_parts([Image(picture(9, 7))], [small]))
    stream.header["side"] = 0.0
    return written(stream)


def of_many_faces():
    """So many faces that Draco takes its other traversal of the mesh."""
    return encoded(scene_of(*torus(42, 12)), resolution=6, qp=46)


def at_the_steps(step, back):
    """Tips of three hinges, int64 [3, 2, 2], whose q of 8.4.2 is a step, or with back one that they are folded back beyond; first
    those that another rounding of q would move."""
    tips = np.stack(np.meshgrid(np.arange(-24, 25), np.arange(1, 25)), -1).reshape(-1, 2)
    large = tips << (NORMAL_BITS - np.frexp(np.abs(tips).max(1))[1])[:, None]
    dot, square = large @ large.T, (large * large).sum(1)
    lengths = square[:, None] * square
    are_near = (dot * dot // (lengths >> 12) == step) & ((dot < 0) == back)
    a, b = np.nonzero(are_near)
    order = np.argsort(dot[a, b] ** 2 // -(-lengths[a, b] >> 12) == step, kind="stable")[:3]
    return np.stack([tips[a[order]], tips[b[order]]], 1)


def hinges():
    """Pairs of faces that fold at each step of 8.4.2 and just beyond it; pairs of which one face has no area; rows of faces on
    one edge; seven places all of which are joined to each other. The last rows' faces have a material of their own."""
    folded = [at_the_steps(step - less, back) for step in FOLDS for less in (0, 1) for back in (False, True)]
    flat = np.array([[[0, 0], [5, 1]], [[7, 3], [0, 0]]])
    rows = [np.stack([np.arange(count), 9 - np.arange(count)], 1) * 3 + 1 for count in (2, 3, 4, 5, 6, 7, 8, 9, 3, 4)]
    patches, places = [], np.random.default_rng(2).permutation(256)
    groups = [*(pair for pairs in folded for pair in pairs), *np.repeat(flat, 4, axis=0), *rows]
    for number, group in enumerate(groups):
        base = np.array([places[number] % 16 * 62 + 30, places[number] // 16 * 62 + 30, 7 * number % 100])
        long = 2 if number < len(groups) - len(rows) else 900
        tips = [base + [x, y, long // 2] for x, y in group]
        patches.append((np.array([base, base + [0, 0, long], *tips]), [(0, 1, 2 + i) for i in range(len(tips))]))
    for n in range(3):  # an angle of exactly 60 degrees, whose odd normals another rounding of q would move
        hinge = np.array([(0, 0, 0), (93, -93, -93), (-45, 45, -46), (45, 46, -45)])
        patches.append((hinge + [500, 500, 600 + 100 * n], [(0, 1, 2), (0, 1, 3)]))
    whole = np.random.default_rng(4).integers(0, 62, (7, 3)) + [930, 930, 900]
    patches.append((whole, list(combinations(range(7), 3))))
    starts = np.cumsum([0] + [len(lattice) for lattice, _ in patches])
    faces = [np.array(patch_faces) + start for (_, patch_faces), start in zip(patches, starts[:-1], strict=True)]
    lattice, unmarked = np.concatenate([lattice for lattice, _ in patches]), len(groups) - 2
    parts = [Patch(lattice, np.concatenate(faces[:unmarked] + faces[len(groups) :])),
             Patch(lattice, np.concatenate(faces[unmarked : len(groups)]), material=1)]
    share = np.where(np.arange(NUM_FOLDS) % 2, 0.9, 0.1)
    return marked(stream_of_parts([Grid(4)], parts, materials=2), [(MARKED_BY_AREA, 180), (MARKED_BY_AREA - 1, 45)], share)


def uncommon():
    """All of them."""
    noise = np.random.default_rng(3).integers(0, 256, (14, 20, 3)).astype(np.uint8)
    return [
        ("rules_quiet", ["a planar support", ("{} models", 8), "one colour but for a few spots"], ("7.5.5", "7.6.3"),
         on_ring(spotted((64, 48), 211), qp=20, models=8), (0,)),
        ("rules_slopes", ["a planar support", ("{} models", 8)], ("7.5.5",),
         on_ring(grainy((64, 48)), qp=4, models=8), (0,)),
        ("rules_zeros", [("grey {}", "base_colour"), "lossless", "one colour but for a few spots"], ("7.6.4", "7.9"),
         on_ring(nearly_flat((128, 96), 331), groups=GREY, qp=63, models=6, max_error=0), (0,)),
        ("rules_ones", [("grey {}", "base_colour"), "lossless", "two values but for a few spots"], ("7.6.4", "7.9"),
         on_ring(two_values((48, 32), 97), groups=GREY, qp=63, models=6, max_error=0), (0,)),
        ("rules_surprises", [("an image of {} x {}", 64, 64), ("wrap {}", "repeat"), ("{} models", 8)], ("7.6.4",),
         on_ring(surprising(), qp=36, models=8), (0,)),
        ("rules_borders", ["DCT blocks", ("grey {}", "base_colour")], ("7.11.4",),
         on_ring(picture(96, 64, noise=20), groups=GREY, qp=40, models=8, dct_blocks=1, planar_transform=1), (0,)),
        ("rules_rotated", [("grey {}", "base_colour"), "rotated splits", ("{} models", 8)], ("7.11.1",),
         on_ring(picture(48, 40, noise=8, seed=6), groups=GREY, qp=5, models=8, planar_transform=1), (0,)),
        ("rules_shares", ["DCT blocks", ("grey {}", "base_colour")], ("7.11.4",),
         on_ring(picture(48, 40, noise=8, seed=2), groups=GREY, qp=2, models=8, dct_blocks=1, planar_transform=1), (0,)),
        ("rules_few_models", ["DCT blocks", "lossless", ("{} models", 2)], ("7.9", "7.11.4"),
         on_ring(picture(32, 24, noise=20), qp=40, models=2, max_error=0, dct_blocks=1, planar_transform=1), (0,)),
        ("rules_clamped", [("an image of {} x {}", 16, 16), ("wrap {}", "clamp"), "UVs beside the image"], ("6.5.3",),
         beside_clamped(), (0,)),
        ("rules_leads",
         [("an image of {} x {}", 20, 14), ("wrap {}", "repeat"), ("noise with errors of at most {} from a coarse field", 0)],
         ("7.9",), on_ring(noise, qp=44, models=6, max_error=0), (0,)),
        ("rules_half", [("B = {}", 20), ("K = {}", 16), "a sample that one rounding would move"], ("6.3",), rounded_twice(),
         (0,)),
        ("queries_sheets", ["two fields over texels", "one over voxels"], ("8.2", "8.2.1", "8.2.2"), sheets(), (0, 1)),
        ("rules_hair", [("B = {}", 20), ("K = {}", 16), "area weights exactly at area_threshold and just below it"],
         ("6.2", "6.4"), by_a_hair(), (0,)),
        ("rules_quarter", [("an image of {} x {}", 9, 7), ("wrap {}", "repeat"), ("UVs quantised to {} bits", 8),
          "floats a quarter beside their numbers"], ("5.6.2",), a_quarter_off(), (0,)),
        ("rules_bound", ["a codeword that begins with the bound of its first bit", "then random bytes"], ("7.6.2",), on_a_bound(),
         (0, 1)),
        ("rules_loose",
         [("an image of {} x {}", 20, 14), ("wrap {}", "repeat"), ("noise with errors of at most {} from a coarse field", 127)],
         ("5.7.1", "7.9"), on_ring(noise, qp=60, models=6, max_error=127), (0,)),
        ("rules_checksums", ["unknown ancillary units", "checksums of 0 and of 2^32 - 1"], ("5.2",), checksums_at_their_ends(),
         (0,)),
        ("rules_long_numbers", ["the level index without slices", "numbers of eight bytes"], ("4.3", "5.7.2"), long_numbers(),
         (0, 1)),
        ("rules_folds",
         ["marks of sharp edges", "folds on both sides of every step", "many classes of folds", "an edge of nine faces"],
         ("8.4.2",), hinges(), (0,)),
        ("rules_slice_level", [("an image of {} x {}", 9000, 1), ("wrap {}", "repeat"), ("slices from level {} on", 12)],
         ("5.7.1", "7.2"), slices_from(12), (0, 1, 2)),
        ("rules_defaults", ["an empty mesh", "parameters one more and one less than their defaults"], ("5.4.2",),
         beside_defaults(), (0,)),
        ("rules_groups", ["an empty mesh", ("{} channel groups", 23), ("a material with {} alone", "specular_colour")],
         ("5.3", "5.3.1"), every_group(), (0,)),
        ("rules_one_level", [("an image of {} x {}", 2, 2), ("wrap {}", "repeat"), "lossless"], ("7.9",),
         on_ring(noise[:2, :2], qp=60, models=6, max_error=0), (0,)),
        ("rules_valence", [("a Draco mesh of traversal type {}", 2)], ("5.6",), of_many_faces(), (0,)),
        ("rules_slanted", [("an image of {} x {}", 48, 24), ("wrap {}", "clamp"), ("{} faces that share no corner", 8)],
         ("6.5.2",), slanted(), (0, 1)),
        ("queries_by_a_hair", ["two sheets and a face of one step", "each in a field of its own"], ("8.2",), far_from_small(),
         (0,)),
        ("queries_no_side", [("an image of {} x {}", 9, 7), ("wrap {}", "repeat"), ("side {}", 0)], ("8.1", "8.2.2"),
         without_side(), (0,)),
    ]
