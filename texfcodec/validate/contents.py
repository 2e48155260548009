"""Steps 6 and 7 of clause 9.2 over a whole stream: geometry, sharp edges, fields and their values, each independently."""

from __future__ import annotations

import zlib
from dataclasses import replace
from functools import partial

from ..bitstream.appearance import groups_of, material_of, needed_groups
from ..bitstream.syntax import UNIT_ATTRIBUTE, UNIT_CODED_NORMALS, UNIT_FIELD, UNIT_GEOMETRY, UNIT_MATERIALS, UNIT_SHARP_EDGES
from ..codecs import codec_of_unit, joint_codec_of_unit
from ..codecs.base import PlaneCodec
from ..decoder import (
    check_samples,
    check_values,
    decode_coded_normals,
    decode_sharp_edges,
    decode_support,
    decode_unit,
    surface_of_field,
)
from ..errors import TexfError
from ..geometry.canonical import CanonicalCube
from ..options import DecodeOptions
from ..report import Report
from ..texf import Texf
from . import mesh_check, oddities
from .listing import Oddity
from .syntax_check import STAND_IN, Parsed


def decode_contents(parsed: Parsed, options: DecodeOptions, report: Report) -> None:
    """Decode everything of a stream that its faults leave decodable. Adds findings to parsed.listing and the numbers of the
    units checked to parsed.checked; report gets seconds by stage."""
    if parsed.stream.header:
        _Contents(parsed, options, report).decode()


class _Contents:
    """Decoding of one stream. units: geometry units, None for those that cannot be decoded."""

    def __init__(self, parsed, options, report):
        self.parsed, self.options, self.report = parsed, options, report
        self.stream, self.listing = parsed.stream, parsed.listing
        self.position_bits = self.stream.header["position_bits"]
        self.units = []

    def decode(self):
        """Decodes everything in the decoder's order."""
        with self.report.stage("geometry"):
            for index, values in enumerate(self.stream.geometry):
                self.units.append(self._decode_geometry(values, self.parsed.numbers[UNIT_GEOMETRY][index]))
        if self.units and None not in self.units and self.parsed.has_all(UNIT_GEOMETRY):
            if self.stream.sharp_edges is not None and not self.parsed.lost & {UNIT_SHARP_EDGES, UNIT_MATERIALS}:
                with self.report.stage("normals"):
                    self._decode_normals(self.parsed.numbers[UNIT_SHARP_EDGES][0])
            with self.report.stage("mesh"):
                for oddity in mesh_check.of_mesh(self.units, self.position_bits):
                    self.listing.oddity(oddity)
        surfaces = self._surfaces()
        attributes = self.stream.attributes
        if len(attributes) == 1 and UNIT_ATTRIBUTE not in self.parsed.lost and codec_of_unit(attributes[0]).joint:
            self._decode_jointly(surfaces)
            return
        for index in range(len(surfaces)):
            support = self._decode_support(index, surfaces)
            if support is not None:
                self._decode_planes(index, support)

    def _try(self, number, decode):
        """The result of decode(), or None after adding its error to the listing."""
        try:
            return decode()
        except TexfError as error:
            self.listing.error(error, number)
            return None

    def _note(self, noted, number):
        for oddity in noted:
            self.listing.oddity(oddity, number)

    def _decode_geometry(self, values, number):
        fields = self.stream.fields
        if values is None or values["field_index"] >= len(fields) or fields[values["field_index"]] is STAND_IN:
            return None
        unit = self._try(number, lambda: decode_unit(values, self.position_bits))
        if unit is not None:
            self.parsed.checked.add(number)
            self._note(mesh_check.of_draco(values, self.position_bits), number)
            self._note(mesh_check.of_faces(unit), number)
        return unit

    def _decode_normals(self, number):
        header, materials = self.stream.header, [material_of(values) for values in self.stream.materials]
        if not self.parsed.has_all(UNIT_MATERIALS) or any(unit.material >= len(materials) for unit in self.units):
            return
        cube = CanonicalCube(tuple(header["origin"]), header["side"], self.position_bits)
        texf = Texf(cube=cube, units=self.units, fields=[], materials=materials)
        self.parsed.checked.add(number)
        texf.sharp_edges = self._try(number, lambda: decode_sharp_edges(self.stream.sharp_edges, texf))
        wanted = self.stream.coded_normals is not None and UNIT_CODED_NORMALS not in self.parsed.lost
        if texf.sharp_edges is not None and wanted:
            number = self.parsed.numbers[UNIT_CODED_NORMALS][0]
            self.parsed.checked.add(number)
            self._try(number, lambda: decode_coded_normals(self.stream.coded_normals, texf))

    def _surfaces(self):
        """The surface of every field, None if a part of it is missing; [] if a unit is lost or there are too many samples."""
        parts, fields = self.stream.geometry, self.stream.fields
        if not (self.parsed.has_all(UNIT_FIELD) and self.parsed.has_all(UNIT_GEOMETRY)):
            return []
        short = {part["field_index"] for part, unit in zip(parts, self.units, strict=True) if unit is None}
        whole = [index for index in range(len(fields)) if index not in short]  # each has a unit: has_all() sees to it
        decoded = [unit for unit in self.units if unit is not None]
        surfaces = {index: surface_of_field(decoded, fields[index]) for index in whole}
        known = replace(self.stream, fields=[fields[index] for index in whole],
                        attributes=self._attributes() if len(whole) == len(fields) else [])
        try:
            check_samples(list(surfaces.values()), known, self.position_bits, self.options.limits)
        except TexfError as error:
            self.listing.error(error)
            return []
        return [surfaces.get(index) for index in range(len(fields))]

    def _attributes(self):
        return [values for values in self.stream.attributes if values is not None]

    def _decode_support(self, index, surfaces):
        """The support of a field, or None."""
        values, number = self.stream.fields[index], self.parsed.numbers[UNIT_FIELD][index]
        if surfaces[index] is None:
            return None
        with self.report.stage("fields"):
            support = self._try(number, lambda: decode_support(surfaces[index], values, self.position_bits, self.options))
        if support is not None:
            self.parsed.checked.add(number)
            self._note(oddities.of_field(values, len(support), self.position_bits), number)
        return support

    def _decode_planes(self, index, support):
        """Decodes the attribute units of a field, except misplaced ones, which are an error already."""
        materials = self.parsed.has_all(UNIT_MATERIALS)
        left = set(needed_groups(self.stream)[index] if materials else range(len(self.stream.header["channel_groups"])))
        for values, number in zip(self.stream.attributes, self.parsed.numbers[UNIT_ATTRIBUTE], strict=True):
            if values is None or values["field_index"] != index or values["group_index"] not in left:
                continue
            codec = codec_of_unit(values)
            if isinstance(codec, PlaneCodec):
                left.remove(values["group_index"])
                with self.report.stage("attributes"):
                    self.parsed.checked.add(number)
                    self._try(number, partial(self._decode_plane, codec, values, support.coarser(values["level_shift"]),
                                              number))

    def _decode_plane(self, codec, values, support, number):
        plane, reading = codec.dec_watched(values, support, self.options.threads)
        check_values(zlib.crc32(plane), values, codec)
        if reading.unread:
            self.listing.oddity(Oddity("TXF-W05", "bytes of codewords are never read", "7.6.2", values["offset"], reading.unread,
                                       0), number)
        if reading.wrong_levels:
            self.listing.oddity(Oddity("TXF-W06", "level_bytes differs from what a decoder reads", "5.7.2", values["offset"],
                                       reading.wrong_levels, 0), number)
        self._note(oddities.of_attribute(values, len(support), self.stream), number)

    def _decode_jointly(self, surfaces):
        """Decodes the single unit of all fields: its requirements on the geometry, then every support, then all values."""
        values, number = self.stream.attributes[0], self.parsed.numbers[UNIT_ATTRIBUTE][0]
        groups, codec = groups_of(self.stream.header["channel_groups"]), joint_codec_of_unit(values)
        evaluators = None
        if surfaces and None not in surfaces:
            self.parsed.checked.add(number)
            evaluators = self._try(number, lambda: codec.dec(values, [s.mesh for s in surfaces], self.position_bits, groups,
                                                             self.options, self.report))
        total, supports = 0, [self._decode_support(index, surfaces) for index in range(len(surfaces))]
        if evaluators is None or None in supports:
            return
        for evaluator, support in zip(evaluators, supports, strict=True):
            total = zlib.crc32(evaluator.values(support, self.options.threads), total)
        self._try(number, lambda: check_values(total, values, codec))
        self._note(oddities.of_attribute(values, len(supports[0]), self.stream), number)
