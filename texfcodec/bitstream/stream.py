"""Writes and reads the values of all units over the syntax tables (spec clause 5)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ..codecs import codec_of_unit
from ..core.syntax_table import Structure
from ..core.syntax_walk import Reader, read_structure, write_structure
from ..errors import LimitError, StreamError
from ..field.extents import octree_depth
from ..scene.normal_rule import CODED, rule_of
from .appearance import check_groups, check_level_shift, check_material, faults_of_appearance, needed_groups
from .stream_values import Stream
from .syntax import (
    ATTRIBUTE,
    GEOMETRY,
    METADATA_JSON,
    SIGNATURE,
    SUPPORT_TEXELS,
    UNIT_ATTRIBUTE,
    UNIT_CODED_NORMALS,
    UNIT_END,
    UNIT_FIELD,
    UNIT_GEOMETRY,
    UNIT_HEADER,
    UNIT_MATERIALS,
    UNIT_METADATA,
    UNIT_SHARP_EDGES,
    UNITS,
)
from .units import read_units, write_unit

if TYPE_CHECKING:
    from ..limits import Limits
    from ..scene.normal_rule import NormalRule
    from .units import Unit


_GEOMETRY_COUNTS, _GEOMETRY_REST = (Structure(GEOMETRY.name, GEOMETRY.clause, part)
                                    for part in (GEOMETRY.elements[:4], GEOMETRY.elements[4:]))  # the field decides the rest


def write_stream(stream: Stream) -> tuple[bytes, dict[str, int]]:
    """Write a whole stream from its syntax values: (bytes, byte counts {"geometry", "attributes", "other"})."""
    sizes = {"geometry": 0, "attributes": 0, "other": len(SIGNATURE)}
    out = bytearray(SIGNATURE)

    def put(unit_type, payload, kind="other"):
        unit = write_unit(unit_type, payload)
        sizes[kind] += len(unit)
        out.extend(unit)

    put(UNIT_HEADER, write_structure(UNITS[UNIT_HEADER], stream.header))
    put(UNIT_MATERIALS, write_structure(UNITS[UNIT_MATERIALS], {**stream.header, "materials": stream.materials}))
    for values in stream.fields:
        put(UNIT_FIELD, write_structure(UNITS[UNIT_FIELD], values))
    supports = {"supports": [f["support"] for f in stream.fields]}
    for values in stream.geometry:
        put(UNIT_GEOMETRY, write_structure(UNITS[UNIT_GEOMETRY], {**values, **supports}), "geometry")
    for values in stream.attributes:
        values = {**values, **attribute_variables(stream, values)}
        payload = write_structure(ATTRIBUTE, values) + codec_of_unit(values).write_parameters(values)
        put(UNIT_ATTRIBUTE, payload, "attributes")
    for unit_type, values in ((UNIT_SHARP_EDGES, stream.sharp_edges), (UNIT_CODED_NORMALS, stream.coded_normals)):
        if values is not None:
            put(unit_type, write_structure(UNITS[unit_type], values), "geometry")
    if stream.metadata is not None:
        values = {"metadata_format": METADATA_JSON, "metadata_json": stream.metadata}
        put(UNIT_METADATA, write_structure(UNITS[UNIT_METADATA], values))
    put(UNIT_END, b"")
    return bytes(out), sizes


def cells_a_side(field: dict) -> int:
    """Return the number of cells (voxels or texels) along the longest side of a field's grid or image. field: syntax values of a
    field unit."""
    return max(field["width"], field["height"]) if field["support"] == SUPPORT_TEXELS else field["resolution"]


def attribute_variables(stream: Stream, values: dict) -> dict:
    """Return the variables that the syntax of an attribute unit takes from other units, by name, such as the resolution of its
    field and the components of its group. stream: the units before; values: the unit's elements read so far. Raises
    StreamError."""
    if values["field_index"] >= len(stream.fields):
        raise StreamError("TXF-S09", "an attribute unit refers to a field that does not exist", clause="5.7",
                          value=values["field_index"], allowed=f"< {len(stream.fields)}")
    groups = stream.header["channel_groups"]
    if values["group_index"] >= len(groups):
        raise StreamError("TXF-S09", "an attribute unit refers to a channel group that does not exist", clause="5.7",
                          value=values["group_index"], allowed=f"< {len(groups)}")
    field = stream.fields[values["field_index"]]
    return {
        "resolution": -(-cells_a_side(field) >> values["level_shift"]), "Planar": field["support"],
        "NumComponents": groups[values["group_index"]]["group_components"],
        "NumOutputs": sum(g["group_components"] for g in groups), "num_fields": stream.header["num_fields"],
    }


def _read_attribute(reader, stream, trace):
    values = read_structure(ATTRIBUTE, reader, {}, trace)
    values.update(attribute_variables(stream, values))
    codec = codec_of_unit(values)
    values["offset"] = reader.base + reader.position
    check_level_shift(values, stream.header["channel_groups"], _most_levels(codec, stream.fields[values["field_index"]]))
    codec.read_parameters(reader, values, trace)
    codec.check(values)
    return values


def _most_levels(codec, field):
    """Largest level_shift of a unit: the number of levels of its field, 0 if the unit holds all fields."""
    return 0 if codec.joint else octree_depth(cells_a_side(field))


def _read_geometry(reader, fields, trace):
    """Syntax values of a geometry unit. If its field does not exist, they end with unit_faces, because nothing says what follows;
    faults_over_units() reports it."""
    values = read_structure(_GEOMETRY_COUNTS, reader, {"supports": [f["support"] for f in fields]}, trace)
    if values["field_index"] < len(fields):
        return read_structure(_GEOMETRY_REST, reader, values, trace)
    reader.position = reader.end
    return values | {"Support": None, "uv_bits": None, "draco_data": b""}


def read_stream(data: bytes, limits: Limits, trace: list | None = None) -> Stream:
    """Parses a whole stream and checks every rule that needs no decoding. data: bytes of a .texf file.

    trace: list that receives for each unit (unit, [(element name, offset, size, value), ...]). Returns Stream. Raises
    StreamError, LimitError, SupportError.
    """
    units, skipped = read_units(data, limits.file_bytes)
    stream = Stream({})
    stream.skipped = [{"type": u.type, "offset": u.start, "bytes": u.stop - u.start} for u in skipped]
    view = memoryview(data)
    for unit in units:
        rows: list | None = None
        if trace is not None:
            rows = []
            trace.append((unit, rows))
        read_payload(view, unit, stream, limits, rows)
    for fault in faults_over_units(stream, sum(u.type == UNIT_MATERIALS for u in units)):
        raise fault
    return stream


def read_payload(view: memoryview, unit: Unit, stream: Stream, limits: Limits, rows: list | None = None) -> None:
    """Parse the payload of one unit and add its values to stream, which holds those of the units before it, in place. view: the
    whole file; rows: as trace of core.syntax_walk.read_structure(). Raises StreamError, LimitError, SupportError."""
    reader = Reader(view, unit.begin, unit.end)
    _read_elements(unit, reader, stream, limits, rows)
    if reader.position != reader.end:
        raise StreamError("TXF-S08", f"the {unit.name} unit has unused bytes at its end", clause="5.2", offset=reader.position,
                          value=reader.end - reader.position, allowed=0)


def _read_elements(unit, reader, stream, limits, rows):
    if unit.type == UNIT_HEADER:
        stream.header = read_structure(UNITS[UNIT_HEADER], reader, {}, rows)
        check_groups(stream.header["channel_groups"])
    elif unit.type == UNIT_MATERIALS:
        stream.materials += read_structure(UNITS[UNIT_MATERIALS], reader, dict(stream.header), rows)["materials"]
        for material in stream.materials:
            check_material(material)
    elif unit.type == UNIT_FIELD:
        stream.fields.append(read_structure(UNITS[UNIT_FIELD], reader, {}, rows))
        if limits.voxels is not None and sum(f["num_keys"] for f in stream.fields) > limits.voxels:
            raise LimitError("TXF-L04", "the stream has more values than the limit allows", clause="5.5",
                             value=sum(f["num_keys"] for f in stream.fields), allowed=limits.voxels)
        _check_image(stream.fields[-1], limits)
    elif unit.type == UNIT_GEOMETRY:
        values = _read_geometry(reader, stream.fields, rows)
        values["offset"] = unit.end - len(values["draco_data"])
        _check_uv_range(values)
        stream.geometry.append(values)
        stream.vertices += values["unit_vertices"]
        stream.faces += values["unit_faces"]
        _check_size(stream, limits)
    elif unit.type == UNIT_ATTRIBUTE:
        stream.attributes.append(_read_attribute(reader, stream, rows))
    elif unit.type == UNIT_METADATA:
        if limits.metadata_bytes is not None and unit.end - unit.begin > limits.metadata_bytes:
            raise LimitError("TXF-L06", "the metadata unit is larger than the limit", clause="5.8",
                             value=unit.end - unit.begin, allowed=limits.metadata_bytes)
        stream.metadata = bytes(read_structure(UNITS[UNIT_METADATA], reader, {}, rows)["metadata_json"])
    elif unit.type == UNIT_SHARP_EDGES:
        stream.sharp_edges = read_structure(UNITS[UNIT_SHARP_EDGES], reader, {}, rows)
        stream.sharp_edges["offset"] = unit.begin
    elif unit.type == UNIT_CODED_NORMALS:
        stream.coded_normals = read_structure(UNITS[UNIT_CODED_NORMALS], reader, {}, rows)
        stream.coded_normals["offset"] = unit.begin


def normal_rules(materials: list[dict]) -> list[NormalRule]:
    """Return the rules of shading normals of those materials that state one, in their order. materials: syntax values."""
    return [rule_of(m["normal_rule"], m["normal_angle"]) for m in materials if m["normal_rule"] is not None]


def _check_image(field, limits):
    """Checks the size of an image, because a table of the whole image is allocated before its texels are counted."""
    if field["support"] != SUPPORT_TEXELS:
        return
    texels = field["width"] * field["height"]
    if limits.texels is not None and texels > limits.texels:
        raise LimitError("TXF-L11", "an image has more texels than the limit allows", clause="5.5", value=texels,
                         allowed=limits.texels)
    if field["num_keys"] > texels:
        raise StreamError("TXF-S04", "num_keys is out of range", clause="5.5", value=field["num_keys"], allowed=f"1..{texels}")


def _check_uv_range(unit):
    """Checks that quantised UVs have at most as many steps as their range, so that every UV is exact."""
    if unit["uv_bits"] and unit["uv_range"] >= 1 << unit["uv_bits"]:
        raise StreamError("TXF-S04", "uv_range is out of range", clause="5.6", offset=unit["offset"], value=unit["uv_range"],
                          allowed=f"1..{(1 << unit['uv_bits']) - 1}")


def _check_size(stream, limits):
    for code, name, count, limit in (("TXF-L02", "vertices", stream.vertices, limits.vertices),
                                     ("TXF-L03", "faces", stream.faces, limits.faces)):
        if limit is not None and count > limit:
            raise LimitError(code, f"the stream has more {name} than the limit allows", clause="5.6", value=count, allowed=limit)


class _Number(NamedTuple):
    """A number that occurs at two places of a stream. what: its name; needs: types of the units that contain it; owner: the unit
    type that it counts, whose further rules are skipped if the numbers differ; pair: function of (Stream, number of materials
    units) that returns the actual and the expected value."""

    what: str
    clause: str
    needs: frozenset[int]
    owner: int | None
    pair: Callable[[Stream, int], tuple]


_HEADER_AND = lambda *types: frozenset((UNIT_HEADER, *types))
_NUMBERS = (
    _Number("the number of materials units", "5.2", _HEADER_AND(UNIT_MATERIALS), UNIT_MATERIALS, lambda s, n: (n, 1)),
    _Number("the number of materials", "5.4", _HEADER_AND(UNIT_MATERIALS), UNIT_MATERIALS,
            lambda s, n: (len(s.materials), s.header["num_materials"])),
    _Number("the number of fields", "5.5", _HEADER_AND(), UNIT_FIELD, lambda s, n: (len(s.fields), s.header["num_fields"])),
    _Number("the number of geometry units", "5.6", _HEADER_AND(), UNIT_GEOMETRY,
            lambda s, n: (len(s.geometry), s.header["num_geometry_units"])),
    _Number("the order of field indices", "5.5", frozenset((UNIT_FIELD,)), UNIT_FIELD,
            lambda s, n: ([f["field_index"] for f in s.fields], list(range(len(s.fields))))),
    _Number("the number of sharp_edges units", "5.10", frozenset((UNIT_MATERIALS, UNIT_SHARP_EDGES)), UNIT_SHARP_EDGES,
            lambda s, n: (s.sharp_edges is not None, any(rule.has_marks for rule in normal_rules(s.materials)))),
    _Number("the number of coded_normals units", "5.11", frozenset((UNIT_MATERIALS, UNIT_CODED_NORMALS)), UNIT_CODED_NORMALS,
            lambda s, n: (s.coded_normals is not None, any(rule.kind == CODED for rule in normal_rules(s.materials)))),
)


def _other_number(what, value, allowed, clause):
    return StreamError("TXF-S11", f"{what} differs from the sequence header", clause=clause, value=value, allowed=allowed)


def faults_over_units(stream: Stream, materials_units: int = 1, broken: set[int] | None = None) -> Iterator[StreamError]:
    """Yields an error for each broken rule about counts and cross references in the whole stream (spec 9.2, step 5), in order.

    materials_units: number of materials units. broken: set of types of faulty units, for callers that continue after an error.
    Rules that need these units are skipped, and the types of units with new faults are added.
    """
    broken = set() if broken is None else broken
    for number in _NUMBERS:
        if not broken & number.needs:
            value, allowed = number.pair(stream, materials_units)
            if value != allowed:
                yield _other_number(number.what, value, allowed, number.clause)
                broken |= set() if number.owner is None else {number.owner}
    if broken & _HEADER_AND(UNIT_MATERIALS, UNIT_FIELD, UNIT_GEOMETRY):
        return
    wrong = [error for unit in stream.geometry for error in _faults_of_names(unit, stream)]
    yield from wrong
    if not wrong and set(range(len(stream.fields))) - {unit["field_index"] for unit in stream.geometry}:
        wrong = [StreamError("TXF-S11", "a field has no geometry", clause="5.5")]
        yield wrong[0]
    if wrong:
        broken.add(UNIT_GEOMETRY)
        return
    if UNIT_ATTRIBUTE not in broken:
        pairs = [(a["field_index"], a["group_index"]) for a in stream.attributes]
        expected = [(f, g) for f, groups in enumerate(needed_groups(stream)) for g in groups]
        expected = [(0, 0)] if stream.joint else expected
        if pairs != expected:
            yield _other_number("the order of attribute units", pairs, expected, "5.7")
        if stream.joint and any(field["support"] == SUPPORT_TEXELS for field in stream.fields):
            yield StreamError("TXF-S13", "one attribute unit codes all fields, but a field is over texels", clause="5.7",
                              offset=stream.joint["offset"], value=stream.joint["codec_id"])
            broken.add(UNIT_ATTRIBUTE)
    yield from faults_of_appearance(stream)


def _faults_of_names(unit, stream):
    for name, count in (("field_index", len(stream.fields)), ("material_index", len(stream.materials))):
        if unit[name] >= count:
            yield StreamError("TXF-S09", f"the {name} of a geometry unit does not exist", clause="5.6", offset=unit["offset"],
                              value=unit[name], allowed=f"< {count}")
