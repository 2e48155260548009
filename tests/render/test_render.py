"""The render room: coverage is exact, the nearest face wins, pictures are what the source and the field say."""

import json
import math
from functools import partial

import numpy as np
import pytest
from PIL import Image
from shapes import painted_sphere, scene_of, square

from oracles import raster as naive
from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError
from texfcodec.field.query import query_field
from texfcodec.field.voxels import VoxelSupport
from texfcodec.geometry.canonical import CanonicalCube
from texfcodec.geometry.geometry_unit import GeometryUnit
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.render.backdrop import GREY, rows
from texfcodec.render.camera import (
    VIEWS,
    Camera,
    bounding_sphere,
    direction_of_angles,
    fibonacci_direction,
    orthographic,
    perspective,
    perspective_around,
    project,
)
from texfcodec.render.difference import compare, heat_colour, sheet
from texfcodec.render.levels import Pyramid
from texfcodec.render.raster import rasterise
from texfcodec.render.shade import box_down, render_scene, render_texf, shade_field, shade_source
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_MASK, Material, Scene, Texture
from texfcodec.texf import Field, Texf

RED, GREEN, BLUE = (1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)


def pixel_camera(size):
    """Orthographic from the front with one pixel per unit: world (x, y) is pixel (x, height - y)."""
    width, height = size
    return Camera(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0]), np.array([width / 2, height / 2, 100.0]),
                  False, height / 2, width, height)


def coded(scene, resolution, qp=4, **more):
    """The scene through the codec: Texf."""
    return decode(encode_scene(scene, EncodeOptions(resolution=resolution, qp=qp, effort="fast", **more)).data)


def cube_mesh(side=1.0):
    """Closed cube round the origin, faces outwards: (positions, faces)."""
    positions = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64) * side / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return positions, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


def stack(colours, modes, cutoff=0.5, double_sided=False):
    """Unit squares at z = 0, 1, ..., each with a material of its own: (factor, alpha mode) from the back to the front."""
    parts = [square(float(z)) for z in range(len(colours))]
    positions = np.concatenate([p for p, _ in parts])
    faces = np.concatenate([f + 4 * i for i, (_, f) in enumerate(parts)])
    materials = [Material(factor=np.array(c, np.float64), alpha_mode=m, alpha_cutoff=cutoff, double_sided=double_sided)
                 for c, m in zip(colours, modes, strict=True)]
    return scene_of(positions, faces, materials=materials, face_material=np.repeat(np.arange(len(parts)), 2))


def front(scene, size=8, radius=0.4):
    """Camera in front of the middle of a stack."""
    return orthographic((0, 0, 1), (0.5, 0.5, 0), radius, size)


# Cameras


def test_front_looks_along_minus_z_with_y_up_and_x_to_the_right():
    camera = orthographic(VIEWS["front"], (0, 0, 0), 1.0, 100)
    assert np.array_equal(camera.forward, (0, 0, -1)) and np.array_equal(camera.up, (0, 1, 0))
    x, y, depth, w = project(camera, np.array([[0.5, 0.5, 0.5]]))[0]
    assert (x, y, depth, w) == (75, 25, 0.5, 1)


@pytest.mark.parametrize("direction", [*VIEWS.values(), (1, 2, 3), (0, 5, 1e-12), *map(fibonacci_direction, range(9), [9] * 9)])
def test_axes_are_orthonormal_and_right_handed(direction):
    camera = orthographic(direction, (1, 2, 3), 2.0, (40, 30))
    axes = np.stack([camera.right, camera.up, -camera.forward])
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12) and np.linalg.det(axes) > 0
    expected = (0, 0, 1) if abs(direction[0]) + abs(direction[2]) < 1e-9 else (0, 1, 0)
    assert camera.up @ np.array(expected) > 0


def test_the_square_spans_the_sphere_whatever_the_shape_of_the_picture():
    for size in ((40, 40), (80, 40), (40, 80)):
        camera = orthographic((0, 0, 1), (0, 0, 0), 3.0, size)
        corner = project(camera, np.array([[3.0, 3.0, 0]]))[0]
        assert np.allclose(corner[:2], (size[0] / 2 + 20, size[1] / 2 - 20))


def test_perspective_halves_the_size_at_twice_the_depth():
    camera = perspective((0, 0, 10), (0, 0, 0), 90, 100)
    near, far = project(camera, np.array([[1.0, 1, 5], [1.0, 1, 0]]))
    assert np.allclose(near, (60, 40, 5, 0.2)) and np.allclose(far, (55, 45, 10, 0.1))


@pytest.mark.parametrize("size", [(64, 64), (90, 40), (40, 90)])
def test_a_perspective_around_a_sphere_holds_it_and_touches_the_border(size):
    camera = perspective_around((1, 1, 1), (5, 5, 5), 2.0, 50, size)
    points = 5 + 2 * np.stack([fibonacci_direction(i, 20000) for i in range(20000)])
    screen = project(camera, points)[:, :2]
    assert (screen >= -1e-9).all() and (screen <= np.array(size) + 1e-9).all()
    assert abs(screen - np.array(size) / 2).max(axis=0).max() > min(size) / 2 - 0.1


@pytest.mark.parametrize("count", [1, 2, 3, 16, 50])
def test_fibonacci_directions_are_unit_and_distinct(count):
    directions = np.stack([fibonacci_direction(i, count) for i in range(count)])
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    gaps = np.linalg.norm(directions[:, None] - directions[None], axis=2) + 9 * np.eye(count)
    assert gaps.min() > 1 / math.sqrt(count)
    if count > 1:
        assert directions[0, 1] == 1 and directions[-1, 1] == -1
    else:
        assert np.array_equal(directions[0], VIEWS["front"])
    if count == 16:
        y, turn = 1 - 6 / 15, 3 * math.pi * (3 - math.sqrt(5))
        assert np.allclose(directions[3], (math.cos(turn) * 0.8, y, math.sin(turn) * 0.8))


def test_named_views_are_angles():
    angles = {"front": (0, 0), "right": (90, 0), "back": (180, 0), "left": (-90, 0), "top": (0, 90), "bottom": (0, -90)}
    assert all(np.allclose(direction_of_angles(*pair), VIEWS[name], atol=1e-15) for name, pair in angles.items())


def test_bounding_sphere_is_the_boxes_and_passes_over_what_is_not_finite():
    centre, radius = bounding_sphere([[0, 0, 0], [2, 4, 4], [1, 1, 1], [np.nan, 0, 0], [np.inf, 0, 0]])
    assert centre.tolist() == [1, 2, 2] and radius == 3
    assert bounding_sphere(np.zeros((0, 3)))[1] == 0 and bounding_sphere([[5, 6, 7]])[0].tolist() == [5, 6, 7]
    assert math.isfinite(bounding_sphere([[-1e308] * 3, [1e308] * 3])[1] / 2)
    assert orthographic((0, 0, 1), (0, 0, 0), 0.0, 8).half == 1.0


def flat(direction=(0, 0, 1), centre=(0, 0, 0), radius=1, size=8):
    return lambda: orthographic(direction, centre, radius, size)


def deep(fov, target=(0, 0, 0)):
    return lambda: perspective((0, 0, 1), target, fov, 8)


@pytest.mark.parametrize("call, code", [
    (flat(size=0), "TXF-I90"), (flat(size=-3), "TXF-I90"), (flat(size=(8, 0)), "TXF-I90"), (flat(size=1 << 15), "TXF-I90"),
    (flat(size=8.5), "TXF-I90"), (flat(size=(1, 2, 3)), "TXF-I90"), (flat((0, 0, 0)), "TXF-I91"),
    (flat((0, np.nan, 1)), "TXF-I91"), (flat((1, 1)), "TXF-I91"), (flat(centre=(0, np.inf, 0)), "TXF-I91"),
    (deep(50, (0, 0, 1)), "TXF-I91"),
    (flat(radius=-1), "TXF-I92"), (flat(radius=np.nan), "TXF-I92"), (flat(radius=np.inf), "TXF-I92"),
    (flat(radius=1e-320), "TXF-I92"), (deep(0), "TXF-I92"), (deep(180), "TXF-I92"), (deep(np.nan), "TXF-I92"),
    (lambda: fibonacci_direction(16, 16), "TXF-I93"), (lambda: fibonacci_direction(-1, 16), "TXF-I93"),
    (lambda: fibonacci_direction(0, 0), "TXF-I93"),
])  # fmt: skip
def test_impossible_cameras_are_refused(call, code):
    with pytest.raises(InputError) as caught:
        call()
    assert caught.value.code == code


# Coverage and visibility


def soup(rng, count, size, kind):
    """Random triangles about a picture, some corners on pixel centres and borders: (positions, faces)."""
    width, height = size
    points = rng.uniform(-0.3, 1.3, (3 * count, 3)) * (width, height, 20)
    if kind == "grid":
        points[:, :2] = np.round(2 * points[:, :2]) / 2
    elif kind == "slivers":
        points[1::3] = points[::3] + rng.normal(0, 0.01, (count, 3))
    elif kind == "small":
        points[1::3], points[2::3] = (points[::3] + rng.normal(0, 1, (count, 3)) for _ in range(2))
    return points, np.arange(3 * count).reshape(-1, 3)


def assert_fragments_are_the_oracles(camera, positions, faces, **options):
    expected = naive.rasterise(camera, positions.tolist(), faces.tolist(), options.get("cull", True),
                               np.flatnonzero(options["two_sided"]).tolist() if "two_sided" in options else ())
    got = rasterise(camera, positions, faces, **options)
    assert got.pixel.tolist() == sorted(y * camera.width + x for x, y in expected)
    for pixel, face, bary, depth in zip(got.pixel.tolist(), got.face, got.bary, got.depth, strict=True):
        hits = expected[pixel % camera.width, pixel // camera.width]
        close = [number for d, number in hits if d <= hits[0][0] + 1e-7 * max(abs(hits[0][0]), 1)]
        assert face in close and depth == pytest.approx(hits[0][0], rel=1e-6, abs=1e-6)
        assert (bary >= 0).all() and abs(bary.sum() - 1) < 1e-12
    return got


@pytest.mark.parametrize("kind", ["grid", "slivers", "small", "large"])
@pytest.mark.parametrize("seed", range(3))
def test_orthographic_fragments_are_the_oracles(kind, seed):
    rng = np.random.default_rng(seed)
    size = (32, 32) if seed else (37, 21)
    positions, faces = soup(rng, 14, size, kind)
    assert_fragments_are_the_oracles(pixel_camera(size), positions, faces, cull=False)
    assert_fragments_are_the_oracles(pixel_camera(size), positions, faces, two_sided=rng.random(14) < 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_perspective_fragments_are_the_oracles(seed):
    rng = np.random.default_rng(seed)
    positions, faces = rng.uniform(-1, 1, (42, 3)), np.arange(42).reshape(-1, 3)
    assert_fragments_are_the_oracles(perspective((0, 1, 3), (0, 0, 0), 50, 32), positions, faces, cull=bool(seed % 2))


def test_a_triangulated_plane_covers_every_pixel_exactly_once():
    rng = np.random.default_rng(1)
    steps = np.arange(-2, 12) * 4.0
    x, y = np.meshgrid(steps, steps)
    points = np.stack([x, y, 0 * x], axis=-1)
    points[::2, ::2, :2] += rng.uniform(-1.5, 1.5, points[::2, ::2, :2].shape)
    points[1::2, 1::2, :2] = np.round(points[1::2, 1::2, :2]) + 0.5
    number = np.arange(points[..., 0].size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, 1:].ravel(), number[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    times = np.zeros(32 * 32, np.int64)
    for face in faces:
        times[rasterise(pixel_camera((32, 32)), points.reshape(-1, 3), face[None], cull=False).pixel] += 1
    assert (times == 1).all()


def test_a_fan_round_a_pixel_centre_covers_it_once():
    rim = np.array([[4, 4], [9, 4.5], [12.5, 9], [9, 13], [4.5, 12], [3, 8.5]])
    points = np.column_stack([np.vstack([[8.5, 8.5], rim]), np.zeros(7)])
    covered = [rasterise(pixel_camera((16, 16)), points, [[0, 1 + i, 1 + (i + 1) % 6]]).pixel.tolist() for i in range(6)]
    every = sum(covered, [])
    assert len(set(every)) == len(every) and 7 * 16 + 8 in every  # world y 8.5 is row 7


def test_left_and_top_borders_belong_to_the_face_and_right_and_bottom_do_not():
    points, faces = np.array([[4.5, 4.5, 0], [8.5, 4.5, 0], [8.5, 8.5, 0], [4.5, 8.5, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    got = rasterise(pixel_camera((16, 16)), points, faces)
    assert sorted(set(got.pixel % 16)) == [4, 5, 6, 7]
    assert sorted(set(got.pixel // 16)) == [7, 8, 9, 10]  # centres 7.5 (top, on the border) to 10.5; 11.5 is the bottom border
    assert len(got.pixel) == 16


def test_two_enormous_faces_share_the_picture_without_gap_or_overlap():
    for far in (1e5, 1e7, 1e9, 1e15):
        points = np.array([[-far, -0.7 * far, 0], [far, 0.7 * far + 3, 0], [-far, far, 0], [far, -far, 0]])
        one = rasterise(pixel_camera((64, 64)), points, [[0, 1, 2]], cull=False).pixel
        two = rasterise(pixel_camera((64, 64)), points, [[1, 0, 3]], cull=False).pixel
        assert sorted([*one, *two]) == list(range(64 * 64)) and len(one) > 100 and len(two) > 100


def test_nothing_off_the_screen_is_seen():
    left, right, above = [[-9, 3], [-1, 3], [-4, 9]], [[40, 3], [50, 3], [45, 9]], [[1, 70], [9, 70], [5, 80]]
    points = np.column_stack([np.array([*left, *right, *above], np.float64), np.zeros(9)])
    assert len(rasterise(pixel_camera((32, 32)), points, np.arange(9).reshape(3, 3), cull=False).pixel) == 0


def test_equal_depth_goes_to_the_lower_face_and_nearer_faces_win_in_any_order():
    points = np.concatenate([square(z, 16.0)[0] for z in (1.0, 1.0, 5.0)])
    faces = [[0, 1, 2], [4, 5, 6], [6, 4, 5]]
    assert set(rasterise(pixel_camera((16, 16)), points, faces).face) == {0}
    assert set(rasterise(pixel_camera((16, 16)), points, [[0, 1, 2], [9, 10, 8]]).face) == {1}
    assert set(rasterise(pixel_camera((16, 16)), points, [[9, 10, 8], [0, 1, 2]]).face) == {0}


def test_back_faces_are_culled_unless_two_sided():
    positions, faces = cube_mesh()
    camera = orthographic((1, 2, 3), (0, 0, 0), 1.0, 64)
    seen, inside = rasterise(camera, positions, faces), rasterise(camera, positions, faces[:, ::-1])
    assert np.array_equal(seen.pixel, inside.pixel) and not set(seen.face) & set(inside.face)
    assert set(seen.face) == {2, 3, 6, 7, 10, 11} and (seen.depth < inside.depth).all()  # +x, +y, +z
    assert np.array_equal(rasterise(camera, positions, faces[:, ::-1], cull=False).face, seen.face)
    two_sided = np.isin(np.arange(12), (2, 3))
    assert {2, 3} < set(rasterise(camera, positions, faces[:, ::-1], two_sided=two_sided).face)


def test_barycentric_coordinates_are_perspective_correct():
    positions, faces = np.array([[-3.0, -1, 2], [4, -1, 2], [0, 2, -30]]), np.array([[0, 1, 2]])
    camera = perspective((0.3, 1, 5), (0, 0, 0), 60, (70, 50))
    got = rasterise(camera, positions, faces, cull=False)
    assert len(got.pixel) > 300
    points = np.einsum("mk,kc->mc", got.bary, positions)
    inner = got.bary.min(axis=1) > 1e-3  # not cut at a border
    screen = project(camera, points)[inner]
    assert np.allclose(screen[:, 0], got.pixel[inner] % 70 + 0.5, atol=1e-9)
    assert np.allclose(screen[:, 1], got.pixel[inner] // 70 + 0.5, atol=1e-9)
    assert np.allclose(screen[:, 2], got.depth[inner], rtol=1e-9)
    normal = np.cross(positions[1] - positions[0], positions[2] - positions[0])
    assert np.abs((points - positions[0]) @ normal).max() < 1e-9 * np.abs(normal).max() * 30


@pytest.mark.parametrize("camera", [pixel_camera((64, 64)), perspective((20, 40, 90), (32, 32, 0), 50, 64)])
def test_slivers_are_shown_within_themselves(camera):
    positions, faces = soup(np.random.default_rng(2), 3000, (64, 64), "slivers")
    got = rasterise(camera, positions, faces, cull=False)
    assert len(got.pixel) > 300 and (got.bary >= 0).all() and np.allclose(got.bary.sum(axis=1), 1)
    points = np.einsum("mk,mkc->mc", got.bary, positions[faces[got.face]])
    centres = np.stack([got.pixel % 64, got.pixel // 64], axis=1) + 0.5
    assert np.linalg.norm(project(camera, points)[:, :2] - centres, axis=1).max() < 0.01


def test_a_camera_inside_a_cube_sees_its_walls_everywhere():
    positions, faces = cube_mesh()
    for eye, target in (((0, 0, 0), (0, 0, -1)), ((0.1, 0.2, 0.3), (1, 0.3, 0.2)), ((0.49, -0.49, 0.49), (-1, 1, -0.8))):
        camera = perspective(eye, target, 100, (48, 32))
        got = rasterise(camera, positions, faces, cull=False)
        assert np.array_equal(got.pixel, np.arange(48 * 32))
        points = np.einsum("mk,mkc->mc", got.bary, positions[faces[got.face]])
        assert np.allclose(np.abs(points).max(axis=1), 0.5, atol=1e-9)
        assert np.allclose(project(camera, points)[:, :2], np.stack([got.pixel % 48, got.pixel // 48], 1) + 0.5, atol=0.02)
        assert len(rasterise(camera, positions, faces).pixel) == 0  # only back faces from inside


def test_faces_across_the_near_plane_are_what_rays_meet():
    rng = np.random.default_rng(5)
    positions, faces = rng.uniform(-1, 1, (45, 3)), np.arange(45).reshape(-1, 3)
    camera = perspective((0, 0, 0), (1, 0.3, 0.2), 90, 32)
    got = rasterise(camera, positions, faces, cull=False)
    behind = project(camera, positions)[:, 2].reshape(-1, 3) < 0
    assert (behind.any(axis=1) & ~behind.all(axis=1))[got.face].sum() > 200
    found = dict(zip(got.pixel.tolist(), zip(got.depth, got.face, strict=True), strict=True))
    differing = 0
    for pixel in range(32 * 32):
        hit = naive.first_hit(camera, positions.tolist(), faces.tolist(), pixel % 32, pixel // 32)
        mine = found.get(pixel)
        differing += (hit is None) != (mine is None) or bool(hit and (hit[1] != mine[1] or abs(hit[0] / mine[0] - 1) > 1e-6))
    assert differing <= 8  # rays within 1/256 pixel of a border


def test_peeling_shows_the_layers_one_by_one():
    positions, faces = cube_mesh()
    camera = orthographic((1, 2, 3), (0, 0, 0), 1.0, 64)
    beyond = np.full(64 * 64, -np.inf)
    first = rasterise(camera, positions, faces, cull=False, beyond=beyond)
    assert np.array_equal(first.face, rasterise(camera, positions, faces, cull=False).face)
    beyond[:] = np.inf
    beyond[first.pixel] = first.depth
    second = rasterise(camera, positions, faces, cull=False, beyond=beyond)
    assert np.array_equal(second.face, rasterise(camera, positions, faces[:, ::-1]).face)
    beyond[:] = np.inf
    beyond[second.pixel] = second.depth
    assert len(rasterise(camera, positions, faces, cull=False, beyond=beyond).pixel) == 0


@pytest.mark.parametrize("camera", [flat((1, 2, 3), radius=1.2, size=(150, 130))(), perspective((1, 1, 1.5), (0, 0, 0), 80, 140)])
def test_threads_change_no_byte(camera):
    rng = np.random.default_rng(0)
    positions, faces = rng.uniform(-1, 1, (900, 3)), np.arange(900).reshape(-1, 3)
    runs = [rasterise(camera, positions, faces, cull=False, threads=n) for n in (1, 2, 3, 8)]
    for name in ("pixel", "face", "bary", "depth"):
        assert len({getattr(run, name).tobytes() for run in runs}) == 1, name


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("make", [flat(size=16), lambda: perspective((0, 0, 3), (0, 0, 0), 40, 16)])
def test_faces_with_corners_that_are_not_finite_are_left_out(bad, make):
    positions, faces = cube_mesh()
    whole = rasterise(make(), positions, faces)
    broken = np.concatenate([positions, [[bad, 0, 0], [0, bad, 0], [0, 0, bad]]])
    got = rasterise(make(), broken, np.concatenate([faces, [[8, 0, 7], [1, 9, 2], [3, 4, 10], [8, 9, 10]]]))
    assert np.array_equal(got.pixel, whole.pixel) and np.array_equal(got.face, whole.face)


def test_degenerate_faces_and_empty_meshes_leave_no_fragment():
    points = np.array([[1, 1, 0], [9, 9, 0], [5, 5, 0], [9, 9, 5.0]])
    assert len(rasterise(pixel_camera((16, 16)), points, [[0, 1, 2], [1, 1, 1], [0, 1, 1], [0, 1, 3]], cull=False).pixel) == 0
    for positions, faces in ((np.zeros((0, 3)), np.zeros((0, 3), np.int64)), (points, np.zeros((0, 3), np.int64))):
        got = rasterise(pixel_camera((16, 16)), positions, faces, threads=2)
        assert (len(got.pixel), got.bary.shape, got.width) == (0, (0, 3), 16)


def test_indices_and_shapes_are_checked():
    points, faces = square()
    camera = pixel_camera((8, 8))
    for bad in ([[0, 1, 4]], [[-1, 0, 1]]):
        with pytest.raises(IndexError):
            rasterise(camera, points, bad)
    with pytest.raises(ValueError):
        rasterise(camera, points, faces, beyond=np.zeros(63))
    with pytest.raises(ValueError):
        rasterise(camera, points, faces, two_sided=np.zeros(3, bool))


# Pictures of scenes


def test_a_picture_shows_the_texture_upright_and_unmirrored():
    image = np.zeros((2, 2, 4), np.uint8)
    image[..., 3] = 255
    image[0, 0, 0], image[0, 1, 1], image[1, 0, 2], image[1, 1, :3] = 255, 255, 255, 255  # red green over blue white
    points, faces = square(0.0)
    uv = np.stack([points[:, 0], 1 - points[:, 1]], axis=1)
    scene = Scene(points, faces, np.zeros(2, np.int64), uv[faces], None, [Material(texture=0)], [Texture(image, (1, 1))])
    shown = render_scene(scene, front(scene, 64, 0.499)).image()
    corners = [shown[4, 4], shown[4, -5], shown[-5, 4], shown[-5, -5]]
    assert [c.tolist() for c in corners] == [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]


def test_a_picture_is_the_sources_colour_at_its_fragments(sample_scene):
    camera = orthographic((1, 0.5, 1), *bounding_sphere(sample_scene.positions), 100)
    picture = render_scene(sample_scene, camera)
    fragments = rasterise(camera, sample_scene.positions, sample_scene.faces)
    expected = sample_source(pack_source(sample_scene), fragments.face, fragments.bary)
    assert np.array_equal(picture.pixel, fragments.pixel) and np.array_equal(picture.colour, expected[:, :3])
    assert len(picture.pixel) > 2000 and (picture.alpha == 1).all() and picture.colour.dtype == np.float32


def test_an_image_is_rounded_colour_over_the_background():
    scene = stack([RED], [0])
    picture = render_scene(scene, front(scene, 8, 1.0))
    picture.colour = picture.colour + np.float32(0.5) * np.arange(len(picture.pixel) * 3, dtype=np.float32).reshape(-1, 3) - 4
    picture.colour[0] = np.nan
    image = picture.image((9, 8, 7)).reshape(-1, 3)
    outside = np.setdiff1d(np.arange(64), picture.pixel)
    assert (image[outside] == (9, 8, 7)).all() and len(outside) > 10
    expected = np.rint(np.clip(picture.colour[1:], 0, 255))
    assert np.array_equal(image[picture.pixel[1:]], expected) and image[picture.pixel[0]].tolist() == [0, 0, 0]


def test_uvs_that_are_not_finite_are_read_as_zero(sample_scene):
    points, faces = square(0.0)
    image = np.full((2, 2, 4), 200, np.uint8)
    for bad in (np.nan, np.inf, -np.inf):
        scene = Scene(points, faces, np.zeros(2, np.int64), np.full((2, 3, 2), bad), None,
                      [Material(texture=0, factor=np.array([0.5, 0.5, 0.5, 1.0]))], [Texture(image)])
        colour = render_scene(scene, front(scene)).colour
        assert len(colour) == 64 and (np.abs(colour - 146) < 2).all()  # 200 at half the light


def test_what_a_mask_cuts_away_shows_the_layer_behind():
    scene = stack([GREEN, (1, 0, 0, 0.4), (0, 0, 1, 0.3)], [0, ALPHA_MASK, ALPHA_MASK], cutoff=0.4)
    picture = render_scene(scene, front(scene))
    assert len(picture.pixel) == 64 and np.allclose(picture.colour, (255, 0, 0), atol=0.01) and (picture.alpha == 1).all()
    many = stack([GREEN] + [(1, 0, 0, 0.2)] * 20, [0] + [ALPHA_MASK] * 20)
    assert np.allclose(render_scene(many, front(many)).colour, (0, 255, 0), atol=0.01)
    nothing = stack([(1, 0, 0, 0.2)], [ALPHA_MASK])
    assert len(render_scene(nothing, front(nothing)).pixel) == 0


def test_blended_layers_are_mixed_over_what_is_behind_them():
    scene = stack([BLUE, (0, 1, 0, 0.5), (1, 0, 0, 0.25)], [0, ALPHA_BLEND, ALPHA_BLEND])
    picture = render_scene(scene, front(scene), threads=2)
    assert np.allclose(picture.colour, (0.25 * 255, 0.75 * 0.5 * 255, 0.75 * 0.5 * 255), atol=0.01)
    assert np.allclose(picture.alpha, 1)


def test_blending_over_nothing_leaves_the_background_through():
    scene = stack([(1, 0, 0, 0.5)], [ALPHA_BLEND])
    picture = render_scene(scene, front(scene))
    assert np.allclose(picture.alpha, 0.5) and np.allclose(picture.colour, (255, 0, 0), atol=0.01)
    assert (picture.image((255, 255, 255)) == (255, 128, 128)).all() and (picture.image((0, 0, 0)) == (128, 0, 0)).all()


def test_at_most_eight_layers_are_composited():
    scene = stack([(1, 0, 0, 0.1)] * 12, [ALPHA_BLEND] * 12)
    assert np.allclose(render_scene(scene, front(scene)).alpha, 1 - 0.9**8, atol=1e-5)


def test_double_sided_materials_are_seen_from_behind():
    for double_sided, count in ((False, 0), (True, 64)):
        scene = stack([RED], [0], double_sided=double_sided)
        camera = orthographic((0, 0, -1), (0.5, 0.5, 0), 0.4, 8)
        assert len(render_scene(scene, camera).pixel) == count
        assert len(render_scene(scene, camera, cull=False).pixel) == 64


def test_a_view_without_anything_is_background():
    empty = scene_of(np.zeros((0, 3)), np.zeros((0, 3)))
    bare = Texf(cube=CanonicalCube((0.0, 0.0, 0.0), 0.0, 14), units=[], fields=[], materials=[])
    camera = orthographic((0, 0, 1), (50, 50, 50), 0.0, (8, 6))
    scene = stack([RED], [0])
    for picture in (render_scene(empty, camera), render_texf(bare, camera), render_scene(scene, camera)):
        assert len(picture.pixel) == 0 and (picture.image((1, 2, 3)) == (1, 2, 3)).all() and picture.image().shape == (6, 8, 3)


def test_box_down_is_the_rounded_mean():
    image = np.arange(2 * 4 * 3).reshape(2, 4, 3).astype(np.uint8)
    assert box_down(image, 2).tolist() == [[[8, 9, 10], [14, 15, 16]]]  # means 7.5, 8.5, ..., halves up
    assert np.array_equal(box_down(image, 1), image)


# Pictures of fields


@pytest.fixture(scope="module")
def sphere_texf():
    return coded(painted_sphere(16), 64)


def test_levels_are_the_means_of_their_voxels(sphere_texf):
    part = sphere_texf.fields[0]
    pyramid = Pyramid(part)
    assert pyramid.last == 6
    for number in range(pyramid.last + 1):
        level, expected = pyramid.level(number), naive.levels(part.keys.tolist(), part.rgba.tolist(), number)
        assert level.support.keys.tolist() == sorted(expected) and level.support.size == 64 >> number
        assert np.allclose(level.values, [expected[k] for k in sorted(expected)], atol=1e-3)
    odd = Pyramid(Field(VoxelSupport(5, np.array([0, 7, 448])), {"base_colour": np.full((3, 3), 9, np.uint8)}))
    assert [odd.level(i).support.size for i in range(4)] == [5, 3, 2, 1] and odd.last == 3


def test_without_filtering_a_picture_is_the_plain_query(sphere_texf):
    camera = orthographic((1, 1, 1), *bounding_sphere(sphere_texf.positions), 24)
    picture = render_texf(sphere_texf, camera, filtering=False)
    fragments = rasterise(camera, sphere_texf.positions, sphere_texf.faces)
    points = np.einsum("mk,mkc->mc", fragments.bary, sphere_texf.positions[sphere_texf.faces[fragments.face]])
    assert np.array_equal(picture.pixel, fragments.pixel) and len(picture.pixel) > 100
    assert np.allclose(picture.colour, sphere_texf.query(points, fragments.face)[:, :3], atol=1e-3)


@pytest.mark.parametrize("deep", [False, True])
def test_magnified_the_filter_changes_nothing(deep, sphere_texf):
    sphere = bounding_sphere(sphere_texf.positions)
    camera = perspective_around((1, 1, 1), *sphere, 40, 300) if deep else orthographic((1, 1, 1), *sphere, 300)
    with_filter, without = (render_texf(sphere_texf, camera, filtering=f) for f in (True, False))
    assert np.array_equal(with_filter.colour, without.colour) and np.array_equal(with_filter.pixel, without.pixel)


def checkered(resolution=256):
    """A flat square, every other voxel black or white, its own field: Texf."""
    x, y = np.meshgrid(np.arange(resolution), np.arange(resolution), indexing="ij")
    from texfcodec.field.morton import encode_morton

    xyz = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    keys = encode_morton(xyz)
    order = np.argsort(keys)
    grey = np.where((xyz[:, 0] // 2 + xyz[:, 1] // 2) % 2, 255, 0).astype(np.uint8)
    part = Field(VoxelSupport(resolution, keys[order]), {"base_colour": np.column_stack([grey, grey, grey])[order]})
    last = (1 << 14) - 1
    lattice = np.array([[0, 0, 0], [last, 0, 0], [last, last, 0], [0, last, 0]])
    unit = GeometryUnit(0, 0, lattice, np.array([[0, 1, 2], [0, 2, 3]]))
    return Texf(cube=CanonicalCube((0.0, 0.0, 0.0), 1.0, 14), units=[unit], fields=[part], materials=[Material()])


@pytest.mark.parametrize("size", [100, 60, 37, 20])
def test_filtering_a_checker_is_nearer_to_the_supersampled_picture(size):
    texf = checkered()
    camera = lambda n: orthographic((0, 0, 1), (0.5, 0.5, 0), 0.45, n)
    times = 8
    reference = box_down(render_texf(texf, camera(times * size), filtering=False).image(), times).astype(np.float64)
    error = {f: np.mean((render_texf(texf, camera(size), filtering=f).image() - reference) ** 2) for f in (True, False)}
    assert error[True] < 0.6 * error[False]


def test_filtering_in_perspective_follows_the_depth():
    texf = checkered()
    camera = perspective((0.5, -0.05, 0.12), (0.5, 0.6, 0), 50, 64)
    filtered, plain = (render_texf(texf, camera, filtering=f) for f in (True, False))
    fragments = rasterise(camera, texf.positions, texf.faces)
    wide = camera.pixel * fragments.depth * 256
    assert (wide < 1).sum() > 100 and (wide > 2).sum() > 100
    assert np.array_equal(filtered.colour[wide <= 1], plain.colour[wide <= 1])
    assert filtered.colour[wide > 2].std() < 0.5 * plain.colour[wide > 2].std()


def test_levels_follow_values_that_are_replaced():
    texf = checkered(64)
    camera = orthographic((0, 0, 1), (0.5, 0.5, 0), 0.45, 8)
    assert abs(render_texf(texf, camera).colour.mean() - 127.5) < 10
    texf.fields[0].rgba = np.full_like(texf.fields[0].rgba, 40)
    assert (render_texf(texf, camera).colour == 40).all()


def test_level_of_detail_streams_can_be_drawn(sphere_texf):
    data = encode_scene(painted_sphere(16), EncodeOptions(resolution=64, qp=4, effort="fast")).data
    camera = orthographic((0, 0.2, 1), *bounding_sphere(sphere_texf.positions), 64)
    a, b = render_texf(sphere_texf, camera), render_texf(decode(data, DecodeOptions(lod=2)), camera)
    assert np.array_equal(a.pixel, b.pixel) and np.abs(a.colour - b.colour).mean() < 12


def test_masks_and_blends_survive_the_codec():
    for mode in (ALPHA_MASK, ALPHA_BLEND):
        scene = stack([GREEN, (1, 0, 0, 0.3)], [0, mode])
        texf = coded(scene, 64, partition="off")
        expected, got = render_scene(scene, front(scene)), render_texf(texf, front(scene))
        assert np.array_equal(expected.pixel, got.pixel) and np.abs(expected.colour - got.colour).max() < 6


def test_pictures_do_not_depend_on_threads(sphere_texf, monkeypatch):
    monkeypatch.setattr("texfcodec.render.shade.BLOCK", 500)
    scene = painted_sphere(16)
    camera = orthographic((1, 1, 1), *bounding_sphere(scene.positions), 100)
    for draw in (lambda n: render_scene(scene, camera, threads=n), lambda n: render_texf(sphere_texf, camera, threads=n),
                 lambda n: render_texf(sphere_texf, camera, filtering=False, threads=n)):
        assert len({draw(n).image().tobytes() for n in (1, 2, 5)}) == 1


def test_shading_can_be_asked_for_chosen_fragments(sphere_texf):
    camera = orthographic((1, 1, 1), *bounding_sphere(sphere_texf.positions), 40)
    fragments = rasterise(camera, sphere_texf.positions, sphere_texf.faces)
    whole = shade_field(sphere_texf, camera, fragments, sphere_texf.positions, sphere_texf.faces, False)
    part = type(fragments)(*(getattr(fragments, n)[5:9] for n in ("pixel", "face", "bary", "depth")), 40, 40)
    assert np.array_equal(shade_field(sphere_texf, camera, part, sphere_texf.positions, sphere_texf.faces, False), whole[5:9])
    assert whole.dtype == np.float32 and whole.shape == (len(fragments.face), 4)
    fragments.face[0] = len(sphere_texf.faces)
    with pytest.raises(IndexError):
        shade_field(sphere_texf, camera, fragments, sphere_texf.positions, sphere_texf.faces)
    with pytest.raises(IndexError):
        shade_source(pack_source(painted_sphere(4)), fragments)


def test_a_coarse_level_asks_its_own_grid(sphere_texf):
    level = Pyramid(sphere_texf.fields[0]).level(2)
    points = np.random.default_rng(0).uniform(0, 64, (200, 3))
    support = level.support
    assert np.array_equal(level.query(points), query_field(points / 4, 16, support.keys, support.brick_map, level.values)[0])


# Differences


def test_a_picture_is_lossless_to_itself_and_the_psnr_is_the_rooms():
    scene = stack([RED], [0])
    picture, other = (render_scene(scene, front(scene, 8, 1.0)) for _ in range(2))
    facts, heat = compare(picture, other)
    assert facts == {"pixels_both": len(picture.pixel), "pixels_only_first": 0, "pixels_only_second": 0, "psnr_rgb": None,
                     "psnr_y": None}
    assert (heat.reshape(-1, 3)[picture.pixel] == 0).all()
    other.colour = other.colour - np.float32([8, 0, 0])
    other.pixel, other.colour, other.alpha = other.pixel[1:], other.colour[1:], other.alpha[1:]
    facts, heat = compare(picture, other)
    assert facts["psnr_rgb"] == pytest.approx(10 * math.log10(255**2 * 3 / 64)) and facts["pixels_only_first"] == 1
    assert heat.reshape(-1, 3)[picture.pixel[1]].tolist() == heat_colour(np.array([8 / math.sqrt(3)]))[0].tolist()


def test_pictures_that_share_nothing_have_no_psnr():
    scene = stack([RED], [0])
    picture, nothing = render_scene(scene, front(scene)), render_scene(scene, orthographic((0, 0, -1), (0, 0, 0), 1, 8))
    facts, heat = compare(picture, nothing)
    assert (facts["pixels_both"], facts["pixels_only_first"], facts["psnr_rgb"]) == (0, 64, None)
    with pytest.raises(ValueError):
        compare(picture, render_scene(scene, front(scene, 9)))


def test_a_sheet_has_its_panels_side_by_side():
    panels = [np.full((64, 64, 3), v, np.uint8) for v in (10, 20, 30)]
    out = sheet(panels, ["a", "a name that is much too long for its panel", "difference"])
    assert out.shape == (94, 64 * 3 + 16, 3) and out[10, 10, 0] == 10 and out[10, 80, 0] == 20 and out[10, 150, 0] == 30
    assert (out[64:, :64] != 255).any() and (out[:, 64:72] == 255).all()


# texf-render


@pytest.fixture
def call(call):
    """call(arguments...) of texf-render."""
    return partial(call, "texf-render")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The bundled sample as GLB and as a small stream."""
    from texfcodec.demo.asset import write_sample
    from texfcodec.io.load import load

    folder = tmp_path_factory.mktemp("sample")
    write_sample(folder / "sample.glb")
    data = encode_scene(load(folder / "sample.glb"), EncodeOptions(resolution=256, qp=28, effort="fast")).data
    (folder / "sample.texf").write_bytes(data)
    return folder / "sample.glb", folder / "sample.texf"


def test_the_command_draws_meshes_and_streams(call, files, tmp_path):
    for source in files:
        out = tmp_path / f"{source.suffix[1:]}.png"
        code, said, err = call(source, out, "--size", "96x64", "--json")
        facts = json.loads(said)
        assert code == 0 and err == "" and facts["schema"] == 1 and facts["files"] == [out.name]
        assert set(facts) == {"schema", "width", "height", "direction", "perspective", "shaded", "pixels", "covered",
                              "background",
                              "compare", "seconds", "peak_memory_bytes", "warnings", "dropped", "remarks", "files"}
        assert (facts["width"], facts["height"], facts["pixels"], facts["compare"]) == (96, 64, 96 * 64, None)
        image = np.asarray(Image.open(out))
        seen = (image != rows(GREY, 64)).any(axis=2).sum()
        assert image.shape == (64, 96, 3) and facts["covered"] == pytest.approx(seen, rel=0.02)
        assert 400 < facts["covered"] < 2000
    assert sorted(p.name for p in tmp_path.iterdir()) == ["glb.png", "texf.png"]


def test_what_is_not_drawn_is_counted(call, files, tmp_path):
    assert call(files[0], tmp_path / "a.png", "--size", "16")[2] == ""  # all of the sample is kept
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nl 1 2\ncurv 1 2\n")
    said = call(path, tmp_path / "a.png", "--size", "16")[2]
    assert "2 properties are not read and not drawn" in said and said.count("\n") == 1
    assert len(json.loads(call(path, tmp_path / "a.png", "--size", "16", "--json")[1])["dropped"]) == 2
    assert call(path, tmp_path / "a.png", "--size", "16", "--quiet") == (0, "", "")


def test_the_command_compares(call, files, tmp_path):
    code, said, _ = call(*files[:1], tmp_path / "a.png", "--compare", files[1], "--size", "128", "--json", "--no-filter")
    found = json.loads(said)["compare"]
    assert code == 0 and set(found) == {"pixels_both", "pixels_only_first", "pixels_only_second", "psnr_rgb", "psnr_y"}
    assert found["pixels_both"] > 1000 and 18 < found["psnr_rgb"] < 60 and 18 < found["psnr_y"] < 60
    assert np.asarray(Image.open(tmp_path / "a.png")).shape == (158, 128 * 3 + 16, 3)
    code, said, _ = call(files[0], tmp_path / "b.png", "--compare", files[0], "--size", "32")
    assert code == 0 and "RGB exact, Y exact" in said


@pytest.mark.parametrize("flags", [
    ("--view", "top"), ("--view", "fibonacci:5"), ("--view", "30,-20"), ("--perspective", "45"), ("--anti-alias", "3"),
    ("--background", "1,2,3"), ("--no-cull", "--quiet"), ("--threads", "1"),
])  # fmt: skip
def test_every_choice_is_taken(call, files, tmp_path, flags):
    code, said, _ = call(files[1], tmp_path / "a.png", "--size", "40", *flags)
    image = np.asarray(Image.open(tmp_path / "a.png"))
    assert code == 0 and image.shape == (40, 40, 3) and ("covered" in said) != ("--quiet" in flags)
    assert image[0, 0].tolist() == ([1, 2, 3] if "--background" in flags else list(GREY[0]))


@pytest.mark.parametrize("flags", [
    ("--view", "above"), ("--view", "fibonacci:16"), ("--view", "1"), ("--view", "nan,0"), ("--size", "0"), ("--size", "9x"),
    ("--size", "9000"), ("--background", "256,0,0"), ("--perspective", "180"), ("--anti-alias", "0"), ("--nonsense",),
])  # fmt: skip
def test_wrong_choices_are_exit_1(call, files, tmp_path, flags):
    code, said, err = call(files[0], tmp_path / "a.png", *flags)
    assert code == 1 and said == "" and err.startswith("error TXF-C01") and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_wrong_files_are_coded_errors(call, files, tmp_path):
    broken = tmp_path / "broken.texf"
    broken.write_bytes(files[1].read_bytes()[:-9])
    png = tmp_path / "a.png"
    for arguments, expected in (((files[0], tmp_path / "a.jpg"), (1, "TXF-C01")), ((files[0],), (1, "TXF-C01")),
                                ((tmp_path / "no.glb", png), (2, "TXF-I01")), ((tmp_path / "no.texf", png), (2, "TXF-I01")),
                                ((broken, png), (3, "TXF-S02")), ((files[0], tmp_path / "no" / "a.png"), (2, "TXF-O01")),
                                ((files[0], png, "--size", "8192", "--anti-alias", "8"), (2, "TXF-I90"))):  # fmt: skip
        code, said, _ = call(*arguments, "--json")
        assert (code, json.loads(said)["error"]["code"]) == expected
    assert list(tmp_path.iterdir()) == [broken]


def test_a_view_without_anything_is_a_warning(call, tmp_path):
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    code, said, err = call(path, tmp_path / "a.png", "--size", "16", "--view", "back")
    assert code == 0 and "0.0 %" in said and "warning: the view shows no surface" in err
    assert call(path, tmp_path / "a.png", "--size", "16")[2] == ""
