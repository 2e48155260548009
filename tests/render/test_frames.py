"""Shading normals of points: what maps say, and that every input, whatever it is, gives a unit normal."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from oracles import shading as naive
from texfcodec.render.tangent_frames import (
    deviated_normals,
    interpolate_corners,
    tangent_space_normals,
    towards_viewer,
    usable_normals,
)

UP, X = np.array([[0, 0, 1]], np.float32), np.array([[1, 0, 0, 1]], np.float32)
SIDE = np.array([[0, 1, 0]], np.float32)


def of_map(texel, scale=1.0, normal=UP, tangent=X, geometric=UP):
    return tangent_space_normals(np.array([texel]), scale, normal, tangent, geometric)[0]


def test_texels_lean_the_normal_along_tangent_and_bitangent():
    assert_allclose(of_map((127.5, 127.5)), [0, 0, 1], atol=1e-7)
    lean = 127.5 * (1 + 0.6)
    assert_allclose(of_map((lean, 127.5)), [0.6, 0, 0.8], atol=1e-6)
    assert_allclose(of_map((127.5, lean)), [0, 0.6, 0.8], atol=1e-6)
    assert_allclose(of_map((127.5, lean), tangent=-X), [0, 0.6, 0.8], atol=1e-6)  # sign and tangent turned: the same bitangent
    assert_allclose(of_map((127.5, lean), tangent=X * [1, 1, 1, -1]), [0, -0.6, 0.8], atol=1e-6)


def test_scale_is_applied_before_the_length_is_renewed():
    assert_allclose(of_map((127.5 * 1.6, 127.5), scale=0.5), naive.unit((0.3, 0, 0.8)), atol=1e-6)
    assert_allclose(of_map((127.5 * 1.6, 127.5), scale=0), [0, 0, 1], atol=1e-7)
    both = tangent_space_normals(np.full((2, 2), 200.0), np.array([0.0, 1.0]), *(np.repeat(a, 2, axis=0) for a in (UP, X, UP)))
    assert_allclose(both[0], [0, 0, 1], atol=1e-7)
    assert both[1, 2] < 0.9


def test_texels_longer_than_one_lie_in_the_surface():
    assert_allclose(of_map((255, 255)), naive.unit((1, 1, 0)), atol=1e-6)


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_input_of_no_use_gives_the_normal_that_is_left(bad):
    broken3, broken4 = np.full((1, 3), bad, np.float32), np.full((1, 4), bad, np.float32)
    assert_array_equal(of_map((200, 90), tangent=broken4), UP[0])
    assert_array_equal(of_map((200, 90), normal=broken3, tangent=broken4, geometric=SIDE), SIDE[0])
    assert_array_equal(of_map((200, 90), normal=broken3, tangent=broken4, geometric=broken3), UP[0])
    assert_array_equal(usable_normals(broken3, 5 * SIDE), SIDE)
    if not bad == 0:
        assert_array_equal(of_map((bad, 90), normal=SIDE), SIDE[0])
        assert_array_equal(deviated_normals(broken3, SIDE, UP), SIDE)


def test_deviations_are_added_and_the_length_renewed():
    assert_allclose(deviated_normals(np.array([[0.75, 0, 0]]), UP, UP), [[0.6, 0, 0.8]], atol=1e-6)
    assert_array_equal(deviated_normals(np.zeros((1, 3)), 3 * SIDE, UP), SIDE)
    assert_array_equal(deviated_normals(-SIDE, SIDE, UP), SIDE)  # a sum without a direction
    assert_allclose(deviated_normals(SIDE, np.full((1, 3), np.nan, np.float32), UP), [naive.unit((0, 1, 1))], atol=1e-6)


def test_normals_turn_to_the_viewer_with_their_face():
    normal = np.array([[0.6, 0, 0.8], [0.6, 0, 0.8]], np.float32)
    got = towards_viewer(normal, np.repeat(UP, 2, axis=0), np.array([[0, 0, 1], [0.1, 0, -1]], np.float32))
    assert_array_equal(got, [normal[0], -normal[1]])


def test_corners_are_mixed_by_their_weights():
    corner = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    got = interpolate_corners(corner, np.array([1, 0]), np.array([[0.5, 0.25, 0.25], [0, 0, 1.0]]))
    assert_allclose(got, [[7.5, 8.5], [4, 5]])
