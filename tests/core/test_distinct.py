"""distinct() against numpy."""

import numpy as np
import pytest

from texfcodec.core.distinct import distinct


@pytest.mark.parametrize("shape", [(0,), (1,), (0, 3), (1000,), (333, 3)])
def test_it_finds_what_numpy_unique_finds(shape):
    keys = np.random.default_rng(5).integers(-40, 1 << 40, shape) * np.random.default_rng(6).integers(0, 2, shape)
    values, number, count = distinct(keys)
    wanted, inverse, counted = np.unique(keys, return_inverse=True, return_counts=True)
    assert values.tolist() == wanted.tolist() and count.tolist() == counted.tolist()
    assert number.shape == keys.shape and (number == inverse.reshape(shape)).all() and number.dtype == np.int64
