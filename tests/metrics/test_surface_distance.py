"""D1 between meshes on cases worked by hand."""

import numpy as np
import pytest
from shapes import sphere, square

from texfcodec.geometry.mesh import Mesh
from texfcodec.metrics.surface_distance import surface_distance


def test_parallel_squares_a_tenth_apart_are_at_20_decibels():
    distance = surface_distance(Mesh(*square(0.0)), Mesh(*square(0.1)), samples=1000)
    assert distance.d1_side == pytest.approx(20) and distance.d1_diagonal == pytest.approx(20 + 10 * np.log10(2))
    assert distance.largest == pytest.approx(0.1) and (distance.side, distance.diagonal) == pytest.approx((1, 2**0.5))


def test_what_is_missing_counts_from_the_source_and_the_worse_way_decides():
    half = Mesh(square()[0] * [0.5, 1, 1], square()[1])
    distance = surface_distance(Mesh(*square()), half, samples=200_000)
    assert distance.to_source == pytest.approx(0, abs=1e-20)
    # The integral of (x - 1/2)^2 over the half that is missing.
    assert distance.from_source == pytest.approx(0.5**3 / 3, rel=5e-3)
    assert distance.d1_side == pytest.approx(10 * np.log10(24), abs=0.03)


def test_a_surface_is_exactly_itself_and_one_without_area_is_refused():
    ball = Mesh(*sphere(6))
    assert surface_distance(ball, ball, samples=500).d1_side > 290
    with pytest.raises(ValueError, match="area"):
        surface_distance(ball, Mesh(ball.positions * [0, 0, 1], ball.faces))
