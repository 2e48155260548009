"""The vectors of conformance/container/: expand() passes them, claims hold, and the runner fails expanders that are wrong."""

import json
import struct

import pytest
from gltf_scenes import tree_of, with_tree

from conformance import run_containers as runner
from conformance.make.containers import HOME, unkept
from fuzz.trees import paths_of
from texfcodec.errors import InputError
from texfcodec.io.container.layout import open_scene_file, streams_of

CASES = sorted(path.parent.name for path in HOME.glob("*/expected.json"))
GOOD = [name for name in CASES if not name.startswith("faulty_")]


@pytest.mark.parametrize("name", CASES)
def test_expand_passes_every_vector(name):
    assert runner.faults_of(runner.own, HOME / name) == []


@pytest.mark.parametrize("name", GOOD)
def test_a_vector_holds_what_it_claims(name):
    case = json.loads((HOME / name / "expected.json").read_text(encoding="utf-8"))
    assert unkept(case["claims"], (HOME / name / "in.glb").read_bytes()) == []


@pytest.mark.parametrize("name", GOOD)
def test_objects_of_the_extension_have_the_properties_of_its_schema(name):
    schema = json.loads((HOME.parents[1] / "docs" / "guide" / "TEXF_stream.schema.json").read_text(encoding="utf-8"))["$defs"]
    root = tree_of((HOME / name / "in.glb").read_bytes())
    objects = {"document": [root], "primitive": [p for mesh in root["meshes"] for p in mesh["primitives"]],
               **{kind: root.get(f"{kind}s", []) for kind in ("scene", "texture", "bufferView")}}
    coded = [(schema[kind], entry["extensions"]["TEXF_stream"]) for kind, entries in objects.items() for entry in entries
             if "TEXF_stream" in entry.get("extensions", {})]
    assert len(coded) >= 2
    for definition, entry in coded:
        assert {*definition.get("required", [])} <= entry.keys() <= definition.get("properties", {}).keys()


@pytest.mark.parametrize("name", [name for name in GOOD if name != "voxels"])  # which takes an atlas each time
def test_a_vector_without_any_one_of_its_properties_is_expanded_or_refused(name):
    data = (HOME / name / "in.glb").read_bytes()
    codes = set()
    for path in list(paths_of(tree_of(data)))[1:]:
        root = tree_of(data)
        holder = root
        for key in path[:-1]:
            holder = holder[key]
        del holder[path[-1]]
        exit_code, expanded, said = runner.own(with_tree(data, root))
        codes.add(said[:5] if exit_code else expanded[:4])
    assert {b"glTF", "TXF-I"} <= codes <= {b"glTF", "TXF-I", "TXF-S"}  # S: a view's number then is that of other bytes


def _with_json(data, bend):
    length = int.from_bytes(data[12:16], "little")
    root = json.loads(data[20 : 20 + length])
    bend(root)
    text = json.dumps(root).encode()
    return struct.pack("<4sIIII", b"glTF", 2, 0, len(text), 0x4E4F534A) + text + data[20 + length :]


def _primitive(root):
    return root["meshes"][0]["primitives"][0]


WRONG = {
    "a face too few": ("skinned", lambda root: root["accessors"][_primitive(root)["indices"]].update(count=3), "POSITION"),
    "other weights": ("skinned", lambda root: _primitive(root)["attributes"].update(
        WEIGHTS_0=_primitive(root)["attributes"]["POSITION"]), "WEIGHTS_0 of primitive 0 differs"),
    "no normals": ("normals", lambda root: _primitive(root)["attributes"].pop("NORMAL"), "NORMAL of primitive 0"),
    "a primitive too few": ("one_stream", lambda root: root["meshes"].pop(), "1 primitives of triangles instead of 2"),
    "a target lost": ("target", lambda root: _primitive(root).pop("targets"), "target 0 POSITION"),
    "no indices": ("target", lambda root: _primitive(root).pop("indices"), "cannot be read"),
}


@pytest.mark.parametrize("name, bend, words", WRONG.values(), ids=list(WRONG))
def test_the_runner_fails_an_expander_that_is_wrong(name, bend, words):
    faults = runner.faults_of(lambda data: (0, _with_json(runner.own(data)[1], bend), ""), HOME / name)
    assert words in " ".join(faults)


@pytest.mark.parametrize("name, bend, code", [
    ("splits", lambda root: root["accessors"][_primitive(root)["extensions"]["TEXF_stream"]["splits"]].update(componentType=5126),
     "TXF-I09"),
    ("deflated", lambda root: [view.update(byteLength=1 << 31) for view in root["bufferViews"] if "extensions" in view],
     "TXF-I41"),
])
def test_faults_of_other_types_and_sizes_are_refused_with_their_code(name, bend, code):
    data = (HOME / name / "in.glb").read_bytes()
    bend(root := tree_of(data))
    exit_code, _, said = runner.own(with_tree(data, root))
    assert exit_code and said.startswith(code)


def test_a_reader_of_streams_alone_refuses_those_that_are_no_indices():
    data = (HOME / "splits" / "in.glb").read_bytes()
    (root := tree_of(data))["extensions"]["TEXF_stream"].update(streams=[-1])
    with pytest.raises(InputError, match="TXF-I09"):
        streams_of(open_scene_file(with_tree(data, root)))


def test_the_runner_sees_other_texels():
    expected = json.loads((HOME / "one_primitive" / "expected.json").read_text(encoding="utf-8"))["primitives"]
    expected[0]["baseColorTexture"][0][0] += 9
    faults = runner.faults_of_arrays(runner.own((HOME / "one_primitive" / "in.glb").read_bytes())[1], expected)
    assert faults == ["baseColorTexture of primitive 0 differs"]


def test_the_runner_fails_an_expander_that_takes_a_faulty_file_or_breaks_at_it():
    folder = HOME / "faulty_unit_twice"
    assert runner.faults_of(lambda data: (0, data, ""), folder) and runner.faults_of(lambda data: (4, b"", "KeyError"), folder)
    assert runner.faults_of(lambda data: (2, b"", "TXF-I11: another reason"), folder)
