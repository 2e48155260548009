"""BD-rate against values worked out by hand."""

import math

import pytest

from texfcodec.metrics.bd_rate import bd_rate

RATE, PSNR = [100, 200, 400, 800], [30.0, 33.0, 35.5, 37.0]
OTHER = [90, 210, 350, 900], [29.0, 33.5, 36.0, 38.0]


@pytest.mark.parametrize("one, other, percent", [
    ((RATE, PSNR), (RATE, PSNR), 0),
    ((RATE, PSNR), ([r / 2 for r in RATE], PSNR), -50),
    ((RATE[::-1], PSNR[::-1]), ([50, 400, 200, 100], [30, 37, 35.5, 33]), -50),  # points in any order
    # ln of the ratio grows from 0 at 30 dB to ln 4 at 40 dB: mean ln 2, twice the rate
    (([100, 1000], [30, 40]), ([100, 4000], [30, 40]), 100),
    # both lines gain a factor 10 per 10 dB; the other needs twice the rate and reaches from 35 to 45 dB: the overlap alone counts
    (([100, 1000], [30, 40]), ([2 * 100 * 10**0.5, 2 * 100 * 10**1.5], [35, 45]), 100),
])
def test_bd_rate_is_the_one_by_hand(one, other, percent):
    assert bd_rate(*one, *other) == pytest.approx(percent)


def test_bd_rate_of_swapped_curves_is_the_reciprocal():
    there, back = bd_rate(RATE, PSNR, *OTHER), bd_rate(*OTHER, RATE, PSNR)
    assert (1 + there / 100) * (1 + back / 100) == pytest.approx(1)


@pytest.mark.parametrize("rate, psnr, word", [
    ([100], [30], "two points"), ([], [], "two points"), ([100, 200], [30, 31, 32], "equal length"),
    ([100, 200, 400], [30, 33, 33], "no more quality"), ([100, 200, 400], [30, 35, 33], "no more quality"),
    ([100, 100, 400], [30, 33, 35], "no more quality"), ([0, 200], [30, 33], "positive"), ([100, 200], [30, math.inf], "finite"),
    ([100, 200], [10, 20], "share no quality range"), ([100, 200], [20, 30], "share no quality range"),
])
def test_bd_rate_refuses(rate, psnr, word):
    for curves in ((rate, psnr, RATE, PSNR), (RATE, PSNR, rate, psnr)):
        with pytest.raises(ValueError, match=word):
            bd_rate(*curves)
