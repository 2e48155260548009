"""Quantiser steps and the scaling of coefficients (spec clause 7.4). As in G-PCC, step = 2**((QP - 4) / 6)."""

from ....core.integer import _isqrt
from ....core.kernel import kernel

VALUE_FRACTION = 12  # fractional bits of attribute means
GAIN_FRACTION = 17
MAX_QP = 63
MAX_Q = (1 << 22) - 1
MAX_DIFFERENCE = (1 << 22) - 1
MAX_MEAN = 1 << 22  # decoded means are clipped to +-1024.0; real ones stay near 0..255
# round(2**((i - 4) / 6) * 2**12): the steps of QP 0..5; every six QPs the step doubles
STEP_TABLE = (2580, 2896, 3251, 3649, 4096, 4598)


def step_of(qp: int) -> int:
    """Return the quantiser's step of a QP in 0..63, with 12 fractional bits; below 2**22."""
    return STEP_TABLE[qp % 6] << (qp // 6)


@kernel
def _gain(w1, w2, half=0):
    """Difference per unit of coefficient, sqrt((w1 + w2) / (w1 w2)), with 17 fractional bits, rounded down; below 2**17.6. half:
    1 multiplies it by sqrt(1/2).

    w1 + w2 <= 2**28, so the shifted sum is <= 2**62.
    """
    return _isqrt(((w1 + w2) << (2 * GAIN_FRACTION - half)) // (w1 * w2))


@kernel
def _dequantise(q, step, w1, w2, half=0):
    """Difference (second minus first mean, 12 fractional bits) that coefficient q represents (spec 7.4.2); half: as in _gain.

    The orthonormal coefficient is difference * sqrt(w1 w2 / (w1 + w2)). |q| < 2**22, step < 2**22, gain < 2**17.6, so the product
    is < 2**62. The result is limited to 22 bits, so that no stream can push later sums out of range.
    """
    difference = (min(abs(q), MAX_Q) * step * _gain(w1, w2, half) + (1 << (GAIN_FRACTION - 1))) >> GAIN_FRACTION
    difference = min(difference, MAX_DIFFERENCE)
    return -difference if q < 0 else difference
