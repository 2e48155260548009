"""Numbers in text, and triangulation of polygons, for all readers."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from ..report import plural

if TYPE_CHECKING:
    from .parts import Notes

MAX_CORNERS = 1 << 14  # of a concave polygon; ear cutting takes seconds a polygon beyond, minutes where it is hostile
_TOLERANCE = 1e-6  # of the polygon's area: what triangles may cover twice; positions written with 7 digits move by less
_NO_AREA = 1e-12  # of the square of its size
_CHUNK = 1 << 18  # corners tested together; bounds the memory of large quad meshes


def parse_numbers(text: bytes, dtype: type) -> np.ndarray | None:
    """Bytes of numbers between blanks -> array [n], or None if anything else is among them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older numpy deprecates, newer raises, on unmatched text
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def counting(sizes: np.ndarray) -> np.ndarray:
    """Return 0..size-1 for each of sizes, one after another: [2, 3] -> [0, 1, 0, 1, 2]."""
    return np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)


def triangulate(points: np.ndarray, corners: np.ndarray, sizes: np.ndarray, notes: Notes) -> tuple[np.ndarray, np.ndarray]:
    """Cut polygons in space into triangles: (int64 [F, 3] corner numbers, int64 [F] polygon of each triangle), in order.

    points: float [V, 3]; corners: int64 [C] point of each corner, one polygon after another; sizes: int64 [P] corners per
    polygon. Corner numbers count through all polygons, so that they also index UVs and colours of corners. Every triangle
    faces the same way as its polygon (Newell normal). A polygon that the fan from its first corner covers becomes that fan;
    mapbox_earcut cuts the others in their own plane. A warning counts polygons that cross themselves or have no area.
    Corners with invalid indices or points that are not finite are left to the check of faces.
    """
    small = int((sizes < 3).sum())
    if small:
        notes.lose(plural(small, "face", "faces") + " with fewer than three corners",
                   plural(small, "face with fewer than three corners is", "faces with fewer than three corners are")
                   + " left out")
    triangles, polygon = _fans(sizes)
    if sizes.max(initial=0) < 4:
        return triangles, polygon
    points = np.asarray(points, np.float64)
    starts, first = np.cumsum(sizes) - sizes, np.searchsorted(polygon, np.arange(len(sizes)))
    valid = (corners >= 0) & (corners < len(points))
    kept, crossing, flat, large = np.ones(len(triangles), bool), [], [], []
    for rows, size in _by_size(sizes):
        ring = starts[rows][:, None] + np.arange(size)
        sound = valid[ring].all(axis=1)
        rows, ring = rows[sound], ring[sound]
        folded, empty = _folded(points[corners[ring]])
        flat.append(rows[empty])
        rows, ring = rows[folded], ring[folded]
        if size > MAX_CORNERS:
            large.append(rows)
            continue
        cuts, crosses = _cut(points[corners[ring]])
        crossing.append(rows[crosses])
        for row, places, cut in zip(rows, ring, cuts, strict=True):
            triangles[first[row] : first[row] + len(cut)] = places[cut]
            kept[first[row] + len(cut) : first[row] + size - 2] = False
    _name(crossing, ("crosses itself", "cross themselves"), "; their triangles may overlap", notes)
    _name(flat, ("has", "have"), " no area (degenerate)", notes)
    _name(large, ("is", "are"), f" concave with more than {MAX_CORNERS} corners and split into fans, which may overlap", notes)
    return triangles[kept], polygon[kept]


def _name(groups, verbs, what, notes):
    rows = np.concatenate([np.zeros(0, np.int64), *groups])
    if len(rows):
        count = plural(len(rows), f"polygon {verbs[0]}", f"polygons {verbs[1]}")
        notes.warn(f"{count}{what}; the first is polygon {rows.min()} of the file")


def _fans(sizes):
    """Polygon (a, b, c, d) -> (a, b, c), (a, c, d)."""
    triangles = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), triangles)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = counting(triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon


def _by_size(sizes):
    """Yields (rows of polygons of the same size, that size) for sizes from four, with at most _CHUNK corners at a time."""
    order = np.argsort(sizes, kind="stable")
    order = order[np.searchsorted(sizes[order], 4) :]
    for rows in np.split(order, np.flatnonzero(np.diff(sizes[order])) + 1):
        size = int(sizes[rows[0]])
        step = max(_CHUNK // size, 1)
        for start in range(0, len(rows), step):
            yield rows[start : start + step], size


def _folded(rings):
    """[Q, n, 3] corners -> (bool [Q] whether the fan from corner 0 does not cover the polygon, bool [Q] whether it has no area).

    A fan covers its polygon if no triangle faces against it and the angles at its first corner sum to less than a full turn.
    NaN compares false, so polygons with broken points keep their fan.
    """
    spokes = rings[:, 1:] - rings[:, :1]
    spokes = spokes / np.maximum(np.abs(spokes).max(axis=(1, 2), keepdims=True), 1e-300)
    areas = np.cross(spokes[:, :-1], spokes[:, 1:])
    normal = areas.sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    signed = (areas @ normal[:, :, None])[..., 0] / np.maximum(length, 1e-300)[:, None]
    empty = np.linalg.norm(areas, axis=2).sum(axis=1) <= _NO_AREA
    against = np.maximum(-signed, 0.0).sum(axis=1)
    folded = (against > _TOLERANCE * length) | (length <= _NO_AREA)
    if rings.shape[1] > 4:  # two triangles turn by less than a full turn anyway
        inner = (spokes[:, :-1] * spokes[:, 1:]).sum(axis=2)
        folded |= np.arctan2(signed, inner).sum(axis=1) > 2 * np.pi
    return folded & ~empty, empty


def _cut(rings):
    """[Q, n, 3] polygons that fans do not cover -> (list of int [m, 3] triangles, bool [Q] whether each crosses itself)."""
    flat, area = _in_plane(rings)
    if rings.shape[1] == 4:  # where one diagonal fails, the other one is left
        cuts = list(np.tile([[1, 2, 3], [1, 3, 0]], (len(rings), 1, 1)))
    else:
        cuts = [_cut_ears(ring) for ring in flat]
    crosses = np.zeros(len(rings), bool) if rings.shape[1] == 4 else _turns_twice(flat)
    for row, cut in enumerate(cuts):
        signed = _signed_areas(flat[row], cut)
        turned = signed < 0
        crosses[row] |= not abs(np.abs(signed).sum() - area[row]) <= _TOLERANCE * area[row]
        if turned.any():
            cut[turned] = cut[turned][:, ::-1]
            crosses[row] |= rings.shape[1] == 4
    return cuts, crosses


def _cut_ears(ring):
    """Polygon [n, 2] -> triangles int64 [m, 3], m = n - 2 if the polygon is simple."""
    import mapbox_earcut

    cut = mapbox_earcut.triangulate_float64(ring, np.array([len(ring)], np.uint32)).reshape(-1, 3).astype(np.int64)
    return cut if len(cut) == len(ring) - 2 else _with_corners_on_edges(cut.tolist(), len(ring))


def _in_plane(rings):
    """[Q, n, 3] -> (float64 [Q, n, 2] in the plane of each Newell normal, scaled to a size near 1; areas float64 [Q])."""
    flat = rings - rings[:, :1]
    flat = flat / np.maximum(np.abs(flat).max(axis=(1, 2), keepdims=True), 1e-300)
    areas = np.cross(flat, np.roll(flat, -1, axis=1))
    normal = areas.sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    largest = np.take_along_axis(areas, np.abs(areas).sum(axis=2).argmax(axis=1)[:, None, None], axis=1)[:, 0]
    normal = np.where((length <= _NO_AREA)[:, None], largest, normal)  # halves that cancel: any plane shows the crossing
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return flat @ np.stack([u, np.cross(normal, u)], axis=2), 0.5 * length


def _turns_twice(flat):
    """[Q, n, 2] -> bool [Q]: whether the edges certainly do not make exactly one full turn, as those of a simple polygon do.

    Ear cutting accepts a ring that winds twice, and its areas add up. Spikes, which turn by half a turn either way, and edges
    without length leave the answer open; it is then False.
    """
    edges = np.roll(flat, -1, axis=1) - flat
    after = np.roll(edges, -1, axis=1)
    turns = np.arctan2(edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0], (edges * after).sum(axis=2))
    clear = (np.abs(turns).max(axis=1) < np.pi - 1e-6) & (np.abs(edges).max(axis=2) > 0).all(axis=1)
    return clear & (np.abs(turns.sum(axis=1) - 2 * np.pi) > 1.0)


def _signed_areas(flat, triangles):
    (ax, ay), (bx, by), (cx, cy) = flat[triangles].transpose(1, 2, 0)
    return 0.5 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def _with_corners_on_edges(triangles, corners):
    """Triangles with the corners on straight edges that ear cutting leaves out: each splits the triangle at its edge, so that
    neighbours fit."""
    used = sorted({corner for triangle in triangles for corner in triangle})
    row_of = {frozenset((triangle[k - 1], triangle[k])): row for row, triangle in enumerate(triangles) for k in range(3)}
    for a, b in zip(used, used[1:] + used[:1], strict=True):
        way = [a, *(corner % corners for corner in range(a + 1, b if b > a else b + corners)), b]
        row = row_of.get(frozenset((a, b)))
        if len(way) == 2 or row is None:
            continue
        apex = next(corner for corner in triangles[row] if corner not in (a, b))
        triangles[row] = [way[0], way[1], apex]
        row_of[frozenset((a, apex))] = row
        for k in range(1, len(way) - 1):
            row_of[frozenset((apex, way[k + 1]))] = len(triangles)
            triangles.append([way[k], way[k + 1], apex])
    return np.array(triangles, np.int64).reshape(-1, 3)
