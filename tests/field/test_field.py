"""The field room: every kernel against its oracle on random and extreme input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import painted_sphere, scene_of, sphere

from oracles import kernels as oracles
from texfcodec import EncodeOptions, InputError, decode
from texfcodec.core.integer import _isqrt, _ones
from texfcodec.encoder.decide.contacts import (
    colour_pieces,
    face_components,
    face_directions,
    find_contacts,
    folding_components,
)
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.errors import LimitError
from texfcodec.field import transfer as transfer_room
from texfcodec.field import voxelise as voxelise_room
from texfcodec.field.grid import _rank, build_brick_map
from texfcodec.field.morton import _morton_key, decode_morton, encode_morton
from texfcodec.field.query import nearest_of_all, query_field
from texfcodec.field.surface_walk import _double_area, grid_coordinates
from texfcodec.field.transfer import transfer
from texfcodec.field.voxelise import count_samples, voxelise
from texfcodec.scene.fetch import pack_source
from texfcodec.scene.scene import ALPHA_BLEND, Material, Scene

ONE_VOXEL_FACE = 1 << 32


def soup(rng, bits, count, reach=None):
    """Random triangles, no vertex shared: lattice int64 [3 n, 3], faces int64 [n, 3]; reach: largest extent in lattice steps."""
    last = (1 << bits) - 1
    centre = rng.integers(0, last + 1, (count, 1, 3))
    spread = rng.integers(-(reach or last), (reach or last) + 1, (count, 3, 3))
    return np.clip(centre + spread, 0, last).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def assert_voxels_are_the_oracles(lattice, faces, bits, resolution, threshold=0):
    keys, weights = voxelise(lattice, faces, bits, resolution, threshold)
    expected = oracles.voxelise(lattice.tolist(), faces.tolist(), bits, resolution, threshold)
    assert dict(zip(keys.tolist(), weights.tolist(), strict=True)) == expected
    assert keys.tolist() == sorted(expected)


# Morton order


@settings(deadline=None, max_examples=200)
@given(st.tuples(*[st.integers(0, 65535)] * 3))
def test_morton_keys_are_made_one_bit_at_a_time_and_go_back(voxel):
    key = oracles.morton(*voxel)
    assert encode_morton(np.array([voxel])).tolist() == [key] == [_morton_key(*voxel)]
    assert decode_morton(np.array([key])).tolist() == [list(voxel)] == [list(oracles.voxel_of(key))]


def test_morton_order_of_the_extreme_voxels():
    assert encode_morton(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [8191] * 3])).tolist() == [0, 1, 2, 4, 8**13 - 1]


# Integer roots and areas


@settings(deadline=None, max_examples=300)
@given(st.integers(0, (1 << 31) - 1), st.integers(-2, 2))
def test_isqrt_is_exact_around_every_square(root, off):
    value = min(max(root * root + off, 0), (1 << 62) - 1)
    assert _isqrt(value) == math.isqrt(value)


@settings(deadline=None, max_examples=200)
@given(st.integers(0, (1 << 62) - 1))
def test_isqrt_is_exact_below_2_to_62(value):
    assert _isqrt(value) == math.isqrt(value)


EDGE = st.one_of(st.integers(-(1 << 29), 1 << 29), st.integers(-3, 3), st.sampled_from([-(1 << 29), 1 << 29]))


@settings(deadline=None, max_examples=300)
@given(st.tuples(*[EDGE] * 3), st.tuples(*[EDGE] * 3))
def test_double_area_is_the_oracles_and_within_2_to_minus_27_of_the_exact_one(u, v):
    got = _double_area(*u, *v)
    assert got == oracles.double_area(u, v)
    exact = oracles.exact_double_area(u, v)
    assert abs(got - exact) <= exact >> 27


@settings(deadline=None)
@given(st.integers(8, 20), st.integers(1, 8192), st.floats(0, 1))
def test_grid_coordinates_are_rounded_down_exactly(bits, resolution, place):
    p = int(place * ((1 << bits) - 1))
    got = grid_coordinates(np.array([p]), bits, resolution)[0]
    assert got == (p * resolution * 65536) // 2**bits < resolution * 65536


# Voxelisation


@pytest.mark.parametrize("resolution", range(1, 65))
def test_voxels_and_weights_are_the_oracles_at_resolution(resolution):
    rng = np.random.default_rng(resolution)
    for bits, reach in ((8, None), (14, 1 << 9), (20, 3)):
        assert_voxels_are_the_oracles(*soup(rng, bits, 2, reach), bits, resolution)


@pytest.mark.parametrize("bits", [12, 14, 20])
def test_voxels_at_resolution_8192_are_the_oracles_for_tiny_triangles_and_for_slivers_across_the_cube(bits):
    rng, last = np.random.default_rng(bits), (1 << bits) - 1
    near = max(1, (20 << bits) >> 13)
    assert_voxels_are_the_oracles(*soup(rng, bits, 4, near), bits, 8192)
    slivers = np.array([[0, 0, 0], [last, last, last], [last, last, last - 1],
                        [0, last, 0], [last, 0, 1], [last, 0, 0]])
    assert_voxels_are_the_oracles(slivers, np.array([[0, 1, 2], [3, 4, 5]]), bits, 8192)


@settings(deadline=None, max_examples=150)
@given(st.lists(st.tuples(*[st.one_of(st.integers(0, 255), st.sampled_from([0, 128, 255]))] * 3), min_size=3, max_size=5),
       st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=1, max_size=3), st.integers(1, 40), st.sampled_from([0, 77, 300]))
def test_voxels_are_the_oracles_for_degenerate_and_repeated_faces(lattice, faces, resolution, threshold):
    assert_voxels_are_the_oracles(np.array(lattice), np.array(faces), 8, resolution, threshold)


def test_the_largest_triangle_touches_every_voxel_of_its_plane():
    corner = np.array([[0, 0, 0], [255, 0, 0], [0, 255, 0], [255, 255, 0]])
    keys, _ = voxelise(corner, np.array([[0, 1, 2], [1, 3, 2]]), 8, 64)
    assert sorted(map(tuple, decode_morton(keys).tolist())) == [(x, y, 0) for x in range(64) for y in range(64)]


def test_a_surface_on_a_voxel_boundary_lies_in_the_upper_voxels():
    """K = 16 on 2**8: lattice 16 k is exactly the boundary between voxels k - 1 and k."""
    corner = np.array([[32, 32, 64], [96, 32, 64], [96, 96, 64], [32, 96, 64]])
    keys, weights = voxelise(corner, np.array([[0, 1, 2], [0, 2, 3]]), 8, 16)
    assert sorted(map(tuple, decode_morton(keys).tolist())) == [(x, y, 4) for x in range(2, 6) for y in range(2, 6)]
    assert 16 * (ONE_VOXEL_FACE - 4) <= weights.sum() <= 16 * ONE_VOXEL_FACE


@pytest.mark.parametrize("axis", range(3))
def test_a_face_without_width_touches_every_voxel_of_its_length(axis):
    """Its one row of samples is its longest side (6.3); the line lies on voxel boundaries of both other axes."""
    line = np.full((3, 3), 16)
    line[:, axis] = [0, 64, 192]
    keys, weights = voxelise(line, np.array([[0, 1, 2]]), 8, 16)
    voxels = decode_morton(keys)
    assert voxels[:, axis].tolist() == list(range(12)) and not weights.any()
    assert (np.delete(voxels, axis, axis=1) == 1).all()


def test_points_touch_the_one_voxel_they_lie_in():
    for p in ([0, 0, 0], [255, 255, 255], [16, 15, 17]):
        keys, weights = voxelise(np.array([p]), np.array([[0, 0, 0]]), 8, 16)
        assert decode_morton(keys).tolist() == [[v // 16 for v in p]] and weights.tolist() == [0]


@pytest.mark.parametrize("resolution,reach", [(7, None), (64, None), (256, 1 << 13), (1024, 1 << 4)])
def test_weights_add_up_to_the_area_less_one_unit_per_sample_and_row_pair(resolution, reach):
    """Every division of 6.2 and 6.3 rounds down: unit loses below rows**2 <= 4 * samples, each sample below one unit."""
    lattice, faces = soup(np.random.default_rng(resolution), 14, 40, reach)
    g = grid_coordinates(lattice, 14, resolution)[faces].tolist()
    minus = lambda a, b: [i - j for i, j in zip(a, b, strict=True)]
    area = sum(oracles.double_area(minus(t[1], t[0]), minus(t[2], t[0])) for t in g) / 2
    total = int(voxelise(lattice, faces, 14, resolution)[1].sum())
    slack = 8 * count_samples(lattice, faces, 14, resolution) + 2.0**-26 * area
    assert area - slack <= total <= area + 2.0**-26 * area


@pytest.mark.parametrize("seed", range(4))
def test_voxels_do_not_depend_on_the_order_of_faces_vertices_and_corners(seed):
    rng = np.random.default_rng(seed)
    lattice, faces = soup(rng, 12, 60, 1 << (4 + 2 * seed))
    keys, weights = voxelise(lattice, faces, 12, 100)
    place = rng.permutation(len(lattice))
    moved = np.empty_like(lattice)
    moved[place] = lattice
    other = place[faces][rng.permutation(len(faces))]
    other = np.array([row[rng.permutation(3)] for row in other])
    keys2, weights2 = voxelise(moved, other, 12, 100)
    np.testing.assert_array_equal(keys2, keys)
    np.testing.assert_array_equal(weights2, weights)


@pytest.mark.parametrize("threads", [2, 3, 8])
def test_voxels_do_not_depend_on_the_slabs_they_are_made_in(threads, monkeypatch):
    lattice, faces = soup(np.random.default_rng(5), 12, 80, 1 << 9)
    alone = voxelise(lattice, faces, 12, 128)
    monkeypatch.setattr(voxelise_room, "MIN_SLAB_SAMPLES", 1)
    corners = grid_coordinates(lattice, 12, 128)
    assert len(voxelise_room._slabs(corners, faces, np.ones(len(faces), np.int64), 128, threads)[1]) == threads + 1
    for a, b in zip(alone, voxelise(lattice, faces, 12, 128, threads=threads), strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_faces_touch_no_voxels():
    keys, weights = voxelise(np.zeros((0, 3), np.int64), np.zeros((0, 3), np.int64), 8, 16)
    assert len(keys) == len(weights) == 0


@pytest.mark.parametrize("face", [[0, 1, 3], [0, -1, 2]])
def test_voxelise_refuses_faces_outside_the_vertex_list(face):
    with pytest.raises(IndexError, match="outside the vertex list"):
        voxelise(np.zeros((3, 3), np.int64), np.array([face]), 8, 16)


def test_a_surface_over_the_voxel_limit_is_refused():
    corner = np.array([[0, 0, 0], [255, 0, 0], [0, 255, 0]])
    touched = len(voxelise(corner, np.array([[0, 1, 2]]), 8, 64)[0])
    assert len(voxelise(corner, np.array([[0, 1, 2]]), 8, 64, max_voxels=touched)[0]) == touched
    with pytest.raises(LimitError) as caught:
        voxelise(corner, np.array([[0, 1, 2]]), 8, 64, max_voxels=touched - 1)
    assert caught.value.code == "TXF-L04"


@pytest.mark.parametrize("resolution,reach", [(1, None), (64, None), (8192, 40)])
def test_count_samples_is_an_upper_bound_and_at_most_a_third_over(resolution, reach):
    lattice, faces = soup(np.random.default_rng(9), 14, 6, reach)
    taken = 0
    for t in grid_coordinates(lattice, 14, resolution)[faces].tolist():
        *_, columns, rows, _ = oracles.frame(*sorted(map(tuple, t)))
        taken += sum(max(1, -(-columns * (2 * rows - 2 * j - (columns <= 4 * rows)) // (2 * rows))) for j in range(rows))
    assert taken <= count_samples(lattice, faces, 14, resolution) <= 2 * taken


# Brick map


@pytest.mark.parametrize("side,count", [(1, 1), (8, 512), (64, 3000), (8192, 3000), (65536, 500)])
def test_the_brick_map_knows_what_a_dict_knows(side, count):
    rng = np.random.default_rng(side)
    xyz = np.unique(rng.integers(0, side, (count, 3)), axis=0)
    keys = np.sort(encode_morton(xyz))
    known, arrays = {key: i for i, key in enumerate(keys.tolist())}, build_brick_map(keys).arrays
    asked = np.concatenate([keys, keys ^ 1, keys ^ (1 << 9), encode_morton(rng.integers(0, side, (500, 3)))])
    assert [_rank(int(k), *arrays) for k in asked] == [known.get(int(k), -1) for k in asked]


def test_an_empty_brick_map_knows_nothing():
    arrays = build_brick_map(np.zeros(0, np.int64)).arrays
    assert [_rank(k, *arrays) for k in (0, 511, 8**13 - 1)] == [-1, -1, -1]


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ones_of_a_word_are_counted(word):
    assert _ones(word) == word.bit_count()


# Query


def field_of(voxels):
    """(keys, brick map, values uint8 [N, 1]) of a dict from voxel to value."""
    keys = encode_morton(np.array(list(voxels)))
    order = np.argsort(keys)
    return keys[order], build_brick_map(keys[order]), np.array(list(voxels.values()), np.uint8)[order, None]


def assert_answers_are_the_oracles(points, voxels, size):
    keys, brick_map, values = field_of(voxels)
    got = query_field(np.array(points, np.float64), size, keys, brick_map, values)[0][:, 0]
    for point, answer in zip(points, got.tolist(), strict=True):
        low, high = oracles.query(point, voxels)
        assert low - 1e-3 <= answer <= high + 1e-3, point


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_query_is_within_a_thousandth_of_the_exact_trilinear_answer(data):
    """Points on a raster of 1/1024 of a voxel, so that no weight is lost between 0 and 1e-9."""
    voxel = st.tuples(*[st.integers(0, 4)] * 3)
    voxels = data.draw(st.dictionaries(voxel, st.integers(0, 255), min_size=20, max_size=120))
    place = st.one_of(st.integers(-512, 5632).map(lambda i: i / 1024), st.integers(0, 10).map(lambda i: i / 2))
    points = data.draw(st.lists(st.tuples(place, place, place), min_size=1, max_size=8))
    assert_answers_are_the_oracles(points, voxels, 5)


def test_points_outside_everything_get_the_nearest_voxel():
    rng = np.random.default_rng(1)
    voxels = {tuple(v): i for i, v in enumerate(rng.integers(0, 60, (40, 3)).tolist())}
    points = [*rng.uniform(-200, 260, (60, 3)).tolist(), [-1e5, 30.0, 30.0], [30.0, 9e5, 2.0]]
    assert_answers_are_the_oracles(points, voxels, 60)


def test_a_nearer_voxel_just_outside_the_search_cube_wins():
    """(13, 13, 13) is 5.0 away and inside the cube of three rings, (14, 10, 10) is 4.4 away and outside."""
    assert_answers_are_the_oracles([(10.1, 10.5, 10.5)], {(13, 13, 13): 1, (14, 10, 10): 2}, 32)


def test_a_point_one_ulp_from_eight_voxels_gets_the_one_active_value():
    ulp = float(np.nextafter(0.5, 1.0))
    assert_answers_are_the_oracles([(ulp, ulp, ulp)], {(1, 1, 1): 200}, 8)


def test_query_does_not_depend_on_threads_or_blocks():
    rng = np.random.default_rng(2)
    keys = np.unique(encode_morton(rng.integers(0, 40, (3000, 3))))
    values, points = rng.integers(0, 256, (len(keys), 4)).astype(np.uint8), rng.uniform(0, 40, (70000, 3))
    brick_map = build_brick_map(keys)
    one, many = (query_field(points, 40, keys, brick_map, values, t)[0] for t in (1, 3))
    np.testing.assert_array_equal(one, many)
    np.testing.assert_array_equal(query_field(points[-100:], 40, keys, brick_map, values)[0], one[-100:])


def test_questions_that_have_no_answer_are_refused():
    texf = decode(encode_scene(painted_sphere(4), EncodeOptions(resolution=8, qp=40, threads=1)).data)
    points = texf.positions[:3]
    for wrong in ("here", [[1, 2]], [1, 2, 3, 4], object()):
        with pytest.raises(InputError, match="TXF-I72"):
            texf.query(wrong)
    for faces in ([0, 1], [0.0, 1.0, 2.0], [0, 1, len(texf.faces)], [0, 1, -1]):
        with pytest.raises(InputError, match="TXF-I72"):
            texf.query(points, faces)
    for value in (np.nan, np.inf, -np.inf):
        with pytest.raises(InputError, match="TXF-I71") as refused:
            texf.query([[0, 0, 0], [0, 0, value]])
        assert refused.value.details["value"] == 1
    assert texf.query(np.zeros((0, 3))).shape == (0, 4) and texf.query(points, [0, 1, 2]).shape == (3, 4)


@pytest.mark.parametrize("seed", range(12))
def test_nearest_voxel_of_all_is_the_nearest(seed):
    random = np.random.default_rng(seed)
    resolution, count = int(random.choice([1, 2, 7, 64, 1000, 8192])), int(random.choice([1, 5, 400]))
    keys = np.unique(encode_morton(random.integers(0, resolution, (count, 3))))
    points = np.concatenate([random.uniform(-0.2, 1.2, (60, 3)) * resolution, random.choice([-1e6, 0.0, 3.5, 1e6], (20, 3)),
                             random.integers(0, resolution + 1, (20, 3))])
    square = ((points[:, None] - (decode_morton(keys) + 0.5)) ** 2).sum(axis=2)
    found = nearest_of_all(points, resolution, keys)
    assert np.allclose(square[np.arange(len(points)), found], square.min(axis=1), rtol=1e-13)


def test_of_voxels_equally_near_the_first_answers():
    keys = np.unique(encode_morton(np.array([[0, 0, 0], [20, 0, 0], [0, 20, 0]])))
    assert nearest_of_all(np.array([[20.5, 20.5, 0.5], [10.5, 10.5, 0.5]]), 32, keys).tolist() == [1, 0]


# Transfer


def coloured_faces(count, seed):
    """Random triangles, each with a material of its own flat colour: (lattice, faces, source, sRGB colours [n, 3])."""
    rng = np.random.default_rng(seed)
    lattice, faces = soup(rng, 10, count, 200)
    factors = np.column_stack([rng.uniform(0, 1, (count, 3)), np.ones(count)])
    scene = Scene(lattice.astype(float), faces, np.arange(count), np.zeros((count, 3, 2)), None,
                  [Material(factor=f) for f in factors], [])
    linear = factors[:, :3]
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255
    return lattice, faces, pack_source(scene), srgb


def test_transfer_is_the_oracles_area_weighted_mean_within_a_twentieth():
    """The curve's table steps by 1/4096, which is worth up to 0.05 grey levels near black."""
    lattice, faces, source, srgb = coloured_faces(12, 3)
    keys, _ = voxelise(lattice, faces, 10, 24)
    colour, alpha = transfer(lattice, faces, source, 10, 24, keys, build_brick_map(keys))
    weights = [oracles.voxelise(lattice.tolist(), [f], 10, 24) for f in faces.tolist()]
    for i, key in enumerate(keys.tolist()):
        share = np.array([w.get(key, 0) / 2**32 for w in weights])
        if share.sum() > 0.01:
            np.testing.assert_allclose(colour[i], share @ srgb / share.sum(), atol=0.05)
    np.testing.assert_allclose(alpha, 255, atol=1e-3)


def test_a_crowd_of_faces_in_one_place_has_the_colour_of_one():
    """Sums in binary32 would be off by 0.3 levels here, and by 13 under a million faces."""
    lattice, faces = np.array([[0, 0, 0], [1023, 0, 0], [0, 1023, 0]]), np.array([[0, 1, 2]])
    scene = scene_of(lattice, faces, np.tile([0.31, 0.155, 0.103, 0.7], (3, 1)))
    scene.materials[0].alpha_mode = ALPHA_BLEND
    keys, _ = voxelise(lattice, faces, 10, 1)
    brick_map = build_brick_map(keys)
    one = transfer(lattice, faces, pack_source(scene), 10, 1, keys, brick_map)
    many = np.zeros(20_000, np.int64)
    crowd = transfer(lattice, faces[many], pack_source(scene, many), 10, 1, keys, brick_map)
    for a, b in zip(one, crowd, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-3)


@pytest.mark.parametrize("threads", [2, 3, 8])
def test_transfer_does_not_depend_on_threads(threads, monkeypatch):
    lattice, faces, source, _ = coloured_faces(30, 4)
    keys, _ = voxelise(lattice, faces, 10, 60)
    brick_map = build_brick_map(keys)
    alone = transfer(lattice, faces, source, 10, 60, keys, brick_map, 4)
    monkeypatch.setattr(voxelise_room, "MIN_SLAB_SAMPLES", 1)
    assert transfer_room._slabs is voxelise_room._slabs
    for a, b in zip(alone, transfer(lattice, faces, source, 10, 60, keys, brick_map, 4, threads), strict=True):
        np.testing.assert_array_equal(a, b)


def test_fully_transparent_voxels_take_the_colour_of_the_nearest_ancestor():
    keys = np.array([0, 7, 8, 64])
    colour, weight = np.array([[10.0], [0], [0], [30]], np.float32), np.array([2.0, 0, 0, 6], np.float32)
    transfer_room.fill_uncoloured(keys, colour, weight)
    assert colour[:, 0].tolist() == [10, 10, 10, 30]


# Partition


def test_components_are_those_of_a_flood_over_shared_edges():
    rng = np.random.default_rng(6)
    faces = rng.integers(0, 60, (40, 3))
    faces = faces[[len(set(f)) == 3 for f in faces.tolist()]]
    edges = [{frozenset(e) for e in ((a, b), (b, c), (c, a))} for a, b, c in faces.tolist()]
    expected, left = [], set(range(len(faces)))
    while left:
        group, front = set(), [min(left)]
        while front:
            f = front.pop()
            if f not in group:
                group.add(f)
                front += [g for g in left if edges[f] & edges[g]]
        left -= group
        expected.append(group)
    got = face_components(faces)
    assert sorted(map(sorted, expected)) == sorted(sorted(np.flatnonzero(got == c).tolist()) for c in set(got.tolist()))


def test_directions_are_the_dominant_signed_axis():
    lattice = np.array([[0, 0, 0], [10, 0, 1], [0, 10, 1], [1, 0, 10]])
    assert face_directions(lattice, np.array([[0, 1, 2], [0, 2, 1], [0, 3, 1], [0, 1, 3], [0, 2, 3]])).tolist() == [4, 5, 2, 3, 0]


def sheet(z, steps=8, size=1 << 12):
    """A welded square sheet of 2 * steps**2 faces at height z: (lattice, faces)."""
    line = np.arange(steps + 1) * (size // steps)
    x, y = np.meshgrid(line, line, indexing="ij")
    a = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + steps + 1, a + steps + 2], 1), np.stack([a, a + steps + 2, a + 1], 1)])
    return np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3), faces


def test_sheets_in_the_same_voxels_get_fields_of_their_own_and_far_ones_share():
    parts = [sheet(z) for z in (100, 110, 3000)]
    starts = np.cumsum([0] + [len(p) for p, _ in parts])
    lattice = np.concatenate([p for p, _ in parts])
    faces = np.concatenate([f + s for (_, f), s in zip(parts, starts[:-1], strict=True)])
    fields = colour_pieces(find_contacts(lattice, faces, 13, 64)).reshape(3, -1)
    assert all(len(set(row.tolist())) == 1 for row in fields)
    assert fields[0, 0] != fields[1, 0] and fields.max() == 1


def test_a_folded_sheet_is_found_and_its_sides_parted():
    low, faces = sheet(100)
    high, _ = sheet(120)
    steps = 8
    lattice = np.concatenate([low, high])
    rim = np.arange(steps)  # the x = 0 edge joins the sheets
    over = len(low)
    band = np.concatenate([np.stack([rim, rim + 1, rim + over], 1), np.stack([rim + 1, rim + over + 1, rim + over], 1)])
    faces = np.concatenate([faces, faces[:, ::-1] + over, band])
    contacts = find_contacts(lattice, faces, 13, 64)
    folding = folding_components(contacts)
    assert contacts.component.max() == 0 and folding.tolist() == [0]
    fields = colour_pieces(contacts, folding)
    side = len(sheet(0)[1])
    assert set(fields[:side].tolist()) != set(fields[side : 2 * side].tolist()) and fields.max() == 1


def test_a_round_surface_is_one_field():
    positions, faces = sphere(12)
    lattice = np.rint((positions + 1) * 4000).astype(np.int64)
    contacts = find_contacts(lattice, faces, 13, 256)
    assert folding_components(contacts).tolist() == [] and colour_pieces(contacts).max() == 0


@pytest.mark.parametrize("cut", range(2, 16, 2))
def test_a_triangle_that_begins_on_a_cut_between_slabs_loses_no_voxel(cut, monkeypatch):
    """K = 16 on 2**20: one lattice step is one unit of 6.1. Both divisions of a row round down, so that samples of a triangle
    whose least y is on a voxel boundary fall below it; whichever slab that is, must look at the triangle."""
    edge = cut << 16
    lattice = np.array([[0, edge + 1, 0], [1 << 19, edge, 0], [1 << 18, edge, 1 << 19], [0, 0, 1], [9, 1048575, 1], [9, 5, 1]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    keys, weights = voxelise(lattice, faces, 20, 16, threads=1)
    assert cut - 1 in decode_morton(keys)[decode_morton(keys)[:, 0] > 0, 1]
    monkeypatch.setattr(voxelise_room, "_slabs", lambda *_: (1, [0, cut, 16]))
    cut_keys, cut_weights = voxelise(lattice, faces, 20, 16, threads=2)
    assert np.array_equal(keys, cut_keys) and np.array_equal(weights, cut_weights)
