"""Preparation of faces for filling: projected, clipped, snapped to 1/256 pixel, wound one way, sorted into bands of rows."""

from dataclasses import dataclass

import numpy as np

from ..core.kernel import kernel
from .camera import Camera, to_camera

SUBPIXELS = 256  # positions of a corner per pixel; raster.py's shifts by 8 are this
GUARD = 1 << 20  # pixels from the picture's centre up to which corners are snapped; what lies beyond is clipped there
NEAR = 1e-6  # of the deepest corner's depth: what is nearer to a perspective camera is clipped
BAND = 32  # rows filled at a time: a band of 2048 columns keeps its depths in 512 KB
MOST_CORNERS = 8  # of a triangle after five clipping planes

FAR = 1e200  # a camera-space coordinate beyond this counts as not finite, so that no product overflows

IN_REACH, TO_CLIP, NOT_FINITE = 0, 1, 2


@dataclass
class Triangles:
    """Triangles on the screen, set up for the kernels of raster.py.

    Attributes
    ----------
    camera : Camera
        The camera.
    seen : float64 [V, 3]
        The corners in camera space (to_camera).
    faces : int64 [F, 3]
        Indices into seen.
    corner : int64 [T, 6]
        x0 y0 x1 y1 x2 y2 in 1/256 pixel, clockwise on the screen.
    plane : float64 [T, 5]
        k, kx, ky, low, high: nearness at the centre of pixel (x, y) is k + kx x + ky y, cut to [low, high]. Nearness grows
        towards the camera: 1 / depth if perspective, -depth if orthographic.
    owner : int64 [T]
        Face numbers, ascending.
    bands, member : int64 [B + 1], int64
        Band b is touched by triangles member[bands[b] : bands[b + 1]], in face order.
    """

    camera: Camera
    seen: np.ndarray
    faces: np.ndarray
    corner: np.ndarray
    plane: np.ndarray
    owner: np.ndarray
    bands: np.ndarray
    member: np.ndarray


def set_up(camera: Camera, positions: np.ndarray, faces: np.ndarray, cull: bool = True,
           two_sided: np.ndarray | None = None) -> Triangles:
    """Project a mesh to the screen and set up the triangles of the faces that may be visible.

    Parameters
    ----------
    camera : Camera
        The camera.
    positions : float64 [V, 3]
        World.
    faces : int64 [F, 3]
        Faces without area on the screen and faces with a corner that is not finite are left out.
    cull : bool
        Leave out faces whose corners run clockwise on the screen.
    two_sided : bool [F], optional
        Faces that are never culled.

    Returns
    -------
    Triangles
        Input of visible().

    Raises
    ------
    IndexError
        A face names no position.
    ValueError
        Arrays do not fit together.

    Notes
    -----
    Magnitudes: a snapped coordinate is below (2**20 + 2**13 + 1) * 2**8 < 2**29, so a product of two differences is below 2**60.
    """
    positions = np.ascontiguousarray(positions, np.float64).reshape(-1, 3)
    faces = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
        raise IndexError("a face refers to a position that does not exist")
    kept = np.full(len(faces), not cull) if two_sided is None or not cull else np.array(two_sided, np.bool_)
    if kept.shape != (len(faces),):
        raise ValueError(f"two_sided must be [{len(faces)}], not {list(kept.shape)}")
    seen = to_camera(camera, positions)
    near = _near(_deepest(seen)) if camera.perspective else -np.inf
    state, snapped = np.empty(len(seen), np.uint8), np.empty((len(seen), 2), np.int64)
    _snap_corners(seen, near, camera.perspective, camera.width, camera.height, state, snapped)
    most = len(faces) + (MOST_CORNERS - 3) * _count_clipped(faces, state)
    corner, plane, owner = np.empty((most, 6), np.int64), np.empty((most, 5)), np.empty(most, np.int64)
    count = _set_up(seen, faces, state, snapped, _planes(camera, near), kept, camera.perspective, camera.width, camera.height,
                    corner, plane, owner)
    corner, plane, owner = corner[:count], plane[:count], owner[:count]
    return Triangles(camera, seen, faces, corner, plane, owner, *_sort_into_bands(corner, camera.height))


def _near(deepest):
    """Depth of a perspective camera's near plane: a fixed share of the deepest corner's; inf if all corners are behind the
    camera."""
    return max(NEAR * deepest, 1e-290) if deepest > 0 else np.inf


@kernel
def _is_finite(point):
    """Return whether all coordinates in camera space, float64 [3], are so small that no product overflows."""
    return abs(point[0]) < FAR and abs(point[1]) < FAR and abs(point[2]) < FAR


@kernel
def _deepest(seen):
    """Largest depth of the finite corners; 0 if none is before the camera."""
    deepest = 0.0
    for v in range(seen.shape[0]):
        if _is_finite(seen[v]):
            deepest = max(deepest, seen[v, 2])
    return deepest


@kernel
def _snap_corners(seen, near, perspective, width, height, state, snapped):
    """Writes each corner's state into state uint8 [V], and the snapped places of those IN_REACH into snapped int64 [V, 2]; 0 for
    the others."""
    for v in range(seen.shape[0]):
        snapped[v, 0], snapped[v, 1] = 0, 0
        if not _is_finite(seen[v]):
            state[v] = NOT_FINITE
            continue
        over = 1.0 / seen[v, 2] if perspective else 1.0
        x, y = seen[v, 0] * over + 0.5 * width, seen[v, 1] * over + 0.5 * height
        inside = abs(x - 0.5 * width) <= GUARD and abs(y - 0.5 * height) <= GUARD and seen[v, 2] >= near
        state[v] = IN_REACH if inside else TO_CLIP
        if inside:
            snapped[v, 0], snapped[v, 1] = np.int64(np.floor(x * SUBPIXELS + 0.5)), np.int64(np.floor(y * SUBPIXELS + 0.5))


def _planes(camera, near):
    """Clipping planes float64 [P, 4] (a, b, c, d), keeping a x + b y + c z + d >= 0 of points in camera space."""
    guard = (GUARD, 0) if camera.perspective else (0, GUARD)
    sides = [(x, y, *guard) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    return np.array([(0, 0, 1, -near)] * camera.perspective + sides, np.float64)


@kernel
def _count_clipped(faces, state):
    """Number of faces with a corner out of reach."""
    count = np.int64(0)
    for f in range(faces.shape[0]):
        count += max(state[faces[f, 0]], state[faces[f, 1]], state[faces[f, 2]]) == TO_CLIP
    return count


@kernel
def _cut_off(source, count, plane, out):
    """Writes the part of a convex polygon on the kept side of one plane into out (Sutherland and Hodgman); returns its corners,
    at most count + 1.

    source, out: float64 [8, 3]; plane: float64 [4]. A new corner is always computed from its inner to its outer neighbour: both
    faces along an edge get the same corner, bit by bit, and no gap opens between them.
    """
    kept = 0
    for i in range(count):
        j = (i + 1) % count
        a = plane[0] * source[i, 0] + plane[1] * source[i, 1] + plane[2] * source[i, 2] + plane[3]
        b = plane[0] * source[j, 0] + plane[1] * source[j, 1] + plane[2] * source[j, 2] + plane[3]
        if a >= 0.0:
            out[kept, 0], out[kept, 1], out[kept, 2] = source[i, 0], source[i, 1], source[i, 2]
            kept += 1
        if (a >= 0.0) != (b >= 0.0):
            inner, outer = (i, j) if a >= 0.0 else (j, i)
            t = a / (a - b) if a >= 0.0 else b / (b - a)
            for k in range(3):
                out[kept, k] = source[inner, k] + t * (source[outer, k] - source[inner, k])
            kept += 1
    return kept


@kernel
def _nearness_plane(seen, i, j, k, perspective, width, height, out):
    """Writes nearness over the screen of the plane through three corners into out float64 [3]: value for pixel (0, 0), steps in x
    and y.

    False if the plane is seen edge-on. The corners are taken in one order, so that faces on the same corners tie.
    """
    i, j = min(i, j), max(i, j)
    j, k = min(j, k), max(j, k)
    i, j = min(i, j), max(i, j)
    ux, uy, uz = seen[j, 0] - seen[i, 0], seen[j, 1] - seen[i, 1], seen[j, 2] - seen[i, 2]
    vx, vy, vz = seen[k, 0] - seen[i, 0], seen[k, 1] - seen[i, 1], seen[k, 2] - seen[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    d = nx * seen[i, 0] + ny * seen[i, 1] + nz * seen[i, 2]
    scale = 1.0 / (d if perspective else nz)
    out[1], out[2] = nx * scale, ny * scale
    out[0] = nz * scale if perspective else -d * scale
    out[0] += out[1] * (0.5 - 0.5 * width) + out[2] * (0.5 - 0.5 * height)
    return np.isfinite(out[0]) and np.isfinite(out[1]) and np.isfinite(out[2])


@kernel
def _first_centre(low):
    """The first pixel whose centre is at or after a snapped coordinate."""
    return (low + 127) >> 8


@kernel
def _last_centre(high):
    """The last pixel whose centre is at or before a snapped coordinate."""
    return (high - 128) >> 8


@kernel
def _add(x0, y0, x1, y1, x2, y2, keep_back, width, height, corner):
    """Stores a snapped triangle in corner int64 [6], clockwise. False if it has no area, faces away or has no pixel centre in its
    box."""
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if area == 0 or (area > 0 and not keep_back):
        return False
    if _last_centre(max(x0, x1, x2)) < max(_first_centre(min(x0, x1, x2)), 0) or _first_centre(min(x0, x1, x2)) >= width:
        return False
    if _last_centre(max(y0, y1, y2)) < max(_first_centre(min(y0, y1, y2)), 0) or _first_centre(min(y0, y1, y2)) >= height:
        return False
    corner[0], corner[1] = x0, y0
    if area > 0:
        corner[2], corner[3], corner[4], corner[5] = x1, y1, x2, y2
    else:
        corner[2], corner[3], corner[4], corner[5] = x2, y2, x1, y1
    return True


@kernel
def _clipped_polygon(seen, face, planes, scratch, other):
    """Clips a face against all planes, into scratch, and returns the number of corners left. scratch, other: float64 [8, 3]."""
    count = 3
    for c in range(3):
        for k in range(3):
            scratch[c, k] = seen[face[c], k]
    for p in range(planes.shape[0]):
        count = _cut_off(scratch, count, planes[p], other)
        for c in range(count):
            for k in range(3):
                scratch[c, k] = other[c, k]
        if count < 3:
            return 0
    return count


@kernel
def _snap_polygon(polygon, count, perspective, width, height, snapped):
    """Snaps the corners of a clipped polygon into int64 [8, 2]; returns their least and largest nearness.

    The planes guarantee z > 0 and the range.
    """
    low, high = np.inf, -np.inf
    for i in range(count):
        over = 1.0 / polygon[i, 2] if perspective else 1.0
        snapped[i, 0] = np.int64(np.floor((polygon[i, 0] * over + 0.5 * width) * SUBPIXELS + 0.5))
        snapped[i, 1] = np.int64(np.floor((polygon[i, 1] * over + 0.5 * height) * SUBPIXELS + 0.5))
        near = over if perspective else -polygon[i, 2]
        low, high = min(low, near), max(high, near)
    return low, high


@kernel(allocates=True)
def _set_up(seen, faces, state, snapped, planes, keep_back, perspective, width, height, corner, plane, owner):
    """Fills corner, plane and owner; returns the number of triangles.

    Bounds: the wrapper has checked the faces against seen, and a face that is clipped gives at most MOST_CORNERS - 2 triangles,
    for which the wrapper has left room.
    """
    n = 0
    polygon, other = np.empty((MOST_CORNERS, 3)), np.empty((MOST_CORNERS, 3))
    place, slope = np.empty((MOST_CORNERS, 2), np.int64), np.empty(3)
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        worst = max(state[i], state[j], state[k])
        if worst == NOT_FINITE:
            continue
        begin = n
        if worst == IN_REACH:
            n += _add(snapped[i, 0], snapped[i, 1], snapped[j, 0], snapped[j, 1], snapped[k, 0], snapped[k, 1], keep_back[f],
                      width, height, corner[n])
            if n == begin:
                continue
            a, b, c = seen[i, 2], seen[j, 2], seen[k, 2]
            low, high = (1.0 / max(a, b, c), 1.0 / min(a, b, c)) if perspective else (-max(a, b, c), -min(a, b, c))
        else:
            count = _clipped_polygon(seen, faces[f], planes, polygon, other)
            low, high = _snap_polygon(polygon, count, perspective, width, height, place)
            for c in range(2, count):
                n += _add(place[0, 0], place[0, 1], place[c - 1, 0], place[c - 1, 1], place[c, 0], place[c, 1], keep_back[f],
                          width, height, corner[n])
        if not _nearness_plane(seen, i, j, k, perspective, width, height, slope):
            slope[0], slope[1], slope[2] = low, 0.0, 0.0
        for t in range(begin, n):
            plane[t, 0], plane[t, 1], plane[t, 2], plane[t, 3], plane[t, 4] = slope[0], slope[1], slope[2], low, high
            owner[t] = f
    return n


def _sort_into_bands(corner, height):
    """(bands int64 [B + 1], member int64), see Triangles."""
    bands = np.zeros(-(-height // BAND) + 1, np.int64)
    _count_members(corner, height, bands)
    bands = np.cumsum(bands)
    member = np.empty(bands[-1], np.int64)
    _place_members(corner, height, bands[:-1].copy(), member)
    return bands, member


@kernel
def _band_range(corner, t, height):
    """First and last band of a stored triangle; the rows are cut to the picture."""
    y0, y1, y2 = corner[t, 1], corner[t, 3], corner[t, 5]
    first, last = max(_first_centre(min(y0, y1, y2)), 0), min(_last_centre(max(y0, y1, y2)), height - 1)
    return first // BAND, last // BAND


@kernel
def _count_members(corner, height, bands):
    """Adds the triangles of band b to bands[b + 1]."""
    for t in range(corner.shape[0]):
        first, last = _band_range(corner, t, height)
        for b in range(first, last + 1):
            bands[b + 1] += 1


@kernel
def _place_members(corner, height, free, member):
    """Writes each triangle into the next free entry of its bands, whose counts come from the same ranges."""
    for t in range(corner.shape[0]):
        first, last = _band_range(corner, t, height)
        for b in range(first, last + 1):
            member[free[b]] = t
            free[b] += 1
