"""Hard meshes through encode() and decode(); bounds of positions, voxels and values: the tests named after bounds."""

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere, scene_of, shuffled, sphere, square, triangles_of

from texfcodec.api import decode, encode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError, LimitError
from texfcodec.field.morton import decode_morton
from texfcodec.geometry.areas import sample_surface
from texfcodec.io.load import load
from texfcodec.limits import Limits
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.fetch import pack_source, sample_source


def coded(scene, **options):
    """(Texf, byte counts) of a scene that went through both pipelines."""
    made = encode_scene(load(scene), EncodeOptions(**{"resolution": 64, "qp": 28, **options}))
    data, sizes = made.data, made.sizes
    return decode(data), sizes


def assert_positions_are_within_half_a_lattice_step(scene, texf):
    """Every corner of every face that was kept has a decoded vertex no further than half a step away on any axis."""
    used = scene.positions[np.unique(scene.faces)]
    step, rounding = texf.side / (2**texf.position_bits - 1), 4 * np.spacing(np.abs(scene.positions).max())
    for part in np.array_split(used, max(1, len(used) // 500)):
        distance = np.abs(part[:, None] - texf.positions[None]).max(axis=2).min(axis=1)
        assert distance.max() <= step * (0.5 + 1e-9) + rounding


def colour_error(scene, texf, samples=2000):
    """Largest and mean colour error at points spread over the source's surface, asking the fields as a viewer would."""
    face, bary = sample_surface(scene.positions, scene.faces, samples)
    points = np.einsum("nc,ncd->nd", bary, scene.positions[scene.faces[face]])
    error = np.abs(texf.query(points)[:, :3] - sample_source(pack_source(scene), face, bary)[:, :3])
    return error.max(), error.mean()


# Scale


def test_the_same_shape_at_any_power_of_two_scale_has_the_same_field():
    scene, first = painted_sphere(8), None
    for scale in (1.0, 2.0**-90, 2.0**90):
        field = coded(scene_of(scene.positions * scale, scene.faces, scene_colours(scene)))[0].fields[0]
        first = first or field
        np.testing.assert_array_equal(field.keys, first.keys)
        np.testing.assert_array_equal(field.rgba, first.rgba)


def scene_colours(scene):
    colours = np.zeros((len(scene.positions), 4))
    colours[scene.faces.reshape(-1)] = scene.corner_color.reshape(-1, 4)
    return colours


# Flat, and single points


@pytest.mark.parametrize("axis", range(3))
def test_a_flat_square_is_one_layer_of_voxels_and_a_linear_gradient_survives(axis):
    positions, faces = square(0.0)
    scene = scene_of(np.roll(positions, axis, axis=1), faces, [[0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]])
    texf, _ = coded(scene, qp=4, support="voxels")
    voxels = decode_morton(texf.fields[0].keys)
    assert len(voxels) == 64 * 64 and (voxels[:, (2 + axis) % 3] == 0).all()
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert colour_error(scene, texf)[1] <= 1


@pytest.mark.parametrize("positions, faces", [([[4, 5, 6]] * 3, [[0, 1, 2]]), ([[4, 5, 6]] * 3, [[0, 0, 0]]), ([], [])])
def test_a_single_point_and_nothing_are_refused_or_an_empty_stream(positions, faces):
    scene = scene_of(positions, faces)
    with pytest.raises(InputError) as caught:
        encode_scene(scene, EncodeOptions(resolution=64))
    assert caught.value.code == "TXF-I63"
    made = encode_scene(scene, EncodeOptions(resolution=64, allow_empty=True))
    texf, sizes = decode(made.data), made.sizes
    assert (texf.fields, len(texf.faces), len(texf.positions), len(texf.voxels()["xyz"])) == ([], 0, 0, 0)
    assert sizes["total"] <= 150
    for ask in (texf.query, texf.nearest_face):
        with pytest.raises(InputError, match="TXF-I70"):
            ask([[0, 0, 0]])


# Colours


def test_a_single_white_vertex_on_black_stays_within_12_levels_at_step_1():
    positions, faces = sphere(8)
    colours = np.tile([0.0, 0, 0, 1], (len(positions), 1))
    colours[40] = 1
    scene = scene_of(positions, faces, colours)
    texf, _ = coded(scene, qp=4, resolution=128)
    worst, mean = colour_error(scene, texf)
    assert texf.fields[0].rgba[:, :3].max() >= 240 and mean <= 0.1
    assert texf.fields[0].rgba[:, :3].min() == 0 and worst <= 12


# Broken and odd meshes


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_vertices_and_uvs_that_are_not_finite_are_refused(bad):
    positions, faces = square()
    with pytest.raises(InputError) as caught:
        encode(scene_of(np.where(positions == 1, bad, positions), faces))
    assert caught.value.code == "TXF-I14"
    scene = scene_of(positions, faces)
    scene.corner_uv[0, 0, 0] = bad
    with pytest.raises(InputError) as caught:
        encode(scene)
    assert caught.value.code == "TXF-I14"


def test_no_faces_and_only_degenerate_faces_are_refused():
    positions, faces = square()
    for rows, code in ((faces[:0], "TXF-I15"), ([[0, 1, 1], [2, 2, 2]], "TXF-I63")):
        with pytest.raises(InputError) as caught:
            encode(scene_of(positions, rows), EncodeOptions(resolution=16))
        assert caught.value.code == code


def test_degenerate_faces_among_good_ones_are_left_out():
    positions, faces = sphere(6)
    scene = scene_of(positions, np.concatenate([faces, [[0, 0, 1], [5, 5, 5], [3, 4, 3]]]))
    texf, _ = coded(scene)
    assert len(texf.faces) == len(faces)
    np.testing.assert_array_equal(triangles_of(texf), triangles_of(coded(scene_of(positions, faces))[0]))


def test_duplicate_and_flipped_faces_are_all_kept():
    positions, faces = sphere(6)
    scene = scene_of(positions, np.concatenate([faces, faces[:10], faces[20:30, ::-1]]))
    texf, _ = coded(scene)
    assert len(texf.faces) == len(faces) + 20
    assert_positions_are_within_half_a_lattice_step(scene, texf)


def test_three_faces_on_one_edge_and_a_vertex_shared_by_two_cones_are_kept():
    fan = scene_of([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0.2], [0.5, 0, 1]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    cones = scene_of([[0, 0, 0], [1, 0, 1], [0, 1, 1], [-1, -1, 1], [1, 0, -1], [0, 1, -1], [-1, -1, -1]],
                     [[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 5, 4], [0, 6, 5], [0, 4, 6]])
    for scene in (fan, cones):
        texf, _ = coded(scene)
        assert len(texf.faces) == len(scene.faces)
        assert_positions_are_within_half_a_lattice_step(scene, texf)


def test_vertices_that_no_face_uses_are_not_coded():
    positions, faces = square()
    texf, _ = coded(scene_of(np.concatenate([positions, [[0.2, 0.3, 0.5]] * 5]), faces))
    assert len(texf.positions) == 4


# Order


@pytest.mark.parametrize("make", [painted_sphere, crossing_sheets])
@pytest.mark.parametrize("seed", range(3))
def test_faces_vertices_start_corners_and_orientation_in_any_order_decode_to_the_same_field(make, seed):
    """Sums of the transfer are in binary32 and in face order, so a value may round to the other side: none does here. A fit adds
    up more of them, and some do."""
    texf, _ = coded(make(), qp=10, refine="off")
    other, _ = coded(shuffled(make(), seed), qp=10, refine="off")
    assert len(texf.fields) == len(other.fields)
    np.testing.assert_array_equal(triangles_of(texf), triangles_of(other))
    by_keys = lambda t: sorted(t.fields, key=lambda f: f.keys.tolist())  # which of two equal pieces is field 0 may differ
    for a, b in zip(by_keys(texf), by_keys(other), strict=True):
        np.testing.assert_array_equal(a.keys, b.keys)
        np.testing.assert_array_equal(a.rgba, b.rgba)


# Several fields, alpha, levels of detail


def test_crossing_sheets_keep_their_alpha_materials_and_metadata():
    scene = crossing_sheets()
    texf, _ = coded(scene, qp=4, support="voxels")
    assert texf.has_alpha and [m.name for m in texf.materials] == ["stone", "glass"]
    assert texf.materials[1].alpha_mode == 2 and texf.metadata == {"copyright": "none"}
    assert sorted(texf.face_material.tolist()) == [0, 0, 1, 1]
    alpha = texf.voxels()["rgba"][:, 3]
    assert alpha.min() < 100 and (alpha == 255).any()


# Limits of the encoder


@pytest.mark.parametrize("limits,code", [(Limits(vertices=113), "TXF-L02"), (Limits(faces=223), "TXF-L03"),
                                         (Limits(voxels=1000), "TXF-L04"), (Limits(samples=1000), "TXF-L05")])
def test_each_limit_refuses_a_mesh_that_is_over_it(limits, code):
    scene = painted_sphere(8)
    assert (len(scene.positions), len(scene.faces)) == (114, 224)
    with pytest.raises(LimitError) as caught:
        encode(scene, EncodeOptions(resolution=64, partition="off", limits=limits))
    assert caught.value.code == code


def test_metadata_over_the_limit_are_left_out_with_a_remark():
    scene, report = crossing_sheets(), Report()
    scene.metadata["extras"] = "x" * 1000
    data = encode_scene(scene, EncodeOptions(resolution=16, limits=Limits(metadata_bytes=500)), report).data
    assert decode(data).metadata == {} and any("metadata" in text and "limit" in text for text in report.remarks)
    assert report.warnings == report.dropped == []
