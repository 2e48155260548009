"""Curves through points that rise and fall only where the points do: piecewise cubic Hermite interpolation (PCHIP).

Slopes at the points are those of Fritsch and Butland (1984): a weighted harmonic mean of the slopes beside a point, 0 where these
differ in sign; at both ends a parabola through three points, held back where it would overshoot.
"""

import numpy as np


class Pchip:
    """The shape-preserving cubic curve (PCHIP) through points (x, y).

    Parameters
    ----------
    x : float64 [N >= 2]
        Rising.
    y : float64 [N] or [N, C]
        Values.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        self._x = np.asarray(x, np.float64)
        self._y = np.asarray(y, np.float64).reshape(len(x), -1)
        self._shape = np.shape(y)[1:]
        width = np.diff(self._x)[:, None]
        rise = np.diff(self._y, axis=0) / width
        slope = _slopes(width, rise)
        bend = (slope[:-1] + slope[1:] - 2 * rise) / width
        self._powers = np.stack([self._y[:-1], slope[:-1], (rise - slope[:-1]) / width - bend, bend / width])  # of 1, t, t^2, t^3

    def __call__(self, at: np.ndarray | float) -> np.ndarray:
        """Values float64 at points within the range of x, of the shape of at, followed by [C] if y has columns."""
        where = np.asarray(at, np.float64)
        piece, t = self._pieces(where.reshape(-1))
        zeroth, first, second, third = self._powers[:, piece]
        return (zeroth + t * (first + t * (second + t * third))).reshape(where.shape + self._shape)

    def integrate(self, low: float, high: float) -> np.ndarray:
        """Integrate the curve between two places within the range of x.

        Parameters
        ----------
        low, high : float
            Ends of the interval on the x axis.

        Returns
        -------
        float64 or float64 [C]
            The integral; [C] if y has columns.
        """
        begin, end = np.maximum(self._x[:-1], low), np.minimum(self._x[1:], high)
        below, above = (np.where(begin < end, bound, self._x[:-1])[:, None] - self._x[:-1, None] for bound in (begin, end))
        steps = sum(power / (n + 1) * (above ** (n + 1) - below ** (n + 1)) for n, power in enumerate(self._powers))
        return np.sum(steps, axis=0).reshape(self._shape)

    def _pieces(self, at):
        piece = np.clip(np.searchsorted(self._x, at, side="right") - 1, 0, len(self._x) - 2)
        return piece, (at - self._x[piece])[:, None]


def _slopes(width, rise):
    if len(rise) == 1:
        return np.concatenate([rise, rise])
    out = np.zeros((len(rise) + 1, rise.shape[1]))
    before, after = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    same = rise[:-1] * rise[1:] > 0
    safe = np.where(same, rise[:-1], 1.0), np.where(same, rise[1:], 1.0)
    out[1:-1] = np.where(same, 1 / ((before / safe[0] + after / safe[1]) / (before + after)), 0.0)
    out[0], out[-1] = _end(width[0], width[1], rise[0], rise[1]), _end(width[-1], width[-2], rise[-1], rise[-2])
    return out


def _end(width, next_width, rise, next_rise):
    """Slope at an end of the curve. width: of the last piece."""
    slope = ((2 * width + next_width) * rise - width * next_rise) / (width + next_width)
    too_steep = (np.sign(rise) != np.sign(next_rise)) & (np.abs(slope) > 3 * np.abs(rise))
    return np.where(np.sign(slope) != np.sign(rise), 0.0, np.where(too_steep, 3 * rise, slope))
