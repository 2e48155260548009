"""Hard meshes through encode() and decode(), each with a stated bound."""

import numpy as np
import pytest
from shapes import crossing_sheets, painted_sphere, scene_of, shuffled, sphere, square, triangles_of

from texfcodec.api import decode, encode, encode_to_result
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.errors import InputError, LimitError
from texfcodec.field.morton import decode_morton, encode_morton
from texfcodec.field.voxelise import voxelise
from texfcodec.geometry.areas import sample_surface
from texfcodec.io.load import load
from texfcodec.limits import Limits
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.fetch import pack_source, sample_source

BROWN = np.array([188, 124, 89])  # sRGB of the linear (0.5, 0.2, 0.1) of scene_of's material


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


# Scale and place


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e30, 1e140])
@pytest.mark.parametrize("position_bits", [8, 14, 20])
def test_a_sphere_of_any_size_keeps_its_shape_and_colour(scale, position_bits):
    scene = painted_sphere(8)
    scene.positions *= scale
    texf, _ = coded(scene, position_bits=position_bits, qp=4)
    assert texf.position_bits == position_bits and texf.lattice_positions.max() == 2**position_bits - 1
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    worst, mean = colour_error(scene, texf)
    assert worst <= 6 and mean <= 0.7


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


@pytest.mark.parametrize("extent", [1.0, 1e-3, 1e-6])
def test_tiny_extents_far_from_the_origin_keep_what_binary64_left_of_them(extent):
    scene = painted_sphere(8)
    scene.positions = scene.positions * extent + 1e7
    texf, _ = coded(scene)
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert len(texf.faces) == len(scene.faces) and len(texf.fields[0].keys) > 10000


def test_the_asset_with_huge_coordinates_keeps_every_position(shared_dir):
    scene = load(shared_dir / "assets" / "hard_hugecoord.glb")
    made = encode_to_result(shared_dir / "assets" / "hard_hugecoord.glb", EncodeOptions(resolution=128, qp=28))
    texf = decode(made.data)
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert len(texf.faces) == made.counts["faces"] > 0


# Flat, linear, single points, slivers


@pytest.mark.parametrize("axis", range(3))
def test_a_flat_square_is_one_layer_of_voxels_and_a_linear_gradient_survives(axis):
    positions, faces = square(0.0)
    scene = scene_of(np.roll(positions, axis, axis=1), faces, [[0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [0, 1, 0, 1]])
    texf, _ = coded(scene, qp=4, support="voxels")
    voxels = decode_morton(texf.fields[0].keys)
    assert len(voxels) == 64 * 64 and (voxels[:, (2 + axis) % 3] == 0).all()
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert colour_error(scene, texf)[1] <= 1


def test_collinear_corners_make_a_line_of_voxels_of_its_colour():
    """A face without area is sampled along half of its length; the rest asks the nearest voxel."""
    scene = scene_of([[0, 0, 0], [1, 2, 3], [2, 4, 6]], [[0, 1, 2]])
    texf, _ = coded(scene)
    voxels = decode_morton(texf.fields[0].keys)
    assert 28 <= len(voxels) <= 100 and np.ptp(voxels[:, 2]) >= 30
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    got = texf.query(np.linspace([0, 0, 0], [2, 4, 6], 40))
    assert np.abs(got[:, :3] - BROWN).max() <= 1


@pytest.mark.parametrize("positions, faces, code", [([[4, 5, 6]] * 3, [[0, 1, 2]], "TXF-I63"), ([], [], "TXF-I15"),
                                                    ([[4, 5, 6]] * 3, [[0, 0, 0]], "TXF-I63")])
def test_a_single_point_and_nothing_are_refused_or_an_empty_stream(positions, faces, code):
    scene = scene_of(positions, faces)
    with pytest.raises(InputError) as caught:
        coded(scene)
    assert caught.value.code == code
    texf, sizes = coded(scene, allow_empty=True)
    assert (texf.fields, len(texf.faces), len(texf.positions), len(texf.voxels()["xyz"])) == ([], 0, 0, 0)
    assert sizes["total"] <= 150
    for ask in (texf.query, texf.nearest_face):
        with pytest.raises(InputError, match="TXF-I70"):
            ask([[0, 0, 0]])


@pytest.mark.parametrize("position_bits", [8, 20])
def test_slivers_of_aspect_a_million_keep_positions_and_colour(position_bits):
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    sliver = np.array([[0, 0, 0], [1, 0, 0], [0.4, 1e-6, 0], [0, 0, 0.3], [1, 0, 0.3], [0.4, 0, 0.3 + 1e-6]]) @ turn
    scene = scene_of(sliver, [[0, 1, 2], [3, 4, 5]])
    texf, _ = coded(scene, position_bits=position_bits)
    assert len(texf.faces) == 2
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert colour_error(scene, texf)[0] <= 1


# Voxel boundaries


def test_vertices_and_edges_on_voxel_boundaries_give_full_voxels_on_one_side_only():
    """The box is 0..255 with 8 bits, so lattice = world; K = 16 puts a boundary at every multiple of 16."""
    positions = [[0, 0, 0], [255, 255, 255], [0, 0, 1]]  # pins the cube to 0..255 with a sliver
    board = [[16 * i, 16 * j, 128] for i in (2, 10) for j in (3, 11)]
    scene = scene_of(positions + board, [[0, 1, 2], [3, 5, 6], [3, 6, 4]])
    texf, _ = coded(scene, resolution=16, position_bits=8, partition="off")
    voxels = set(map(tuple, decode_morton(texf.fields[0].keys).tolist()))
    inside = {(x, y, 8) for x in range(2, 10) for y in range(3, 11)}
    assert inside <= voxels
    assert all(max(v) - min(v) <= 1 for v in voxels - inside)  # the rest is the diagonal
    assert_positions_are_within_half_a_lattice_step(scene, texf)


# Very small and very large triangles


def test_a_hundred_thousand_triangles_in_one_voxel_keep_their_colour_within_one():
    rng = np.random.default_rng(0)
    crowd = np.concatenate([rng.uniform(0, 0.05, (50_000, 3)), [[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    faces = rng.integers(0, 50_000, (100_000, 3))
    faces = np.concatenate([faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)], [[50_000, 50_001, 50_002]]])
    texf, sizes = coded(scene_of(crowd, faces), resolution=16, position_bits=20, partition="off")
    assert len(texf.faces) == len(faces)
    assert np.abs(texf.fields[0].rgba[:, :3].astype(int) - BROWN).max() <= 1
    assert sizes["attributes"] <= 100


@pytest.mark.parametrize("resolution", [64, 400])
def test_triangles_as_large_as_the_cube_cover_it(resolution):
    corners = [[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]
    scene = scene_of(corners, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    texf, _ = coded(scene, resolution=resolution, partition="off")
    face, bary = sample_surface(scene.positions, scene.faces, 5000)
    grid = texf.cube.to_grid(np.einsum("nc,ncd->nd", bary, scene.positions[scene.faces[face]]), resolution)
    voxels = set(map(tuple, decode_morton(texf.fields[0].keys).tolist()))
    alone = sum(tuple(v) not in voxels for v in np.clip(np.floor(grid), 0, resolution - 1).astype(int).tolist())
    assert alone <= 0.03 * len(grid)  # points in voxels that hold less than 77/256 of a face


# Grid resolutions, steps, position bits


@pytest.mark.parametrize("resolution", range(1, 65))
def test_every_resolution_to_64_has_voxels_in_its_grid_and_the_mean_colour(resolution):
    scene = painted_sphere(6)
    texf, _ = coded(scene, resolution=resolution, qp=10, partition="off", refine="off")  # a fit need not keep the mean
    voxels = decode_morton(texf.fields[0].keys)
    assert voxels.min() >= 0 and voxels.max() < resolution == texf.resolution
    assert resolution == 1 or voxels.max() >= resolution - 2
    mean = sample_source(pack_source(scene), *sample_surface(scene.positions, scene.faces, 4000))[:, :3].mean(axis=0)
    assert np.abs(texf.fields[0].rgba[:, :3].mean(axis=0) - mean).max() <= (2 if resolution > 1 else 5)


def test_resolution_8192_of_a_small_mesh_is_exact_in_place_and_near_in_colour():
    """Three thin strips along the axes, one voxel wide and 8192 long."""
    width = 1 / 8192
    strips = [[[0, 0, 0], [1, 0, 0], [1, width, 0], [0, width, 0]], [[0, 0, 0], [0, 1, 0], [0, 1, width], [0, 0, width]],
              [[0, 0, 0], [0, 0, 1], [width, 0, 1], [width, 0, 0]]]
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(3)])
    ends = np.random.default_rng(1).uniform(0, 1, (6, 4))  # colours run along the strips
    colours = ends[[0, 1, 1, 0, 2, 3, 3, 2, 4, 5, 5, 4]]
    scene = scene_of(np.concatenate(strips), faces, colours)
    texf, _ = coded(scene, resolution=8192, position_bits=20, partition="off", qp=10)
    voxels = decode_morton(texf.fields[0].keys)
    assert texf.resolution == 8192 and voxels.max() == 8191 and len(voxels) >= 3 * 8191
    assert_positions_are_within_half_a_lattice_step(scene, texf)
    assert colour_error(scene, texf)[1] <= 3


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


def test_needles_that_meet_in_a_point_are_covered_from_end_to_end():
    """4000 faces of 0.3 voxels by 1000: at least 99 % of the surface lies in active voxels, in every tenth of the height."""
    n = 4000
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rim = np.stack([8000 + 3000 * np.cos(angle), 8000 + 3000 * np.sin(angle), np.full(n, 100.0)], axis=1)
    lattice = np.rint(np.concatenate([[[8000, 8000, 16000]], rim])).astype(np.int64)
    faces = np.stack([np.zeros(n, np.int64), 1 + np.arange(n), 1 + (np.arange(n) + 1) % n], axis=1)
    keys, _ = voxelise(lattice, faces, 14, 1024)
    face, bary = sample_surface(lattice, faces, 100_000)
    points = np.einsum("nc,ncd->nd", bary, lattice[faces[face]])
    inside = np.isin(encode_morton((points // 16).astype(np.int64)), keys)
    tenth = np.minimum((points[:, 2] - 100) // 1590, 9).astype(np.int64)
    assert inside.mean() >= 0.99 and (np.bincount(tenth, inside) / np.bincount(tenth)).min() >= 0.98
