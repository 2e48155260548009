"""The conformance vectors of shading normals: rules of materials (5.4.1) and marks of sharp edges (5.10 and 8.4.2)."""

import zlib

import numpy as np

from conformance.make.faulty import M, as_faulty, flipped, with_element, with_units, with_values
from conformance.make.good import Vector, encoded, parsed, units_of, written
from conformance.make.scenes import many_materials, ribbon, scene_of, torus, two_sheets
from texfcodec import decode
from texfcodec.bitstream.syntax import UNIT_SHARP_EDGES
from texfcodec.codecs.sharp_edges import enc_marks
from texfcodec.core.syntax_walk import write_v
from texfcodec.geometry.edges import NUM_FOLDS, coded_edges
from texfcodec.scene.scene import Material

S = UNIT_SHARP_EDGES
MARKED_BY_AREA, MARKED_BY_BOTH = 6, 8  # normal_rule


def ruled(data, rules):
    """The stream with other (normal_rule, normal_angle) by material."""
    stream = parsed(data)
    for material, (rule, angle) in zip(stream.materials, rules, strict=True):
        material.update(normal_rule=rule, normal_angle=angle)
    return written(stream)


def marked(data, rules, share=0.2, seed=0):
    """The same with random marks, of which so large a share are sharp; it may differ by class of folds."""
    texf, stream = decode(data), parsed(data)
    wants = np.array([rule >= MARKED_BY_AREA for rule, _ in rules])
    ends, fold = coded_edges(texf.lattice_positions, texf.faces, wants[texf.face_material])
    marks = np.random.default_rng(seed).random(len(ends)) < np.broadcast_to(share, NUM_FOLDS)[fold]
    for material, (rule, angle) in zip(stream.materials, rules, strict=True):
        material.update(normal_rule=rule, normal_angle=angle)
    stream.sharp_edges = {"num_edges": len(marks), "marks_crc": zlib.crc32(marks), "marks_data": enc_marks(marks, ends, fold)}
    return written(stream)


def ring(**choices):
    """A torus of one material."""
    return encoded(scene_of(*torus(12, 6), [Material("skin")]), resolution=12, qp=46, **choices)


def crumpled():
    """A torus with other positions, so that faces fold at all angles."""
    positions, faces, colours = torus(16, 8)
    moved = positions + np.random.default_rng(5).normal(0, 0.08, positions.shape)
    return encoded(scene_of(moved, faces, colours), resolution=12, qp=46)


def uncommon():
    """Rules that differ, and marks that no surface would ask for."""
    unlit = two_sheets()
    unlit.materials[1].unlit = True
    of_five = encoded(many_materials(), resolution=14, qp=46)
    lines = [
        ("normals_rules", "five materials in one field, all kinds and weights of rules", ("5.4.1", "8.4.1"),
         ruled(of_five, [(0, 0), (1, 180), (3, 30), (5, 60), (2, 1)])),
        ("normals_unlit", "an unlit material without a rule", ("5.4.1",), encoded(unlit, resolution=14, qp=46)),
        ("normals_marks", "marks of sharp edges", ("5.10", "8.4.2"), marked(ring(), [(MARKED_BY_BOTH, 180)])),
        ("normals_marks_noise", "marks of sharp edges, many classes of folds", ("5.10", "8.4.2"),
         marked(crumpled(), [(MARKED_BY_AREA, 90)], 0.5, 1)),
        ("normals_marks_ribbon", "a ribbon, marks of sharp edges", ("8.4.2",),
         marked(encoded(scene_of(*ribbon()), resolution=20, qp=46), [(7, 120)], 0.1, 2)),
        ("normals_marks_one", "five materials in one field, marks at one of the materials", ("5.10", "8.4.2"),
         marked(of_five, [(0, 45), (MARKED_BY_AREA, 180), (0, 45), (3, 45), (0, 0)], 0.7, 3)),
        ("normals_all_sharp", "every edge sharp", ("8.4.2",), marked(ring(), [(MARKED_BY_AREA, 180)], 1.1)),
        ("normals_fine", "position_bits 20, marks of sharp edges", ("8.4.2",),
         marked(ring(position_bits=20), [(MARKED_BY_AREA, 180)], 0.3, 4)),
    ]
    return [Vector(f"uncommon/{name}", *rest) for name, *rest in lines]


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

    lines = [
        ("normal_rule_9", "normal_rule 9", "5.4.1", rule(9, base), "TXF-S04"),
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
    ]
    return as_faulty(lines)

