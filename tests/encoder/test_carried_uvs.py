"""UVs of simplified meshes: the texture stays where it was, on both sides of every seam."""

import numpy as np
import pytest

from texfcodec.encoder.mesh.carried_uvs import SeamedMesh, carried_uvs
from texfcodec.encoder.mesh.simplify import simplify
from texfcodec.encoder.mesh.topology import seam_edges
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.mesh import Mesh, points_at


def grid(columns, rows):
    """Corners of the squares of a grid, int64 [2 (columns - 1) (rows - 1), 3], by column * rows + row."""
    place = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = place[:-1, :-1].ravel(), place[1:, :-1].ravel(), place[1:, 1:].ravel(), place[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def sheet():
    """A dome, and UVs that are linear in x and y."""
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60), indexing="ij"))
    mesh = Mesh(np.stack([x, y, 0.4 * np.cos(2 * x) * np.cos(y)], axis=1), grid(60, 60))
    return mesh, np.stack([0.4 * x + 0.1 * y + 0.5, 0.3 * y + 0.5], axis=1)[mesh.faces]


def tube(turns=80, rows=60):
    """A closed tube whose one chart has its seam within, which winds: u goes once around."""
    i, j = (side.ravel() for side in np.meshgrid(np.arange(turns + 1), np.arange(rows), indexing="ij"))
    angle = 2 * np.pi * i / turns + 0.4 * np.sin(12 * j / rows)
    positions = np.stack([np.cos(angle), np.sin(angle), 4 * j / rows + 0.05 * np.cos(5 * angle)], axis=1)
    uv = np.stack([i / turns, j / rows], axis=1)
    faces = grid(turns + 1, rows)
    welded = np.where(i == turns, j, np.arange(len(i)))
    return Mesh(positions, welded[faces]), uv[faces]


@pytest.mark.parametrize("shape, seams", [(sheet, 0), (tube, 59)])
@pytest.mark.parametrize("share", [0.5, 0.1])
def test_the_texture_stays_where_it_was(shape, seams, share):
    source, uv = shape()
    edges = seam_edges(source.faces, corner=uv, apart=1e-5)
    assert len(edges) == seams
    some = simplify(source, edges).at(round(share * len(source.faces)))
    assert len(some.mesh.faces) <= share * len(source.faces)
    carried = carried_uvs(SeamedMesh(source, edges), uv, SeamedMesh(some.mesh, some.edges(edges)), some.face)
    face, bary = sample_surface(some.mesh.positions, some.mesh.faces, 5000)
    points, there = points_at(some.mesh, face, bary), (carried[face] * bary[..., None]).sum(axis=1)
    if shape is sheet:
        wanted = np.stack([0.4 * points[:, 0] + 0.1 * points[:, 1] + 0.5, 0.3 * points[:, 1] + 0.5], axis=1)
    else:
        angle = np.arctan2(points[:, 1], points[:, 0])
        v = (points[:, 2] - 0.05 * np.cos(5 * angle)) / 4
        wanted = np.stack([(angle - 0.4 * np.sin(12 * v)) / (2 * np.pi) % 1.0, v], axis=1)
    apart = np.abs(there - wanted)
    apart[:, 0] = np.minimum(apart[:, 0], 1 - apart[:, 0])  # at u of 0 and 1, where the tube closes
    assert np.percentile(apart, 99) < (0.003 if share == 0.5 else 0.025) and apart.max() < 0.05


def test_a_chart_takes_nothing_from_the_one_beside_it():
    """Along a seam that winds, points of one chart come to lie on faces of the other."""
    source, uv = sheet()
    plain, middle = uv.copy(), source.positions[source.faces].mean(axis=1)
    right = middle[:, 0] > 0.2 * np.sin(9 * middle[:, 1])
    uv[right] = 0.9 - uv[right]
    edges = seam_edges(source.faces, corner=uv, apart=1e-5)
    some = simplify(source, edges).at(100)
    carried = carried_uvs(SeamedMesh(source, edges), uv, SeamedMesh(some.mesh, some.edges(edges)), some.face)
    mine = right[some.face]
    carried[mine] = 0.9 - carried[mine]
    wanted = carried_uvs(SeamedMesh(source, edges), plain, SeamedMesh(some.mesh, some.edges(edges)), some.face)
    assert len(some.edges(edges)) < len(edges)
    assert np.abs(carried - wanted).max() < 1e-3


def test_corners_between_which_no_seam_is_have_one_uv():
    source, uv = tube()
    edges = seam_edges(source.faces, corner=uv, apart=1e-5)
    some = simplify(source, edges).at(len(source.faces) // 4)
    carried = carried_uvs(SeamedMesh(source, edges), uv, SeamedMesh(some.mesh, some.edges(edges)), some.face)
    rest = seam_edges(some.mesh.faces, corner=carried, apart=1e-9)
    assert {tuple(edge) for edge in rest.tolist()} == {tuple(edge) for edge in some.edges(edges).tolist()}


def test_a_chart_of_no_size_keeps_its_uv():
    source, uv = sheet()
    uv[:] = 0.25
    some = simplify(source).at(500)
    none = np.zeros((0, 2), np.int64)
    carried = carried_uvs(SeamedMesh(source, none), uv, SeamedMesh(some.mesh, none), some.face)
    assert np.allclose(carried, 0.25, atol=1e-12)
