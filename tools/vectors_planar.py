"""The conformance vectors of planar supports (clause 7.11), good and faulty, made from a stream whose only field is planar."""

import numpy as np
from vectors_faulty import as_faulty, with_values
from vectors_filter import SLICES, every, filtered, out_of_range
from vectors_good import Vector, parsed, recoded, with_codeword
from vectors_texels import Image, picture, ring, stream_of_parts

from texfcodec.codecs.raht.transform.filter import PLANAR_TAPS, stage_of

ALL = {"planar": 1, "planar_transform": 1, "component_cross": 16}


def drawn_stage(seed):
    """A FilterStage of every class of three components, all its taps drawn."""
    mask = every(3)
    taps = np.random.default_rng(seed).integers(-30, 31, PLANAR_TAPS * mask.bit_count())
    return stage_of(mask, taps, 3)


def sheet_of_texels():
    """A stream of colour alone on one planar field of some hundred texels."""
    return stream_of_parts([Image(picture(24, 16))], [ring((24, 16))])


def uncommon():
    """Vectors of each tool."""
    data = sheet_of_texels()
    noise = np.random.default_rng(81).bytes(6000)
    stages = {3: [drawn_stage(80 + n) for n in range(2)]}
    lines = [
        ("planar_plain", "a planar support, all of its tools off", ("7.11",), recoded(data, models=8, planar=1)),
        ("planar_direct", "rotated splits and components that follow, direct contexts", ("7.11.1", "7.11.2"),
         recoded(data, **ALL)),
        ("planar_mixed", "the same, mixed contexts", ("7.11.1", "7.11.2", "7.11.3"),
         recoded(data, models=8, colour_range=4, **ALL)),
        ("planar_cross_1", "component_cross 1, no transform", ("7.11.2", "7.8.1"),
         recoded(data, models=6, plain=True, planar=1, component_cross=1)),
        ("planar_slices", "slices with the level index", ("7.2", "7.11"),
         recoded(data, models=8, slices=SLICES, index=True, **ALL)),
        ("planar_filter", "two filter stages of five taps, with slices", ("5.7.3", "7.11.4"),
         filtered(data, stages, slices=SLICES, models=6, **ALL)),
        ("planar_lossless", "lossless", ("7.9", "7.11"), recoded(data, models=6, max_error=0, **ALL)),
        ("planar_random", "a random codeword, means and factors at their bounds", ("7.11.1", "7.11.2"),
         with_codeword(recoded(data, models=8, **ALL), noise, [40, 50, 40])),
    ]
    return [Vector(f"uncommon/{name}", *rest, (0, 1)) for name, *rest in lines]


def faulty():
    """Clauses 5.7.1 and 7.11."""
    data = sheet_of_texels()
    mixed = recoded(data, models=6, **ALL)
    (unit,) = parsed(mixed).attributes
    turned = lambda stream: stream.attributes[0].update(planar_transform=0)
    weaker = lambda stream: stream.attributes[0].update(component_cross=15)
    last = filtered(data, {3: [drawn_stage(90)]}, models=6, **ALL)
    tap = lambda stream: stream.attributes[0]["filters"][0]["filter_coefficients"].__setitem__(64, 99)  # class 4, component 0
    assert unit["planar_transform"] == 1 and unit["component_cross"] == 16
    lines = [
        ("planar_transform_2", "planar_transform 2", "5.7.1",
         out_of_range(mixed, "planar_transform", b"\2", planar_transform=2), "TXF-S04"),
        ("component_cross_17", "component_cross 17", "5.7.1",
         out_of_range(mixed, "component_cross", b"\21", component_cross=17), "TXF-S04"),
        ("planar_transform_off", "planar_transform is 0 for what was coded with 1", "7.11.1",
         with_values(mixed, turned), "TXF-S32"),
        ("component_cross_15", "component_cross is 15 for what was coded with 16", "7.11.2",
         with_values(mixed, weaker), "TXF-S32"),
        ("planar_filter_tap", "another fifth filter coefficient of the roughest class", "7.11.4",
         with_values(last, tap), "TXF-S32"),
    ]
    return as_faulty(lines)
