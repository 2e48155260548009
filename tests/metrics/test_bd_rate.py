"""BD-rate against values worked out by hand."""

import math

import pytest

from texfcodec.metrics.bd_rate import bd_rate

# BD-rate
RATE, PSNR = [100, 200, 400, 800], [30.0, 33.0, 35.5, 37.0]


def test_bd_rate_of_a_curve_against_itself_is_zero():
    assert bd_rate(RATE, PSNR, RATE, PSNR) == 0.0


def test_bd_rate_of_half_and_double_the_rate():
    half, double = [r / 2 for r in RATE], [r * 2 for r in RATE]
    assert bd_rate(RATE, PSNR, half, PSNR) == pytest.approx(-50)
    assert bd_rate(RATE, PSNR, double, PSNR) == pytest.approx(100)


def test_bd_rate_of_two_straight_lines_by_hand():
    # ln of the ratio grows from 0 at 30 dB to ln 4 at 40 dB: mean ln 2, twice the rate
    assert bd_rate([100, 1000], [30, 40], [100, 4000], [30, 40]) == pytest.approx(100)


def test_bd_rate_averages_over_the_overlap_only():
    # both lines gain a factor 10 per 10 dB; b needs twice the rate and reaches from 35 to 45 dB
    b = [2 * 100 * 10**0.5, 2 * 100 * 10**1.5]
    assert bd_rate([100, 1000], [30, 40], b, [35, 45]) == pytest.approx(100)


def test_bd_rate_takes_points_in_any_order():
    assert bd_rate(RATE[::-1], PSNR[::-1], [50, 400, 200, 100], [30, 37, 35.5, 33]) == pytest.approx(-50)


def test_bd_rate_of_swapped_curves_is_the_reciprocal():
    other_rate, other_psnr = [90, 210, 350, 900], [29.0, 33.5, 36.0, 38.0]
    there, back = bd_rate(RATE, PSNR, other_rate, other_psnr), bd_rate(other_rate, other_psnr, RATE, PSNR)
    assert (1 + there / 100) * (1 + back / 100) == pytest.approx(1)


@pytest.mark.parametrize(
    "rate, psnr, word",
    [
        ([100], [30], "two points"),
        ([], [], "two points"),
        ([100, 200], [30, 31, 32], "equal length"),
        ([100, 200, 400], [30, 33, 33], "no more quality"),
        ([100, 200, 400], [30, 35, 33], "no more quality"),
        ([100, 100, 400], [30, 33, 35], "no more quality"),
        ([0, 200], [30, 33], "positive"),
        ([100, 200], [30, math.inf], "finite"),
        ([100, 200], [10, 20], "share no quality range"),
        ([100, 200], [20, 30], "share no quality range"),
    ],
)
def test_bd_rate_refuses(rate, psnr, word):
    with pytest.raises(ValueError, match=word):
        bd_rate(rate, psnr, RATE, PSNR)
    with pytest.raises(ValueError, match=word):
        bd_rate(RATE, PSNR, rate, psnr)
