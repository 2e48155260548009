"""What an encode is going to do: plan(scene, request) decides, in order, what every part of the surface becomes, at which
precision, and with which evidence. Nothing is coded here but geometry, whose decoded form everything else stands on.

An Outline is the beginning of a plan, before anything is measured: a dry run stops there. pipeline.code() turns a Plan
into a stream, at the plan's QP or, by with_qp(), at another.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..bitstream.stream import Stream, write_stream
from ..bitstream.values import header_values
from ..codecs.base import Source
from ..errors import InputError
from ..geometry.areas import area_shares
from ..geometry.geometry_unit import field_surface, field_uv
from ..geometry.surface import make_surface
from ..geometry.tangents import has_uv_area
from ..scene.channels import COLOURS, channel_over
from .coding import Content, coding_of
from .decide.channel_weights import measured_weights
from .decide.lattice import usual_surface
from .decide.lost_detail import without_lost_detail
from .decide.materials import needed_scene
from .decide.mesh import MeshChoice
from .decide.normal_rules import choose_normals
from .decide.one_colour import material_colours
from .decide.part_fields import PartFields, choose_part_fields
from .decide.partition import choose_fields
from .decide.supports import choose_supports, moved_plans, without_faces
from .decide.tangent_frames import fit_frames
from .decision import Decision
from .estimates.partition_error import codes_alpha
from .geometry_units import code_geometry, geometry_bytes
from .map_planes import groups_of, names_of_field
from .memo import Memo, NoMemo
from .optimise.refinement import Refine
from .rd import RateDistortion
from .shown_maps import ShownMaps, with_folded_normals
from .source_field import active_voxels, check_voxels
from .texel_field import texel_field

if TYPE_CHECKING:
    from ..geometry.surface import Surface
    from ..options import EncodeOptions
    from ..report import Report
    from ..scene.scene import Material, Scene
    from .decide.mesh import SentMesh
    from .decide.normal_rules import Shading
    from .decide.supports import Supports
    from .source_field import SourceField
    from .texel_field import TexelPlan


@dataclass(frozen=True, kw_only=True)
class Outline:
    """The beginning of a plan. scene: with the materials that have to be coded; materials: as the stream holds them; surface: the
    scene on the usual lattice; rd: estimates at the requested quality; evidence: by the names of the choices."""

    request: EncodeOptions
    scene: Scene
    materials: list[Material]
    surface: Surface
    rd: RateDistortion
    evidence: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All that does not depend on the QP, but for what choosing supports took from it.

    request: as it came; rd: estimates at the quality that is coded, at the chosen K; surface: the mesh that is sent, on its
    lattice; geometry: syntax values of the geometry units; source: what is coded, by channels and fields, on that mesh; fields:
    SourceFields, whose planes are empty where the codec asks the source itself; materials: as the stream holds them; shading: how
    normals are made again; resolution: K, None where nothing is over voxels; evidence: of every choice by its name.
    """

    request: EncodeOptions
    rd: RateDistortion
    surface: Surface
    geometry: list[dict]
    source: Source
    fields: list[SourceField]
    materials: list[Material]
    shading: Shading
    resolution: int | None
    evidence: dict[str, Any]

    @property
    def one_colour(self) -> bool:
        """Whether there are no values but one colour, so that no QP changes the stream."""
        return all(part.one_colour for part in self.fields) and all(group.channels[0] in COLOURS for group in self.source.groups)

    @property
    def qp(self) -> int | None:
        """That values are coded at; None where an error bound sets it, or the codec has none."""
        return self.request.qp if self.rd.coder is None else self.rd.coder.qp

    def with_qp(self, qp: int) -> Plan:
        """The plan at another QP: supports and values stay."""
        return self.at(qp=qp)

    def at(self, **quality: int | None) -> Plan:
        """The plan at another qp or max_error."""
        return replace(self, rd=replace(self.rd, coder=self.rd.planes.at(**quality)))

    def between(self, qp: float) -> Plan:
        """The plan at a QP between whole ones, where its codec has such; else at the next finer one. A byte has its price there,
        which says what is worth being exact."""
        return replace(self, rd=replace(self.rd, qp=round(qp), coder=self.rd.planes.between(qp)))


class OverBudget(Exception):
    """Geometry alone takes as many bytes as the stream may, or more. geometry: that it takes."""

    def __init__(self, geometry: int) -> None:
        super().__init__(f"geometry takes {geometry} bytes")
        self.geometry = geometry


def least_bytes(scene: Scene, request: EncodeOptions) -> tuple[int, int]:
    """(bytes of the header, bytes of the geometry) of a scene's stream with one field over voxels and the fewest position bits
    that the encoder takes: known without a look at any colour."""
    surface = make_surface(scene, request)
    geometry, _ = code_geometry(surface, np.zeros(len(surface.faces), np.int64), {})
    header = Stream(header_values([], surface, geometry, 1, groups_of(set(), False)))
    return len(write_stream(header)[0]), geometry_bytes(geometry)


def outline(scene: Scene, request: EncodeOptions, report: Report, parts: int = 1) -> Outline:
    """The lattice, and what of its materials a scene needs. parts: of the stage "effects", of which this is the first. Raises
    InputError, LimitError."""
    with report.stage("lattice"):
        surface = usual_surface(scene, request)
    with report.stage("effects", (0, parts)):
        needs = needed_scene(scene, surface, request.effects)
    return Outline(request=request, scene=needs.value.scene, materials=needs.value.materials, surface=surface,
                   rd=RateDistortion.of(request), evidence={"effects": needs.evidence})


@dataclass(frozen=True, kw_only=True)
class _Begun:
    """A plan whose supports are chosen. outline: its beginning; scene: with measured weights; colours: of material_colours."""

    outline: Outline
    scene: Scene
    colours: np.ndarray
    supports: Decision[Supports]


def begin(scene: Scene, request: EncodeOptions, report: Report, finer: frozenset[int], memo: Memo) -> _Begun:
    """The beginning of a plan, up to its supports. finer, memo: as of plan()."""

    def of_scene():
        begun = outline(scene, request, report, parts=2)
        with report.stage("effects", (1, 2)):
            weights = measured_weights(begun.scene, request.rate_is_free, request.threads) if request.effort != "fast" else None
            weighted = begun.scene if weights is None else replace(begun.scene, weights=weights)
            return begun, weighted, material_colours(weighted, begun.surface)

    first, weighted, colours = memo.get("outline", of_scene)
    begun = replace(first, request=request, rd=RateDistortion.of(request, memo))

    def supports():
        with report.stage("supports") as step:
            return choose_supports(weighted, begun.surface, begun.rd, request, colours, finer, step)

    coder = begun.rd.coder and begun.rd.coder.signature
    chosen = memo.get(("supports", coder, begun.rd.qp, finer), supports)
    return _Begun(outline=begun, scene=weighted, colours=colours, supports=chosen)


def plan(scene: Scene, request: EncodeOptions, report: Report, finer: frozenset[int] = frozenset(),
         budget: int | None = None, memo: Memo | None = None) -> Plan:
    """The Plan of a scene.

    Parameters
    ----------
    finer : frozenset of int
        Materials whose supports are to be finer than they would be chosen.
    budget : int or None
        Of the stream, in bytes: raises OverBudget, before any colour is brought over, where the geometry takes it all.
    memo : Memo or None
        What plans of this scene at other QPs share; None keeps nothing.

    Raises
    ------
    InputError, LimitError, SupportError
        As encode().
    """
    first_half = begin(scene, request, report, finer, memo or NoMemo())
    begun, scene, colours, supports = first_half.outline, first_half.scene, first_half.colours, first_half.supports
    evidence = begun.evidence
    looks = begun.rd.memo.of_plan()
    meshed = _meshed(begun, supports, scene, colours, looks, report)
    if (instead := supports.value.instead) is not None:
        other = _meshed(begun, instead, scene, colours, looks, report)
        if other.mesh.value.saved - meshed.mesh.value.saved > supports.value.behind:
            supports, meshed = instead, other
    chosen, rd, usual, shown = meshed.supports, meshed.rd, meshed.usual, meshed.shown
    parts = _said(meshed.partition, report, request.strict).value
    face_field = parts.face_field
    sent = _said(meshed.mesh, report).value
    surface = sent.surface
    with report.stage("normals") as step:
        folded = with_folded_normals(sent.scene, surface, _without_uv_area(chosen.plans))
        shading = _said(choose_normals(folded, surface, rd.qp, budget, chosen.attributes, step), report)
        frames = _said(fit_frames(sent.scene, surface, shading.value, chosen.plans, rd), report)
        chosen = replace(chosen, plans=frames.value)
    evidence = evidence | {"supports": supports.evidence, "partition": meshed.partition.evidence, "mesh": meshed.mesh.evidence,
                           "normals": shading.evidence | frames.evidence}
    first = int(face_field.max(initial=-1)) + 1
    by_row = np.full(len(shown.faces), -1, np.int64)
    by_row[usual.origin_face] = face_field
    sent_field = _numbered(by_row[sent.rows], chosen.plans, first)
    drawn_field = sent_field if sent.places is None else by_row[sent.drawn.origin_face]
    shown = sent.shown(shown)
    with report.stage("geometry") as step:
        geometry, units = code_geometry(surface, sent_field, dict(enumerate(chosen.plans, first)), step)
    if budget is not None and geometry_bytes(geometry) >= budget:
        raise OverBudget(geometry_bytes(geometry))
    surfaces = [field_surface(units, i) for i in range(first + len(chosen.plans))]
    names = [names_of_field(shown, surface, sent_field == number) for number in range(len(surfaces))]
    present = {channel_over(name, number >= first).name for number, own in enumerate(names) for name in own}
    groups = groups_of(present, codes_alpha(shown, surface))
    maps = ShownMaps(shown, sent.drawn, lambda: sent.at_corners(shading.value.corner_normals(surface))) if present else None
    source = Source(shown, sent.drawn, drawn_field, surfaces, groups, maps, _on_pictures)
    fields = _fields((chosen, parts.own), surface.cube.position_bits, source, units, rd, report)
    report.dropped += _blended_squares(shown, surface, chosen.plans, colours)
    wanted = Refine(request.refine, request.refine_iterations)
    content = coding_of(rd).content(Content(source, fields), names[:first], colours, rd, wanted, report)
    filled = _said(content, report)
    return Plan(request=request, rd=rd, surface=surface, geometry=geometry, source=filled.value.source,
                fields=filled.value.fields, materials=begun.materials, shading=shading.value,
                resolution=rd.resolution if first else None, evidence=evidence | filled.evidence)


@dataclass(frozen=True)
class _Meshed:
    """Supports with the mesh that suits them. rd: of their K; usual: the source's Surface at its bits; shown: the scene without
    detail that no voxel shows; partition: of face fields, as of _partitioned(); mesh: of a SentMesh."""

    supports: Supports
    rd: RateDistortion
    usual: Surface
    shown: Scene
    partition: Decision[PartFields]
    mesh: Decision[SentMesh]


def _meshed(begun: Outline, supports: Decision[Supports], scene: Scene, colours: np.ndarray, looks: Memo,
            report: Report) -> _Meshed:
    """The _Meshed of Supports. colours: of material_colours; looks: at meshes, which other Supports may use."""
    chosen, request = supports.value, begun.request
    rd = replace(begun.rd, resolution=chosen.resolution, values=chosen.values)
    with report.stage("partition") as step:
        choice = MeshChoice(scene, begun.surface, rd, request, chosen.mse, looks)
        usual = choice.finer()
        if usual is not begun.surface:
            chosen = replace(chosen, plans=moved_plans(chosen.plans, scene, usual))
        shown, partition = _partitioned(scene, usual, chosen.plans, colours, rd, request, step)
    with report.stage("faces") as step:
        mesh = choice.smaller(usual, partition.value.face_field, chosen.plans, step)
        sent = mesh.value
        if sent.surface is not usual:
            chosen = replace(chosen, plans=moved_plans(chosen.plans, sent.scene, sent.surface))
    return _Meshed(chosen, rd, usual, shown, partition, mesh)


def _said(decision: Decision, report: Report, strict: bool = False) -> Decision:
    """The decision, once its sentences are in the report. Raises InputError TXF-I52 for a warning where strict."""
    report.warnings += decision.warnings
    report.dropped += decision.dropped
    report.remarks += decision.remarks
    if strict and decision.warnings:
        raise InputError("TXF-I52", "the mesh would lose something, and strict forbids it", warnings=report.warnings)
    return decision


def _without_uv_area(plans):
    """Faces over texels whose UVs, as they are coded, have no area: int64 [N] of the surface's."""
    flat = [plan.group.faces[~has_uv_area(plan.corner_uv())] for plan in plans]
    return np.concatenate(flat) if flat else np.zeros(0, np.int64)


def _on_pictures(*given, **named):
    """refine_by_pictures(), imported where it is needed, which is seldom."""
    from .optimise.picture_refinement import refine_by_pictures

    return refine_by_pictures(*given, **named)


def _partitioned(scene, surface, plans, colours, rd, request, step):
    """(the scene without detail that no voxel shows, Decision of PartFields, -1 standing for faces of TexelPlans, which get a
    field each). colours: of material_colours."""
    over_texels = np.isin(np.arange(len(surface.faces)), np.concatenate([[-1], *(plan.group.faces for plan in plans)]))
    if rd.coder is not None:  # a joint codec asks the source itself, at points
        scene = without_lost_detail(scene, surface, ~over_texels, rd.resolution)
    face_field, rest = np.full(len(surface.faces), -1, np.int64), ~over_texels
    if plans and not rest.any():
        return scene, Decision(PartFields(face_field, {}), {"fields": 0, "reason": "the whole surface is over texels"})
    part = rd.on_part(float(area_shares(surface.lattice, surface.faces)[rest].sum()))
    voxels = choose_fields(scene, without_faces(surface, over_texels), colours, part, request.partition, step)
    face_field[rest] = voxels.value
    parts = choose_part_fields(scene, surface, face_field, colours, rd)
    return scene, replace(parts, evidence=voxels.evidence | parts.evidence, warnings=voxels.warnings)


def _numbered(face_field, plans, first):
    """Field numbers of faces, int64 [F], those of TexelPlans from `first` on."""
    for number, one in enumerate(plans, first):
        face_field[one.group.faces] = number
    return face_field


def _fields(chosen, position_bits, source, units, rd, report):
    """SourceFields without colours over voxels, with them over texels. chosen: Supports, and PartFields.own."""
    chosen, own = chosen
    first = len(source.surfaces) - len(chosen.plans)
    fields: list[SourceField] = []
    for number, (lattice, faces) in enumerate(source.surfaces[:first]):
        with report.stage("voxelise", (number, first)):
            resolution, offset = own.get(number, (rd.resolution, chosen.qp_offset))
            part = active_voxels(lattice, faces, position_bits, replace(rd, resolution=resolution))
            fields.append(replace(part, qp_offset=offset))
        check_voxels(fields, rd.limits)  # here as well: the next may take minutes
    for number, texels in enumerate(chosen.plans, first):
        with report.stage("texels", (number - first, len(chosen.plans))):
            uv, faces = field_uv(units, number), source.surfaces[number][1]
            fields.append(texel_field(texels, uv, faces, source, rd.limits, rd.threads))
    check_voxels(fields, rd.limits)
    return fields


def _blended_squares(scene: Scene, surface: Surface, plans: list[TexelPlan], colours: np.ndarray) -> Iterable[str]:
    """Names of what is lost of NEAREST samplers: those of images that faces show in more than one colour and which do not go over
    texels."""
    kept = np.zeros(len(surface.faces), bool)
    for texels in plans:
        kept[texels.group.faces] = texels.group.nearest
    shown = {scene.materials[m].texture for m in np.unique(surface.material[~kept]) if np.isnan(colours[m]).any()}
    names = [scene.textures[t].name or str(t) for t in sorted(shown) if t >= 0 and scene.textures[t].nearest]
    return [f"NEAREST filter of texture '{name}'" for name in names]
