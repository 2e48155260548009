"""Conformance vectors on which plausible misreadings of the specification part from its text, and that no other vector has."""

import numpy as np

from conformance.make.faulty import A, F, G, M, with_units
from conformance.make.good import encoded, of_triangles, scene_of, torus
from conformance.make.materials_faulty import binary32
from conformance.make.neural import QUICK, neural, sheets
from conformance.make.normals import CODED, marked, wild
from conformance.make.order import with_bytes
from conformance.make.rules import SPAN, of_nothing
from conformance.make.texels import Grid, Image, Patch, picture, sheet, stream_of_parts
from texfcodec.scene.scene import Material

LAST = (1 << 20) - 1


def at_a_third():
    """B = 20, K = 3: a triangle that one step more would bring into the next column, and one in each end of the lattice."""
    third = [(349525, 9, 9), (349525, 90, 9), (349525, 9, 90)]
    ends = [(0, 0, 0), (9, 0, 0), (0, 9, 9), (LAST, LAST, LAST), (LAST - 8, LAST, LAST), (LAST, LAST - 8, LAST - 8)]
    return of_triangles([*third, *ends], resolution=3, area_threshold=0)


def sorted_otherwise():
    """B = 20, K = 2: corners whose grid coordinates sort otherwise than their lattice positions."""
    return of_triangles([(591251, 500203, 208831), (591248, 579975, 208831), (757180, 512108, 254852), *SPAN], resolution=2,
                        area_threshold=0)


def beside_the_grid():
    """B = 20, K = 16: a triangle on the border, one of whose samples lies beside the grid."""
    return of_triangles([(0, 3, 49162), (173860, 0, 141487), (53151, 0, 44344), *SPAN], area_threshold=0)


def twice():
    """B = 20, K = 16: a triangle twice, whose area weight reaches area_threshold in their sum alone."""
    a, b, c = (1000, 1000, 40000), (41000, 1000, 40000), (1000, 41000, 40000)
    return of_triangles([a, b, c, b, c, a, *SPAN], area_threshold=60)


def coded(lattice, faces, share=0, **more):
    """A stream of coded normals on a mesh."""
    return marked(stream_of_parts([Grid(6)], [Patch(np.array(lattice), np.array(faces))]), [(CODED, 0)], share, **more)


def nine_at_an_edge():
    """Nine faces at an edge, which do not share it (8.4.2), and two beside them."""
    rim = [[500 + 40 * k, 900 - 3 * k * k, 100 + k] for k in range(9)]
    beside = [[0, 100, 0], [100, 100, 0], [0, 200, 5], [90, 220, 40]]
    return coded([[500, 0, 0], [500, 0, 900], *rim, *beside], [*([0, 1, 2 + k] for k in range(9)), [11, 12, 13], [12, 14, 13]])


def on_a_line():
    """A face of three positions on a line between two others: it has groups as they have."""
    return coded([[0, 0, 0], [500, 0, 0], [1000, 0, 0], [0, 900, 40], [1000, 900, 80]], [[0, 2, 1], [0, 1, 3], [1, 2, 4]])


def nearly_flat():
    """A sheet whose normals lie so near to an axis that z x e of 8.4.3 is long, with residuals that show it."""
    x, y = np.divmod(np.arange(144), 12)
    lattice = np.stack([90 * x, 90 * y, np.random.default_rng(3).integers(0, 2, 144)], axis=1)
    corners = [i for i in range(132) if i % 12 < 11]
    faces = [[i, i + 12, i + 1] for i in corners] + [[i + 1, i + 12, i + 13] for i in corners]
    return coded(lattice, faces, 0.6, residuals=wild, step=90)


def uncommon():
    """The good ones."""
    unlit = Material("", unlit=True)
    return [
        ("rules_third", [("B = {}", 20), ("K = {}", 3), "a grid coordinate just below a voxel"], ("6.1",), at_a_third(), (0,)),
        ("rules_sorted", [("B = {}", 20), ("K = {}", 2), "corners that the grid sorts otherwise"], ("6.2",), sorted_otherwise(),
         (0,)),
        ("rules_beside", [("B = {}", 20), ("K = {}", 16), "a sample beside the grid"], ("6.3",), beside_the_grid(), (0,)),
        ("rules_twice", [("B = {}", 20), ("K = {}", 16), "a triangle twice"], ("6.3", "6.4"), twice(), (0,)),
        ("rules_nine", ["coded normals", "an edge of nine faces"], ("8.4.3",), nine_at_an_edge(), (0,)),
        ("rules_line", ["coded normals", "a face of three positions on a line"], ("8.4.3",), on_a_line(), (0,)),
        ("rules_near_axis", ["coded normals", "normals near an axis"], ("8.4.3", "8.4.4"), nearly_flat(), (0,)),
        ("rules_least", ["an empty mesh", ("side {}", 0)], ("4.3", "5.3"), of_nothing([unlit] * 3, side=-0.0), (0,)),
    ]


def of_unlit(*parameters):
    """An empty mesh with an unlit material and its parameters: pairs of parameter_id and value."""
    rows = b"".join(bytes([number]) + binary32(value) for number, value in parameters)
    return with_units(of_nothing([Material(unlit=True)]), lambda units: units.__setitem__(
        1, (M, bytes([0, 0, 2, 0, len(parameters)]) + rows)))


def of_group(*channels, components):
    """An empty mesh with a channel group."""
    group = {"num_semantics": len(channels), "group_semantics": list(channels), "group_components": components}
    return of_nothing([], num_channel_groups=1, channel_groups=[group])


def faulty():
    """Numbers of components, rules of an unlit material, and orders of 9.2."""
    plain = encoded(scene_of(*torus(8, 5)), resolution=5, qp=40)
    strange = lambda data, *changes: with_bytes(data, (A, 0, "codec_id", b"\7"), *changes)
    image = stream_of_parts([Image(picture(2, 3))], [sheet([(0, 0), (31, 0), (31, 47)] * 2)])
    fields = with_units(strange(plain), lambda units: units.insert(3, (F, b"\1" + units[2][1][1:])))
    joint = neural(sheets(12), 41, [(6, 0, 77)], **QUICK)
    lines = [
        ("keys_before_codec", "num_keys 7 of an image of 2 x 3", strange(image, (F, 0, "num_keys", b"\7")), "TXF-S04"),
        ("codec_before_draco", "another magic number of Draco's", strange(plain, (G, 0, "draco_data", b"DRACX")), "TXF-U02"),
        ("codec_before_fields", "a field unit too many", fields, "TXF-U02"),
        ("codec_before_shift", "level_shift 13", strange(plain, (A, 0, "level_shift", b"\x0d")), "TXF-U02"),
    ]
    return [
        ("components_of_colours", "one component for two colours", "5.3.1", of_group(0, 7, components=1), "TXF-U03"),
        ("components_of_others", "two components for base colour and alpha", "5.3.1", of_group(0, 1, components=2), "TXF-U03"),
        ("unlit_default", "a parameter of an unlit material that is its default", "5.4.2", of_unlit((2, 1.0)), "TXF-S04"),
        ("unlit_order", "parameters of an unlit material out of order", "5.4.2", of_unlit((3, 0.5), (2, 0.5)), "TXF-S04"),
        ("registry_before_order", "parameters out of order, and parameter_id 27", "9.2",
         of_unlit((3, 0.5), (2, 0.5), (27, 1.0)), "TXF-U09"),
        *((name, f"{title}, and an unknown attribute codec", "9.2", data, code) for name, title, data, code in lines),
        ("form_before_field", "3DNTC of field 1, and form 2", "9.2",
         with_bytes(joint, (A, 0, "field_index", b"\1"), (A, 0, "form", b"\2")), "TXF-U09"),
    ]
