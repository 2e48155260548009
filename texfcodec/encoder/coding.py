"""The two ways of coding values: field by field and channel group by channel group, or all of them in one unit (encoder only)."""

from __future__ import annotations

import hashlib
import time
import zlib
from abc import ABC, abstractmethod
from contextlib import closing
from dataclasses import fields as fields_of
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..bitstream.stream import Stream, attribute_variables
from ..bitstream.values import attribute_values
from ..codecs import codec_of
from ..codecs.base import JointCodec, Source, split_groups
from ..core.threads import in_order
from ..geometry.areas import area_shares
from .decide.one_colour import one_colour
from .decide.spending import CodedUnit, image_budgets, spend
from .decision import Decision
from .map_planes import errors_of, joined, with_grey, with_maps
from .optimise.refinement import Refine, refine_fields
from .source_field import SourceField, filled, transferred

if TYPE_CHECKING:
    from ..report import Report
    from .plan import Plan
    from .rd import RateDistortion

Planes = list[dict[str, np.ndarray]]  # by field, what a decoder gets, by channel name
# Voxels and texels of all channel groups up to which these are coded side by side: beyond, memory adds up (a helmet's 15 million:
# 1.4 GB and not 1.0), and codecs keep the processors busy by themselves
MOST_TOGETHER = 1 << 22


class Content(NamedTuple):
    """What is coded: the Source, and its SourceFields by number."""

    source: Source
    fields: list[SourceField]


class Coding(ABC):
    """How values go into a stream, and what they need before."""

    @abstractmethod
    def content(self, content: Content, names: list[set[str]], colours: np.ndarray, rd: RateDistortion, wanted: Refine,
                report: Report) -> Decision[Content]:
        """The values of what is over voxels, brought from the source. names: by field over voxels, the channels that it has maps
        of; colours: of material_colours; wanted: refinement."""

    @abstractmethod
    def units(self, plan: Plan, stream: Stream, report: Report) -> Decision[Planes]:
        """Adds the attribute units of a Plan to a stream whose other units are there."""


class PlaneCoding(Coding):
    """For codecs of planes: one attribute unit for each channel group of each field."""

    def content(self, content: Content, names: list[set[str]], colours: np.ndarray, rd: RateDistortion, wanted: Refine,
                report: Report) -> Decision[Content]:
        """See Coding.content: transfer from the textures, and refinement."""
        source, fields = content
        for number, own in enumerate(names):
            with report.stage("transfer", (number, len(names))):
                fields = _replaced(fields, number, _values(fields[number], source, number, own, colours, rd))
        warning = "anisotropy directions need UVs, which voxels do not have; only the strength is kept"
        directed = any("anisotropy" in own or _is_anisotropic(source, number) for number, own in enumerate(names))
        warnings = (warning,) if directed else ()
        with report.stage("refine") as step:
            refinement = refine_fields(source, fields[: len(names)], rd, wanted, step)
        fields = [*refinement.value, *fields[len(names) :]]
        source = source._replace(groups=with_grey(source.groups, fields))
        return Decision(Content(source, fields), {"refinement": refinement.evidence}, warnings)

    def units(self, plan: Plan, stream: Stream, report: Report) -> Decision[Planes]:
        """See Coding.units."""
        planes: Planes = [{} for _ in plan.fields]
        evidence: list[dict] = []
        budgets, surface, groups = image_budgets(plan.source, plan.fields), plan.source.surface, plan.source.groups
        shares = np.bincount(plan.source.face_field, area_shares(surface.lattice, surface.faces), len(plan.fields))
        places = [(i, number) for i, part in enumerate(plan.fields) for number, group in enumerate(groups)
                  if any(channel.name in part.planes for channel in group.channels)]

        def code(place):
            begin = time.perf_counter()
            return _unit(plan, stream, place, shares[place[0]], budgets.get(place)), time.perf_counter() - begin

        together = sum(len(plan.fields[i].keys) for i, _ in places) <= MOST_TOGETHER
        with closing(in_order(code, places, plan.request.threads if together else 1)) as made:
            for n, (i, number) in enumerate(places):
                with report.stage("attributes", (n, len(places))):
                    spent, seconds = next(made)
                unit, group = spent.value, groups[number]
                stream.attributes.append(unit.values)
                planes[i] |= group.split(unit.decoded)
                row = {"field": i, "codec": unit.codec.name, "level_shift": unit.values["level_shift"],
                       "qp_offset": plan.fields[i].qp_offset, "encode_ms": round(1000 * seconds, 1)}
                evidence.append(row | spent.evidence | errors_of(group, unit.plane, unit.decoded))
        for part in plan.fields:
            part.support.forget()
        return Decision(planes, {"channels": evidence})


class JointCoding(Coding):
    """For codecs that code all fields and channel groups in one unit, and ask the source themselves."""

    def content(self, content: Content, names: list[set[str]], colours: np.ndarray, rd: RateDistortion, wanted: Refine,
                report: Report) -> Decision[Content]:
        """See Coding.content."""
        return Decision(content, {})

    def units(self, plan: Plan, stream: Stream, report: Report) -> Decision[Planes]:
        """See Coding.units."""
        request, codec, planes, total = plan.request, codec_of(plan.request.codec), [], 0
        assert isinstance(codec, JointCodec)
        if not plan.fields:
            return Decision([], {"refinement": {"asked": request.refine, "kind": "off", "reason": "there is no field"}})
        coded = codec.enc(plan.source, codec.settings(request), report)
        for part, evaluator in zip(plan.fields, coded.evaluators, strict=True):
            values = evaluator.values(part.support, request.threads)
            total = zlib.crc32(values, total)
            planes.append(split_groups(values, plan.source.groups))
        stream.attributes.append(attribute_values(codec, 0, 0, total, coded.values))
        return Decision(planes, coded.choices)


def coding_of(rd: RateDistortion) -> Coding:
    """The Coding that a codec needs: PlaneCoding where rd has a coder."""
    return JointCoding() if rd.coder is None else PlaneCoding()


def _is_anisotropic(source, number):
    """Returns whether a material of a field has an anisotropy factor, with or without a map."""
    used = np.unique(source.surface.material[source.face_field == number])
    return any(source.scene.materials[m].parameters.get("anisotropy", (0.0,))[0] > 0 for m in used)


def _replaced(fields, number, part):
    return [*fields[:number], part, *fields[number + 1 :]]


def _values(part, source, number, names, colours, rd):
    """A field over voxels with the source's values."""
    colour = one_colour(colours, source.surface.material[source.face_field == number])
    if colour is None:
        made = rd.of_field(f"transfer {number}", source, part, lambda: transferred(part, source, number, rd))
        made = replace(made, qp_offset=part.qp_offset)
    else:
        made = filled(part, source, colour)
    return with_maps(made, source, number, names, rd.threads)


def _digest(plane, support):
    """Stands for values on a support: hashable."""
    at = [getattr(support, field.name) for field in fields_of(support) if field.name != "keys"]
    return (type(support), *at, *(hashlib.sha256(np.ascontiguousarray(one).data).digest() for one in (support.keys, plane)))


def _unit(plan: Plan, stream: Stream, place: tuple[int, int], share: float, budget: float | None) -> Decision[CodedUnit]:
    """The CodedUnit of a channel group of a field. place: (field, group); share: of the surface; budget: as of spend()."""
    part, group = plan.fields[place[0]], plan.source.groups[place[1]]
    plane, shift = joined(part, group)
    support = part.support.coarser(shift)
    coder = plan.rd.planes.shifted(part.qp_offset).for_plane(plane)
    known, content = plan.rd.memo.of_parts(), _digest(plane, support)

    def code(coder):
        values, decoded = known.get(("coded", coder.signature, *content), lambda: coder.code(plane, support))
        values = attribute_values(coder.codec, *place, zlib.crc32(decoded), values, shift)
        size = len(coder.codec.write_parameters(values | attribute_variables(stream, values)))
        return CodedUnit(codec=coder.codec, values=values, bytes=size, plane=plane, decoded=decoded)

    if part.exact:
        return Decision(code(coder.exactly()), {})
    weights, channel = plan.source.scene.weights, group.channels[0]
    coder, weight = coder.for_group(group, weights), weights.get(channel.name, channel.weight)
    return spend(code(coder), code, coder, plan.rd.cost(0, weight, share), budget)
