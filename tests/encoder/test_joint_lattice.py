"""The joint lattice: never worse than rounding, what slow descent finds, no turned faces, within the cube."""

import numpy as np
import pytest
from dense_matrix import dense
from rough_meshes import grid, rough
from shapes import sphere, square

from texfcodec.encoder.mesh.joint_lattice import REACH, joint_lattice
from texfcodec.encoder.mesh.vertex_fit import own_fit
from texfcodec.geometry.canonical import fit_cube
from texfcodec.geometry.mesh import Mesh
from texfcodec.metrics.surface_distance import surface_distance


def turned(mesh, lattice):
    """Faces that look against their normals in the mesh or have no area."""
    now, then = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (lattice[mesh.faces], mesh.positions[mesh.faces]))
    return (now * then).sum(axis=1) <= 0


def descent(fit, cube):
    """The same descent with a dense matrix, one coordinate after the other, by the form itself."""
    matrix, step = dense(fit.matrix), cube.side / cube.last
    out = start = cube.to_lattice(fit.mesh.positions)
    form = lambda k: (e := (k - (fit.mesh.positions - cube.origin) / step).ravel()) @ matrix @ e
    moving = True
    while moving:
        moving = False
        for v, k in np.ndindex(*out.shape):
            tries = []
            for to in range(max(start[v, k] - REACH, 0), min(start[v, k] + REACH, cube.last) + 1):
                other = out.copy()
                other[v, k] = to
                tries.append((form(other), other))
            best = min(tries, key=lambda pair: pair[0])
            is_better = best[0] < form(out) - 1e-9 * matrix[3 * v + k, 3 * v + k]
            if is_better and not (turned(fit.mesh, best[1]) & ~turned(fit.mesh, out)).any():
                out, moving = best[1], True
    return out


@pytest.mark.parametrize("mesh", [rough(sphere(4), 0.1), grid(4, 0.2), Mesh(*square())])
@pytest.mark.parametrize("bits", [8, 10])
def test_descent_is_that_of_dense_algebra(mesh, bits):
    fit, cube = own_fit(mesh), fit_cube(mesh.positions, bits)
    np.testing.assert_array_equal(joint_lattice(fit, cube), descent(fit, cube))


@pytest.mark.parametrize("bits", [8, 9, 10, 12, 14])
def test_the_form_is_never_worse_than_rounding_and_d1_is_better_by_a_position_bit_or_nearly(bits):
    mesh = rough(sphere(24), 0.01)
    fit, cube = own_fit(mesh), fit_cube(mesh.positions, bits)
    rounded, joint = cube.to_lattice(mesh.positions), joint_lattice(fit, cube)
    before, after = (fit.matrix.form(cube.to_world(lattice) - mesh.positions) for lattice in (rounded, joint))
    assert after < 0.6 * before
    d1 = [surface_distance(mesh, Mesh(cube.to_world(lattice), mesh.faces), 20_000).d1_side for lattice in (rounded, joint)]
    assert d1[1] > d1[0] + 3.5


def test_a_descent_from_a_better_start_ends_no_worse():
    mesh = rough(sphere(12), 0.02)
    fit, cube = own_fit(mesh), fit_cube(mesh.positions, 8)
    first = joint_lattice(fit, cube)
    second = joint_lattice(fit, cube, first)
    forms = [fit.matrix.form(cube.to_world(lattice) - mesh.positions) for lattice in (first, second)]
    assert forms[1] <= forms[0] * (1 + 1e-12)
    np.testing.assert_array_equal(joint_lattice(fit, cube), first)


@pytest.mark.parametrize("seed", range(4))
def test_no_face_is_turned_that_rounding_does_not_turn(seed):
    mesh = rough(sphere(40), 0.005, seed)
    cube = fit_cube(mesh.positions, 8)
    rounded, joint = turned(mesh, cube.to_lattice(mesh.positions)), turned(mesh, joint_lattice(own_fit(mesh), cube))
    assert rounded.any() and not (joint & ~rounded).any()


def test_positions_stay_in_the_cube_and_near_where_they_were():
    mesh = rough(sphere(10), 0.1)
    for bits in (8, 20):
        cube = fit_cube(mesh.positions, bits)
        joint = joint_lattice(own_fit(mesh), cube)
        assert joint.min() >= 0 and joint.max() <= cube.last and joint.dtype == np.int64
        assert np.abs(joint - cube.to_lattice(mesh.positions)).max() <= REACH


def test_points_and_nothing_at_all_are_taken():
    for positions, faces in ((np.zeros((3, 3)), [[0, 1, 2]]), (np.zeros((0, 3)), []), (square()[0], [])):
        mesh = Mesh(positions, np.array(faces, np.int64).reshape(-1, 3))
        cube = fit_cube(positions, 10)
        np.testing.assert_array_equal(joint_lattice(own_fit(mesh), cube), cube.to_lattice(positions))
