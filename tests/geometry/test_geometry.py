"""The geometry room: the canonical cube and the Draco unit."""

import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import sphere

from texfcodec.core.syntax_walk import write_v
from texfcodec.errors import InputError, StreamError
from texfcodec.geometry.areas import face_areas, relative_areas, used_vertices
from texfcodec.geometry.canonical import MAX_COORDINATE, CanonicalCube, fit_cube
from texfcodec.geometry.checksum import geometry_crc
from texfcodec.geometry.draco import _HEADER, dec_geometry, enc_geometry
from texfcodec.geometry.mesh import Mesh

SCALE = st.sampled_from([1e-30, 1e-6, 1.0, 1e7, 1e30, 1e140])


@pytest.mark.parametrize("count, faces", [(30, 40), (1000, 3), (5, 1)])
def test_used_vertices_are_numbered_as_sorting_them_would(count, faces):
    """Few faces of many vertices are sorted, others counted."""
    rng = np.random.default_rng(count)
    rows = rng.integers(0, count, (faces, 3))
    used, local = used_vertices(rows, count)
    np.testing.assert_array_equal(used, np.unique(rows))
    np.testing.assert_array_equal(used[local], rows)


@pytest.mark.parametrize("scale", [1e-70, 1.0, 1e70])
def test_areas_along_columns_are_those_of_cross_products_to_the_bit(scale):
    rng = np.random.default_rng(0)
    points, faces = rng.normal(size=(50, 3)) * scale, rng.integers(0, 40, (300, 3))
    a, b, c = (points[faces[:, i]] for i in range(3))
    np.testing.assert_array_equal(face_areas(points, faces), np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    near = points[:40] / np.abs(points[:40]).max()
    near -= near.min(axis=0)
    a, b, c = (near[faces[:, i]] / near.max() for i in range(3))
    np.testing.assert_array_equal(relative_areas(points, faces), np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


@pytest.mark.parametrize("corner, face, says", [
    ([0, 0, np.nan], [0, 1, 2], "positions must be finite"), ([0, -np.inf, 0], [0, 1, 2], "positions must be finite"),
    ([0, 0, 1], [0, 1, 3], "integers from 0 to 2"), ([0, 0, 1], [-1, 1, 2], "integers from 0 to 2"),
])
def test_a_mesh_of_no_numbers_or_of_corners_that_are_not_there_is_refused(corner, face, says):
    with pytest.raises(ValueError, match=says):
        Mesh([[0, 0, 0], [1, 0, 0], corner], [face]).checked()


# The canonical cube


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32), SCALE, st.sampled_from([0.0, 1.0, 1e3, 1e7]), st.integers(8, 20))
def test_every_position_comes_back_within_half_a_lattice_step_and_two_roundings(seed, scale, offset, bits):
    rng = np.random.default_rng(seed)
    points = (rng.uniform(-1, 1, (20, 3)) + offset * rng.uniform(-1, 1, 3)) * scale
    cube = fit_cube(points, bits)
    lattice = cube.to_lattice(points)
    assert lattice.min() >= 0 and lattice.max() == cube.last
    rounding = 4 * np.spacing(np.abs(points).max())
    assert np.abs(cube.to_world(lattice) - points).max() <= cube.side / cube.last * (0.5 + 1e-9) + rounding


@pytest.mark.parametrize("bits", [8, 14, 20])
def test_lattice_positions_come_back_from_the_world_exactly(bits):
    cube = CanonicalCube((-3.0, 7.0, 1e5), 12.5, bits)
    lattice = np.random.default_rng(bits).integers(0, cube.last + 1, (1000, 3))
    np.testing.assert_array_equal(cube.to_lattice(cube.to_world(lattice)), lattice)
    assert cube.last == 2**bits - 1


def test_the_cube_is_the_box_minimum_and_its_longest_side():
    cube = fit_cube(np.array([[1.0, -2, 3], [2, 8, 4]]), 10)
    assert (cube.origin, cube.side, cube.position_bits) == ((1.0, -2.0, 3.0), 10.0, 10)
    assert cube.to_lattice(np.array([[1.0, 8, 3], [-9, 99, 3]])).tolist() == [[0, 1023, 0], [0, 1023, 0]]


def test_a_single_point_has_side_zero_and_stays_where_it_is():
    cube = fit_cube(np.array([[5.0, 6, 7]] * 3), 14)
    assert cube.side == 0 and cube.to_lattice(np.array([[5.0, 6, 7]])).tolist() == [[0, 0, 0]]
    assert cube.to_world(np.array([[0, 0, 0]])).tolist() == [[5, 6, 7]]
    assert cube.to_grid(np.array([[5.0, 6, 7]]), 64).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("resolution,bits", [(1, 8), (1000, 14), (8192, 20)])
def test_grid_coordinates_of_a_vertex_are_those_of_its_voxel(resolution, bits):
    cube = CanonicalCube((10.0, 20.0, 30.0), 3.0, bits)
    lattice = np.random.default_rng(bits).integers(0, cube.last + 1, (500, 3))
    got = cube.to_grid(cube.to_world(lattice), resolution)
    np.testing.assert_allclose(got, lattice * resolution / 2**bits, atol=1e-7 * resolution / 1000 + 1e-9)


@pytest.mark.parametrize("points,code", [([[0, 0, 2 * MAX_COORDINATE]], "TXF-I60"), ([[-2 * MAX_COORDINATE, 0, 0]], "TXF-I60"),
                                         ([[0, 0, 0], [1e-300, 0, 0]], "TXF-I61")])
def test_boxes_out_of_range_are_refused(points, code):
    with pytest.raises(InputError) as caught:
        fit_cube(np.array(points, np.float64), 14)
    assert caught.value.code == code


# The Draco unit


def unit(rows=8, bits=10):
    """(lattice, faces, Draco bytes, decoded vertex count) of a sphere."""
    positions, faces = sphere(rows)
    lattice = np.rint((positions + 1) / 2 * ((1 << bits) - 1)).astype(np.int64)
    return lattice, faces, enc_geometry(lattice, faces, bits)


def triangles(lattice, faces):
    """Triangles as a sorted list of corner triples, the least corner first, orientation kept."""
    rows = []
    for face in faces:
        corners = [tuple(lattice[v]) for v in face]
        first = corners.index(min(corners))
        rows.append(tuple(corners[first:] + corners[:first]))
    return sorted(rows)


@pytest.mark.parametrize("rows,bits", [(3, 8), (8, 14), (24, 20)])
def test_triangles_come_back_with_their_orientation(rows, bits):
    lattice, faces, data = unit(rows, bits)
    got, got_faces = dec_geometry(data, len(lattice), len(faces), bits)
    assert got.dtype == got_faces.dtype == np.int64
    assert triangles(got.tolist(), got_faces.tolist()) == triangles(lattice.tolist(), faces.tolist())


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.integers(1, 30))
def test_any_soup_of_faces_with_three_different_corners_comes_back(seed, count):
    """Non-manifold edges, duplicates and opposite pairs included."""
    import DracoPy

    rng = np.random.default_rng(seed)
    lattice = np.unique(rng.integers(0, 256, (max(4, count // 2), 3)), axis=0)
    faces = np.array([rng.choice(len(lattice), 3, replace=False) for _ in range(count)])
    data = enc_geometry(lattice, faces, 8)
    got, got_faces = dec_geometry(data, len(DracoPy.decode(data).points), count, 8)
    assert triangles(got.tolist(), got_faces.tolist()) == triangles(lattice.tolist(), faces.tolist())


def test_positions_outside_the_lattice_are_not_coded():
    for bad in (-1, 256):
        with pytest.raises(ValueError, match="out of range"):
            enc_geometry(np.array([[0, 0, 0], [1, 1, 1], [bad, 0, 0]]), np.array([[0, 1, 2]]), 8)


def refused(data, vertices, faces, bits=10):
    with pytest.raises(StreamError) as caught:
        dec_geometry(data, vertices, faces, bits, offset=77)
    return caught.value.code


def test_a_draco_header_of_another_form_is_refused():
    lattice, faces, data = unit()
    for i in range(len(_HEADER)):
        assert refused(data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :], len(lattice), len(faces)) == "TXF-S20"
    assert refused(data[:11] + b"\x01" + data[12:], len(lattice), len(faces)) == "TXF-S20"


@pytest.mark.parametrize("vertices,faces", [
    (1 << 40, 1 << 40), ((1 << 32) - 1, (1 << 31) - 1), (1 << 24, 1 << 24), (3, (1 << 31) // 3), (3, (1 << 24) - 1)])
def test_draco_counts_that_lie_along_with_the_unit_are_refused(vertices, faces):
    _, _, data = unit()
    body = data[15:]  # behind the traversal type and counts of one and two bytes
    assert refused(_HEADER + b"\x00" + write_v(vertices) + write_v(faces) + body, vertices, faces) in ("TXF-S21", "TXF-S22")


def test_every_prefix_of_the_draco_data_is_refused():
    lattice, faces, data = unit(4)
    for end in range(len(data)):
        assert refused(data[:end], len(lattice), len(faces)).startswith("TXF-S")


def test_an_answer_of_another_shape_than_asked_is_refused(monkeypatch):
    """Draco's library is not ours: what it says is looked at before it is used."""
    import DracoPy

    lattice, faces, data = unit()
    mesh = DracoPy.decode(data)
    for points, triangles in ((mesh.points[:, :2], mesh.faces), (mesh.points.astype(np.int64), mesh.faces),
                              (mesh.points, mesh.faces[1:]), (mesh.points, None)):
        answer = SimpleNamespace(points=points, faces=triangles, attributes=mesh.attributes)
        monkeypatch.setattr(DracoPy, "decode", lambda data, answer=answer: answer)
        assert refused(data, len(lattice), len(faces)) == "TXF-S21"


# The checksum of what was decoded


@pytest.mark.parametrize("textured", [False, True])
@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_the_checksum_is_of_the_faces_and_not_of_their_order(textured, seed):
    rng = np.random.default_rng(seed)
    lattice, faces = rng.integers(0, 4, (9, 3)) * [1, 300, 349525], rng.integers(0, 9, (7, 3))
    uv = rng.integers(-(1 << 26), 1 << 26, (9, 2)) if textured else None
    corners = lattice if uv is None else np.hstack([lattice, uv])
    rows = [min(corners[np.roll(face, turn)].ravel().tolist() for turn in range(3)) for face in faces]
    crc = geometry_crc(lattice, faces, uv)
    assert crc == sum(zlib.crc32(np.array(row, "<i4").tobytes()) for row in rows) % 2**32
    place, turned = rng.permutation(9), np.stack([np.roll(face, rng.integers(3)) for face in faces])[rng.permutation(7)]
    assert geometry_crc(lattice[place], np.argsort(place)[turned], None if uv is None else uv[place]) == crc
    moved = corners.copy()
    moved[faces[0, 0], 0] += 1
    assert geometry_crc(moved[:, :3], faces, moved[:, 3:] if textured else None) != crc


def test_the_checksum_refuses_a_corner_that_is_not_there():
    for corner in (3, -1):
        with pytest.raises(IndexError):
            geometry_crc(np.zeros((3, 3), np.int64), np.array([[0, 1, corner]]))
