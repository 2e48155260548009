"""Conformance vectors for single rules that no other vector holds, as mutants of the reference decoder have shown (mutants.py).

Probabilities at their ends take many symbols alike, and a sample on a border takes corners that were searched for.
"""

import numpy as np

from conformance.make.good import encoded, scene_of
from conformance.make.texels import CLAMPED, Grid, Image, picture, ring, sheet, stream_of_parts
from texfcodec.codecs.base import Group
from texfcodec.scene.channels import BASE_COLOUR

GREY = [Group((BASE_COLOUR,), True)]


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


def on_ring(image, **more):
    """A stream of an image on a ring."""
    return stream_of_parts([Image(image)], [ring(image.shape[1::-1])], **more)


def rounded_twice():
    """B = 20, K = 16, so that a grid coordinate is the lattice position: a triangle one of whose samples would lie in another
    voxel if half (6.3) were rounded once, and one that spans the cube."""
    last = (1 << 20) - 1
    corners = [[(164262, 262144, 418757), (39672, 262146, 478751), (161712, 262143, 458756)],
               [(0, last, 0), (last, last, last), (last, 0, last)]]
    positions = np.array(corners, np.float64).reshape(-1, 3)
    colours = np.column_stack([positions / last, np.ones(6)]).astype(np.float32)
    scene = scene_of(positions, np.arange(6).reshape(2, 3), colours)
    return encoded(scene, resolution=16, qp=40, position_bits=20, area_threshold=0)


def sheets():
    """Two sheets over texels one above the other, and between them, nearer to the first, one over voxels that touches it."""
    one = 16
    first = sheet([(0, 0), (9 * one, 8), (9 * one, 7 * one), (0, 0), (9 * one, 7 * one), (-3 * one, 6 * one)])
    second = sheet([(5, 5), (8 * one, 9), (7 * one, 6 * one), (5, 5), (7 * one, 6 * one), (9, 5 * one)], field=2)
    between = sheet(np.zeros((6, 2)), field=1)
    second.lattice = second.lattice + [0, 0, 600]
    between.lattice, between.uv = between.lattice + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 80], [0, 0, 80]]), None
    fields = [Image(picture(9, 7), CLAMPED), Grid(7), Image(picture(8, 6, seed=3))]
    return stream_of_parts(fields, [first, between, second])


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
        ("rules_leads",
         [("an image of {} x {}", 20, 14), ("wrap {}", "repeat"), ("noise with errors of at most {} from a coarse field", 0)],
         ("7.9",), on_ring(noise, qp=44, models=6, max_error=0), (0,)),
        ("rules_half", [("B = {}", 20), ("K = {}", 16), "a sample that one rounding would move"], ("6.3",), rounded_twice(),
         (0,)),
        ("queries_sheets", ["two fields over texels", "one over voxels"], ("8.2", "8.2.1", "8.2.2"), sheets(), (0, 1)),
    ]
