"""Padding between the charts of an atlas: beyond a chart's border it shows the surface of the neighbouring chart.

A texel of a mip level on a border averages texels inside and outside the chart. If the texels outside show the surface beyond the
border, both charts of a seam average the same piece of surface and agree. If they repeat the chart's own colours, each chart
shows the surface half a texel inside it. Measured on bball_0001 and ycb_scissors at r03: mean jumps at mip levels 1, 2 and 3
fall from 2.3, 4.8, 8.5 and 2.2, 4.3, 6.9 to 1.7, 2.8, 6.0 and 1.7, 2.9, 5.1. With eight texels, levels 2 and 3 fall to 2.0, 3.5
and 1.7, 2.4, but pictures with mip levels are then 0.2 and 0.3 dB further from the source, in place of 0.05 dB, because the
surface beyond a border differs from that inside. Across sharp edges it differs most: they are left out. Charts twice as far apart
gain nothing.
"""

import numpy as np

from ...core.kernel import kernel
from .system import AtlasSystem

REACH = 2  # texels
LEVEL = 0.7  # least cosine between the faces on both sides


def continue_over_borders(image: np.ndarray, system: AtlasSystem) -> np.ndarray:
    """Fill uncovered texels within REACH of a chart's border with the values of the chart across that border, in place.

    image: uint8 [H, W, C], with its covered texels baked. Borders on sharp edges of the surface are skipped. Returns whether each
    texel was filled, bool [H, W]."""
    half, ends = system.borders
    level = (system.normals(half[0] // 3) * system.normals(half[1] // 3)).sum(axis=1) > LEVEL
    half, ends = half[:, level], np.ascontiguousarray(ends[:, level])
    nearness = np.full(system.owner.shape, np.inf, np.float32)
    third = system.texels[half // 3, (half % 3 + 2) % 3]
    _continue(ends, third, system.charts[half // 3], system.owner, system.charts, image, nearness, np.empty(2))
    return np.isfinite(nearness)


@kernel
def _across(x, y, ends, third, pair, own, place):
    """Write the position on the other side of a pair of edges, for a point (x, y) beyond the border of side `own`, to place
    float64 [2]. Returns the point's squared distance from the border, -1 if it is not beyond it or the edges have no length."""
    ax, ay = ends[own, pair, 0, 0], ends[own, pair, 0, 1]
    dx, dy = ends[own, pair, 1, 0] - ax, ends[own, pair, 1, 1] - ay
    other = 1 - own
    ex, ey = ends[other, pair, 1, 0] - ends[other, pair, 0, 0], ends[other, pair, 1, 1] - ends[other, pair, 0, 1]
    length, beyond = np.sqrt(dx * dx + dy * dy), np.sqrt(ex * ex + ey * ey)
    if length < 1e-6 or beyond < 1e-6:
        return -1.0
    away = ((x - ax) * dy - (y - ay) * dx) / length
    inside = (third[own, pair, 0] - ax) * dy - (third[own, pair, 1] - ay) * dx
    if away * inside >= 0.0:
        return -1.0
    t = ((x - ax) * dx + (y - ay) * dy) / (length * length)
    over = max(-t, t - 1.0, 0.0) * length
    turn = (third[other, pair, 0] - ends[other, pair, 0, 0]) * ey - (third[other, pair, 1] - ends[other, pair, 0, 1]) * ex
    depth = abs(away) * beyond / length * (1.0 if turn > 0.0 else -1.0)
    place[0] = ends[other, pair, 0, 0] + t * ex + depth * ey / beyond
    place[1] = ends[other, pair, 0, 1] + t * ey - depth * ex / beyond
    return away * away + over * over


@kernel
def _continue(ends, third, edge_chart, owner, chart, image, nearness, place):
    """See continue_over_borders(); place: float64 [2], overwritten. Reads texels with an owner and writes texels without, so that
    only the order of equally near edges matters, which is fixed. Bounds: rows and columns are clipped to the image before they
    index it."""
    height, width = owner.shape
    for pair in range(ends.shape[1]):
        for own in range(2):
            x0, x1 = ends[own, pair, 0, 0], ends[own, pair, 1, 0]
            y0, y1 = ends[own, pair, 0, 1], ends[own, pair, 1, 1]
            for row in range(max(int(min(y0, y1)) - REACH, 0), min(int(max(y0, y1)) + REACH, height - 1) + 1):
                for column in range(max(int(min(x0, x1)) - REACH, 0), min(int(max(x0, x1)) + REACH, width - 1) + 1):
                    if owner[row, column] >= 0:
                        continue
                    distance = _across(column + 0.5, row + 0.5, ends, third, pair, own, place)
                    if distance < 0.0 or distance > REACH * REACH or distance >= nearness[row, column]:
                        continue
                    if _look_up(place[0] - 0.5, place[1] - 0.5, owner, chart, edge_chart[1 - own, pair], image, row, column):
                        nearness[row, column] = distance


@kernel
def _look_up(x, y, owner, chart, wanted, image, row, column):
    """Write the bilinear look-up at (x, y), in texels from the centre of the first, to a texel, if all texels that it reads are
    in the wanted chart; returns whether they are. Bounds: c and r are compared with the image before they index it."""
    c, r = int(np.floor(x)), int(np.floor(y))
    if c < 0 or r < 0 or c + 1 >= owner.shape[1] or r + 1 >= owner.shape[0]:
        return False
    for i in range(2):
        for j in range(2):
            face = owner[r + i, c + j]
            if face < 0 or chart[face] != wanted:
                return False
    u, v = x - c, y - r
    for k in range(image.shape[2]):
        upper = image[r, c, k] * (1.0 - u) + image[r, c + 1, k] * u
        lower = image[r + 1, c, k] * (1.0 - u) + image[r + 1, c + 1, k] * u
        image[row, column, k] = np.uint8(upper * (1.0 - v) + lower * v + 0.5)
    return True
