"""Fifth stage: geometry units, and the voxels and texels that hold the values (encoder only)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...codecs.base import Source
from ...geometry.geometry_unit import field_surface, field_uv
from ...scene.channels import channel_over
from ..stages import Placed
from ..supports.texel_plan import texel_field
from ..values.map_planes import groups_of, map_names
from ..values.shown_maps import ShownMaps
from ..values.source_field import active_voxels, check_voxels
from .geometry_units import code_geometry, geometry_bytes
from .partition import codes_alpha

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ...geometry.geometry_unit import GeometryUnit
    from ...report import Report
    from ...scene.scene import Scene
    from ..stages import Meshed, Shaded
    from ..supports.texel_plan import SentPlan
    from ..values.source_field import SourceField


class OverBudget(Exception):
    """Raised if geometry alone takes the bytes of the stream. geometry: its bytes."""

    def __init__(self, geometry: int) -> None:
        super().__init__(f"geometry takes {geometry} bytes")
        self.geometry = geometry


def place(shaded: Shaded, budget: int | None, report: Report) -> Placed:
    """Run the fifth stage: return the Placed of a shaded mesh, its coded geometry and the voxels and texels of its fields.
    budget: bytes of the stream, None without one. Raises InputError, LimitError; OverBudget if geometry takes the whole
    budget."""
    meshed, sent = shaded.meshed, shaded.meshed.mesh.value
    first = int(meshed.partition.value.face_field.max(initial=-1)) + 1  # the number of the first field over texels
    sent_field, drawn_field = _field_numbers(meshed, shaded.plans, first)
    with report.stage("geometry") as step:
        geometry, units = code_geometry(sent.surface, sent_field, dict(enumerate(shaded.plans, first)), step)
    if budget is not None and geometry_bytes(geometry) >= budget:
        raise OverBudget(geometry_bytes(geometry))
    shown, surface = sent.shown(meshed.shown), sent.surface
    surfaces = [field_surface(units, number) for number in range(first + len(shaded.plans))]
    used = [np.unique(surface.material[sent_field == number]) for number in range(len(surfaces))]
    names = [map_names(shown.materials[m] for m in own) for own in used]
    present = {channel_over(name, number >= first).name for number, own in enumerate(names) for name in own}
    groups = groups_of(present, codes_alpha(shown.materials, surface))
    normals = lambda: sent.at_corners(shaded.shading.corner_normals(surface))
    maps = ShownMaps(shown, sent.source_on_mesh, normals) if present else None
    source = Source(shown, sent.source_on_mesh, drawn_field, surfaces, groups, maps, _on_pictures)
    fields = _fields(shaded, source, units, report)
    report.dropped += _blended_squares(shown, shaded)
    return Placed(shaded=shaded, geometry=geometry, source=source, fields=fields, names=names[:first])


def _field_numbers(meshed: Meshed, plans: list[SentPlan], first: int) -> tuple[np.ndarray, np.ndarray]:
    """Return field numbers, int64, of the faces of the sent mesh, and of the source's faces on it; TexelPlans are numbered from
    `first` on."""
    sent = meshed.mesh.value
    by_source_face = np.full(len(meshed.shown.faces), -1, np.int64)
    by_source_face[meshed.usual.origin_face] = meshed.partition.value.face_field
    sent_field = by_source_face[sent.source_face]
    for number, plan in enumerate(plans, first):
        sent_field[plan.group.faces] = number
    drawn_field = sent_field if sent.corner_places is None else by_source_face[sent.source_on_mesh.origin_face]
    return sent_field, drawn_field


def _fields(shaded: Shaded, source: Source, units: list[GeometryUnit], report: Report) -> list[SourceField]:
    """Return SourceFields, without colours over voxels, with them over texels."""
    meshed, plans = shaded.meshed, shaded.plans
    price, bits, own = meshed.price, meshed.mesh.value.surface.cube.position_bits, meshed.partition.value.own
    first = len(source.surfaces) - len(plans)
    fields: list[SourceField] = []
    for number, (lattice, faces) in enumerate(source.surfaces[:first]):
        with report.stage("voxelise", (number, first)):
            resolution, offset = own.get(number, (price.resolution, meshed.supports.qp_offset))
            part = active_voxels(lattice, faces, bits, replace(price, resolution=resolution))
            fields.append(replace(part, qp_offset=offset))
        check_voxels(fields, price.limits)  # here as well: the next may take minutes
    for number, plan in enumerate(plans, first):
        with report.stage("texels", (number - first, len(plans))):
            uv, faces = field_uv(units, number), source.surfaces[number][1]
            fields.append(texel_field(plan, uv, faces, source, price.limits, price.threads))
    check_voxels(fields, price.limits)
    return fields


def _on_pictures(fit, source, position_bits, on_progress, **schedule):
    """Call refine_by_pictures(), imported here, because few encodes need it. schedule: fields of its Schedule."""
    from ..values import picture_refinement, pictures

    given = pictures.Schedule(**schedule)
    return picture_refinement.refine_by_pictures(fit, source, position_bits, given, on_progress=on_progress)


def _blended_squares(shown: Scene, shaded: Shaded) -> Iterable[str]:
    """Return names of lost NEAREST samplers: of images that faces show in more than one colour and that do not go over texels."""
    surface, colours = shaded.meshed.mesh.value.surface, shaded.meshed.prepared.colours
    kept = np.zeros(len(surface.faces), bool)
    for plan in shaded.plans:
        kept[plan.group.faces] = plan.group.nearest
    textures = {shown.materials[m].texture for m in np.unique(surface.material[~kept]) if np.isnan(colours[m]).any()}
    names = [shown.textures[t].name or str(t) for t in sorted(textures) if t >= 0 and shown.textures[t].nearest]
    return [f"NEAREST filter of texture '{name}'" for name in names]
