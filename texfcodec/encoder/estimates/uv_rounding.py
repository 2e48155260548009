"""What rounding UVs does to the picture, by the bits that they keep below the texel (encoder only).

The neighbours of a texel in its image say little: UVs of a palette lie at the centres of texels and never between them, and half
a texel there is another colour. So the image is asked at points of the surface, where its UVs are and where rounding puts them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scene.fetch import UV_OF_SOURCE, sample_source
from ..texel_field import MOST_FRACTION_BITS, TexelPlan

if TYPE_CHECKING:
    from .probe import Patch, Probe

EVERY = 4  # of a patch's points, 16,384 of them
NEGLIGIBLE = 0.01  # of it: from here on each bit is taken to leave a quarter of the squared error


def rounding_shares(patch: Patch, plan: TexelPlan, probe: Probe) -> np.ndarray:
    """By number of bits, float64 [MOST_FRACTION_BITS + 1]: squared error that rounded UVs add at surface points, as a share of
    the one that coding leaves in a Probe of the plan; of all channels the largest."""
    patches = [(patch, probe.mse), *((part, probe.maps[name].mse) for name, part in patch.maps.items())]
    shares: list[float] = []
    for bits in range(MOST_FRACTION_BITS + 1):
        known = bool(shares) and shares[-1] <= NEGLIGIBLE
        shares.append(shares[-1] / 4 if known else max(_added(part, plan, bits) / mse for part, mse in patches))
    return np.array(shares)


def _added(patch, plan, bits):
    """Mean squared error of a patch's channel by UVs that are rounded to so many bits below the texel of the coded size."""
    texels = np.array(plan.size, np.float64) * (1 << bits)
    rows = np.arange(0, len(patch.face), EVERY)
    exact = plan.group.uv / plan.group.size
    source = list(patch.source)
    source[UV_OF_SOURCE] = np.ascontiguousarray(np.floor(exact * texels + 0.5) / texels)
    got = sample_source(tuple(source), patch.face[rows], patch.bary[rows], patch.threads)
    return patch.mse(rows, patch.values(got))
