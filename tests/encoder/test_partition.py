"""What the encoder makes of flat faces, of layers in the same voxels, and of alpha when it splits a surface into fields."""


import numpy as np
import pytest
from shapes import scene_of

from texfcodec.api import decode, encode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.place import contacts
from texfcodec.errors import InputError
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, ALPHA_OPAQUE, Material
from texfcodec.scene.srgb import linear_to_srgb


def cube():
    """(positions [8, 3], faces [12, 3]) of the unit cube."""
    positions = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
             [1, 5, 7], [1, 7, 3]]
    return positions, np.array(faces)


def sheets(heights, count=2):
    """Unit squares of two faces each at these heights, none sharing a vertex: (positions, faces)."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    return joined(*((square + [0, 0, z], np.array([[0, 1, 2], [0, 2, 3]])[:count]) for z in heights))


def joined(*meshes):
    starts = np.cumsum([0] + [len(p) for p, _ in meshes])
    return np.concatenate([p for p, _ in meshes]), np.concatenate([f + s for (_, f), s in zip(meshes, starts, strict=False)])


def segments(count, on_lattice, seed=0):
    """Faces whose corners lie on a line, all over the unit cube; exactly so after rounding to 14 bits, or only before."""
    rng = np.random.default_rng(seed)
    first, last = rng.uniform(0, 1, (2, count, 1, 3))
    middle = rng.uniform(0.1, 0.9, (count, 1, 1))
    points = first + np.concatenate([0 * middle, middle, 0 * middle + 1], axis=1) * (last - first)
    if on_lattice:
        first, half = rng.integers(4096, 12288, (count, 1, 3)), rng.integers(-2048, 2048, (count, 1, 3))
        points = (first + half * np.array([[[0], [1], [2]]])) / 16383
    return points.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def fan_on_a_line(count):
    """Faces that share the corner at the origin and lie on one line, each with an edge in common with the next."""
    along = np.linspace(0.01, 1, count + 1)[:, None] * [1, 1, 1]
    n = np.arange(count)
    return np.concatenate([np.zeros((1, 3)), along]), np.stack([0 * n, 1 + n, 2 + n], axis=1)


def collapsed(count):
    points, faces = segments(count, True, 1)
    faces[:, 2] = faces[:, 1]
    return points, faces


FLAT = {"on the lattice": lambda n: segments(n, True), "before rounding": lambda n: segments(n, False), "fan": fan_on_a_line,
        "two equal corners": collapsed}


@pytest.mark.parametrize("kind", FLAT)
@pytest.mark.parametrize("base", [cube, lambda: sheets([0, 0.001, 0.5, 0.501, 1])], ids=["cube", "near sheets"])
def test_flat_faces_leave_the_stream_as_it_is_without_them(base, kind):
    good, flat = base(), FLAT[kind](466)
    options = EncodeOptions(resolution=32, qp=28, effort="fast")
    positions, faces = joined(good, flat)
    assert encode_scene(scene_of(positions, faces), options).data == encode_scene(scene_of(*good), options).data


def test_a_flat_face_that_closes_a_gap_stays():
    """The middle of a long edge on one side is a corner on the other: the flat face between them keeps the surface closed."""
    positions = [[0, 0, 0], [2, 0, 0], [1, 0, 0], [1, 2, 0], [1, -2, 0]]
    faces = [[0, 1, 3], [2, 0, 4], [1, 2, 4], [0, 2, 1]]
    surface = make_surface(scene_of(positions, faces), EncodeOptions())
    np.testing.assert_array_equal(surface.origin_face, [0, 1, 2, 3])
    hanging = make_surface(scene_of(positions, [faces[0], faces[3]]), EncodeOptions())
    np.testing.assert_array_equal(hanging.origin_face, [0])


def test_where_all_faces_are_flat_all_stay():
    surface = make_surface(scene_of(*segments(20, True)), EncodeOptions())
    assert len(surface.faces) == 20


# Layers in the same voxels


def layers(*kinds, heights=None, colours=None, shared=True, qp=10, **options):
    """(Texf, Report, reason of the partition) of unit squares of two faces, one per (alpha mode, alpha, cutoff) of kinds, at
    equal or given heights; colours: linear RGB of each; shared: with the same diagonal, so that all their edges coincide."""
    heights = heights or [0.5] * len(kinds)
    positions, faces = sheets(heights)
    if not shared:
        faces[2:4] = [[4, 5, 7], [5, 6, 7]]
    materials = [Material(f"m{i}", np.array([*(colours[i] if colours else (0.5, 0.2, 0.1)), alpha]), alpha_mode=mode,
                          alpha_cutoff=cutoff) for i, (mode, alpha, cutoff) in enumerate(kinds)]
    scene = scene_of(positions, faces, materials=materials, face_material=np.repeat(np.arange(len(kinds)), 2))
    report = Report()
    made = encode_scene(scene, EncodeOptions(resolution=64, qp=qp, **options), report)
    return decode(made.data), report, made.choices["partition"]["reason"]


def alpha_of(texf, material):
    """Alpha of the only field that the faces of a material are in, as the set of its values."""
    fields = set(texf.face_field[texf.face_material == material].tolist())
    assert len(fields) == 1
    return set(texf.fields[fields.pop()].rgba[:, 3].tolist())


SOLID, HOLE, GLASS = (ALPHA_OPAQUE, 1.0, 0.5), (ALPHA_MASK, 0.0, 0.5), (ALPHA_BLEND, 0.2, 0.5)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("heights", [[0.5, 0.5], [0.5, 0.501]])
@pytest.mark.parametrize("other,value", [(HOLE, 0), (GLASS, 51)])
def test_layers_of_equal_colour_and_different_alpha_keep_their_alpha(heights, shared, other, value):
    texf, report, _ = layers(SOLID, other, heights=heights, shared=shared)
    assert (alpha_of(texf, 0), alpha_of(texf, 1)) == ({255}, {value})
    assert report.warnings == [] and len(texf.fields) == 2
    layers(SOLID, other, heights=heights, shared=shared, strict=True)


@pytest.mark.parametrize("kind", [SOLID, HOLE, GLASS])
@pytest.mark.parametrize("heights", [[0.5, 0.5], [0.5, 0.501]])
def test_layers_of_equal_alpha_and_colour_stay_one_field(heights, kind):
    texf, report, _ = layers(kind, kind, heights=heights)
    assert len(texf.fields) == 1 and report.warnings == []


def test_masks_on_the_same_side_of_their_cutoff_stay_one_field():
    texf, report, _ = layers((ALPHA_MASK, 0.9, 0.5), (ALPHA_MASK, 0.6, 0.5))
    assert len(texf.fields) == 1 and report.warnings == []
    assert len(layers((ALPHA_MASK, 0.9, 0.5), (ALPHA_MASK, 0.6, 0.7))[0].fields) == 2


def test_alpha_mixed_where_partition_is_off_is_told():
    texf, report, reason = layers(SOLID, HOLE, partition="off")
    assert len(texf.fields) == 1 and len(report.warnings) == 1 and "partition is off" in report.warnings[0]
    assert reason == "switched off"
    with pytest.raises(InputError) as caught:
        layers(SOLID, HOLE, partition="off", strict=True)
    assert caught.value.code == "TXF-I52" and "alpha" in caught.value.details["warnings"][-1]
    assert layers(HOLE, HOLE, partition="off")[1].warnings == []
    assert layers(SOLID, HOLE, partition="off", heights=[0, 1])[1].warnings == []


def test_more_layers_of_different_alpha_than_fields_are_told():
    steps = [(ALPHA_BLEND, i / 19, 0.5) for i in range(20)]
    texf, report, _ = layers(*steps, effort="fast")
    assert len(texf.fields) == 16 and len(report.warnings) == 1 and "limited to 16" in report.warnings[0]
    texf, report, _ = layers(*steps[:16], effort="fast")
    assert len(texf.fields) == 16 and report.warnings == []
    assert [alpha_of(texf, i) for i in range(16)] == [{round(255 * a)} for _, a, _ in steps[:16]]


@pytest.mark.parametrize("count", [2, 3, 6])
def test_coincident_layers_that_differ_in_colour_get_fields_of_their_own(count):
    """By material, or by vertex colours alone."""
    greys = np.linspace(0, 1, count)
    texf, *_ = layers(*[SOLID] * count, colours=np.repeat(greys[:, None], 3, axis=1).tolist(), effort="fast")
    assert len(texf.fields) == count
    positions, faces = sheets([0.5] * count)
    rgba = np.column_stack([np.repeat(greys, 4)] * 3 + [np.ones(4 * count)])
    texf = decode(encode_scene(scene_of(positions, faces, rgba), EncodeOptions(resolution=64, qp=10, effort="fast")).data)
    assert sorted(int(f.rgba[:, 0].mean().round()) for f in texf.fields) == np.rint(linear_to_srgb(greys) * 255).tolist()


def test_the_api_refuses_losses_as_the_command_line_does():
    scene = scene_of(*sheets([0.5]))
    scene.dropped, scene.remarks = ["NORMAL"], ["a vertex is left out"]
    assert encode(scene, EncodeOptions(resolution=16, qp=30))
    with pytest.raises(InputError) as caught:
        encode(scene, EncodeOptions(resolution=16, qp=30, strict=True))
    assert caught.value.code == "TXF-I52" and caught.value.details == {"dropped": ["NORMAL"]}
    scene.dropped, report = [], Report()
    assert encode(scene, EncodeOptions(resolution=16, qp=30, strict=True), report)  # a remark refuses nothing
    assert report.remarks == scene.remarks and report.warnings == report.dropped == []


# Contacts beside their definitions


def boxes(count, side=0.3, seed=0):
    """Cubes anywhere in the unit cube: (positions, faces)."""
    points, faces = cube()
    return joined(*((side * points + low, faces) for low in np.random.default_rng(seed).uniform(0, 1 - side, (count, 3))))


def found(count, resolution=16):
    """(Surface, Contacts) of boxes."""
    surface = make_surface(scene_of(*boxes(count)), EncodeOptions())
    return surface, contacts.find_contacts(surface.lattice, surface.faces, surface.cube.position_bits, resolution)


def labels_by_cell(made):
    """{cell: set of labels} of Contacts."""
    by_cell = {}
    for cell, label in zip(made.cell.tolist(), made.label.tolist(), strict=True):
        by_cell.setdefault(cell, set()).add(label)
    return by_cell


def test_contacts_are_those_of_each_face_alone():
    """With more cells to a label than the first hash table takes."""
    surface, made = found(5, 256)
    assert np.bincount(made.label).max() > contacts.FIRST_TABLE
    pairs, bits = set(), surface.cube.position_bits
    for number in range(len(surface.faces)):
        part = slice(number, number + 1)
        alone = contacts.find_contacts(surface.lattice, surface.faces[part], bits, 256, made.component[part])
        pairs |= set(zip(alone.cell.tolist(), alone.label.tolist(), strict=True))
    assert list(zip(made.cell.tolist(), made.label.tolist(), strict=True)) == sorted(pairs)


def test_folding_components_are_those_with_opposite_faces_in_a_cell():
    made = found(30, 6)[1]
    cells, folded = np.zeros((2, made.component.max() + 1))
    for labels in labels_by_cell(made).values():
        for component in {label // 6 for label in labels}:
            own = {label % 6 for label in labels if label // 6 == component}
            cells[component] += 1
            folded[component] += any({2 * axis, 2 * axis + 1} <= own for axis in range(3))
    wanted = np.flatnonzero(folded > contacts.MIN_FOLD * cells)
    np.testing.assert_array_equal(contacts.folding_components(made), wanted)
    assert len(wanted)


def colouring(made, split, most):
    """colour_pieces() by its definition, by piece."""
    pieces = [sorted({2 * (label // 6) + (label % 2 if label // 6 in split else 0) for label in labels})
              for _, labels in sorted(labels_by_cell(made).items())]
    crowded = sum(len(own) > contacts.NEAR + 1 for own in pieces) > contacts.MIN_CROWD * len(pieces)
    far, sizes, meetings = contacts.FAR if crowded else contacts.NEAR, {}, {}
    for own in pieces:
        for i, piece in enumerate(own):
            sizes[piece] = sizes.get(piece, 0) + 1
            for other in own[i + 1 : i + 1 + far]:
                meetings[piece, other] = meetings.get((piece, other), 0) + 1
    colour = {}
    for piece in sorted(sizes, key=lambda piece: (-sizes[piece], piece)):
        load = [0] * most
        for (a, b), cells in meetings.items():
            other = b if a == piece else a if b == piece else None
            if other in colour and cells > max(contacts.MIN_CONTACT * min(sizes[a], sizes[b]), 1):
                load[colour[other]] += cells
        colour[piece] = load.index(min(load))
    return colour


@pytest.mark.parametrize(("count", "resolution"), [(3, 32), (40, 16), (120, 6)])
def test_pieces_are_coloured_greedily_by_the_cells_in_which_they_meet(count, resolution):
    made = found(count, resolution)[1]
    for split in ([], list(range(0, count, 2))):
        colour = colouring(made, split, 8)
        piece = contacts.pieces_of(made, split)[0]
        _, wanted = np.unique([colour[p] for p in piece.tolist()], return_inverse=True)
        np.testing.assert_array_equal(contacts.colour_pieces(made, split, 8), wanted)


def test_meetings_in_a_crowd_are_linear_in_its_pieces():
    """All pieces in the same three cells: each meets no more than FAR after it."""
    count = 5000
    label = np.tile(6 * np.arange(count), 3)
    made = contacts.Contacts(np.arange(count), np.zeros(count, np.int64), np.repeat(np.arange(3), count), label)
    meetings, sizes = contacts._meetings(made.cell, made.label // 6)
    assert meetings.shape[1] <= contacts.FAR * count and (meetings[2] == 3).all() and (sizes == 3).all()
    assert contacts.colour_pieces(made).max() + 1 == contacts.MAX_FIELDS
