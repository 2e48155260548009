"""A smaller image whose bilinear picture on the surface is closest to that of the source's (encoder only).

With B the matrix that takes the small image's texels to the centres of the source's, s the source and W the surface that each of
its texels shows, this minimises |B t - s|^2 weighed by W, with some damping towards the mean of what a texel shows. B is the
product of one matrix for rows and one for columns, so that nothing larger than the source is ever made. """

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..asset.scene import WRAP_REPEAT

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

DAMPING = 0.02
ITERATIONS = 6


def resampled(image: np.ndarray, weight: np.ndarray, size: tuple[int, int], wrap: tuple[int, int]) -> np.ndarray:
    """The image at another size. image: float32 [H, W, C]; weight: float64 [H, W], at least 0, how much of the surface a texel
    shows; size: (width, height), at most the image's. Returns float32 [height, width, C] in 0..255; 0 where nothing is shown."""
    rows, columns = _bilinear(image.shape[0], size[1], wrap[1]), _bilinear(image.shape[1], size[0], wrap[0])
    weight = (weight / max(weight.mean(), 1e-30)).astype(np.float32)
    total = rows.T @ weight @ columns
    damping = np.float32(DAMPING * total[total > 0].mean() if (total > 0).any() else 1.0)
    out = np.empty((size[1], size[0], image.shape[2]), np.float32)
    for c in range(image.shape[2]):
        mean = (rows.T @ (weight * image[..., c]) @ columns) / np.maximum(total, np.float32(1e-12))
        error = weight * (image[..., c] - rows @ mean @ columns.T)
        change = _solve(lambda t: rows.T @ (weight * (rows @ t @ columns.T)) @ columns + damping * t, rows.T @ error @ columns)
        out[..., c] = np.clip(mean + change, 0, 255)
    return out


def _bilinear(fine, coarse, mode) -> csr_matrix:
    """Matrix float32 [fine, coarse] that reads a line of `coarse` texels at the centres of `fine` ones."""
    from scipy.sparse import csr_matrix  # here, because scipy takes long to import

    place = (np.arange(fine) + 0.5) * coarse / fine - 0.5
    low = np.floor(place).astype(np.int64)
    share = (place - low).astype(np.float32)
    both = np.stack([low, low + 1])
    both = both % coarse if mode == WRAP_REPEAT else np.clip(both, 0, coarse - 1)  # mirrored, the border repeats as when clamped
    lines = np.tile(np.arange(fine), 2)
    return csr_matrix((np.concatenate([1 - share, share]), (lines, both.ravel())), shape=(fine, coarse))


def _solve(apply, right):
    """x with apply(x) = right after ITERATIONS steps of conjugate gradients from 0."""
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
