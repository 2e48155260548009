"""Fit of vertices to a surface: it comes closer, agrees with dense algebra, and does no harm where there is nothing to gain."""

import numpy as np
import pytest
from dense_matrix import dense
from rough_meshes import grid, rough
from shapes import sphere, square

from texfcodec.encoder.mesh.normal_matrix import NormalEquations, PointResiduals
from texfcodec.encoder.mesh.simplify import simplify
from texfcodec.encoder.mesh.vertex_fit import DAMPING, STIFFNESS, TANGENTIAL, MatchedLines, fit_vertices, own_fit
from texfcodec.geometry.mesh import Mesh
from texfcodec.metrics.surface_distance import surface_distance


def test_a_coarse_mesh_comes_closer_to_the_source_by_more_than_a_decibel():
    source = rough(sphere(40), 0.002)
    coarse = simplify(source).at(600).mesh
    fit = fit_vertices(source, coarse, samples=20_000)
    before, after = surface_distance(source, coarse, 20_000, 9), surface_distance(source, fit.mesh, 20_000, 9)
    assert after.d1_side > before.d1_side + 1
    np.testing.assert_array_equal(fit.mesh.faces, coarse.faces)


def test_what_lies_on_the_source_stays_there():
    ball = rough(sphere(10), 0.03)
    assert np.abs(fit_vertices(ball, ball, samples=5000).mesh.positions - ball.positions).max() < 1e-9


@pytest.mark.parametrize("scale", [2.0**30, 2.0**-30, 2.0**300])
def test_scale_changes_nothing(scale):
    source = rough(sphere(12), 0.01)
    coarse = simplify(source).at(100).mesh
    fit = fit_vertices(source, coarse, samples=2000)
    other = fit_vertices(Mesh(source.positions * scale, source.faces), Mesh(coarse.positions * scale, coarse.faces), samples=2000)
    np.testing.assert_array_equal(other.mesh.positions / scale, fit.mesh.positions)
    again = fit_vertices(source, coarse, samples=2000)
    np.testing.assert_array_equal(again.mesh.positions, fit.mesh.positions)
    np.testing.assert_array_equal(again.matrix.block, fit.matrix.block)


def test_the_equations_are_those_of_dense_least_squares():
    rng = np.random.default_rng(1)
    faces, count = grid(3).faces, 200
    face, bary = rng.integers(0, len(faces), count), rng.dirichlet(np.ones(3), count)
    residual, direction, weight = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), rng.random(count)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    equations = NormalEquations(faces, 17)  # one vertex that no face has
    equations.add(PointResiduals(face, bary, residual, direction, weight), 0.7, 0.3)
    rows = np.zeros((count, 3, 17, 3))
    for s in range(count):
        root = np.sqrt(weight[s] * 0.7) * np.outer(direction[s], direction[s])  # for a unit vector its own square
        both = np.linalg.cholesky(weight[s] * 0.3 * np.eye(3) + root @ root).T
        for i in range(3):
            rows[s, :, faces[face[s], i]] += bary[s, i] * both
        residual[s] = both @ residual[s]
    a, b = rows.reshape(3 * count, 51), residual.ravel()
    expected = a.T @ a
    scale = np.trace(expected) / 51
    for v in range(17):
        near = set(faces[(faces == v).any(axis=1)].ravel()) - {v}
        for k in range(3):
            expected[3 * v + k, 3 * v + k] += scale * (0.01 * len(near) + 0.001)
            expected[3 * v + k, [3 * w + k for w in near]] -= scale * 0.01
    moved, matrix = equations.solve(0.01, 0.001)
    np.testing.assert_allclose(dense(matrix), expected, atol=1e-9)
    np.testing.assert_allclose(moved.ravel(), np.linalg.solve(expected, a.T @ b), atol=1e-3)
    step = rng.normal(size=(17, 3))
    np.testing.assert_allclose((matrix @ step).ravel(), expected @ step.ravel(), atol=1e-9)
    assert matrix.form(step) == pytest.approx(step.ravel() @ expected @ step.ravel())


def test_the_own_matrix_is_the_integral_over_the_surface():
    mesh = Mesh(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    got = dense(own_fit(mesh).matrix).reshape(3, 3, 3, 3)
    area, mean = 2.0, 2.0 * (1 + 2 * TANGENTIAL) / 18  # of the diagonal: a sixth of the area, in full along the normal
    for k, part in enumerate((TANGENTIAL, TANGENTIAL, 1.0)):
        expected = area / 12 * part * (1 + np.eye(3)) + mean * (STIFFNESS * (3 * np.eye(3) - 1) + DAMPING * np.eye(3))
        np.testing.assert_allclose(got[:, k, :, k], expected, rtol=1e-9)


def test_the_matrix_is_definite_on_flat_sheets_and_idle_vertices():
    flat = grid(4)
    mesh = Mesh(np.concatenate([flat.positions, [[0.5, 0.5, 3.0]]]), np.concatenate([flat.faces, [[0, 1, 1], [2, 2, 2]]]))
    for fit in (own_fit(mesh), fit_vertices(flat, mesh, samples=500)):
        assert np.linalg.eigvalsh(dense(fit.matrix)).min() > 0 and np.isfinite(fit.mesh.positions).all()


def test_sheets_that_lie_close_do_not_draw_each_other():
    top, bottom = grid(12, 0.003, seed=1), grid(12, 0.003, seed=2)
    source = Mesh(np.concatenate([top.positions + [0, 0, 0.02], bottom.positions]),
                  np.concatenate([top.faces, bottom.faces[:, ::-1] + len(top.positions)]))
    coarse = simplify(source).at(200).mesh
    fit = fit_vertices(source, coarse, samples=20_000)
    upper = coarse.positions[:, 2] > 0.01
    assert fit.mesh.positions[upper, 2].min() > 0.01 > fit.mesh.positions[~upper, 2].max()


def test_the_fit_turns_no_face_even_on_a_mesh_of_slivers():
    source = rough(sphere(16), 0.01)
    for seed in range(3):
        mesh = rough(sphere(10), 0.12, seed)
        fit = fit_vertices(source, mesh, samples=2000).mesh
        before, after = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (m.positions[m.faces] for m in (mesh, fit)))
        assert ((before * after).sum(axis=1) > 0).all()
        assert surface_distance(source, fit, 5000).d1_side > surface_distance(source, mesh, 5000).d1_side


def test_lines_bring_a_border_back_to_where_it_was():
    source = grid(24, 0.004)
    steps = simplify(source)
    coarse = steps.at(400)
    border = np.unique(coarse.lines)

    def off(mesh):
        return np.abs(mesh.positions[border, :2, None] - [0.0, 1.0]).min(axis=(1, 2)).max()

    pulled = Mesh(0.5 + (coarse.mesh.positions - 0.5) * [0.97, 0.97, 1], coarse.mesh.faces)
    free, held = (fit_vertices(source, pulled, lines, 20_000) for lines in (None, MatchedLines(steps.lines, coarse.lines)))
    assert off(held.mesh) < 0.002 < 0.005 < off(free.mesh)
    nothing = MatchedLines(steps.lines, np.zeros((0, 2), np.int64))
    np.testing.assert_array_equal(fit_vertices(source, pulled, nothing, 20_000).mesh.positions, free.mesh.positions)


def test_a_mesh_without_area_is_refused():
    ball = Mesh(*sphere(6))
    for source, mesh in ((ball, Mesh(ball.positions * 0, ball.faces)), (Mesh(ball.positions * 0, ball.faces), ball),
                         (ball, Mesh(square()[0], np.zeros((0, 3), np.int64)))):
        with pytest.raises(ValueError, match="area|faces"):
            fit_vertices(source, mesh, samples=100)
