"""Decoding in a child process with capped memory and time: what to use for files from strangers.

The parent never runs Draco or a kernel on the stream. What the child answers is arrays without pickles and JSON, checked again.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from .. import errors
from ..bitstream.appearance import check_groups, check_material, groups_of, material_of
from ..bitstream.syntax import CHANNEL_GROUP, MATERIAL, MAX_GROUPS
from ..bitstream.values import material_values
from ..codecs import codec_names, codec_of
from ..codecs.base import JointCodec
from ..core.syntax_table import Element, Structure
from ..core.syntax_walk import REALS, Reader, read_structure, write_structure
from ..errors import StreamError, TexfError
from ..field.extents import MAX_SIDE
from ..field.texel_set import MAX_UV
from ..field.texels import TexelSupport, texels_are_sound
from ..field.voxels import VoxelSupport, keys_are_sound
from ..geometry.canonical import MAX_BITS, MIN_BITS, CanonicalCube
from ..geometry.edges import coded_edges
from ..geometry.geometry_unit import GeometryUnit
from ..limits import Limits
from ..options import DecodeOptions
from ..report import Report, peak_memory_bytes
from ..scene.channels import COLOURS, channel_over, group_values
from ..texf import Field, Texf
from .limited_process import FACTS, NO_CAP, child_folder, crash_of, read_facts, run_child, within_cap

ANSWER = "answer.npz"
APPEARANCE = Structure("appearance", "5.4", (  # channel groups and materials of an answer, as in a stream
    Element("num_channel_groups", "u8", 1, MAX_GROUPS),
    Element("channel_groups", CHANNEL_GROUP, count="num_channel_groups"),
    Element("num_materials", "v", 0, 65536),
    Element("materials", MATERIAL, count="num_materials"),
))
_USUAL = Limits()


def decode_isolated(data: bytes, options: DecodeOptions | None = None, report: Report | None = None) -> Texf:
    """As decode(), in a child process capped by limits.isolate_bytes (of address space beyond what the idle decoder has) and
    limits.isolate_seconds.

    data: bytes; options: DecodeOptions; report: Report, which gets the child's seconds, warnings and peak memory. Where the
    system has no cap on memory, a warning says so. Raises what decode() raises, and TXF-S40, TXF-L07, TXF-L08, TXF-L15.
    """
    options, report = options or DecodeOptions(), report or Report()
    with child_folder() as folder, report.stage("isolate"):
        facts, arrays = _run_child(bytes(data), options, folder)
    report.warnings += [str(w) for w in facts["warnings"]]
    report.seconds |= {f"child {name}": value for name, value in facts["seconds"].items()}
    report.child_peak_memory_bytes = facts["peak_memory_bytes"]
    return _texf(facts, arrays, options.threads, options.limits)


def _run_child(data, options, folder):
    """Starts the child, waits, and returns its answer (facts, arrays), or raises what became of it."""
    child = run_child("texfcodec.sandbox.isolate", data, asdict(options), options.limits, folder)
    try:
        facts = read_facts(folder)
        if "error" in facts:
            raise _error_of(facts["error"])
        with np.load(folder / ANSWER, allow_pickle=False) as file:
            return facts, {name: file[name] for name in file.files}
    except TexfError:
        raise
    except Exception as error:  # no answer, or one that a broken child made up
        raise crash_of(child, options.limits) from error


def _error_of(facts):
    """The child's own error, in the class it names."""
    family = {name: getattr(errors, name) for name in ("InputError", "StreamError", "LimitError", "SupportError")}
    details = {str(k): v for k, v in facts["details"].items()}
    return family.get(facts["family"], StreamError)(str(facts["code"]), str(facts["message"]), **details)


def _texf(facts, arrays, threads, limits=_USUAL):
    """The Texf of an answer. The child may have been taken over: every index is checked again."""
    try:
        cube = _cube(facts)
        groups, materials = _appearance(arrays["appearance"])
        channels = tuple(channel for group in groups for channel in group.channels)
        units = _split(facts["units"], arrays, {"lattice": np.int64, "faces": np.int64, "uv": np.int64})
        fields = _split(facts["fields"], arrays, {"keys": np.int64, **{_plane(c): np.uint8 for c in channels}})
        texf = Texf(cube=cube, units=[_unit(numbers, parts) for numbers, parts in units],
                    fields=[_field(field, channels, shifts, steps)
                            for field, shifts, steps in zip(fields, facts["shifts"], facts["steps"], strict=True)],
                    materials=materials, metadata=dict(facts["metadata"]), groups=groups, threads=threads,
                    skipped=list(facts["skipped"]))
        if facts["sharp_edges"]:
            texf.sharp_edges = _typed(arrays["sharp_edges"], bool)
        if facts["coded_normals"]:
            texf.coded_normals = _typed(arrays["coded_normals"], np.int16)
        sound = answer_is_sound(texf, limits)
        if facts["codec"] is not None:
            codec = texf.codec = _codec(facts["codec"])
            texf.evaluators = codec.unpack(facts["evaluators"], arrays, groups, len(texf.fields))
    except (TexfError, KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise StreamError("TXF-S40", "the decoder returned an invalid result", reason=type(error).__name__) from error
    if not sound:
        raise StreamError("TXF-S40", "the decoder returned an index out of range")
    return texf


def answer_is_sound(texf: Texf, limits: Limits) -> bool:
    """Whether no index in what a sandbox answered leaves its array, and every array is as long as what it belongs to."""
    sound = all(_field_is_sound(f, texf.channels, limits) for f in texf.fields)
    sound = sound and all(_unit_is_sound(u, texf) for u in texf.units)
    if sound and texf.sharp_edges is not None:
        sound = _marks_are_sound(texf)
    if sound and texf.coded_normals is not None:
        sound = texf.coded_normals.shape == (len(texf.corner_groups()), 3)
    return sound


def _cube(facts):
    """The canonical cube, in the ranges of a sequence header (5.3)."""
    cube = CanonicalCube(tuple(float(x) for x in facts["origin"]), float(facts["side"]), facts["position_bits"])
    finite = all(abs(x) <= REALS["f64"] for x in (*cube.origin, cube.side))
    if len(cube.origin) != 3 or not finite or cube.side < 0 or not MIN_BITS <= cube.position_bits <= MAX_BITS:
        raise ValueError("cube")
    return cube


def _typed(array, kind):
    """The array without gaps, which must hold this kind of numbers: others are not converted."""
    if array.dtype != kind:
        raise ValueError("kind of numbers")
    return np.ascontiguousarray(array)


def _pack_appearance(texf):
    """What _appearance() reads: uint8 [n]."""
    groups = [group_values(g.channels, g.grey) for g in texf.groups]
    materials = [material_values(m) for m in texf.materials]
    return np.frombuffer(write_structure(APPEARANCE, {"num_channel_groups": len(groups), "channel_groups": groups,
                                                      "num_materials": len(materials), "materials": materials}), np.uint8)


def _appearance(packed):
    """Channel groups and materials, checked like those of a stream."""
    data = np.ascontiguousarray(packed, np.uint8).tobytes()
    reader = Reader(data, 0, len(data))
    values = read_structure(APPEARANCE, reader, {})
    check_groups(values["channel_groups"])
    for material in values["materials"]:
        check_material(material)
    if reader.position != reader.end:
        raise ValueError("appearance")
    return groups_of(values["channel_groups"]), [material_of(material) for material in values["materials"]]


def _plane(channel):
    """Name of the array that holds a channel's planes of the fields that have one, end to end."""
    return f"plane_{channel.name}"


def _marks_are_sound(texf):
    marked = np.array([m.normals.has_marks for m in texf.materials], bool)[texf.face_material]
    return texf.sharp_edges.shape == (len(coded_edges(texf.lattice_positions, texf.faces, marked)[0]),)


def _unit(numbers, parts):
    """The GeometryUnit of (field, material, whether it has UVs) and its arrays."""
    field, material, textured = numbers
    return GeometryUnit(field, material, parts[0], parts[1], parts[2] if textured else None)


def _field(packed, channels, shifts, steps):
    """The Field of its support's numbers, two over voxels and six over texels, its arrays, and the shifts and steps of its
    planes."""
    numbers, parts = packed
    planes = {channel.name: plane for channel, plane in zip(channels, parts[1:], strict=True) if len(plane)}
    shifts = {str(name): int(shift) for name, shift in shifts.items()}
    steps = {str(name): float(step) for name, step in steps.items()}
    if len(numbers) == len(_support_numbers(VoxelSupport(1, parts[0]))):
        return Field(VoxelSupport(numbers[0], parts[0], numbers[1]), planes, shifts, steps)
    width, height, wrap_s, wrap_t, fraction_bits, shift = numbers
    support = TexelSupport(keys=parts[0], level_shift=shift, width=width, height=height, wrap=(wrap_s, wrap_t),
                           fraction_bits=fraction_bits)
    return Field(support, planes, shifts, steps)


def _support_numbers(support):
    """What makes a support beside its keys."""
    if support.planar:
        return [support.width, support.height, *support.wrap, support.fraction_bits, support.level_shift]
    return [support.resolution, support.level_shift]


def _codec(name):
    codec = codec_of(name) if name in codec_names() else None
    if not isinstance(codec, JointCodec):
        raise ValueError("codec")
    return codec


def _split(rows, arrays, dtypes):
    """Cuts arrays that were joined end to end. rows: ([numbers], [length of each array]) per part."""
    at, out = dict.fromkeys(dtypes, 0), []
    for numbers, lengths in rows:
        parts = []
        for (name, dtype), length in zip(dtypes.items(), lengths, strict=True):
            parts.append(_typed(arrays[name][at[name] : at[name] + length], dtype))
            if len(parts[-1]) != length:
                raise ValueError(name)
            at[name] += length
        out.append(([int(n) for n in numbers], parts))
    return out


def _unit_is_sound(unit, texf):
    named = 0 <= unit.field < len(texf.fields) and 0 <= unit.material < len(texf.materials)
    return named and unit.lattice.shape[1:] == (3,) and unit.faces.shape[1:] == (3,) and _within(unit.faces, len(unit.lattice)) \
        and _within(unit.lattice, 1 << texf.position_bits) and _uv_is_sound(unit, texf.fields[unit.field]) \
        and _has_maps(texf.fields[unit.field], texf.materials[unit.material])


def _has_maps(part, material):
    """Whether a field has planes of all channels that a material of its faces names."""
    return all(channel_over(name, part.over_texels).name in part.planes for name in material.maps)


def _uv_is_sound(unit, part):
    """A unit has UVs where its field is over texels, one for each vertex, and only there."""
    if unit.uv is None or not part.over_texels:
        return unit.uv is None and not part.over_texels
    return unit.uv.shape == (len(unit.lattice), 2) and bool(((unit.uv > -MAX_UV) & (unit.uv < MAX_UV)).all())


def _field_is_sound(part, channels, limits):
    whole = all(c.name in part.planes for c in channels if c in COLOURS) and part.shifts.keys() <= part.planes.keys()
    whole = whole and all(0 <= step < 1 << 12 for step in part.steps.values())
    return whole and _support_is_sound(part.support, limits) \
        and all(_plane_is_sound(part, c) for c in channels if c.name in part.planes)


def _plane_is_sound(part, channel):
    """Whether a plane is as long as its support, which is that of the field for what every viewer shows."""
    shift = part.shifts.get(channel.name, 0)
    within = 0 <= shift <= (0 if channel in COLOURS else part.support.depth)
    return within and part.planes[channel.name].shape == (len(part.support_of(channel.name)), channel.components)


def _support_is_sound(support, limits):
    if not support.planar:
        return 1 <= support.resolution <= 8192 and 0 <= support.level_shift <= 13 and keys_are_sound(support.keys, support.size)
    numbers = (support.width, support.height, *support.wrap, support.fraction_bits, support.level_shift)
    least, most = (1, 1, 0, 0, 0, 0), (MAX_SIDE, MAX_SIDE, 2, 2, 8, 14)
    within = all(low <= number <= high for low, number, high in zip(least, numbers, most, strict=True))
    few = limits.texels is None or support.width * support.height <= limits.texels
    return within and few and texels_are_sound(support.keys, support.size)


def _within(values, end):
    return len(values) > 0 and values.min() >= 0 and values.max() < end


def _child(folder, request):
    """The child's side: decodes stdin and leaves its answer in the folder."""
    from ..decoder import decode_stream

    limits = Limits(**request.pop("limits"))
    request["isolate"] = False
    data, report = sys.stdin.buffer.read(), Report()

    def decoded():
        facts, arrays = _answer(decode_stream(data, DecodeOptions(**request, limits=limits), report), report)
        np.savez(folder / ANSWER, **arrays)
        return facts

    try:
        facts, capped = within_cap(limits, decoded)
        facts["warnings"] = report.warnings + [NO_CAP] * (not capped)
    except TexfError as error:
        facts = {"error": {"family": type(error).__name__, "code": error.code, "message": error.message,
                           "details": error.details}}
    (folder / FACTS).write_text(json.dumps(facts), encoding="utf-8")


def _answer(texf, report):
    """(facts, arrays) of a decoded Texf; arrays of all units and fields joined end to end."""
    facts = {
        "origin": list(texf.cube.origin), "side": texf.side, "position_bits": texf.position_bits, "metadata": texf.metadata,
        "skipped": texf.skipped, "warnings": report.warnings,
        "seconds": report.seconds, "peak_memory_bytes": peak_memory_bytes(), "codec": None,
        "units": [([u.field, u.material, int(u.uv is not None)], [len(u.lattice), len(u.faces), _length(u.uv)])
                  for u in texf.units],
        "fields": [(_support_numbers(f.support), [len(f.keys), *(_length(f.planes.get(c.name)) for c in texf.channels)])
                   for f in texf.fields],
        "shifts": [f.shifts for f in texf.fields], "steps": [f.steps for f in texf.fields],
        "sharp_edges": texf.sharp_edges is not None, "coded_normals": texf.coded_normals is not None,
    }
    arrays = {
        "lattice": np.concatenate([np.zeros((0, 3), np.int64), *(u.lattice for u in texf.units)]),
        "faces": np.concatenate([np.zeros((0, 3), np.int64), *(u.faces for u in texf.units)]),
        "uv": np.concatenate([np.zeros((0, 2), np.int64), *(u.uv for u in texf.units if u.uv is not None)]),
        "keys": np.concatenate([np.zeros(0, np.int64), *(f.keys for f in texf.fields)]),
        "appearance": _pack_appearance(texf),
    }
    for name in ("sharp_edges", "coded_normals"):
        if facts[name]:
            arrays[name] = getattr(texf, name)
    for channel in texf.channels:
        empty = np.zeros((0, channel.components), np.uint8)
        arrays[_plane(channel)] = np.concatenate([empty, *(f.planes[channel.name] for f in texf.fields
                                                              if channel.name in f.planes)])
    if texf.evaluators:
        facts["codec"] = texf.codec.name
        facts["evaluators"], packed = texf.codec.pack(texf.evaluators)
        arrays |= packed
    return facts, arrays


def _length(array):
    return 0 if array is None else len(array)


if __name__ == "__main__":
    _child(Path(sys.argv[1]), json.loads(sys.argv[2]))
