"""A matrix of blocks as a dense one."""

import numpy as np


def dense(matrix):
    """[3 V, 3 V], which must be symmetric."""
    size = len(matrix.first) - 1
    out = np.zeros((size, 3, size, 3))
    for v in range(size):
        for k in range(matrix.first[v], matrix.first[v + 1]):
            out[v, :, matrix.column[k]] = matrix.block[k]
    out = out.reshape(3 * size, 3 * size)
    np.testing.assert_allclose(out, out.T, atol=1e-12 * max(np.abs(out).max(), 1e-300))
    return out
