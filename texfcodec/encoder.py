"""Mesh to stream: the whole pipeline on one page. decoder.py is its mirror image."""

import json
import zlib
from dataclasses import dataclass

import numpy as np

from .asset.load import load
from .asset.sample import pack_source
from .asset.scene import ALPHA_MASK, ALPHA_OPAQUE
from .attribute.choice import choose_kernel
from .attribute.codec import enc_attributes
from .attribute.colour import TRANSFORM_BT709, TRANSFORM_NONE, forward_colour, forward_plain, inverse_colour, inverse_plain
from .attribute.layout import octree_depth
from .bitstream.stream import Stream, write_stream
from .bitstream.syntax import CODEC_RAHT, SEMANTIC_ALPHA, SEMANTIC_BASE_COLOUR, TRANSFER_LINEAR, TRANSFER_SRGB, VERSION
from .decoder import field_surface, voxels_crc
from .errors import InputError, LimitError
from .field.grid import build_brick_map
from .field.transfer import transfer, useful_density
from .field.trial import choose_fields
from .field.voxelise import count_samples, voxelise
from .geometry.canonical import CanonicalCube, fit_cube
from .geometry.draco import dec_geometry, enc_geometry
from .options import EncodeOptions
from .report import Report
from .texf import GeometryUnit

# Most samples per voxel edge of the transfer, by effort: 3 saves 1.2 % of the bits over 2, 4 saves 2 %, 6 saves 2.2 % (bball_0001)
TRANSFER_DENSITY = {"fast": 2, "balanced": 4, "best": 6}
LEVEL_INDEX_BYTES = 4096  # smaller attribute units do without their per-level byte counts


@dataclass
class Surface:
    """The source on its lattice. cube; lattice: int64 [V, 3], no two alike; faces: int64 [F, 3], three different corners each;
    origin_face: int64 [F] into the scene's faces; material: int64 [F]."""

    cube: CanonicalCube
    lattice: np.ndarray
    faces: np.ndarray
    origin_face: np.ndarray
    material: np.ndarray


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
    data, report.facts["bytes"] = encode_scene(scene, options, report)
    return data


def encode_scene(scene, options=None, report=None):
    """Codes a Scene. Returns (bytes, byte counts {"total", "geometry", "attributes", "other"}).

    options: EncodeOptions; report: Report. Raises InputError, LimitError, SupportError.
    """
    options, report = options or EncodeOptions(), report or Report()
    with report.stage("lattice"):
        surface = make_surface(scene, options)
    with report.stage("partition"):
        face_field = choose_fields(scene, surface, options, report)
        report.facts["scene_face_field"] = np.full(len(scene.faces), -1, np.int64)
        report.facts["scene_face_field"][surface.origin_face] = face_field
    with report.stage("geometry"):
        geometry, units = _code_geometry(surface, face_field)
    stream = Stream(_header(scene, surface, geometry, face_field))
    stream.geometry, stream.materials = geometry, [_material_values(m) for m in scene.materials]
    for i in range(stream.header["num_fields"]):
        _code_field(i, stream, surface, face_field == i, units, scene, options, report)
    stream.metadata = _metadata_bytes(scene.metadata, options, report)
    with report.stage("write"):
        data, sizes = write_stream(stream)
    report.facts.update(fields=stream.header["num_fields"], voxels=sum(f["num_voxels"] for f in stream.fields),
                        faces=stream.header["num_faces"], vertices=stream.header["num_vertices"])
    return data, {"total": len(data), **sizes}


def make_surface(scene, options):
    """Puts the scene on the lattice, merges equal positions and leaves out faces that have lost a corner (Surface)."""
    limits = options.limits
    for code, what, count, limit in (("TXF-L02", "vertices", len(scene.positions), limits.vertices),
                                     ("TXF-L03", "faces", len(scene.faces), limits.faces)):
        if limit is not None and count > limit:
            raise LimitError(code, f"the mesh has more {what} than the limit allows", value=count, allowed=limit)
    cube = fit_cube(scene.positions, options.position_bits)
    points = cube.to_lattice(scene.positions)
    packed = points[:, 0] | (points[:, 1] << 20) | (points[:, 2] << 40)
    unique, place = np.unique(packed, return_inverse=True)
    lattice = np.stack([(unique >> shift) & 0xFFFFF for shift in (0, 20, 40)], axis=1)
    faces = place.reshape(-1)[scene.faces]
    keep = np.flatnonzero((faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0]))
    if len(keep) == 0 and not options.allow_empty:
        raise InputError("TXF-I63", "every face is degenerate: no three corners are apart", value=len(faces))
    return Surface(cube, lattice, faces[keep], keep, np.asarray(scene.face_material)[keep])


def _code_geometry(surface, face_field):
    """One Draco unit per field and material: (syntax values, decoded GeometryUnits)."""
    values, units = [], []
    groups = face_field * (int(surface.material.max(initial=0)) + 1) + surface.material
    for group in np.unique(groups):
        mine = np.flatnonzero(groups == group)
        used, local = np.unique(surface.faces[mine], return_inverse=True)
        data = enc_geometry(surface.lattice[used], local.reshape(-1, 3), surface.cube.position_bits)
        number, material = int(face_field[mine[0]]), int(surface.material[mine[0]])
        lattice, faces = _decode_own(data, surface.cube.position_bits)
        if len(faces) != len(mine):
            raise InputError("TXF-I62", "Draco changed the number of faces", value=len(faces), allowed=len(mine))
        values.append({"field_index": number, "material_index": material, "unit_vertices": len(lattice), "unit_faces": len(faces),
                       "draco_data": data})
        units.append(GeometryUnit(number, material, lattice, faces))
    return values, units


def _decode_own(data, position_bits):
    """Decodes what enc_geometry made; only Draco knows how many vertices it made of ours."""
    import DracoPy

    mesh = DracoPy.decode(data)
    return dec_geometry(data, len(mesh.points), len(mesh.faces), position_bits)


def _header(scene, surface, geometry, face_field):
    groups = [{"group_semantic": SEMANTIC_BASE_COLOUR, "group_transfer": TRANSFER_SRGB, "group_components": 3}]
    if any(scene.materials[m].alpha_mode != ALPHA_OPAQUE for m in np.unique(surface.material)):
        groups.append({"group_semantic": SEMANTIC_ALPHA, "group_transfer": TRANSFER_LINEAR, "group_components": 1})
    return {
        "version": VERSION, "position_bits": surface.cube.position_bits, "origin": surface.cube.origin, "side": surface.cube.side,
        "num_vertices": sum(g["unit_vertices"] for g in geometry), "num_faces": len(surface.faces),
        "num_materials": len(scene.materials), "num_fields": int(face_field.max(initial=-1)) + 1,
        "num_geometry_units": len(geometry), "num_channel_groups": len(groups), "channel_groups": groups,
    }


def _material_values(material):
    name = material.name.encode("utf-8", "replace")[:65535].decode("utf-8", "ignore")
    return {"name_length": len(name.encode("utf-8")), "material_name": name, "alpha_mode": material.alpha_mode,
            "alpha_cutoff": round(min(max(material.alpha_cutoff, 0.0), 1.0) * 65535) if material.alpha_mode == ALPHA_MASK else None,
            "material_flags": int(material.double_sided) | int(material.unlit) << 1}


def _metadata_bytes(metadata, options, report):
    if not metadata:
        return None
    raw = json.dumps(metadata, ensure_ascii=False, separators=(",", ":"), sort_keys=True).encode("utf-8", "replace")
    if options.limits.metadata_bytes is not None and len(raw) > options.limits.metadata_bytes:
        report.warnings.append(f"metadata of {len(raw)} bytes are over the limit and were left out")
        report.dropped.append("metadata")
        return None
    return raw


def _code_field(number, stream, surface, mine, units, scene, options, report):
    """Voxelises, transfers and codes one field; appends its field unit and attribute units to the stream."""
    bits, limits = surface.cube.position_bits, options.limits
    with report.stage("voxelise"):
        field = make_field(units, number, bits, options)
    values = {"field_index": number, "resolution": options.resolution, "area_threshold": field.threshold,
              "num_voxels": len(field.keys), "voxels_crc": voxels_crc(field.keys)}
    stream.fields.append(values)
    if limits.voxels is not None and sum(f["num_voxels"] for f in stream.fields) > limits.voxels:
        raise LimitError("TXF-L04", "the fields have more voxels than the limit allows", allowed=limits.voxels)
    with report.stage("transfer"):
        source = pack_source(scene, surface.origin_face[mine])
        textured = (surface.lattice, surface.faces[mine], source, bits, options.resolution)
        density = useful_density(*textured, most=TRANSFER_DENSITY[options.effort])
        colour, alpha = transfer(*textured, field.keys, build_brick_map(field.keys), density, options.threads)
    with report.stage("attributes"):
        for i, group in enumerate(stream.header["channel_groups"]):
            plane = colour if group["group_semantic"] == SEMANTIC_BASE_COLOUR else alpha[:, None]
            stream.attributes.append(_code_group(number, i, plane, field.keys, options))


@dataclass
class VoxelSet:
    """keys: int64 [N] ascending; threshold: the area threshold they were kept by."""

    keys: np.ndarray
    threshold: int


def make_field(units, number, position_bits, options):
    """Voxelises one field and picks its area threshold: the configured one, unless it would leave parts uncovered."""
    lattice, faces = field_surface(units, number)
    total = count_samples(lattice, faces, position_bits, options.resolution)
    if options.limits.samples is not None and total > options.limits.samples:
        raise LimitError("TXF-L05", "the surface needs more samples than the limit allows", value=total,
                         allowed=options.limits.samples)
    keys, weights = voxelise(lattice, faces, position_bits, options.resolution, 0, options.threads, options.limits.voxels)
    threshold = options.area_threshold
    keep = weights >= threshold << 24
    if weights[~keep].sum(dtype=np.float64) > 0.1 * weights.sum(dtype=np.float64) or not keep.any():
        return VoxelSet(keys, 0)
    return VoxelSet(keys[keep], threshold)


def _code_group(number, index, plane, keys, options):
    """One attribute unit: values float32 [N, C] in 0..255 of channel group `index`."""
    colour = plane.shape[1] == 3
    qp = [min(max(options.qp + (options.chroma_qp_offset if c else 0), 0), 63) for c in range(plane.shape[1])]
    values = forward_colour(plane) if colour else forward_plain(np.rint(plane))
    depth = octree_depth(options.resolution)
    kernel = choose_kernel(keys, depth, values, qp, options.effort)
    coded, means = enc_attributes(keys, depth, values, qp, kernel, options.threads)
    decoded = inverse_colour(means) if colour else inverse_plain(means)
    return {"field_index": number, "group_index": index, "codec_id": CODEC_RAHT, "values_crc": zlib.crc32(decoded),
            **raht_values(coded, colour)}


def raht_values(coded, colour):
    """Syntax values of raht_parameters (spec 5.7.1) for CodedAttributes; colour: whether the BT.709 transform was used."""
    lengths = [len(c) for c in coded.codewords]
    return {
        "colour_transform": TRANSFORM_BT709 if colour else TRANSFORM_NONE, "qp": coded.qp, "kernel": coded.kernel,
        "root_mean": coded.root, "slice_level": coded.slice_level, "num_slices": len(coded.slice_first),
        "slice_step": np.diff(coded.slice_first).tolist(), "level_index": int(sum(lengths) >= LEVEL_INDEX_BYTES),
        "codewords": [{"codeword_length": n, "level_bytes": b} for n, b in zip(lengths, coded.level_bytes, strict=True)],
        "codeword_data": b"".join(coded.codewords),
    }
