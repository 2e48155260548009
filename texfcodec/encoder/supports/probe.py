"""Cost and quality of a support, measured on small pieces of the surface (encoder only).

Around a few points spread evenly by area and contrast, cells of the support are cut out, filled from the source, coded and
decoded at the QP at hand. Bits per value and the error at surface points well inside these cells stand for the whole: bytes come
out 1 to 17 % too high on six assets and 43 % on a small one, where the two supports differ by more, or by so little that either
will do (docs/design/texels.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...codecs.base import Group
from ...core.colour_error import ColourError, decibels
from ...core.kernel import kernel
from ...field.grid import build_brick_map
from ...field.morton import decode_morton, encode_morton
from ...field.query import query_field
from ...field.texels import TexelSupport
from ...field.transfer import texels_per_edge, transfer
from ...field.voxelise import voxelise
from ...field.voxels import VoxelSupport
from ...geometry.areas import face_areas, sample_surface
from ...scene.channels import BASE_COLOUR, BY_NAME, COLOURS
from ...scene.fetch import map_columns, pack_map, pack_source, sample_source
from ...scene.scene import WRAP_CLAMP, WRAP_REPEAT
from ..values.coder import Coder
from ..values.source_field import transfer_density

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene
    from ..price import Lagrangian
    from .texel_plan import TexelPlan

VOXELS_PER_AREA = 1.05  # voxels over surface in voxel faces; 1.015 to 1.071 on seven assets at K 512
VOXEL_CELLS, TEXEL_CELLS = 40, 24  # 24 are too few to tell K 1024 from K 724 on a scan: half a dB off, and 11 % of the bytes
VOXEL_CELL, TEXEL_CELL = 5, 6  # log2 of a cell's side
UNSEEN = 255.0**2  # the squared error of voxels that are not there
POINTS, LEAST_POINTS = 1 << 16, 100
SLOPE = 0.8  # bytes of the values ~ error ** -SLOPE from r01 to r04: 0.4 to 0.7 on detailed images, 0.9 to 1.7 on smooth ones
APART = 6  # QP between the two codings of a probe: a step twice as large
LEAST_BITS, LEAST_ERROR = 1e-4, 1e-3  # of a value, and of coding, that slopes are reckoned with
MOST_ADDED = 1 / 3  # log2 of squared error by a step of QP, at most: as the square of the step
LEFT_BY_FIT = 0.6  # share of the transfer's squared error that a fit leaves; 0.39 to 0.85 on seven assets at K 512 and 1024


@dataclass(frozen=True)
class TrialCoding:
    """Bytes and error of a support, estimated from samples of it that were coded on trial. values: number on the whole surface;
    bits: per value; mse: at surface points, after coding; qp_offset: of the trial to the rate's QP; fixed: bytes beside the
    values; maps: TrialCodings of further channels, by name; uncoded: squared error before coding; alpha: the part of mse that is
    alpha's; slopes: log2 changes of the bits (less) and of the error of coding (more) with a step of QP, (0, 0) if not
    measured."""

    values: int
    bits: float
    mse: float
    qp_offset: int = 0
    fixed: float = 0.0
    maps: dict = field(default_factory=dict)
    uncoded: float = 0.0
    alpha: float = 0.0
    slopes: tuple[float, float] = (0.0, 0.0)

    def at(self, steps: int) -> TrialCoding:
        """Return the trial as predicted, by its slopes, at a QP that is coarser by some steps; finer if they are negative."""
        saved, added = self.slopes
        mse = self.uncoded + (self.mse - self.uncoded) * 2.0 ** (added * steps)
        alpha = self.alpha * mse / self.mse if self.mse else 0.0
        return replace(self, bits=self.bits * 2.0 ** (-saved * steps), mse=mse, alpha=alpha, qp_offset=self.qp_offset + steps,
                       maps={name: trial.at(steps) for name, trial in self.maps.items()})

    @property
    def attributes(self) -> float:
        """Bytes of the values of all channels."""
        return self.values * self.bits / 8 + sum(trial.attributes for trial in self.maps.values())

    @property
    def bytes(self) -> float:
        """Bytes of the values and fixed bytes."""
        return self.attributes + self.fixed

    @property
    def error(self) -> float:
        """Squared error of the shaded picture by all channels, over the surface of the trial."""
        return self.mse + sum(trial.error for trial in self.maps.values())

    @property
    def colour(self) -> float:
        """Squared error of base colour alone, with its weight."""
        return self.mse - self.alpha

    @property
    def flat(self) -> TrialCoding:
        """Squared error of base colour and alpha alone, as pictures without light show them."""
        return replace(self, maps={})

    def evidence(self) -> dict:
        """Return the entry of the report."""
        channels = {name: round(decibels(max(trial.mse, 1e-4)), 2) for name, trial in self.maps.items()}
        return {"values": self.values, "attribute_bytes": round(self.attributes), "geometry_bytes": round(self.fixed),
                "qp_offset": self.qp_offset, "psnr_y": round(decibels(max(self.colour, 1e-4)), 2),
                } | ({"psnr_of_maps": channels} if channels else {})


class SampleRegion:
    """The sampled part of a surface: a scene's faces with evenly spread points on them. faces: int64 [F] into surface's; name: of
    the channel, None for base colour and alpha; maps: the regions of further channels by name; weight: of its squared error in
    that of the picture, by default its share of the surface's area; colours: region of base colour on the same faces."""

    def __init__(self, scene: Scene, surface: Surface, faces: np.ndarray, threads: int, name: str | None = None,
                 colours: SampleRegion | None = None) -> None:
        self.scene, self.surface, self.faces, self.threads, self.name = scene, surface, faces, threads, name
        if colours is None:
            self.face, self.bary = sample_surface(surface.lattice.astype(np.float64), surface.faces[faces], POINTS)
        else:
            self.face, self.bary, self._areas = colours.face, colours.bary, colours._areas
        self.source = self.packed(faces)
        self.colour = sample_source(self.source, self.face, self.bary, threads)
        self.maps: dict[str, SampleRegion] = {}
        if name is None:
            names = {n for m in np.unique(surface.material[faces]) for n in scene.materials[m].maps}
            self.maps = {n: SampleRegion(scene, surface, faces, threads, n, self) for n in sorted(names)}
        corners = surface.lattice[surface.faces[faces[self.face]]]
        self.points = np.einsum("nc,ncd->nd", self.bary, corners)  # on the lattice
        self.weight = self.area / float(self._areas.sum())

    def packed(self, faces: np.ndarray) -> tuple:
        """Return the region's channel on some faces of the surface, int64 [F], as a source that scene.fetch samples."""
        rows = self.surface.origin_face[faces]
        return pack_source(self.scene, rows) if self.name is None else pack_map(self.scene, self.name, rows)

    def values(self, rgba: np.ndarray) -> np.ndarray:
        """Return the components that are coded of sampled RGBA, float32 [N, C]: RGB with alpha if it varies, or the columns of a
        map. rgba: float32 [N, 4], sampled from packed()."""
        if self.name is None:
            return np.ascontiguousarray(rgba[:, : 3 if self.colour[:, 3].min() == 255 else 4])
        return np.ascontiguousarray(rgba[:, map_columns(self.name)])

    @property
    def area(self) -> float:
        """Area in squared lattice steps."""
        return float(self._areas[self.faces].sum())

    @cached_property
    def _areas(self):
        return face_areas(self.surface.lattice, self.surface.faces)

    def voxels(self, resolution: int) -> int:
        """Return the rough number of voxels that the region's faces fill at a resolution K."""
        return round(self.area * (resolution / (1 << self.surface.cube.position_bits)) ** 2 * VOXELS_PER_AREA)

    def texels_per_edge(self, resolution: int) -> float:
        """Return the mean number of texels along the edge of a voxel at a resolution K, in the channel with the most."""
        surface, faces = self.surface, self.surface.faces[self.faces]
        own = texels_per_edge(surface.lattice, faces, self.source, surface.cube.position_bits, resolution)
        return max([own, *(region_of_map.texels_per_edge(resolution) for region_of_map in self.maps.values())])

    def mse(self, chosen: np.ndarray, got: np.ndarray, stands_for: np.ndarray | None = None) -> float:
        """Return the mean squared error of values at chosen points of the region, int64 [n]: of Y and, if it is coded, of alpha;
        for a map the mean over its components, times its weight. got: float32 [n, C], the values there, as of values();
        stands_for: float64 [n], area of the surface that each point stands for, None if all are equal."""
        if not len(chosen):
            return 0.0
        shares = np.ones(len(chosen)) if stands_for is None else stands_for
        if self.name is not None:
            weight = self.scene.weights.get(self.name, BY_NAME[self.name].weight)
            squares = ((self.values(self.colour[chosen]) - got) ** 2).mean(axis=1)
            return weight * float(np.average(squares, weights=shares))
        error, seen = ColourError(), shares * (self.colour[chosen, 3] / 255)
        error.add(self.colour[chosen, :3], got[:, :3], seen if seen.any() else shares)
        alpha = self.alpha_mse(chosen, got, shares)
        return self.scene.weights.get(BASE_COLOUR.name, BASE_COLOUR.weight) * error.mse()["y"] + alpha

    def alpha_mse(self, chosen: np.ndarray, got: np.ndarray, stands_for: np.ndarray) -> float:
        """Return the mean squared error of alpha at chosen points, 0 if it is not coded; arguments as of mse()."""
        if self.name is not None or got.shape[1] < 4 or not len(chosen):
            return 0.0
        return float(np.average((self.colour[chosen, 3] - got[:, 3]) ** 2, weights=stands_for))


class _Points(NamedTuple):
    """Points at which a TrialCoding's error is measured. chosen: int64 [n] of the region's points; stands_for: float64 [n], area
    that each stands for; query: function that returns the values of a plane there, float32 [n, C]."""

    chosen: np.ndarray
    stands_for: np.ndarray
    query: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class _ProbedPart:
    """The sampled values of a channel before coding. region: its SampleRegion; plane: float32 [N, C], the values of the support's
    cells; uncoded: squared error at the points; saved: what a surface fit is likely to take from that."""

    region: SampleRegion
    plane: np.ndarray
    uncoded: float
    saved: float = 0.0


@dataclass(frozen=True)
class Probe:
    """Cells of a support with values from the source, to be coded on trial at any QP. values: number on the whole surface; parts:
    further channels first, base colour last; none if no cell holds a value."""

    values: int
    support: TexelSupport | VoxelSupport
    points: _Points
    parts: tuple[_ProbedPart, ...] = ()

    @property
    def least_error(self) -> float:
        """Squared error of all channels before coding, which no QP falls below."""
        return sum(part.uncoded - part.saved for part in self.parts)

    def coded(self, coder: Coder) -> TrialCoding:
        """Return the TrialCoding at the coder's QP."""
        trial, maps = TrialCoding(self.values, 24.0, UNSEEN), {}
        for part in self.parts:
            trial = self._coded_part(part, coder)
            if part.region.name is not None:
                maps[part.region.name] = trial
        return replace(trial, maps=maps)

    def _coded_part(self, part, coder):
        """Return the TrialCoding of a channel at the coder's QP and, for its slopes, APART from it."""
        region, points = part.region, self.points
        (bits, decoded), (fewer, coarser) = (_coded(part.plane, self.support, region, coder.shifted(steps))
                                             for steps in (0, APART))
        at, chosen, shares = points.query(decoded), points.chosen, points.stands_for
        mse, more = (region.mse(chosen, got, shares) for got in (at, points.query(coarser)))
        saved = math.log2(max(bits, LEAST_BITS) / max(fewer, LEAST_BITS)) / APART
        added = math.log2(max(more - part.uncoded, LEAST_ERROR) / max(mse - part.uncoded, LEAST_ERROR)) / APART
        slopes = max(saved, 0.0), min(max(added, 0.0), MOST_ADDED)
        return TrialCoding(self.values, bits, mse - part.saved, uncoded=min(part.uncoded, mse) - part.saved,
                           alpha=region.alpha_mse(chosen, at, shares), slopes=slopes)


def _coded(plane, support, region, quality):
    """Return (bits per value, decoded) of float32 [N, C]: a map, or colour and, if it is there, alpha by itself."""
    decoded, size, name = [], 0, region.name
    parts = [plane] if name is not None else np.split(plane, [3], axis=1)[: plane.shape[1] - 2]
    channels = COLOURS if name is None else (BY_NAME[name],)
    for part, channel in zip(parts, channels, strict=False):
        coder = quality.for_group(Group((channel,)), region.scene.weights).roughly()
        count, values = coder.size(np.ascontiguousarray(part), support)
        size += count
        decoded.append(values)
    return 8 * size / len(plane), np.concatenate(decoded, axis=1)


class _Cells(NamedTuple):
    """Cells of a grid that stand for all. keys: Morton keys int64 [K], ascending; stands_for: float64 [K], area of the surface
    that a point of each cell stands for."""

    keys: np.ndarray
    stands_for: np.ndarray

    def of_points(self, keys):
        """Return the area that each of some points stands for, float64 [n]. keys: int64 [n], Morton keys of their cells."""
        return self.stands_for[np.searchsorted(self.keys, keys)]


def _sampled_cells(region, places, cell, most, held=None):
    """Return up to `most` _Cells of a region's points, at places int64 [M, d]. Cells are taken evenly from the smoothest to the
    one with the most contrast, because chance would miss rare detail, and by their number of values, so that bits are those of
    all; a point of a cell with few values for its surface stands for more. held: ascending keys of values, int64 [N]; without
    them a cell has as many as points."""
    keys, own, counts = np.unique(_cell_keys(places, cell), return_inverse=True, return_counts=True)
    contrast = np.zeros(len(counts))
    for part in (region, *region.maps.values()):
        value = part.colour[:, :3].mean(axis=1, dtype=np.float64)
        mean, square = (np.bincount(own, value**power) / counts for power in (1, 2))
        contrast += square - mean**2
    ends = None if held is None else np.searchsorted(held, [keys << 3 * cell, keys + 1 << 3 * cell])
    size = counts if ends is None else np.maximum(ends[1] - ends[0], 1)
    order = np.argsort(contrast, kind="stable")
    upto = np.cumsum(size[order])
    picks = order[np.searchsorted(upto, (np.arange(most) + 0.5) * upto[-1] / most)]
    times = np.bincount(picks, minlength=len(keys))
    taken = np.flatnonzero(times)
    return _Cells(keys[taken], times[taken] / size[taken])


def _cell_keys(places, cell):
    """Return Morton keys of the cells of places, int64 [M, 2 or 3]."""
    flat = np.zeros((len(places), 3), np.int64)
    flat[:, : places.shape[1]] = places >> cell
    return encode_morton(flat)


def _within(keys, cells, cell):
    """Return those of ascending keys that are in one of the cells: each is a run of keys."""
    ends = np.searchsorted(keys, np.concatenate([cells, cells + 1]) << 3 * cell)
    return np.concatenate([keys[a:b] for a, b in zip(ends[: len(cells)], ends[len(cells) :], strict=True)])


def _well_inside(place, cell, cells):
    """Return the numbers of the places, float64 [M, d], that are in one of the cells, with all neighbours that interpolation
    needs if there are such places."""
    whole = np.floor(place).astype(np.int64)
    rest, there = place - (whole >> cell << cell), np.isin(_cell_keys(whole, cell), cells)
    inner = np.flatnonzero(((rest >= 1) & (rest <= (1 << cell) - 1)).all(axis=1) & there)
    return inner if len(inner) > LEAST_POINTS else np.flatnonzero(there)


def probe_texels(region: SampleRegion, plan: TexelPlan, keys: np.ndarray, cell: int, most: int = TEXEL_CELLS) -> Probe:
    """Return the Probe of the texels of a TexelPlan in up to `most` sampled cells (squares). keys: int64 [N], Morton keys of the
    texels that the plan covers; cell: log2 of a square's side in texels."""
    texel = np.einsum("nc,ncd->nd", region.bary, plan.group.uv[region.face]) * np.array(plan.size) / plan.group.size
    place = np.column_stack([_wrapped(texel[:, i], plan.size[i], plan.group.wrap[i]) for i in range(2)])
    sample = _sampled_cells(region, place.astype(np.int64), cell, most, keys)
    cells, inside = sample.keys, _within(keys, sample.keys, cell)
    support = TexelSupport(keys=inside, width=plan.size[0], height=plan.size[1], wrap=plan.group.wrap, fraction_bits=0)
    chosen = _well_inside(place, cell, cells)
    shares = sample.of_points(_cell_keys(np.floor(place[chosen]).astype(np.int64), cell))
    points = _Points(chosen, shares, lambda plane: support.query(texel[chosen], plane, region.threads))
    parts = tuple(_part(part, _texels_of(plan, part, support), points) for part in (*region.maps.values(), region))
    return Probe(len(keys), support, points, parts)


def _part(region, plane, points, left=1.0):
    """Return the _ProbedPart of a plane. left: share of the error that a fit leaves."""
    uncoded = region.mse(points.chosen, points.query(plane), points.stands_for)
    return _ProbedPart(region, plane, uncoded, (1 - left) * uncoded)


def _texels_of(plan, region, support):
    """Return values of the texels of a support, float32 [N, C]."""
    if region.name is not None:
        return _texels_of_map(plan, region, support)
    return region.values(plan.near_values(region.surface, support.xy(), region.threads))


def _texels_of_map(plan, region, support):
    """Return the same of a map: the mean of the image texels in each texel of the support, or the texel that its centre is in."""
    image, xy = plan.group.maps[region.name], support.xy()
    ratio = image.shape[1] / plan.size[0]
    steps = max(int(ratio), 1)
    total = np.zeros((len(xy), 4), np.float32)
    for dx, dy in np.ndindex(steps, steps):
        centre = (xy + (np.array([dx, dy]) + 0.5) / steps) / plan.size * (image.shape[1], image.shape[0])
        place = np.floor(centre).astype(np.int64)
        total += image[place[:, 1], place[:, 0]]
    rgba = total / steps**2
    return np.ascontiguousarray(rgba[:, list(BY_NAME[region.name].columns)])


def _wrapped(place, size, mode):
    """Return coordinates in texels brought into 0..size."""
    if mode == WRAP_CLAMP:
        return np.clip(place, 0, size)
    if mode == WRAP_REPEAT:
        return place % size
    return size - np.abs(place % (2 * size) - size)


def probe_voxels(region: SampleRegion, resolution: int, cell: int, price: Lagrangian) -> Probe:
    """Return the Probe of the voxels of sampled cells (cubes) of a region. resolution: K; cell: log2 of a cube's side in voxels;
    price: gives the area threshold, the density of the transfer, and whether a surface fit may follow."""
    surface, bits = region.surface, region.surface.cube.position_bits
    grid = region.points * (resolution / (1 << bits))
    sample = _sampled_cells(region, grid.astype(np.int64), cell, VOXEL_CELLS)
    cells = sample.keys
    near = _faces_near(surface.lattice, surface.faces[region.faces], resolution / (1 << bits), cells, cell)
    faces = surface.faces[region.faces[near]]
    keys, _ = voxelise(surface.lattice, faces, bits, resolution, price.area_threshold, region.threads)
    keys = _within(keys, cells, cell)
    support, values = VoxelSupport(resolution, keys), region.voxels(resolution)
    if not len(keys):
        return Probe(values, support, _Points(np.zeros(0, np.int64), np.zeros(0), lambda plane: plane))
    chosen, density = _well_inside(grid, cell, cells), transfer_density(region.texels_per_edge(resolution), price)
    shares = sample.of_points(_cell_keys(np.floor(grid[chosen]).astype(np.int64), cell))
    brick_map = build_brick_map(keys)
    points = _Points(chosen, shares, lambda plane: query_field(grid[chosen], resolution, keys, brick_map, plane,
                                                               region.threads)[0])

    def probed(part):
        packed = part.packed(region.faces[near])
        rgba = np.column_stack(transfer(surface.lattice, faces, packed, bits, resolution, keys, brick_map, density,
                                        region.threads))
        return _part(part, part.values(rgba), points, LEFT_BY_FIT if price.is_fitted and part is region else 1.0)

    return Probe(values, support, points, tuple(probed(part) for part in (*region.maps.values(), region)))


@kernel(allocates=True)
def _near_cells(lattice, faces, scale, low, high):
    """Return whether the box of a face reaches into one of the boxes from low to high, int64 [N, 3]: bool [F]. scale: of the
    lattice to their grid."""
    near, least, most = np.zeros(len(faces), np.bool_), np.empty(3), np.empty(3)
    for f in range(len(faces)):
        for c in range(3):
            a, b, d = lattice[faces[f, 0], c] * scale, lattice[faces[f, 1], c] * scale, lattice[faces[f, 2], c] * scale
            least[c], most[c] = min(a, b, d), max(a, b, d)
        for k in range(len(low)):
            near[f] |= (most[0] >= low[k, 0] and most[1] >= low[k, 1] and most[2] >= low[k, 2]
                        and least[0] <= high[k, 0] and least[1] <= high[k, 1] and least[2] <= high[k, 2])
    return near


def _faces_near(lattice, faces, scale, cells, cell):
    """Return the numbers of the faces whose boxes reach into one of the cells. lattice: int64 [V, 3]; faces: int64 [F, 3]; scale:
    of the lattice to the grid of the cells."""
    place = decode_morton(cells).astype(np.int64)
    low, high = (place << cell) - 1, (place + 1 << cell) + 1
    return np.flatnonzero(_near_cells(lattice, faces, scale, np.ascontiguousarray(low), np.ascontiguousarray(high)))
