"""Bad glTF files through encode_gltf() and expand(): a coded error, or a file that has lost nothing."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from gltf_scenes import SCENES, remembering, tree_of, with_tree

from fuzz.trees import paths_of
from texfcodec.encoder.container.encode import encode_document
from texfcodec.errors import InputError, TexfError
from texfcodec.io.container.expand import expand_bytes
from texfcodec.io.gltf.accessor import read_accessor
from texfcodec.io.gltf.document import MOST_LEVELS, open_document
from texfcodec.io.parts import Notes
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report

FAST = EncodeOptions(rate="r06", no_check=True, effort="fast")
KINDS = ("SCALAR", "VEC2", "VEC3", "VEC4")
OF_FILES = ("TXF-I", "TXF-S", "TXF-L", "TXF-U")


@pytest.fixture(scope="module")
def code():
    """The encoder, which codes equal scenes once."""
    return remembering()


def encoded(data, code):
    return encode_document(data, Path(), FAST, Report(), code)


def expanded(data):
    from texfcodec.decoder import decode_stream

    return expand_bytes(data, Path(), lambda stream: decode_stream(stream, DecodeOptions(), Report()))


@pytest.fixture(scope="module")
def coded(code):
    """{name: GLB with streams}."""
    return {name: encoded(SCENES[name]().glb(), code).data for name in ("skinned", "morphing")}


def primitive(root, mesh=0):
    return root["meshes"][mesh]["primitives"][0]


def accessor_of(root, name):
    return root["accessors"][primitive(root)["attributes"][name]]


# Sources. All of it is untouched in the coded file, or its first primitive stays as it is, or the file is refused.


def _cycle(root):
    root["nodes"] += [{"children": [7], "mesh": 0}, {"children": [6]}]


def _many_nodes(root):
    first = len(root["nodes"])
    root["nodes"] += [{"children": [first + n + 1], "translation": [0, 0, 1e-5]} for n in range(50_000)] + [{"mesh": 0}] * 50_000
    root["scenes"][0]["nodes"].append(first)


def _long_names(root):
    for kind in ("nodes", "meshes", "materials", "skins"):
        root[kind][0]["name"] = "n" * (1 << 20)


def _target(**sparse):
    def bend(root):
        count = accessor_of(root, "POSITION")["count"]
        root["accessors"].append({"type": "VEC3", "componentType": 5126, "count": count, "sparse": {
            "count": 1, "indices": {"bufferView": 0, "componentType": 5121, "byteOffset": 255},
            "values": {"bufferView": 0}} | sparse})
        primitive(root)["targets"] = [{"POSITION": len(root["accessors"]) - 1}]
    return bend


UNTOUCHED = {
    "nodes on a cycle": _cycle,
    "a node of two parents": lambda root: root["nodes"][2]["children"].append(1),
    "100,000 nodes": _many_nodes,
    "names of a megabyte": _long_names,
    "a node that is not there": lambda root: root["scenes"][0]["nodes"].append(99),
    "a joint that is not there": lambda root: root["skins"][0]["joints"].append(99),
    "a camera that is no object": lambda root: root.update(cameras=[3]),
    "an image of a file that is not here": lambda root: root["images"].append({"uri": "none.png"}),
    "an image of another host": lambda root: root["images"].append({"uri": "https://example.org/a.png"}),
    "a scale beyond all numbers": lambda root: root["nodes"][0].update(scale=[1e300] * 3),
    "an extension that is not declared": lambda root: root.update(extensions={"ACME": {"accessors": [0, 1, 2]}}),
}
STAYS = {
    "an accessor that is longer than its view": lambda root: accessor_of(root, "JOINTS_0").update(count=3000),
    "weights of another count": lambda root: accessor_of(root, "WEIGHTS_0").update(count=3),
    "an accessor without values": lambda root: accessor_of(root, "POSITION").update(count=0),
    "a matrix as an attribute": lambda root: accessor_of(root, "JOINTS_0").update(type="MAT4", count=2),
    "signed indices": lambda root: root["accessors"][primitive(root)["indices"]].update(componentType=5122),
    "faces of vertices that are not there": lambda root: [accessor_of(root, name).update(count=3) for name in primitive(root)[
        "attributes"]],
    "a sparse index that is not there": _target(),
    "sparse values beyond their view": _target(count=1 << 30),
    "a mode that is no number": lambda root: primitive(root).update(mode="triangles"),
    "points": lambda root: primitive(root).update(mode=0),
}
REFUSED = {
    "primitives that are no array": lambda root: root["meshes"][0].update(primitives={}),
    "attributes that are no object": lambda root: primitive(root).update(attributes=[0]),
    "targets that are no array": lambda root: primitive(root).update(targets={"POSITION": 0}),
    "extensions that are null": lambda root: primitive(root).update(extensions=None),
    "an index as text": lambda root: primitive(root).update(indices="0"),
    "an index as a float": lambda root: primitive(root)["attributes"].update(POSITION=0.0),
    "an index as a boolean": lambda root: primitive(root).update(material=True),
    "a material that is not there": lambda root: primitive(root).update(material=9),
    "samplers that are null": lambda root: root.update(samplers=None),
    "objects in objects": lambda root: root.update(extras=_nested(MOST_LEVELS)),
}


def _nested(levels):
    value = 0
    for _ in range(levels):
        value = [value]
    return value


def _bent(bend):
    root = deepcopy(tree_of(SCENES["skinned"]().glb()))
    bend(root)
    return with_tree(SCENES["skinned"]().glb(), root)


@pytest.mark.parametrize("bend", UNTOUCHED.values(), ids=list(UNTOUCHED))
def test_what_no_stream_holds_is_untouched_however_odd(bend, code):
    source = _bent(bend)
    result = encoded(source, code)
    before, after = tree_of(source), tree_of(result.data)
    assert result.streams and all("TEXF_stream" in primitive(after, mesh)["extensions"] for mesh in (0, 1))
    for kind in ("nodes", "scenes", "skins", "cameras", "animations"):
        kept = [[{k: v for k, v in entry.items() if k != "inverseBindMatrices"} if isinstance(entry, dict) else entry
                 for entry in root.get(kind, [])] for root in (before, after)]
        assert kept[0] == kept[1]
    assert [image["uri"] for image in after.get("images", []) if "uri" in image] \
        == [image["uri"] for image in before["images"] if "uri" in image]


@pytest.mark.parametrize("bend", STAYS.values(), ids=list(STAYS))
def test_a_primitive_that_cannot_be_read_stays_as_it_is(bend, code):
    source = _bent(bend)
    result = encoded(source, code)
    before, after = tree_of(source), tree_of(result.data)
    assert {k: v for k, v in primitive(after).items() if k not in ("attributes", "indices", "targets")} \
        == {k: v for k, v in primitive(before).items() if k not in ("attributes", "indices", "targets")}
    assert primitive(after).get("attributes", {}).keys() == primitive(before).get("attributes", {}).keys()
    assert "TEXF_stream" in primitive(after, 1)["extensions"]


@pytest.mark.parametrize("bend", REFUSED.values(), ids=list(REFUSED))
def test_a_tree_of_other_types_is_refused(bend, code):
    with pytest.raises(InputError, match="TXF-I09"):
        encoded(_bent(bend), code)


def _patched(builder, number, values):
    """The GLB of a Builder with other bytes for an accessor."""
    view = builder.tree["bufferViews"][builder.tree["accessors"][number]["bufferView"]]
    data = np.tile(np.asarray(values), (view["byteLength"] // values.nbytes, 1)).tobytes()
    builder.blob = builder.blob[: view["byteOffset"]] + data + builder.blob[view["byteOffset"] + view["byteLength"] :]
    return builder.glb()


@pytest.mark.parametrize("scene, place, values", [
    ("skinned", ("meshes", 0, "primitives", 0, "attributes", "JOINTS_0"), np.array([9, 200, 255, 7], np.uint8)),
    ("skinned", ("meshes", 0, "primitives", 0, "attributes", "WEIGHTS_0"), np.array([3, -1, np.nan, 0.5], np.float32)),
    ("skinned", ("skins", 0, "inverseBindMatrices"), np.full(16, np.inf, np.float32)),
    ("morphing", ("meshes", 0, "primitives", 0, "targets", 1, "POSITION"), np.array([np.nan, 1e38, -np.inf], np.float32)),
    ("spinning", ("animations", 0, "samplers", 0, "input"), np.array([np.nan], np.float32)),
    ("spinning", ("animations", 0, "samplers", 0, "output"), np.array([0, np.inf, 0, 0], np.float32)),
])
def test_stored_values_come_back_however_odd(scene, place, values, code):
    def number_in(root):
        for key in place:
            root = root[key]
        return root

    builder = SCENES[scene]()
    source = _patched(builder, number_in(builder.tree), values)
    result = open_document(expanded(encoded(source, code).data), None, Notes())
    stored = read_accessor(result, number_in(result.root), (*KINDS, "MAT4"))
    assert {row.tobytes() for row in stored} == {values.tobytes()}


@pytest.mark.parametrize("name", ["skinned", "morphing"])
@pytest.mark.parametrize("value", [None, [], {}, "a", -1, 1.5, True, 1 << 70], ids=str)
def test_any_value_of_another_type_ends_in_a_coded_error(value, name, coded, code):
    """Each place of the tree in turn, of the coded file and of its source."""
    codes = set()
    for data, run in ((coded[name], expanded), (SCENES[name]().glb(), lambda data: encoded(data, code))):
        for path in list(paths_of(tree_of(data)))[1:]:
            root = tree_of(data)
            holder = root
            for key in path[:-1]:
                holder = holder[key]
            holder[path[-1]] = value
            try:
                run(with_tree(data, root))
            except TexfError as error:
                codes.add(error.code)
    assert codes and all(error.startswith("TXF-I") for error in codes)
