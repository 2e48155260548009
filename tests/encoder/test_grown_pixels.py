"""Pixels beside an outline, against scipy's dilation."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from texfcodec.encoder.mesh.picture_error import _grown


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (8, 5), (40, 31)])
def test_covered_pixels_grow_by_their_neighbours(shape):
    for share in (0.0, 0.05, 0.4, 1.0):
        covered = np.random.default_rng(3).random(shape) < share
        assert np.array_equal(_grown(covered), binary_dilation(covered, np.ones((3, 3))))
