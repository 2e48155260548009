"""Morton and Hilbert curves through grids of two and three dimensions, and how a list of values fills an image along them."""

import math

import numpy as np

CURVES = "morton", "hilbert"


def curve_keys(cells, bits, curve):
    """Return the position of every cell along a curve, int64 [N]. cells: coordinates, integer [N, D] in 0..2**bits - 1; curve:
    of CURVES. For both curves, a key without its last D bits is that of the cell twice as large around."""
    axes = np.array(np.asarray(cells).T, np.int64, order="C")
    if axes.size and (axes.min() < 0 or axes.max() >> bits):
        raise ValueError(f"a cell is outside of 0..{(1 << bits) - 1}")
    if curve == "hilbert":
        _turn(axes, bits)
        axes = axes[::-1]  # the first axis is the most significant one of a Hilbert digit, the last one of Morton's
    keys = np.zeros(axes.shape[1], np.int64)
    for bit in range(bits):
        for number, axis in enumerate(axes):
            keys |= ((axis >> bit) & 1) << (bit * len(axes) + number)
    return keys


def _turn(axes, bits):
    """Cells int64 [D, N] to the digits of their Hilbert keys, in place, bit by bit from the top (Skilling, "Programming the
    Hilbert curve", 2004): every cube is turned and mirrored as its place along the curve asks for, then Gray codes are undone."""
    first, others = axes[0], axes[1:]
    for bit in range(bits - 1, 0, -1):
        below = (1 << bit) - 1
        first ^= below * (first >> bit & 1)
        for axis in others:
            upper = (axis >> bit & 1).astype(bool)
            swapped = np.where(upper, 0, (first ^ axis) & below)
            first ^= np.where(upper, below, swapped)
            axis ^= swapped
    for number in range(1, len(axes)):
        axes[number] ^= axes[number - 1]
    flips = np.zeros_like(first)
    for bit in range(1, bits):
        flips ^= (axes[-1] >> bit & 1) * ((1 << bit) - 1)
    axes ^= flips


def image_size(count, tile):
    """Return (width, height) of an image that holds count values: about square, of whole tiles of `tile` pixels a side."""
    columns = max(math.ceil(math.sqrt(count) / tile), 1)
    return columns * tile, max(math.ceil(count / (columns * tile * tile)), 1) * tile


def image_places(count, tile, curve):
    """Return the pixel of each of count values, as index into the rows of the image of image_size(): int64 [count].

    Values fill tiles of `tile` pixels a side (a power of two), each along the 2D curve. Tiles go row by row; with the Hilbert
    curve every other row is mirrored, so that a row of tiles is one path without a jump.
    """
    width, height = image_size(count, tile)
    y, x = (a.ravel() for a in np.divmod(np.arange(tile * tile), tile))
    order = np.argsort(curve_keys(np.stack([x, y], axis=1), tile.bit_length() - 1, curve))
    x, y = x[order], y[order]  # the Hilbert curve leaves its tile at the end of the row on which it came in
    number, inside = np.divmod(np.arange(count), tile * tile)
    row, column = np.divmod(number, width // tile)
    at = column * tile + x[inside]
    at = np.where((row & 1 == 1) & (curve == "hilbert"), width - 1 - at, at)
    assert height * width >= count
    return (row * tile + y[inside]) * width + at


def to_image(values, tile, curve):
    """Return the image uint8 [height, width, C] of values uint8 [N, C], N >= 1; pixels left over repeat the last value."""
    width, height = image_size(len(values), tile)
    image = np.empty((height * width, values.shape[1]), np.uint8)
    image[:] = values[-1]
    image[image_places(len(values), tile, curve)] = values
    return image.reshape(height, width, -1)


def from_image(image, count, tile, curve):
    """Return the count values of an image of to_image(), [count, C]. Raises ValueError if the size of the image does not fit."""
    width, height = image_size(count, tile)
    if image.shape[:2] != (height, width):
        raise ValueError(f"the image decodes to {image.shape[1]} x {image.shape[0]} pixels where {width} x {height} were coded")
    return image.reshape(height * width, -1)[image_places(count, tile, curve)]
