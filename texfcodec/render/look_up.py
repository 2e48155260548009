"""Smooth functions of two variables as small tables: built once by quadrature, read by bilinear interpolation."""

import numpy as np

from ..core.kernel import kernel


@kernel
def _bilinear(table, x, y, out):
    """Writes values of table [X, Y, K] at x, y in 0..1 into out [K, M]; x and y are clamped, NaN counts as 0."""
    last_x, last_y = table.shape[0] - 1, table.shape[1] - 1
    for i in range(x.shape[0]):
        u, v = x[i] * np.float32(last_x), y[i] * np.float32(last_y)
        u = min(u, np.float32(last_x)) if u > 0 else np.float32(0)
        v = min(v, np.float32(last_y)) if v > 0 else np.float32(0)
        a, b = min(np.int64(u), last_x - 1), min(np.int64(v), last_y - 1)
        fu, fv = u - np.float32(a), v - np.float32(b)
        for k in range(table.shape[2]):
            low = table[a, b, k] + fu * (table[a + 1, b, k] - table[a, b, k])
            high = table[a, b + 1, k] + fu * (table[a + 1, b + 1, k] - table[a, b + 1, k])
            out[k, i] = low + fv * (high - low)


def look_up(table: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Look up bilinear values in a table.

    Parameters
    ----------
    table : float32 [X, Y, K]
        X and Y at least 2; its ends are at 0 and 1.
    x, y : float32 [M]
        Places in the table, from its first to its last entry, clamped to 0..1; NaN counts as 0.

    Returns
    -------
    float32 [K, M]
        The values.

    Raises
    ------
    ValueError
        Shapes do not fit.
    """
    if table.ndim != 3 or min(table.shape[:2]) < 2 or x.ndim != 1 or x.shape != y.shape:
        raise ValueError(f"table {table.shape} and places {x.shape}, {y.shape} do not fit")
    out = np.empty((table.shape[2], len(x)), np.float32)
    _bilinear(table, np.ascontiguousarray(x, np.float32), np.ascontiguousarray(y, np.float32), out)
    return out
