"""Groups of corners and their coded normals against the naive decoder, on random and extreme surfaces."""

import numpy as np
import pytest

from conformance.reference import normals as naive
from texfcodec.codecs.coded_normals import dec_residuals, enc_residuals
from texfcodec.geometry.corner_groups import ONE, groups_of
from texfcodec.geometry.edges import reduced, shared_edges, weld


def crowd(seed, bits=20, count=120):
    """(lattice int64 [V, 3], faces int64 [F, 3]): faces of any shape, doubled, turned over, with two corners at one position, and
    with edges of three to nine faces."""
    rng = np.random.default_rng(seed)
    lattice = rng.integers(0, 1 << bits, (40, 3))
    lattice[30:] = lattice[:10]  # positions that are there twice
    faces = rng.integers(0, 40, (count, 3))
    fan = np.array([[0, 1, i] for i in range(2, 11)])
    return lattice, np.concatenate([faces, faces[:5], faces[5:9, ::-1], np.roll(faces[9:12], 1, axis=1), fan])


def both(lattice, faces, coded, share, seed=0):
    """(our CornerGroups, the naive ones), edges being sharp by chance."""
    edges = shared_edges(weld(lattice)[faces])
    sharp = np.random.default_rng(seed).random(len(edges)) < share
    number = {tuple(place[::-1]): n for n, place in zip(weld(lattice).tolist(), lattice.tolist(), strict=True)}
    places = {n: place for place, n in number.items()}
    triangles = [[tuple(lattice[v].tolist()) for v in face] for face in faces]
    marked = {(places[a], places[b]) for a, b in edges.ends[sharp].tolist()}
    slow = naive.groups_of(triangles, coded.tolist(), marked)
    return groups_of(lattice, faces, coded, edges, sharp), slow, triangles


@pytest.mark.parametrize("bits, share", [(20, 0.3), (20, 0.0), (2, 0.5), (1, 0.2), (12, 1.1)])
def test_groups_and_their_frames_are_the_naive_ones(bits, share):
    for seed in range(3):
        lattice, faces = crowd(seed, bits)
        coded = np.random.default_rng(seed).random(len(faces)) < 0.7
        ours, slow, triangles = both(lattice, faces, coded, share)
        groups = np.split(ours.corner_of, ours.first[1:-1])
        assert [{(corner // 3, corner % 3) for corner in group.tolist()} for group in groups] == slow
        assert ours.frame.tolist() == [[list(axis) for axis in naive.frame(triangles, group)] for group in slow]


def test_groups_are_in_an_order_that_faces_and_corners_do_not_change():
    """Whatever the order of faces and the corner that each begins with, twins that lie on each other among them."""
    lattice, faces = crowd(4, 3)
    rng = np.random.default_rng(1)
    order = rng.permutation(len(faces))
    turned = np.stack([np.roll(face, rng.integers(3)) for face in faces[order]])
    ours, others = (groups_of(lattice, f, np.ones(len(f), bool), edges, np.zeros(len(edges), bool))
                    for f, edges in ((f, shared_edges(weld(lattice)[f])) for f in (faces, turned)))
    assert np.array_equal(ours.frame, others.frame) and len(ours) > 20


@pytest.mark.parametrize("scale", [0, 1, 40, 8205])
@pytest.mark.parametrize("step", [1, 180, 4096])
def test_residuals_come_back_and_make_the_naive_normals(scale, step):
    lattice, faces = crowd(7)
    ours, slow, triangles = both(lattice, faces, np.ones(len(faces), bool), 0.4)
    rng = np.random.default_rng(scale)
    residuals = rng.integers(-scale, scale + 1, (len(ours), 2))
    if scale:
        residuals[: 2] = scale, -scale
    data = enc_residuals(residuals, ours)
    assert np.array_equal(dec_residuals(data, ours), residuals)
    assert naive.decode_residuals(data, slow) == [tuple(pair) for pair in residuals.tolist()]
    normals = ours.normals(residuals, step)
    assert normals.tolist() == [naive.bent(naive.frame(triangles, group), i, j, step)
                                for group, (i, j) in zip(slow, residuals.tolist(), strict=True)]
    assert np.abs(np.linalg.norm(normals.astype(float), axis=1) - (1 << ONE)).max() < 4


def test_any_bytes_are_some_residuals():
    lattice, faces = crowd(3)
    ours, slow, _ = both(lattice, faces, np.ones(len(faces), bool), 0.4)
    for data in (b"", bytes(2000), b"\xff" * 2000, np.random.default_rng(0).bytes(2000)):
        residuals = dec_residuals(data, ours)
        assert residuals.shape == (len(ours), 2) and np.abs(residuals).max() < 1 << ONE
        assert naive.decode_residuals(data, slow) == [tuple(pair) for pair in residuals.tolist()]


@pytest.mark.parametrize("step", [1, 180, 4096])
def test_the_nearest_residual_is_within_half_a_step_in_each_direction(step):
    """Along the projection; a normal opposite to its base within what the syntax has room for."""
    lattice, faces = crowd(5)
    ours, _, _ = both(lattice, faces, np.ones(len(faces), bool), 0.2)
    wanted = np.random.default_rng(2).normal(size=(len(ours), 3))
    wanted[::7] = -ours.frame[::7, 2]
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    got = ours.normals(ours.residuals(wanted, step), step).astype(float)
    got /= np.linalg.norm(got, axis=1, keepdims=True)
    apart = np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(got - wanted, axis=1) / 2, 1)))
    near = (wanted * ours.frame[:, 2]).sum(axis=1) > 0  # in front of the base, where a step is at most its angle
    if step > 4:  # the residuals are below 8001: of one unit each they do not reach so far
        assert apart[near].max() < np.degrees(step * 2.0**-14 * np.sqrt(2)) + 0.02
    assert step != 4096 or apart.max() < 60


def test_reduced_vectors_have_fourteen_bits():
    vectors = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [1 << 55, -5, 3], [(1 << 14) - 1, 0, -(1 << 14)], [3, -3, 1 << 13]])
    out = reduced(vectors)
    assert out[0].tolist() == [0, 0, 0] and out[1].tolist() == [1 << 13, 0, 0] and out[3].tolist() == [1 << 13, -1, 0]
    assert all(int(max(map(abs, row))).bit_length() in (13, 14) or not any(row) for row in out.tolist())
