"""Angles between two sets of directions, for normal maps and vertex normals."""

import numpy as np


def angular_error(ref: np.ndarray, got: np.ndarray, weights: np.ndarray | None = None) -> dict:
    """Return statistics of the angles between corresponding directions, in degrees.

    Parameters
    ----------
    ref, got : float [N, 3]
        Directions of any length.
    weights : float [N], optional
        Non-negative and finite; None for 1 each.

    Returns
    -------
    dict
        "mean_degrees", "rms_degrees", "median_degrees", "p95_degrees", "p99_degrees" and "samples". p95 is the smallest angle
        that at least 95 % of the weight does not exceed.

    Raises
    ------
    ValueError
        Shapes do not agree, weights are bad, or no pair or no weight is left.

    Notes
    -----
    A pair whose reference is zero, NaN or infinite is left out; samples counts the others. A result that is zero, NaN or infinite
    counts 180 degrees: a codec must not gain by writing none. The angle is atan2(|cross|, dot) of unit vectors, which keeps its
    digits near 0 and 180 degrees, where the arc cosine loses half of them.
    """
    ref, got = np.asarray(ref, np.float64), np.asarray(got, np.float64)
    if ref.ndim != 2 or ref.shape[1] != 3 or ref.shape != got.shape:
        raise ValueError(f"directions must both be [N, 3], not {list(ref.shape)} and {list(got.shape)}")
    weights = np.ones(len(ref)) if weights is None else np.asarray(weights, np.float64)
    if weights.shape != ref.shape[:1]:
        raise ValueError(f"weights must be [{len(ref)}], not {list(weights.shape)}")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise ValueError("weights must be finite and not negative")
    a, known = _units(ref)
    b, valid = _units(got)
    degrees = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("nc,nc->n", a, b)))
    degrees, kept = np.where(valid, degrees, 180.0)[known], weights[known]
    total = float(kept.sum())
    if not total > 0:
        raise ValueError("there is no reference direction, or all have weight zero: no angle can be computed")
    return {"mean_degrees": float(kept @ degrees / total), "rms_degrees": float(np.sqrt(kept @ degrees**2 / total)),
            "median_degrees": _weighted_quantile(degrees, kept, 0.5), "p95_degrees": _weighted_quantile(degrees, kept, 0.95),
            "p99_degrees": _weighted_quantile(degrees, kept, 0.99), "samples": len(degrees)}


def _units(vectors):
    """(unit vectors [N, 3], bool [N]: whether there is a direction); without a direction the vector is z."""
    largest = np.abs(vectors).max(axis=1, initial=0.0)
    valid = np.isfinite(largest) & (largest > 0)
    safe = np.where(valid[:, None], vectors, (0.0, 0.0, 1.0)) / np.where(valid, largest, 1.0)[:, None]
    return safe / np.linalg.norm(safe, axis=1)[:, None], valid


def _weighted_quantile(values, weights, share):
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulative, share * cumulative[-1])]])
