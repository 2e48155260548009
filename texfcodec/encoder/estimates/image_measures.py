"""What an image probably costs over texels and over voxels, from cheap measures and without any coding (encoder only).

How many texels the surface shows, from a small raster of the UVs; how many voxels it has, from its area; how many bits a value of
either takes, from Haar coefficients of a few windows of the image, as they are and at the voxels' size; and what the voxels lose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import RGB_TO_YUV
from ...errors import LimitError
from ...geometry.areas import face_areas, sample_surface
from ...geometry.draco import split_corners
from ...scene.fetch import values_of_map
from ..texel_field import TexelPlan, covered_texels, most_fraction_bits, wrapped_line
from .probe import SLOPE, VOXELS_PER_AREA

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ..decide.texel_images import ImageGroup

UNIT_BYTES = 60  # of a further field
SMALL = 256  # longer side of the raster that counts texels
WINDOWS, SIDE = 16, 64  # windows of the image, texels along a side
DEAD_ZONE = 1 / 3  # of the quantiser
# Made on every second of 17 assets by name, at r01, r03 and r05; how well they do on the others: docs/reports/results.md.
BITS, LEAST_BITS = 2.0, 0.05  # of a value for each bit of its Haar coefficients, and where these are all nothing
UV_BYTES = 0.3  # of a corner for each bit of its distance to the next, in texels
LOSS = 40.0  # how much the squared error that voxels leave weighs against a squared step


@dataclass(frozen=True)
class Measures:
    """Of one image group. texels: that the surface shows; shown: the same, each as often as it does; voxels: at K; per_edge:
    texels along a voxel's edge; points: corners that differ; bits: (of a texel, of a voxel); lost: squared error of voxels."""

    texels: float
    shown: float
    voxels: float
    per_edge: float
    points: int
    bits: tuple[float, float]
    lost: float

    @property
    def uv_bytes(self) -> float:
        """What UVs take, roughly."""
        return UV_BYTES * self.points * np.log2(1 + np.sqrt(self.texels / self.points))

    def cost(self, step: float) -> tuple[float, float]:
        """Bytes over texels and over voxels at equal quality. step: of the quantiser, in levels."""
        texel, voxel = (BITS * (bits + LEAST_BITS) / 8 for bits in self.bits)
        over_texels = self.texels * texel + self.uv_bytes + UNIT_BYTES
        return over_texels, self.voxels * voxel * (1 + LOSS * self.lost / step**2) ** SLOPE


def measured(group: ImageGroup, surface: Surface, resolution: int, step: float, most_rows: int | None) -> Measures | None:
    """The Measures of a group; None where there is nothing to measure. step: of the quantiser, in levels; most_rows: limit on
    samples."""
    corners = surface.faces[group.faces]
    area = face_areas(surface.lattice, corners).sum() * (resolution / (1 << surface.cube.position_bits)) ** 2
    small = min(1.0, SMALL / max(group.size))
    plan = _plan(group, tuple(max(1, round(side * small)) for side in group.size))
    uv = plan.corner_uv().reshape(-1, 2)
    try:
        count = len(covered_texels(plan, uv, np.arange(len(uv)).reshape(-1, 3), most_rows, None))
    except LimitError:
        return None
    if not area or not count:
        return None
    texels = count * (group.size[0] * group.size[1]) / (plan.size[0] * plan.size[1])
    u, v = group.uv[:, 1] - group.uv[:, 0], group.uv[:, 2] - group.uv[:, 0]
    shown = float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2)
    per_edge = float(np.sqrt(shown / area))
    points = len(split_corners(corners, _plan(group, group.size).corner_uv())[0])
    bits, lost = _bits_of(group, surface, per_edge, step)
    return Measures(texels, shown, area * VOXELS_PER_AREA, per_edge, points, bits, lost)


def _plan(group, size):
    return TexelPlan(group, size, min(2, most_fraction_bits(size, group)))


def _bits_of(group, surface, per_edge, step):
    """((bits of a texel, of a voxel), squared error of voxels) over all channels of a group, the error of the worst."""
    if group.palette:
        return (0.0, 0.0), 0.0
    face, bary = sample_surface(surface.lattice.astype(np.float64), surface.faces[group.faces], WINDOWS)
    at = np.einsum("nc,ncd->nd", bary, group.uv[face]) / np.array(group.size)
    colour = _windows(group.image, at, group.wrap)[..., :3].astype(np.float32) @ RGB_TO_YUV.T.astype(np.float32)
    planes = [colour] + [values_of_map(name, _windows(image, at, group.wrap)).astype(np.float32)
                         for name, image in group.maps.items()]
    cells = 1 << max(int(min(SIDE / max(per_edge, 0.5), 2 * SIDE)).bit_length() - 1, 0)  # voxels along a window
    cut = min(SIDE, max(1, round(per_edge * cells)))
    texel = voxel = lost = 0.0
    for plane in planes:
        part = plane[:, :cut, :cut]
        coarse = part if cells == cut else _resized(part, cells)
        error = 0.0 if cells == cut else float(((_resized(coarse, cut) - part)[..., 0] ** 2).mean())
        bits = haar_bits(plane, step)
        texel, voxel, lost = texel + bits, voxel + (haar_bits(coarse, step) if cells > 1 else bits), max(lost, error)
    return (texel, voxel), lost


def _windows(image, at, wrap):
    """uint8 [N, SIDE, SIDE, 4] of an image around points, float64 [N, 2] in widths and heights."""
    height, width = image.shape[:2]
    out = np.empty((len(at), SIDE, SIDE, 4), np.uint8)
    for window, (u, v) in zip(out, at, strict=True):
        columns = wrapped_line(np.arange(SIDE) + int(u * width) - SIDE // 2, 1, width, wrap[0])
        rows = wrapped_line(np.arange(SIDE) + int(v * height) - SIDE // 2, 1, height, wrap[1])
        window[:] = image[rows[:, None], columns]
    return out


def _resized(planes, side):
    """Squares float32 [N, S, S, C] at another side: means where it is smaller, linear where it is larger."""
    from PIL import Image

    out = np.empty((len(planes), side, side, planes.shape[3]), np.float32)
    for n, c in np.ndindex(len(planes), planes.shape[3]):
        square = Image.fromarray(np.ascontiguousarray(planes[n, ..., c]))
        out[n, ..., c] = np.asarray(square.resize((side, side), Image.Resampling.BILINEAR))
    return out


def haar_bits(planes: np.ndarray, step: float) -> float:
    """Bits per position that the orthonormal Haar coefficients of squares take once quantised: the mean over positions of the sum
    of log2(1 + |level|). planes: float32 [N, S, S, C], S a power of two; step: of the quantiser."""
    total, low = 0.0, planes
    while low.shape[1] > 1:
        a, b, c, d = low[:, ::2, ::2], low[:, 1::2, ::2], low[:, ::2, 1::2], low[:, 1::2, 1::2]
        for high in (a - b + c - d, a + b - c - d, a - b - c + d):
            total += float(np.log2(1 + np.floor(np.abs(high) / (2 * step) + DEAD_ZONE)).sum())
        low = (a + b + c + d) / 2
    return total / (len(planes) * planes.shape[1] ** 2)
