"""Decodes a stream to a Texf. encoder/write.py is the mirror image."""

import json
import time
import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .bitstream.appearance import groups_of, material_of
from .bitstream.stream import Stream, read_stream
from .bitstream.syntax import SUPPORT_TEXELS
from .codecs import joint_codec_of_unit, plane_codec_of_unit
from .codecs.base import Codec, Group, split_groups
from .errors import LimitError, StreamError
from .field.keyed import keys_crc
from .field.texel_set import count_rows, referenced_texels
from .field.texels import TexelSupport
from .field.voxelise import count_samples, voxelise
from .field.voxels import VoxelSupport
from .geometry.canonical import CanonicalCube
from .geometry.checksum import geometry_crc
from .geometry.corner_groups import CornerGroups
from .geometry.draco import UvCoding, dec_geometry, dec_textured
from .geometry.edges import coded_edges
from .geometry.geometry_unit import GeometryUnit, LatticeMesh, field_surface, field_uv
from .limits import Limits
from .options import DecodeOptions
from .report import Report
from .texf import Field, Texf

Known = Callable[[dict, Group], np.ndarray | None]  # (syntax elements of an attribute unit, its group) -> its values, or None


class DecodedSurface(NamedTuple):
    """Decoded surface of one field. mesh: its LatticeMesh; uv: int64 [V, 2], parallel to the lattice, None if the field is over
    voxels."""

    mesh: LatticeMesh
    uv: np.ndarray | None


def decode_stream(data: bytes, options: DecodeOptions, report: Report, known: Known | None = None) -> Texf:
    """Decodes a .texf stream in this process (spec clauses 5 to 8).

    Parameters
    ----------
    data : bytes
        The stream.
    options : DecodeOptions
        Threads, limits and the level of detail.
    report : Report
        Receives seconds by stage and warnings.
    known : callable, optional
        (syntax values of an attribute unit, its Group) -> uint8 [N, C] or None. The encoder passes the values that it has, so
        that its own stream decodes faster. Their checksum is still compared.

    Returns
    -------
    Texf
        The mesh, its fields and materials.

    Raises
    ------
    StreamError, LimitError, SupportError
        Nothing else, on any input.
    """
    with report.stage("parse"):
        stream = read_stream(bytes(data), options.limits)
    texf = appearance_of(stream, options, report)
    cube, units = texf.cube, texf.units
    for number, values in enumerate(stream.geometry):
        with report.stage("geometry", (number, len(stream.geometry))):
            units.append(decode_unit(values, cube.position_bits))
    if stream.sharp_edges:
        with report.stage("normals"):
            texf.sharp_edges = decode_sharp_edges(stream.sharp_edges, texf)
            if stream.coded_normals:
                texf.coded_normals = decode_coded_normals(stream.coded_normals, texf)
    surfaces = [surface_of_field(units, f) for f in stream.fields]
    check_samples(surfaces, stream, cube.position_bits, options.limits)
    if stream.joint:
        _decode_jointly(texf, stream, surfaces, options, report)
    else:
        _decode_planes(texf, stream, surfaces, options, report, known or (lambda values, group: None))
    return texf


def appearance_of(stream: Stream, options: DecodeOptions, report: Report) -> Texf:
    """Build a Texf from what a stream holds without further decoding. It has no units, fields, marks and normals yet.

    Parameters
    ----------
    stream : Stream
        As read_stream() returns it.
    options : DecodeOptions
        Gives the threads.
    report : Report
        Receives warnings about skipped units.

    Returns
    -------
    Texf
        Canonical cube, materials, channel groups and metadata.
    """
    for unit in stream.skipped:
        report.warnings.append(f"an unknown ancillary unit of type {unit['type']} at byte {unit['offset']} is skipped")
    header = stream.header
    return Texf(cube=CanonicalCube(tuple(header["origin"]), header["side"], header["position_bits"]), units=[], fields=[],
                materials=[material_of(m) for m in stream.materials], metadata=_metadata(stream.metadata, report),
                groups=groups_of(header["channel_groups"]), threads=options.threads, skipped=stream.skipped)


def decode_unit(values: dict, position_bits: int) -> GeometryUnit:
    """Decodes one geometry unit.

    Parameters
    ----------
    values : dict
        Syntax values of the unit (spec 5.6).
    position_bits : int
        Bits of a lattice coordinate.

    Returns
    -------
    GeometryUnit
        Lattice, faces and, over texels, UVs.

    Raises
    ------
    StreamError
        The substream does not decode, or TXF-S24: its checksum differs.
    """
    decoded = _decode_draco(values, position_bits)
    if geometry_crc(*decoded) != values["geometry_crc"]:
        raise StreamError("TXF-S24", "the checksum of the decoded faces does not match", clause="5.6.3",
                          offset=values["offset"])
    return GeometryUnit(values["field_index"], values["material_index"], *decoded)


def _decode_draco(values, position_bits):
    """(lattice, faces) of a geometry unit, and UVs if its field is over texels."""
    if values["Support"] == SUPPORT_TEXELS:
        coding = UvCoding(values["uv_bits"], values["uv_range"] or 1)
        lattice, faces, uv = dec_textured(values["draco_data"], values["unit_vertices"], values["unit_faces"], coding,
                                          position_bits, values["offset"])
        return lattice, faces, uv + values["uv_origin"]
    return dec_geometry(values["draco_data"], values["unit_vertices"], values["unit_faces"], position_bits, values["offset"])


def decode_sharp_edges(values: dict, texf: Texf) -> np.ndarray:
    """Decodes the marks of sharp edges (spec 8.4.2).

    Parameters
    ----------
    values : dict
        Syntax values of the sharp_edges unit.
    texf : Texf
        With its geometry units and materials.

    Returns
    -------
    bool [E]
        One mark for each edge of a face whose material has marks.

    Raises
    ------
    StreamError
        TXF-S30: the number of edges differs; TXF-S32: the checksum differs.
    """
    from .codecs.sharp_edges import dec_marks

    marked = np.array([m.normals.has_marks for m in texf.materials], bool)
    ends, fold = coded_edges(texf.lattice_positions, texf.faces, marked[texf.face_material])
    if len(ends) != values["num_edges"]:
        raise StreamError("TXF-S30", "the edges rebuilt from the geometry differ from the coded edges", clause="8.4.2",
                          offset=values["offset"], value=len(ends), allowed=values["num_edges"])
    marks = dec_marks(values["marks_data"], ends, fold)
    if zlib.crc32(marks.tobytes()) != values["marks_crc"]:
        raise StreamError("TXF-S32", "the checksum of the decoded marks does not match", clause="8.4.2",
                          offset=values["offset"])
    return marks


def decode_coded_normals(values: dict, texf: Texf) -> np.ndarray:
    """Decodes the coded normals of corner groups (spec 8.4.4).

    Parameters
    ----------
    values : dict
        Syntax values of the coded_normals unit.
    texf : Texf
        With its geometry units, materials and sharp_edges.

    Returns
    -------
    int16 [G, 3]
        One normal for each corner group, of length about 2**14.

    Raises
    ------
    StreamError
        TXF-S30: the number of groups differs; TXF-S32: the checksum differs.
    """
    from .codecs.coded_normals import dec_residuals

    groups: CornerGroups = texf.corner_groups()
    if len(groups) != values["num_groups"]:
        raise StreamError("TXF-S30", "the corners rebuilt from the geometry differ from those with coded normals",
                          clause="8.4.3", offset=values["offset"], value=len(groups), allowed=values["num_groups"])
    normals = groups.normals(dec_residuals(values["residual_data"], groups), values["normal_step"])
    if zlib.crc32(normals.astype("<i2").tobytes()) != values["normals_crc"]:
        raise StreamError("TXF-S32", "the checksum of the decoded normals does not match", clause="8.4.4",
                          offset=values["offset"])
    return normals


def _metadata(raw, report):
    """The metadata as a dict. The unit is ancillary: if it is not a JSON object, it is skipped with a warning."""
    value = {} if raw is None else json_object(raw)
    if value is None:
        report.warnings.append("the metadata unit is not a JSON object and is skipped")
    return value or {}


def json_object(raw: bytes) -> dict | None:
    """Parses a JSON object.

    Parameters
    ----------
    raw : bytes
        Text of a JSON document.

    Returns
    -------
    dict or None
        None if the bytes are not a JSON object.
    """
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def check_samples(surfaces: list[DecodedSurface], stream: Stream, position_bits: int, limits: Limits) -> None:
    """Refuse a stream whose supports (voxels, texels) would take too long to derive from its surfaces. The time grows with
    samples and rows of texels; their sum over all fields is checked before the first is visited.

    Parameters
    ----------
    surfaces : list of DecodedSurface
        By field.
    stream : Stream
        Gives resolutions and image sizes.
    position_bits : int
        Bits of a lattice coordinate.
    limits : Limits
        Gives the limit of samples.

    Raises
    ------
    LimitError
        TXF-L05.
    """
    total = _count_samples(surfaces, stream, position_bits)
    if limits.samples is not None and total > limits.samples:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", clause="6.3", value=total,
                         allowed=limits.samples)


def _count_samples(surfaces, stream, position_bits):
    """Samples and rows of all fields (spec 10.1)."""
    total = 0
    for surface, field in zip(surfaces, stream.fields, strict=True):
        total += _count_rows(surface, field) if field["support"] == SUPPORT_TEXELS else \
            count_samples(surface.mesh.lattice, surface.mesh.faces, position_bits, field["resolution"])
    if stream.joint:
        total += joint_codec_of_unit(stream.joint).count_samples(stream.joint, [s.mesh for s in surfaces], position_bits)
    return total


def _count_rows(surface, field):
    """Rows of texels that a field's faces cover, plus a sixteenth of its image: 16 texels are scanned in the time of one
    sample."""
    return count_rows(surface.uv, surface.mesh.faces, field["uv_fraction_bits"]) + (field["width"] * field["height"] >> 4)


def surface_of_field(units: list, field: dict) -> DecodedSurface:
    """Join the geometry units of a field to the surface from which its support (voxels or texels) is derived.

    Parameters
    ----------
    units : list of GeometryUnit
        All units of the stream.
    field : dict
        Syntax values of the field unit.

    Returns
    -------
    DecodedSurface
        With UVs if the field is over texels.
    """
    number = field["field_index"]
    return DecodedSurface(field_surface(units, number), field_uv(units, number) if field["support"] == SUPPORT_TEXELS else None)


def decode_support(surface: DecodedSurface, values: dict, position_bits: int,
                   options: DecodeOptions) -> VoxelSupport | TexelSupport:
    """Derive the voxels or texels that hold a field's values from its surface (spec clause 6).

    Parameters
    ----------
    surface : DecodedSurface
        As surface_of_field() returns it.
    values : dict
        Syntax values of the field unit.
    position_bits : int
        Bits of a lattice coordinate.
    options : DecodeOptions
        Threads and limits.

    Returns
    -------
    VoxelSupport or TexelSupport
        At full resolution.

    Raises
    ------
    StreamError
        TXF-S30: the cells differ from the coded ones in number or checksum.
    LimitError
        More cells than options.limits allows.
    """
    decode = _decode_texels if values["support"] == SUPPORT_TEXELS else _decode_voxels
    support = decode(surface, values, position_bits, options)
    if len(support) != values["num_keys"] or keys_crc(support.keys) != values["keys_crc"]:
        raise StreamError("TXF-S30", "the voxels or texels rebuilt from the geometry differ from the coded ones",
                          clause="6.5" if support.planar else "6.4", value=len(support), allowed=values["num_keys"])
    return support


def _decode_voxels(surface, values, position_bits, options):
    keys, _ = voxelise(surface.mesh.lattice, surface.mesh.faces, position_bits, values["resolution"], values["area_threshold"],
                       options.threads, options.limits.voxels)
    return VoxelSupport(values["resolution"], keys)


def _decode_texels(surface, values, position_bits, options):
    size, wrap = (values["width"], values["height"]), (values["wrap_s"], values["wrap_t"])
    keys = referenced_texels(surface.uv, surface.mesh.faces, values["uv_fraction_bits"], size, wrap, options.limits.voxels)
    return TexelSupport(keys=keys, width=size[0], height=size[1], wrap=wrap, fraction_bits=values["uv_fraction_bits"])


def _support_stage(fields, number, report):
    """The report's stage for deriving a field's support, numbered among the fields of the same kind."""
    same = [i for i, field in enumerate(fields) if field["support"] == fields[number]["support"]]
    return report.stage("texels" if fields[number]["support"] == SUPPORT_TEXELS else "voxelise", (same.index(number), len(same)))


def _decode_planes(texf, stream, surfaces, options, report, known):
    """Adds the fields to texf when each channel group has an attribute unit of its own."""
    for i, field in enumerate(stream.fields):
        with _support_stage(stream.fields, i, report):
            support = decode_support(surfaces[i], field, texf.position_bits, options)
        with report.stage("attributes", (i, len(stream.fields))):
            texf.fields.append(Field(support.coarser(options.lod), {}))
            for values in stream.attributes:
                if values["field_index"] == i:
                    begin, group = time.perf_counter(), texf.groups[values["group_index"]]
                    _add_planes(texf.fields[i], group, values, support, options, known(values, group))
                    report.channels.append({"field": i, "channels": [channel.name for channel in group.channels],
                                            "decode_ms": round(1000 * (time.perf_counter() - begin), 1)})
        support.forget()


def _add_planes(field, group, values, support, options, plane=None):
    """Adds the planes of one attribute unit to a Field, without the levels that options.lod omits. plane: the decoded values, if
    they are known already."""
    shift, codec = values["level_shift"], plane_codec_of_unit(values)
    if plane is None:
        plane = _decode_plane(codec, values, support.coarser(shift), max(options.lod - shift, 0), options)
    else:
        check_values(zlib.crc32(plane), values, codec)
    add_planes(field, group, values, plane)


def add_planes(field: Field, group: Group, values: dict, plane: np.ndarray) -> None:
    """Adds the planes of one attribute unit to a field, in place.

    Parameters
    ----------
    field : Field
        Its support is that of its level of detail.
    group : Group
        Channel group of the unit.
    values : dict
        Syntax values of the unit.
    plane : uint8 [n, C]
        Decoded values on the support of the unit's own level.
    """
    planes, step = group.split(plane), plane_codec_of_unit(values).step(values)
    field.planes |= planes
    if step is not None:
        field.steps |= dict.fromkeys(planes, step)
    field.shifts |= dict.fromkeys(planes, max(values["level_shift"] - field.level_shift, 0))


def _decode_plane(codec, values, support, levels, options):
    """Decodes one attribute unit without its last `levels` levels: uint8 [n, C]. support: the support of its full plane."""
    plane = codec.dec(values, support, levels if codec.has_levels else 0, options.threads)
    if not (codec.has_levels and min(levels, support.depth)):
        check_values(zlib.crc32(np.ascontiguousarray(plane).data), values, codec)  # a plug-in may return a view
    return plane if codec.has_levels else support.mean(plane, levels)


def _decode_jointly(texf, stream, surfaces, options, report):
    """Adds fields to texf whose points are answered by evaluators. Their voxels hold the answers at the voxel centres."""
    values, total = stream.joint, 0
    codec = texf.codec = joint_codec_of_unit(values)
    texf.evaluators = codec.dec(values, [s.mesh for s in surfaces], texf.position_bits, texf.groups, options, report)
    for i, field in enumerate(stream.fields):
        with _support_stage(stream.fields, i, report):
            support = decode_support(surfaces[i], field, texf.position_bits, options)
        with report.stage("attributes", (i, len(stream.fields))):
            full = texf.evaluators[i].values(support, options.threads)
            total = zlib.crc32(full, total)
            planes = split_groups(support.mean(full, options.lod), texf.groups)
            texf.fields.append(Field(support.coarser(options.lod), planes))
    check_values(total, values, codec)


def check_values(checksum: int, values: dict, codec: Codec) -> None:
    """Compare the checksum of a unit's decoded values with its values_crc.

    Parameters
    ----------
    checksum : int
        CRC-32 of the decoded values.
    values : dict
        Syntax values of the attribute unit.
    codec : Codec
        Names the clause in the error.

    Raises
    ------
    StreamError
        TXF-S32.
    """
    if checksum != values["values_crc"]:
        raise StreamError("TXF-S32", "the checksum of the decoded values does not match", clause=codec.checksum_clause,
                          offset=values["offset"])
