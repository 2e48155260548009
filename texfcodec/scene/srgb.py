"""The sRGB curve (IEC 61966-2-1), both ways, and rounding of colours to bytes."""

import numpy as np


def srgb_to_linear(v: np.ndarray) -> np.ndarray:
    """Convert sRGB-coded values to linear light.

    Parameters
    ----------
    v : float, any shape
        0..1; values outside are clipped.

    Returns
    -------
    float64, same shape
        0..1.
    """
    v = np.clip(np.asarray(v, np.float64), 0.0, 1.0)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(v: np.ndarray) -> np.ndarray:
    """Convert linear light to sRGB-coded values.

    Parameters
    ----------
    v : float, any shape
        Negative values count as 0.

    Returns
    -------
    float64, same shape
        0..1 for values 0..1.
    """
    v = np.maximum(np.asarray(v, np.float64), 0.0)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Round values to uint8.

    Parameters
    ----------
    values : float, any shape
        0..255; values outside are clipped, NaN becomes 0.

    Returns
    -------
    uint8, same shape
        The rounded values.
    """
    return np.rint(np.fmin(np.fmax(values, 0.0), 255.0)).astype(np.uint8)  # fmax(): NaN becomes 0
