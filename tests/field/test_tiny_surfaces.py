"""A few faces through the kernels that sample a scene and lay out an atlas, small enough to run where these are plain Python."""

import numpy as np
import pytest

from texfcodec.io.atlas import chart_packing
from texfcodec.io.atlas.chart_packing import pack_charts, upright
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, Material, Scene, Texture
from texfcodec.scene.srgb import linear_to_srgb

CORNERS = np.array([[0.1, 0.2], [0.4, 0.3], [0.2, 0.6]])
IMAGE = np.random.default_rng(3).integers(0, 256, (4, 5, 4), np.uint8)


def scene_of(materials, uv=CORNERS, wrap=WRAP_CLAMP, colour=None):
    """One face for each material, with these UVs."""
    faces = np.arange(3 * len(materials)).reshape(-1, 3)
    return Scene(positions=np.zeros((faces.size, 3)), faces=faces, face_material=np.arange(len(materials)),
                 corner_uv=np.repeat(uv[None], len(materials), axis=0), corner_color=colour, materials=materials,
                 textures=[Texture(IMAGE, (wrap, wrap))])


def sampled(scene):
    """float32 [M, 4] at the corners and the middle of every face, in order."""
    places = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.25, 0.25, 0.5]])
    count = len(scene.faces)
    return sample_source(pack_source(scene), np.repeat(np.arange(count), 4), np.tile(places, (count, 1)))


@pytest.mark.parametrize("wrap, moved", [(WRAP_REPEAT, CORNERS + [3, -2]), (WRAP_MIRROR, -CORNERS), (WRAP_MIRROR, 2 - CORNERS),
                                         (WRAP_MIRROR, CORNERS + 2)])
def test_what_lies_beside_the_image_is_what_the_wrap_mode_says(wrap, moved):
    blend = [Material(texture=0, alpha_mode=ALPHA_BLEND)]
    np.testing.assert_allclose(sampled(scene_of(blend, moved, wrap)), sampled(scene_of(blend, wrap=wrap)), atol=1e-3)


def test_beside_a_clamped_image_is_its_last_texel():
    far = sampled(scene_of([Material(texture=0, alpha_mode=ALPHA_BLEND)], CORNERS + 9))
    np.testing.assert_array_equal(far, np.tile(IMAGE[-1, -1].astype(np.float32), (4, 1)))


def test_factors_and_corner_colours_multiply_in_linear_light():
    materials = [Material(factor=(0.5, 1.0, 0.25, 0.5)), Material(factor=(0.5, 1.0, 0.25, 0.5), alpha_mode=ALPHA_BLEND)]
    half = np.full((2, 3, 4), 0.5, np.float32)
    plain, tinted = sampled(scene_of(materials)), sampled(scene_of(materials, colour=half))
    for found, gain in ((plain, 1.0), (tinted, 0.5)):
        wanted = 255 * linear_to_srgb(np.array([0.5, 1.0, 0.25]) * gain)
        np.testing.assert_allclose(found[:, :3], np.tile(wanted, (8, 1)), atol=0.1)
        assert (found[:4, 3] == 255).all() and np.allclose(found[4:, 3], 255 * 0.5 * gain)


def test_a_face_outside_the_source_is_no_question():
    with pytest.raises(IndexError, match="outside the source"):
        sample_source(pack_source(scene_of([Material(texture=0)])), np.array([1]), np.array([[1.0, 0, 0]]))


def charts(count, width, height):
    """(flat, chart, extent) of rectangles of two faces each, upright."""
    corner = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    flat = np.tile(corner[[[0, 1, 2], [0, 2, 3]]], (count, 1, 1))
    chart = np.repeat(np.arange(count), 2)
    turned, extent = upright(flat, chart, count)
    return turned, chart, extent


@pytest.mark.parametrize("searched", [2, 1000])
@pytest.mark.parametrize("count, width, height", [(1, 1, 1), (5, 1, 3), (30, 0.2, 2)])
def test_charts_are_packed_into_the_square_beside_each_other(monkeypatch, searched, count, width, height):
    monkeypatch.setattr(chart_packing, "_SEARCHED", searched)
    flat, chart, extent = charts(count, width, height)
    placed, scale = pack_charts(flat, chart, extent, 48, 1)
    assert scale > 0 and placed.min() >= 0.5 and placed.max() <= 47.5
    boxes = [(placed[chart == c].min(axis=(0, 1)), placed[chart == c].max(axis=(0, 1))) for c in range(count)]
    apart = [(a[1] + 0.99 <= b[0]).any() or (b[1] + 0.99 <= a[0]).any() for i, a in enumerate(boxes) for b in boxes[:i]]
    assert all(apart)


def test_padding_that_leaves_no_room_is_told():
    flat, chart, extent = charts(40, 1, 1)
    assert pack_charts(flat, chart, extent, 8, 2) == (None, 0.0)
