"""Sixth stage: the values of every field, transferred from the source (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..decision import record
from ..stages import Filled
from .coding import coding_of

if TYPE_CHECKING:
    from ...codecs.base import Codec
    from ...report import Report
    from ..caches import Cache
    from ..stages import Placed


@dataclass(frozen=True, kw_only=True)
class FillRequest:
    """Fields of EncodeOptions that values depend on, beside their price. codec: the codec itself; settings: of its settings()."""

    codec: Codec
    settings: Any  # each codec has a class of its own
    qp: int | None
    refine: str
    refine_iterations: int


def fill(placed: Placed, request: FillRequest, fields: Cache, report: Report) -> Filled:
    """Run the sixth stage: return the Filled of a placed mesh, with values from the source in all fields. fields: cache of
    transferred and fitted values. Raises InputError, LimitError."""
    shaded = placed.shaded
    meshed, prepared = shaded.meshed, shaded.meshed.prepared
    price = meshed.price
    filled = record(coding_of(price).content(placed, request, fields, report), report)
    return Filled(request=request, price=price, surface=meshed.mesh.value.surface, geometry=placed.geometry,
                  source=filled.value.source, fields=filled.value.fields, materials=prepared.materials, shading=shaded.shading,
                  resolution=price.resolution if placed.names else None,
                  evidence=prepared.evidence | meshed.evidence | shaded.evidence | filled.evidence)
