"""Colour error between corresponding samples (3D-PSNR), and its PSNR.

Colours are sRGB-coded RGB in 0..255, as floats; nothing is rounded or clipped. YUV is BT.709, full range. PSNR has peak 255 and
is float("inf") for an error of exactly zero. json_text.json_ready() turns that into None, and in_decibels() prints it as "exact".
"""

import math

import numpy as np

PEAK = 255.0
EXACT = "exact"  # the one word for a match without any error, where a PSNR is infinite; lossless is a way of coding
BLOCK = 1 << 16  # samples per step: 64 Ki rows of three doubles stay near the cache, whatever the total

# Rows Y, U, V for full-range BT.709; U and V lack their offset of 128, which cancels in every difference.
_KR, _KG, _KB = 0.2126, 0.7152, 0.0722
RGB_TO_YUV = np.array(
    [
        [_KR, _KG, _KB],
        [-_KR / (2 - 2 * _KB), -_KG / (2 - 2 * _KB), 0.5],
        [0.5, -_KG / (2 - 2 * _KR), -_KB / (2 - 2 * _KR)],
    ]
)


class ColourError:
    """Accumulates the colour error over any number of samples in the memory of one block.

    Call add() repeatedly, then result(). The split of the samples into calls changes only the last bits of the float64 sums.
    """

    def __init__(self) -> None:
        self.samples = 0
        self._weight = 0.0
        self._squares = np.zeros(6)  # y, u, v, r, g, b

    def add(self, ref: np.ndarray, got: np.ndarray, weights: np.ndarray | None = None) -> None:
        """Adds samples. ref, got: [N, 3] RGB in 0..255 (any real dtype); weights: [N] non-negative, or None for 1 each.

        Raises ValueError for shapes that do not agree and for values that are not finite.
        """
        ref, got = np.asarray(ref), np.asarray(got)
        if ref.ndim != 2 or ref.shape[1] != 3 or ref.shape != got.shape:
            raise ValueError(f"colours must both be [N, 3], not {list(ref.shape)} and {list(got.shape)}")
        if weights is not None:
            weights = np.asarray(weights, dtype=np.float64)
            if weights.shape != ref.shape[:1]:
                raise ValueError(f"weights must be [{len(ref)}], not {list(weights.shape)}")
            if not (np.isfinite(weights).all() and (weights >= 0).all()):
                raise ValueError("weights must be finite and not negative")
        for start in range(0, len(ref), BLOCK):
            part = slice(start, start + BLOCK)
            difference = got[part].astype(np.float64) - ref[part].astype(np.float64)
            squares = np.hstack([difference @ RGB_TO_YUV.T, difference]) ** 2
            if not np.isfinite(squares).all():
                raise ValueError(f"a colour among samples {start} to {start + len(difference) - 1} is not finite")
            w = np.ones(len(difference)) if weights is None else weights[part]
            self._squares += w @ squares
            self._weight += float(w.sum())
        self.samples += len(ref)

    @property
    def weight(self) -> float:
        """Sum of the weights of all samples; 0 if there are none."""
        return self._weight

    def mse(self) -> dict[str, float]:
        """Weighted mean squared errors {"y", "u", "v", "rgb"}; rgb is the mean over samples and channels."""
        if self._weight <= 0:
            raise ValueError("there are no samples, or all have weight zero: no error can be computed")
        y, u, v, r, g, b = (self._squares / self._weight).tolist()
        return {"y": y, "u": u, "v": v, "rgb": (r + g + b) / 3}

    def result(self) -> dict[str, float]:
        """{"samples", "mse_y", "mse_u", "mse_v", "mse_rgb", "psnr_y", "psnr_u", "psnr_v", "psnr_yuv611", "psnr_rgb"}."""
        mse = self.mse()
        return {"samples": self.samples, **{f"mse_{k}": m for k, m in mse.items()}, **psnr_of_mse(mse)}


def colour_mse(ref: np.ndarray, got: np.ndarray, weights: np.ndarray | None = None) -> dict[str, float]:
    """Mean squared errors {"y", "u", "v", "rgb"} of got against ref; arguments as in ColourError.add."""
    error = ColourError()
    error.add(ref, got, weights)
    return error.mse()


def psnr_3d(ref: np.ndarray, got: np.ndarray, weights: np.ndarray | None = None) -> dict[str, float]:
    """Return PSNR in dB {"psnr_y", "psnr_u", "psnr_v", "psnr_yuv611", "psnr_rgb"} of the colours got against ref at the same
    surface points; arguments as in ColourError.add."""
    return psnr_of_mse(colour_mse(ref, got, weights))


def psnr_of_mse(mse: dict[str, float]) -> dict[str, float]:
    """PSNR values of a colour_mse() dict; psnr_yuv611 is (6 Y + U + V) / 8 of the three values in dB, not of the errors."""
    y, u, v, rgb = (decibels(mse[k]) for k in ("y", "u", "v", "rgb"))
    return {"psnr_y": y, "psnr_u": u, "psnr_v": v, "psnr_yuv611": (6 * y + u + v) / 8, "psnr_rgb": rgb}


def decibels(mse: float, peak: float = PEAK) -> float:
    """Return the PSNR in dB of a mean squared error, 10 log10(peak^2 / mse); inf for mse 0. peak: the largest value."""
    if not mse >= 0:
        raise ValueError(f"a mean squared error cannot be {mse}")
    return math.inf if mse == 0 else 10 * math.log10(peak * peak / mse)


def in_decibels(value: float | None, digits: int = 2) -> str:
    """Format a PSNR in dB as text, "34.20 dB"; None, which json_text.json_ready() makes of inf, gives EXACT. digits:
    decimals."""
    return EXACT if value is None else f"{value:.{digits}f} dB"


