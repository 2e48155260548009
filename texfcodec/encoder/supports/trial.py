"""Trial codings of a support, settled at the QP where bytes and error cost least (encoder only)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...geometry.areas import face_areas
from ...scene.channels import BASE_COLOUR
from ..price import COARSEST, FINEST, Lagrangian
from .probe import APART, Probe, SampleRegion, TrialCoding, probe_texels, probe_voxels
from .reference_density import REFERENCE_K

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Material, Scene
    from ..caches import Cache
    from .texel_plan import TexelPlan

MOST_SHORT, AIMED_SHORT = 4.0, 3.0  # dB under the QP's promise: of base colour at most, and what trials, a dB off, aim at
MOST_COARSER = 9  # offset that slopes may ask for
MOST_TURNS = 2  # codings of a trial beyond the first, where slopes point too far away
MANY_CELLS = 96  # squares that have to show that a QP far above the rate's is fine enough; 24 were 5 dB off on a chess board
SURE = 0.88  # of the cost without, from which on they are followed


class _RegionKey(NamedTuple):
    """Everything beside the scene and its surface that a SampleRegion depends on."""

    faces: bytes
    texels: float


@dataclass(frozen=True)
class Trials:
    """Trial codings of samples of supports of one surface, at the prices of one quality. regions: cache of SampleRegions."""

    scene: Scene
    surface: Surface
    price: Lagrangian
    regions: Cache

    @property
    def materials(self) -> list[Material]:
        """Materials of the scene."""
        return self.scene.materials

    def keeps_promise(self, trial: TrialCoding, region: SampleRegion) -> bool:
        """Return whether a trial's base colour is as close to the source as the QP promises, or at most MOST_SHORT worse."""
        return not self.price.has_promise or trial.colour <= self._worst(region, MOST_SHORT)

    def region(self, faces: np.ndarray, texels: float = math.inf) -> SampleRegion | None:
        """Return the SampleRegion of some faces, int64 [F]: points on them for comparing candidates; None if these have no area.
        texels: number that the image has there. Small, densely textured parts get extra weight, because viewers zoom in."""
        if not face_areas(self.surface.lattice, self.surface.faces[faces]).any():
            return None

        def sampled():
            region = SampleRegion(self.scene, self.surface, faces, self.price.threads)
            region.weight = max(region.weight, min(region.voxels(REFERENCE_K), texels) / self.price.values)
            return region

        return self.regions.get(_RegionKey(faces.tobytes(), texels), sampled)

    def texels(self, region: SampleRegion, plan: TexelPlan, keys: np.ndarray, cell: int, most: float = math.inf) \
            -> TrialCoding | None:
        """Return the TrialCoding of a TexelPlan at the QP of least cost, coded in squares with a side of 2**cell texels; None if
        it is certain to cost `most` bytes. keys: int64 [N], Morton keys of the texels that the plan covers. A QP far above the
        rate's has to hold in more squares, because a few may have missed the detail."""
        trial = self._settled(probe_texels(region, plan, keys, cell), region, len(keys), most)
        if trial is None or trial.qp_offset <= COARSEST:
            return trial
        return self._settled(probe_texels(region, plan, keys, cell, MANY_CELLS), region, len(keys), most)

    def voxels(self, region: SampleRegion, resolution: int, cell: int) -> TrialCoding:
        """Return the TrialCoding of a region's voxels at a resolution K and the QP of least cost, coded in cubes with a side of
        2**cell voxels."""
        probe = probe_voxels(region, resolution, cell, self.price)
        trial = self._settled(probe, region, region.voxels(resolution))
        assert trial is not None
        return trial

    def _worst(self, region, short):
        """Return the squared error of base colour, with its weight, that is `short` dB short of the promise of the QP."""
        weight = self.scene.weights.get(BASE_COLOUR.name, BASE_COLOUR.weight)
        return weight * 10 ** (short / 10) * self.price.coding_mse

    def _settled(self, probe: Probe, region: SampleRegion, values: float, most: float = math.inf) -> TrialCoding | None:
        """Return the trial at the QP of least cost, or at a finer one if the promise needs that; None if its error alone costs
        `most` bytes before coding. values: number of values."""
        if self.price.cost(0, probe.least_error, region.weight) >= most:
            return None

        def coded(offset):
            return replace(probe.coded(self.price.planes.shifted(offset)), qp_offset=offset)

        offset = self.price.qp_offset(values, region.weight)
        trial = coded(offset)
        for _ in range(MOST_TURNS):
            steps = self._best_steps(trial, region)
            if -APART // 2 <= steps <= APART:
                return trial.at(steps)
            offset += max(steps, -APART)  # too far for the slopes
            trial = coded(offset)
        return trial.at(max(min(self._best_steps(trial, region), APART), -APART // 2))

    def _best_steps(self, trial, region):
        """Return the steps of QP from a trial to its final QP."""
        if not self.price.is_free or not trial.slopes[0]:
            return 0
        steps = range(FINEST - trial.qp_offset, MOST_COARSER - trial.qp_offset + 1)
        cost = {k: self.price.cost(at.bytes, at.error, region.weight) for k in steps for at in (trial.at(k),)}
        best = min(cost, key=cost.__getitem__)
        chosen = best if cost[best] < SURE * cost[0] else 0
        kept = (k for k in range(0, chosen, -1) if trial.at(k).colour <= self._worst(region, 0.0))
        chosen = max(chosen, next(kept, chosen))  # no finer than the promise
        most = self._worst(region, AIMED_SHORT)
        if not self.price.has_promise or trial.uncoded > most:
            return chosen
        return min(chosen, max((k for k in steps if trial.at(k).colour <= most), default=steps[0]))
