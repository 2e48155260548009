"""The good conformance vectors: small scenes through the encoder, and streams that our encoder does not write, made here."""

import zlib
from unittest.mock import patch

import numpy as np

from conformance.make.scenes import many_materials, noise_sheet, ribbon, scene_of, torus, triangle, two_sheets
from texfcodec import EncodeOptions, Limits, decode
from texfcodec.bitstream.stream import cells_a_side, read_stream, write_stream
from texfcodec.bitstream.syntax import SIGNATURE, UNIT_END, UNIT_METADATA
from texfcodec.bitstream.units import read_units, write_unit
from texfcodec.codecs.raht import attribute_coder
from texfcodec.codecs.raht.coefficients.residual import ResidualPlan
from texfcodec.codecs.raht.raht_syntax import TRANSFORM_BT709
from texfcodec.codecs.raht.raht_values import coded_of, raht_values
from texfcodec.codecs.raht.transform.colour import forward_colour, forward_plain, inverse_colour, inverse_plain
from texfcodec.encoder.encode import encode_scene
from texfcodec.field.extents import octree_depth
from texfcodec.field.voxelise import voxelise
from texfcodec.geometry.checksum import geometry_crc
from texfcodec.geometry.draco import UvCoding, dec_geometry, dec_textured
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, Material

KERNEL = (64, 24, 1, 0, 32, 8, 0)


# Coding


def encoded(scene, **choices):
    """The scene's stream. choices: EncodeOptions."""
    usual = {"threads": 1, "support": "voxels", "partition": "off", "effort": "fast", "refine": "off"}
    options = EncodeOptions(**(usual | choices))
    return encode_scene(scene, options).data


def with_checksum(unit):
    """Syntax values of a geometry unit with the geometry_crc of what it decodes to."""
    data, counts = bytes(unit["draco_data"]), (unit["unit_vertices"], unit["unit_faces"])
    if unit.get("uv_origin"):
        lattice, faces, uv = dec_textured(data, *counts, UvCoding(unit["uv_bits"], unit["uv_range"] or 1), 20)
        return unit | {"geometry_crc": geometry_crc(lattice, faces, uv + unit["uv_origin"])}
    return unit | {"geometry_crc": geometry_crc(*dec_geometry(data, *counts, 20))}


def parsed(data):
    """Stream (values by name) of a stream's bytes."""
    return read_stream(data, Limits())


def written(stream):
    """Bytes of a Stream."""
    return write_stream(stream)[0]


def units_of(data):
    """(type, payload) of every unit, the end unit included."""
    units = sorted((unit for kind in read_units(data) for unit in kind), key=lambda unit: unit.start)
    return [(unit.type, data[unit.begin : unit.end]) for unit in units] + [(UNIT_END, b"")]


def stream_of(units):
    """Signature and units with correct lengths and checksums."""
    return SIGNATURE + b"".join(write_unit(unit_type, payload) for unit_type, payload in units)


def plane_keys(unit, keys):
    """Keys of what an attribute unit has values of. keys: of its field."""
    return np.unique(keys >> 3 * unit["level_shift"])


def values_of(unit, keys):
    """Decoded values of an attribute unit whatever its values_crc says: uint8 [n, C]. keys: of its field."""
    keys = plane_keys(unit, keys)
    coded, spans = coded_of(unit)
    data = np.frombuffer(bytes(unit["codeword_data"]), np.uint8)
    inverse = inverse_colour if unit["colour_transform"] == TRANSFORM_BT709 else inverse_plain
    return attribute_coder.dec_attributes(keys, unit["Depth"], coded, data, spans, unit["Depth"], inverse=inverse)


def raht(values, keys, resolution, qp, kernel=KERNEL, plain=False, index=False, slices=None, max_error=None, **tools):
    """Attribute elements for values uint8 [N, C]. plain: no colour transform; index: with level_bytes; slices: what is to hold in
    codec while it plans them; max_error: with residuals; tools: further ones of attribute_coder.Tools."""
    colour = values.shape[1] == 3 and not plain
    inverse = inverse_colour if colour else inverse_plain
    plan = None if max_error is None else ResidualPlan(max_error, values, inverse)
    means = (forward_colour if colour else forward_plain)(values.astype(np.float32))
    with patch.multiple(attribute_coder, **(slices or {"SLICE_VOXELS": 1 << 18})):
        tools = attribute_coder.Tools(kernel, **tools)
        coded, coefficients = attribute_coder.enc_attributes(keys, octree_depth(resolution), means, qp, tools, plan=plan)
    return {
        "values_crc": zlib.crc32(inverse(coefficients) if plan is None else coefficients),
        **raht_values(coded, colour), "level_index": int(index),
    }


def recoded(data, **choices):
    """The stream with its attribute units coded anew (raht), from the values that they decode to; planar where they were."""
    stream, fields = parsed(data), decode(data).fields
    for unit in stream.attributes:
        number, keys = unit["field_index"], fields[unit["field_index"]].keys
        tools = {"planar": unit["Planar"], **choices}
        cells = -(-cells_a_side(stream.fields[number]) >> unit["level_shift"])
        unit.update(raht(values_of(unit, keys), plane_keys(unit, keys), cells, unit["qp"], **tools))
    return written(stream)


def split_by_material(data):
    """The stream of one field with a field for every geometry unit, each with the values of the old one."""
    stream, texf = parsed(data), decode(data)
    (old,), bits = stream.fields, texf.cube.position_bits
    rank = {key: i for i, key in enumerate(texf.fields[0].keys.tolist())}
    values, units = [values_of(unit, texf.fields[0].keys) for unit in stream.attributes], stream.attributes
    stream.fields, stream.attributes = [], []
    for i, geometry in enumerate(texf.units):
        keys, _ = voxelise(geometry.lattice, geometry.faces, bits, old["resolution"], old["area_threshold"])
        own_rows = [rank[key] for key in keys.tolist()]
        stream.geometry[i]["field_index"] = i
        stream.fields.append(old | {"field_index": i, "num_keys": len(keys), "keys_crc": zlib.crc32(keys.astype("<i8"))})
        for unit, plane in zip(units, values, strict=True):
            stream.attributes.append(unit | {"field_index": i} | raht(plane[own_rows], keys, old["resolution"], unit["qp"]))
    stream.header["num_fields"] = len(texf.units)
    return written(stream)


# Streams that the encoder does not write


def one_voxel():
    """K = 1: the values are root_mean, there is no codeword."""
    stream = parsed(encoded(scene_of(*torus(8, 5)), resolution=2, qp=30))
    keys = np.zeros(1, np.int64)
    (values,), (unit,) = stream.fields, stream.attributes
    values.update(resolution=1, num_keys=1, keys_crc=zlib.crc32(keys.astype("<i8")))
    unit.update(residual=0, residual_cross=[], codewords=[], codeword_data=b"",
                values_crc=zlib.crc32(inverse_colour(np.array([unit["root_mean"]], np.int32))))
    return written(stream)


def with_codeword(data, codeword, qp):
    """The stream of one field and group with another codeword, and the values_crc that goes with it."""
    stream = parsed(data)
    (unit,) = stream.attributes
    unit.update(qp=qp, codewords=[{"codeword_length": len(codeword), "level_bytes": []}], codeword_data=codeword)
    unit["values_crc"] = zlib.crc32(values_of(unit, decode(data).fields[0].keys))
    return written(stream)


def random_codewords():
    """Codewords that no encoder made, by name; all bytes zero means that every bit is a one and every coefficient the largest."""
    noise = np.random.default_rng(11).integers(0, 256, 24000, np.uint8)
    noise[0] &= 0x7F
    sheet = recoded(encoded(noise_sheet(), resolution=24, qp=40))
    ring = recoded(encoded(scene_of(*torus()), resolution=40, qp=40))
    mixed = recoded(encoded(noise_sheet(), resolution=24, qp=40), models=8, colour_range=4, filters=1)
    bounded = recoded(encoded(noise_sheet(), resolution=24, qp=40), models=8, max_error=0)
    small = recoded(encoded(noise_sheet(), resolution=8, qp=40), models=8, max_error=1)
    return {"residuals": with_codeword(bounded, noise[:6000].tobytes(), [40, 50, 40]),
            "residuals_zeros": with_codeword(small, bytes(2000) + noise[:2000].tobytes(), [40, 50, 40]),
            "mixed": with_codeword(mixed, noise[:6000].tobytes(), [40, 50, 40]),
            "mixed_zeros": with_codeword(mixed, bytes(40) + noise[:3000].tobytes(), [63, 50, 20]),
            "random": with_codeword(sheet, noise[:6000].tobytes(), [63, 50, 63]),
            "random_large": with_codeword(ring, noise.tobytes(), [50, 50, 50]),
            "zeros_random": with_codeword(sheet, bytes(21) + noise[:3000].tobytes(), [10, 63, 20]),
            "ones_random": with_codeword(sheet, b"\xff" * 4 + b"\x80" + noise[:3000].tobytes(), [40, 50, 30]),
            "empty": with_codeword(sheet, b"", [63, 0, 63])}


def mixed_resolutions():
    """Two fields of different K; the second field's geometry comes first."""
    fine, coarse = (parsed(split_by_material(encoded(two_sheets(), resolution=k, qp=30))) for k in (21, 12))
    fine.fields[1], fine.attributes[1] = coarse.fields[1], coarse.attributes[1]
    fine.geometry.reverse()
    return written(fine)


def alpha_first():
    """The alpha group before the colour group."""
    stream = parsed(encoded(scene_of(*torus(12, 6), [Material("veil", alpha_mode=ALPHA_BLEND)]), resolution=18, qp=34))
    stream.header["channel_groups"].reverse()
    colour, alpha = stream.attributes
    colour["group_index"], alpha["group_index"] = 1, 0
    stream.attributes = [alpha, colour]
    return written(stream)


def with_strange_units():
    """Ancillary units of unknown types, one of them empty, and metadata before the materials."""
    units = units_of(encoded(scene_of(*torus(12, 6)), resolution=14, qp=36))
    metadata = (UNIT_METADATA, b"\0" + '{"name":"Würfel"}'.encode())
    return stream_of([units[0], metadata, (200, b"what a later version has to say"), *units[1:3], (199, b""), *units[3:-1],
                      (255, bytes(range(256))), units[-1]])


def with_other_metadata():
    """A metadata unit of a format that nobody knows, not JSON and not UTF-8."""
    units = units_of(encoded(scene_of(*torus(12, 6)), resolution=14, qp=36))
    return stream_of([*units[:-1], (UNIT_METADATA, b"\1" + bytes(range(255, 245, -1))), units[-1]])


def on_voxel_boundaries():
    """B = 8, K = 64: a closed box and two inner walls with all vertices on voxel corners, which are multiples of 4."""
    box = np.array([[x, y, z] for x in (0, 128) for y in (0, 64) for z in (0, 252)], np.float64)
    walls = np.array([[64, 0, 0], [64, 64, 0], [64, 64, 252], [0, 32, 128], [128, 32, 128], [128, 64, 128]], np.float64)
    corner = np.array([[255, 255, 255], [255, 251, 255], [251, 255, 255]], np.float64)  # makes the cube 0..255
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
             [1, 5, 7], [1, 7, 3], [8, 9, 10], [11, 12, 13], [14, 15, 16]]
    positions = np.concatenate([box, walls, corner])
    colours = np.column_stack([positions / 255, np.ones(len(positions))]).astype(np.float32)
    return encoded(scene_of(positions, np.array(faces), colours), resolution=64, qp=40, position_bits=8)


def of_triangles(corners, resolution=16, qp=40, **choices):
    """The stream, B = 20, of triangles that share no corner and reach both ends of the lattice. With K = 16 a grid coordinate is
    the lattice position."""
    positions = np.array(corners, np.float64).reshape(-1, 3)
    colours = np.column_stack([positions / ((1 << 20) - 1), np.ones(len(positions))]).astype(np.float32)
    scene = scene_of(positions, np.arange(len(positions)).reshape(-1, 3), colours)
    return encoded(scene, resolution=resolution, qp=qp, position_bits=20, **choices)


def exact_areas():
    """B = 20, K = 16: areas and heights that lie exactly on a limit.

    A triangle whose height is one over a multiple of half a voxel (6.2), one that fills exactly 32/256 of a face (6.4), two with
    a little less and a little more, and one that spans the cube.
    """
    last, half = (1 << 20) - 1, 1 << 15
    base, height = 1023 << 10, 31 * half + 1
    small = lambda x, long, high: [[x, 40000, 900000], [x + long, 40000, 900000], [x, 40000 + high, 900000]]
    corners = [[[0, 0, 700], [base, 0, 700], [5, height, 700]], small(70000, half, half), small(140000, half, half - 1),
               small(210000, half - 1, half + 1), [[0, last, 0], [last, last, last], [last - 9, last, last]]]
    return of_triangles(corners, qp=30, area_threshold=32)


def flat_ring():
    """One colour but for a few spots: contexts that have seen thousands of zeros."""
    positions, faces, colours = torus(24, 12)
    colours[np.arange(len(colours)) % 61 > 0] = 0.4
    return encoded(scene_of(positions, faces, colours), resolution=128, qp=16)


def needle():
    """The largest grid there is, crossed by a triangle of next to no area: B = 20, K = 8192."""
    line = np.array([[0, 0, 0], [1, 0.002, 0.001], [0.5, 0.001, 0.0005]])
    colours = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]], np.float32)
    return encoded(scene_of(line, np.array([[0, 1, 2]]), colours), resolution=8192, qp=46, position_bits=20)


def point_triangle():
    """B = 20, K = 8: a large triangle and one whose corners are the same grid coordinate, so that its Base is 0 (6.2)."""
    last = (1 << 20) - 1
    corners = [[[0, 0, 0], [last, last, 0], [0, last, last]], [[900000, 2, 2], [900001, 2, 2], [900000, 3, 2]]]
    return of_triangles(corners, 8, 30, area_threshold=0)


def fan():
    """Five triangles on one edge: not a manifold, Draco makes more vertices of it."""
    angle = np.arange(5) * 1.1
    rim = np.stack([np.cos(angle), np.sin(angle), 0.2 * angle], 1)
    positions = np.concatenate([[[0, 0, -1], [0, 0, 1]], rim])
    colours = np.column_stack([np.abs(positions) / 2, np.ones(7)]).astype(np.float32)
    return encoded(scene_of(positions, np.array([[0, 1, i] for i in range(2, 7)]), colours), resolution=20, qp=28)


def empty():
    """Every face has lost a corner: no geometry, no field."""
    scene = scene_of(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.ones((3, 4), np.float32))
    return encoded(scene, resolution=16, qp=30, allow_empty=True)


def subset():
    """What the encoder writes every day."""
    everyday = scene_of(*torus())
    mask = [Material("leaf", alpha_mode=ALPHA_MASK, alpha_cutoff=0.3), Material("bark")]
    half = np.repeat([0, 1], len(everyday.faces) // 2)
    return [
        ("k2", [("K = {}", 2), "a single block"], ("7.2",), encoded(everyday, resolution=2, qp=30), (0, 1, 3)),
        ("k3", [("K = {}", 3), "no power of two"], ("6.3", "8.3"), encoded(everyday, resolution=3, qp=30), (0, 1, 2)),
        ("k33", [("K = {}", 33), "all levels of detail"], ("7.2", "8.3"), encoded(everyday, resolution=33, qp=22),
         (*range(8), 13)),
        ("k100", [("K = {}", 100)], ("6.3", "7.5.1"), encoded(everyday, resolution=100, qp=46), (0, 2)),
        ("k256", [("K = {}", 256), "a ribbon"], ("6.2",), encoded(scene_of(*ribbon()), resolution=256, qp=34), (0, 1)),
        ("qp0", ["the smallest step"], ("7.4.2",), encoded(everyday, resolution=20, qp=0), (0,)),
        ("qp63", ["the largest step"], ("7.4.2",), encoded(everyday, resolution=20, qp=63), (0,)),
        ("noise_qp0", ["the smallest step", "long magnitudes", "clipped values"], ("7.5.4", "7.8.2"),
         encoded(noise_sheet(), resolution=48, qp=0), (0, 1)),
        ("one_triangle", ["one triangle"], ("6.2", "6.3"), encoded(scene_of(*triangle()), resolution=48, qp=28), (0,)),
        ("threshold0", [("area_threshold {} keeps every touched voxel", 0)], ("6.4",),
         encoded(everyday, resolution=16, qp=36, area_threshold=0), (0,)),
        ("threshold77", [("area_threshold {} drops some", 77)], ("6.4",),
         encoded(everyday, resolution=16, qp=36, area_threshold=77), (0,)),
        ("materials", ["five materials in one field"], ("5.4.1", "5.6"), encoded(many_materials(), resolution=22, qp=34), (0,)),
        ("two_fields", ["two fields", "one inside the other"], ("5.5", "5.7"),
         split_by_material(encoded(two_sheets(), resolution=21, qp=30)), (0, 2)),
        ("alpha_mask", ["alpha group for a MASK material beside an opaque one"], ("5.3.1", "5.4.1", "7.8.1"),
         encoded(scene_of(*torus(), mask, half), resolution=20, qp=30), (0, 1)),
        ("alpha_blend", ["alpha group for a BLEND material"], ("5.3.1", "7.8.1"),
         encoded(scene_of(*torus(), [Material("veil", alpha_mode=ALPHA_BLEND)]), resolution=20, qp=22), (0,)),
        ("metadata", ["a metadata unit"], ("5.8",),
         encoded(scene_of(*torus(), metadata={"copyright": "none", "extras": {"ü": [1, 2.5]}}), resolution=12, qp=40), (0,)),
    ]


def uncommon():
    """What a decoder meets seldom, and what only another encoder would write."""
    everyday, random = scene_of(*torus()), random_codewords()
    veil = scene_of(*torus(), [Material("veil", alpha_mode=ALPHA_BLEND)])
    slices, one_slice = {"WHOLE_VOXELS": 1, "SLICE_VOXELS": 300, "SLICE_NODES": 40}, {"_plan_slices": lambda levels, _: (2, [0])}
    huge = scene_of(torus()[0] * 1e140 + np.array([9e141, -3e140, 0]), *torus()[1:])
    tiny = scene_of(torus()[0] * 1e-280, *torus()[1:])
    return [
        ("one_voxel", [("K = {}", 1), "no level", "no codeword"], ("5.7.1", "7.8.2", "8.3"), one_voxel(), (0, 1)),
        ("empty", ["an empty mesh"], ("5.3",), empty(), (0,)),
        ("slices", ["slices with the level index"], ("5.7.1", "5.7.2", "7.2"),
         recoded(encoded(everyday, resolution=33, qp=24), slices=slices, index=True), tuple(range(8))),
        ("slices_two_groups", ["slices of colour and alpha"], ("5.7.1", "7.2"),
         recoded(encoded(veil, resolution=30, qp=30), slices=slices), (0, 2)),
        ("one_slice", ["a trunk with a single slice"], ("5.7.1", "7.2"),
         recoded(encoded(everyday, resolution=20, qp=30), slices=one_slice), (0, 2, 3)),
        ("level_index", ["the level index without slices"], ("5.7.2",),
         recoded(encoded(everyday, resolution=16, qp=30), index=True), (0,)),
        ("kernel", ["another prediction kernel", "one weight 0"], ("7.3",),
         recoded(encoded(everyday, resolution=24, qp=26), kernel=(1, 255, 17, 3, 200, 0, 99)), (0,)),
        ("direct", ["direct contexts"], ("7.5.2", "7.5.3"), recoded(encoded(everyday, resolution=33, qp=24)), (0, 1)),
        ("one_model", ["a single model", "no colour range", "no filter"], ("7.5.5", "7.6.4"),
         recoded(encoded(everyday, resolution=24, qp=24), models=1), (0, 1)),
        ("following", ["components that follow"], ("7.4.4",),
         recoded(encoded(noise_sheet(), resolution=24, qp=30), models=8, component_cross=16), (0, 2)),
        ("all_tools_slices", [("{} models", 6), "colour range", "no filter", "slices of colour and alpha"], ("7.2", "7.5.5"),
         recoded(encoded(veil, resolution=30, qp=34), slices=slices, models=6, colour_range=255), (0, 2)),
        ("random_mixed", ["random bytes through the mixed contexts"], ("7.5.5", "7.6.4"), random["mixed"], (0, 1)),
        ("zeros_mixed", ["zeros", "then random bytes", "the longest escapes"], ("7.5.5", "7.6.4"), random["mixed_zeros"], (0, 1)),
        ("lossless_slices", ["lossless", "slices", "colour and alpha"], ("5.7.1", "7.2", "7.9"),
         recoded(encoded(veil, resolution=24, qp=4), slices=slices, models=6, filters=1, max_error=0), (0, 1)),
        ("near_lossless", [("noise with errors of at most {} from a coarse field", 2)], ("5.7.1", "7.9"),
         recoded(encoded(noise_sheet(), resolution=40, qp=34), models=6, max_error=2), (0, 2)),
        ("random_residuals", ["random bytes through the residuals"], ("7.9",), random["residuals"], (0, 1)),
        ("zeros_residuals", ["zeros up to the middle of the residuals", "then random bytes", "the largest ones"], ("7.9",),
         random["residuals_zeros"], (0,)),
        ("no_transform", ["three components without a colour transform"], ("5.7.1", "7.8.1"),
         recoded(encoded(everyday, resolution=20, qp=28), plain=True), (0, 1)),
        ("random_codeword", ["random bytes as a codeword", "saturated differences and means"], ("7.4.2", "7.4.3", "7.6"),
         random["random"], (0, 1, 2)),
        ("random_large", ["random bytes as a codeword", "means at their bounds"], ("7.4.3", "7.6"), random["random_large"],
         (0, 1)),
        ("zeros_random", ["zeros", "then random bytes", "the longest escapes"], ("7.5.4", "7.6"), random["zeros_random"], (0, 1)),
        ("ones_random", ["a codeword that begins above every range"], ("7.6.2",), random["ones_random"], (0, 1)),
        ("empty_codeword", ["a codeword of no bytes"], ("5.7.2", "7.4.2", "7.6.2"), random["empty"], (0, 1, 3)),
        ("mixed_resolutions", ["fields of different K", "geometry units out of field order"], ("5.5", "5.6", "8.3"),
         mixed_resolutions(), (0, 1, 4, 5)),
        ("alpha_first", ["alpha before colour"], ("5.3.1", "5.7"), alpha_first(), (0,)),
        ("strange_units", ["unknown ancillary units", "metadata early"], ("5.2", "5.8"), with_strange_units(), (0,)),
        ("metadata_format_1", ["metadata of another format"], ("5.8",), with_other_metadata(), (0,)),
        ("voxel_boundaries", [("B = {}", 8), "all vertices but three on voxel corners"], ("6.1", "6.2", "6.3"),
         on_voxel_boundaries(), (0,)),
        ("needle_bits20_k8192", [("B = {}", 20), ("K = {}", 8192), "a triangle thinner than a voxel"], ("6.1", "6.2", "6.4"),
         needle(), (0, 5)),
        ("point_triangle", [("B = {}", 20), "a triangle whose corners have one grid coordinate"], ("6.2", "6.3"),
         point_triangle(), (0, 1)),
        ("exact_areas", ["areas and heights exactly on a limit"], ("6.2", "6.4"), exact_areas(), (0,)),
        ("flat", ["one colour but for a few spots", "probabilities at their lower bound"], ("7.6.3",), flat_ring(), (0,)),
        ("bits20", [("B = {}", 20)], ("6.1", "6.2"), encoded(everyday, resolution=33, qp=34, position_bits=20), (0,)),
        ("fan", ["a mesh that is not a manifold"], ("5.6",), fan(), (0,)),
        ("huge_coordinates", [("coordinates near 1e{}", 142)], ("5.3",), encoded(huge, resolution=12, qp=36), (0,)),
        ("tiny_coordinates", [("coordinates near 1e{}", -280)], ("5.3",), encoded(tiny, resolution=12, qp=36), (0,)),
    ]
