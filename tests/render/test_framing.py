"""The camera that frames a model: all of it is in the picture, and it fills as much as the picture's shape lets it."""

import json

import numpy as np
import pytest
from analytic import grid_mesh
from shapes import scene_of

from texfcodec.errors import InputError
from texfcodec.render.camera import MARGIN, bounding_sphere, framing, orthographic, project
from texfcodec.render.raster import rasterise
from texfcodec.render.shade import render_scene

DIRECTIONS = [(0, 0, 1), (1, 0.4, 1), (0, 1, 0), (-0.2, -1, 0.1)]


def standing(count=500):
    """A cloud as slim as a person, far from the origin."""
    return np.random.default_rng(0).uniform(-1, 1, (count, 3)) * (0.25, 1.8, 0.15) + (70, -3, 5)


@pytest.mark.parametrize("fov", [None, 15.0, 60.0, 120.0])
@pytest.mark.parametrize("size", [(300, 300), (640, 200), (100, 400)])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_every_point_is_in_the_picture_and_some_touch_its_margin(direction, size, fov):
    seen = project(framing(direction, standing(), size, fov), standing())
    share = np.abs(seen[:, :2] / size * 2 - 1)
    assert share.max() <= 1 / MARGIN + 1e-9 and share.max() >= (1 / MARGIN - 1e-9 if fov is None else 0.85)
    assert (seen[:, 2] > 0).all()


def test_a_standing_person_fills_the_height_of_the_picture():
    box = np.array([[x, y, z] for x in (-0.25, 0.25) for y in (0, 1.8) for z in (-0.15, 0.15)])
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                      [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    scene = scene_of(box, faces)
    share = {}
    for name, camera in (("framed", framing((0, 0, 1), box, (200, 360))),
                         ("sphere", orthographic((0, 0, 1), *bounding_sphere(box), (200, 360)))):
        share[name] = len(render_scene(scene, camera, threads=1).pixel) / (200 * 360)
    assert share["sphere"] < 0.15 and share["framed"] > 0.45


@pytest.mark.parametrize("points", [np.zeros((0, 3)), [[5, 6, 7]], [[np.nan, 0, 0]], [[1, 2, 3], [1, 2, 3]]])
@pytest.mark.parametrize("fov", [None, 40.0])
def test_nothing_and_a_single_point_stand_for_a_sphere_of_radius_1(points, fov):
    camera = framing((0, 0, 1), np.asarray(points, float), 64, fov)
    if fov is None:
        assert camera.half == pytest.approx(MARGIN)
    assert np.isfinite(camera.eye).all()


def test_a_flat_model_seen_edge_on_is_drawn_in_a_finite_picture():
    positions, faces = grid_mesh(4)
    flat = positions * (1, 0, 1)
    camera = framing((0, 0, 1), flat, 64)
    assert len(rasterise(camera, flat, faces, cull=False).pixel) <= 2 * 64 and camera.half > 0.4


def test_points_beyond_all_numbers_are_refused():
    with pytest.raises(InputError, match="TXF-I9[12]"):
        framing((0, 0, 1), np.array([[-1e308] * 3, [1e308] * 3]), 64)


def test_texf_render_frames_the_model(call, tmp_path):
    lines = [f"v {x} {y} {z}" for x in (0, 0.4) for y in (0, 1.8) for z in (0, 0.3)]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\nf 1 5 7 3\nf 2 4 8 6\n")
    code, said, _ = call("texf-render", tmp_path / "a.obj", tmp_path / "a.png", "--size", "100x450", "--no-cull", "--json")
    facts = json.loads(said)
    assert code == 0 and facts["covered"] > 0.85 * facts["pixels"]
