"""D1, D2 and Hausdorff between meshes on cases worked by hand."""

import json

import numpy as np
import pytest
from shapes import sphere, square

from texfcodec.geometry.mesh import Mesh
from texfcodec.metrics.surface_distance import surface_distance


def joined(*parts):
    """One mesh of several (positions, faces)."""
    starts = np.cumsum([0] + [len(positions) for positions, _ in parts])
    faces = [part[1] + start for part, start in zip(parts, starts, strict=False)]
    return Mesh(np.concatenate([part[0] for part in parts]), np.concatenate(faces))


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e20])
def test_parallel_squares_are_their_gap_apart_by_every_measure(scale):
    """Three times the side's square over that of a hundredth of it: 44.77 dB."""
    near, far = (Mesh(positions * scale, faces) for positions, faces in (square(0.0), square(0.01)))
    distance = surface_distance(near, far, samples=1000)
    decibels = 10 * np.log10(3 * 100**2)
    assert distance.d1 == pytest.approx(decibels) == pytest.approx(44.771, abs=1e-3) and distance.d2 == pytest.approx(decibels)
    assert distance.d1_side == pytest.approx(40) and distance.largest == pytest.approx(0.01 * scale)
    report = distance.report()
    assert report == json.loads(json.dumps(report, allow_nan=False))
    assert (report["peak"], report["hausdorff"]["share"]) == pytest.approx((scale, 0.01 / 2**0.5))
    assert report["d1"]["to_source"] == report["d1"]["from_source"] == pytest.approx(1e-4 * scale**2)


def test_a_square_shifted_in_its_plane_is_off_by_d1_and_not_by_d2():
    moved = Mesh(square()[0] + [0.1, 0, 0], square()[1])
    distance = surface_distance(Mesh(*square()), moved, samples=100_000)
    # A tenth of the points is outside, at 0 to 0.1 from the border: the integral of x^2 to 0.1.
    assert distance.to_source == pytest.approx(0.1**3 / 3, rel=0.02) == pytest.approx(distance.from_source, rel=0.03)
    assert distance.of_mesh.plane == pytest.approx(0, abs=1e-20) and distance.largest == pytest.approx(0.1)


def test_what_is_missing_counts_from_the_source_and_the_worse_way_decides():
    half = Mesh(square()[0] * [0.5, 1, 1], square()[1])
    distance = surface_distance(Mesh(*square()), half, samples=200_000)
    assert distance.to_source == pytest.approx(0, abs=1e-20)
    # The integral of (x - 1/2)^2 over the half that is missing.
    assert distance.from_source == pytest.approx(0.5**3 / 3, rel=5e-3)
    assert distance.d1 == pytest.approx(10 * np.log10(3 * 24), abs=0.03)
    assert (distance.of_mesh.largest, distance.largest) == pytest.approx((0, 0.5), abs=1e-12)


def test_an_extra_part_far_away_counts_to_the_source_alone():
    """A square of the same size 3 above: half of the points, 3 away along the normal."""
    distance = surface_distance(Mesh(*square(0.0)), joined(square(0.0), square(3.0)), samples=1000)
    assert distance.of_source == pytest.approx((0, 0, 0), abs=1e-15)
    assert distance.of_mesh == pytest.approx((4.5, 4.5, 3))
    assert distance.d1 == distance.d2 == pytest.approx(10 * np.log10(3 / 4.5)) and distance.largest == pytest.approx(3)
    back = surface_distance(joined(square(0.0), square(3.0)), Mesh(*square(0.0)), samples=1000)
    assert back.of_source == pytest.approx((4.5, 4.5, 3)) and back.side == 3
    assert back.d1 == pytest.approx(10 * np.log10(3 * 9 / 4.5))


def test_a_spike_too_thin_for_the_samples_is_in_the_hausdorff_distance():
    spike = np.array([[0.5, 0.5, 0.5], [0.5, 0.5 + 1e-9, 0.5], [0.5, 0.5, 1.5]]), np.array([[0, 1, 2]])
    distance = surface_distance(Mesh(*square()), joined(square(), spike), samples=1000)
    assert distance.to_source == pytest.approx(0, abs=1e-12) and distance.largest == pytest.approx(1)


def test_a_surface_is_exactly_itself_and_one_without_area_is_refused():
    ball, plate = Mesh(*sphere(6)), Mesh(*square())
    assert surface_distance(ball, ball, samples=500).d1 > 290
    assert surface_distance(plate, plate, samples=500, threads=2) == surface_distance(plate, plate, samples=500)
    with pytest.raises(ValueError, match="area"):
        surface_distance(ball, Mesh(ball.positions * [0, 0, 1], ball.faces))
