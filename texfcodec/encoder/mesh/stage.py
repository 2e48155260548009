"""Third stage: the sent mesh, and with it the supports that cost least (encoder only).

Simplification keeps faces of two fields apart, so the partition is chosen here as well, for each candidate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from ...geometry.areas import area_shares
from ..decision import Decision, record
from ..faces import SourceSurface
from ..place.part_fields import PartFields, choose_part_fields
from ..place.partition import choose_fields
from ..place.prefilter_textures import prefilter_textures
from ..stages import Meshed
from ..supports.choice import moved_plans, without_faces
from ..supports.trial import Trials
from .choice import MeshChoice

if TYPE_CHECKING:
    from ...report import Report, Step
    from ...scene.scene import Scene
    from ..caches import Caches
    from ..stages import Supported
    from ..supports.choice import Supports
    from ..supports.texel_plan import SentPlan, SourcePlan
    from .candidates import SentMesh
    from .choice import MeshRequest


def mesh(supported: Supported, request: MeshRequest, caches: Caches, report: Report) -> Meshed:
    """Run the third stage: simplify and partition the mesh for each candidate, and return the Meshed that costs least. Raises
    InputError."""
    meshed = [_meshed(supported, candidate, request, caches, report) for candidate in supported.candidates]
    best = max(meshed, key=lambda candidate: candidate.gain)
    record(best.partition, report, request.strict)
    record(best.mesh, report)
    return best


def _meshed(supported: Supported, candidate: Decision[Supports], request: MeshRequest, caches: Caches, report: Report) -> Meshed:
    """Return the Meshed of one candidate."""
    prepared, supports = supported.prepared, candidate.value
    scene, reference = prepared.scene, prepared.surface
    price = replace(supported.price, resolution=supports.resolution, values=supports.values)
    with report.stage("partition") as step:
        choice = MeshChoice(scene, reference, price, request, supports.mse, caches.meshes)
        usual = choice.finer()
        if usual is not reference:
            supports = replace(supports, plans=moved_plans(supports.plans, scene, usual))
        trials = Trials(scene, usual, price, caches.regions)
        shown, partition = _partitioned(trials, supports.plans, prepared.colours, request.partition, step)
    with report.stage("faces") as step:
        sent = choice.smaller(usual, partition.value.face_field, supports.plans, step)
    evidence = {"supports": candidate.evidence, "partition": partition.evidence, "mesh": sent.evidence}
    return Meshed(prepared=prepared, supports=supports, plans=_on_sent(supports.plans, sent.value, usual), price=price,
                  usual=usual, shown=shown, partition=partition, mesh=sent, evidence=evidence)


def _on_sent(plans: list[SourcePlan], sent: SentMesh, usual: SourceSurface) -> list[SentPlan]:
    """Return the plans of a surface on the mesh that is sent in its place."""
    if sent.surface is not usual:
        plans = moved_plans(plans, sent.scene, SourceSurface(sent.surface))
    return cast("list[SentPlan]", plans)  # the only place where faces of a source's surface become faces of the sent one


def _partitioned(trials: Trials, plans: list[SourcePlan], colours: np.ndarray, partition: str,
                 step: Step) -> tuple[Scene, Decision[PartFields]]:
    """Return (the scene without detail that no voxel shows, PartFields on its surface). The fields are -1 for faces of
    TexelPlans, each of which gets a field of its own. colours: of material_colours()."""
    scene, surface, price = trials.scene, trials.surface, trials.price
    over_texels = np.isin(np.arange(len(surface.faces)), np.concatenate([[-1], *(plan.group.faces for plan in plans)]))
    if price.coder is not None:  # a joint codec reads the source itself, at points
        scene = prefilter_textures(scene, surface, ~over_texels, price.resolution)
    face_field, rest = np.full(len(surface.faces), -1, np.int64), ~over_texels
    if plans and not rest.any():
        return scene, Decision(PartFields(face_field, {}), {"fields": 0, "reason": "the whole surface is over texels"})
    share = float(area_shares(surface.lattice, surface.faces)[rest].sum())
    voxels = choose_fields(scene, without_faces(surface, over_texels), colours, price.on_part(share), partition, step)
    face_field[rest] = voxels.value
    parts = choose_part_fields(face_field, colours, replace(trials, scene=scene))
    return scene, replace(parts, evidence=voxels.evidence | parts.evidence, warnings=voxels.warnings)
