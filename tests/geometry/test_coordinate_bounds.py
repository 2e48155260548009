"""Bounds of coordinates: scale, offset and the canonical cube's lattice."""

from fractions import Fraction

import numpy as np
import pytest
from bounds import Draws, Group
from shapes import painted_sphere, scene_of

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError
from texfcodec.geometry.canonical import MAX_COORDINATE, fit_cube
from texfcodec.options import EncodeOptions

case = Group("Coordinates")

SMALLEST_SIDE = 1e-290
PLAIN = {"resolution": 16, "qp": 28, "effort": "fast", "refine": "off", "threads": 1}
ROUNDING = 1 + 2.0**-29
HALF_STEPS = "half lattice steps"


def placed(draw: Draws, unit: np.ndarray, smallest: float = -289, largest: float = 149, reach: float = 14) -> np.ndarray:
    """Positions in 0..1 at some scale, from a place that is up to 10^reach times as far from the origin as they are large."""
    scale = draw.power(smallest, largest)
    offset = min(scale * draw.power(-3, reach), 0.8 * MAX_COORDINATE) * draw.pick((-1, 0, 1))
    return unit * scale + offset


@case("lattice rounding", ROUNDING, HALF_STEPS, seeds=20)
def lattice_rounding(draw: Draws) -> float:
    """Error of a decoded position in half lattice steps and an ulp of the largest coordinate, in exact fractions.
    Stress: positions at any scale from 1e-289 to 1e149 and up to 1e14 times their extent away, many of them where a half
    decides
    Bound: A position goes to the nearest lattice point and back by 8.1. Three binary64 operations on numbers below 2^20 move
    the tie by at most 2^-31 steps, two on the way back by 2^-32; the last addition rounds to an ulp of the largest
    coordinate, which is added to the half step here: no format of coordinates has less.
    """
    bits, last = (b := draw.integer(8, 20)), (1 << b) - 1
    unit = draw.reals((5, 3), 0, 1)
    unit[0], unit[1] = 0, 1
    for row in range(2, 5):  # some lie where a half decides
        if draw.pick((True, False)):
            unit[row] = (np.floor(unit[row] * last) + 0.5) / last
            unit[row] += np.spacing(unit[row]) * draw.integer(-2, 2)
    return rounding_of(placed(draw, unit), bits)


def rounding_of(positions: np.ndarray, bits: int) -> float:
    """The same of positions float64 [V, 3]."""
    cube, last = fit_cube(positions, bits), (1 << bits) - 1
    lattice = cube.to_lattice(positions)
    if lattice.min() != 0 or lattice.max() != last:
        return np.inf
    decoded = cube.to_world(lattice)
    allowed = Fraction(cube.side) / last / 2 + Fraction(float(np.spacing(np.abs(positions).max())))
    pairs = zip(decoded.ravel().tolist(), positions.ravel().tolist(), strict=True)
    return float(max(abs(Fraction(a) - Fraction(b)) for a, b in pairs) / allowed)


@case("scales that are refused", 0, "wrong answers", seeds=40)
def refused_by_code(draw: Draws) -> float:
    """1 where a scale is not taken, or refused, as the two limits say; both are put to the test from each side.
    Stress: extents from 1e-320 to 1e307 and both limits from each side
    Bound: Coordinates over 1e150 are refused as TXF-I60 and extents between 0 and 1e-290 as TXF-I61: between the limits no
    difference, quotient or lattice step leaves the normal numbers of binary64.
    """
    limit = draw.pick((MAX_COORDINATE, SMALLEST_SIDE, 10.0 ** draw.real(-320, 307)))
    scale = float(limit * (1 + draw.integer(-2, 2) * 2.0**-52)) if draw.pick((True, False)) else float(limit)
    positions = np.array([[0, 0, 0], [scale, scale / 2, 0]]) * draw.pick((1, -1))
    wanted = "TXF-I60" if scale > MAX_COORDINATE else "TXF-I61" if 0 < scale < SMALLEST_SIDE else None
    try:
        cube = fit_cube(positions, 14)
    except InputError as error:
        return float(error.code != wanted)
    return float(wanted is not None or not 0 <= cube.side < np.inf)


def corner_errors(scene: object, texf: object) -> float:
    """How far a corner of a scene is from the decoded vertex nearest to it, as lattice_rounding has it."""
    used = scene.positions[np.unique(scene.faces)]
    distance = np.abs(used[:, None] - texf.positions[None]).max(axis=2).min(axis=1).max()
    return float(distance / (texf.side / ((1 << texf.position_bits) - 1) / 2 + np.spacing(np.abs(used).max())))


@case("a ball at any scale", ROUNDING, HALF_STEPS, seeds=3)
def whole_pipeline(draw: Draws) -> float:
    """A coloured ball through encoder and decoder at any scale and place.
    Stress: encoder and decoder, scale 1e-289 to 1e149, offset to 1e9 extents, 8 to 20 position bits
    Bound: As above: Draco keeps lattice positions as they are (5.6), and origin and side stand in the stream as binary64
    (5.3).
    """
    scene = painted_sphere(4, seed=draw.integer(0, 99))
    scene.positions = placed(draw, (scene.positions + 1) / 2, reach=9)
    made = encode_scene(scene, EncodeOptions(position_bits=draw.integer(8, 20), **PLAIN))
    return corner_errors(scene, decode(made.data))


@case("slivers", ROUNDING, HALF_STEPS, seeds=3)
def sliver_corners(draw: Draws) -> float:
    """Two slivers of an aspect up to 10^9, turned anyhow, through encoder and decoder.
    Stress: faces 1 to 10^9 times as long as wide, turned anyhow
    Bound: As above, and no face is lost: what the lattice makes a line stays a face as long as its three corners are apart,
    whatever its width.
    """
    aspect, turn = draw.power(0, 9), np.linalg.qr(draw.generator().normal(size=(3, 3)))[0]
    apex = draw.real(0.1, 0.9)
    thin = np.array([[0, 0, 0], [1, 0, 0], [apex, 1 / aspect, 0], [0, 0, 0.3], [1, 0, 0.3], [apex, 0, 0.3 + 1 / aspect]])
    scene = scene_of(placed(draw, thin @ turn, -20, 20, 3), [[0, 1, 2], [3, 4, 5]])
    texf = decode(encode_scene(scene, EncodeOptions(position_bits=draw.integer(8, 20), **PLAIN)).data)
    return corner_errors(scene, texf) if len(texf.faces) == 2 else np.inf


@case("lines and points", 0, "wrong answers")
def shapes_without_area(draw: Draws) -> float:
    """Faces that are lines or points, alone: 1 where they are neither coded whole nor refused as having no face.
    Stress: faces without area, alone in the mesh, scale 1e-280 to 1e140
    Bound: A face has samples whatever its area (6.3: columns and rows are at least 1), so a line is coded in its colour; a
    point has no longest side and is refused as TXF-I63.
    """
    scale, ends = draw.power(-280, 140), draw.reals((2, 3), -1, 1)
    share = draw.real(0, 1) if draw.pick((True, False)) else draw.pick((0, 1))
    is_point = draw.pick((True, False))
    corners = np.array([ends[0]] * 3 if is_point else [ends[0], ends[0] + share * (ends[1] - ends[0]), ends[1]]) * scale
    try:
        texf = decode(encode_scene(scene_of(corners, [[0, 1, 2]]), EncodeOptions(**PLAIN)).data)
    except InputError as error:
        return float(error.code != "TXF-I63")
    colour = texf.query(corners[0] + np.linspace(0, 1, 20)[:, None] * (corners[2] - corners[0]))
    return float(is_point or len(texf.faces) != 1 or np.abs(colour[:, :3] - [188, 124, 89]).max() > 1)


@pytest.mark.parametrize("hard", [*case], ids=lambda hard: hard.name)
def test_no_trial_of_a_case_is_worse_than_its_bound(hard):
    worst = hard.worst()
    assert worst.value <= hard.bound, worst
