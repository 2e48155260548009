"""Shading normals made from the decoded geometry."""

import numpy as np
import trimesh

from texfcodec.geometry.shading_normals import corner_normals


def lattice_of(mesh, scale):
    return np.rint(mesh.vertices * scale).astype(np.int64) + 2 * scale, np.asarray(mesh.faces, np.int64)


def test_a_cube_keeps_its_edges():
    box = trimesh.creation.box()
    lattice, faces = lattice_of(box, 1000)
    expected = np.repeat(np.asarray(box.face_normals, np.float32)[:, None], 3, axis=1)
    assert np.abs(corner_normals(lattice, faces) - expected).max() < 1e-6


def test_a_ball_is_smooth_to_two_degrees_also_across_duplicated_vertices():
    ball = trimesh.creation.icosphere(subdivisions=4)
    lattice, faces = lattice_of(ball, 100_000)
    soup = np.arange(3 * len(faces)).reshape(-1, 3)
    got = corner_normals(lattice[faces].reshape(-1, 3), soup)
    cosine = np.einsum("fcd,fcd->fc", got, ball.vertices[ball.faces])
    assert cosine.min() > np.cos(np.radians(2))
    assert len(np.unique(got.reshape(-1, 3), axis=0)) <= 1.05 * len(ball.vertices)


def test_normals_have_length_one_whatever_the_faces():
    lattice = np.array([[0, 0, 0], [5, 0, 0], [10, 0, 0], [0, 7, 3]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [3, 1, 0]])
    assert np.abs(np.linalg.norm(corner_normals(lattice, faces), axis=2) - 1).max() < 1e-6
    assert corner_normals(lattice, np.zeros((0, 3), np.int64)).shape == (0, 3, 3)
