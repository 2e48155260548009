"""The rasteriser: the face that is visible at each pixel's centre, and the point on that face.

Exact by construction: corners are snapped to 1/256 pixel and all coverage is computed in int64, so two faces along an edge share
its pixels without overlap or gap (top-left rule). Pixels keep only depth and face while faces compete; the barycentric
coordinates are computed afterwards, once per visible pixel, from the face before snapping.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..core.kernel import kernel
from ..field.texel_cover import nearest_on_triangle
from .triangles import BAND, Triangles, _first_centre, _last_centre, set_up

if TYPE_CHECKING:
    from .camera import Camera


@dataclass
class Fragments:
    """The visible surface of a picture, one entry per covered pixel.

    Attributes
    ----------
    pixel : int64 [M]
        row * width + column, ascending.
    face : int64 [M]
        Visible face.
    bary : float64 [M, 3]
        Perspective-correct barycentric coordinates, non-negative, with sum 1.
    depth : float64 [M]
        Along the camera's forward, as the faces competed with it.
    width, height : int
        Pixels.
    """

    pixel: np.ndarray
    face: np.ndarray
    bary: np.ndarray
    depth: np.ndarray
    width: int
    height: int

    def rows(self, chosen: np.ndarray) -> Fragments:
        """Return some of the fragments. chosen: numbers of entries, int64 [n]."""
        return replace(self, pixel=self.pixel[chosen], face=self.face[chosen], bary=self.bary[chosen], depth=self.depth[chosen])


def rasterise(camera: Camera, positions: np.ndarray, faces: np.ndarray, cull: bool = True, two_sided: np.ndarray | None = None,
              threads: int = 1, beyond: np.ndarray | None = None) -> Fragments:
    """Find the visible faces of a mesh: the nearest face at every pixel centre, and of equally near ones that with the lowest
    number.

    Parameters
    ----------
    camera : Camera
        It may stand inside the mesh if perspective.
    positions : float64 [V, 3]
        World.
    faces : int64 [F, 3]
        Counter-clockwise seen from outside. Degenerate faces and faces with a corner that is not finite are invisible.
    cull : bool
        Leave out back faces.
    two_sided : bool [F], optional
        Faces that are never culled.
    threads : int
        Most threads; the result does not depend on it.
    beyond : float64 [height * width], optional
        Only points that are strictly deeper count (depth peeling).

    Returns
    -------
    Fragments
        One entry per covered pixel.

    Raises
    ------
    IndexError
        A face names no position.
    ValueError
        Shapes are wrong.
    """
    return visible(set_up(camera, positions, faces, cull, two_sided), threads, beyond)


def visible(triangles: Triangles, threads: int = 1, beyond: np.ndarray | None = None) -> Fragments:
    """Rasterise triangles that are set up already, for several passes over the same faces; see rasterise().

    Parameters
    ----------
    triangles : Triangles
        Of set_up().
    threads, beyond
        As of rasterise().

    Returns
    -------
    Fragments
        One entry per covered pixel.
    """
    camera = triangles.camera
    width, height = camera.width, camera.height
    beyond = np.zeros(0) if beyond is None else np.ascontiguousarray(beyond, np.float64)
    if len(beyond) not in (0, width * height) or beyond.ndim != 1:
        raise ValueError(f"beyond must be [{width * height}], not {list(beyond.shape)}")
    winner = np.empty((height, width), np.int32 if len(triangles.owner) < 1 << 31 else np.int64)
    bands = range(len(triangles.bands) - 1)

    def fill(band):
        members = triangles.member[triangles.bands[band] : triangles.bands[band + 1]]
        rows = winner[band * BAND : (band + 1) * BAND]
        return _fill(triangles.corner, triangles.plane, members, band * BAND, camera.perspective, beyond, rows)

    def resolve(band):
        rows, part = winner[band * BAND : (band + 1) * BAND], slice(begins[band], begins[band + 1])
        _resolve(rows, band * BAND, height, triangles.plane, triangles.owner, triangles.seen, triangles.faces, camera.perspective,
                 out.pixel[part], out.face[part], out.bary[part], out.depth[part])

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        begins = np.cumsum([0, *pool.map(fill, bands)])
        out = _room(int(begins[-1]), width, height)
        list(pool.map(resolve, bands))
    return out


def _room(count, width, height):
    return Fragments(np.empty(count, np.int64), np.empty(count, np.int64), np.empty((count, 3)), np.empty(count), width, height)


@kernel
def _narrow(ax, ay, bx, by, py, left, right):
    """Cuts the pixels left..right of a row to those on the inner side of the edge from a to b; the top-left rule decides borders.

    py: the row's centre. The triangle is clockwise on the screen (y down), so inside is where e(x) = (bx - ax) (py - ay) - (by -
    ay) (256 x + 128 - ax) >= 0. |e| < 2**60: coordinates are below 2**29.
    """
    dx, dy = bx - ax, by - ay
    e = dx * (py - ay) - dy * (128 - ax)
    if dy < 0:  # a left edge owns its points
        return max(left, -((e >> 8) // -dy)), right
    if dy > 0:
        return left, min(right, ((e - 1) >> 8) // dy)
    return (left, right) if e > 0 or (e == 0 and dx > 0) else (left, left - 1)  # a top edge owns its points


@kernel
def _span(corner, y, last):
    """First and last pixel of row y whose centres a triangle covers, within 0..last; first > last if there is none. corner: int64
    [6]."""
    py = 256 * y + 128
    left, right = _narrow(corner[0], corner[1], corner[2], corner[3], py, np.int64(0), last)
    left, right = _narrow(corner[2], corner[3], corner[4], corner[5], py, left, right)
    return _narrow(corner[4], corner[5], corner[0], corner[1], py, left, right)


@kernel
def _nearness(plane, x, y):
    """Nearness of a triangle at a pixel centre. It depends on the pixel alone, not on the division of the picture into bands."""
    return min(max(plane[0] + plane[2] * y + plane[1] * x, plane[3]), plane[4])


@kernel
def _depth(nearness, perspective):
    return 1.0 / nearness if perspective else -nearness


@kernel(allocates=True)
def _fill(corner, plane, members, top, perspective, beyond, winner):
    """Fills one band with the nearest members and returns the number of covered pixels.

    winner: int [rows, width], rows from picture row `top` on: gets the visible triangle of each pixel, or -1. Bounds: rows and
    spans are cut to the band; beyond is empty or covers the whole picture.
    """
    rows, width = winner.shape
    nearest = np.full((rows, width), -np.inf)
    winner[:] = -1
    covered = np.int64(0)
    for m in range(members.shape[0]):
        t = members[m]
        c, p = corner[t], plane[t]
        first = max(_first_centre(min(c[1], c[3], c[5])), top)
        last = min(_last_centre(max(c[1], c[3], c[5])), top + rows - 1)
        for y in range(first, last + 1):
            left, right = _span(c, y, width - 1)
            r = y - top
            for x in range(left, right + 1):
                near = _nearness(p, x, y)
                if not near > nearest[r, x]:
                    continue
                if beyond.shape[0] > 0 and not _depth(near, perspective) > beyond[y * width + x]:
                    continue
                covered += winner[r, x] < 0
                nearest[r, x] = near
                winner[r, x] = t
    return covered


@kernel
def _barycentric(seen, a, b, c, x, y, perspective, out):
    """Writes the barycentric coordinates of the point of a face that is visible at (x, y) into out float64 [3].

    x, y: pixels from the picture's centre. The coordinates are determinants of the corners with the ray, so that corners behind
    the camera do no harm. After snapping the point may be just outside the face: then the nearest point of the face on the screen
    is taken.
    """
    wa, wb, wc = (seen[a, 2], seen[b, 2], seen[c, 2]) if perspective else (1.0, 1.0, 1.0)
    ax, ay = seen[a, 0] - x * wa, seen[a, 1] - y * wa
    bx, by = seen[b, 0] - x * wb, seen[b, 1] - y * wb
    cx, cy = seen[c, 0] - x * wc, seen[c, 1] - y * wc
    u, v, w = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
    over = 1.0 / (u + v + w)
    u, v, w = u * over, v * over, w * over
    if not min(u, v, w) >= 0.0 and min(wa, wb, wc) > 0.0:
        _, u, v = nearest_on_triangle(0.0, 0.0, ax / wa, ay / wa, bx / wb, by / wb, cx / wc, cy / wc)
        u, v, w = u / wa, v / wb, (1.0 - u - v) / wc
    u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    total = u + v + w
    if 0.0 < total < np.inf:
        out[0], out[1], out[2] = u / total, v / total, w / total
    else:  # nothing but rounding: any of its points is as good
        out[:] = 1.0 / 3.0


@kernel
def _resolve(winner, top, height, plane, owner, seen, faces, perspective, pixel, face, bary, depth):
    """Writes the fragments of one band in row order. winner: as _fill left it; the outputs have as many rows as _fill counted."""
    rows, width = winner.shape
    n = 0
    for r in range(rows):
        y = top + r
        for x in range(width):
            t = winner[r, x]
            if t < 0:
                continue
            f = owner[t]
            pixel[n], face[n] = y * width + x, f
            depth[n] = _depth(_nearness(plane[t], x, y), perspective)
            _barycentric(seen, faces[f, 0], faces[f, 1], faces[f, 2], x + 0.5 - 0.5 * width, y + 0.5 - 0.5 * height, perspective,
                         bary[n])
            n += 1
