"""Sixth stage: the values of every field, transferred from the source (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..decision import record
from ..stages import Filled
from .coding import coding_of
from .refinement import Refine

if TYPE_CHECKING:
    from ...options import EncodeOptions
    from ...report import Report
    from ..caches import Cache
    from ..stages import Placed


def fill(placed: Placed, request: EncodeOptions, fields: Cache, report: Report) -> Filled:
    """Return the Filled of a placed mesh. fields: cache of transferred and fitted values. Raises InputError, LimitError."""
    shaded = placed.shaded
    meshed, prepared = shaded.meshed, shaded.meshed.prepared
    wanted, price = Refine(request.refine, request.refine_iterations), meshed.price
    filled = record(coding_of(price).content(placed, wanted, fields, report), report)
    return Filled(request=request, price=price, surface=meshed.mesh.value.surface, geometry=placed.geometry,
                  source=filled.value.source, fields=filled.value.fields, materials=prepared.materials, shading=shaded.shading,
                  resolution=price.resolution if placed.names else None,
                  evidence=prepared.evidence | meshed.evidence | shaded.evidence | filled.evidence)
