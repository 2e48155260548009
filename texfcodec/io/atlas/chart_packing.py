"""Packing charts into a square: tallest first, each dropped onto the skyline of those before it (Levy et al. 2002, LSCM).

A chart rests on the skyline with its lower outline, not with its box. All outlines are widened by the padding, so that no two
charts come closer than twice the padding. Long lists end in a sweep instead of a search, which keeps the work linear.
"""

import math

import numpy as np

from ...core.kernel import kernel
from ...field.texel_cover import span_in_band

_ANGLES = 24  # directions tried over a quarter turn when a chart's smallest box is looked for
_SEARCHED = 3000  # charts placed by search over the whole width; the smaller ones after them search a window at the sweep
_WINDOW = 64  # columns
_TRIALS = 8  # densities tried; each packs everything once


def upright(flat: np.ndarray, chart: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Turn each chart so that its bounding box is smallest and upright, and move its corner to the origin.

    flat: float64 [F, 3, 2]; chart: int64 [F] in 0..count-1. Returns (flat float64 [F, 3, 2], extent float64 [count, 2]).
    """
    angle, box = np.zeros(count), np.full((count, 4), np.nan)
    for turn in np.arange(_ANGLES) * (math.pi / 2 / _ANGLES):
        candidate = np.tile(np.array([np.inf, np.inf, -np.inf, -np.inf]), (count, 1))
        _boxes(flat, chart, math.cos(turn), math.sin(turn), candidate)
        better = ~(_box_area(candidate) >= _box_area(box))
        angle[better], box[better] = turn, candidate[better]
    extent = box[:, 2:] - box[:, :2]
    cos, sin = np.cos(angle)[chart, None], np.sin(angle)[chart, None]
    x = flat[..., 0] * cos + flat[..., 1] * sin - box[chart, 0, None]
    y = flat[..., 1] * cos - flat[..., 0] * sin - box[chart, 1, None]
    wide = extent[:, 0] > extent[:, 1]
    lying = wide[chart, None]
    turned = np.stack([np.where(lying, y, x), np.where(lying, extent[chart, 0, None] - x, y)], -1)
    return np.maximum(turned, 0.0), np.where(wide[:, None], extent[:, ::-1], extent)


def pack_charts(flat: np.ndarray, chart: np.ndarray, extent: np.ndarray, side: int,
                padding: int) -> tuple[np.ndarray | None, float]:
    """Place upright charts in a square at the largest common scale that fits. Only a chart that would be larger than the square
    at that scale is shrunk further.

    flat, chart: of upright(); extent: size of each chart's box, as upright() returns it; side: of the square in texels; padding:
    texels around each chart. Returns (flat float64 [F, 3, 2] in texels of the square, the scale), or (None, 0.0) when the padding
    alone leaves no room.
    """
    count = len(extent)
    faces = np.argsort(chart, kind="stable")
    start = np.searchsorted(chart[faces], np.arange(count + 1))
    order = np.argsort(-extent[:, 1], kind="stable")
    area = float(flat_areas(flat).sum())
    scale = math.sqrt(0.8 * side * side / max(area, 1e-300))
    best, best_scale = None, 0.0
    ceiling, floor = math.inf, 0.0
    for _ in range(_TRIALS):
        own = np.minimum(scale, (side - 2 * padding - 2) / np.maximum(extent.max(1), 1e-300))
        place, half_turn = np.zeros((2, len(order), 2), np.int64)
        used = _pack(flat, faces, start, order, extent, own, side, padding, place, half_turn)
        if used <= side:
            best, best_scale, floor = (place, half_turn, own), scale, scale
            if used > 0.97 * side or (own < scale).all():
                break
        else:
            ceiling = min(ceiling, scale)
        scale = _next_scale(scale, side / max(used, 1), floor, ceiling)
    if best is None:
        return None, 0.0
    place, half_turn, own = best
    sign = np.where((half_turn > 0).any(1), -1, 1)[:, None]  # a turned chart is measured from the far corner of its texel box
    origin = place + half_turn + sign * padding
    return flat * (sign * own[:, None])[chart, None, :] + origin[chart, None, :], best_scale


def flat_areas(flat: np.ndarray) -> np.ndarray:
    """Return the areas float64 [F] of faces in the plane. flat: [F, 3, 2], their corners, in any unit."""
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * 0.5


def _next_scale(scale, room, floor, ceiling):
    """The next scale to try, between the bounds known so far; height grows roughly with the square of the scale."""
    guess = scale * math.sqrt(room) * 0.992
    if not floor < guess < ceiling:
        guess = 0.5 * (floor + ceiling) if ceiling < math.inf else scale * 1.2
    return guess


def _box_area(box):
    return (box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])


@kernel
def _boxes(flat, chart, cos, sin, box):
    """Widen the boxes [count, 4] = (x, y minima, x, y maxima) of all charts by their faces, turned by one angle."""
    for f in range(flat.shape[0]):
        c = chart[f]
        for i in range(3):
            x = flat[f, i, 0] * cos + flat[f, i, 1] * sin
            y = flat[f, i, 1] * cos - flat[f, i, 0] * sin
            box[c, 0], box[c, 1] = min(box[c, 0], x), min(box[c, 1], y)
            box[c, 2], box[c, 3] = max(box[c, 2], x), max(box[c, 3], y)


@kernel
def _outline(flat, members, scale, padding, low, high):
    """Write the lowest and highest texel row of each texel column of a chart's faces, widened by the padding; returns the width.

    low, high: int64 [>= width], overwritten; columns without a face keep low > high.
    """
    width = 0
    for col in range(len(low)):  # numba takes longer to compile what fills a slice
        low[col], high[col] = len(low) * 4, -1
    for f in members:
        ax, ay = flat[f, 0, 0] * scale + padding, flat[f, 0, 1] * scale + padding
        bx, by = flat[f, 1, 0] * scale + padding, flat[f, 1, 1] * scale + padding
        cx, cy = flat[f, 2, 0] * scale + padding, flat[f, 2, 1] * scale + padding
        first = max(math.ceil(min(ax, bx, cx) - padding - 0.5), 0)
        last = min(math.floor(max(ax, bx, cx) + padding - 0.5), len(low) - 1)
        width = max(width, last + 1)
        for col in range(first, last + 1):
            bottom, top = span_in_band(ay, ax, by, bx, cy, cx, col + 0.5 - padding, col + 0.5 + padding)
            if bottom <= top:
                low[col] = min(low[col], max(math.ceil(bottom - padding - 0.5), 0))
                high[col] = max(high[col], math.floor(top + padding - 0.5))
    return width


@kernel
def _rest_height(skyline, x, low, width, limit):
    """Row at which an outline comes to rest at column x, or limit if that row is not below limit."""
    row = 0
    for i in range(width):
        row = max(row, skyline[x + i] - low[i])
        if row >= limit:
            return limit
    return row


@kernel
def _find_place(skyline, low, width, first, last):
    """(x, row) of the lowest resting place with first <= x <= last, the leftmost of equals."""
    best_x, best_row = first, _rest_height(skyline, first, low, width, 1 << 40)
    for x in range(first + 1, last + 1):
        row = _rest_height(skyline, x, low, width, best_row)
        if row < best_row:
            best_x, best_row = x, row
    return best_x, best_row


@kernel
def _turn(low, high, width):
    """Turn an outline by half a turn in place; returns its height in texels."""
    height = 0
    for i in range(width):
        height = max(height, high[i] + 1)
    for i in range((width + 1) // 2):
        j = width - 1 - i
        low[i], high[i], low[j], high[j] = height - 1 - high[j], height - 1 - low[j], height - 1 - high[i], height - 1 - low[i]
    return height


@kernel
def _lay(skyline, low, high, width, x, row):
    """Raise the skyline over an outline put down at (x, row); returns the new highest row among its columns."""
    used = 0
    for i in range(width):
        if high[i] >= low[i]:
            skyline[x + i] = row + high[i] + 1
            used = max(used, skyline[x + i])
    return used


@kernel(allocates=True)
def _pack(flat, faces, start, order, extent, scales, side, padding, place, half_turn):
    """Place every chart in order, giving up once the height exceeds four sides; returns the height.

    Writes place int64 [n, 2] and half_turn int64 [n, 2]: the texel box of charts placed upside down; zeros stay for the others.
    Bounds: width <= side because scales limit every extent to side - 2 padding - 2.
    """
    skyline = np.zeros(side + 1, np.int64)
    low, high = np.empty(side, np.int64), np.empty(side, np.int64)
    used, cursor = 0, 0
    for rank in range(len(order)):
        c = order[rank]
        columns = min(side, int(extent[c, 0] * scales[c]) + 2 * padding + 2)
        width = _outline(flat, faces[start[c] : start[c + 1]], scales[c], padding, low[:columns], high[:columns])
        first, last = 0, side - width
        if rank >= _SEARCHED:
            first = cursor if cursor <= last else 0
            last = min(last, first + _WINDOW)
        x, row = _find_place(skyline, low, width, first, last)
        height = _turn(low, high, width)
        other_x, other_row = _find_place(skyline, low, width, first, last)
        if other_row < row:
            x, row = other_x, other_row
            half_turn[c, 0], half_turn[c, 1] = width, height
        else:
            _turn(low, high, width)
        place[c, 0], place[c, 1] = x, row
        cursor = first + width  # not x + width: jumping to the lowest place would leave the passed ground unfilled
        used = max(used, _lay(skyline, low, high, width, x, row))
        if used > 4 * side:
            break
    return used
