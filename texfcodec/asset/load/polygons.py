"""What OBJ and PLY share: numbers written as text, and polygons that become triangles."""

import warnings

import numpy as np


def parse_numbers(text, dtype):
    """bytes of numbers between blanks -> array [n], or None when something in it is no number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older numpy deprecates, newer raises, on unmatched text
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def counting(sizes):
    """[2, 3] -> [0, 1, 0, 1, 2]"""
    return np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def fan_triangles(sizes, notes):
    """int64 [P] corners per polygon -> (int64 [F, 3] corner numbers, int64 [F] polygon of each triangle).

    Corner numbers count through all polygons. Polygon (a, b, c, d) becomes (a, b, c), (a, c, d): exact where it is convex.
    """
    small, large = int((sizes < 3).sum()), int((sizes > 4).sum())
    if small:
        notes.warn(f"{small} faces with fewer than three corners are left out")
    if large:
        notes.warn(f"{large} polygons with more than four corners are split into fans")
    triangles = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), triangles)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = counting(triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon
