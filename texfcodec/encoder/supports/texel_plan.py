"""From an image group to a field over texels: integer UVs, the texels that they cover, and their values (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic

import numpy as np

from ...bitstream.syntax import MAX_UV_ORIGIN
from ...errors import LimitError
from ...field.texel_set import count_rows, referenced_texels, shown_area
from ...field.texels import TexelSupport
from ...geometry.areas import face_areas
from ...geometry.draco import MAX_UV_BITS
from ...scene.channels import BY_NAME
from ...scene.fetch import UV_OF_SOURCE, sample_source, values_of_map, wrapped
from ...scene.scene import WRAP_CLAMP
from ..faces import Faces, LatticeFaces, SentFaces
from ..values.shown_maps import frame_rotation, rotate_xy
from ..values.source_field import SourceField, colour_planes
from .resample import resampled

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ...geometry.surface import Surface
    from ...limits import Limits
    from .image_groups import ImageGroup
    from .probe import SampleRegion

MOST_FRACTION_BITS = 8
FULL_BITS = 2  # of UVs where only the weights of texels are at stake
WINDOW, MARGIN = 5, 4  # log2 of the side of a window in texels, and texels around it that are fitted with it
EVERY = 4  # of a region's points, 16,384 of them
NEGLIGIBLE = 0.02  # squared error from which on each bit is taken to leave a quarter


@dataclass(frozen=True)
class TexelPlan(Generic[Faces]):
    """A planned field over the texels of an image. group: ImageGroup, the faces and their image; size: coded (width, height);
    fraction_bits: of its UVs, below the texel; qp_offset: of its values, to the rate's QP."""

    group: ImageGroup[Faces]
    size: tuple[int, int]
    fraction_bits: int
    qp_offset: int = 0

    @property
    def signature(self) -> tuple:
        """Hashable key of the whole plan on one surface."""
        return self.group.key, self.group.faces.tobytes(), self.size, self.fraction_bits, self.qp_offset

    def corner_uv(self) -> np.ndarray:
        """Return UVs of the group's faces, int64 [F, 3, 2], in steps of 2**-fraction_bits texels of the coded size."""
        scale = np.array(self.size, np.float64) / self.group.size * (1 << self.fraction_bits)
        return np.floor(self.group.uv * scale + 0.5).astype(np.int64)

    def values(self, surface: Surface, xy: np.ndarray, threads: int) -> np.ndarray:
        """Return the colours of some texels of the image at its coded size, RGBA float32 [N, 4] in 0..255. surface: the group's,
        whose areas weigh the texels if the image is made smaller; xy: columns and rows, int32 [N, 2]."""
        group = self.group
        if self.size == group.size:
            return group.values(group.image[xy[:, 1], xy[:, 0]])
        if self.size not in group.smaller:
            shown = self._shown(surface, group.size)
            group.smaller[self.size] = group.resampled(group.image, shown, self.size, group.wrap, threads)
        return group.smaller[self.size][xy[:, 1], xy[:, 0]]

    def near_values(self, surface: Surface, xy: np.ndarray, threads: int) -> np.ndarray:
        """Return the same as values(), for few texels: a smaller image is fitted in windows around them alone, where all texels
        count alike."""
        group, side = self.group, 1 << WINDOW
        ratio = group.size[0] // self.size[0]
        if ratio == 1 or (self.size[0] * ratio, self.size[1] * ratio) != group.size or self.size in group.smaller:
            return self.values(surface, xy, threads)
        cells, own = np.unique(xy >> WINDOW, axis=0, return_inverse=True)
        out, reach = np.empty((len(xy), 4), np.float32), np.arange(-MARGIN * ratio, (side + MARGIN) * ratio)
        weight, size = np.ones((len(reach), len(reach))), (side + 2 * MARGIN, side + 2 * MARGIN)
        for number, cell in enumerate(cells):
            columns, rows = (wrapped(cell[k] * side * ratio + reach, group.size[k], group.wrap[k]) for k in (0, 1))
            fitted = group.resampled(group.image[rows[:, None], columns], weight, size, (WRAP_CLAMP, WRAP_CLAMP))
            inside = np.flatnonzero(own.ravel() == number)
            at = xy[inside] - cell * side + MARGIN
            out[inside] = fitted[at[:, 1], at[:, 0]]
        return out

    def values_of_map(self, name: str, surface: Surface, support: TexelSupport, threads: int) -> tuple[np.ndarray, int]:
        """Return (values of one of the group's maps at the field's texels, levels): float32 [n, C] for the texels of
        support.coarser(levels). Levels are above 0 if a map, smaller than the field by a power of two, keeps its own texels.
        name: its channel."""
        image = self.group.maps[name]
        size = (image.shape[1], image.shape[0])
        shift = max((self.size[0] // size[0]).bit_length() - 1, 0)
        if (size[0] << shift, size[1] << shift) == self.size:
            xy = support.coarser(shift).xy()
            return values_of_map(name, image[xy[:, 1], xy[:, 0]]), shift
        values = values_of_map(name, image)
        if size[0] < self.size[0] or size[1] < self.size[1]:
            values = _stretched(values, self.size)
        else:
            values = resampled(values, self._shown(surface, size), self.size, self.group.wrap, threads)
        xy = support.xy()
        return np.ascontiguousarray(values[xy[:, 1], xy[:, 0]]), 0

    def _shown(self, surface, size):
        """Return the area of the surface that shows each texel of an image of `size` with the group's UVs, float64 [H, W]."""
        group = self.group
        scale = (1 << FULL_BITS) * np.array(size, np.float64) / group.size
        steps = np.floor(group.uv * scale + 0.5).astype(np.int64).reshape(-1, 2)
        area = face_areas(surface.lattice, surface.faces[group.faces])
        return shown_area(steps, np.arange(len(steps)).reshape(-1, 3), FULL_BITS, size, group.wrap, area)


SourcePlan = TexelPlan[LatticeFaces]  # of faces of a SourceSurface
SentPlan = TexelPlan[SentFaces]  # of faces of the SentSurface


def _stretched(values, size):
    """Return an image float32 [H, W, C] at a size that is larger on at least one side, bilinear."""
    from PIL import Image

    parts = [Image.fromarray(np.ascontiguousarray(values[..., c])).resize(size, Image.Resampling.BILINEAR)
             for c in range(values.shape[2])]
    return np.stack([np.asarray(part) for part in parts], axis=-1)


def most_fraction_bits(size: tuple[int, int], group: ImageGroup) -> int:
    """Return the most bits below the texel that UVs of a group can have in a stream. size: coded (width, height)."""
    scale = max(size[0] / group.size[0], size[1] / group.size[1])
    reach, span = np.abs(group.uv).max() * scale, np.ptp(group.uv.reshape(-1, 2), axis=0).max() * scale
    bits = MOST_FRACTION_BITS
    while bits and (reach * 2**bits >= MAX_UV_ORIGIN - 1 or span * 2**bits >= (1 << MAX_UV_BITS) - 2):
        bits -= 1
    return bits


def rounding_errors(region: SampleRegion, plan: TexelPlan) -> np.ndarray:
    """Return the squared error that rounded UVs add at points of a region, the sum over channels, for each number of bits below
    the texel: float64 [MOST_FRACTION_BITS + 1].

    Neighbouring texels in the image say little about it: UVs of a palette lie at the centres of texels and never between them,
    and half a texel further is another colour. So the image is sampled at points of the surface, with exact and with rounded
    UVs.
    """
    errors: list[float] = []
    for bits in range(MOST_FRACTION_BITS + 1):
        known = bool(errors) and errors[-1] <= NEGLIGIBLE
        errors.append(errors[-1] / 4 if known else sum(_added(part, plan, bits) for part in (region, *region.maps.values())))
    return np.array(errors)


def _added(region, plan, bits):
    """Return the mean squared error of a region's channel by UVs that are rounded to so many bits below the texel of the coded
    size."""
    texels = np.array(plan.size, np.float64) * (1 << bits)
    rows = np.arange(0, len(region.face), EVERY)
    exact = plan.group.uv / plan.group.size
    source = list(region.source)
    source[UV_OF_SOURCE] = np.ascontiguousarray(np.floor(exact * texels + 0.5) / texels)
    got = sample_source(tuple(source), region.face[rows], region.bary[rows], region.threads)
    return region.mse(rows, region.values(got))


def covered_texels(plan: TexelPlan, uv: np.ndarray, faces: np.ndarray, most_rows: int | None, most: int | None) -> np.ndarray:
    """Return the ascending Morton keys, int64 [N], of the texels that bilinear interpolation reads anywhere on a surface. uv:
    int64 [V, 2] in steps of 2**-fraction_bits texels; faces: int64 [F, 3]. Raises LimitError for more than most_rows rows or
    `most` texels."""
    rows = count_rows(uv, faces, plan.fraction_bits)
    if most_rows is not None and rows > most_rows:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", value=rows, allowed=most_rows)
    return referenced_texels(uv, faces, plan.fraction_bits, plan.size, plan.group.wrap, most)


def texel_field(plan: SentPlan, uv: np.ndarray, faces: np.ndarray, source: Source, limits: Limits, threads: int) -> SourceField:
    """Return the SourceField of a plan: its texels and the source's values there. uv: int64 [V, 2] and faces: int64 [F, 3], the
    decoded surface; source: scene and surface that values come from. Raises LimitError."""
    keys = covered_texels(plan, uv, faces, limits.samples, limits.voxels)
    support = TexelSupport(keys=keys, width=plan.size[0], height=plan.size[1], wrap=plan.group.wrap,
                           fraction_bits=plan.fraction_bits)
    planes, shifts = colour_planes(plan.values(source.surface, support.xy(), threads), source), {}
    normals = [name for name in plan.group.maps if BY_NAME[name].unit == "degrees"]
    rotation = frame_rotation(source.scene, source.surface, plan.group.faces) if normals else None
    for name in plan.group.maps:
        values, shifts[name] = plan.values_of_map(name, source.surface, support, threads)
        planes[name] = rotate_xy(values, rotation) if name in normals else values
    return SourceField(support, 0, planes, shifts, exact=plan.group.palette, nearest=plan.group.nearest,
                       qp_offset=plan.qp_offset)
