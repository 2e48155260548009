"""Vertex colours under a material with maps: into the texels where each shows one colour, over voxels where not."""

import numpy as np
import pytest
from test_rotated_maps import grid

from texfcodec import EncodeOptions, decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.supports.image_groups import image_groups
from texfcodec.geometry.surface import make_surface
from texfcodec.scene.fetch import pack_source, sample_source


def painted(shared=False, textured=True):
    """The plane of test_rotated_maps, its vertices red on the left and green on the right."""
    scene, _ = grid(shared=shared)
    right = scene.positions[scene.faces][:, :, :1] / 8
    scene.corner_color = np.concatenate([1 - right, right, 0.3 + 0 * right, 1 + 0 * right], axis=2).astype(np.float32)
    scene.corner_tangent = None
    if not textured:
        scene.materials[0].texture = -1
    return scene


@pytest.mark.parametrize("textured", [True, False])
def test_vertex_colours_go_into_texels_and_come_back(textured):
    scene = painted(textured=textured)
    made = encode_scene(scene, EncodeOptions(support="texels", qp=8, threads=1))
    texf = decode(made.data)
    assert made.counts["voxels"] == 0 and len(texf.fields) == 1
    bary = np.full((len(texf.faces), 3), 1 / 3)
    points = texf.positions[texf.faces].mean(axis=1)
    middles = scene.positions[scene.faces].mean(axis=1)
    face = np.linalg.norm(points[:, None] - middles, axis=2).argmin(axis=1)
    want = sample_source(pack_source(scene), face, bary)[:, :3]
    got = texf.query(points, np.arange(len(points)))[:, :3]
    assert np.abs(got - want).max() < 8 and np.sqrt(((got - want) ** 2).mean()) < 2.5


def test_faces_that_share_texels_and_not_colours_stay_over_voxels():
    scene = painted(shared=True)
    assert image_groups(scene, make_surface(scene, EncodeOptions())) == []
    (group,) = image_groups(painted(), make_surface(painted(), EncodeOptions()))
    assert len(group.faces) == 128 and (group.factor == 1).all()
