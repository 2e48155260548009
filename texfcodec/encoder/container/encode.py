"""A glTF file -> the same file with its meshes and images in streams (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...bitstream.stream import read_stream, write_stream
from ...core.json_text import json_text
from ...errors import InputError
from ...io.container.layout import CodedPrimitive, short_numbers, write_extension
from ...io.container.references import DATA
from ...io.container.rewritten import Rewritten
from ...io.gltf.carried import EXTENSION
from ...io.gltf.document import open_document
from ...io.gltf.material import slot_of
from ...io.gltf.properties import extensions
from ...io.gltf.properties import part as part_of
from ...io.gltf.reader import place
from ...io.parts import Notes, assemble
from ...report import SENTENCES
from ...scene.channels import BY_NAME
from .keyframes import reduce_keyframes
from .line_up import line_up
from .plan import KeptNotes, clusters_of, plan_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ...options import EncodeOptions
    from ...report import Report
    from ...scene.scene import Scene
    from ...texf import Texf
    from ..write import Encoded
    from .plan import CodedPart, Plan

_DRACO = "KHR_draco_mesh_compression"
_OF_A_PART = ("TXF-I60", "TXF-I61", "TXF-I62", "TXF-I63")  # of a stream's meshes; others are of the file or of options


@dataclass(kw_only=True)
class EncodedContainer:
    """A coded glTF file and its report.

    Attributes
    ----------
    data : bytes
        The GLB.
    streams : list of Encoded
        Its streams, in order.
    sizes : dict
        Bytes of the "streams" and of all else, "other".
    warnings, dropped : list of str
        Changes of the picture in sentences, and names of what is not coded.
    remarks : list of str
        Sentences on what changes no picture.
    """

    data: bytes
    streams: list[Encoded]
    sizes: dict[str, int]
    warnings: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def encode_document(data: bytes, folder: Path, options: EncodeOptions, report: Report,
                    code: Callable[[Scene, EncodeOptions, Report], Encoded]) -> EncodedContainer:
    """Code the meshes of a glTF file.

    Parameters
    ----------
    data : bytes
        A .glb or .gltf file.
    folder : Path
        Base of relative URIs.
    options : EncodeOptions
        Of every stream; meshes with stored values keep their vertices.
    report : Report
        Receives seconds, losses and remarks.
    code : function
        (Scene, EncodeOptions, Report) -> Encoded. It refuses the report's losses if options are strict.

    Raises
    ------
    InputError, LimitError, SupportError
        The file or an option is at fault.
    """
    if options.target_bytes is not None:
        raise InputError("TXF-I50", "target_bytes is of a single stream; a scene may have several", value=options.target_bytes)
    known = {name: len(getattr(report, name)) for name in SENTENCES}
    document = open_document(data, folder, KeptNotes(limits=options.limits))
    out = Rewritten(document)
    views = list(part_of(extensions(document.root), EXTENSION).get("streams", []))
    streams: list[Encoded] = []
    with report.stage("plan"):
        plan = plan_of(document)
    for coded in _all_coded(document, plan, options, report, code):
        coded.number = len(views)
        streams.append(coded.encoded)
        views.append(out.add_view(coded.encoded.data))
        for number, units in enumerate(coded.units):
            if units:
                _write_part(out, plan, coded, number)
    if streams:
        _write_file(out, plan, views)
        if not options.keep_animations:
            reduce_keyframes(document, out)
    glb = out.glb(deflate=bool(streams))
    held = sum(len(encoded.data) for encoded in streams)
    report.remarks += [*plan.remarks, *_lost_labels(document.root, out.root)]
    return EncodedContainer(data=glb, streams=streams, sizes={"streams": held, "other": len(glb) - held},
                            **{name: getattr(report, name)[count:] for name, count in known.items()})


@dataclass(kw_only=True)
class _Coded:
    """A coded stream. texf: decoded; parts: what it holds; units: geometry units of each part, whose number is that of its
    material; stored: of each part, its _Stored; number: of the stream in the file."""

    encoded: Encoded
    texf: Texf
    parts: list[CodedPart]
    units: list[tuple[int, ...]]
    stored: list[_Stored | None]
    number: int = 0


def _all_coded(document, plan, options, report, code) -> Iterator[_Coded]:
    """Yield the streams of a plan. Where one cannot be coded, its parts are coded apart as far as they share no images, and what
    is at fault is left as it is in the file."""
    pending = list(reversed(plan.streams))
    while pending:
        parts = pending.pop()
        counts = {name: len(getattr(report, name)) for name in SENTENCES}
        try:
            coded = _coded(document, plan, parts, options, report, code)
        except InputError as error:
            if error.code not in _OF_A_PART:
                raise
            for name, count in counts.items():  # of what is not coded
                del getattr(report, name)[count:]
            clusters = clusters_of(parts)
            if len(clusters) > 1:
                pending += reversed(clusters)
            else:
                plan.leave(parts, f"{error.message} ({error.code})", [])
        else:
            held = [part for part, units in zip(parts, coded.units, strict=True) if units]
            idle = [part for part, units in zip(parts, coded.units, strict=True) if not units]
            plan.leave(idle, "no face has three distinct corners on the lattice (TXF-I63)", held)
            yield coded


def _coded(document, plan: Plan, parts: list[CodedPart], options, report, code) -> _Coded:
    """Code the parts of a stream. If a material would get its images from two places, all goes over voxels."""
    from ...decoder import decode_stream
    from ...options import DecodeOptions
    from ...report import Report

    keeps = any(part.keeps_vertices for part in parts)
    request = options.changed(effects="all", **({"keep_mesh": True} if keeps else {}))
    scene = _scene(plan, parts)
    for name in SENTENCES:
        setattr(report, name, getattr(report, name) + getattr(scene, name))
    for support in (options.support, "voxels"):
        encoded = code(scene, request.changed(support=support), report)
        encoded = _without_factors(encoded, options.limits)
        texf = decode_stream(encoded.data, DecodeOptions(limits=options.limits), Report())
        units = [tuple(n for n, unit in enumerate(texf.units) if unit.material == number) for number in range(len(parts))]
        if not _is_torn(texf, parts, units):
            break
    stored = [_stored(document, plan, part, texf, of_part) if part.keeps_vertices and of_part else None
              for part, of_part in zip(parts, units, strict=True)]
    return _Coded(encoded=encoded, texf=texf, parts=parts, units=units, stored=stored)


def _without_factors(encoded, limits):
    """Return an Encoded whose stream has no names and parameters of materials, because the file has them."""
    stream = read_stream(encoded.data, limits)
    for material in stream.materials:
        material |= {"name_length": 0, "material_name": "", "num_parameters": 0, "parameters": []}
    data, _ = write_stream(stream)
    saved = len(encoded.data) - len(data)
    return replace(encoded, data=data, sizes=encoded.sizes | {name: encoded.sizes[name] - saved for name in ("total", "other")})


def _is_torn(texf, parts, units):
    """Return whether the faces of a material of the file lie in fields that give it several images."""
    places: dict[int | None, set] = {}
    for part, of_part in zip(parts, units, strict=True):
        for number in of_part:
            field_number = texf.units[number].field
            places.setdefault(part.material, set()).add(field_number if texf.fields[field_number].over_texels else None)
    return any(len(of_material) > 1 and material is not None for material, of_material in places.items())


def _scene(plan, parts) -> Scene:
    """Return the Scene of a stream: each part with a material of its own."""
    materials = [plan.materials[part.material] for part in parts]
    placed = [replace(place(part.part, part.place), material=number, color=None, maps={}) for number, part in enumerate(parts)]
    used = sorted({t for material in materials for t in (material.texture, *material.maps.values()) if t >= 0})
    number_of = {old: new for new, old in enumerate(used)} | {-1: -1}
    materials = [replace(material, name=parts[number].part.label, texture=number_of[material.texture],
                         maps={name: number_of[t] for name, t in material.maps.items()})
                 for number, material in enumerate(materials)]
    scene = assemble(placed, materials, [plan.textures[t] for t in used], Notes())
    scene.flat = True
    return scene


class _Stored(NamedTuple):
    """Values that are stored for a part. arrays: by place in the primitive; rows: int64 [N], their row for each stored vertex;
    splits: as of CodedPrimitive."""

    arrays: dict
    rows: np.ndarray
    splits: np.ndarray


def _stored(document, plan, part, texf, units):
    """Return the _Stored of a part whose vertices are kept. Raises InputError TXF-I62 if they are not all decoded."""
    points = np.asarray(place(part.part, part.place).positions, np.float64)
    rows = np.arange(len(points)) if part.part.rows is None else part.part.rows
    arrays = _stored_arrays(document, plan, part)
    equal = _equal_rows([values[rows] for values, *_ in arrays.values()], len(points))
    lined = line_up(texf, units, points, np.asarray(part.part.faces, np.int64), equal)
    return _Stored(arrays, rows[lined.source], lined.splits)


def _write_part(out: Rewritten, plan: Plan, coded: _Coded, number: int) -> None:
    """Write a primitive: its units, and the values that are stored in their vertex order. number: of the part in its stream."""
    texf, part, units, stored = coded.texf, coded.parts[number], coded.units[number], coded.stored[number]
    primitive = out.root["meshes"][part.mesh]["primitives"][part.number]
    points = np.asarray(place(part.part, part.place).positions, np.float64)
    faces = np.asarray(part.part.faces, np.int64)
    count, splits = sum(len(texf.units[n].lattice) for n in units), np.zeros((0, 2), np.int64)
    if stored is not None:
        count, splits = len(stored.rows), stored.splits
        _write_stored(out, primitive, stored.arrays, stored.rows)
    description = CodedPrimitive(mesh=part.mesh, number=part.number, stream=coded.number, units=units,
                                 matrix=np.linalg.inv(part.place), texcoord=plan.texcoord[part.material], splits=splits)
    texcoord = description.texcoord if plan.slots[part.material] else None
    in_mesh = points[np.unique(faces)] @ description.matrix[:3, :3].T + description.matrix[:3, 3]
    _write_described(out, primitive, part, in_mesh, (count, 3 * sum(len(texf.units[n].faces) for n in units)), texcoord)
    at = out.add_accessor(splits.astype(np.uint32), "VEC2") if len(splits) else None
    write_extension(primitive, description, at)


def _stored_arrays(document, plan, part):
    """Return {place in the primitive: (values [V, k], accessor)} of what is stored: attributes by name, targets by (n, name)."""
    primitive = document.entries("meshes")[part.mesh]["primitives"][part.number]
    return {key: (values, primitive["targets"][key[0]][key[1]] if isinstance(key, tuple) else primitive["attributes"][key])
            for key, values in plan.reader.stored(part.mesh, part.number).items() if isinstance(key, tuple) or key in part.stored}


def _equal_rows(arrays, count):
    """Return a number for each row, int64 [V], equal for rows that are equal in all arrays."""
    if not arrays:
        return np.zeros(count, np.int64)
    packed = np.concatenate([np.ascontiguousarray(values).view(np.uint8).reshape(count, -1) for values in arrays], axis=1)
    return np.unique(packed, axis=0, return_inverse=True)[1].reshape(-1)


def _write_stored(out, primitive, stored, rows):
    """Store the values of a primitive in another order. rows: int64 [N] into the source's."""
    for key, (values, number) in stored.items():
        new = out.add_stored(number, values[rows], isinstance(key, tuple))
        if isinstance(key, tuple):
            primitive["targets"][key[0]][key[1]] = new
        else:
            primitive["attributes"][key] = new


def _write_described(out, primitive, part, points, counts, texcoord):
    """Replace the accessors of what a stream holds by such without data. points: in mesh space; counts: of vertices and
    corners; texcoord: number of the stream's UV set, None without images."""
    attributes = {name: primitive["attributes"][name] for name in primitive["attributes"] if name in part.stored}
    bounds = {"min": short_numbers(points.min(axis=0)), "max": short_numbers(points.max(axis=0))}
    held = {"POSITION": {"componentType": 5126, "count": counts[0], "type": "VEC3", **bounds}}
    held |= {name: {"componentType": 5126, "count": counts[0], "type": kind}
             for name, kind in (("NORMAL", "VEC3"), ("TANGENT", "VEC4")) if name in primitive["attributes"]}
    if texcoord is not None:
        held[f"TEXCOORD_{texcoord}"] = {"componentType": 5126, "count": counts[0], "type": "VEC2"}
    numbers = {name: out.add("accessors", entry) for name, entry in held.items()}  # equal ones are merged in the end
    primitive["attributes"] = numbers | attributes
    primitive["indices"] = out.add("accessors", {"componentType": 5125, "count": counts[1], "type": "SCALAR"})
    primitive.pop("mode", None)
    table = primitive.get("extensions", {})
    table.pop(_DRACO, None)
    if "extensions" in primitive and not table:
        del primitive["extensions"]


def _lost_labels(source, root):
    """Return a remark, in a list, on names and extras of data that are coded or put in another order; [] if all are kept."""
    lost = {}
    for kind in (*DATA, "buffers"):
        before, after = ({json_text([entry.get("name"), entry.get("extras")]) for entry in tree.get(kind, [])
                          if isinstance(entry, dict) and ("name" in entry or "extras" in entry)} for tree in (source, root))
        if before - after:
            lost[kind] = len(before - after)
    return [f"names and extras are left out with coded data: {', '.join(f'{n} of {kind}' for kind, n in lost.items())}"] \
        if lost else []


def _write_file(out, plan, views):
    """Name the streams, and take coded images out of the materials."""
    out.root.setdefault("extensions", {})[EXTENSION] = {"streams": views}
    out.use_extension(EXTENSION, required=True)
    empty = None
    for number, channels in plan.slots.items():
        for name in channels if number is not None else ():
            info = slot_of(out.root["materials"][number], BY_NAME[name])
            empty = out.add("textures", {}) if empty is None else empty
            info["index"] = empty

