"""Samples of decoded fields at the fragments of a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..core.kernel import kernel
from .levels import Pyramid, pyramid_of

if TYPE_CHECKING:
    from ..texf import Texf
    from .camera import Camera

SampleFunction = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class FieldSampler:
    """Samples fields of a Texf for one picture.

    If a pixel is wider than a voxel or texel, filtering mixes the two levels nearest to the pixel's width; elsewhere values are
    exactly those of the Texf at the point.

    Parameters
    ----------
    texf : Texf
        A decoded stream.
    camera : Camera, optional
        Needed for filtering alone.
    deepest : float, optional
        Largest depth of any fragment; None: no filtering.
    positions : float64 [V, 3]
        World.
    faces : int64 [F, 3]
        texf's own, or others for the same faces in the same order.
    """

    def __init__(self, texf: Texf, camera: Camera | None, deepest: float | None, positions: np.ndarray,
                 faces: np.ndarray) -> None:
        self.texf, self.deepest = texf, 0.0 if deepest is None else deepest
        self._pixel = 0.0 if deepest is None or camera is None else camera.pixel
        self._perspective = camera is not None and camera.perspective
        self.positions, self.faces = np.ascontiguousarray(positions, np.float64), np.ascontiguousarray(faces, np.int64)
        self._uv = np.ascontiguousarray(texf.uv)
        self._density: np.ndarray | None = None

    def of_field(self, number: int, names: Sequence[str] = ()) -> SampleFunction:
        """Return the function that samples field `number` at fragments: (face int64 [M], bary float64 [M, 3], depth float64 [M])
        -> values float32 [M, C], 0..255. depth: of the fragments, along the camera's forward, which filtering needs.

        names: of planes that have one support, whose values are side by side; empty: colour and alpha, four columns.
        """
        pyramid = pyramid_of(self.texf.fields[number], names)
        if self.texf.fields[number].over_texels:
            return self._of_texels(number, pyramid)
        return self._of_voxels(number, pyramid, names)

    def _of_voxels(self, number, pyramid, names):
        texf, support = self.texf, pyramid.level(0).support
        width = self._pixel * _voxels_per_unit(texf, support)
        self._build(pyramid, width)

        def sample(face, bary, depth):
            points = surface_points(face, bary, self.positions, self.faces)
            grid = texf.cube.to_grid(points, support.resolution) / (1 << support.level_shift)

            def finest(chosen):
                if not texf.evaluators:
                    return pyramid.level(0).query(grid[chosen])
                if not names:
                    return texf.query_field(number, points[chosen])
                planes = texf.query_planes(number, names, points[chosen], face[chosen])
                return np.hstack([planes[name] for name in names])

            return _filtered(pyramid, finest, grid, width * depth if self._perspective else width)

        return sample

    def _of_texels(self, number, pyramid):
        """Function of of_field() for a field over texels; the number of texels in a pixel differs from face to face."""
        support = pyramid.level(0).support
        support.rank  # noqa: B018  built now, so that the threads only read
        if self._density is None:
            self._density = self._texels_per_pixel() if self._pixel else np.zeros(len(self.faces))
        density = self._density / (1 << support.level_shift)
        self._build(pyramid, density[self.texf.face_field == number].max(initial=0.0))

        def sample(face, bary, depth):
            texel = np.einsum("mk,mkc->mc", bary, self._uv[self.faces[face]])
            wide = density[face] * depth if self._perspective else density[face]
            return _filtered(pyramid, lambda chosen: pyramid.level(0).query(texel[chosen]), texel, wide)

        return sample

    def _texels_per_pixel(self):
        return texels_per_unit(self.positions[self.faces], self._uv[self.faces]) * self._pixel

    def _build(self, pyramid, widest):
        """Builds the levels for pixels that are at most `widest` cells wide (at depth 1 if perspective), before threads read
        them."""
        if self._perspective:
            widest *= self.deepest
        if widest > 1:
            for number in range(min(int(np.log2(widest)) + 1, pyramid.last) + 1):
                support = pyramid.level(number).support
                if support.planar:
                    support.rank  # noqa: B018


def _filtered(pyramid: Pyramid, finest, places, wide):
    """Values at places that are `wide` cells wide, float64 scalar or [M].

    finest: function (numbers of places) -> values of level 0; places: those of Level.query, [M, ...].
    """
    if not np.any(wide > 1):
        return finest(slice(None))
    fineness = np.minimum(np.log2(np.maximum(wide, 1)), pyramid.last)
    return mixed(lambda number, chosen: pyramid.level(number).query(places[chosen]) if number else finest(chosen),
                 np.broadcast_to(fineness, len(places)))


def mixed(level: Callable[[int, np.ndarray], np.ndarray], fineness: np.ndarray) -> np.ndarray:
    """Mix values linearly between the two levels around a fractional level of detail.

    Parameters
    ----------
    level : function (int, int64 [m]) -> float [m, C]
        Takes the number of a level and indices of places; returns the values there.
    fineness : float64 [M]
        Fractional level of each place.

    Returns
    -------
    float32 [M, C]
        The values.
    """
    out = None
    for number in range(int(fineness.min()), int(np.ceil(fineness.max())) + 1):
        share = np.maximum(1 - np.abs(fineness - number), 0).astype(np.float32)
        chosen = np.flatnonzero(share)
        if len(chosen):
            values = level(number, chosen)
            out = np.zeros((len(fineness), values.shape[1]), np.float32) if out is None else out
            out[chosen] += share[chosen, None] * values
    assert out is not None  # there is a place, and some level is near it
    return out


def texels_per_unit(corners: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return how many texels lie along one unit of length in the world, for each face.

    Parameters
    ----------
    corners : float64 [F, 3, 3]
        World.
    uv : float64 [F, 3, 2]
        Texels.

    Returns
    -------
    float64 [F]
        Square root of the ratio of areas; 0 if a face has no area.
    """
    world = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    return np.sqrt(np.divide(flat, world, out=np.zeros(len(corners)), where=world > 0))


def _voxels_per_unit(texf, support):
    """Voxels of a support along one unit of length in the world."""
    if texf.side == 0:
        return 0.0
    return float(texf.cube.to_grid(texf.origin + texf.side, support.resolution).max()) / texf.side / (1 << support.level_shift)


def surface_points(face: np.ndarray, bary: np.ndarray, positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the world points at barycentric coordinates of faces.

    Parameters
    ----------
    face : int64 [M]
        Face of each point.
    bary : float64 [M, 3]
        Barycentric coordinates.
    positions : float64 [V, 3]
        Contiguous.
    faces : int64 [F, 3]
        Below V; contiguous.

    Returns
    -------
    float64 [M, 3]
        The points.

    Raises
    ------
    IndexError
        There is no such face.
    """
    if len(face) and (face.min() < 0 or face.max() >= len(faces)):
        raise IndexError("face index outside the mesh")
    return _surface_points(face, bary, positions, faces)


@kernel(allocates=True)
def _surface_points(face, bary, positions, faces):
    """Bounds: surface_points has checked face against faces, set_up faces against positions."""
    out = np.empty((face.shape[0], 3))
    for i in range(face.shape[0]):
        a, b, c = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        for k in range(3):
            out[i, k] = bary[i, 0] * positions[a, k] + bary[i, 1] * positions[b, k] + bary[i, 2] * positions[c, k]
    return out
