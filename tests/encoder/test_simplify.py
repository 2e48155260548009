"""Simplification by edge collapses: prefixes, topology, lines, turned faces, bad input, and the oracle's sequence."""

import numpy as np
import pytest
from rough_meshes import grid, rough, torus
from shapes import sphere, square
from slow_collapses import collapses

from texfcodec.encoder.mesh.simplify import simplify
from texfcodec.encoder.mesh.topology import seam_edges, sharp_edges, undirected
from texfcodec.geometry.mesh import Mesh


def normals(mesh):
    p = mesh.positions[mesh.faces]
    return np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])


def all_prefixes(simplification):
    return [simplification.at(int(count)).mesh for count in simplification.remaining]


def euler(mesh):
    return len(np.unique(mesh.faces)) - len(undirected(mesh.faces)[0]) + len(mesh.faces)


def same(a, b):
    return np.array_equal(a.kept, b.kept) and np.array_equal(a.removed, b.removed) and np.array_equal(a.last, b.last)


@pytest.mark.parametrize("mesh, lines", [
    (rough(sphere(5)), []), (rough(torus(8, 6), seed=1), []), (rough(grid(5, 0.1), seed=2), []), (rough(grid(4), 0.001, 3), []),
    (rough(grid(6, 0.2), seed=4), [(21 + i, 22 + i) for i in range(6)]),
])
def test_collapses_are_those_of_the_oracle(mesh, lines):
    expected = collapses(*mesh, lines)
    got = simplify(mesh, np.array(lines, np.int64).reshape(-1, 2))
    assert [(a, b) for a, b, *_ in expected] == list(zip(got.kept.tolist(), got.removed.tolist(), strict=True))
    np.testing.assert_allclose(got.placed, [place for *_, place, _ in expected], atol=1e-6)
    np.testing.assert_allclose(got.error * Mesh(*mesh).frame()[1] ** 4, [error for *_, error in expected], rtol=1e-4, atol=1e-12)
    assert len(expected) > 10


def test_a_face_that_a_scan_turned_makes_no_line_and_goes():
    """A vertex in a face that has slipped over its side: one of the three faces around it looks down."""
    positions, faces = grid(8, 0.1)
    flat = Mesh(np.asarray(positions, float) * [1, 1, 0.02], np.asarray(faces))
    a, b, c = flat.faces[60]
    p = flat.positions
    slipped = 0.55 * (p[a] + p[b]) - 0.1 * p[c]
    around = [[a, b, len(p)], [b, c, len(p)], [c, a, len(p)]]
    mesh = Mesh(np.vstack([p, slipped]), np.vstack([np.delete(flat.faces, 60, 0), around]))
    up = np.sign(normals(flat)[0, 2])
    assert (normals(mesh)[:, 2] * up < 0).sum() == 1
    lines = sharp_edges(mesh, 60)
    assert not len(lines)
    least = all_prefixes(simplify(mesh, lines))[len(mesh.faces) // 4]
    assert (normals(least)[:, 2] * up > 0).all()


def test_any_face_count_is_a_prefix_of_one_sequence():
    mesh = rough(sphere(10))
    steps = simplify(mesh)
    positions, corners = mesh.positions.copy(), mesh.faces.copy()
    for i, count in enumerate(steps.remaining):
        corners[corners == steps.removed[i]] = steps.kept[i]
        positions[steps.kept[i]] = steps.placed[i]
        whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
        at = steps.at(int(count))
        assert whole.sum() == count == len(at.mesh.faces)
        np.testing.assert_array_equal(positions[corners[whole]], at.mesh.positions[at.mesh.faces])
        np.testing.assert_array_equal(np.flatnonzero(whole), at.face)
        np.testing.assert_array_equal(at.vertex, np.unique(corners[whole]))


def test_a_count_is_met_from_below_by_at_most_one_face_and_never_below_the_fewest():
    steps = simplify(rough(sphere(10)))
    for count in range(steps.fewest, len(steps.source.faces) + 1):
        assert 0 <= count - len(steps.at(count).mesh.faces) <= 1
    assert len(steps.at(0).mesh.faces) == steps.fewest == 4
    np.testing.assert_array_equal(steps.at(10**9).mesh.positions, steps.source.positions)


@pytest.mark.parametrize("mesh, characteristic", [(rough(sphere(12)), 2), (torus(), 0), (rough(grid(10, 0.1)), 1)])
def test_what_is_closed_stays_closed_and_the_euler_characteristic_stays(mesh, characteristic):
    closed = characteristic != 1
    for smaller in all_prefixes(simplify(mesh)):
        count = undirected(smaller.faces)[2]
        assert euler(smaller) == characteristic and count.max() <= 2 and (not closed or count.min() == 2)
        assert len(np.unique(np.sort(smaller.faces, axis=1), axis=0)) == len(smaller.faces)


def test_a_flat_square_becomes_two_faces_and_its_border_stays_where_it_is():
    steps = simplify(grid(10))
    for smaller in (steps.at(int(count)).mesh for count in steps.remaining if count > 1):
        ends, _, count = undirected(smaller.faces)
        border = smaller.positions[ends[count == 1]]
        on_side = (np.abs(border[:, :, None, :2] - [[0.0], [1.0]]) < 1e-4).all(axis=1).any(axis=(1, 2))
        assert on_side.all() and np.linalg.norm(np.diff(border, axis=1), axis=2).sum() == pytest.approx(4, abs=1e-3)
        assert normals(smaller)[:, 2].min() > 0 and normals(smaller)[:, 2].sum() == pytest.approx(2, abs=1e-3)
    assert len(steps.at(2).mesh.faces) == 2


def test_the_border_of_a_rough_surface_stays_within_a_hundredth_of_a_cell():
    smaller = simplify(grid(16, 0.02)).at(256)
    border = smaller.mesh.positions[smaller.lines]
    off = np.abs(border[..., :2, None] - [0.0, 1.0]).max(axis=1).min(axis=(1, 2))
    assert off.max() < 0.01 / 16 and len(smaller.lines) < 64


def test_a_seam_keeps_its_line_and_both_sides_their_area():
    mesh = grid(8, inner=0.0)
    group = (mesh.positions[mesh.faces][:, :, 0].mean(axis=1) > 0.5).astype(int)
    lines = seam_edges(mesh.faces, group)
    assert len(lines) == 8
    steps = simplify(mesh, lines)
    for count in (100, 50, 20, 4):
        smaller = steps.at(count)
        area = np.bincount(group[smaller.face], normals(smaller.mesh)[:, 2] / 2)
        np.testing.assert_allclose(area, 0.5, atol=1e-4)
        assert seam_edges(smaller.mesh.faces, group[smaller.face]).size > 0


def test_no_face_is_ever_turned():
    bumpy = grid(20, 0.05)
    for mesh in (*all_prefixes(simplify(bumpy))[::7], *all_prefixes(simplify(grid(20)))[::7]):
        assert normals(mesh)[:, 2].min() > 0
    ball = simplify(Mesh(*sphere(16)))
    for mesh in all_prefixes(ball)[:-20:5]:
        assert (normals(mesh) * mesh.positions[mesh.faces].mean(axis=1)).sum(axis=1).min() > 0


def test_fixed_vertices_stay_and_where_all_are_nothing_goes():
    mesh = rough(sphere(8))
    fixed = np.arange(len(mesh.positions)) % 5 == 0
    smallest = simplify(mesh, fixed=fixed).at(0)
    at = np.searchsorted(smallest.vertex, np.flatnonzero(fixed))
    np.testing.assert_array_equal(smallest.vertex[at], np.flatnonzero(fixed))
    np.testing.assert_array_equal(smallest.mesh.positions[at], mesh.positions[fixed])
    assert len(simplify(mesh, fixed=np.ones(len(fixed), bool)).kept) == 0
    assert len(simplify(mesh, undirected(mesh.faces)[0]).kept) == 0  # every edge a line


def test_where_the_mesh_is_no_manifold_its_vertices_stay():
    flat, n = grid(6), 49
    wall = Mesh(flat.positions[:, [0, 2, 1]] + [0, 0.5, 0], flat.faces + n)
    merge = np.arange(2 * n)
    bottom = np.flatnonzero(wall.positions[:, 2] == 0)
    for v in bottom:  # the wall stands on the middle line of the floor
        merge[n + v] = np.argmin(np.abs(flat.positions - [wall.positions[v, 0], 0.5, 0]).sum(axis=1))
    flat.positions[merge[n + bottom]] = wall.positions[bottom]
    mesh = Mesh(np.concatenate([flat.positions, wall.positions]), merge[np.concatenate([flat.faces, wall.faces])])
    triple = undirected(mesh.faces)[2] > 2
    assert triple.sum() == 6
    smallest = simplify(mesh).at(0)
    assert set(merge[n + bottom]) <= set(smallest.vertex) and (undirected(smallest.mesh.faces)[2] > 2).sum() == 6
    assert len(smallest.mesh.faces) < 60


def test_two_bodies_that_touch_in_a_vertex_still_do():
    ball = rough(sphere(6))
    top = len(ball.positions) - 2
    faces = ball.faces + len(ball.positions)
    faces[faces == top + len(ball.positions)] = top
    mesh = Mesh(np.concatenate([ball.positions, ball.positions * [1, 1, -1] + [0, 0, 2 * ball.positions[top, 2]]]),
                np.concatenate([ball.faces, faces[:, ::-1]]))
    for smaller in all_prefixes(simplify(mesh))[::3]:
        assert undirected(smaller.faces)[2].max() == 2 and euler(smaller) == 3
    assert top in simplify(mesh).at(0).vertex


@pytest.mark.parametrize("faces, left", [
    ([], 0), ([[0, 1, 2]], 1), ([[0, 1, 2], [0, 2, 3]], 1), ([[0, 0, 1]], 0), ([[0, 1, 2], [0, 1, 2]], 2),
    ([[0, 1, 2], [0, 2, 1]], 2), ([[0, 1, 2], [0, 1, 3], [0, 1, 2]], 3), ([[0, 1, 2], [3, 3, 3]], 1),
])
def test_few_double_and_degenerate_faces_are_taken_as_they_come(faces, left):
    steps = simplify(Mesh(square()[0], np.array(faces, np.int64).reshape(-1, 3)))
    assert steps.fewest == left == len(steps.at(0).mesh.faces)
    assert len(steps.at(100).mesh.faces) == sum(len(set(f)) == 3 for f in faces)


def test_faces_without_area_do_no_harm():
    mesh = grid(6)
    mesh.positions[:30] = mesh.positions[0]
    assert np.isfinite(simplify(mesh).placed).all()
    assert simplify(Mesh(np.zeros((49, 3)), mesh.faces)).fewest > 0


def test_random_soups_end_and_get_no_new_edges_of_many_faces():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        mesh = Mesh(rng.normal(size=(12, 3)), rng.integers(0, 12, (int(rng.integers(1, 30)), 3)))
        steps = simplify(mesh)
        many = [(undirected(m.faces)[2] > 2).sum() for m in (steps.at(10**6).mesh, steps.at(0).mesh)]
        assert many[1] <= many[0] and (np.diff(steps.remaining) < 0).all()


def test_scale_and_place_change_nothing_and_a_run_is_as_another():
    mesh = rough(sphere(10))
    steps = simplify(mesh)
    for scale in (1.0, 2.0**30, 2.0**-30, 1e9, 1e100):
        other = simplify(Mesh(mesh.positions * scale, mesh.faces))
        assert same(steps, other)
        np.testing.assert_allclose(other.placed / scale, steps.placed, atol=1e-9)
    np.testing.assert_array_equal(simplify(mesh).placed, steps.placed)


@pytest.mark.parametrize("position, faces", [(np.nan, [[0, 1, 2]]), (np.inf, [[0, 1, 2]]), (0, [[0, 1, 4]]), (0, [[-1, 1, 2]])])
def test_nan_and_foreign_indices_are_refused(position, faces):
    positions = square()[0]
    positions[0, 0] = position
    with pytest.raises(ValueError):
        simplify(Mesh(positions, np.array(faces)))
