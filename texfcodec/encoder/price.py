"""The price of a byte: costs of candidates at the requested quality (encoder only).

The QP is the requested quality. It sets lambda, the squared error of the picture that a byte is worth. The encoder takes the
candidate whose bytes and error cost least (Lagrangian.cost), and codes it at the QP at which one more byte would buy as much
(qp_offset). Lambda depends on the QP and on the source alone, never on earlier choices, and neither do the candidates: a finer QP
then has no fewer bytes and no larger error, as far as the estimates are true.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..core.colour_error import decibels

if TYPE_CHECKING:
    from ..limits import Limits
    from .values.coder import Coder

# Squared steps that a bit of values takes from the squared error of the picture where the coder works: medians of 13 images from
# QP 40 to 20 are 0.06 to 0.08 over texels and 0.08 to 0.10 over voxels of K 1024, quartiles 0.06 and 0.11; maps of three
# components, whose error is the mean over these, have less.
TRADE_OFF = 0.06
FINEST, COARSEST = -12, 3  # offsets to the QP; what is coarser by more would fall short of the rate's promise


def coding_mse(qp: int) -> float:
    """Return the rough squared error of luma, in squared levels of 255, that coding at a QP leaves. It weighs gains: 6.4 at QP
    28 (40 dB), growing with step**1.5."""
    return 6.4 * 2.0 ** ((qp - 28) / 4)


def bounded_mse(max_error: int) -> float:
    """Return the mean squared error, in squared levels, of values with errors spread evenly over -max_error..max_error, rounding
    included."""
    return (2 * max_error + 1) ** 2 / 12


@dataclass(frozen=True, kw_only=True)
class Lagrangian:
    """Prices at one quality, and the settings that every estimate shares.

    coder: None for a codec that codes all fields together; qp: whose error is assumed; max_error: bound on errors, None without
    one; resolution: K of the rate; is_free: whether QPs of supports may differ from it; is_fitted: whether a surface fit may
    follow the transfer; has_promise: whether parts have to be as close as the QP promises; values: number of values if the whole
    surface were as dense as coded content usually is (supports.reference_density), for lambda; effort, area_threshold, threads,
    limits: as of EncodeOptions.
    """

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

    @property
    def planes(self) -> Coder:
        """The coder, if the codec is one of planes."""
        assert self.coder is not None
        return self.coder

    @property
    def coding_mse(self) -> float:
        """Squared error that coding leaves at the QP."""
        return coding_mse(self.qp)

    @property
    def floor(self) -> float:
        """Squared error of coding, at the QP or within the bound."""
        return self.coding_mse if self.max_error is None else bounded_mse(self.max_error)

    @property
    def step(self) -> float:
        """Step of the quantiser, in levels."""
        return 2 ** ((self.qp - 4) / 6)

    @property
    def byte(self) -> float:
        """Lambda: squared error of the picture, as a mean over all of it, that a byte is worth."""
        return 8 * TRADE_OFF * self.step**2 / max(self.values, 1.0)

    def cost(self, size: float, error: float, share: float = 1.0) -> float:
        """Return the Lagrangian cost in bytes: size + share * error / lambda. share: part of the surface that has the error."""
        return size + share * error / self.byte if error else size

    def on_part(self, share: float) -> Lagrangian:
        """Return the prices for choices on a part of the surface alone, with errors as means over it. share: the part's of the
        area."""
        return replace(self, values=self.values * share)

    def qp_offset(self, values: float, share: float) -> int:
        """Return the offset to the requested QP for a support, in FINEST..COARSEST; 0 if QPs may not differ. values: number of
        its values; share: part of the surface that it covers. Each of few values shows on more of the picture, so its bits are
        worth finer steps."""
        if not self.is_free or not values:
            return 0
        return min(max(round(3 * math.log2(values / share / self.values)), FINEST), COARSEST)

    def gain(self, before: float, after: float) -> float:
        """Return the dB that values gain, once they are coded, if their squared error before coding falls from `before` to
        `after`. The error of coding is added to both."""
        return decibels(after + self.floor) - decibels(before + self.floor)
