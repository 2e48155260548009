"""Tangents made from UVs: what files bring, mirrored charts, and input that gives no direction."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from shapes import sphere, square

from texfcodec.geometry import tangents
from texfcodec.geometry.tangents import corner_tangents, has_uv_area

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"
TYPES, SIZES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}, {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def accessors(path):
    """Function number of a GLB's accessor -> array, and the primitives of its meshes."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    tree, blob = json.loads(data[20 : 20 + length]), data[28 + length :]

    def read(number):
        accessor = tree["accessors"][number]
        view, width = tree["bufferViews"][accessor["bufferView"]], SIZES[accessor["type"]]
        kind = np.dtype(TYPES[accessor["componentType"]])
        step = view.get("byteStride", kind.itemsize * width)
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.ndarray((accessor["count"], width), kind, blob, start, (step, kind.itemsize))

    return read, [p for mesh in tree["meshes"] for p in mesh["primitives"]]


def deviation(path):
    """Of every corner of a file with tangents: degrees between the file's and ours, and whether the signs agree."""
    read, primitives = accessors(path)
    angles, same = [], []
    for primitive in primitives:
        names = ("POSITION", "NORMAL", "TEXCOORD_0", "TANGENT")
        p, n, uv, tangent = (read(primitive["attributes"][name]).astype(np.float64) for name in names)
        faces = read(primitive["indices"]).astype(np.int64).reshape(-1, 3)
        got, ref = corner_tangents(p, faces, uv[faces], n[faces]), tangent[faces]
        cosine = np.einsum("fck,fck->fc", ref[..., :3], got[..., :3]) / np.linalg.norm(ref[..., :3], axis=2)
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).ravel())
        same.append((ref[..., 3] == got[..., 3])[has_uv_area(uv[faces])].ravel())
    return np.concatenate(angles), np.concatenate(same)


@pytest.mark.parametrize("name, median, most, signs", [("avocado", 0.5, 2.5, 0.99), ("waterbottle_pbr", 0.1, 0.2, 0.99),
                                                       ("tiny_plane", 0.01, 0.01, None)])
def test_tangents_are_those_of_the_file(name, median, most, signs):
    """The plane's file counts v upwards, against glTF's rule, so its signs are left out."""
    path = ASSETS / f"{name}.glb"
    if not path.exists():
        pytest.skip("needs the assets of ../shared")
    angles, same = deviation(path)
    assert np.median(angles) < median and np.percentile(angles, 95) < most
    assert signs is None or same.mean() > signs


def flat_square(uv):
    positions, faces = square()
    normal = np.broadcast_to(np.array([0, 0, 1.0], np.float32), (2, 3, 3))
    return corner_tangents(positions, faces, np.asarray(uv, float)[faces], normal)


def test_bitangent_points_up_in_the_picture():
    """glTF's v falls from the top of the picture; green grows upwards."""
    upright = flat_square([[0, 1], [1, 1], [1, 0], [0, 0]])  # v = 1 - y
    assert_allclose(upright.reshape(-1, 4), np.tile([1, 0, 0, 1], (6, 1)), atol=1e-7)
    turned = flat_square([[1, 1], [1, 0], [0, 0], [0, 1]])  # u = 1 - y, v = 1 - x
    assert_allclose(turned.reshape(-1, 4), np.tile([0, -1, 0, 1], (6, 1)), atol=1e-7)


def test_mirrored_charts_keep_apart():
    mirrored = flat_square([[1, 1], [0, 1], [0, 0], [1, 0]])
    assert_allclose(mirrored.reshape(-1, 4), np.tile([-1, 0, 0, -1], (6, 1)), atol=1e-7)
    # two faces at an edge, one of them mirrored: same corner UVs there, and neither changes the other
    positions = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    uv = np.array([[0, 1], [0, 0], [1, 1], [1, 1]], float)
    got = corner_tangents(positions, faces, uv[faces], np.broadcast_to(np.array([0, 0, 1.0], np.float32), (2, 3, 3)))
    assert_allclose(got[0], np.tile([1, 0, 0, 1], (3, 1)), atol=1e-7)
    assert_allclose(got[1], np.tile([-1, 0, 0, -1], (3, 1)), atol=1e-7)


def round_mesh():
    positions, faces = sphere(12)
    uv = np.column_stack([np.arctan2(positions[:, 1], positions[:, 0]) / 6.3, positions[:, 2]])[faces]
    return positions, faces, uv, positions[faces].astype(np.float32)


def test_tangents_do_not_depend_on_the_order_of_faces_or_on_welding():
    positions, faces, uv, normal = round_mesh()
    reference = corner_tangents(positions, faces, uv, normal)
    order = np.random.default_rng(0).permutation(len(faces))
    assert_allclose(corner_tangents(positions, faces[order], uv[order], normal[order]), reference[order], atol=1e-6)
    soup = corner_tangents(positions[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3), uv, normal)
    assert_array_equal(soup, reference)


def test_tangents_are_unit_and_orthogonal_whatever_comes():
    positions, faces, uv, normal = round_mesh()
    every = slice(None)
    for change, which, rows, factor in [("uv of no area", 1, slice(0, None, 2), 0), ("nan uv", 1, slice(0, None, 3), np.nan),
                                        ("inf uv", 1, slice(0, None, 3), np.inf), ("nan positions", 0, slice(0, None, 4), np.nan),
                                        ("huge", 0, every, 1e150), ("huge uv", 1, every, 1e100), ("tiny", 0, every, 1e-25),
                                        ("no normals", 2, slice(0, None, 2), 0)]:
        p, t, n = changed = positions.copy(), uv.copy(), normal.copy()
        with np.errstate(invalid="ignore"):  # 0 times infinity
            changed[which][rows] *= np.asarray(factor, changed[which].dtype)
        got = corner_tangents(p, faces, t, n).astype(np.float64)
        area = has_uv_area(t)
        assert area.sum() > len(area) / 4, change
        assert_allclose(np.linalg.norm(got[area, :, :3], axis=2), 1, atol=1e-6, err_msg=change)
        assert set(np.unique(got[area, :, 3])) <= {-1.0, 1.0} and not got[~area].any(), change
        assert np.abs(np.einsum("fck,fck->fc", got[..., :3], n)).max() < 1e-6, change


def test_no_faces_have_no_tangents():
    got = corner_tangents(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3, 2)), np.zeros((0, 3, 3), np.float32))
    assert got.shape == (0, 3, 4)


def test_corners_are_grouped_alike_where_their_mixed_bits_collide(monkeypatch):
    rows = np.random.default_rng(3).integers(0, 3, (200, 4)).astype(np.float64)
    expected = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    monkeypatch.setattr(tangents, "MIX", np.int64(0))
    pairs = np.unique(np.stack([tangents._groups(rows[:, :3], rows[:, 3:]), expected]), axis=1)
    assert pairs.shape[1] == len(np.unique(pairs[0])) == len(np.unique(pairs[1])) > 20
