"""Conformance vectors for rules that a careful reader may take otherwise without a difference in any other vector: each was
written against such a reading, made of the reference decoder.
"""

from unittest.mock import patch

import numpy as np

from conformance.make.filter import filtered
from conformance.make.good import encoded, of_triangles, parsed, recoded, with_checksum, with_codeword, written
from conformance.make.materials import groups, over_texels, painted
from conformance.make.normals import CODED, marked, narrow
from conformance.make.planar import DCT, drawn_stage, two_corners
from conformance.make.rules import SPAN, beginning_at, far_from_small, of_nothing, on_ring
from conformance.make.scenes import noise_sheet, scene_of, torus
from conformance.make.texels import BITS, CLAMPED, MIRRORED, Grid, Image, Patch, picture, ring, sheet, stream_of_parts
from conformance.reference import attributes
from conformance.reference.bits import units_of
from conformance.reference.syntax import read_stream
from texfcodec import decode
from texfcodec.errors import StreamError
from texfcodec.geometry.draco import UvCoding, dec_textured
from texfcodec.scene.scene import Material

# uv_range, and by how much all u are off: less than a quarter of a step in binary64 and more in binary32 (5.6.2), and vice versa.
NEARER, FURTHER = (414924, -0.09416219592094421), (874407, -0.20682688057422638)
NAMES = ("\0\x1f\x7f", "\x80\u07ff\u0800\ud7ff\ue000\ufffe\uffff", "\U00010000\U0010ffff", "\ufeff../\\")
GREYS = "sheen_colour", "diffuse_transmission_colour"


class Dictated(attributes.RangeDecoder):
    """A range decoder without a codeword: every bit is a zero unless the share of ones is above `likely` thirds, but for
    some, by their numbers, which are ones."""

    def __init__(self, ones=(), likely=2):
        self.ones, self.likely, self.count, self.low, self.range, self.size = ones, likely, 0, 0, 2**32 - 1, 4

    def split(self, bound):
        bit = int(self.count in self.ones or 3 * bound > self.likely * self.range)
        self.count += 1
        self.low, self.range = (self.low, bound) if bit else (self.low + bound, self.range - bound)
        while self.range < 2**24:
            self.low, self.range, self.size = self.low * 256, self.range * 256, self.size + 1
        return bit

    def codeword(self):
        """A codeword of which these bits are decoded."""
        return self.low.to_bytes(self.size, "big")


def dictated(data, *dictation):
    """The Dictated of a stream of one attribute unit."""
    (unit,), decoder = read_stream(units_of(data))["attributes"], Dictated(*dictation)
    with patch.object(attributes, "RangeDecoder", lambda _: decoder):
        attributes.decode_values(unit, decode(data).fields[0].keys.tolist())
    return decoder


def beyond_255():
    """Values of voxels of which some have residuals that stand for more than 255, and the others residuals of 0."""
    data = recoded(encoded(scene_of(*torus(8, 5)), resolution=9, qp=46), models=6, max_error=0)
    (unit,), last = parsed(data).attributes, dictated(data).count
    ones = [first + n for first in range(last - 300, last + 600, 150) for n in range(65)]
    return with_codeword(data, dictated(data, ones).codeword(), unit["qp"])


def bits_of(residual):
    """The bits of a residual (7.9) as text."""
    rest, sign = f"{abs(residual) - 15:b}", int(residual < 0)
    long = "1" * (14 + len(rest)) + "0" + rest[1:]
    return "0" if residual == 0 else f"1{sign}" + (long if abs(residual) > 15 else "1" * (abs(residual) - 1) + "0")


def between_classes():
    """Eight voxels, with a residual of 256 at the first, which is cut to 255. Not cut, it would move the last one's energy to
    the next class."""
    square, faces = np.array([[0, 0], [1000, 0], [0, 1000], [1000, 1000]]), np.array([[0, 1, 2], [1, 3, 2]])
    lattice = np.concatenate([np.column_stack([square, [z] * 4]) for z in (9, 900)])
    patches = [Patch(lattice, np.concatenate([faces, faces + 4]))]
    data = stream_of_parts([Grid(2, (90, 90, 90), False)], patches, models=6, max_error=0)
    bits = "00" + "".join(3 * bits_of(residual) for residual in (256, 100, 0, 0, 0, 0, 0, -9))  # flags, then three components
    ones = {n for n, bit in enumerate(bits) if bit == "1"}
    return with_codeword(data, dictated(data, ones, 3).codeword(), [30, 30, 30])


def with_idle_cross():
    """A residual_cross of the component that comes first, which has nothing to follow."""
    image = np.random.default_rng(3).integers(0, 256, (2, 2, 3)).astype(np.uint8)
    stream = parsed(on_ring(image, qp=60, models=6, max_error=0))
    stream.attributes[0]["residual_cross"][1] = 16
    return written(stream)


def greys():
    """Triangles all over a cube in greys: coarse blocks of eight children with luma and without chroma."""
    random = np.random.default_rng(0)
    positions, grey = random.random((18, 3)), random.random(18)
    colours = np.column_stack([grey, grey, 0.95 * grey, np.ones(18)]).astype(np.float32)
    return recoded(encoded(scene_of(positions, np.arange(18).reshape(6, 3), colours), resolution=32, qp=46), models=1)


def steps():
    """Noise of small steps, uint8 [H, W, 3], that the smallest step of quantisation tells apart."""
    moves = np.random.default_rng(9).integers(-1, 2, (32, 48, 3))
    return (90 + np.cumsum(moves, 1)).clip(0, 255).astype(np.uint8)


def coarser_by_component():
    """Texels from flat to noise, each component with a step of its own, filtered."""
    size = (40, 24)
    share = np.linspace(0, 1, size[0])[None, :, None] ** 2
    image = np.round(picture(*size) * (1 - share) + share * picture(*size, noise=60)).astype(np.uint8)
    data = stream_of_parts([Image(image)], [ring(size)], qp=[34, 22, 46])
    return filtered(data, {3: [drawn_stage(97)]}, models=6, planar_transform=1, component_cross=16)


def full_and_empty():
    """Squares of 8 x 8 texels of noise or of one colour, all asked: DCT blocks with each number of coefficients there is least
    and most."""
    size = (48, 32)
    noisy = np.random.default_rng(12).random((4, 6)) < 0.5
    noise = np.random.default_rng(14).integers(0, 256, (32, 48, 3))
    image = np.where(np.kron(noisy, np.ones((8, 8)))[:, :, None] > 0, noise, 90).astype(np.uint8)
    corners = [(0, 0), (16 * size[0], 0), (16 * size[0], 16 * size[1]), (0, 16 * size[1])]
    data = stream_of_parts([Image(image)], [sheet([corners[i] for i in (0, 1, 2, 0, 2, 3)])], qp=10)
    return recoded(data, **DCT)


def above_every_range(models):
    """A codeword that begins above every range and goes on with zeros, then noise."""
    data = recoded(encoded(scene_of(*torus(20, 10)), resolution=32, qp=40), models=models)
    return with_codeword(data, b"\xff" * 4 + bytes(4) + np.random.default_rng(15).bytes(500), [30, 40, 30])


def back_to_back():
    """Triangles across an axis with a front and a back, the sum of whose normals vanishes, beside a slanted one."""
    lattice = np.array([[4, 10, 10], [4, 400, 30], [4, 60, 300], [900, 700, 500], [600, 1000, 600], [700, 650, 900],
                        [20, 900, 70], [300, 900, 90], [80, 900, 400]])
    faces = np.array([[0, 1, 2], [0, 2, 1], [3, 4, 5], [6, 7, 8], [6, 8, 7]])
    return marked(stream_of_parts([Grid(6)], [Patch(lattice, faces)]), [(CODED, 0)], 0)


def far_folds():
    """An image that is mirrored several times on a sheet, and one of 2^3 + 1 texels a side that ends far inside of its sheet."""
    texel = 16
    corners = lambda w, h, x, y: [(texel * u, texel * v) for u, v in ((-w, -h), (x, 1 - h), (x - 1, y), (-w, -h), (x - 1, y),
                                                                     (1 - w, y - 2))]
    mirrored, clamped = sheet(corners(17, 16, 25, 22)), sheet(corners(20, 14, 31, 27), field=1)
    clamped.lattice = clamped.lattice[:, [0, 2, 1]] + [0, 0, 90]
    return stream_of_parts([Image(picture(6, 5, noise=40), MIRRORED), Image(picture(9, 9, noise=40, seed=4), CLAMPED)],
                           [mirrored, clamped])


def without_area():
    """A sheet at z 0 and a face that is a line at z 300, in a field of its own; a world point is its lattice position."""
    flat = Patch(np.array([[0, 0, 0], [1000, 0, 0], [0, 1000, 0]]), np.array([[0, 1, 2]]))
    line = Patch(np.array([[100, 100, 300], [400, 200, 300], [700, 300, 300]]), np.array([[0, 1, 2]]), field=1)
    stream = parsed(stream_of_parts([Grid(4), Grid(4, (10, 20, 220))], [flat, line]))
    stream.header.update(origin=[0.0, 0.0, 0.0], side=float((1 << stream.header["position_bits"]) - 1))
    return written(stream)


def as_large_as_f64():
    """An origin and a side of 1e300."""
    stream = parsed(encoded(scene_of(*torus(8, 5)), resolution=5, qp=46))
    stream.header.update(origin=[-1e300, 1e300, -0.0], side=1e300)
    return written(stream)


def where_binary32_parts(reach, least):
    """UVs in 20 bits of a range, whose floats stand so far beside their numbers in u."""
    a, b = int(reach * 0.37), int(reach * 0.81)
    uv = [(0, 0), (a, 700), (b, 900), (0, 0), (b, 900), (reach, 300)]
    return beginning_at(stream_of_parts([Image(picture(5, 3), MIRRORED, 8)], [sheet(uv, bits=20)]), (least, 0))


def at_one_position():
    """A sheet, and faces with three or two corners at one position but no two at one UV. Draco's encoder writes no such faces; a
    flipped bit makes them of others."""
    lattice = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 1, 0]])
    faces, uv = np.array([[0, 1, 2], [0, 2, 3], [2, 4, 3]]), np.array([[25, 36], [7, 32], [3, 0], [20, 10], [12, 1]])
    parts = [Patch(lattice, faces, uv[faces]), sheet([(0, 0), (99, 8), (90, 70), (0, 0), (90, 70), (3, 66)])]
    stream = parsed(stream_of_parts([Image(picture(9, 7))], parts))
    unit = stream.geometry[0]
    for bit in range(8 * 14, 8 * len(unit["draco_data"])):
        data = bytearray(unit["draco_data"])
        data[bit // 8] ^= 1 << bit % 8
        try:
            positions, corners, _ = dec_textured(bytes(data), len(lattice), len(faces), UvCoding(0, 1), BITS)
            stream.geometry[0] = with_checksum(unit | {"draco_data": bytes(data)})
            decode(written(stream))  # whose texels are the same
        except StreamError:  # as of most flips
            continue
        if 1 in [len({*map(tuple, positions[face].tolist())}) for face in corners]:
            return written(stream)
    raise AssertionError("no flip makes such faces")


def named():
    """Materials with names from the ends of what UTF-8 has, no face of theirs."""
    return of_nothing([Material(name) for name in NAMES])


def with_idle_rules():
    """Coded normals at the material of all faces; materials of no face have each other rule, with a channel that no group has."""
    patches = ring((8, 8))
    idle = [Material(f"idle {rule}", maps={"roughness": -1}) for rule in range(7)]
    data = stream_of_parts([Grid(7)], [Patch(patches.lattice, patches.faces)], [Material("seen"), *idle])
    return marked(data, [(CODED, 0), *((rule, 10 * rule) for rule in range(7))], 0.2, 3)


def uncommon():
    """All of them."""
    numbers = np.random.default_rng(100).bytes(600)
    return [
        ("rules_rough", ["a planar support", ("{} models", 8), "the smallest step"], ("7.5.5",),
         on_ring(steps(), qp=0, models=8), (0,)),
        ("rules_qps", ["a planar support", ("{} filter stages", 1), "another step in every component"], ("7.4.2", "7.11.3"),
         coarser_by_component(), (0, 1)),
        ("rules_full", ["DCT blocks", ("DCT blocks of {} coefficients", 0), ("DCT blocks of {} coefficients", 63)], ("7.11.4",),
         full_and_empty(), (0, 1)),
        ("rules_steep", ["DCT blocks", "random bytes as a codeword", "coefficients at their bounds"], ("7.11.4",),
         with_codeword(recoded(two_corners(), **DCT), numbers, [63, 63, 63]), (0,)),
        ("rules_above", ["a codeword that begins above every range", "then zeros", "direct contexts"], ("7.6.2",),
         above_every_range(0), (0, 1)),
        ("rules_above_mixed", ["a codeword that begins above every range", "then zeros", ("{} models", 8)], ("7.6.2",),
         above_every_range(8), (0, 1)),
        ("rules_beyond", ["lossless", "a residual beyond 255"], ("7.9",), beyond_255(), (0,)),
        ("rules_vanishing", ["coded normals", "faces at one place", "normals that vanish in their sum"], ("8.4.3",),
         back_to_back(), (0,)),
        ("rules_names", ["an empty mesh", "names from all ends of UTF-8"], ("4.3", "5.4.1"), named(), (0,)),
        ("rules_largest", [("coordinates near 1e{}", 300)], ("4.3", "5.3"), as_large_as_f64(), (0,)),
        ("rules_idle", ["coded normals", "materials of no face with every rule",
                        "a material of no face names a channel that no group holds"], ("5.4.1", "5.10", "5.11"),
         with_idle_rules(), (0,)),
        ("rules_nearer", [("UVs quantised to {} bits", 20), "floats that binary32 has further from their numbers"], ("5.6.2",),
         where_binary32_parts(*NEARER), (0,)),
        ("rules_position", [("an image of {} x {}", 9, 7), "faces whose corners are at one position"], ("5.6.3",),
         at_one_position(), (0,)),
        ("queries_folds", ["two fields over texels", "UVs several images beside"], ("6.5.3", "8.2.2"), far_folds(), (0, 1, 3)),
        ("queries_line", ["two fields", "a face without area", "each in a field of its own"], ("8.2",), without_area(), (0,)),
        ("queries_far", ["two sheets and a face of one step", "each in a field of its own"], ("8.2",), far_from_small(), (0,)),
        ("maps_grey_rest", [("grey {}", name) for name in GREYS], ("5.3.1",),
         over_texels([painted(*GREYS)], groups(*GREYS, grey=GREYS), models=6, max_error=0), (0,)),
        ("queries_narrow", ["faces with two corners at one position"], ("8.2",), narrow(), (0,)),
        ("rules_height", [("B = {}", 20), ("K = {}", 16), "areas and heights exactly on a limit"], ("6.2",),
         of_triangles([(1000, 45000, 40000), (61000, 45000, 40000), (3000, 77768, 40010), *SPAN], area_threshold=0), (0,)),
        ("rules_last_context", ["a single model", "greys in coarse blocks of eight children"], ("7.5.5",), greys(), (0,)),
        ("rules_cut", [("K = {}", 2), "lossless", "a residual beyond 255"], ("7.9",), between_classes(), (0,)),
        ("rules_first", [("an image of {} x {}", 2, 2), "lossless", "a first component with a residual_cross"], ("7.9",),
         with_idle_cross(), (0,)),
        ("texels_one_bit", [("an image of {} x {}", 2, 2), ("UVs quantised to {} bits", 1), "UVs in whole texels"], ("5.6.2",),
         stream_of_parts([Image(picture(2, 2), fraction=0)], [sheet([(0, 0), (1, 0), (1, 1)] * 2, bits=1)]), (0,)),
        ("rules_energy", ["zeros", "then random bytes", ("{} models", 8)], ("7.5.5",),
         with_codeword(recoded(encoded(noise_sheet(), resolution=12, qp=40), models=8),
                       bytes(20) + np.random.default_rng(39).bytes(300), [40, 50, 40]), (0, 1)),
    ]
