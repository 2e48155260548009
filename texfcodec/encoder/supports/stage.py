"""Second stage: candidate supports of the surface (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..stages import Supported
from .choice import SupportRequest, choose_supports

if TYPE_CHECKING:
    from ...report import Report
    from ..caches import Caches
    from ..price import Lagrangian
    from ..stages import Prepared


def support(prepared: Prepared, request: SupportRequest, price: Lagrangian, caches: Caches, report: Report) -> Supported:
    """Run the second stage: return the Supported of a scene, candidate supports at a quality. Raises InputError, LimitError."""
    with report.stage("supports") as step:
        candidates = choose_supports(prepared, price, request, caches, step)
    return Supported(prepared=prepared, price=price, candidates=candidates)
