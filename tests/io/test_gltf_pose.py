"""glTF files in the pose of an animation: values by hand, and that nothing else of the file changes."""

import numpy as np
import pytest
from gltf_scenes import SCENES, spinning
from mesh_files import SQUARE, TWO, Builder

from texfcodec import InputError
from texfcodec.io.gltf.pose import interpolated
from texfcodec.io.load import load, load_posed

HALF = np.sqrt(0.5)
TIMES = np.array([1, 3], np.float32)


def turn(degrees, axis=2):
    """Quaternion of a turn about an axis, float64 [4]."""
    half = np.radians(degrees) / 2
    return np.concatenate([np.sin(half) * np.eye(3)[axis], [np.cos(half)]])


def animated(builder, path, values, node=0, mode="LINEAR", times=TIMES, **more):
    """Add a channel to the first animation of a builder; return the builder."""
    if "animations" not in builder.tree:
        builder.tree["animations"] = [{"samplers": [], "channels": []}]
    animation = builder.tree["animations"][0]
    animation["samplers"].append({"input": builder.accessor(times), "interpolation": mode,
                                  "output": builder.accessor(np.asarray(values), **more)})
    animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": path}})
    return builder


def square(path, values, **more):
    """A square whose node an animation moves."""
    builder = Builder()
    builder.primitive()
    return animated(builder, path, np.asarray(values, more.pop("dtype", np.float32)), **more)


def positions(builder, *times, animation=None):
    """Positions at each time, float64 [T, V, 3]."""
    return np.array([scene.positions for scene in load_posed(builder.glb(), times, animation)])


def test_translation_and_scale_are_linear_and_clamped_to_the_keyframes():
    got = positions(square("translation", [[0, 0, 0], [4, 8, 0]]), -5, 1, 1.5, 3, 99)
    np.testing.assert_allclose(got, SQUARE + np.array([0, 0, 1, 4, 4])[:, None, None] * [1, 2, 0], atol=1e-6)
    np.testing.assert_allclose(positions(square("scale", [[1, 1, 1], [3, 1, 1]]), 2)[0], SQUARE * [2, 1, 1], atol=1e-6)


def test_a_step_holds_until_the_next_keyframe_as_float32_has_it():
    times = np.array([0, 0.1, 0.7], np.float32)
    got = positions(square("translation", np.eye(3), mode="STEP", times=times), 0.0999, 0.1, 0.69, 0.7)
    np.testing.assert_array_equal(got - SQUARE, np.broadcast_to(np.eye(3)[[0, 1, 1, 2], None], got.shape))


def test_rotations_take_the_shorter_arc_at_a_constant_speed():
    by_hand = [SQUARE @ [[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in np.radians([0, 30, 120])]
    for sign in (1, -1):
        builder = square("rotation", [turn(0), sign * turn(120)])
        np.testing.assert_allclose(positions(builder, 1, 1.5, 3), by_hand, atol=1e-6)
    short = np.round(32767 * np.array([turn(0), turn(120)]))
    packed = square("rotation", short, dtype=np.int16, normalized=True)
    np.testing.assert_allclose(positions(packed, 1.5)[0], by_hand[1], atol=1e-4)
    near = interpolated(TIMES.astype(float), np.array([turn(0), turn(1e-7)])[:, None], "LINEAR", 2.0, True)
    np.testing.assert_allclose(near, turn(5e-8), atol=1e-15)


def test_a_cubic_spline_has_its_values_tangents_and_middle():
    keys = np.array([[[9, 9, 9], [0, 0, 0], [1, 0, 2]], [[-1, 4, 2], [2, 0, 0], [9, 9, 9]]], np.float32)
    builder = square("translation", keys.reshape(-1, 3), mode="CUBICSPLINE")
    got = positions(builder, 0, 1, 2, 3, 4) - SQUARE
    middle = (keys[0, 1] + keys[1, 1]) / 2 + 2 * (keys[0, 2] - keys[1, 0]) / 8  # of Hermite's form, over two seconds
    np.testing.assert_allclose(got[:, 0], [[0, 0, 0], [0, 0, 0], middle, [2, 0, 0], [2, 0, 0]], atol=1e-6)
    step = 1e-6
    before, after = (interpolated(TIMES.astype(float), keys.astype(float), "CUBICSPLINE", time) for time in (1 + step, 3 - step))
    np.testing.assert_allclose([before / step, (keys[1, 1] - after) / step], [keys[0, 2], keys[1, 0]], atol=1e-4)


def arm():
    """A square whose upper edge follows an elbow at y = 1, and its middle both joints."""
    builder, joints = Builder(), np.array([[0, 1, 0, 0]] * 4, np.uint8)
    weights = np.array([[255, 0, 0, 0], [255, 0, 0, 0], [0, 255, 0, 0], [102, 153, 0, 0]], np.uint8)
    builder.primitive(attributes={"JOINTS_0": builder.accessor(joints), "WEIGHTS_0": builder.accessor(weights, normalized=True)})
    bind = np.stack([np.eye(4), np.eye(4)]).astype(np.float32)
    bind[1, 3, 1] = -1  # columns first
    matrices = builder.add("accessors", {"bufferView": builder.view(bind.tobytes()), "count": 2, "type": "MAT4",
                                         "componentType": 5126})
    builder.tree |= {"skins": [{"joints": [1, 2], "inverseBindMatrices": matrices}], "scenes": [{"nodes": [0, 1]}],
                     "nodes": [{"mesh": 0, "skin": 0, "translation": [7, 7, 7]}, {"children": [2]}, {"translation": [0, 1, 0]}]}
    animated(builder, "translation", np.array([[0, 0, 0], [2, 0, 0]], np.float32), node=1)
    return animated(builder, "rotation", np.array([turn(0), turn(180)], np.float32), node=2)


def test_an_arm_of_two_joints_bends_at_its_elbow():
    np.testing.assert_allclose(positions(arm(), 0)[0], load(arm().glb()).positions, atol=1e-7)
    elbow, quarter = np.array([0, 1, 0]), np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    bent = (SQUARE - elbow) @ quarter.T + elbow
    share = np.array([0, 0, 1, 0.6])[:, None]
    np.testing.assert_allclose(positions(arm(), 2)[0], (1 - share) * SQUARE + share * bent + [1, 0, 0], atol=1e-6)


def morphing(**target):
    """A square with a normal and a tangent and a sparse target that moves its second vertex."""
    builder = Builder()
    rows, lift = builder.view(np.array([1], np.uint16).tobytes()), builder.view(np.array([[0, 0, 2]], np.float32).tobytes())
    sparse = builder.add("accessors", {"count": 4, "type": "VEC3", "componentType": 5126, "sparse": {
        "count": 1, "indices": {"bufferView": rows, "componentType": 5123}, "values": {"bufferView": lift}}})
    normal, tangent = np.tile(np.float32([0, 0, 1]), (4, 1)), np.tile(np.float32([1, 0, 0, -1]), (4, 1))
    targets = [{"POSITION": sparse, "NORMAL": builder.accessor(np.tile(np.float32([2, 0, 0]), (4, 1))),
                "TANGENT": builder.accessor(np.tile(np.float32([0, 0, -2]), (4, 1)))}]
    builder.primitive(attributes={"NORMAL": builder.accessor(normal), "TANGENT": builder.accessor(tangent)}, targets=targets)
    builder.tree["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0, "weights": [0.25]}]
    builder.tree["scenes"] = [{"nodes": [0, 1, 2]}]
    return animated(builder, "weights", np.array([0, 1], np.float32))


def test_morph_weights_move_positions_normals_and_tangents_of_their_node_alone():
    scene = next(load_posed(morphing().glb(), [2]))
    lifted = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(scene.positions, np.concatenate([SQUARE + lifted, SQUARE + [5, 0, 0], SQUARE + lifted / 2]))
    np.testing.assert_allclose(scene.corner_normal[::2, 0], [[HALF, 0, HALF], [0, 0, 1], np.array([1, 0, 2]) / np.sqrt(5)],
                               atol=1e-6)
    np.testing.assert_allclose(scene.corner_tangent[::2, 0], [[HALF, 0, -HALF, -1], [1, 0, 0, -1],
                                                              np.array([2, 0, -1, -np.sqrt(5)]) / np.sqrt(5)], atol=1e-6)


def test_the_first_keyframe_of_a_file_that_rests_in_it_is_the_file_itself():
    rest, posed = load(spinning().glb()), next(load_posed(spinning().glb(), [0]))
    for name in ("positions", "faces", "corner_uv"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(posed, name))
    assert rest.dropped == ["animation 'spin'"] and posed.dropped == []


def two_animations():
    builder = square("translation", [[0, 0, 0], [2, 0, 0]])
    builder.tree["animations"] += [{"name": "0", "samplers": builder.tree["animations"][0]["samplers"], "channels": []},
                                   {"name": "idle", "samplers": [], "channels": []}]
    return builder


@pytest.mark.parametrize("animation, moved", [(None, 1), ("0", 0), ("1", 0), ("idle", 0)])
def test_an_animation_is_the_first_or_has_a_name_or_a_number(animation, moved):
    np.testing.assert_array_equal(positions(two_animations(), 2, animation=animation)[0], SQUARE + [moved, 0, 0])


@pytest.mark.parametrize("source, animation", [
    (SCENES["skinned"]().glb(), None), (two_animations().glb(), "3"), (two_animations().glb(), "Idle"), (b"v 0 0 0\n", None),
], ids=["none", "number", "name", "no glTF"])
def test_a_file_without_the_animation_is_refused(source, animation):
    with pytest.raises(InputError) as error:
        next(load_posed(source, [0], animation))
    assert error.value.code == "TXF-I29"


@pytest.mark.parametrize("builder", [
    square("translation", [[0, 0, 0], [np.nan, 0, 0]]), square("translation", np.zeros((2, 3)), mode="BEZIER"),
    square("translation", np.zeros((2, 3)), times=np.array([1, np.nan], np.float32)),
    square("translation", np.zeros((2, 3)), times=np.array([3, 1], np.float32)), square("translation", np.zeros((3, 3))),
    square("weights", np.zeros(3)), square("rotation", np.zeros((2, 3))), square("colour", np.zeros((2, 3))),
    square("translation", np.zeros((2, 3)), node=7), square("translation", np.zeros((2, 3)), mode="CUBICSPLINE"),
], ids=["values", "mode", "times", "order", "count", "weights", "type", "path", "node", "spline"])
def test_a_malformed_animation_is_refused(builder):
    with pytest.raises(InputError) as error:
        next(load_posed(builder.glb(), [2]))
    assert error.value.code == "TXF-I09"


def test_what_is_not_posed_is_named():
    builder = two_animations()
    builder.tree["nodes"][0]["matrix"] = np.eye(4).reshape(-1).tolist()
    pointer = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/materials/0/emissiveFactor"}}}
    builder.tree["animations"][0]["channels"].append({"sampler": 0, "target": pointer})
    scene = next(load_posed(builder.glb(), [2]))
    np.testing.assert_array_equal(scene.positions, SQUARE)
    assert len(scene.faces) == len(TWO) and scene.warnings == [
        "node 'node' has a matrix, so its animation is not posed",
        "KHR_animation_pointer: /materials/0/emissiveFactor is animated but not posed"]
