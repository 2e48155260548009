"""Seams and sharp edges of small meshes, worked by hand."""

import numpy as np
import pytest

from texfcodec.encoder.mesh.topology import seam_edges, sharp_edges
from texfcodec.geometry.mesh import Mesh

FACES = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4]])


def listed(edges):
    return sorted(map(tuple, edges.tolist()))


def test_seams_are_where_groups_or_uvs_differ():
    uv = np.random.default_rng(0).normal(size=(5, 2))[FACES]
    assert listed(seam_edges(FACES)) == listed(seam_edges(FACES, np.zeros(3), uv)) == []
    assert listed(seam_edges(FACES, np.array([0, 1, 1]))) == [(0, 2)]
    for corner, edges in (((2, 0), [(2, 3)]), ((2, 1), [(2, 3)]), ((2, 2), []), ((1, 1), [(0, 2), (2, 3)]), ((0, 1), [])):
        other = uv.copy()
        other[corner] += 1
        assert listed(seam_edges(FACES, corner=other)) == edges
        turned = FACES.copy()
        turned[1] = turned[1, ::-1]  # a face that runs the other way round shares its edges as well
        other[1] = other[1, ::-1].copy()
        assert listed(seam_edges(turned, corner=other)) == edges


@pytest.mark.parametrize("degrees", [10, 45, 89, 91, 130, 179])
def test_sharp_edges_are_those_above_the_angle(degrees):
    for angle, scale in ((30, 1.0), (90, 1e9), (150, 1e-9)):
        up = np.radians(angle)
        mesh = Mesh(scale * np.array([[0, 0, 0], [1, 0, 0], [0.5, -1, 0], [0.5, np.cos(up), np.sin(up)]]),
                    np.array([[1, 0, 2], [0, 1, 3]]))
        assert listed(sharp_edges(mesh, degrees)) == ([(0, 1)] if angle > degrees else [])


def test_a_face_without_area_has_no_sharp_edge():
    assert not len(sharp_edges(Mesh(np.zeros((5, 3)), FACES), 10))
    assert not len(seam_edges(np.zeros((0, 3), np.int64), np.zeros(0)))
