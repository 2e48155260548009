"""The texels that a textured surface references: an exact rasterisation with wrap (spec clause 6.5).

A face references a texel if bilinear interpolation at some point of the face weighs it, that is if the face meets the open square
of two texels a side around the texel's centre. In each row, the columns of these squares form a range. Ranges are added to a
table of differences, so neither the order of the faces nor their number of turns around a tiled image matters.
"""

import numpy as np

from ..core.kernel import kernel
from ..errors import LimitError
from ..scene.fetch import _wrapped
from ..scene.scene import WRAP_CLAMP, WRAP_REPEAT
from .morton import _morton_key, encode_morton

MOST_IN_32_BITS = 1 << 30  # rows; each adds at most 2 to a texel
MAX_UV = 1 << 26  # of a coordinate in steps: products of the rasterisation stay below 2**61
SIDE = 16  # of the squares that are looked through in Morton order
COLUMN, ROW = np.array([[sum((place >> 2 * b + axis & 1) << b for b in range(4)) for place in range(SIDE * SIDE)]
                        for axis in (0, 1)])
KEY = encode_morton(np.stack([COLUMN, ROW, np.zeros_like(ROW)], axis=1))


@kernel
def _rows_of(low, high, fraction):
    """First and last row (or column) whose open squares reach into low..high, in half steps."""
    half = np.int64(1) << fraction
    return (low - half) // (2 * half), (high + half - 1) // (2 * half)


@kernel
def _count_rows(uv, faces, fraction):
    """Rows of all faces, the measure of the work."""
    total = np.int64(0)
    for f in range(faces.shape[0]):
        a, b, c = 2 * uv[faces[f, 0], 1], 2 * uv[faces[f, 1], 1], 2 * uv[faces[f, 2], 1]
        first, last = _rows_of(min(a, b, c), max(a, b, c), fraction)
        total += last - first + 1
    return total


@kernel
def _edge_columns(xa, ya, xb, yb, low, high, half):
    """Columns (first, last) whose squares meet the part of an edge within low <= y <= high; first > last if there are none.

    All in half steps, with coordinates below 2**27, so numerators stay below 2**57.
    """
    if ya > yb:
        xa, ya, xb, yb = xb, yb, xa, ya
    if yb < low or ya > high:
        return np.int64(1) << 40, -(np.int64(1) << 40)
    height = yb - ya
    first, last = np.int64(1) << 40, -(np.int64(1) << 40)
    for end in range(2):
        if end == 0:
            number, share = (xa, np.int64(1)) if ya >= low else (xa * height + (xb - xa) * (low - ya), height)
        else:
            number, share = (xb, np.int64(1)) if yb <= high else (xa * height + (xb - xa) * (high - ya), height)
        first = min(first, (number - half * share) // (2 * half * share))
        last = max(last, -((-number - half * share) // (2 * half * share)) - 1)
    return first, last


@kernel
def _add_range(row, first, last, size, mode, share, table):
    """Adds share to columns first..last, wrapped into 0..size-1, of row `row` of the differences."""
    count = last - first + 1
    if mode == WRAP_CLAMP:
        table[row, min(max(first, 0), size - 1)] += share
        table[row, min(max(last, 0), size - 1) + 1] -= share
        return
    period = size if mode == WRAP_REPEAT else 2 * size
    if count >= period:
        table[row, 0] += share
        table[row, size] -= share
        return
    begin = first % period
    end = begin + count
    for turn in range(4):  # begin..end-1 is below 4 sizes; odd turns run backwards where the image is mirrored
        low, high = max(begin, turn * size) - turn * size, min(end, (turn + 1) * size) - turn * size
        if low >= high:
            continue
        if mode != WRAP_REPEAT and turn & 1:
            low, high = size - high, size - low
        table[row, low] += share
        table[row, high] -= share


@kernel
def _rasterise(uv, faces, fraction, wrap_s, wrap_t, shares, table):
    """Adds the share of every face to the columns of each of its rows in table [height, width + 1]. shares: [F], of the table's
    type, which can hold twice their sum. The caller has checked that faces index uv. |uv| < MAX_UV: coordinates below 2**27."""
    height, width = table.shape[0], table.shape[1] - 1
    half = np.int64(1) << fraction
    for f in range(faces.shape[0]):
        ax, ay = 2 * uv[faces[f, 0], 0], 2 * uv[faces[f, 0], 1]
        bx, by = 2 * uv[faces[f, 1], 0], 2 * uv[faces[f, 1], 1]
        cx, cy = 2 * uv[faces[f, 2], 0], 2 * uv[faces[f, 2], 1]
        top, bottom = _rows_of(min(ay, by, cy), max(ay, by, cy), fraction)
        for row in range(top, bottom + 1):
            low, high = 2 * half * row - half, 2 * half * (row + 1) + half
            first0, last0 = _edge_columns(ax, ay, bx, by, low, high, half)
            first1, last1 = _edge_columns(bx, by, cx, cy, low, high, half)
            first2, last2 = _edge_columns(cx, cy, ax, ay, low, high, half)
            first, last = min(first0, first1, first2), max(last0, last1, last2)
            if first <= last:
                _add_range(_wrapped(row, height, wrap_t), first, last, width, wrap_s, shares[f], table)


@kernel
def _sum_rows(table):
    """Replaces the columns but the last of every row by their running sum. Returns how many sums are not zero."""
    n = np.int64(0)
    for y in range(table.shape[0]):
        total = table[y, 0] - table[y, 0]  # zero of the table's type
        for x in range(table.shape[1] - 1):
            total += table[y, x]
            table[y, x] = total
            n += total > 0
    return n


@kernel
def _every_second(v):
    """Gathers every second bit of 0 <= v < 2**32, from bit 0 on."""
    v = v & 0x55555555
    v = (v | (v >> 1)) & 0x33333333
    v = (v | (v >> 2)) & 0x0F0F0F0F
    v = (v | (v >> 4)) & 0x00FF00FF
    return (v | (v >> 8)) & 0xFFFF


@kernel
def _keys_of(table, squares, keys):
    """Fills keys with the ascending Morton keys of the texels whose running sum is not zero. squares: the least power of 4 of
    squares that cover the table."""
    n, height, width = 0, table.shape[0], table.shape[1] - 1
    for square in range(squares):
        left, top = SIDE * _every_second(square), SIDE * _every_second(square >> 1)
        if left >= width or top >= height:
            continue
        first = _morton_key(left, top, np.int64(0))
        for i in range(SIDE * SIDE):
            x, y = left + COLUMN[i], top + ROW[i]
            if x < width and y < height and table[y, x] > 0 and n < keys.shape[0]:
                keys[n] = first | KEY[i]
                n += 1


def count_rows(uv: np.ndarray, faces: np.ndarray, fraction_bits: int) -> int:
    """Return the number of rows of texels, over all faces, that referenced_texels() would visit, as a measure of its time.
    Arguments as there."""
    return int(_count_rows(uv, faces, fraction_bits))


def referenced_texels(uv: np.ndarray, faces: np.ndarray, fraction_bits: int, size: tuple[int, int], wrap: tuple[int, int],
                      most: int | None = None) -> np.ndarray:
    """Return ascending Morton keys, int64 [N], of the texels of an image that the faces of a surface reference.

    uv: int64 [V, 2] in steps of 2**-fraction_bits texels, of magnitude below MAX_UV; faces: int64 [F, 3] in 0..V-1; size:
    (width, height), at most layout.MAX_SIDE each; wrap: modes (s, t) of scene.scene. Raises LimitError TXF-L04 if there are more
    than `most` texels.
    """
    rows = count_rows(uv, faces, fraction_bits)
    table = np.zeros((size[1], size[0] + 1), np.int32 if rows < MOST_IN_32_BITS else np.int64)
    shares = np.ones(len(faces), table.dtype)
    _rasterise(np.ascontiguousarray(uv), np.ascontiguousarray(faces), fraction_bits, *wrap, shares, table)
    count = int(_sum_rows(table))
    if most is not None and count > most:
        raise LimitError("TXF-L04", "the fields have more values than the limit allows", clause="6.5", value=count, allowed=most)
    keys = np.empty(count, np.int64)
    _keys_of(table, 4 ** ((max(size) - 1) // SIDE).bit_length(), keys)
    return keys


def shown_area(uv: np.ndarray, faces: np.ndarray, fraction_bits: int, size: tuple[int, int], wrap: tuple[int, int],
               area: np.ndarray) -> np.ndarray:
    """Approximate area of the surface that each texel shows, float64 [height, width]: a face spreads its area evenly over the
    texels that it references. area: float64 [F]; the others as in referenced_texels(). Encoder only."""
    table = np.zeros((size[1], size[0] + 1))
    corners = uv[faces].astype(np.float64) / (1 << fraction_bits)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    texels = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    _rasterise(np.ascontiguousarray(uv), np.ascontiguousarray(faces), fraction_bits, *wrap, area / np.maximum(texels, 1.0), table)
    return np.maximum(np.cumsum(table[:, :-1], axis=1), 0.0)
