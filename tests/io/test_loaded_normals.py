"""Normals and tangents of files on their way to a Scene."""

import numpy as np
import pytest
from conftest import REPOSITORY
from format_files import FACES, ascii_ply
from mesh_files import SQUARE, SQUARE_UV, TWO, Builder, facing, load_bytes, refusal, textured
from shapes import scene_of, square

from texfcodec.errors import InputError
from texfcodec.io.load import load

SLANTED = np.array([[0, 0, 2], [0.6, 0, 0.8], [0, 0, 0.5], [0, -3, 4]], np.float32)  # of any length
UNIT = SLANTED / np.linalg.norm(SLANTED, axis=1, keepdims=True)
ALONG = np.array([[1, 0, 0, 1], [0, 2, 0, -1], [1, 1, 0, 1], [0, 0, 1, 1]], np.float32)


def built(normals=SLANTED, tangents=None, node=None, **accessor):
    """A Builder with a square that has these normals."""
    builder = Builder()
    attributes = {"NORMAL": builder.accessor(normals, **accessor)}
    if tangents is not None:
        attributes["TANGENT"] = builder.accessor(tangents)
    builder.primitive(attributes=attributes)
    builder.tree["nodes"][0] |= node or {}
    return builder


def test_normals_arrive_at_their_corners_with_length_one(tmp_path):
    scene = load_bytes(tmp_path, built(tangents=ALONG), strict=True)
    assert scene.corner_normal.dtype == scene.corner_tangent.dtype == np.float32
    np.testing.assert_allclose(scene.corner_normal, UNIT[TWO], atol=1e-6)
    length = np.linalg.norm(ALONG[:, :3], axis=1, keepdims=True)
    np.testing.assert_allclose(scene.corner_tangent, np.hstack([ALONG[:, :3] / length, ALONG[:, 3:]])[TWO], atol=1e-6)
    assert scene.dropped == [] and scene.warnings == [] and scene.flat


def test_a_file_without_normals_keeps_no_array_and_ignores_its_tangents(tmp_path):
    builder = Builder()
    builder.primitive(attributes={"TANGENT": builder.accessor(ALONG)})
    scene = load_bytes(tmp_path, builder)
    assert scene.corner_normal is None and scene.corner_tangent is None and scene.flat and scene.dropped == []
    assert not load_bytes(tmp_path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", "a.obj").flat


@pytest.mark.parametrize("scale, side", [([2, 1, 0.5], 1), ([-1, 1, 1], -1), ([1, -2, -3], 1), ([-1, -1, -1], -1)])
def test_nodes_turn_normals_by_the_inverse_transpose_and_tangents_along(tmp_path, scale, side):
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # a quarter around z
    quaternion = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    scene = load_bytes(tmp_path, built(tangents=ALONG, node={"scale": scale, "rotation": quaternion}))
    linear = turn @ np.diag(scale)
    normals = SLANTED @ np.linalg.inv(linear)
    tangents = ALONG[:, :3] @ linear.T
    order = TWO if side > 0 else TWO[:, [0, 2, 1]]
    np.testing.assert_allclose(scene.corner_normal, (normals / np.linalg.norm(normals, axis=1, keepdims=True))[order], atol=1e-6)
    expected = np.hstack([tangents / np.linalg.norm(tangents, axis=1, keepdims=True), ALONG[:, 3:] * side])[order]
    np.testing.assert_allclose(scene.corner_tangent, expected, atol=1e-6)
    assert (np.einsum("fk,fk->f", facing(scene), scene.corner_normal[:, 0]) > 0).all()  # the winding turns along


def test_a_node_that_is_flat_along_an_axis_still_faces_somewhere(tmp_path):
    scene = load_bytes(tmp_path, built(np.float32([[0, 0, 1]] * 4), node={"scale": [2, 3, 0]}))
    np.testing.assert_allclose(scene.corner_normal, np.broadcast_to([0, 0, 1], (2, 3, 3)))


def test_integers_are_scaled(tmp_path):
    stored = np.array([[0, 0, 127], [127, 0, 0], [0, -128, 0], [-90, 0, 90]], np.int8)
    padded = np.zeros((4, 4), np.int8)
    padded[:, :3] = stored
    builder = built()
    view = builder.view(padded.tobytes(), byteStride=4)
    builder.tree["accessors"][builder.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]] |= {
        "bufferView": view, "componentType": 5120, "normalized": True}
    expected = np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0], [-np.sqrt(0.5), 0, np.sqrt(0.5)]])
    np.testing.assert_allclose(load_bytes(tmp_path, builder).corner_normal, expected[TWO], atol=1e-6)


def test_normals_of_draco_data(tmp_path):
    DracoPy = pytest.importorskip("DracoPy")
    up = np.broadcast_to(np.float64([[0.6, 0, 0.8]]), (4, 3)).copy()
    packed = DracoPy.encode(SQUARE, TWO.astype(np.uint32), normals=up, quantization_bits=16, normal_quantization_bits=12)
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in DracoPy.decode(packed).attributes}
    builder = built()
    (primitive,) = builder.tree["meshes"][0]["primitives"]
    draco = {"bufferView": builder.view(packed), "attributes": {"POSITION": ids[0], "NORMAL": ids[1]}}
    primitive["extensions"] = {"KHR_draco_mesh_compression": draco}
    for index in primitive["attributes"].values():
        del builder.tree["accessors"][index]["bufferView"]
    np.testing.assert_allclose(load_bytes(tmp_path, builder).corner_normal, np.broadcast_to([0.6, 0, 0.8], (2, 3, 3)), atol=1e-3)


@pytest.mark.parametrize("bad", [[0, 0, 0], [np.nan, 0, 1], [0, np.inf, 0]])
def test_broken_normals_make_way_for_the_faces_and_are_named_once(tmp_path, bad):
    normals = UNIT.copy()
    normals[1] = bad  # of one corner, in the first face
    scene = load_bytes(tmp_path, built(normals))
    np.testing.assert_allclose(scene.corner_normal[0, 1], [0, 0, 1])
    np.testing.assert_allclose(scene.corner_normal[1], UNIT[TWO[1]], atol=1e-6)
    assert len(scene.remarks) == 1 and scene.remarks[0].startswith("1 face corner has a normal") and scene.warnings == []


def test_tangents_that_are_broken_or_missing_are_zero(tmp_path):
    tangents = ALONG.copy()
    tangents[0], tangents[2, 3] = np.nan, 0
    scene = load_bytes(tmp_path, built(tangents=tangents))
    assert (np.abs(scene.corner_tangent).max(axis=2) == 0).tolist() == np.isin(TWO, [0, 2]).tolist()


def test_primitives_without_normals_beside_others_are_flat(tmp_path):
    builder = built()
    builder.primitive(SQUARE + np.float32([0, 0, 5]))
    scene = load_bytes(tmp_path, builder)
    np.testing.assert_allclose(scene.corner_normal[2:], np.broadcast_to([0, 0, 1], (2, 3, 3)))
    np.testing.assert_allclose(scene.corner_normal[:2], UNIT[TWO], atol=1e-6)


def test_another_count_of_normals_is_malformed(tmp_path):
    assert refusal(tmp_path, built(SLANTED[:3])).code == "TXF-I09"


def test_morph_targets_move_normals_too(tmp_path):
    builder = built(np.float32([[0, 0, 1]] * 4))
    (primitive,) = builder.tree["meshes"][0]["primitives"]
    primitive["targets"] = [{"NORMAL": builder.accessor(np.float32([[1, 0, 0]] * 4))}]
    builder.tree["meshes"][0]["weights"] = [1]
    np.testing.assert_allclose(load_bytes(tmp_path, builder).corner_normal, np.full((2, 3, 3), [np.sqrt(0.5), 0, np.sqrt(0.5)]),
                               atol=1e-6)


OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 2 # up\nvn 0.6 0 0.8\n"


@pytest.mark.parametrize("faces, expected", [
    ("f 1//1 2//2 3//1 4//2", [[0, 1, 0], [0, 0, 1]]), ("f 1/1/1 2/1/-1 3/1/1 4/1/-1", [[0, 1, 0], [0, 0, 1]]),
    ("f 1//2 2//2 3//2\nf 1 3 4", [[1, 1, 1], [0, 0, 0]]),  # the second face says nothing: flat
])
def test_obj_normals(tmp_path, faces, expected):
    scene = load_bytes(tmp_path, f"{OBJ}vt 0 0\n{faces}\n", "a.obj")
    np.testing.assert_allclose(scene.corner_normal, np.array([[0, 0, 1], [0.6, 0, 0.8]])[np.array(expected)], atol=1e-6)
    assert "NORMAL" not in scene.dropped and not scene.flat


def test_obj_normals_that_nothing_names_are_none(tmp_path):
    assert load_bytes(tmp_path, f"{OBJ}f 1 2 3\n", "a.obj").corner_normal is None


def test_an_obj_face_that_names_no_normal_there_is_refused(tmp_path):
    assert refusal(tmp_path, f"{OBJ}f 1//1 2//3 3//1\n", "a.obj").code == "TXF-I13"
    assert refusal(tmp_path, f"{OBJ}f 1//1 2//-3 3//1\n", "a.obj").code == "TXF-I13"


def test_ply_normals(tmp_path):
    more = "property float nx\nproperty float ny\nproperty float nz\n"
    text = ascii_ply(FACES, "4 0 1 2 3", np.hstack([SQUARE, UNIT]), more)
    scene = load_bytes(tmp_path, text, "a.ply", strict=True)
    np.testing.assert_allclose(scene.corner_normal, UNIT[TWO], atol=1e-5)
    assert scene.dropped == [] and not scene.flat


@pytest.mark.parametrize("name, value", [("corner_normal", np.zeros((2, 3, 2))), ("corner_tangent", np.zeros((2, 3, 3)))])
def test_a_scene_of_a_caller_is_checked(name, value):
    scene = scene_of(*square())
    setattr(scene, name, value)
    with pytest.raises(InputError) as caught:
        load(scene)
    assert caught.value.code == "TXF-I22"
    setattr(scene, name, np.full((2, 3, 3 if name == "corner_normal" else 4), np.nan))
    with pytest.raises(InputError) as caught:
        load(scene)
    assert caught.value.code == "TXF-I14"


def test_textured_primitives_keep_uv_beside_normals(tmp_path):
    builder = textured()
    builder.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = builder.accessor(SLANTED)
    scene = load_bytes(tmp_path, builder)
    np.testing.assert_array_equal(scene.corner_uv, SQUARE_UV[TWO])
    np.testing.assert_allclose(scene.corner_normal, UNIT[TWO], atol=1e-6)


def test_normals_of_every_asset_have_length_one():
    folder = REPOSITORY.parent / "shared" / "assets"
    if not folder.is_dir():
        pytest.skip("the real assets are not there")
    found = 0
    for name in ("vintage_fan", "virtual_city", "cat_webp"):
        normal = load(folder / f"{name}.glb").corner_normal
        found += len(normal)
        assert np.abs(np.linalg.norm(normal, axis=2) - 1).max() < 1e-5
    assert found > 30000
