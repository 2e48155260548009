"""How many bits of a UV below the texel: those that cost the fewest bytes and leave the picture as it is (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..texel_field import MOST_FRACTION_BITS

if TYPE_CHECKING:
    from ..estimates.probe import Probe

MOST_ADDED = 0.5  # of the error that coding leaves: what rounded UVs may add, whatever they save


def fraction_bits(shares: np.ndarray, probe: Probe, bytes_a_bit: float, slope: float) -> int:
    """Bits of UVs at which values and UVs take the fewest bytes at equal quality, among those that leave the picture as it is.

    shares: of rounding_shares(); probe: the Probe that they are of; bytes_a_bit: what a further bit costs; slope: bytes of values
    go with error ** -slope."""
    sound = np.flatnonzero(shares <= MOST_ADDED)
    if not len(sound):
        return MOST_FRACTION_BITS
    costs = probe.attributes * (1 + shares[sound]) ** slope + bytes_a_bit * sound
    return int(sound[np.argmin(costs)])
