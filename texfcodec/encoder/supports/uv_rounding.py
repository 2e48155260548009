"""Error of rounded UVs in the picture, by the bits that they keep below the texel (encoder only).

Neighbouring texels in the image say little about it: UVs of a palette lie at the centres of texels and never between them, and
half a texel further is another colour. So the image is sampled at points of the surface, with exact and with rounded UVs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scene.fetch import UV_OF_SOURCE, sample_source
from .texel_plan import MOST_FRACTION_BITS, TexelPlan

if TYPE_CHECKING:
    from .probe import SampleRegion

EVERY = 4  # of a region's points, 16,384 of them
NEGLIGIBLE = 0.02  # squared error from which on each bit is taken to leave a quarter


def rounding_errors(region: SampleRegion, plan: TexelPlan) -> np.ndarray:
    """Return the squared error that rounded UVs add at surface points, the sum over channels, by number of bits: float64
    [MOST_FRACTION_BITS + 1]."""
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
