"""The texels that cover a triangle, and the triangle's point nearest to a texel: kernels shared by atlas and bake.

Everything here is in texel units (texel (i, j) covers [i, i+1) x [j, j+1), centre at i+0.5, j+0.5) and float64: an atlas is a
convenience for viewers, not part of the normative decode.
"""

import math

from ..core.kernel import kernel


@kernel
def _clip_edge(x0, y0, x1, y1, low, high):
    """(x minimum, x maximum) of the part of an edge with low <= y <= high; (inf, -inf) if there is none."""
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y1 < low or y0 > high:
        return math.inf, -math.inf
    a, b = x0, x1
    if y0 < low:
        a = x0 + (x1 - x0) * ((low - y0) / (y1 - y0))
    if y1 > high:
        b = x0 + (x1 - x0) * ((high - y0) / (y1 - y0))
    return min(a, b), max(a, b)


@kernel
def span_in_band(ax, ay, bx, by, cx, cy, low, high):
    """(x minimum, x maximum) of a triangle inside the band low <= y <= high; (inf, -inf) if they do not meet.

    It is exact, because the extreme points of a convex shape cut by a band lie on its edges. Degenerate triangles are segments.
    """
    l0, h0 = _clip_edge(ax, ay, bx, by, low, high)
    l1, h1 = _clip_edge(bx, by, cx, cy, low, high)
    l2, h2 = _clip_edge(cx, cy, ax, ay, low, high)
    return min(l0, l1, l2), max(h0, h1, h2)


@kernel
def _nearest_on_edge(px, py, x0, y0, x1, y1):
    """(squared distance, parameter 0..1) of the point of an edge nearest to p."""
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    t = 0.0
    if length > 0.0:
        t = min(max(((px - x0) * dx + (py - y0) * dy) / length, 0.0), 1.0)
    ex, ey = x0 + t * dx - px, y0 + t * dy - py
    return ex * ex + ey * ey, t


@kernel
def nearest_on_triangle(px, py, ax, ay, bx, by, cx, cy):
    """(squared distance, weight of a, weight of b) of the triangle's point nearest to p; distance 0 if p is inside.

    The weight of c is 1 - a - b. Either winding; a degenerate triangle is treated as its longest segment.
    """
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area != 0.0:
        wa = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area
        wb = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area
        if wa >= 0.0 and wb >= 0.0 and wa + wb <= 1.0:
            return 0.0, wa, wb
    best, t = _nearest_on_edge(px, py, ax, ay, bx, by)
    wa, wb = 1.0 - t, t
    d, t = _nearest_on_edge(px, py, bx, by, cx, cy)
    if d < best:
        best, wa, wb = d, 0.0, 1.0 - t
    d, t = _nearest_on_edge(px, py, cx, cy, ax, ay)
    if d < best:
        best, wa, wb = d, t, 0.0
    return best, wa, wb
