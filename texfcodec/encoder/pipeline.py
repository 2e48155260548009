"""Mesh to stream: the whole pipeline on one page. decoder.py is its mirror image."""

from __future__ import annotations

import hashlib
import time
import zlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..bitstream.stream import Stream, attribute_variables, write_stream
from ..bitstream.values import attribute_values, field_values, header_values, material_values, metadata_bytes
from ..codecs import codec_of
from ..codecs.base import PlaneCodec, Source, split_groups
from ..core.json_text import json_ready
from ..errors import InputError
from ..geometry.areas import used_vertices
from ..geometry.checksum import geometry_crc
from ..geometry.draco import counts_of, dec_geometry, dec_textured, enc_geometry, enc_textured, split_corners
from ..geometry.geometry_unit import GeometryUnit, field_surface, field_uv
from ..geometry.surface import Surface, make_surface
from ..options import EncodeOptions
from ..report import Report, no_step, plural
from ..scene.channels import COLOURS, channel_over
from ..scene.scene import NEAREST_FIELDS
from .decide.channel_weights import measured_weights
from .decide.lost_detail import without_lost_detail
from .decide.map_sizes import coarsen_maps
from .decide.materials import needed_scene
from .decide.normal_rules import Shading, choose_normals
from .decide.one_colour import material_colours, one_colour
from .decide.plane_codec import codec_for, with_qp_of
from .decide.spending import CodedUnit, image_budgets, spend
from .decide.supports import choose_supports, without_faces
from .decide.trial import choose_fields, codes_alpha
from .map_planes import errors_of, fill_maps, groups_of, joined, names_of_field, with_grey
from .optimise.refinement import refine_fields
from .shown_maps import ShownMaps
from .source_field import SourceField, active_voxels, check_voxels, filled, transferred
from .texel_field import texel_field

if TYPE_CHECKING:
    from ..scene.scene import Material, Scene


@dataclass
class Prepared:
    """All that does not depend on the QP, but for what choosing supports took from it. geometry: syntax values of the geometry
    units; source: what is coded, by channels and fields; fields: SourceFields, whose planes are empty where the codec asks the
    source itself; materials: as the stream holds them; shading: how normals are made again; choices: which partition and
    refinement, and why."""

    geometry: list
    source: Source
    fields: list[SourceField]
    materials: list[Material]
    shading: Shading
    resolution: int | None = None
    choices: dict = field(default_factory=dict)

    @property
    def over_voxels(self) -> bool:
        """Whether every field is over voxels."""
        return not any(part.support.planar for part in self.fields)

    @property
    def one_colour(self) -> bool:
        """Whether there are no values but one colour, so that no QP changes the stream."""
        return all(part.one_colour for part in self.fields) and all(group.channels[0] in COLOURS for group in self.source.groups)

    @property
    def surface(self) -> Surface:
        """The source on its lattice."""
        return self.source.surface


@dataclass(kw_only=True, repr=False)
class Encoded:
    """A stream and what is known of it. sizes: bytes as {"total", "geometry", "attributes", "other"}; counts: {"fields",
    "voxels", "texels", "faces", "vertices"}; face_field: int64 [F], field of every face of the scene, -1 where it was left out;
    choices: every choice of the encoder by its name, with what was measured for it, JSON-ready; reconstruction_sha256: hash over
    keys and decoded values, field by field and channel by channel; psnr_3d: as metrics.psnr_3d, where it was measured; check: as
    check.check_encoded, where the stream was checked; values: by field, decoded planes by channel name, until then; warnings,
    dropped: what looks different and what is not coded, in sentences; remarks: what changes no picture."""

    data: bytes
    sizes: dict
    counts: dict
    face_field: np.ndarray
    choices: dict
    resolution: int | None
    qp: int | None
    texels_per_voxel_edge: float
    reconstruction_sha256: str
    psnr_3d: dict | None = None
    check: dict | None = None
    values: list[dict[str, np.ndarray]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def __repr__(self):
        counts = ", ".join(f"{number} {name}" for name, number in self.counts.items())
        losses = len(self.warnings) + len(self.dropped)
        lost = f", {losses} loss{'es' * (losses != 1)}" if losses else ""
        return f"<Encoded: {len(self.data)} bytes, K {self.resolution}, QP {self.qp}, {counts}{lost}>"


def encode_scene(scene: Scene, options: EncodeOptions | None = None, report: Report | None = None,
                 finer: frozenset[int] = frozenset()) -> Encoded:
    """Codes a Scene. finer: as of prepare(). Raises InputError, LimitError, SupportError."""
    options, report = options or EncodeOptions(), report or Report()
    return code_prepared(prepare(scene, options, report, finer), options, report)


class OverBudget(Exception):
    """Geometry alone takes as many bytes as the stream may, or more. geometry: that it takes."""

    def __init__(self, geometry: int) -> None:
        super().__init__(f"geometry takes {geometry} bytes")
        self.geometry = geometry


def least_bytes(scene: Scene, options: EncodeOptions) -> tuple[int, int]:
    """(bytes of the header, bytes of the geometry) of a scene's stream with one field over voxels and the fewest position bits
    that the encoder takes: known without a look at any colour."""
    surface = make_surface(scene, options)
    geometry, _ = _code_geometry(surface, np.zeros(len(surface.faces), np.int64), {})
    header = Stream(header_values([], surface, geometry, 1, groups_of(set(), False)))
    return len(write_stream(header)[0]), _bytes_of(geometry)


def _bytes_of(geometry):
    return sum(len(unit["draco_data"]) for unit in geometry)


def prepare(scene: Scene, options: EncodeOptions, report: Report, finer: frozenset[int] = frozenset(),
            budget: int | None = None) -> Prepared:
    """Lattice, partition, geometry, voxels and transfer; may be coded at several QPs. finer: numbers of materials whose supports
    are to be finer than they would be chosen; budget: of the stream, in bytes: raises OverBudget, before any colour is brought
    over, where the geometry takes it all."""
    with report.stage("lattice"):
        surface = make_surface(scene, options)
    with report.stage("effects"):
        needs = needed_scene(scene, surface, options)
        scene = needs.scene
        if options.effort != "fast":
            scene = replace(scene, weights=measured_weights(scene, options.threads))
        colours = material_colours(scene, surface)
    with report.stage("supports") as step:
        supports = choose_supports(scene, surface, options, finer, colours, step)
        colours = colours if supports.surface is surface else material_colours(scene, supports.surface)
    surface, plans = supports.surface, supports.plans
    options = replace(options, resolution=supports.resolution, position_bits=surface.cube.position_bits)
    with report.stage("normals"):
        shading = choose_normals(scene, surface, report)
    with report.stage("partition"):
        if not codec_of(options.codec).joint:  # which asks the source itself, at points
            scene = without_lost_detail(scene, surface, ~_of_plans(surface, plans), supports.resolution)
        face_field, partition = _fields_of_faces(scene, surface, plans, colours, options, report)
    first = int(face_field.max(initial=-1)) + 1 - len(plans)
    with report.stage("geometry") as step:
        geometry, units = _code_geometry(surface, face_field, dict(enumerate(plans, first)), step)
    if budget is not None and _bytes_of(geometry) >= budget:
        raise OverBudget(_bytes_of(geometry))
    surfaces = [field_surface(units, i) for i in range(first + len(plans))]
    names = [names_of_field(scene, surface, face_field == number) for number in range(len(surfaces))]
    present = {channel_over(name, number >= first).name for number, mine in enumerate(names) for name in mine}
    groups = groups_of(present, codes_alpha(scene, surface))
    maps = ShownMaps(scene, surface, shading) if present else None
    source = Source(scene, surface, face_field, surfaces, groups, maps, _on_pictures)
    fields = []
    for number, one in enumerate(surfaces[:first]):
        with report.stage("voxelise", (number, first)):
            fields.append(active_voxels(*one, surface.cube.position_bits, options))
    for number, plan in enumerate(plans, first):
        with report.stage("texels", (number - first, len(plans))):
            fields.append(texel_field(plan, field_uv(units, number), surfaces[number][1], source, options))
    check_voxels(fields, options.limits)
    resolution = options.resolution if first else None
    choices = {"effects": needs.told, "supports": supports.told, "partition": partition, "normals": shading.told}
    prepared = Prepared(geometry, source, fields, needs.materials, shading, resolution, choices)
    report.dropped += _blended_squares(scene, surface, plans, colours)
    codec = codec_of(options.codec)
    if isinstance(codec, PlaneCodec):
        _fill(prepared, names[:first], colours, options, report)
        prepared.source = source._replace(groups=with_grey(source.groups, fields))
        with report.stage("sizes"):
            choices["sizes"] = [coarsen_maps(part, prepared.source, codec, options) for part in fields]
    return prepared


def _on_pictures(*given, **named):
    """refine_by_pictures(), imported where it is asked for: few ask."""
    from .optimise.picture_refinement import refine_by_pictures

    return refine_by_pictures(*given, **named)


def _blended_squares(scene, surface, plans, colours):
    """Names of what is lost of NEAREST samplers: those of images that faces show in more than one colour and which do not go over
    texels."""
    kept = np.zeros(len(surface.faces), bool)
    for plan in plans:
        kept[plan.group.faces] = plan.group.nearest
    shown = {scene.materials[m].texture for m in np.unique(surface.material[~kept]) if np.isnan(colours[m]).any()}
    names = [scene.textures[t].name or str(t) for t in sorted(shown) if t >= 0 and scene.textures[t].nearest]
    return [f"NEAREST filter of texture '{name}'" for name in names]


def _of_plans(surface, plans):
    """Faces of the surface that TexelPlans have, bool [F]."""
    return np.isin(np.arange(len(surface.faces)), np.concatenate([[-1], *(plan.group.faces for plan in plans)]))


def _fields_of_faces(scene, surface, plans, colours, options, report):
    """Field number of every face, int64 [F], and what the report says of it: voxels first, then a field for each TexelPlan.
    colours: of material_colours."""
    face_field, rest = np.empty(len(surface.faces), np.int64), ~_of_plans(surface, plans)
    told, fields = {"fields": 0, "reason": "all of the surface is over texels"}, 0
    if rest.any() or not plans:
        face_field[rest], told = choose_fields(scene, without_faces(surface, ~rest), colours, options, report)
        fields = int(face_field[rest].max(initial=-1)) + 1
    for number, plan in enumerate(plans, fields):
        face_field[plan.group.faces] = number
    return face_field, told


def _fill(prepared, names, colours, options, report):
    """Brings the source's values into the voxels of the first fields. names: by field, the channels that it has maps of;
    colours: of material_colours."""
    fields, source = prepared.fields[: len(names)], prepared.source
    for number, part in enumerate(fields):
        with report.stage("transfer", (number, len(fields))):
            colour = one_colour(colours, source.surface.material[source.face_field == number])
            transferred(part, source, number, options) if colour is None else filled(part, source, colour)
            fill_maps(part, source, number, names[number], options)
    if any("anisotropy" in mine for mine in names):
        report.warnings.append("directions of anisotropy mean nothing over voxels, which have no UVs: only its strength stays")
    with report.stage("refine"):
        prepared.choices["refinement"] = refine_fields(source, fields, options, report)


def code_prepared(prepared: Prepared, options: EncodeOptions, report: Report) -> Encoded:
    """Codes the attributes at options.qp and writes the stream: as encode_scene."""
    source, fields, choices = prepared.source, prepared.fields, dict(prepared.choices)
    scene, surface = source.scene, source.surface
    stream = Stream(header_values(prepared.materials, surface, prepared.geometry, len(fields), source.groups))
    rules = prepared.shading.rules
    stream.geometry = prepared.geometry
    stream.materials = [material_values(m, rule) for m, rule in zip(prepared.materials, rules, strict=True)]
    stream.sharp_edges = prepared.shading.values
    stream.fields = [field_values(i, part.support, part.threshold) for i, part in enumerate(fields)]
    stream.metadata = metadata_bytes(scene.metadata | _samplers(prepared), options, report)
    codec, reconstruction = codec_of(options.codec), hashlib.sha256()
    decoded = _code_jointly if codec.joint else _code_planes
    values = decoded(codec, stream, prepared, options, report, choices)
    for part, planes in zip(fields, values, strict=True):
        for plane in planes.values():
            reconstruction.update(np.ascontiguousarray(part.support.keys, "<i8").data)
            reconstruction.update(np.ascontiguousarray(plane).data)
    with report.stage("write"):
        data, sizes = write_stream(stream)
    _name_collapsed(scene, surface, report)
    face_field = np.full(len(scene.faces), -1, np.int64)
    face_field[surface.origin_face] = source.face_field
    texels = sum(len(part.support) for part in fields if part.support.planar)
    counts = {"fields": len(fields), "voxels": sum(len(part.support) for part in fields) - texels, "texels": texels,
              "faces": stream.header["num_faces"], "vertices": stream.header["num_vertices"]}
    return Encoded(data=data, sizes={"total": len(data), **sizes}, counts=counts, face_field=face_field,
                   choices=json_ready(choices), resolution=prepared.resolution, qp=options.qp,
                   reconstruction_sha256=reconstruction.hexdigest(), values=values,
                   texels_per_voxel_edge=max((part.texels_per_edge for part in fields), default=0.0))


def _samplers(prepared):
    """What metadata say of samplers, which the bitstream does not know: fields whose texels are squares of one colour."""
    squares = [number for number, part in enumerate(prepared.fields) if part.nearest]
    return {NEAREST_FIELDS: squares} if squares else {}


def _name_collapsed(scene, surface, report):
    """Remarks on faces of the scene that the lattice has no room for; those that name a vertex twice are the loader's."""
    a, b, c = scene.faces.T
    count = len(scene.faces) - len(surface.origin_face) - int(((a == b) | (b == c) | (c == a)).sum())
    if count > 0:
        share = 100 * count / len(scene.faces)
        text = (plural(count, "face", "faces") + f" of {len(scene.faces)} ({share:.2g} %) without area on the lattice of "
                f"{surface.cube.position_bits} bits: left out; more --position-bits may keep them")
        report.remarks += [text] * (text not in report.remarks)


def _code_planes(codec, stream, prepared, options, report, choices):
    """One attribute unit per field and channel: the decoded planes of each field, by channel name."""
    choices["channels"], out = [], []
    others = _bytes_of(stream.geometry)
    budgets = image_budgets(prepared.source, prepared.fields)
    for i, part in enumerate(prepared.fields):
        with report.stage("attributes", (i, len(prepared.fields))) as step:
            out.append({})
            for number, group in enumerate(prepared.source.groups):
                if any(channel.name in part.planes for channel in group.channels):
                    begin = time.perf_counter()
                    step(number, len(prepared.source.groups))
                    unit = _code_group(codec, stream, prepared, (i, number), options, others, budgets.get((i, number)))
                    stream.attributes.append(unit.values)
                    others += unit.bytes
                    out[i] |= group.split(unit.decoded)
                    told = {"field": i, "codec": unit.codec.name, "level_shift": unit.values["level_shift"],
                            "encode_ms": round(1000 * (time.perf_counter() - begin), 1), **unit.spending}
                    choices["channels"].append(told | errors_of(group, unit.plane, unit.decoded))
    return out


def _code_group(codec, stream, prepared, place, options, others, budget):
    """The CodedUnit of a channel group of a field. place: (field, group); others, budget: bytes, as of spend()."""
    part, group = prepared.fields[place[0]], prepared.source.groups[place[1]]
    plane, shift = joined(part, group)
    chosen, support = codec_for(plane, codec), part.support.coarser(shift)

    def code(options):
        values, decoded = chosen.enc(plane, support, options)
        values = attribute_values(chosen, *place, zlib.crc32(decoded), values, shift)
        size = len(chosen.write_parameters(values | attribute_variables(stream, values)))
        return CodedUnit(codec=chosen, values=values, bytes=size, plane=plane, decoded=decoded)

    if part.exact:
        return code(replace(options, qp=None, max_error=0))
    wanted = with_qp_of(group, options, prepared.source.scene.weights)
    return spend(code(wanted), code, wanted, others, budget)


def _code_jointly(codec, stream, prepared, options, report, choices):
    """One attribute unit for all fields and channels; what it decodes to at the voxels, as _code_planes."""
    source, out, total = prepared.source, [], 0
    if not prepared.fields:
        choices["refinement"] = {"asked": options.refine, "kind": "off", "reason": "there is no field"}
        return out
    made = codec.enc(source, options, report)
    choices |= made.choices
    for part, evaluator in zip(prepared.fields, made.evaluators, strict=True):
        values = evaluator.values(part.support, options.threads)
        total = zlib.crc32(values, total)
        out.append(split_groups(values, source.groups))
    stream.attributes.append(attribute_values(codec, 0, 0, total, made.values))
    return out


def _code_geometry(surface, face_field, plans, step=no_step):
    """One Draco unit per field and material: (syntax values, decoded GeometryUnits). plans: TexelPlan by field number."""
    values, units = [], []
    corner_uv = {number: plan.corner_uv() for number, plan in plans.items()}
    groups = face_field * (int(surface.material.max(initial=0)) + 1) + surface.material
    used = np.unique(groups)
    for done, group in enumerate(used):
        step(done, len(used))
        mine = np.flatnonzero(groups == group)
        number, material = int(face_field[mine[0]]), int(surface.material[mine[0]])
        code = _code_textured if number in plans else _code_plain
        uv = corner_uv[number][np.searchsorted(plans[number].group.faces, mine)] if number in plans else None
        made, decoded = code(surface, mine, uv)
        if len(decoded[1]) != len(mine):
            raise InputError("TXF-I62", "Draco changed the number of faces", value=len(decoded[1]), allowed=len(mine))
        values.append({"field_index": number, "material_index": material, "geometry_crc": geometry_crc(*decoded), **made})
        units.append(GeometryUnit(number, material, *decoded))
    return values, units


def _code_plain(surface, mine, _):
    """Syntax values of a unit of positions, and what it decodes to: (lattice, faces)."""
    bits = surface.cube.position_bits
    used, local = used_vertices(surface.faces[mine], len(surface.lattice))
    data = enc_geometry(surface.lattice[used], local, bits)
    counts = counts_of(data)
    return {"unit_vertices": counts[0], "unit_faces": counts[1], "draco_data": data}, dec_geometry(data, *counts, bits)


def _code_textured(surface, mine, uv):
    """As _code_plain with UVs int64 [F, 3, 2]: (lattice, faces, uv)."""
    bits, origin = surface.cube.position_bits, uv.min(axis=(0, 1))
    vertex, uv, faces = split_corners(surface.faces[mine], uv - origin)
    data, coding = enc_textured(surface.lattice[vertex], faces, uv, bits)
    counts = counts_of(data)
    lattice, faces, decoded = dec_textured(data, *counts, coding, bits)
    values = {"unit_vertices": counts[0], "unit_faces": counts[1], "uv_origin": origin.tolist(), "uv_bits": coding.bits,
              "uv_range": coding.range, "draco_data": data}
    return values, (lattice, faces, decoded + origin)
