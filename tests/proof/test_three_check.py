"""three_check of tools/proof: what it passes to three.js, how pictures are compared; both renderers on one mesh."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from browser import BROWSER
from mesh_files import Builder

from texfcodec.geometry.areas import face_areas
from texfcodec.geometry.tangents import corner_tangents
from texfcodec.io.load import load
from texfcodec.metrics.views import ViewSettings, compare_views
from texfcodec.render.camera import to_camera
from texfcodec.render.environment import DAYLIGHT
from tools.proof import three_check
from tools.proof.public_models.run import node_modules
from tools.proof.three_check import (
    Shown,
    agreement,
    arguments_of,
    camera_json,
    cameras_of,
    light_of,
    lights_json,
    ours,
    sky_map,
    theirs,
)

MODULES = Path(__file__).resolve().parents[2] / "out" / "public_models"


def ball(path, roughness=0.5, rows=24):
    """A GLB of a smooth grey ball at a path: the path."""
    up, round_ = np.meshgrid(np.linspace(0, np.pi, rows), np.linspace(0, 2 * np.pi, 2 * rows), indexing="ij")
    points = np.stack([np.sin(up) * np.sin(round_), np.cos(up), np.sin(up) * np.cos(round_)], -1).reshape(-1, 3)
    at, points = np.arange(len(points)).reshape(rows, -1), points.astype(np.float32)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    builder = Builder()
    pbr = {"baseColorFactor": [0.6, 0.5, 0.3, 1], "roughnessFactor": roughness, "metallicFactor": 0.5}
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint16)
    builder.primitive(points, faces, material=builder.material(pbr=pbr), attributes={"NORMAL": builder.accessor(points)})
    path.write_bytes(builder.glb())
    return path


def test_the_sky_map_has_the_skys_radiance_from_the_nadir_up_and_lights_keep_their_irradiance():
    sky = sky_map(light_of("daylight"))
    assert sky.shape == (*three_check.SKY_SIZE[::-1], 4) and sky.dtype == np.float32 and (sky[..., 3] == 1).all()
    ends = DAYLIGHT.radiance(np.array([[0, 0], [-1, 1], [0, 0]], float)).T
    np.testing.assert_allclose(sky[[0, -1], 0, :3], ends, atol=1e-3)
    assert (sky == sky[:, :1]).all() and sky_map(light_of("lights")) is None
    assert lights_json(light_of("sky")) == [] and len(lights_json(light_of("lights"))) == len(DAYLIGHT.lights)
    for told, light in zip(lights_json(light_of("daylight")), DAYLIGHT.lights, strict=True):
        np.testing.assert_allclose(told["colour"], light.irradiance)
        np.testing.assert_allclose(told["direction"], light.direction)


def test_cameras_say_what_a_matrix_of_three_js_asks(tmp_path):
    scene = load(ball(tmp_path / "ball.glb"))
    for camera in cameras_of(scene, 5, 64):
        told = json.loads(json.dumps(camera_json(camera)))
        axes = np.array([told["right"], told["up"], told["forward"]])
        assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) < 0  # three.js looks along -z
        place = np.array(told["eye"]) + told["depth"] * axes[2] + told["half"] * (0.5 * axes[0] + 0.25 * axes[1])
        np.testing.assert_allclose(to_camera(camera, place[None])[0][:2], [16, -8], atol=1e-6)


def test_pixels_count_that_both_cover_and_all_samples_of_a_pixel_do():
    white, black = np.full((4, 4, 3), 255, np.uint8), np.zeros((4, 4, 3), np.uint8)
    whole, half = np.ones((4, 4), bool), np.arange(16).reshape(4, 4) < 8
    one, other = Shown([white], [whole]), Shown([np.where(half[..., None], white - 10, black)], [half])
    psnr, _, share, far = agreement(one, other)
    assert psnr == pytest.approx(20 * np.log10(25.5), abs=1e-6) and (share, far) == (0.5, 1.0)
    assert agreement(one, one) == (np.inf, np.inf, 1.0, 0.0)
    averaged, covered = Shown([], []), half.copy()
    covered[0, 0] = False
    averaged.add(np.where(half[..., None], white, black), covered, 2)
    assert averaged.images[0][..., 0].tolist() == [[255, 255], [0, 0]]
    assert averaged.covered[0].tolist() == [[False, True], [False, False]]


def test_our_side_is_what_texf_eval_shaded_compares(tmp_path):
    scenes = [load(ball(tmp_path / f"{n}.glb", roughness)) for n, roughness in enumerate((0.3, 0.5))]
    settings, cameras = ViewSettings(environment=DAYLIGHT), cameras_of(scenes[0], 3, 96)
    wanted = compare_views(*scenes, views=3, size=96, settings=settings)
    _, got, _, _ = agreement(*(ours(scene, cameras, settings) for scene in scenes))
    assert got == pytest.approx(wanted["psnr"]["y"], abs=1e-9)


def test_raw_pictures_are_read_from_below(tmp_path):
    raw = np.zeros((2, 2, 4), np.uint8)
    raw[0] = 9, 9, 9, 255  # the lower row
    raw.tofile(tmp_path / "x-0.rgba")
    shown = theirs(tmp_path, "x", 1, 2)
    assert shown.covered[0].tolist() == [[False, False], [True, True]] and shown.images[0][1, 0].tolist() == [9, 9, 9]


def test_the_command_line_takes_all_that_is_alike_at_once_and_needs_something_to_draw(capsys):
    assert arguments_of(["--assets", "assets", "--alike", "all"]).alike == list(three_check.ALIKE)
    with pytest.raises(SystemExit):
        arguments_of([])
    assert "pairs" in capsys.readouterr().err


@pytest.fixture(scope="module")
def modules():
    """A folder in which node finds three.js, where a browser is too."""
    if BROWSER is None or not shutil.which("node"):
        pytest.skip("no Chromium or no node to draw with")
    return node_modules(MODULES) or pytest.skip("npm cannot install three.js")


def test_three_js_lights_a_ball_as_we_do(modules, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(os.environ, "CHROMIUM", BROWSER)
    one, other = ball(tmp_path / "one.glb"), ball(tmp_path / "other.glb", 0.4)
    three_check.main(["--pair", str(one), str(other), "--size", "96", "--alike", "all", "--modules", str(modules),
                      "--out", str(tmp_path / "out"), "--pictures"])
    lines = capsys.readouterr().out.splitlines()
    ours_, three, less, *agree, covered = (cell.strip().split()[0] for cell in lines[-1].split("|")[2:-1])
    assert lines[0].startswith("three.js r187, daylight, alike: roughness")
    assert abs(float(less)) < 0.3 and float(ours_) < 45 and min(map(float, agree)) > 42 and float(covered) > 99
    assert len(list((tmp_path / "out" / "pictures").glob("*.png"))) == 4


MIKKTSPACE = """
import { readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
const from = createRequire(path.join(process.cwd(), 'x.js')).resolve('three');
const mikktspace = await import(path.join(from, '../../examples/jsm/libs/mikktspace.module.js'));
await mikktspace.ready;
const read = (name) => new Float32Array(Uint8Array.from(readFileSync(process.argv[1] + name)).buffer);
const parts = ['positions', 'normals', 'uvs'].map(read);
writeFileSync(process.argv[1] + 'tangents', Buffer.from(mikktspace.generateTangents(...parts).buffer));
"""


def test_frames_made_of_uvs_are_those_of_mikktspace(modules, shared_dir, tmp_path):
    scene = load(shared_dir / "assets" / "damaged_helmet.glb")
    arrays = {"positions": scene.positions[scene.faces], "normals": scene.corner_normal, "uvs": scene.corner_uv}
    for name, values in arrays.items():
        np.ascontiguousarray(values, np.float32).tofile(tmp_path / name)
    subprocess.run(["node", "--input-type=module", "-e", MIKKTSPACE, f"{tmp_path}/"], cwd=modules, check=True)
    theirs_ = np.fromfile(tmp_path / "tangents", np.float32).reshape(-1, 3, 4)
    made = corner_tangents(scene.positions, scene.faces, scene.corner_uv, scene.corner_normal)
    has, areas = made.any(axis=2), np.repeat(face_areas(scene.positions, scene.faces)[:, None], 3, axis=1)
    same = np.linalg.norm(made[..., :3] - theirs_[..., :3], axis=2) < 1e-3
    assert areas[has & same].sum() > 0.99 * areas[has].sum() and (areas * has).sum() > 0.999 * areas.sum()
    assert (made[..., 3] == -theirs_[..., 3])[has].all()  # glTF counts v downwards
