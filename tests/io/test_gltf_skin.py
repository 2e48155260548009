"""Skinned glTF meshes take the pose of their joints in the file, whatever node shows them; broken skins stay as stored, named."""

import numpy as np
import pytest
from mesh_files import COMPONENTS, SQUARE, TWO, Builder, facing, load_bytes, refusal

from texfcodec.errors import InputError

NORMAL = np.array([[0, 0, 1], [0, 1, 1], [1, 0, 1], [0, 0, 1]], np.float32)
TANGENT = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 0, 1], [1, 0, 0, 1]], np.float32)
HALF = np.sqrt(0.5)
JOINTS = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]])
WEIGHTS = np.array([[0.75, 0.25, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0]])
NODES = [{"mesh": 0, "skin": 0, "name": "body", "scale": [9, 9, 9]},
         {"children": [2], "scale": [2, 2, 2]},
         {"translation": [0, 1, 0], "rotation": [0, 0, HALF, HALF], "children": [3]},
         {"translation": [0, 0, 3], "scale": [1, 2, 0.5]}]


def matrices(bind):
    """World matrices of nodes 2 and 3 of NODES by hand, times the inverse bind matrices."""
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]], float)
    inner = np.array([[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 0.5, 3], [0, 0, 0, 1]], float)
    above = np.diag([2.0, 2, 2, 1]) @ turn
    return [above @ bind[0], above @ inner @ bind[1]]


BIND = np.array([np.eye(4), [[0.5, 0, 0, 1], [0, 0.5, 0, 0], [0, 0, 0.5, -1], [0, 0, 0, 1]]])


def accessor(builder, rows, kind, code, **more):
    view = builder.view(np.ascontiguousarray(rows).tobytes())
    return builder.add("accessors", {"bufferView": view, "count": len(rows), "type": kind, "componentType": code, **more})


def skinned(joints=JOINTS, weights=WEIGHTS, bind=BIND, kind="f4", nodes=NODES, **attributes):
    builder = Builder()
    full = 1 if kind == "f4" else np.iinfo(kind).max
    named = {"NORMAL": builder.accessor(NORMAL), "TANGENT": builder.accessor(TANGENT)}
    for number in range(joints.shape[1] // 4):
        part = slice(4 * number, 4 * number + 4)
        named[f"JOINTS_{number}"] = accessor(builder, joints[:, part].astype("u1"), "VEC4", COMPONENTS["u1"])
        named[f"WEIGHTS_{number}"] = accessor(builder, np.round(weights[:, part] * full).astype(kind) if full > 1 else
                                              weights[:, part].astype(kind), "VEC4", COMPONENTS[kind], normalized=full > 1)
    builder.primitive(attributes=named | attributes)
    skin = {"joints": [2, 3]}
    if bind is not None:
        skin["inverseBindMatrices"] = accessor(builder, bind.transpose(0, 2, 1).astype("f4"), "MAT4", 5126)
    builder.tree["nodes"] = [dict(node) for node in nodes]
    builder.tree |= {"skins": [skin], "scenes": [{"nodes": [0, 1]}]}
    return builder


def expected(joints, weights, bind):
    """(positions, normals, tangents) by the formula of the specification, vertex by vertex."""
    world, out = matrices(bind), []
    for point, normal, tangent, row, share in zip(SQUARE, NORMAL, TANGENT, joints, weights, strict=True):
        blend = sum(w * world[j] for j, w in zip(row, share, strict=True) if w)
        linear = blend[:3, :3]
        turned, along = np.linalg.inv(linear).T @ normal, linear @ tangent[:3]
        out.append((linear @ point + blend[:3, 3], turned / np.linalg.norm(turned),
                    [*along / np.linalg.norm(along), tangent[3] * np.sign(np.linalg.det(linear))]))
    return [np.array(values) for values in zip(*out, strict=True)]


@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
@pytest.mark.parametrize("bind", [BIND, None], ids=["bound", "unbound"])
def test_a_skinned_mesh_takes_the_pose_of_its_joints(tmp_path, kind, bind):
    weights = WEIGHTS if kind == "f4" else np.round(WEIGHTS * np.iinfo(kind).max) / np.iinfo(kind).max
    weights = weights / weights.sum(axis=1, keepdims=True)
    scene = load_bytes(tmp_path, skinned(weights=WEIGHTS, kind=kind, bind=bind))
    points, normals, tangents = expected(JOINTS, weights, np.array([np.eye(4)] * 2) if bind is None else bind)
    np.testing.assert_allclose(scene.positions, points, atol=1e-6)
    np.testing.assert_allclose(scene.corner_normal, normals[TWO], atol=1e-5)
    np.testing.assert_allclose(scene.corner_tangent, tangents[TWO], atol=1e-5)
    assert scene.dropped == ["skin"] and scene.warnings == []


def test_all_sets_of_joints_count_and_weights_are_made_to_sum_to_one(tmp_path):
    joints, weights = np.hstack([JOINTS, JOINTS[:, [1, 0, 2, 3]]]), np.hstack([WEIGHTS, WEIGHTS[:, [1, 0, 2, 3]]])
    scene = load_bytes(tmp_path, skinned(joints, 3 * weights))
    np.testing.assert_allclose(scene.positions, expected(JOINTS, WEIGHTS, BIND)[0], atol=1e-6)


def test_a_mirroring_skeleton_turns_faces_with_their_normals(tmp_path):
    scene = load_bytes(tmp_path, skinned(nodes=[NODES[0], {**NODES[1], "scale": [-2, 2, 2]}, *NODES[2:]]))
    plain = load_bytes(tmp_path, skinned())
    np.testing.assert_allclose(facing(scene), facing(plain) * [-1, 1, 1], atol=1e-6)
    np.testing.assert_array_equal(scene.corner_tangent[:, 0, 3], -plain.corner_tangent[:, 0, 3])


def broken(change):
    builder = skinned()
    change(builder.tree)
    return builder


@pytest.mark.parametrize("builder, says", [
    (skinned(joints=JOINTS + 1), "refers to a joint that does not exist"),
    (skinned(bind=BIND[:1]), "fewer inverse bind matrices"),
    (skinned(bind=BIND * np.nan), "NaN or infinite"),
    (skinned(joints=JOINTS[:3]), "or differ in count"),
    (broken(lambda tree: tree.pop("skins")), "'skins' has no such entry"),
    (broken(lambda tree: tree["skins"][0].pop("joints")), "no joints"),
    (broken(lambda tree: tree["skins"][0].update(joints=[2, 77])), "'nodes' has no such entry"),
    (broken(lambda tree: tree["skins"][0].update(inverseBindMatrices=77)), "'accessors' has no such entry"),
    (broken(lambda tree: tree["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0")), "JOINTS_0 and WEIGHTS_0"),
], ids=lambda value: value if isinstance(value, str) else "")
def test_broken_skins_are_a_warning_and_an_error_when_strict(tmp_path, builder, says):
    scene = load_bytes(tmp_path, builder)
    np.testing.assert_allclose(scene.positions, 9 * SQUARE)
    assert scene.dropped == ["skin"] and len(scene.warnings) == 1
    assert says in scene.warnings[0] and "used as stored" in scene.warnings[0] and "'body'" in scene.warnings[0]
    assert refusal(tmp_path, builder, strict=True).code == "TXF-I09"


def test_joints_that_nothing_weighs_may_be_anything(tmp_path):
    joints = np.where(WEIGHTS > 0, JOINTS, 200)
    np.testing.assert_allclose(load_bytes(tmp_path, skinned(joints)).positions, expected(JOINTS, WEIGHTS, BIND)[0], atol=1e-6)


def test_weights_that_say_nothing_follow_the_first_joint(tmp_path):
    weights = WEIGHTS.copy()
    weights[0], weights[1] = 0, [1, np.nan, -1, np.inf]
    scene = load_bytes(tmp_path, skinned(weights=weights))
    weights[0] = weights[1] = [1, 0, 0, 0]
    np.testing.assert_allclose(scene.positions, expected(JOINTS, weights, BIND)[0], atol=1e-6)
    assert scene.warnings[0].startswith("2 of 4 vertices of mesh 'mesh' primitive 0 have skin weights")


def test_a_skeleton_in_a_ring_is_no_tree(tmp_path):
    nodes = [*NODES[:3], {**NODES[3], "children": [1]}]
    assert isinstance(refusal(tmp_path, skinned(nodes=nodes)), InputError)
