"""Baking by least squares against a dense solution, padding that makes charts agree, and the measure of seams."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
from analytic import decoded, grid_mesh, soup_mesh, sphere_mesh, surface_samples

from texfcodec.io.atlas import system as system_room
from texfcodec.io.atlas.bake import bake
from texfcodec.io.atlas.chart_padding import continue_over_borders
from texfcodec.io.atlas.maps import _in_tangent_space
from texfcodec.io.atlas.seams import LEVELS, border_edges, measure_seams
from texfcodec.io.atlas.system import AtlasSystem
from texfcodec.io.atlas.unwrap import Atlas, make_atlas
from texfcodec.scene.factors import FLAT
from texfcodec.scene.scene import ALPHA_MASK, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Texture

CLAMP = (WRAP_CLAMP, WRAP_CLAMP)


def rough_colour(points, scale=20.0, swing=25.0):
    """A field with detail of a few texels, which point samples cannot hold: float32 [M, 3]."""
    phase = np.asarray(points) @ (scale * np.array([[1.0, 0.3, -0.7], [0.2, 1.1, 0.9], [0.6, -0.5, 0.8]]))
    return (127.5 + swing * np.sin(phase)).astype(np.float32)


def rough(positions, faces, scale=20.0, **changes):
    texf = decoded(positions, faces, **changes)
    texf.query = lambda points, face=None: np.hstack([rough_colour(points, scale), np.full((len(points), 1), 255, np.float32)])
    return texf


def two_squares(side=24):
    """Two squares that meet at x = 1 on the surface and stand apart in an image of that side: an Atlas, positions, faces."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    flat = positions[faces][..., :2] * 0.35
    flat[:2] += [0.05, 0.05]
    flat[2:] = (flat[2:] - [0.35, 0])[..., ::-1] + [0.55, 0.55]  # turned, so that texels do not line up
    return Atlas(flat, side, side, "fast", 0.25), positions, faces


def rows_of(system, x, y):
    """The dense matrix of bilinear look-ups at (x, y), float64 [M, n]."""
    height, width = system.owner.shape
    number = np.full((height, width), -1)
    number[system.covered] = np.arange(system.covered.sum())
    out = np.zeros((len(x), system.covered.sum()))
    for i in range(len(x)):
        u, v = np.clip([x[i] - 0.5, y[i] - 0.5], 0, [width - 1, height - 1])
        column, row = min(int(u), width - 2), min(int(v), height - 2)
        for down in range(2):
            for right in range(2):
                share = (v - row if down else row + 1 - v) * (u - column if right else column + 1 - u)
                out[i, number[row + down, column + right]] += share
    return out


def dense(system, sample, columns):
    """The damped least squares that fitted() solves, as a dense matrix and its right side."""
    x, y, face = (np.concatenate(part) for part in zip(*(block() for block in system._sample_blocks()), strict=True))
    look_ups, wanted = rows_of(system, x, y), sample(system._points(x, y, face), face)
    start = system.at_centres(sample, columns)
    damping = system_room.DAMPING * (look_ups**2).sum(0).mean()
    return np.vstack([look_ups, np.sqrt(damping) * np.eye(len(start))]), np.vstack([wanted, np.sqrt(damping) * start])


# Least squares.


def test_fit_agrees_with_a_dense_least_squares_solution(monkeypatch):
    monkeypatch.setattr(system_room, "SWEEPS", 200)
    system = AtlasSystem(*two_squares())
    sample = lambda points, face: rough_colour(points)
    stacked, wanted = dense(system, sample, 3)
    oracle = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    inside = (oracle >= 0) & (oracle <= 255)
    fitted = system.fitted(sample, 3)
    assert inside.all() and np.abs(fitted - oracle).max() < 0.05
    monkeypatch.setattr(system_room, "SWEEPS", 4)
    assert np.abs(system.fitted(sample, 3) - oracle).mean() < 0.15 * np.abs(system.at_centres(sample, 3) - oracle).mean()


def test_weighted_fit_agrees_with_a_dense_least_squares_solution(monkeypatch):
    monkeypatch.setattr(system_room, "SWEEPS", 200)
    system = AtlasSystem(*two_squares())
    counts = lambda points: 0.25 + 0.75 * (points[:, 1] < 0.5)
    sample = lambda points, face: np.column_stack([rough_colour(points), counts(points)]).astype(np.float32)
    x, y, face = (np.concatenate(part) for part in zip(*(block() for block in system._sample_blocks()), strict=True))
    points = system._points(x, y, face)
    root, look_ups = np.sqrt(counts(points))[:, None], rows_of(system, x, y)
    start = system.at_centres(sample, 4)[:, :3]
    damping = system_room.DAMPING * ((root * look_ups) ** 2).sum(0).mean()
    stacked = np.vstack([root * look_ups, np.sqrt(damping) * np.eye(len(start))])
    oracle = np.linalg.lstsq(stacked, np.vstack([root * rough_colour(points), np.sqrt(damping) * start]), rcond=None)[0]
    assert np.abs(system.fitted(sample, 3, weighted=True) - np.clip(oracle, 0, 255)).max() < 0.05


def test_values_stay_in_range_where_the_least_squares_would_leave_it(monkeypatch):
    monkeypatch.setattr(system_room, "SWEEPS", 200)
    system = AtlasSystem(*two_squares())
    steps = lambda points, face: np.where(np.floor(points[:, :1] * 7) % 2 > 0, 255.0, 0.0).astype(np.float32)
    stacked, wanted = dense(system, steps, 1)
    free = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    oracle = scipy.optimize.lsq_linear(stacked, wanted[:, 0], (0, 255), tol=1e-12).x
    assert free.min() < -5 and free.max() > 260 and np.abs(system.fitted(steps, 1)[:, 0] - oracle).max() < 0.05


def test_one_system_answers_for_planes_asked_apart_as_for_planes_asked_together():
    system = AtlasSystem(*two_squares())
    together = system.fitted(lambda points, face: rough_colour(points), 3, threads=2)
    for c in range(3):
        alone = system.fitted(lambda points, face, c=c: rough_colour(points)[:, c : c + 1], 1)
        assert np.array_equal(alone[:, 0], together[:, c])


@pytest.mark.parametrize("mesh", [lambda: grid_mesh(24, 0.3), sphere_mesh])
def test_a_fitted_texture_is_closer_to_the_field_than_point_samples(monkeypatch, mesh):
    texf = rough(*mesh(), scale=25.0)
    atlas = make_atlas(texf.positions, texf.faces, 128, "fast")
    errors = []
    for sweeps in (0, 4):
        monkeypatch.setattr(system_room, "SWEEPS", sweeps)
        points, uv, face = surface_samples(texf, atlas.corner_uv)
        shown = looked_up(bake(texf, atlas=atlas).image, uv)
        errors.append(((shown - texf.query(points, face)[:, :3]) ** 2).mean())
    assert errors[1] < 0.6 * errors[0]


def looked_up(image, uv):
    height, width = image.shape[:2]
    place = np.clip(uv * [width, height] - 0.5, 0, [width - 1, height - 1])
    low = np.minimum(place.astype(int), [width - 2, height - 2])
    (u, v), texel = (place - low).T[..., None], image[..., :3].astype(float)
    x, y = low.T
    upper, lower = (texel[y + k, x] * (1 - u) + texel[y + k, x + 1] * u for k in range(2))
    return upper * (1 - v) + lower * v


def test_colours_that_nobody_sees_do_not_darken_their_neighbours():
    texf = decoded(*grid_mesh(9), has_alpha=True, materials=[Material("leaf", alpha_mode=ALPHA_MASK)])
    hidden = lambda p: (np.floor(p[:, :1] * 9) + np.floor(p[:, 1:2] * 9)) % 2 > 0
    texf.query = lambda p, f: np.where(hidden(p), [[0, 0, 0, 0]], [[200, 100, 50, 255]]).astype(np.float32)
    image = bake(texf, 128, "fast").image
    assert (image[..., :3] == [200, 100, 50]).all() and {0, 255} <= set(np.unique(image[..., 3]))


def test_faces_without_area_and_meshes_without_faces_bake():
    texf = rough(*grid_mesh(4))
    texf.faces = np.vstack([texf.faces, [[0, 0, 0], [1, 1, 2]]])
    texf.face_material = texf.face_field = np.zeros(len(texf.faces), np.int64)
    assert bake(texf, 64, "fast").image.shape == (64, 64, 4)
    assert not bake(rough(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), 64, "fast").image[..., :3].any()


# Gutters.


def test_padding_shows_what_lies_beyond_the_border():
    atlas, positions, faces = two_squares(128)
    system = AtlasSystem(atlas, positions, faces)
    colour = lambda points: np.rint(40 + 80 * points[:, :1])
    image = np.zeros((128, 128, 1), np.uint8)
    image[system.covered] = system.fitted(lambda p, f: colour(p).astype(np.float32), 1)
    beyond = continue_over_borders(image, system)
    row, column = np.nonzero(beyond)
    assert len(row) > 80 and not (beyond & system.covered).any()
    x = (column + 0.5) / 128
    right_of_the_first = x < 0.5  # the first square's padding: its x axis goes on to the right
    wanted = 40 + 80 * (x - 0.05) / 0.35
    assert np.abs(image[row, column, 0] - wanted)[right_of_the_first].max() < 4
    y = (row + 0.5) / 128
    assert np.abs(image[row, column, 0] - (120 + 80 * (y - 0.55) / 0.35))[~right_of_the_first].max() < 4


def test_padding_does_not_show_what_lies_around_a_sharp_edge():
    atlas, positions, faces = two_squares(128)
    positions[4:] = [[1, 0, 1], [1, 1, 1]]
    system = AtlasSystem(atlas, positions, faces)
    assert not continue_over_borders(np.full((128, 128, 1), 9, np.uint8), system).any()


def test_padding_never_shows_another_chart_than_the_one_beyond():
    texf = rough(*soup_mesh(300))
    system = AtlasSystem(make_atlas(texf.positions, texf.faces, 256, "fast"), texf.positions, texf.faces)
    image = np.full((*system.owner.shape, 1), 7, np.uint8)
    assert not continue_over_borders(image, system).any() and (image == 7).all()  # loose faces share no edge


def test_fit_and_padding_make_charts_agree(monkeypatch):
    texf = rough(*sphere_mesh(), scale=8.0)
    atlas = make_atlas(texf.positions, texf.faces, 512, "fast")
    after = seams_of(texf, atlas)
    monkeypatch.setattr("texfcodec.io.atlas.bake.continue_over_borders", lambda image, system: np.zeros(image.shape[:2], bool))
    without_padding = seams_of(texf, atlas)
    monkeypatch.setattr(system_room, "SWEEPS", 0)
    before = seams_of(texf, atlas)
    assert after["mean"][0] < 0.7 * before["mean"][0] and without_padding["mean"][0] == after["mean"][0]
    assert all(a < 0.85 * b for a, b in zip(after["mean"][1:3], without_padding["mean"][1:3], strict=True))


def seams_of(texf, atlas):
    texture = Texture(bake(texf, atlas=atlas).image, CLAMP)
    return measure_seams(texf.positions, texf.faces, atlas.corner_uv, [texture], np.zeros(len(texf.faces), np.int64))


# The measure.


def test_seams_of_a_known_jump_are_that_jump_at_every_level():
    atlas, positions, faces = two_squares(64)
    image = np.full((64, 64, 3), 90, np.uint8)
    image[32:] = 130
    told = measure_seams(positions, faces, atlas.corner_uv, [Texture(image, CLAMP)], np.zeros(4, np.int64))
    assert told["border_edges"] == 1 and told["points"] == int(np.ceil(0.35 * 64)) and len(told["mean"]) == LEVELS
    assert np.allclose(told["mean"][:3], 40, atol=0.01) and np.allclose(told["largest"][:3], 40, atol=0.01)


def test_levels_are_halved_in_linear_light_as_viewers_do():
    atlas, positions, faces = two_squares(64)
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32] = 255 * ((np.indices((32, 64)).sum(0) % 2)[..., None])
    told = measure_seams(positions, faces, atlas.corner_uv, [Texture(image, CLAMP)], np.zeros(4, np.int64))
    assert told["mean"][1] == pytest.approx(187.5, abs=0.5)  # half the light of white, sRGB-coded


def test_edges_inside_a_chart_and_open_edges_are_no_borders():
    positions, faces = grid_mesh(6)
    half, _ = border_edges(positions, faces, positions[faces][..., :2], np.zeros(len(faces), np.int64))
    assert half.shape == (2, 0)


def test_borders_are_found_where_vertices_are_doubled_and_where_images_change():
    positions, faces = grid_mesh(3)
    apart, loose = positions[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    uv = positions[faces][..., :2].copy()
    uv[: len(faces) // 2, :, 0] += 0.5
    one = border_edges(positions, faces, uv, np.zeros(len(faces), np.int64))
    two = border_edges(apart, loose, uv, np.zeros(len(faces), np.int64))
    assert one[0].shape[1] == two[0].shape[1] > 0 and np.array_equal(one[1], two[1])
    image = np.arange(len(faces)) % 2
    assert border_edges(positions, faces, positions[faces][..., :2], image)[0].shape[1] > 0


@pytest.mark.parametrize(("wrap", "jump"), [(WRAP_REPEAT, 0.0), (WRAP_MIRROR, 0.0), (WRAP_CLAMP, 180.0)])
def test_seams_follow_the_wrap_mode(wrap, jump):
    atlas, positions, faces = two_squares(64)
    uv = atlas.corner_uv.copy()
    uv[:2] = positions[faces[:2]][..., :2] * [0.2, 0.5] + [0.3, 0.25]  # the border lies at x = 0.5 of this side
    uv[2:] = positions[faces[2:]][..., :2] * [0.2, 0.5] + [0.3 + 2, 0.25]  # and here two tiles on
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, 60:] = 180
    told = measure_seams(positions, faces, uv, [Texture(image, (wrap, wrap))], np.zeros(4, np.int64))
    assert told["mean"][0] == pytest.approx(jump, abs=0.01)


def test_without_borders_nothing_jumps():
    texf = SimpleNamespace(positions=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int64))
    told = measure_seams(texf.positions, texf.faces, np.zeros((0, 3, 2)), [], np.zeros(0, np.int64))
    assert told == {"border_edges": 0, "points": 0, "mean": [0.0] * LEVELS, "largest": [0.0] * LEVELS}


@pytest.mark.parametrize("hand", [1, -1])
def test_a_bent_normal_is_told_along_the_tangents_of_its_face(hand):
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    normals = np.broadcast_to(np.float32([0, 0, 1]), (1, 3, 3)).copy()
    tangents = np.broadcast_to(np.float32([0, 1, 0, hand]), (1, 3, 4)).copy()  # u goes along y, v along x or against it
    points, face = np.array([[0.2, 0.3, 0], [0.1, 0.1, 0], [0.5, 0.2, 0]]), np.zeros(3, np.int64)
    offsets = np.float32([[FLAT, FLAT, FLAT], [2 * FLAT, FLAT, FLAT], [FLAT, 0, FLAT]])  # as it is, by 45 degrees to x, and to -y
    xy = np.empty((3, 2), np.float32)
    _in_tangent_space(points, face, corners, normals, tangents, offsets, xy)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(xy / FLAT - 1, [[0, 0], [0, -hand * half], [-half, 0]], atol=1e-6)
