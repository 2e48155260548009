"""Cameras: where a picture is taken from and where a point of the world lands in it.

Pixel (column, row) covers [column, column + 1) x [row, row + 1), y downwards, its centre at .5. Views and their order are those
of the MPEG mesh metric software (mpeg-pcc-mmetric 1.1.7, mode ibsm), so that image metrics can be compared with it.
"""

import math
import operator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..core.kernel import kernel
from ..errors import InputError

MAX_SIZE = 1 << 14  # pixels a side; raster.py's integers are bounded with it
LEAST = 1e-300  # world units (or tangent): half a picture's height, so that a pixel's side is never zero
MARGIN = 1.04  # of a framed model's size that its picture is
LEAST_SHARE = 1e-3  # of the radius: least half of a framed picture's height, and least distance of the camera
AXIS = 1e-9  # a direction is along y where its horizontal part is shorter than this

VIEWS = {"front": (0, 0, 1), "back": (0, 0, -1), "left": (-1, 0, 0), "right": (1, 0, 0), "top": (0, 1, 0), "bottom": (0, -1, 0)}


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera in world space.

    Parameters
    ----------
    right, up, forward : float64 [3]
        Orthonormal axes.
    eye : float64 [3]
        Position.
    perspective : bool
        False if orthographic.
    half : float
        Half the visible height: in world units if orthographic, tangent of half the vertical field of view if perspective.
    width, height : int
        Pixels.

    Raises
    ------
    InputError
        TXF-I90 and TXF-I92.
    """

    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    eye: np.ndarray
    perspective: bool
    half: float
    width: int
    height: int

    def __post_init__(self):
        _size((self.width, self.height))
        if not LEAST <= self.half < math.inf:
            raise InputError("TXF-I92", "half the visible height is out of range", value=self.half, allowed=f">= {LEAST}")

    @property
    def pixel(self) -> float:
        """A pixel's side in world units; when perspective, at depth 1."""
        return 2.0 * self.half / self.height


def orthographic(direction: ArrayLike, centre: ArrayLike, radius: float, size: int | tuple[int, int]) -> Camera:
    """Return an orthographic camera that looks from a direction at a centre.

    Parameters
    ----------
    direction : float [3]
        From centre to camera; of any length.
    centre : float [3]
        World.
    radius : float
        The largest square that fits the picture spans +-radius, in world units; 0 (a single point) stands for 1.
    size : int or (int, int)
        Pixels a side, or (width, height).

    Returns
    -------
    Camera
        Up is (0, 1, 0), or (0, 0, 1) if the direction is along y.

    Raises
    ------
    InputError
        TXF-I90 to TXF-I92.
    """
    width, height = _size(size)
    right, up, forward = _axes(_unit(direction))
    middle, radius = _place(centre), _radius(radius)
    return Camera(right, up, forward, middle - radius * forward, False, radius * height / min(width, height), width, height)


def perspective(eye: ArrayLike, target: ArrayLike, fov_degrees: float, size: int | tuple[int, int]) -> Camera:
    """Return a perspective camera at a point that looks at another.

    Parameters
    ----------
    eye, target : float [3]
        World.
    fov_degrees : float
        Vertical field of view, in 0..180 without the ends.
    size : int or (int, int)
        Pixels a side, or (width, height).

    Returns
    -------
    Camera
        Up is as in orthographic().

    Raises
    ------
    InputError
        TXF-I90 to TXF-I92.
    """
    width, height = _size(size)
    place = _place(eye)
    right, up, forward = _axes(_unit(place - _place(target)))
    return Camera(right, up, forward, place, True, math.tan(_half_angle(fov_degrees)), width, height)


def perspective_around(direction: ArrayLike, centre: ArrayLike, radius: float, fov_degrees: float,
                       size: int | tuple[int, int]) -> Camera:
    """Return a perspective camera that sees a whole sphere.

    Parameters
    ----------
    direction, centre, radius, size
        As of orthographic(), of the sphere.
    fov_degrees : float
        As of perspective().

    Returns
    -------
    Camera
        Its distance from the centre follows from the field of view.

    Raises
    ------
    InputError
        TXF-I90 to TXF-I92.
    """
    width, height = _size(size)
    outwards, middle, radius = _unit(direction), _place(centre), _radius(radius)
    narrow = math.atan(math.tan(_half_angle(fov_degrees)) * min(width, height) / height)
    return perspective(middle + outwards * (radius / math.sin(narrow)), middle, fov_degrees, (width, height))


def framing(direction: ArrayLike, positions: np.ndarray, size: int | tuple[int, int], fov_degrees: float | None = None) -> Camera:
    """Return a camera that looks from a direction and sees all points, centred and as large as MARGIN permits.

    Parameters
    ----------
    direction : float [3]
        From the points to the camera.
    positions : float [V, 3]
        World; points that are not finite do not count. A single point, or none, stands for a sphere of radius 1.
    size : int or (int, int)
        Pixels a side, or (width, height).
    fov_degrees : float, optional
        Vertical field of view; None for an orthographic camera.

    Returns
    -------
    Camera
        Up is as in orthographic().

    Raises
    ------
    InputError
        TXF-I90 to TXF-I92.
    """
    width, height = _size(size)
    centre, radius = bounding_sphere(positions)
    right, up, forward = _axes(_unit(direction))
    points = np.asarray(positions, np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)] - centre
    if radius == 0:
        points = np.array([right, -right, up, -up, forward, -forward])
    radius = _radius(radius)
    along = (points / radius) @ np.array([right, up, forward]).T
    if fov_degrees is None:
        low, high = along.min(axis=0), along.max(axis=0)
        half = MARGIN * max((high[1] - low[1]) / 2, (high[0] - low[0]) / 2 * height / width)
        place = (low + high) / 2 * (1, 1, 0) + (0, 0, low[2] - 1)
        half, perspective = max(half, LEAST_SHARE) * radius, False
    else:
        half, perspective = math.tan(_half_angle(fov_degrees)), True
        place = _seen_whole(along, (half * width / height / MARGIN, half / MARGIN))
    with np.errstate(all="ignore"):
        eye = centre + radius * (place[0] * right + place[1] * up + place[2] * forward)
    return Camera(right, up, forward, _place(eye), perspective, half, width, height)


def _seen_whole(along, slopes):
    """The position nearest to points from which |right| and |up| are within slopes times the depth.

    along: float64 [M, 3], coordinates of the points along right, up and forward.
    """
    sides = [((along[:, k] - slope * along[:, 2]).max(), (-along[:, k] - slope * along[:, 2]).max())
             for k, slope in enumerate(slopes)]
    back = min(-(low + high) / (2 * slope) for (low, high), slope in zip(sides, slopes, strict=True))
    place = [(low - high) / 2 for low, high in sides]
    return np.array([*place, min(back, along[:, 2].min() - LEAST_SHARE)])


def fibonacci_direction(i: int, count: int) -> np.ndarray:
    """Return the direction, from the centre to the camera, of one of several views that are spread evenly over the sphere, from
    +y to -y.

    Parameters
    ----------
    i : int
        Number of the view, 0..count - 1.
    count : int
        Number of views; a single view is the front.

    Returns
    -------
    float64 [3]
        Of length 1.

    Raises
    ------
    InputError
        TXF-I93 if there is no such view.

    Notes
    -----
    y = 1 - 2 i / (count - 1), turned about y by i pi (3 - sqrt 5), as in mpeg-pcc-mmetric.
    """
    if not 0 <= i < count:
        raise InputError("TXF-I93", "the number of the view does not exist", value=i, allowed=f"0..{count - 1}")
    if count == 1:
        return np.array(VIEWS["front"], np.float64)
    y = 1 - 2 * i / (count - 1)
    r, turn = math.sqrt(max(1 - y * y, 0.0)), i * math.pi * (3 - math.sqrt(5))
    return np.array([math.cos(turn) * r, y, math.sin(turn) * r])


def direction_of_angles(azimuth: float, elevation: float) -> np.ndarray:
    """Return the direction, from the centre to the camera, that an azimuth and an elevation stand for.

    Parameters
    ----------
    azimuth : float
        Degrees; 0 is the front (+z), 90 the right (+x).
    elevation : float
        Degrees; 90 is the top (+y).

    Returns
    -------
    float64 [3]
        Of length 1.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])


def bounding_sphere(positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the sphere round the axis-aligned box of points.

    Parameters
    ----------
    positions : float [V, 3]
        Points that are not finite do not count.

    Returns
    -------
    centre : float64 [3]
        Of the box; the origin without points.
    radius : float
        Half the box's diagonal; 0 without points.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    finite = np.isfinite(positions).all(axis=1)
    positions = positions if finite.all() else positions[finite]
    if len(positions) == 0:
        return np.zeros(3), 0.0
    low, high = positions.min(axis=0), positions.max(axis=0)
    return low / 2 + high / 2, math.hypot(*(high / 2 - low / 2).tolist())


def to_camera(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Transform world points to camera space.

    Parameters
    ----------
    camera : Camera
        The camera.
    points : float64 [M, 3]
        World.

    Returns
    -------
    float64 [M, 3]
        x to the right and y downwards in pixels from the picture's centre (at depth 1 if perspective), and the depth along
        forward in world units.

    Notes
    -----
    Each point is computed on its own, in a fixed order of operations: equal points have equal images, at any index.
    """
    points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    out = np.empty((len(points), 3))
    axes = np.array([camera.right, camera.up, camera.forward], np.float64)
    _turn(points, np.asarray(camera.eye, np.float64), axes, np.array((1 / camera.pixel, -1 / camera.pixel, 1.0)), out)
    return out


@kernel
def _turn(points, eye, axes, scales, out):
    """Writes (points - eye) along each axis, times its scale, into out float64 [M, 3]. axes: float64 [3, 3]."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        for k in range(3):
            out[i, k] = (x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2]) * scales[k]


def to_screen(camera: Camera, seen: np.ndarray) -> np.ndarray:
    """Project points in camera space to the screen.

    Parameters
    ----------
    camera : Camera
        The camera.
    seen : float64 [M, 3]
        From to_camera().

    Returns
    -------
    float64 [M, 4]
        x, y in pixels, depth, and 1 / w: 1 if orthographic, 1 / depth if perspective. Points with depth <= 0 are behind the
        camera; their x and y have no meaning.
    """
    out = np.empty((len(seen), 4))
    with np.errstate(all="ignore"):
        out[:, 3] = 1 / seen[:, 2] if camera.perspective else 1.0
        out[:, 0] = seen[:, 0] * out[:, 3] + camera.width / 2
        out[:, 1] = seen[:, 1] * out[:, 3] + camera.height / 2
    out[:, 2] = seen[:, 2]
    return out


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Project world points to the screen.

    Parameters
    ----------
    camera : Camera
        The camera.
    points : float64 [M, 3]
        World.

    Returns
    -------
    float64 [M, 4]
        As of to_screen().
    """
    with np.errstate(all="ignore"):
        return to_screen(camera, to_camera(camera, points))


def _size(size):
    """(width, height) from an integer or a pair of them."""
    try:
        sides = [operator.index(side) for side in ((size, size) if np.ndim(size) == 0 else size)]
    except TypeError:
        sides = []
    if len(sides) != 2 or not all(1 <= side <= MAX_SIZE for side in sides):
        raise InputError("TXF-I90", "the size of a picture must be one or two integers", value=str(size),
                         allowed=f"1..{MAX_SIZE}")
    return tuple(sides)


def _place(point):
    point = np.asarray(point, np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError("TXF-I91", "the position of the camera must be three finite numbers", value=str(point))
    return point


def _unit(direction):
    direction = _place(direction)
    largest = np.abs(direction).max()
    if largest == 0:
        raise InputError("TXF-I91", "the direction of the camera is zero", value=str(direction))
    direction = direction / largest
    return direction / math.hypot(*direction.tolist())


def _axes(direction):
    """(right, up, forward) of a camera that looks against a unit direction."""
    forward = -direction
    upwards = np.array([0.0, 0.0, 1.0] if math.hypot(direction[0], direction[2]) < AXIS else [0.0, 1.0, 0.0])
    right = np.cross(forward, upwards)
    right /= math.hypot(*right.tolist())
    return right, np.cross(right, forward), forward


def _radius(radius):
    if not (math.isfinite(radius) and radius >= 0):
        raise InputError("TXF-I92", "the radius must be finite and not negative", value=radius)
    return float(radius) or 1.0


def _half_angle(fov_degrees):
    if not 0 < fov_degrees < 180:
        raise InputError("TXF-I92", "the field of view is out of range", value=fov_degrees, allowed="between 0 and 180 degrees")
    return math.radians(fov_degrees) / 2
