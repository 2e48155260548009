"""SSIM in plain Python, pixel by pixel in double precision, with windows cut off at the image border."""

import math

RADIUS, SIGMA = 5, 1.5
C1, C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2


def window(y, x, height, width):
    """[(row, column, weight)] of the Gaussian window around (y, x), inside the image and of sum 1."""
    around = [
        (r, c, math.exp(-((r - y) ** 2 + (c - x) ** 2) / (2 * SIGMA**2)))
        for r in range(max(y - RADIUS, 0), min(y + RADIUS + 1, height))
        for c in range(max(x - RADIUS, 0), min(x + RADIUS + 1, width))
    ]
    total = sum(w for _, _, w in around)
    return [(r, c, w / total) for r, c, w in around]


def ssim_at(a, b, y, x):
    """SSIM of two planes, lists of rows, at one pixel."""
    around = window(y, x, len(a), len(a[0]))
    mean_a = sum(w * a[r][c] for r, c, w in around)
    mean_b = sum(w * b[r][c] for r, c, w in around)
    var_a = sum(w * (a[r][c] - mean_a) ** 2 for r, c, w in around)
    var_b = sum(w * (b[r][c] - mean_b) ** 2 for r, c, w in around)
    covariance = sum(w * (a[r][c] - mean_a) * (b[r][c] - mean_b) for r, c, w in around)
    light = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    return light * (2 * covariance + C2) / (var_a + var_b + C2)


def ssim_mean(a, b, mask):
    """Mean over the channels of a and b, lists of planes, and over the pixels where mask is set."""
    wanted = [(y, x) for y, row in enumerate(mask) for x, value in enumerate(row) if value]
    values = [ssim_at(p, q, y, x) for p, q in zip(a, b, strict=True) for y, x in wanted]
    return sum(values) / len(values)
