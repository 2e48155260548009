"""Normal maps whose TANGENTs are not what the UVs make: their texels are turned, or faces get a field of their own."""

import numpy as np
import pytest

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.shading.frame_choice import mean_matrices, rotate_normal_map
from texfcodec.field.texel_set import shown_area
from texfcodec.metrics.shaded import compare_channels
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture

TEXELS = EncodeOptions(support="texels", qp=20, threads=1)
CLAMP = (1, 1)


def grid(side=8, size=64, shared=False):
    """Squares of a plane whose right half has TANGENTs at another angle to their UVs than the left; a normal map of waves.
    shared: whether both halves show the same texels."""
    positions = np.array([[x, y, 0.0] for x in range(side + 1) for y in range(side + 1)])
    low = np.array([x * (side + 1) + y for x in range(side) for y in range(side)])
    faces = np.concatenate([np.stack([low, low + side + 1, low + side + 2], 1), np.stack([low, low + side + 2, low + 1], 1)])
    uv = (positions[:, :2] / side * 0.96 + 0.02)[faces]
    right = positions[faces][:, :, 0].min(axis=1) >= side / 2
    if shared:
        uv[right, :, 0] -= 0.48
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    waves = [127.5 + 60 * np.sin(x / 5), 127.5 + 50 * np.cos((x + y) / 7), np.full(x.shape, 255.0), np.full(x.shape, 255.0)]
    colour = np.dstack([100 + 50 * np.sin(x / 9), 120 + 40 * np.cos(y / 8), x * 2, np.full(x.shape, 255)]).astype(np.uint8)
    textures = [Texture(colour, wrap=CLAMP), Texture(np.rint(np.dstack(waves)).astype(np.uint8), wrap=CLAMP)]
    scene = Scene(positions, faces, np.zeros(len(faces), np.int64), uv, None, [Material("m", texture=0, maps={"normal": 1})],
                  textures)
    scene.corner_normal = np.tile(np.float32([0, 0, 1]), (len(faces), 3, 1))
    scene.corner_tangent = np.tile(np.float32([1, 0, 0, 1]), (len(faces), 3, 1))
    return scene, right


def coded(scene):
    """(what the report says of normals, warnings about maps, degrees between normals with the map, fields)."""
    report = Report()
    made = encode_scene(scene, TEXELS, report)
    texf = decode(made.data)
    degrees = compare_channels(scene, texf, 20_000)["normals"]["with_map"]
    return made.choices["normals"], [w for w in report.warnings if w.startswith("normal maps")], degrees, len(texf.fields)


@pytest.mark.parametrize("tangent", [(1, 0, 0, -1), (0.8, 0.6, 0, 1), (0, -1, 0, 1)])
def test_texels_that_faces_of_one_frame_show_are_turned_into_it(tangent):
    scene, right = grid()
    scene.corner_tangent[right] = tangent
    said, warnings, degrees, fields = coded(scene)
    assert (said["turned_texels"] > 1000 and fields == 1) or said["split_fields"] == 1
    assert not warnings
    assert degrees["median_degrees"] < 1.5 and degrees["p95_degrees"] < 4


def test_faces_of_the_other_hand_that_share_texels_get_a_field_of_their_own():
    scene, right = grid(shared=True)
    scene.corner_tangent[right] = (1, 0, 0, -1)
    said, warnings, degrees, fields = coded(scene)
    assert said["split_fields"] == 1 and fields == 2 and not warnings
    assert degrees["median_degrees"] < 1.5 and degrees["p95_degrees"] < 4


def test_nothing_is_turned_where_all_frames_are_those_of_the_uvs():
    for shared in (False, True):
        said, warnings, degrees, fields = coded(grid(shared=shared)[0])
        assert said["turned_texels"] == said["split_fields"] == 0 and fields == 1 and not warnings


def test_a_file_without_tangents_is_left_alone():
    scene, _ = grid()
    scene.corner_tangent = None
    assert "turned_texels" not in coded(scene)[0]


def test_matrices_of_texels_are_means_by_area():
    """Two faces over the same texels, one of which needs a quarter turn and has three times the area."""
    uv = np.array([[[0.0, 0], [16, 0], [0, 16]]])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    texels, matrices = mean_matrices((uv, np.tile(turn, (1, 3, 1, 1)), np.array([3.0])), (uv, np.array([1.0])), np.ones(2),
                                     (16, 16), CLAMP)
    asked = shown_area((16 * uv[0]).astype(np.int64), np.array([[0, 1, 2]]), 4, (16, 16), CLAMP, np.ones(1)).ravel() > 0
    assert len(texels) == asked.sum()
    inside = np.isin(texels, np.flatnonzero(asked.reshape(16, 16)[1:, 1:]))
    assert np.allclose(matrices[inside], 0.75 * turn + 0.25 * np.eye(3), atol=1e-9)


def test_an_image_that_repeats_too_often_is_left_alone():
    uv = np.array([[[0.0, 0], [1 << 20, 0], [0, 1 << 20]]])
    none = np.zeros((0, 3, 2)), np.zeros(0)
    assert len(mean_matrices((uv, np.tile(np.eye(3), (1, 3, 1, 1)), np.ones(1)), none, np.ones(2), (16, 16), (0, 0))[0]) == 0


def test_frames_that_turn_over_inside_a_face_are_followed():
    """TANGENTs of a middle line: they point one way at two corners, and the other way at the third."""
    scene, right = grid(side=4)
    scene.corner_tangent[right, 0] = (-0.9, 0.4358899, 0, 1)
    said, _, degrees, _ = coded(scene)
    assert said["turned_texels"] > 500 and degrees["median_degrees"] < 1.5 and degrees["p95_degrees"] < 12


@pytest.mark.parametrize("scale", [1.0, 0.5, 3.0, 0.0])
def test_rotated_normals_point_where_the_matrix_sends_them(scale):
    rng = np.random.default_rng(0)
    texels = rng.integers(80, 176, (500, 2)).astype(np.float32)
    angle = rng.uniform(0, 2 * np.pi, 500)
    turn = np.zeros((500, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = (np.cos(angle), -np.sin(angle), np.sin(angle),
                                                                                 np.cos(angle), 1)
    got = rotate_normal_map(texels, turn, scale) / 127.5 - 1
    if scale:
        want = np.einsum("nij,nj->ni", turn[:, :2, :2], texels / 127.5 - 1)
        assert np.abs(got[:, :2] - want).max() <= 0.5 / 127.5 + 1e-6
    assert np.abs(np.linalg.norm(got, axis=1) - 1).max() < 0.01
