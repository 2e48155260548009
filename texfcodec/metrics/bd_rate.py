"""Bjontegaard delta rate: how many percent more or fewer bytes one codec needs than another for the same quality."""

import numpy as np
from numpy.typing import ArrayLike

from .pchip import Pchip


def bd_rate(rate_a: ArrayLike, psnr_a: ArrayLike, rate_b: ArrayLike, psnr_b: ArrayLike) -> float:
    """Return the Bjontegaard rate difference of curve b against the anchor a, in percent; negative if b needs less.

    Parameters
    ----------
    rate_a, rate_b : float [N >= 2]
        Bytes or bits (the unit cancels), in any order.
    psnr_a, psnr_b : float [N >= 2]
        dB.

    Returns
    -------
    float
        Percent.

    Raises
    ------
    ValueError
        Fewer than two points; rates that are not positive; values that are not finite (lossless points have no PSNR: leave them
        out); quality that does not rise strictly with rate; curves without a common quality range.

    Notes
    -----
    log(rate) is interpolated over quality by PCHIP (shape preserving: no overshoot between points) and averaged over the overlap
    of the quality ranges. Two points make a straight line.
    """
    quality_a, log_a = _curve("a", rate_a, psnr_a)
    quality_b, log_b = _curve("b", rate_b, psnr_b)
    low, high = max(quality_a[0], quality_b[0]), min(quality_a[-1], quality_b[-1])
    if not low < high:
        raise ValueError(
            f"the curves share no quality range: a covers {quality_a[0]} to {quality_a[-1]} dB, b covers {quality_b[0]} to "
            f"{quality_b[-1]} dB"
        )
    mean_difference = (_integral(quality_b, log_b, low, high) - _integral(quality_a, log_a, low, high)) / (high - low)
    return float(np.expm1(mean_difference) * 100)


def _curve(name, rate, psnr):
    rate, psnr = np.asarray(rate, dtype=np.float64), np.asarray(psnr, dtype=np.float64)
    if rate.ndim != 1 or rate.shape != psnr.shape:
        raise ValueError(f"curve {name}: rate and psnr must be two lists of equal length, not {rate.shape} and {psnr.shape}")
    if len(rate) < 2:
        raise ValueError(f"curve {name}: at least two points are needed, but there are {len(rate)}")
    if not (np.isfinite(rate).all() and np.isfinite(psnr).all() and (rate > 0).all()):
        raise ValueError(f"curve {name}: rates must be positive, and rates and qualities finite")
    order = np.argsort(rate, kind="stable")
    rate, psnr = rate[order], psnr[order]
    falls = np.flatnonzero((np.diff(rate) <= 0) | (np.diff(psnr) <= 0))
    if len(falls):
        before, after = psnr[falls[0] : falls[0] + 2]
        raise ValueError(f"no BD-rate: more bytes of curve {name} bring no more quality, {before:.2f} dB and then {after:.2f}")
    return psnr, np.log(rate)


def _integral(quality, log_rate, low, high):
    return float(Pchip(quality, log_rate).integrate(low, high))


def difference_at(rate_a: ArrayLike, psnr_a: ArrayLike, rate: float, psnr: float) -> float:
    """Return the rate difference in percent of one point against the curve a at the point's quality; negative if the point takes
    fewer bytes.

    Parameters
    ----------
    rate_a, psnr_a : float [N >= 2]
        The curve, as of bd_rate().
    rate, psnr : float
        The point.

    Returns
    -------
    float
        Percent.

    Raises
    ------
    ValueError
        As bd_rate().

    Notes
    -----
    Within the curve's quality log(rate) is interpolated by PCHIP. Beyond its ends the outermost straight line is extended, which
    is a guess.
    """
    quality, log_rate = _curve("a", rate_a, psnr_a)
    if quality[0] <= psnr <= quality[-1]:
        there = float(Pchip(quality, log_rate)(psnr))
    else:
        first = 0 if psnr < quality[0] else len(quality) - 2
        slope = (log_rate[first + 1] - log_rate[first]) / (quality[first + 1] - quality[first])
        there = log_rate[first] + slope * (psnr - quality[first])
    return float(np.expm1(np.log(rate) - there) * 100)
