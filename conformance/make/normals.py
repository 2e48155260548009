"""The conformance vectors of shading normals: rules of materials (5.4.1) and marks of sharp edges (5.10 and 8.4.2)."""

import zlib

import DracoPy
import numpy as np

from conformance.make.faulty import M, flipped, with_element, with_units, with_values
from conformance.make.good import encoded, parsed, units_of, written
from conformance.make.scenes import many_materials, ribbon, scene_of, torus, two_sheets
from conformance.make.texels import BITS, Grid, Patch, stream_of_parts
from texfcodec import decode
from texfcodec.bitstream.syntax import UNIT_CODED_NORMALS, UNIT_SHARP_EDGES
from texfcodec.codecs.coded_normals import dec_residuals, enc_residuals
from texfcodec.codecs.sharp_edges import enc_marks
from texfcodec.core.syntax_walk import write_v
from texfcodec.errors import StreamError
from texfcodec.geometry.corner_groups import corner_groups
from texfcodec.geometry.draco import dec_geometry
from texfcodec.geometry.edges import NUM_FOLDS, coded_edges
from texfcodec.scene.normal_rule import IN_STREAM, rule_of
from texfcodec.scene.scene import Material

S, N = UNIT_SHARP_EDGES, UNIT_CODED_NORMALS
MARKED_BY_AREA, MARKED_BY_BOTH, CODED = 3, 5, IN_STREAM.code  # normal_rule


def ruled(data, rules):
    """The stream with other (normal_rule, normal_angle) by material."""
    stream = parsed(data)
    for material, (rule, angle) in zip(stream.materials, rules, strict=True):
        material.update(normal_rule=rule, normal_angle=angle)
    return written(stream)


def small(count):
    """Residuals as an encoder has them, most of them 0: int64 [count, 2]."""
    return np.rint(np.random.default_rng(6).normal(0, 1.5, (count, 2))).astype(np.int64)


def wild(count):
    """Residuals of all sizes and both signs, the largest that can be written among them: int64 [count, 2]."""
    rng = np.random.default_rng(8)
    return np.rint(2.0 ** rng.uniform(-2, 13.002, (count, 2))).astype(np.int64).clip(0, 8205) * rng.choice((-1, 1), (count, 2))


def marked(data, rules, share=0.2, seed=0, residuals=small, step=180):
    """The same with random marks, of which so large a share are sharp; it may differ by class of folds. residuals: where a rule
    asks for coded normals, a function of their number, or the codeword itself."""
    texf, stream = decode(data), parsed(data)
    wants = np.array([rule >= MARKED_BY_AREA for rule, _ in rules])
    ends, fold = coded_edges(texf.lattice_positions, texf.faces, wants[texf.face_material])
    marks = np.random.default_rng(seed).random(len(ends)) < np.broadcast_to(share, NUM_FOLDS)[fold]
    for material, (rule, angle) in zip(stream.materials, rules, strict=True):
        material.update(normal_rule=rule, normal_angle=angle)
    stream.sharp_edges = {"num_edges": len(marks), "marks_crc": zlib.crc32(marks), "marks_data": enc_marks(marks, ends, fold)}
    if CODED in (rule for rule, _ in rules):
        groups = corner_groups(texf.lattice_positions, texf.faces, [rule_of(*pair) for pair in rules], texf.face_material, marks)
        data = residuals(len(groups)) if callable(residuals) else residuals
        data = data if isinstance(data, bytes) else enc_residuals(data, groups)
        normals = groups.normals(dec_residuals(data, groups), step)
        stream.coded_normals = {"num_groups": len(groups), "normal_step": step, "residual_data": data,
                                "normals_crc": zlib.crc32(normals.astype("<i2").tobytes())}
    return written(stream)


def ring(**choices):
    """A torus of one material."""
    return encoded(scene_of(*torus(12, 6), [Material("skin")]), resolution=12, qp=46, **choices)


def crumpled(seed=5):
    """A torus with other positions, so that faces fold at all angles."""
    positions, faces, colours = torus(16, 8)
    moved = positions + np.random.default_rng(seed).normal(0, 0.08, positions.shape)
    return encoded(scene_of(moved, faces, colours), resolution=12, qp=46)


def leaves():
    """Four squares at right angles around one edge, with a front and a back, and two more fronts on one of them."""
    positions = np.array([[0, 0, z] for z in (0, 1)] + [[x, y, z] for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)) for z in (0, 1)])
    fronts = np.concatenate([[[0, 2 * k, 2 * k + 1], [0, 2 * k + 1, 1]] for k in range(1, 5)])
    faces = np.concatenate([fronts[:4], fronts[4:, ::-1], fronts[:2, ::-1], fronts[:2], fronts[:2, [1, 2, 0]]])
    colours = np.column_stack([positions * 0.4 + 0.4, np.ones(10)]).astype(np.float32)
    return encoded(scene_of(positions.astype(float), faces, colours), resolution=12, qp=46)


def narrow():
    """A stream of a bumpy sheet in which corners of faces share a position. Draco's encoder writes no such faces, but a flipped
    bit in what it has written makes some."""
    x, y = np.divmod(np.arange(36), 6)
    lattice = np.stack([3 * x, 3 * y, (x * y) % 3], 1)
    faces = np.array([[i, i + 1, i + 7] for i in range(29) if i % 6 < 5] + [[i, i + 7, i + 6] for i in range(29) if i % 6 < 5])
    whole = DracoPy.encode(lattice.astype(np.uint32), faces.astype(np.uint32), compression_level=10, create_metadata=False)
    for bit in range(8 * 20, 8 * len(whole)):
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        try:
            points, corners = dec_geometry(bytes(data), len(lattice), len(faces), BITS)
        except StreamError:  # as of most flips
            continue
        kinds = [len({tuple(points[c]) for c in face}) for face in corners.tolist()]
        if kinds.count(2) > 1 and kinds.count(3) > 20:
            return stream_of_parts([Grid(20)], [Patch(points, corners, draco=bytes(data))])
    raise AssertionError("no flip makes such faces")


def uncommon():
    """Rules that differ, and marks that no surface would ask for."""
    unlit = two_sheets()
    unlit.materials[1].unlit = True
    of_five = encoded(many_materials(), resolution=14, qp=46)
    return [
        ("normals_rules", ["five materials in one field", "all weights of rules"], ("5.4.1", "8.4.1"),
         ruled(of_five, [(0, 0), (1, 180), (0, 30), (2, 60), (2, 1)])),
        ("normals_unlit", ["an unlit material without a rule"], ("5.4.1",), encoded(unlit, resolution=14, qp=46)),
        ("normals_marks", ["marks of sharp edges"], ("5.10", "8.4.2"), marked(ring(), [(MARKED_BY_BOTH, 180)])),
        ("normals_marks_noise", ["marks of sharp edges", "many classes of folds"], ("5.10", "8.4.2"),
         marked(crumpled(), [(MARKED_BY_AREA, 90)], 0.5, 1)),
        # One of its folds has another class where negative components are shifted towards 0.
        ("normals_marks_shift", ["many classes of folds", "marks of sharp edges"], ("8.4.2",),
         marked(crumpled(21), [(MARKED_BY_AREA, 90)], 0.5, 10)),
        ("normals_marks_ribbon", ["a ribbon", "marks of sharp edges"], ("8.4.2",),
         marked(encoded(scene_of(*ribbon()), resolution=20, qp=46), [(4, 120)], 0.1, 2)),
        ("normals_marks_one", ["five materials in one field", "marks at one of the materials"], ("5.10", "8.4.2"),
         marked(of_five, [(0, 45), (MARKED_BY_AREA, 180), (0, 45), (1, 45), (0, 0)], 0.7, 3)),
        ("normals_marks_narrow", ["marks of sharp edges", "faces with two corners at one position"], ("8.4.2",),
         marked(narrow(), [(MARKED_BY_BOTH, 180)], 0.5)),
        ("normals_all_sharp", ["every edge sharp"], ("8.4.2",), marked(ring(), [(MARKED_BY_AREA, 180)], 1.1)),
        ("normals_fine", [("B = {}", 20), "marks of sharp edges"], ("8.4.2",),
         marked(ring(position_bits=20), [(MARKED_BY_AREA, 180)], 0.3, 4)),
        ("normals_coded", ["coded normals"], ("5.11", "8.4.3", "8.4.4"), marked(ring(), [(CODED, 0)])),
        ("normals_coded_wild", ["coded normals", "residuals of all sizes"], ("8.4.4",),
         marked(crumpled(), [(CODED, 180)], 0.4, 5, wild, 4096)),
        ("normals_coded_noise", ["coded normals", "a codeword of noise"], ("8.4.4",),
         marked(crumpled(), [(CODED, 0)], 0.1, 6, np.random.default_rng(9).bytes(4000), 77)),
        ("normals_coded_one", ["five materials in one field", "coded normals at one of the materials"], ("5.11", "8.4.3"),
         marked(of_five, [(0, 45), (CODED, 0), (0, 45), (MARKED_BY_BOTH, 90), (0, 0)], 0.3, 7, small, 1)),
        ("normals_coded_leaves", ["coded normals", "faces at one place", "edges of more than two faces"], ("8.4.3",),
         marked(leaves(), [(CODED, 0)], 0.15, 8, small, 700)),
        ("normals_coded_sharp", ["every edge sharp", "coded normals", "faces at one place"], ("8.4.3",),
         marked(leaves(), [(CODED, 0)], 1.1, 8, small, 700)),
        ("normals_coded_fine", [("B = {}", 20), "coded normals"], ("8.4.3",),
         marked(ring(position_bits=20), [(CODED, 0)], 0.1, 9, small, 60)),
    ]


def faulty():
    """Clauses 5.4.1, 5.10 and 8.4.2."""
    base, plain = marked(ring(), [(MARKED_BY_BOTH, 180)]), ring()
    (unit,) = [payload for kind, payload in units_of(base) if kind == S]
    edges = parsed(base).sharp_edges["num_edges"]
    rule = lambda number, data=plain: with_element(data, M, "materials[0].normal_rule", bytes([number]))
    angle = lambda number: with_element(plain, M, "materials[0].normal_angle", bytes([number]))

    other_edges = lambda count: with_element(base, S, "num_edges", write_v(count))

    def cut(units):
        units[next(i for i, (kind, _) in enumerate(units) if kind == S)] = (S, unit[:4])

    def other_marks(stream):
        data = bytearray(stream.sharp_edges["marks_data"])
        data[3] ^= 0x40
        stream.sharp_edges["marks_data"] = bytes(data)

    with_normals = marked(ring(), [(CODED, 0)])
    (coded_unit,) = [payload for kind, payload in units_of(with_normals) if kind == N]
    groups = parsed(with_normals).coded_normals["num_groups"]
    of_normals = lambda name, raw: with_element(with_normals, N, name, raw)

    def cut_normals(units):
        units[next(i for i, (kind, _) in enumerate(units) if kind == N)] = (N, coded_unit[:6])

    def other_residuals(stream):
        data = bytearray(stream.coded_normals["residual_data"])
        data[7] ^= 0x11
        stream.coded_normals["residual_data"] = bytes(data)

    def without_normals(units):
        units[:] = [(kind, payload) for kind, payload in units if kind != N]

    return [
        ("normal_rule_7", "normal_rule 7", "5.4.1", rule(7, base), "TXF-U09"),
        ("normal_angle_181", "normal_angle 181", "5.4.1", angle(181), "TXF-S04"),
        ("marks_missing", "a rule that asks for marks, and no sharp edges unit", "5.10", rule(MARKED_BY_AREA), "TXF-S11"),
        ("marks_unasked", "a sharp edges unit that no rule asks for", "5.10",
         with_units(plain, lambda units: units.insert(2, (S, unit))), "TXF-S11"),
        ("crc_sharp_edges", "a flipped bit in a unit of type 129", "5.2", flipped(base, S), "TXF-S03"),
        ("marks_twice", "two sharp edges units", "5.2", with_units(base, lambda units: units.insert(2, (S, unit))), "TXF-S07"),
        ("marks_cut", "the sharp edges unit ends in marks_crc", "5.10", with_units(base, cut), "TXF-S02"),
        ("num_edges_0", "num_edges is 0", "5.10", with_element(base, S, "num_edges", b"\0"), "TXF-S04"),
        ("num_edges_more", "num_edges is one too many", "8.4.2", other_edges(edges + 1), "TXF-S30"),
        ("num_edges_less", "num_edges is one too few", "8.4.2", other_edges(edges - 1), "TXF-S30"),
        ("marks_crc", "a wrong marks_crc", "8.4.2", with_element(base, S, "marks_crc", b"\1\2\3\4"), "TXF-S32"),
        ("marks_data", "a flipped bit in marks_data", "8.4.2", with_values(base, other_marks), "TXF-S32"),
        ("coded_missing", "a rule that asks for coded normals, and no such unit", "5.11",
         with_units(with_normals, without_normals), "TXF-S11"),
        ("coded_unasked", "a coded normals unit that no rule asks for", "5.11",
         with_units(base, lambda units: units.insert(2, (N, coded_unit))), "TXF-S11"),
        ("coded_twice", "two coded normals units", "5.2",
         with_units(with_normals, lambda units: units.insert(2, (N, coded_unit))), "TXF-S07"),
        ("crc_coded_normals", "a flipped bit in a unit of type 130", "5.2", flipped(with_normals, N), "TXF-S03"),
        ("coded_cut", "the coded normals unit ends in normals_crc", "5.11", with_units(with_normals, cut_normals), "TXF-S02"),
        ("num_groups_0", "num_groups is 0", "5.11", of_normals("num_groups", b"\0"), "TXF-S04"),
        ("num_groups_more", "num_groups is one too many", "8.4.3", of_normals("num_groups", write_v(groups + 1)), "TXF-S30"),
        ("num_groups_less", "num_groups is one too few", "8.4.3", of_normals("num_groups", write_v(groups - 1)), "TXF-S30"),
        ("num_groups_lie", "num_groups is 2^56 - 1", "8.4.3", of_normals("num_groups", write_v((1 << 56) - 1)), "TXF-S30"),
        ("normal_step_0", "normal_step is 0", "5.11", of_normals("normal_step", b"\0\0"), "TXF-S04"),
        ("normal_step_4097", "normal_step is 4097", "5.11", of_normals("normal_step", b"\1\x10"), "TXF-S04"),
        ("normals_crc", "a wrong normals_crc", "8.4.4", of_normals("normals_crc", b"\1\2\3\4"), "TXF-S32"),
        ("residual_data", "a flipped bit in residual_data", "8.4.4", with_values(with_normals, other_residuals), "TXF-S32"),
    ]

