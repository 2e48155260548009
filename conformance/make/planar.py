"""The conformance vectors of planar supports (clause 7.11), good and faulty, made from a stream whose only field is planar."""

import numpy as np

from conformance.make.faulty import with_values
from conformance.make.filter import SLICES, every, filtered, out_of_range
from conformance.make.good import parsed, recoded, with_codeword
from conformance.make.texels import Image, picture, ring, sheet, stream_of_parts
from texfcodec.codecs.raht.transform.filter import stage_of
from texfcodec.codecs.raht.transform.planar_rings import PLANAR_TAPS

ALL = {"planar_transform": 1, "component_cross": 16}
DCT = {"models": 8, "dct_blocks": 1, **ALL}


def drawn_stage(seed):
    """A FilterStage of every class of three components, all its taps drawn, none of them 0."""
    mask = every(3)
    taps = np.random.default_rng(seed).choice([t for t in range(-40, 41) if t], PLANAR_TAPS * mask.bit_count())
    return stage_of(mask, taps, 3)


def sheet_of_texels(alpha=False):
    """A stream of one field over texels, whose picture goes from flat to noise: texels of every class of roughness (7.7)."""
    size = (48, 32)
    smooth, noisy = (picture(*size, 4 if alpha else 3, noise=noise).astype(float) for noise in (0, 60))
    share = np.linspace(0, 1, size[0])[None, :, None] ** 2
    image = np.round(smooth + share * (noisy - smooth)).astype(np.uint8)
    return stream_of_parts([Image(image)], [ring(size)], alpha=alpha, qp=34)


def islands():
    """A stream over texels in which every face shows a few texels of its own, one or two away from those of the next face."""
    size, patch = (48, 32), ring((48, 32))
    middle = patch.uv.mean(axis=1, keepdims=True)
    patch.uv = np.floor(middle + 0.35 * (patch.uv - middle) + 0.5).astype(np.int64)
    return stream_of_parts([Image(picture(*size, noise=30))], [patch], qp=30)


def two_corners(alpha=False, qp=30):
    """A stream over texels of two triangles in an image, squares of 8 x 8 texels whole in them and in part along their edges."""
    size, uv = (56, 44), [(2, 2), (50, 4), (4, 40), (52, 10), (54, 42), (12, 42)]
    image = picture(*size, 4 if alpha else 3, noise=40)
    return stream_of_parts([Image(image)], [sheet([[16 * u, 16 * v] for u, v in uv])], alpha=alpha, qp=qp)


def uncommon():
    """Vectors of each tool."""
    data, corners = sheet_of_texels(), two_corners()
    noise = np.random.default_rng(81).bytes(600)
    stages, stages_of_islands, stages_of_dct = ({3: [drawn_stage(seed + n) for n in range(2)]} for seed in (80, 84, 88))
    lines = [
        ("planar_plain", ["a planar support", ("{} models", 8), "no rotated splits", "no components that follow"],
         ("7.11", "7.11.2"), recoded(data, models=8)),
        ("planar_direct", ["rotated splits", "components that follow", "direct contexts"], ("7.11.1", "7.4.4"),
         recoded(data, **ALL)),
        ("planar_mixed", ["rotated splits", "components that follow", ("{} models", 8), "colour range"],
         ("7.11.1", "7.4.4", "7.11.2"), recoded(data, models=8, colour_range=4, **ALL)),
        ("planar_alpha", ["a planar support", "colour and alpha", "rotated splits", "components that follow"],
         ("5.7.1", "7.11.1", "7.4.4"), recoded(sheet_of_texels(alpha=True), models=6, **ALL)),
        ("planar_cross_1", [("component_cross {}", 1), "no transform"], ("7.4.4", "7.8.1"),
         recoded(data, models=6, plain=True, component_cross=1)),
        ("planar_slices", ["a planar support", "slices with the level index"], ("7.2", "7.11", "7.11.2"),
         recoded(data, models=8, slices=SLICES, index=True, **ALL)),
        ("planar_islands", ["a planar support", "texels that no face asks", "components that follow"],
         ("5.7.3", "7.4.4", "7.11.3"), filtered(islands(), stages_of_islands, models=8, **ALL)),
        ("planar_filter", ["two filter stages of five taps", "slices"], ("5.7.3", "7.11.3"),
         filtered(data, stages, slices=SLICES, models=6, **ALL)),
        ("planar_lossless", ["a planar support", "lossless"], ("7.9", "7.11"), recoded(data, models=6, max_error=0, **ALL)),
        ("planar_random", ["a planar support", "random bytes as a codeword", "means at their bounds", "factors at their bounds"],
         ("7.11.1", "7.4.4", "7.11.2"), with_codeword(recoded(data, models=8, **ALL), noise, [40, 63, 63])),
        ("dct_blocks", ["DCT blocks beside others", ("{} models", 8)], ("7.11.4", "7.11.2"), recoded(corners, **DCT)),
        ("dct_alpha", ["DCT blocks of one component and of three", ("{} models", 6)], ("7.11.4",),
         recoded(two_corners(alpha=True), **DCT | {"models": 6})),
        ("dct_fine", ["DCT blocks", "long magnitudes"], ("7.11.4",), recoded(two_corners(qp=4), **DCT)),
        ("dct_slices", ["DCT blocks", "slices with the level index"], ("7.2", "7.11.4"),
         recoded(corners, slices=SLICES, index=True, **DCT)),
        ("dct_trunk", ["DCT blocks above the slices"], ("7.2", "7.11.4"),
         recoded(corners, slices=SLICES | {"_plan_slices": lambda levels, _: (4, [0, len(levels[4]) // 2])}, **DCT)),
        ("dct_filter", ["DCT blocks", "two filter stages of five taps"], ("7.11.3", "7.11.4"),
         filtered(data, stages_of_dct, **DCT)),
        ("dct_lossless", ["DCT blocks", "lossless"], ("7.9", "7.11.4"), recoded(corners, max_error=0, **DCT)),
        ("dct_random", ["DCT blocks", "random bytes as a codeword", "means at their bounds"], ("7.11.4",),
         with_codeword(recoded(corners, **DCT), noise, [40, 63, 63])),
        # A share of 7.11.4 that is rounded up leads to other bits.
        ("dct_random_fine", ["DCT blocks", "random bytes as a codeword"], ("7.11.4",),
         with_codeword(recoded(two_corners(qp=0), **DCT), bytes([9]) + np.random.default_rng(1).bytes(2999), [12, 0, 9])),
    ]
    return [(name, *rest, (0, 1, 3) if name.startswith("dct_") else (0, 1)) for name, *rest in lines]


def faulty():
    """Clauses 5.7.1 and 7.11."""
    data = sheet_of_texels()
    mixed = recoded(data, models=6, **ALL)
    (unit,) = parsed(mixed).attributes
    plain = lambda stream: stream.attributes[0].update(dct_blocks=0)
    turned = lambda stream: stream.attributes[0].update(planar_transform=0)
    weaker = lambda stream: stream.attributes[0].update(component_cross=15)
    last = filtered(data, {3: [drawn_stage(90)]}, models=6, **ALL)
    tap = lambda stream: stream.attributes[0]["filters"][0]["filter_coefficients"].__setitem__(64, 99)  # class 4, component 0
    assert unit["planar_transform"] == 1 and unit["component_cross"] == 16
    return [
        ("planar_transform_2", "planar_transform 2", "5.7.1",
         out_of_range(mixed, "planar_transform", b"\2", planar_transform=2), "TXF-U09"),
        ("component_cross_17", "component_cross 17", "5.7.1",
         out_of_range(mixed, "component_cross", b"\21", component_cross=17), "TXF-S04"),
        ("planar_transform_off", "planar_transform is 0 for what was coded with 1", "7.11.1",
         with_values(mixed, turned), "TXF-S32"),
        ("component_cross_15", "component_cross is 15 for what was coded with 16", "7.4.4",
         with_values(mixed, weaker), "TXF-S32"),
        ("dct_blocks_2", "dct_blocks 2", "5.7.1", out_of_range(mixed, "dct_blocks", b"\2", dct_blocks=2), "TXF-U09"),
        ("dct_blocks_off", "dct_blocks is 0 for what was coded with 1", "7.11.4",
         with_values(recoded(data, **DCT), plain), "TXF-S32"),
        ("planar_filter_tap", "another fifth filter coefficient of the roughest class", "7.11.3",
         with_values(last, tap), "TXF-S32"),
    ]
