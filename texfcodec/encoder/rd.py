"""Rate and distortion: the one door to what a candidate costs and how it looks (encoder only).

The QP is the quality that was requested, and with it a price of a byte, lambda, in squared error of the picture. Of candidates
the one is taken whose bytes and error cost the least (RateDistortion.cost); each is coded where a further byte would buy that
much and no more (qp_offset). Lambda depends on the QP and on the source alone, never on what was taken, and neither do the
candidates: so a finer QP gets no fewer bytes and no larger error, as far as the estimates are true.

Each kind of candidate has an estimate of its own in estimates/: supports are coded on small pieces (probe.py), partitions
compared without coding (partition_error.py), UVs and positions rounded and looked at (uv_rounding.py, position_error.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..codecs import codec_of
from ..codecs.base import PlaneCodec
from ..core.colour_error import decibels
from ..geometry.areas import face_areas
from ..scene.channels import BASE_COLOUR
from .coder import Coder
from .decide.channel_weights import shown_of_radians
from .estimates import partition_error, position_error, probe, uv_rounding
from .estimates.usual_values import USUAL_K
from .memo import Memo, NoMemo
from .source_field import transfer_density

if TYPE_CHECKING:
    from ..codecs.base import Source
    from ..geometry.surface import Surface
    from ..limits import Limits
    from ..options import EncodeOptions
    from ..scene.scene import Scene
    from .estimates.position_error import PositionError
    from .estimates.probe import Patch, Probe
    from .source_field import SourceField
    from .texel_field import TexelPlan

# Squared steps that a bit of values takes from the squared error of the picture where the coder works: medians of 13 images from
# QP 40 to 20 are 0.06 to 0.08 over texels and 0.08 to 0.10 over voxels of K 1024, quartiles 0.06 and 0.11; maps of three
# components, whose error is the mean over these, have less.
TRADE_OFF = 0.06
MOST_SHORT, AIMED_SHORT = 4.0, 3.0  # dB under the QP's promise: of base colour at most, and what probes, a dB off, aim at
MOST_COARSER = 9  # offset that slopes may ask for
MOST_TURNS = 2  # codings of a probe beyond the first, where slopes point too far away
SURE = 0.88  # of the cost without, from which on they are followed
FINEST, COARSEST = -12, 3  # offsets to the QP; what is coarser by more would fall short of the rate's promise
LEFT_BY_FIT, APART = probe.LEFT_BY_FIT, probe.APART
Result = TypeVar("Result")


def coding_mse(qp: int) -> float:
    """Rough luma error that coding at this QP leaves, for weighing gains: 6.4 at QP 28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


def bounded_mse(max_error: int) -> float:
    """Error of values that are evenly spread over the bound, their rounding included."""
    return (2 * max_error + 1) ** 2 / 12


@dataclass(frozen=True, kw_only=True)
class RateDistortion:
    """Estimates at one quality. coder: None for a codec that codes all fields together; qp: whose error is reckoned with;
    max_error: bound on errors, None without one; resolution: K of the rate; is_free: whether QPs of supports may differ from it;
    is_fitted: whether a surface fit may follow the transfer; has_promise: whether parts have to be as close as the
    QP promises; values: that the surface would have if all of it were as dense as
    what is coded usually is (estimates.usual_values), which lambda is about; memo: of what other plans of the scene may use."""

    coder: Coder | None
    qp: int
    max_error: int | None
    resolution: int
    effort: str
    is_free: bool
    is_fitted: bool
    area_threshold: int
    threads: int
    limits: Limits
    values: float = 1 << 20
    has_promise: bool = True
    memo: Memo = field(default_factory=NoMemo, compare=False)

    @classmethod
    def of(cls, request: EncodeOptions, memo: Memo | None = None) -> RateDistortion:
        """The estimates of a request."""
        codec = codec_of(request.codec)
        coder = Coder(codec, codec.settings(request)) if isinstance(codec, PlaneCodec) else None
        assert request.resolution is not None  # its __post_init__ fills it in
        return cls(coder=coder, qp=request.reckoned_qp, max_error=request.max_error, resolution=request.resolution,
                   effort=request.effort, is_free=request.rate_is_free, is_fitted=request.may_fit,
                   area_threshold=request.area_threshold, threads=request.threads, limits=request.limits,
                   memo=memo or NoMemo())

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
    def step(self) -> float:
        """Of the quantiser, in levels."""
        return 2 ** ((self.qp - 4) / 6)

    @property
    def byte(self) -> float:
        """Lambda: squared error of the picture, the mean over all of it, that a byte is worth."""
        return 8 * TRADE_OFF * self.step**2 / max(self.values, 1.0)

    def cost(self, size: float, error: float, share: float = 1.0) -> float:
        """Of a candidate, in bytes: its own and those that its squared error on a share of the surface is worth."""
        return size + share * error / self.byte if error else size

    def on_part(self, share: float) -> RateDistortion:
        """The estimates for a share of the surface alone, by which its error counts."""
        return replace(self, values=self.values * share)

    def qp_offset(self, values: float, share: float) -> int:
        """To the QP, for a support with so many values on a share of the surface: the fewer there are, the more of the picture
        each is, and the finer steps its bits are worth."""
        if not self.is_free or not values:
            return 0
        return min(max(round(3 * math.log2(values / share / self.values)), FINEST), COARSEST)

    def keeps_promise(self, one: Probe, patch: Patch) -> bool:
        """Whether base colour is as close as the QP promises, or short of that by MOST_SHORT."""
        return not self.has_promise or one.colour <= self._worst(patch, MOST_SHORT)

    def _worst(self, patch, short):
        """Squared error of base colour, with its weight, that is short of the promise of the QP by some dB."""
        weight = patch.scene.weights.get(BASE_COLOUR.name, BASE_COLOUR.weight)
        return weight * 10 ** (short / 10) * self.coding_mse

    def _settled(self, make: Callable[[int], Probe], patch: Patch, values: float) -> Probe:
        """The Probe at the QP at which its bytes and error cost least, or at a finer one where the promise needs that. make:
        codes it at an offset to the QP; values: how many it has."""
        offset = self.qp_offset(values, patch.weight)
        one = make(offset)
        for _ in range(MOST_TURNS):
            steps = self._best_steps(one, patch)
            if -APART // 2 <= steps <= APART:
                return one.at(steps)
            offset += max(steps, -APART)  # too far for the slopes
            one = make(offset)
        return one.at(max(min(self._best_steps(one, patch), APART), -APART // 2))

    def _best_steps(self, one, patch):
        """Steps of QP from a Probe to where it is settled."""
        if not self.is_free or not one.slopes[0]:
            return 0
        steps = range(FINEST - one.qp_offset, MOST_COARSER - one.qp_offset + 1)
        cost = {k: self.cost(at.bytes, at.error, patch.weight) for k in steps for at in (one.at(k),)}
        best = min(cost, key=cost.__getitem__)
        chosen = best if cost[best] < SURE * cost[0] else 0
        kept = (k for k in range(0, chosen, -1) if one.at(k).colour <= self._worst(patch, 0.0))
        chosen = max(chosen, next(kept, chosen))  # no finer than the promise
        most = self._worst(patch, AIMED_SHORT)
        if not self.has_promise or one.uncoded > most:
            return chosen
        return min(chosen, max((k for k in steps if one.at(k).colour <= most), default=steps[0]))

    def gain(self, before: float, after: float) -> float:
        """dB between two squared errors of values before coding, at the quality that coding leaves."""
        return decibels(after + self.floor) - decibels(before + self.floor)

    def patch(self, scene: Scene, surface: Surface, faces: np.ndarray, texels: float = math.inf) -> Patch | None:
        """Points of some faces, int64 [F], that candidates are compared at; None where these have no area. texels: of the image
        there. A small part with many counts for more than its share: who looks at it sees it large, at the rate's QP."""
        if not face_areas(surface.lattice, surface.faces[faces]).any():
            return None

        def patch():
            made = probe.Patch(scene, surface, faces, self.threads)
            made.weight = max(made.weight, min(made.voxels(USUAL_K), texels) / self.values)
            return made

        return self.memo.of_qualities().get(("patch", faces.tobytes(), texels), patch)

    def of_field(self, name: str, source: Source, part: SourceField, make: Callable[[], Result]) -> Result:
        """What a step made of a field over voxels from the source, which no QP changes. name: of the step, and of the field."""
        covered = source.face_field.tobytes(), part.support.keys.tobytes(), self.resolution
        _, result = self.memo.get((name, id(source.surface), *covered), lambda: (source.surface, make()))
        return result

    def texels(self, patch: Patch, plan: TexelPlan, keys: np.ndarray, cell: int) -> Probe:
        """A TexelPlan, coded in pieces, squares with a side of 2**cell texels. keys: int64 [N], the texels that it covers."""

        def coded(offset):
            return replace(probe.probe_texels(patch, plan, keys, cell, self.planes.shifted(offset)), qp_offset=offset)

        return self._settled(coded, patch, len(keys))

    def voxels(self, patch: Patch, resolution: int, cell: int) -> Probe:
        """Voxels at a resolution, coded in pieces, cubes with a side of 2**cell voxels."""
        density = transfer_density(patch.texels_per_edge(resolution), self)

        def coded(offset):
            made = probe.probe_voxels(patch, resolution, cell, density, self.planes.shifted(offset), self.area_threshold,
                                      self.is_fitted)
            return replace(made, qp_offset=offset)

        return self._settled(coded, patch, patch.voxels(resolution))

    def rounded_uv(self, patch: Patch, plan: TexelPlan) -> np.ndarray:
        """By bits of UVs below the texel, float64: squared error of rounding."""
        return uv_rounding.rounding_errors(patch, plan)

    def moved_positions(self, scene: Scene, usual: Surface) -> PositionError:
        """What a surface that has moved from the usual lattice does to pictures, and what that does to shading normals."""
        return position_error.PositionError(scene, usual, shown_of_radians(scene.weights), self.threads)

    def partition(self, scene: Scene, surface: Surface, face_field: np.ndarray, resolution: int) -> dict[str, float]:
        """Squared errors of voxels without coding, {"y", "alpha"}. face_field: int64 [F]."""
        return partition_error.uncoded_errors(scene, surface, face_field, resolution, self.area_threshold, self.threads)
