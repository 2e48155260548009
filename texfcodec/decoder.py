"""Stream to Texf: the mirror image of encoder.py."""

import json
import zlib

import numpy as np

from .asset.scene import Material
from .bitstream.stream import read_stream
from .bitstream.syntax import SEMANTIC_ALPHA, SEMANTIC_BASE_COLOUR
from .bitstream.values import coded_of
from .codecs.neural.infer import voxel_values
from .codecs.neural.payload import Tables, payload_of, take_codes
from .codecs.raht.codec import dec_attributes
from .codecs.raht.layout import octree_depth
from .codecs.raht.transform.colour import TRANSFORM_BT709, inverse_colour, inverse_plain
from .errors import LimitError, StreamError
from .geometry.canonical import CanonicalCube
from .geometry.draco import dec_geometry
from .options import DecodeOptions
from .report import Report
from .support.morton import decode_morton
from .support.voxelise import count_samples, voxelise
from .texf import Field, GeometryUnit, Texf


def decode(data, options=None, report=None):
    """Decodes a .texf stream (spec clauses 5 to 8).

    data: bytes; options: DecodeOptions; report: Report that receives seconds by stage and warnings. Returns Texf.
    Raises StreamError, LimitError or SupportError; nothing else on any input.
    """
    options, report = options or DecodeOptions(), report or Report()
    if options.isolate:
        from .isolate import decode_isolated

        return decode_isolated(data, options, report)
    with report.stage("parse"):
        stream = read_stream(bytes(data), options.limits)
    for unit in stream.skipped:
        report.warnings.append(f"skipped an unknown ancillary unit of type {unit['type']} at byte {unit['offset']}")
    header = stream.header
    cube = CanonicalCube(tuple(header["origin"]), header["side"], header["position_bits"])
    with report.stage("geometry"):
        units = [_decode_unit(g, cube.position_bits) for g in stream.geometry]
    texf = Texf(cube, units, [], [_material(m) for m in stream.materials], threads=options.threads, skipped=stream.skipped)
    texf.metadata = _metadata(stream.metadata, report)
    groups = header["channel_groups"]
    texf.has_alpha = any(g["group_semantic"] == SEMANTIC_ALPHA for g in groups)
    surfaces = [field_surface(units, i) for i in range(len(stream.fields))]
    _check_samples(surfaces, stream, cube.position_bits, options.limits)
    if stream.neural:
        _decode_neural(texf, stream, surfaces, options, report)
        return texf
    for i, values in enumerate(stream.fields):
        with report.stage("voxelise"):
            keys = _decode_voxels(surfaces[i], values, cube.position_bits, options)
        coded = [a for a in stream.attributes if a["field_index"] == i]
        with report.stage("attributes"):
            texf.fields.append(_decode_field(values["resolution"], keys, coded, groups, options))
    return texf


def _decode_unit(values, position_bits):
    lattice, faces = dec_geometry(values["draco_data"], values["unit_vertices"], values["unit_faces"], position_bits,
                                  values["offset"])
    return GeometryUnit(values["field_index"], values["material_index"], lattice, faces)


def _material(values):
    cutoff = (values["alpha_cutoff"] or 0) / 65535
    flags = values["material_flags"]
    return Material(values["material_name"], alpha_mode=values["alpha_mode"], alpha_cutoff=cutoff, double_sided=bool(flags & 1),
                    unlit=bool(flags & 2))


def _metadata(raw, report):
    """The metadata unit is ancillary: one that is not JSON is passed over with a warning."""
    if raw is None:
        return {}
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        report.warnings.append("the metadata unit does not hold a JSON object and was passed over")
        return {}
    return value


def field_surface(units, number):
    """Lattice and faces of all geometry units of one field, joined: (int64 [V, 3], int64 [F, 3])."""
    mine = [u for u in units if u.field == number]
    starts = np.cumsum([0] + [len(u.lattice) for u in mine])
    faces = [u.faces + s for u, s in zip(mine, starts[:-1], strict=True)]
    return np.concatenate([u.lattice for u in mine]), np.concatenate(faces)


def voxels_crc(keys):
    """CRC-32 over the Morton keys as 64-bit little-endian numbers (spec 6.4)."""
    return zlib.crc32(np.ascontiguousarray(keys, "<i8"))


def _check_samples(surfaces, stream, position_bits, limits):
    """Voxelisation time grows with the samples: refuses the sum over all fields before the first is touched."""
    total = sum(count_samples(*s, position_bits, f["resolution"]) for s, f in zip(surfaces, stream.fields, strict=True))
    if stream.neural:
        grids = [level["level_resolution"] for level in stream.neural["latent_levels"] if level["table_log2"] == 0]
        total += sum(count_samples(*s, position_bits, grid) for s in surfaces for grid in grids)
    if limits.samples is not None and total > limits.samples:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", clause="6.3", value=total,
                         allowed=limits.samples)


def _decode_voxels(surface, values, position_bits, options):
    keys, _ = voxelise(*surface, position_bits, values["resolution"], values["area_threshold"], options.threads,
                       options.limits.voxels)
    if len(keys) != values["num_voxels"] or voxels_crc(keys) != values["voxels_crc"]:
        raise StreamError("TXF-S30", "the voxels rebuilt from the geometry are not the ones that were coded", clause="6.4",
                          value=len(keys), allowed=values["num_voxels"])
    if len(keys) == 0:
        raise StreamError("TXF-S31", "a field has no voxels", clause="5.5", value=values["field_index"])
    return keys


def _decode_neural(texf, stream, surfaces, options, report):
    """Fills texf with the fields of a 3DNTC payload (clause 11)."""
    values, bits, groups = stream.neural, texf.cube.position_bits, stream.header["channel_groups"]
    payload, total = payload_of(values, options.limits), 0
    columns = tuple(c for g in groups for c in ((0, 1, 2) if g["group_semantic"] == SEMANTIC_BASE_COLOUR else (3,)))
    with report.stage("voxelise"):
        grids = [[_level_voxels(one, bits, level, i, options) for level in payload.levels] for i, one in enumerate(surfaces)]
    with report.stage("attributes"):
        take_codes(payload, values)
        texf.neural = [Tables(payload, i, keys, columns) for i, keys in enumerate(grids)]
    for i, field in enumerate(stream.fields):
        with report.stage("voxelise"):
            keys = _decode_voxels(surfaces[i], field, bits, options)
        with report.stage("attributes"):
            plane = voxel_values(decode_morton(keys), field["resolution"], texf.neural[i], options.threads)
            total = zlib.crc32(plane, total)
            texf.fields.append(_coarse_field(field["resolution"], keys, plane, columns, options.lod))
    if total != values["values_crc"]:
        raise StreamError("TXF-S32", "the decoded values do not have the checksum that was sent", clause="11.8",
                          offset=values["offset"])


def _coarse_field(resolution, keys, plane, columns, lod):
    """Field of a 3DNTC payload's voxels; where levels are left out, of the rounded means of those below (8.3)."""
    depth = octree_depth(resolution)
    shift = min(lod, depth)
    first = np.flatnonzero(np.diff(keys >> 3 * shift, prepend=-1))
    counts = np.diff(np.append(first, len(keys)))[:, None]
    rgba = np.full((len(first), 4), 255, np.uint8)
    rgba[:, list(columns)] = (2 * np.add.reduceat(plane.astype(np.int64), first, axis=0) + counts) // (2 * counts)
    return Field(resolution, shift, keys[first] >> 3 * shift, rgba)


def _level_voxels(surface, position_bits, level, number, options):
    """Voxels of one field that have latents, ascending Morton keys; None for a hashed level (clause 11.3)."""
    if level.table_log2:
        return None
    keys, _ = voxelise(*surface, position_bits, level.resolution, level.area_threshold, options.threads, options.limits.voxels)
    if len(keys) != level.entries[number]:
        raise StreamError("TXF-S30", "the voxels rebuilt from the geometry are not the ones that have latents", clause="11.3",
                          value=len(keys), allowed=level.entries[number])
    return keys


def _decode_field(resolution, keys, coded, groups, options):
    depth = octree_depth(resolution)
    stop = max(0, depth - options.lod)
    level_keys = keys if stop == depth else np.unique(keys >> 3 * (depth - stop))
    rgba = np.full((len(level_keys), 4), 255, np.uint8)
    for values in coded:
        plane = _decode_group(values, keys, depth, stop, options.threads)
        rgba[:, slice(0, 3) if groups[values["group_index"]]["group_semantic"] == SEMANTIC_BASE_COLOUR else slice(3, 4)] = plane
    return Field(resolution, depth - stop, level_keys, rgba)


def _decode_group(values, keys, depth, stop, threads):
    """One attribute unit down to level `stop`: uint8 [n, C]."""
    coded, spans = coded_of(values)
    bt709 = values["colour_transform"] == TRANSFORM_BT709
    if bt709 and len(coded.qp) != 3:
        raise StreamError("TXF-S04", "colour_transform needs three components", clause="5.7.1", offset=values["offset"])
    data, inverse = np.frombuffer(values["codeword_data"], np.uint8), inverse_colour if bt709 else inverse_plain
    plane = dec_attributes(keys, depth, coded, data, spans, stop, threads, inverse)
    if stop == depth and zlib.crc32(plane) != values["values_crc"]:
        raise StreamError("TXF-S32", "the decoded values do not have the checksum that was sent", clause="7.10",
                          offset=values["offset"])
    return plane

