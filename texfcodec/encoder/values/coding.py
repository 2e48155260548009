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

from ...bitstream.stream import Stream, attribute_variables
from ...bitstream.values import attribute_values
from ...codecs.base import JointCodec, Source, split_groups
from ...core.threads import in_order
from ...geometry.areas import area_shares
from ..decision import Decision
from ..prepare.uniform_colour import uniform_colour
from .map_planes import errors_of, joined, with_grey, with_maps
from .refinement import refine_fields
from .source_field import SourceField, field_keys, transferred, uniform_field
from .unit_qp import CodedUnit, choose_qp, estimated_bytes, image_budgets

if TYPE_CHECKING:
    from ...report import Report
    from ..caches import Cache
    from ..price import Lagrangian
    from ..stages import Filled, Placed
    from .stage import FillRequest

Planes = list[dict[str, np.ndarray]]  # by field, what a decoder gets, by channel name
# Voxels and texels of all channel groups up to which these are coded side by side: beyond, memory adds up (a helmet's 15 million:
# 1.4 GB and not 1.0), and codecs keep the processors busy by themselves
MOST_TOGETHER = 1 << 22


class Content(NamedTuple):
    """The values to code: the Source, and its SourceFields by number."""

    source: Source
    fields: list[SourceField]


class Coding(ABC):
    """A way of coding values into a stream, with its preparations."""

    @abstractmethod
    def content(self, placed: Placed, wanted: FillRequest, cache: Cache, report: Report) -> Decision[Content]:
        """Return the Decision on the Content of a placed mesh: its fields, filled with values of the source. wanted: gives the
        refinement of these values; cache: of transferred and fitted fields."""

    @abstractmethod
    def units(self, filled: Filled, stream: Stream, cache: Cache, report: Report) -> Decision[Planes]:
        """Code the values of a Filled and add their attribute units to a stream that already holds all other units; return the
        decoded planes. cache: of coded units."""


class PlaneCoding(Coding):
    """For codecs of planes: one attribute unit for each channel group of each field."""

    def content(self, placed: Placed, wanted: FillRequest, cache: Cache, report: Report) -> Decision[Content]:
        """Return the Decision on the Content, with values transferred from the textures to each field's voxels, and refined."""
        source, names, price = placed.source, placed.names, placed.shaded.meshed.price
        fields = list(placed.fields)
        for number, key in enumerate(field_keys("transfer", source, fields[: len(names)], price.resolution)):
            with report.stage("transfer", (number, len(names))):
                fields[number] = _values(placed, number, key, cache)
        warning = "anisotropy directions need UVs, which voxels do not have; only the strength is kept"
        factors = [m.parameters.get("anisotropy", (0.0,))[0] for number in range(len(names)) for m in source.materials_of(number)]
        directed = any("anisotropy" in own for own in names) or max(factors, default=0.0) > 0
        warnings = (warning,) if directed else ()
        with report.stage("refine") as step:
            refinement = refine_fields(source, fields[: len(names)], price, wanted, cache, step)
        fields = [*refinement.value, *fields[len(names) :]]
        source = source._replace(groups=with_grey(source.groups, fields))
        return Decision(Content(source, fields), {"refinement": refinement.evidence}, warnings)

    def units(self, filled: Filled, stream: Stream, cache: Cache, report: Report) -> Decision[Planes]:
        """Code each channel group of each field as a unit of its own, at a QP that suits it; return the decoded planes by
        field."""
        planes: Planes = [{} for _ in filled.fields]
        evidence: list[dict] = []
        budgets, surface, groups = image_budgets(filled.source, filled.fields), filled.source.surface, filled.source.groups
        shares = np.bincount(filled.source.face_field, area_shares(surface.lattice, surface.faces), len(filled.fields))
        places = [(i, number) for i, part in enumerate(filled.fields) for number, group in enumerate(groups)
                  if any(channel.name in part.planes for channel in group.channels)]

        def code(place):
            begin = time.perf_counter()
            return _unit(filled, stream, place, (shares[place[0]], budgets.get(place)), cache), time.perf_counter() - begin

        together = sum(len(filled.fields[i].keys) for i, _ in places) <= MOST_TOGETHER
        with closing(in_order(code, places, filled.price.threads if together else 1)) as coded_units:
            for n, (i, number) in enumerate(places):
                with report.stage("attributes", (n, len(places))):
                    spent, seconds = next(coded_units)
                unit, group = spent.value, groups[number]
                stream.attributes.append(unit.values)
                planes[i] |= group.split(unit.decoded)
                row = {"field": i, "codec": unit.codec.name, "level_shift": unit.values["level_shift"],
                       "qp_offset": filled.fields[i].qp_offset, "encode_ms": round(1000 * seconds, 1)}
                evidence.append(row | spent.evidence | errors_of(group, unit.plane, unit.decoded))
        for part in filled.fields:
            part.support.forget()
        return Decision(planes, {"channels": evidence})


class JointCoding(Coding):
    """For codecs that code all fields and channel groups in one unit, and sample the source themselves."""

    def content(self, placed: Placed, wanted: FillRequest, cache: Cache, report: Report) -> Decision[Content]:
        """Return the Decision on the Content as it was placed, without values: the codec samples the source itself."""
        return Decision(Content(placed.source, placed.fields), {})

    def units(self, filled: Filled, stream: Stream, cache: Cache, report: Report) -> Decision[Planes]:
        """Code all fields as a single attribute unit, add it to the stream, and return the decoded planes by field."""
        request, codec, planes, total = filled.request, filled.request.codec, [], 0
        assert isinstance(codec, JointCodec)
        if not filled.fields:
            return Decision([], {"refinement": {"asked": request.refine, "kind": "off", "reason": "there is no field"}})
        coded = codec.enc(filled.source, request.settings, report)
        for part, evaluator in zip(filled.fields, coded.evaluators, strict=True):
            values = evaluator.values(part.support, filled.price.threads)
            total = zlib.crc32(values, total)
            planes.append(split_groups(values, filled.source.groups))
        stream.attributes.append(attribute_values(codec, 0, 0, total, coded.values))
        return Decision(planes, coded.choices)


def coding_of(price: Lagrangian) -> Coding:
    """Return the Coding that the codec needs: PlaneCoding if the price has a coder, else JointCoding."""
    return JointCoding() if price.coder is None else PlaneCoding()


def _values(placed, number, key, cache):
    """Return a field over voxels with the source's values."""
    part, source, meshed = placed.fields[number], placed.source, placed.shaded.meshed
    price = meshed.price
    colour = uniform_colour(meshed.prepared.colours, source.surface.material[source.face_field == number])
    if colour is None:
        filled_part = cache.get(key, lambda: transferred(part, source, number, price))
        filled_part = replace(filled_part, qp_offset=part.qp_offset)
    else:
        filled_part = uniform_field(part, source, colour)
    return with_maps(filled_part, source, number, placed.names[number], price.threads)


def _digest(plane, support):
    """Return a hashable key of values on a support."""
    at = [getattr(support, field.name) for field in fields_of(support) if field.name != "keys"]
    return (type(support), *at, *(hashlib.sha256(np.ascontiguousarray(array).data).digest() for array in (support.keys, plane)))


class _UnitKey(NamedTuple):
    """Everything that a coded unit depends on. content: digests of support and values."""

    coder: tuple
    content: tuple


def _unit(filled: Filled, stream: Stream, place: tuple[int, int], bounds: tuple[float, float | None],
          cache: Cache) -> Decision[CodedUnit]:
    """Return the CodedUnit of a channel group of a field. place: (field, group); bounds: share of the surface, and budget as of
    choose_qp()."""
    part, group = filled.fields[place[0]], filled.source.groups[place[1]]
    plane, shift = joined(part, group)
    support = part.support.coarser(shift)
    coder = filled.price.planes.shifted(part.qp_offset).for_plane(plane)
    (share, budget), content = bounds, _digest(plane, support)

    def code(coder):
        values, decoded = cache.get(_UnitKey(coder.signature, content), lambda: coder.code(plane, support))
        values = attribute_values(coder.codec, *place, zlib.crc32(decoded), values, shift)
        size = len(coder.codec.write_parameters(values | attribute_variables(stream, values)))
        return CodedUnit(codec=coder.codec, values=values, bytes=size, plane=plane, decoded=decoded)

    def exact_bytes():
        key = _UnitKey(("estimated bytes", *coder.exactly().signature), content)
        return cache.get(key, lambda: estimated_bytes(plane, support, coder))

    if part.exact:
        return Decision(code(coder.exactly()), {})
    weights, channel = filled.source.scene.weights, group.channels[0]
    coder, weight = coder.for_group(group, weights), weights.get(channel.name, channel.weight)
    return choose_qp(code(coder), code, coder, filled.price.cost(0, weight, share), budget, exact_bytes)
