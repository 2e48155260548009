"""Rate and distortion: the one door to what a candidate costs and how it looks (encoder only).

The QP is the quality that was requested. Each kind of candidate has an estimate of its own in estimates/: supports are coded on
small pieces (probe.py), partitions compared without coding (partition_error.py), UVs and positions rounded and looked at
(uv_rounding.py, position_error.py), coarser maps coded in pieces (map_levels.py), and advice measures images without any coding
(image_measures.py). They answer in different units; what makes them comparable, the error that coding at a QP leaves, is here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..codecs import codec_of
from ..codecs.base import PlaneCodec
from ..core.colour_error import decibels
from ..geometry.areas import face_areas
from .coder import Coder
from .decide.channel_weights import shown_of_radians
from .estimates import image_measures, map_levels, partition_error, position_error, probe, uv_rounding

if TYPE_CHECKING:
    from ..field.texels import TexelSupport
    from ..field.voxels import VoxelSupport
    from ..geometry.surface import Surface
    from ..limits import Limits
    from ..options import EncodeOptions
    from ..scene.scene import Scene
    from .decide.texel_images import ImageGroup
    from .estimates.image_measures import Measures
    from .estimates.position_error import Moved
    from .estimates.probe import Patch, Probe
    from .texel_field import TexelPlan

ENOUGH = 0.25  # of the usual error at a QP: smooth images that are closer to the source than that are close enough
LEFT_BY_FIT = probe.LEFT_BY_FIT
# Squared steps that one more bit for a value takes off the error at that value: median over 13 images, QP 38 to 22, texels 0.083
# to 0.061, voxels at K 1024 0.083 to 0.105.
ERROR_OF_A_BIT = 0.06
LEAST_K = 256  # whose number of voxels counts where there are fewer values


def coding_mse(qp: int) -> float:
    """Rough luma error that coding at this QP leaves, for weighing gains: 6.4 at QP 28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


def bounded_mse(max_error: int) -> float:
    """Error of values that are evenly spread over the bound, their rounding included."""
    return (2 * max_error + 1) ** 2 / 12


@dataclass(frozen=True, kw_only=True)
class RateDistortion:
    """Estimates at one quality. coder: None for a codec that codes all fields together; qp: whose error is reckoned with;
    max_error: bound on errors, None without one; resolution: K of the rate; is_fitted: whether a surface fit may follow the
    transfer."""

    coder: Coder | None
    qp: int
    max_error: int | None
    resolution: int
    effort: str
    is_fitted: bool
    area_threshold: int
    threads: int
    limits: Limits

    @classmethod
    def of(cls, request: EncodeOptions) -> RateDistortion:
        """The estimates of a request."""
        codec = codec_of(request.codec)
        coder = Coder(codec, codec.settings(request)) if isinstance(codec, PlaneCodec) else None
        assert request.resolution is not None  # its __post_init__ fills it in
        return cls(coder=coder, qp=request.reckoned_qp, max_error=request.max_error, resolution=request.resolution,
                   effort=request.effort, is_fitted=request.may_fit, area_threshold=request.area_threshold,
                   threads=request.threads, limits=request.limits)

    @property
    def planes(self) -> Coder:
        """The coder, where the codec is one of planes."""
        assert self.coder is not None
        return self.coder

    @property
    def coding_mse(self) -> float:
        """Squared error that coding leaves at the QP."""
        return coding_mse(self.qp)

    @property
    def floor(self) -> float:
        """Squared error that coding leaves, at the QP or within the bound."""
        return self.coding_mse if self.max_error is None else bounded_mse(self.max_error)

    @property
    def least_mse(self) -> float:
        """Squared error below which nothing is worth more bytes."""
        return ENOUGH * self.coding_mse

    @property
    def step(self) -> float:
        """Of the quantiser, in levels."""
        return 2 ** ((self.qp - 4) / 6)

    def gain(self, before: float, after: float) -> float:
        """dB between two squared errors of values before coding, at the quality that coding leaves."""
        return decibels(after + self.floor) - decibels(before + self.floor)

    def patch(self, scene: Scene, surface: Surface, faces: np.ndarray) -> Patch | None:
        """Points of some faces, int64 [F], that candidates are compared at; None where these have no area."""
        if not face_areas(surface.lattice, surface.faces[faces]).any():
            return None
        return probe.Patch(scene, surface, faces, self.least_mse, self.threads)

    def texels(self, patch: Patch, plan: TexelPlan, keys: np.ndarray) -> Probe:
        """A TexelPlan, coded in pieces. keys: int64 [N], the texels that it covers."""
        return probe.probe_texels(patch, plan, keys, self.planes)

    def voxels(self, patch: Patch, resolution: int, density: int) -> Probe:
        """Voxels at a resolution, coded in pieces. density: samples per voxel edge of the transfer."""
        return probe.probe_voxels(patch, resolution, density, self.planes, self.area_threshold, self.is_fitted)

    def rounded_uv(self, patch: Patch, plan: TexelPlan, estimate: Probe) -> np.ndarray:
        """By bits of UVs below the texel, float64: squared error of rounding over that of coding."""
        return uv_rounding.rounding_shares(patch, plan, estimate)

    def moved_positions(self, scene: Scene) -> Callable[[Surface, np.ndarray], Moved]:
        """What a surface that has moved does to pictures, with what that does to shading normals: of the source's faces on it and
        the smooth normals there, float32 [F, 3, 3]."""
        look, shown = position_error.PositionError(scene, self.threads), shown_of_radians(scene.weights)

        def moved(drawn: Surface, normals: np.ndarray) -> Moved:
            seen = look.of(drawn)
            return replace(seen, mse=seen.mse + shown * look.turned_normals(drawn, normals))

        return moved

    def least_price(self, surface: Surface) -> float:
        """Bytes that a unit of squared error of pictures is worth at least: what it takes to code it away over a small number of
        values. Where colours take next to nothing, their own bytes would let a few bytes of geometry buy any error."""
        area = face_areas(surface.lattice, surface.faces).sum() / 4.0**surface.cube.position_bits
        return probe.VOXELS_PER_AREA * area * LEAST_K**2 / (8 * ERROR_OF_A_BIT * self.step**2)

    def partition(self, scene: Scene, surface: Surface, face_field: np.ndarray, resolution: int) -> dict[str, float]:
        """Squared errors of voxels without coding, {"y", "alpha"}. face_field: int64 [F]."""
        return partition_error.uncoded_errors(scene, surface, face_field, resolution, self.area_threshold, self.threads)

    def map_levels(self, plane: np.ndarray, support: VoxelSupport | TexelSupport, coder: Coder) -> tuple[int, list[float]]:
        """(levels of a map that are best left out, costs of those that were coded in pieces, in bits a cell)."""
        return map_levels.cheapest_level(plane, support, coder)

    def image_measures(self, group: ImageGroup, surface: Surface) -> Measures | None:
        """What an image costs over texels and over voxels, without coding; None where there is nothing to measure."""
        return image_measures.measured(group, surface, self.resolution, self.step, self.limits.samples)
