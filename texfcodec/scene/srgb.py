"""The sRGB curve (IEC 61966-2-1), both ways, and colours as bytes; the one home of them."""

import numpy as np


def srgb_to_linear(v: np.ndarray) -> np.ndarray:
    """sRGB-coded 0..1 to linear 0..1, float64, any shape; values outside are clipped."""
    v = np.clip(np.asarray(v, np.float64), 0.0, 1.0)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(v: np.ndarray) -> np.ndarray:
    """Linear to sRGB-coded 0..1, float64, any shape; negative values count as 0."""
    v = np.maximum(np.asarray(v, np.float64), 0.0)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Values 0..255, any shape, rounded to uint8; those outside are clipped, and what is not a number becomes 0."""
    return np.nan_to_num(np.rint(np.clip(values, 0.0, 255.0)), nan=0.0).astype(np.uint8)
