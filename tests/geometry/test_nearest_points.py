"""Nearest points of a mesh against all its triangles."""

import numpy as np
import pytest
from shapes import sphere, square

from texfcodec.geometry.mesh import Mesh, points_at
from texfcodec.geometry.nearest_points import BLOCK, NearestPoints


def nearest_by_hand(mesh, point):
    """Distance of a point to a mesh: inside of a triangle, or on a side."""
    best = np.inf
    for a, b, c in mesh.positions[mesh.faces]:
        bary = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)[0]
        inside = a + np.stack([b - a, c - a], axis=1) @ bary
        if bary.min() >= 0 and bary.sum() <= 1:
            best = min(best, np.linalg.norm(inside - point))
        for p, q in ((a, b), (b, c), (c, a)):
            share = np.clip((point - p) @ (q - p) / max((q - p) @ (q - p), 1e-300), 0, 1)
            best = min(best, np.linalg.norm(p + share * (q - p) - point))
    return best


@pytest.mark.parametrize("scale", [1.0, 1e9, 1e-9])
def test_nearest_points_agree_with_all_triangles(scale):
    rng = np.random.default_rng(0)
    faces = np.concatenate([rng.integers(0, 20, (25, 3)), [[3, 3, 3], [4, 4, 5], [6, 7, 6]]])  # and some without area
    for count in (1, 2, 5, 28):
        mesh = Mesh(rng.normal(size=(20, 3)) * scale, faces[-count:])
        points = rng.normal(size=(60, 3)) * 2 * scale
        nearest = NearestPoints(mesh).find(points)
        np.testing.assert_allclose(nearest.distance, [nearest_by_hand(mesh, p) for p in points], rtol=1e-6)
        off = np.linalg.norm(points_at(mesh, nearest.face, nearest.bary) - points, axis=1)
        np.testing.assert_allclose(off, nearest.distance, rtol=1e-9)
        assert nearest.bary.min() >= 0 and np.abs(nearest.bary.sum(axis=1) - 1).max() < 1e-12


def test_of_two_sheets_the_one_answers_that_faces_the_same_way():
    floor, ceiling = square(0.0), square(0.1)
    mesh = Mesh(np.concatenate([floor[0], ceiling[0]]), np.concatenate([floor[1], ceiling[1][:, ::-1] + 4]))
    point = np.array([[0.3, 0.4, 0.09]])
    nearest = NearestPoints(mesh)
    assert nearest.find(point).face[0] >= 2
    assert nearest.find(point, np.array([[0.0, 0, 1]]), 0.2).face[0] < 2
    assert nearest.find(point, np.array([[0.0, 0, 1]]), 0.05).face[0] >= 2  # but not from any distance
    assert nearest.find(point, np.array([[0.0, 0, 1]]), 0.2).distance[0] == pytest.approx(0.09)


def test_of_two_groups_the_points_own_answers_where_it_is_about_as_near():
    low, high = square(0.0), square(0.1)
    mesh = Mesh(np.concatenate([low[0], high[0]]), np.concatenate([low[1], high[1] + 4]))
    nearest, points = NearestPoints(mesh, np.array([7, 7, 3, 3])), np.tile([0.3, 0.4, 0.09], (4, 1))
    found = nearest.find(points, turn=0.2, group=np.array([7, 3, 5, -1]))  # nobody is of group 5, and -1 is any
    assert (found.face < 2).tolist() == [True, False, False, False]
    assert (nearest.find(points, turn=0.05, group=np.full(4, 7)).face >= 2).all()
    up = np.tile([0.0, 0, 1], (4, 1))
    assert (nearest.find(points, -up, 0.2, np.full(4, 7)).face < 2).all()  # both face up: the group still decides


def test_slivers_and_points_on_the_surface_are_found():
    rng = np.random.default_rng(3)
    positions = rng.normal(size=(90, 3))
    positions[60:] = positions[30:60] + rng.normal(size=(30, 3)) * 10.0 ** rng.uniform(-12, -3, (30, 1))
    mesh = Mesh(positions, np.arange(90).reshape(3, 30).T)
    points = np.concatenate([rng.normal(size=(40, 3)), mesh.positions[mesh.faces].mean(axis=1)])
    expected = [nearest_by_hand(mesh, point) for point in points]
    np.testing.assert_allclose(NearestPoints(mesh).find(points).distance, expected, rtol=1e-6, atol=1e-7)


def test_the_answer_does_not_depend_on_threads_and_a_mesh_without_faces_has_none():
    ball = Mesh(*sphere(6))
    points = np.random.default_rng(1).normal(size=(2 * BLOCK + 5, 3))
    nearest = NearestPoints(ball)
    for one, two in zip(nearest.find(points), nearest.find(points, threads=2), strict=True):
        assert np.array_equal(one, two)
    with pytest.raises(ValueError, match="without faces"):
        NearestPoints(Mesh(ball.positions, np.zeros((0, 3), np.int64)))
