"""Filling of unknown texels from the known texels around them, in the blocks that mip levels average."""

import numpy as np

from ...core.kernel import kernel


def fill_uncovered(image: np.ndarray, known: np.ndarray) -> None:
    """Fill unknown texels from the known texels around them, in place, by push-pull; mip levels then have no gaps.

    image: uint8 [H, W, C]; known: bool [H, W], texels that have a value. Without any known texel the image stays as it is.
    """
    if known.all() or not known.any():
        return
    coarse = np.zeros(((image.shape[0] + 1) // 2, (image.shape[1] + 1) // 2, image.shape[2]), np.uint8)
    coarse_known = np.zeros(coarse.shape[:2], np.bool_)
    _push(image, known, coarse, coarse_known)
    fill_uncovered(coarse, coarse_known)
    _pull(image, known, coarse)


@kernel
def _push(image, known, coarse, coarse_known):
    """Each coarse texel is the mean of its known fine texels."""
    for row in range(coarse.shape[0]):
        for col in range(coarse.shape[1]):
            rows, cols = min(2 * row + 2, image.shape[0]), min(2 * col + 2, image.shape[1])
            count = 0
            for r in range(2 * row, rows):
                for c in range(2 * col, cols):
                    count += known[r, c]
            if count == 0:
                continue
            coarse_known[row, col] = True
            for k in range(image.shape[2]):
                total = count // 2
                for r in range(2 * row, rows):
                    for c in range(2 * col, cols):
                        if known[r, c]:
                            total += image[r, c, k]
                coarse[row, col, k] = total // count


@kernel
def _pull(image, known, coarse):
    """Unknown fine texels take their coarse texel's colour, which is the average of a mip level."""
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            if not known[row, col]:
                for k in range(image.shape[2]):
                    image[row, col, k] = coarse[row // 2, col // 2, k]
