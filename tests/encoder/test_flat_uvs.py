"""Faces whose UVs have no area under a normal map: only the file's TANGENTs say what the map means there."""

import numpy as np
import pytest

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.io.load import load
from texfcodec.render.lit_scene import SceneMaps
from texfcodec.render.tangent_frames import tangent_space_normals
from texfcodec.report import Report
from texfcodec.scene.channels import channel_over
from texfcodec.scene.scene import Material, Scene, Texture

TEXELS = EncodeOptions(support="texels", qp=4, threads=1)
TILT = (230, 128)  # of the one texel that the flat faces see


def strips(tangent=(0.0, 1.0, 0.0, 1.0), flat=True):
    """Two squares side by side: one with ordinary UVs, one whose UVs are one point, under a normal map of noise."""
    positions = np.array([[x, y, 0.0] for x in range(3) for y in range(2)])
    faces = np.array([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    uv = (positions[:, [0, 1]] * [0.8, 0.8] + 0.1)[faces]
    if flat:
        uv[2:] = (3.5 / 16, 12.5 / 16)
    rng = np.random.default_rng(0)
    colour = np.dstack([rng.integers(60, 200, (16, 16, 3)), np.full((16, 16), 255)]).astype(np.uint8)
    bumps = np.dstack([rng.integers(110, 146, (16, 16, 2)), np.full((16, 16, 2), 255)]).astype(np.uint8)
    bumps[11:14, 2:6, :2] = TILT
    materials = [Material("skin", texture=0, maps={"normal": 1})]
    scene = Scene(positions, faces, np.zeros(4, np.int64), uv, None, materials, [Texture(colour), Texture(bumps)])
    scene.corner_normal = np.tile(np.float32([0, 0, 1]), (4, 3, 1))
    if tangent is not None:
        scene.corner_tangent = np.tile(np.float32([1, 0, 0, 1]), (4, 3, 1))
        scene.corner_tangent[2:] = tangent
    return scene


def shown(scene_or_texf, maps, faces):
    """Normals that light sees at the middle of faces, float32 [N, 3]."""
    bary = np.full((len(faces), 3), 1 / 3)
    texel = maps.sampler(None, 0, {"normal"}, False)({"normal"}, faces, bary, None)["normal"]
    normal = maps.corner_normal[faces].mean(axis=1)
    return tangent_space_normals(texel, 1.0, normal, maps.tangents("normal", faces, bary), np.zeros_like(normal))


def of_right(texf_or_scene):
    """Faces of the square whose UVs are a point."""
    return np.flatnonzero(texf_or_scene.positions[texf_or_scene.faces][:, :, 0].min(axis=1) > 0.99)


@pytest.mark.parametrize("tangent", [(0, 1, 0, 1), (-1, 0, 0, 1), (0.6, 0.8, 0, -1)])
def test_the_map_goes_into_the_shading_normals_where_uvs_make_no_frame(tmp_path, tangent):
    scene = strips(tangent)
    want = shown(scene, SceneMaps(scene), np.array([2, 3]))
    assert np.degrees(np.arccos(want[:, 2])).min() > 30
    data = encode_scene(scene, TEXELS)
    texf = decode(data.data)
    right = of_right(texf)
    got = texf.shading_normals()[right].mean(axis=1)
    assert np.degrees(np.arccos(np.clip((got * want).sum(axis=1), -1, 1))).max() < 1.5
    texf.save(tmp_path / "a.glb")
    back = load(tmp_path / "a.glb")
    faces = of_right(back)
    assert all("normal" not in back.materials[m].maps for m in back.face_material[faces])
    assert np.degrees(np.arccos(np.clip((back.corner_normal[faces].mean(axis=1) * want).sum(axis=1), -1, 1))).max() < 1.5
    others = np.setdiff1d(np.arange(len(back.faces)), faces)
    assert all("normal" in back.materials[m].maps for m in back.face_material[others])


def test_without_tangents_of_the_file_nothing_is_folded():
    """Then the map says nothing of these faces in the source either."""
    texf = decode(encode_scene(strips(None), TEXELS).data)
    assert np.allclose(texf.shading_normals(), [0, 0, 1], atol=1e-6) and texf.coded_normals is None
    scene = strips(None)
    assert np.allclose(shown(scene, SceneMaps(scene), np.array([2, 3])), [0, 0, 1])


def test_over_voxels_the_map_is_a_deviation_and_needs_no_frame():
    texf = decode(encode_scene(strips(), TEXELS.changed(support="voxels", resolution=32, qp=4)).data)
    assert np.allclose(texf.shading_normals(), [0, 0, 1], atol=1e-6)
    deviation = texf.fields[0].planes[channel_over("normal", False).name].astype(float) / 127.5 - 1
    assert (np.linalg.norm(deviation, axis=1) > 0.4).mean() > 0.4  # half of the surface is tilted by more than 30 degrees


def test_tangents_that_texels_cannot_hold_are_a_warning_with_degrees_and_a_share():
    """Half of the surface has TANGENTs at a right angle to its UVs, and bumps of some degrees; where all have, maps turn."""
    def warned(scene):
        report = Report()
        choices = encode_scene(scene, TEXELS, report).choices["normals"]
        return [text for text in report.warnings if text.startswith("normal maps differ in direction")], choices

    (text,), choices = warned(strips((0, 1, 0, 1), flat=False))
    assert choices["mapped_degrees"][1] > 5 and f"{choices['mapped_degrees'][0]} degrees" in text
    right = strips((1, 0, 0, 1), flat=False)
    assert warned(right)[0] == [] and warned(right)[1]["mapped_degrees"][2] < 0.1
    right.corner_tangent[...] = (0, 1, 0, 1)
    assert warned(right)[0] == []


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("tangent", [(0, 1, 0, 0), (0, 1, 0, 2), (0, 0, 1, 1), (1e-30, 0, 0, 1), (1e20, 0, 0, 1), (0, 0, 0, 1)])
def test_tangents_that_make_no_frame_leave_normals_of_length_1(tangent, flat):
    """No sign or a strange one, along the normal, next to nothing, huge, zero."""
    normals = decode(encode_scene(strips(tangent, flat), TEXELS).data).shading_normals()
    assert np.abs(np.linalg.norm(normals.astype(float), axis=2) - 1).max() < 1e-6
