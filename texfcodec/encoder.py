"""Mesh to stream: the whole pipeline on one page. decoder.py is its mirror image."""

import hashlib
import zlib
from dataclasses import dataclass, field

import numpy as np

from .asset.load.files import load
from .bitstream.stream import Stream, write_stream
from .bitstream.syntax import CODEC_3DNTC, CODEC_RAHT, FORM_RESIDENT, FORM_TRANSPORT, SEMANTIC_BASE_COLOUR
from .bitstream.values import header_values, material_values, metadata_bytes, raht_values
from .choose.prepare import SourceField, active_voxels, source_field
from .choose.trial import choose_fields
from .codecs.neural.fit import fit_payload
from .codecs.neural.infer import voxel_values
from .codecs.neural.payload import payload_values
from .codecs.raht.choice import choose_base_qp, choose_tools
from .codecs.raht.codec import enc_attributes
from .codecs.raht.coefficients.residual import ResidualPlan
from .codecs.raht.layout import octree_depth
from .codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from .decoder import field_surface, voxels_crc
from .errors import InputError, LimitError
from .geometry.draco import counts_of, dec_geometry, enc_geometry
from .geometry.surface import Surface, make_surface
from .options import EncodeOptions
from .refine.choice import refine_fields
from .report import Report
from .support.morton import decode_morton
from .texf import GeometryUnit


@dataclass
class Prepared:
    """All that does not depend on the QP. geometry: syntax values of the geometry units; face_field: int64 [F] over
    surface.faces."""

    surface: Surface
    face_field: np.ndarray
    geometry: list
    fields: list[SourceField]
    partition: dict  # which fields and why, for the report
    refinement: dict = field(default_factory=dict)  # likewise


def encode(mesh_or_path, options=None, report=None):
    """Codes a textured mesh.

    mesh_or_path: path of a .glb, .gltf, .obj or .ply file, a trimesh object or a Scene; options: EncodeOptions; report: Report
    that receives seconds by stage, warnings, dropped properties and byte counts. Returns the .texf stream as bytes.
    Raises InputError, LimitError, SupportError.
    """
    options, report = options or EncodeOptions(), report or Report()
    with report.stage("load"):
        scene = load(mesh_or_path, strict=options.strict)
    report.warnings += scene.warnings
    report.dropped += scene.dropped
    if options.target_bytes is not None or options.target_psnr is not None:
        from .search import encode_to_target

        return encode_to_target(scene, options, report)
    data, report.facts["bytes"] = encode_scene(scene, options, report)
    return data


def encode_scene(scene, options=None, report=None):
    """Codes a Scene. Returns (bytes, byte counts {"total", "geometry", "attributes", "other"}).

    options: EncodeOptions; report: Report. Raises InputError, LimitError, SupportError.
    """
    options, report = options or EncodeOptions(), report or Report()
    if options.codec == "3dntc":
        return _code_neural(scene, options, report)
    return code_prepared(scene, prepare(scene, options, report), options, report)


def _lay_out(scene, options, report):
    """Lattice, partition and geometry: (Prepared without fields, GeometryUnits as decoded)."""
    with report.stage("lattice"):
        surface = make_surface(scene, options)
    with report.stage("partition"):
        face_field = choose_fields(scene, surface, options, report)
    with report.stage("geometry"):
        geometry, units = _code_geometry(surface, face_field)
    return Prepared(surface, face_field, geometry, [], report.facts["partition"]), units


def prepare(scene, options, report):
    """Lattice, partition, geometry, voxels and transfer (Prepared); may be coded at several QPs."""
    prepared, units = _lay_out(scene, options, report)
    surface, face_field = prepared.surface, prepared.face_field
    for i in range(int(face_field.max(initial=-1)) + 1):
        prepared.fields.append(source_field(scene, surface, face_field == i, field_surface(units, i), options, report))
    voxels = sum(len(f.keys) for f in prepared.fields)
    if options.limits.voxels is not None and voxels > options.limits.voxels:
        raise LimitError("TXF-L04", "the fields have more voxels than the limit allows", value=voxels,
                         allowed=options.limits.voxels)
    with report.stage("refine"):
        refine_fields(scene, surface, face_field, prepared.fields, options, report)
    prepared.refinement = report.facts["refinement"]
    return prepared


def code_prepared(scene, prepared, options, report):
    """Codes the attributes at options.qp and writes the stream: as encode_scene."""
    surface, fields = prepared.surface, prepared.fields
    stream = Stream(header_values(scene, surface, prepared.geometry, len(fields)))
    stream.geometry, stream.materials = prepared.geometry, [material_values(m) for m in scene.materials]
    reconstruction = hashlib.sha256()  # keys and decoded values, group by group, as a decoder will have them
    for i, part in enumerate(fields):
        stream.fields.append({"field_index": i, "resolution": options.resolution, "area_threshold": part.threshold,
                              "num_voxels": len(part.keys), "voxels_crc": voxels_crc(part.keys)})
        with report.stage("attributes"):
            for k, group in enumerate(stream.header["channel_groups"]):
                plane = part.colour if group["group_semantic"] == SEMANTIC_BASE_COLOUR else part.alpha[:, None]
                values, decoded = _code_group(plane, part.keys, options)
                stream.attributes.append({"field_index": i, "group_index": k, **values})
                reconstruction.update(np.ascontiguousarray(part.keys, "<i8"))
                reconstruction.update(np.ascontiguousarray(decoded))
    report.facts["texels_per_voxel_edge"] = max((f.texels_per_edge for f in fields), default=0.0)
    return _write(stream, scene, prepared, reconstruction, options, report)


def _write(stream, scene, prepared, reconstruction, options, report):
    """The bytes of a Stream and their counts, and what the report tells of it. reconstruction: hash over what decodes."""
    stream.metadata = metadata_bytes(scene.metadata, options, report)
    with report.stage("write"):
        data, sizes = write_stream(stream)
    face_field = np.full(len(scene.faces), -1, np.int64)
    face_field[prepared.surface.origin_face] = prepared.face_field
    report.facts.update(fields=len(stream.fields), voxels=sum(f["num_voxels"] for f in stream.fields),
                        faces=stream.header["num_faces"], vertices=stream.header["num_vertices"], scene_face_field=face_field,
                        partition=prepared.partition, refinement=prepared.refinement,
                        reconstruction_sha256=reconstruction.hexdigest())
    return data, {"total": len(data), **sizes}


def _code_neural(scene, options, report):
    """As encode_scene, with one 3DNTC payload for all fields (clause 11)."""
    prepared, units = _lay_out(scene, options, report)
    surface, bits = prepared.surface, prepared.surface.cube.position_bits
    surfaces = [field_surface(units, i) for i in range(int(prepared.face_field.max(initial=-1)) + 1)]
    stream = Stream(header_values(scene, surface, prepared.geometry, len(surfaces)))
    stream.geometry, stream.materials = prepared.geometry, [material_values(m) for m in scene.materials]
    reconstruction, keys, total = hashlib.sha256(), [], 0
    with report.stage("voxelise"):
        for i, one in enumerate(surfaces):
            found, threshold = active_voxels(*one, bits, options)
            keys.append(found)
            stream.fields.append({"field_index": i, "resolution": options.resolution, "area_threshold": threshold,
                                  "num_voxels": len(found), "voxels_crc": voxels_crc(found)})
    if surfaces:
        components = sum(g["group_components"] for g in stream.header["channel_groups"])
        payload, tables = fit_payload(scene, surface, prepared.face_field, surfaces, components, options, report)
        for i, found in enumerate(keys):
            plane = voxel_values(decode_morton(found), options.resolution, tables[i], options.threads)
            total = zlib.crc32(plane, total)
            for channels in (slice(0, 3), slice(3, 4))[: 2 if components == 4 else 1]:
                reconstruction.update(np.ascontiguousarray(found, "<i8"))
                reconstruction.update(np.ascontiguousarray(plane[:, channels]))
        form = FORM_TRANSPORT if options.transport else FORM_RESIDENT
        stream.attributes.append({"field_index": 0, "group_index": 0, "codec_id": CODEC_3DNTC, "values_crc": total,
                                  **payload_values(payload, form)})
    prepared.refinement = report.facts.get("refinement", {"asked": options.refine, "kind": "off", "reason": "there is no field"})
    return _write(stream, scene, prepared, reconstruction, options, report)


def _code_geometry(surface, face_field):
    """One Draco unit per field and material: (syntax values, decoded GeometryUnits)."""
    values, units = [], []
    groups = face_field * (int(surface.material.max(initial=0)) + 1) + surface.material
    for group in np.unique(groups):
        mine = np.flatnonzero(groups == group)
        used, local = np.unique(surface.faces[mine], return_inverse=True)
        data = enc_geometry(surface.lattice[used], local.reshape(-1, 3), surface.cube.position_bits)
        number, material = int(face_field[mine[0]]), int(surface.material[mine[0]])
        lattice, faces = dec_geometry(data, *counts_of(data), surface.cube.position_bits)
        if len(faces) != len(mine):
            raise InputError("TXF-I62", "Draco changed the number of faces", value=len(faces), allowed=len(mine))
        values.append({"field_index": number, "material_index": material, "unit_vertices": len(lattice), "unit_faces": len(faces),
                       "draco_data": data})
        units.append(GeometryUnit(number, material, lattice, faces))
    return values, units


def _code_group(plane, keys, options):
    """Syntax values of one attribute unit and what decodes from it, uint8 [N, C]. plane: float32 [N, C] in 0..255; keys: int64
    [N]."""
    if options.max_error is not None:
        return _code_bounded(plane, keys, options)
    colour, depth = plane.shape[1] == 3, octree_depth(options.resolution)
    values, qp = forward_colour(plane) if colour else forward_plain(np.rint(plane)), _qp_of(options.qp, plane.shape[1], options)
    tools = choose_tools(keys, depth, values, qp, options.effort, options.threads)
    coded, means = enc_attributes(keys, depth, values, qp, tools, options.threads)
    decoded = inverse_colour(means) if colour else inverse_plain(means)
    return {"codec_id": CODEC_RAHT, "values_crc": zlib.crc32(decoded), **raht_values(coded, colour)}, decoded


def _code_bounded(plane, keys, options):
    """As _code_group, with no rounded value further off than options.max_error."""
    colour, depth = plane.shape[1] == 3, octree_depth(options.resolution)
    original = np.clip(np.rint(plane), 0, 255).astype(np.uint8)
    values = forward_colour(original) if colour else forward_plain(original)
    plan = ResidualPlan(options.max_error, original, inverse_colour if colour else inverse_plain)
    qp = choose_base_qp(keys, depth, values, lambda qp: _qp_of(qp, plane.shape[1], options), plan, options.effort,
                        options.threads)
    tools = choose_tools(keys, depth, values, qp, options.effort, options.threads)
    coded, decoded = enc_attributes(keys, depth, values, qp, tools, options.threads, plan)
    return {"codec_id": CODEC_RAHT, "values_crc": zlib.crc32(decoded), **raht_values(coded, colour)}, decoded


def _qp_of(qp, components, options):
    return [min(max(qp + (options.chroma_qp_offset if c else 0), 0), 63) for c in range(components)]
