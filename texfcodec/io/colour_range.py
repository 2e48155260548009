"""The range of colours, 0 to 1, 255 or 65535, in formats that do not define it: guessed from the stored type and all values."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..report import plural

if TYPE_CHECKING:
    from .parts import Notes

_BRIGHT = 10.0  # what colours in 0..1 may reach by a fault or by bright light; all of 0..255 below it would be black
_OVER = 2.0  # times a larger range that values may reach
_NEAR = 1e-6


def unit_colours(values: np.ndarray, notes: Notes, what: str) -> np.ndarray:
    """Colours [..., channels], stored as integers or floats -> float64 in [0, 1]; NaN stays.

    The range of 8-bit integers is 255. The range of all others is 1, 255 or 65535, chosen by the median and the maximum of the
    non-zero values, so that a few outliers do not change it. Outliers and negative values are clipped, with a remark. Alpha, the
    last of two or four channels, may have its own range. what: the values' name in remarks, such as "colours of vertices".
    """
    values = np.asarray(values)
    if values.dtype == np.int8:
        values = values.view(np.uint8)  # a char that an exporter holds for a byte
    if values.dtype == np.uint8:
        return values / 255.0
    stored = values.astype(np.float64)
    width = stored.shape[-1] if stored.ndim else 1
    colours = stored[..., : width - 1] if width in (2, 4) else stored
    reach = _reach(colours, values.dtype.kind)
    out = stored / reach
    if width in (2, 4) and reach > 1.0:
        out[..., -1] = stored[..., -1] / (reach if _largest(stored[..., -1]) > _OVER else 1.0)
    if reach > 1.0 and (np.nan_to_num(stored) % 1.0).any():  # whole numbers are what such a range is for
        notes.remark(f"{what} are read as 0..{reach:.0f}")
    return clipped(out, notes, what)


def clipped(colours: np.ndarray, notes: Notes, what: str) -> np.ndarray:
    """Colours [..., channels] clipped to [0, 1], with a remark if that changes any; NaN stays. what: their name in the remark."""
    outside = (colours < -_NEAR) | (colours > 1.0 + _NEAR)
    if outside.any():
        count = int(outside.any(axis=-1).sum())
        notes.remark(f"{what}: " + plural(count, "value is", "values are") + " outside the range and clipped")
    return np.clip(colours, 0.0, 1.0)


def _reach(values, kind):
    """Upper end of the values' range: 1, 255 or 65535. kind: "f" for floats, else integers."""
    shown = np.abs(values[np.isfinite(values) & (values != 0)])
    if not len(shown):
        return 1.0
    largest, middle = float(shown.max()), float(np.median(shown))
    if largest > 255.0 * _OVER and middle > 255.0:
        return 65535.0
    return 255.0 if (largest > 1.0 if kind != "f" else largest > _BRIGHT and middle > 1.0) else 1.0


def _largest(values):
    finite = values[np.isfinite(values)]
    return float(finite.max()) if finite.size else 0.0
