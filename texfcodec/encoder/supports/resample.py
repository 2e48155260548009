"""A smaller image whose bilinear picture on the surface is closest to that of the source's (encoder only).

With B the matrix from the small image's texels to the centres of the source's, s the source and W the area of the surface that
shows each source texel, this minimises |B t - s|^2 weighted by W, with some damping towards the mean of the source under a texel.
B is bilinear in rows and columns, so each step is one walk over the source's rows and needs no larger memory than the source.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ...core.kernel import kernel
from ...scene.scene import WRAP_REPEAT

DAMPING = 0.02
ITERATIONS = 6


def resampled(image: np.ndarray, weight: np.ndarray, size: tuple[int, int], wrap: tuple[int, int],
              threads: int = 1) -> np.ndarray:
    """Return the image at another size, float32 [height, width, C] in 0..255; 0 for texels that are not shown. image: uint8 or
    float32 [H, W, C]; weight: float64 [H, W], at least 0, area of the surface that shows a texel; size: (width, height), at most
    the image's. The result does not depend on threads."""
    lines = (*_lines(image.shape[0], size[1], wrap[1]), *_lines(image.shape[1], size[0], wrap[0]))
    weight = (weight / max(weight.mean(), 1e-30)).astype(np.float32)
    out = np.empty((size[1], size[0], image.shape[2]), np.float32)

    def column(c):
        out[..., c] = _fitted(np.ascontiguousarray(image[..., c], np.float32), weight, lines, out.shape[:2])

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        list(pool.map(column, range(image.shape[2])))
    return out


def _lines(fine, coarse, mode):
    """Return the places of the centres of `fine` texels between `coarse` ones: the texel before int64 [fine], the one after, its
    share."""
    place = (np.arange(fine) + 0.5) * coarse / fine - 0.5
    low = np.floor(place).astype(np.int64)
    both = np.stack([low, low + 1])
    both = both % coarse if mode == WRAP_REPEAT else np.clip(both, 0, coarse - 1)  # mirrored, the border repeats as when clamped
    return both[0], both[1], (place - low).astype(np.float32)


def _fitted(channel, weight, lines, shape):
    """Return one channel, float32 [H, W], at another size."""
    zeros, ones = np.zeros(shape, np.float32), np.zeros((1, 1), np.float32)
    total, right = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    _pull(zeros, np.ones_like(channel), weight, *lines, total)
    _pull(zeros, channel, weight, *lines, right)
    mean = right / np.maximum(total, np.float32(1e-12))
    damping = np.float32(DAMPING * total[total > 0].mean() if (total > 0).any() else 1.0)

    def apply(t):
        image = np.zeros(shape, np.float32)
        _pull(t, ones, weight, *lines, image)
        return damping * t - image

    error = np.zeros(shape, np.float32)
    _pull(mean, channel, weight, *lines, error)
    return np.clip(mean + _solve(apply, error), 0, 255)


@kernel(allocates=True)
def _pull(t, target, weight, row0, row1, row_share, column0, column1, column_share, out):
    """Add B^T W (target - B t) to out, float32 like t; a target of a single value is constant."""
    flat = target.shape[0] == 1 and target.shape[1] == 1
    line = np.empty(t.shape[1], np.float32)
    for y in range(weight.shape[0]):
        a, b, v = row0[y], row1[y], row_share[y]
        line[:] = 0.0
        for x in range(weight.shape[1]):
            w = weight[y, x]
            if w == 0.0:
                continue
            c, d, u = column0[x], column1[x], column_share[x]
            shown = (1 - v) * ((1 - u) * t[a, c] + u * t[a, d]) + v * ((1 - u) * t[b, c] + u * t[b, d])
            error = w * ((target[0, 0] if flat else target[y, x]) - shown)
            line[c] += (1 - u) * error
            line[d] += u * error
        for x in range(t.shape[1]):
            out[a, x] += (1 - v) * line[x]
            out[b, x] += v * line[x]


def _solve(apply: Callable[[np.ndarray], np.ndarray], right: np.ndarray) -> np.ndarray:
    """Return x with apply(x) = right after ITERATIONS steps of conjugate gradients from 0."""
    x, residual = np.zeros_like(right), right.copy()
    direction, power = residual.copy(), float((residual * residual).sum(dtype=np.float64))
    for _ in range(ITERATIONS):
        if power <= 1e-12:
            break
        image = apply(direction)
        step = np.float32(power / max(float((direction * image).sum(dtype=np.float64)), 1e-30))
        x += step * direction
        residual -= step * image
        before, power = power, float((residual * residual).sum(dtype=np.float64))
        direction = residual + np.float32(power / before) * direction
    return x
