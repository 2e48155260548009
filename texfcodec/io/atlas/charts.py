"""Charts for the fast atlas: edge-connected, front-facing, free of overlap, grown in one linear pass over any triangle soup."""

import math

import numpy as np

from ...core.kernel import kernel
from ...field.texel_cover import nearest_on_triangle, span_in_band
from .chart_packing import flat_areas, upright

FACING = 0.6  # a face joins when its own normal is within acos(0.6) = 53 degrees of the chart axis: stretch up to 1.67,
STEEPEST = 0.25  # or within 75 degrees while the smoothed normal is within 53: keeps the noise of scans inside a chart
DEPTH_TOLERANCE = 4.0  # texels; one smooth sheet seen twice within two texels differs by at most 2 * sqrt(2) * tan(53 deg) = 3.8
OVERLAP_TOLERANCE = 0.05  # texels; for centres inside both faces: only a shared edge or a duplicate face may do that
_ROUNDS = 4
_GRID = 2048  # side of the overlap grid in cells, a power of two; no chart is larger than this less a rim


def grow_charts(points: np.ndarray, faces: np.ndarray, groups: np.ndarray,
                largest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Partition faces into charts that project onto a plane without overlapping themselves.

    points: float64 [V, 3] in texels at the intended density; faces: int64 [F, 3]; groups: int64 [F], charts never mix
    groups; largest: texels a chart may extend.
    Returns (flat float64 [F, 3, 2], chart int64 [F], extent float64 [n, 2]): corners in texels, in an upright chart whose box has
    a corner at the origin, with the mean stretch of the projection undone; chart of each face, 0..n-1; size of each chart's box.
    Work is linear in faces and covered texels. Charts that fill little of their box (frames, rings) are grown again, smaller.
    """
    points = np.ascontiguousarray(points)
    normals, areas = _normals(points, faces)
    ahead, behind = _edge_rings(faces)
    smooth = _smoothed(normals * areas[:, None], ahead)
    axes = np.where((smooth * normals).sum(1, keepdims=True) < 0.8, normals, smooth)  # a seed must face its own chart
    frames, order = _frames(axes), np.argsort(-areas, kind="stable")
    stamp, depth = np.full((_GRID, _GRID), -1, np.int64), np.zeros((_GRID, _GRID), np.float32)
    chart, flat = np.full(len(faces), -1, np.int64), np.zeros((len(faces), 3, 2))
    limit = np.full(len(faces), min(float(largest), _GRID - 8.0))
    first, extents = 0, np.zeros((0, 2))  # chart numbers are never used twice: the stamps of earlier rounds stay
    again, turned = np.ones(len(faces), bool), np.zeros_like(flat)
    for round_ in range(_ROUNDS):
        _grow(points, faces, groups, normals, smooth, frames, order, ahead, behind, stamp, depth, limit, first, chart, flat)
        turned[again], extent = upright(flat[again], chart[again] - first, int(chart.max()) + 1 - first)
        extents = np.concatenate([extents, extent])
        filled = np.bincount(chart) > 0
        dense, extent = (np.cumsum(filled) - 1)[chart], extents[filled]
        hollow = _is_hollow(turned, dense, extent)
        if round_ == _ROUNDS - 1 or not hollow.any():
            break
        first, again = int(chart.max()) + 1, hollow[dense]
        limit[again] = 0.5 * extent[dense[again]].max(1)
        chart[again] = -1
    stretch = _stretch(turned, dense, areas, len(extent))
    return turned * stretch[dense, None, None], dense, extent * stretch[:, None]


def _is_hollow(flat, chart, extent):
    """Return whether each chart would waste much of the atlas, bool [n]: a large box filled to less than a third."""
    filled = np.bincount(chart, flat_areas(flat), minlength=len(extent))
    return (filled < 0.33 * extent.prod(1)) & (extent.prod(1) > 64 * 64)


def _stretch(flat, chart, areas, count):
    """Linear factor per chart that makes its flat area equal its surface area, at most 1.6."""
    surface, filled = np.bincount(chart, areas, minlength=count), np.bincount(chart, flat_areas(flat), minlength=count)
    return np.clip(np.sqrt(surface / np.where(filled > 0, filled, np.inf)), 1.0, 1.6)


def _normals(points, faces):
    """Unit normals [F, 3] (zero for degenerate faces) and areas [F]."""
    corner = points[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.sqrt((cross * cross).sum(1))
    safe = np.where(length > 0, length, 1.0)
    return cross / safe[:, None], length * 0.5


def _edge_rings(faces):
    """(next, previous) half-edge in the ring of all half-edges on the same undirected edge, int64 [3 F] each, for every half-edge
    3 f + i. A ring connects any number of faces at a non-manifold edge with two steps per half-edge.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    low, high = low[order], high[order]
    first = np.ones(len(order), bool)
    first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    begin = np.flatnonzero(first)
    last = np.append(begin[1:], len(order)) - 1
    following = np.roll(order, -1)
    following[last] = order[begin]
    ahead = np.empty_like(order)
    ahead[order] = following
    behind = np.empty_like(order)
    behind[following] = order
    return ahead, behind


def _smoothed(weighted, ahead):
    """Area-weighted mean unit normals [F, 3] over two rings of neighbours; zero if they cancel or have no area."""
    total = weighted
    for _ in range(2):
        total = total + total[ahead[0::3] // 3] + total[ahead[1::3] // 3] + total[ahead[2::3] // 3]
    length = np.sqrt((total * total).sum(1))
    return total / np.where(length > 0, length, 1.0)[:, None]


def _frames(axes):
    """Right-handed frames float64 [F, 3, 3], rows x, y and depth, depth along each axis; the world's frame for a zero axis."""
    x = np.cross(np.eye(3)[np.abs(axes).argmin(1)], axes)
    length = np.sqrt((x * x).sum(1, keepdims=True))
    x /= np.where(length > 0, length, 1.0)
    frames = np.stack([x, np.cross(axes, x), axes], 1)
    frames[length[:, 0] == 0] = np.eye(3)
    return frames


@kernel
def _project(points, faces, face, frames, seed, out):
    """Write the corners of a face in its chart's frame to out [3, 3]: (x, y, depth) per corner."""
    for i in range(3):
        v = faces[face, i]
        for k in range(3):
            x, y, z = frames[seed, k, 0], frames[seed, k, 1], frames[seed, k, 2]
            out[i, k] = x * points[v, 0] + y * points[v, 1] + z * points[v, 2]


@kernel
def _widen(bounds, tri, wider):
    """Write bounds (x minimum, y minimum, x maximum, y maximum), widened by a projected face, to wider; returns the larger
    side."""
    for k in range(2):
        wider[k] = min(bounds[k], tri[0, k], tri[1, k], tri[2, k])
        wider[k + 2] = max(bounds[k + 2], tri[0, k], tri[1, k], tri[2, k])
    return max(wider[2] - wider[0], wider[3] - wider[1])


@kernel
def _meets_other_sheet(tri, chart, stamp, depth, write):
    """Return whether a face, widened by a texel, meets a cell that this chart already covers at another depth.

    With write, claims cells instead: a cell holds 2 * chart + 1 if its centre is inside a face, 2 * chart on a face's rim.
    Cells are addressed modulo the grid side (a power of two), which cannot alias because limit bounds the chart's extent; the
    mask keeps every index in range.
    """
    mask = stamp.shape[0] - 1
    ax, ay, bx, by, cx, cy = tri[0, 0], tri[0, 1], tri[1, 0], tri[1, 1], tri[2, 0], tri[2, 1]
    for row in range(math.floor(min(ay, by, cy) - 1.5), math.ceil(max(ay, by, cy) + 1.5)):
        left, right = span_in_band(ax, ay, bx, by, cx, cy, row - 0.5, row + 1.5)
        if left > right:
            continue
        for col in range(math.ceil(left - 1.5), math.floor(right + 0.5) + 1):
            claim = stamp[row & mask, col & mask]
            if not write and claim >> 1 != chart:
                continue
            gap, wa, wb = nearest_on_triangle(col + 0.5, row + 0.5, ax, ay, bx, by, cx, cy)
            z = wa * tri[0, 2] + wb * tri[1, 2] + (1.0 - wa - wb) * tri[2, 2]
            own_claim = 2 * chart + (1 if gap == 0.0 else 0)
            if write:
                if claim >> 1 != chart or claim < own_claim:
                    stamp[row & mask, col & mask] = own_claim
                    depth[row & mask, col & mask] = z
            else:
                tolerance = OVERLAP_TOLERANCE if claim & own_claim & 1 else DEPTH_TOLERANCE
                if abs(depth[row & mask, col & mask] - z) > tolerance:
                    return True
    return False


@kernel
def _facing(vectors, face, frames, seed):
    """Cosine between a face's vector and the axis of the chart that a seed started."""
    x, y, z = frames[seed, 2, 0], frames[seed, 2, 1], frames[seed, 2, 2]
    return vectors[face, 0] * x + vectors[face, 1] * y + vectors[face, 2] * z


@kernel
def _joins(face, seed, groups, normals, smooth, frames):
    """Return whether a neighbour may join by group and direction; faces without area have no direction and always may."""
    if groups[face] != groups[seed]:
        return False
    if normals[face, 0] == 0.0 and normals[face, 1] == 0.0 and normals[face, 2] == 0.0:
        return True
    own = _facing(normals, face, frames, seed)
    return own >= FACING or (own >= STEEPEST and _facing(smooth, face, frames, seed) >= FACING)


@kernel
def _take(face, chart, tri, bounds, wider, charts, flat):
    """Make a face part of a chart: number, flat corners, bounds."""
    charts[face] = chart
    for i in range(3):
        flat[face, i, 0], flat[face, i, 1] = tri[i, 0], tri[i, 1]
    for k in range(4):
        bounds[k] = wider[k]


@kernel(allocates=True)
def _grow(points, faces, groups, normals, smooth, frames, order, ahead, behind, stamp, depth, limit, chart, charts, flat):
    """Breadth-first growth from the largest free face; rejected faces stay free and seed later charts. See grow_charts.

    charts: -1 for free faces, others are left alone; chart: first new number; limit [F] <= grid side - 8: extent of the chart
    a face may seed. Writes charts and flat (corners on the chart's plane).
    """
    queue = np.empty(faces.shape[0], np.int64)
    tri, bounds, wider = np.empty((3, 3)), np.empty(4), np.empty(4)
    chart -= 1
    for seed in order:
        if charts[seed] >= 0:
            continue
        chart += 1
        bounds[0], bounds[1], bounds[2], bounds[3] = math.inf, math.inf, -math.inf, -math.inf
        _project(points, faces, seed, frames, seed, tri)
        size = _widen(bounds, tri, wider)
        _take(seed, chart, tri, bounds, wider, charts, flat)
        if size >= limit[seed]:
            continue
        _meets_other_sheet(tri, chart, stamp, depth, True)
        queue[0], head, tail = seed, 0, 1
        while head < tail:
            for step in range(6):
                half = 3 * queue[head] + step // 2
                face = ahead[half] // 3 if step % 2 == 0 else behind[half] // 3
                if charts[face] >= 0 or not _joins(face, seed, groups, normals, smooth, frames):
                    continue
                _project(points, faces, face, frames, seed, tri)
                if _widen(bounds, tri, wider) >= limit[seed] or _meets_other_sheet(tri, chart, stamp, depth, False):
                    continue
                _meets_other_sheet(tri, chart, stamp, depth, True)
                _take(face, chart, tri, bounds, wider, charts, flat)
                queue[tail] = face
                tail += 1
            head += 1
