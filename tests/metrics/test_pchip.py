"""PCHIP against scipy's."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from texfcodec.metrics.pchip import Pchip


@pytest.mark.parametrize("seed", range(30))
def test_values_and_integrals_are_those_of_scipy(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 9))
    x = np.cumsum(random.uniform(0.01, 3, count))
    y = random.choice([-2.0, 0, 0.5, 1], (count, 2)) if seed % 3 else np.cumsum(random.uniform(0, 1, (count, 2)), axis=0)
    ours, theirs, at = Pchip(x, y), PchipInterpolator(x, y), np.concatenate([x, np.linspace(x[0], x[-1], 50)])
    assert np.allclose(ours(at), theirs(at), rtol=1e-12, atol=1e-12) and ours(at).shape == theirs(at).shape
    low, high = np.sort(random.uniform(x[0], x[-1], 2))
    assert np.allclose(ours.integrate(low, high), theirs.integrate(low, high), rtol=1e-11, atol=1e-12)


def test_a_curve_of_numbers_answers_numbers():
    curve = Pchip(np.array([0.0, 1, 3]), np.array([1.0, 2, 2]))
    assert curve(1.0).shape == () and float(curve(2.0)) == 2.0 and curve.integrate(1, 3).shape == ()
    assert float(curve.integrate(1, 3)) == pytest.approx(4.0)
