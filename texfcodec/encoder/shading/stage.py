"""Fourth stage: the rules by which a decoder derives normals and tangent frames (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.tangents import has_uv_area
from ..decision import record
from ..faces import SentFaces
from ..stages import Shaded
from ..values.shown_maps import with_folded_normals
from .frame_choice import fit_frames
from .normal_rules import choose_normals

if TYPE_CHECKING:
    from ...report import Report
    from ..caches import Cache
    from ..stages import Meshed
    from ..supports.texel_plan import SentPlan


def shade(meshed: Meshed, budget: int | None, frames: Cache, report: Report) -> Shaded:
    """Run the fourth stage: return the Shaded of a mesh, with the rules by which a decoder derives normals and with normal maps
    in its tangent frames. budget: bytes of the stream, None without one; frames: cache of fitted plans."""
    sent, supports, price = meshed.mesh.value, meshed.supports, meshed.price
    with report.stage("normals") as step:
        folded = with_folded_normals(sent.scene, sent.surface, _without_uv_area(meshed.plans))
        shading = record(choose_normals(folded, sent.surface, price.qp, budget, supports.attributes, step), report)
        fitted = record(fit_frames(sent.scene, sent.surface, shading.value, meshed.plans, price, frames), report)
    return Shaded(meshed=meshed, shading=shading.value, plans=fitted.value,
                  evidence={"normals": shading.evidence | fitted.evidence})


def _without_uv_area(plans: list[SentPlan]) -> SentFaces:
    """Return faces over texels whose coded UVs have no area."""
    flat = [plan.group.faces[~has_uv_area(plan.corner_uv())] for plan in plans]
    return SentFaces(np.concatenate(flat) if flat else np.zeros(0, np.int64))
