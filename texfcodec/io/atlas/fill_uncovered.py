"""Filling of unknown texels from the known texels around them, in the blocks that mip levels average."""

import numpy as np

_QUARTERS = [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]


def fill_uncovered(image: np.ndarray, known: np.ndarray) -> None:
    """Fill unknown texels from the known texels around them, in place, by push-pull; mip levels then have no gaps.

    image: uint8 [H, W, C]; known: bool [H, W], texels that have a value. Without any known texel the image stays as it is. No
    kernel: decoders without numba call this.
    """
    if known.any():
        _fill(np.moveaxis(image, 2, 0), known)


def _fill(planes, known):
    """The same for uint8 [C, H, W]."""
    if known.all():
        return
    coarse, coarse_known = _push(planes, known)
    _fill(coarse, coarse_known)
    for quarter in _QUARTERS:  # unknown texels take their coarse texel's colour, which is the average of a mip level
        fine, missing = planes[:, *quarter], ~known[quarter]
        np.copyto(fine, coarse[:, : missing.shape[0], : missing.shape[1]], where=missing)


def _push(planes, known):
    """(uint8 [C, H / 2, W / 2], the means of the known texels in blocks of 2 x 2; which blocks have any, bool)."""
    size = (known.shape[0] + 1) // 2, (known.shape[1] + 1) // 2
    total, count = np.zeros((len(planes), *size), np.uint16), np.zeros(size, np.uint16)
    for quarter in _QUARTERS:
        there = known[quarter]
        place = tuple(map(slice, there.shape))
        total[:, *place] += planes[:, *quarter] * there
        count[place] += there
    return ((total + count // 2) // np.maximum(count, 1)).astype(np.uint8), count > 0
