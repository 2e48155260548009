"""What is dropped on the page of texf-view, from whoever it came, and the GLB that the page gets of a mesh."""

import base64
import json
import subprocess
import sys

import numpy as np
import pytest
from shapes import mapped_sheet, noise, scene_of, sphere
from stand_ins import post

from texfcodec import EncodeOptions, LimitError, decode, encode
from texfcodec.demo.asset import make_sample
from texfcodec.errors import InputError, StreamError
from texfcodec.io.formats import SUFFIXES
from texfcodec.io.load import load
from texfcodec.limits import Limits
from texfcodec.scene.channels import BY_NAME
from texfcodec.viewer.dropped import glb_of_dropped
from texfcodec.viewer.glb import glb_of_asset, glb_of_scene, is_read
from texfcodec.viewer.server import ViewServer

# Files that are dropped


@pytest.fixture(scope="module")
def stream():
    return encode(make_sample(), EncodeOptions(resolution=32, qp=30))


@pytest.fixture(scope="module")
def glb(stream, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    decode(stream).save(path, appearance="vertex")
    return path.read_bytes()


def glb_of(document):
    """A GLB without a binary chunk."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + np.array([2, 20 + len(text), len(text), 0x4E4F534A], "<u4").tobytes() + text


def with_image(uri):
    """A GLB with one triangle whose texture is at a URI."""
    buffer = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    accessor = {"componentType": 5126, "count": 3}
    return glb_of({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "images": [{"uri": uri}],
        "textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "buffers": [{"byteLength": 60, "uri": "data:;base64," + base64.b64encode(buffer).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}],
        "accessors": [{**accessor, "bufferView": 0, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                      {**accessor, "bufferView": 1, "type": "VEC2"}],
    })  # fmt: skip


def document_of(data):
    """The JSON of a GLB."""
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def warnings_of(data):
    return document_of(data)["asset"]["extras"]["texf"]["warnings"]


def test_meshes_are_taken_and_broken_ones_leave_the_server_at_work(stream, glb):
    with ViewServer([], drop=glb_of_dropped) as view:
        bare = glb_of({"asset": {"version": "2.0"}})
        for data, code in ((b"", "TXF-I04"), (b"garbage" * 99, "TXF-I05"), (stream, "TXF-I05"),
                           (glb[: len(glb) // 2], "TXF-I07"), (b"glTF" + bytes(99), "TXF-I33"), (bare, "TXF-I15")):
            status, _, body = post(view, "drop?name=a", data)
            assert (status, json.loads(body)["code"]) == (422, code), code
        status, _, body = post(view, "drop?name=vase", glb)
        assert status == 200 and len(load(body).faces) == len(load(glb).faces)


def test_a_dropped_mesh_reaches_no_file_of_this_machine(tmp_path, monkeypatch):
    from PIL import Image

    Image.new("RGB", (4, 4), (1, 2, 3)).save(tmp_path / "private.png")
    monkeypatch.chdir(tmp_path)
    data = glb_of_dropped(with_image("private.png"), "a.glb")
    assert b"private.png" in data  # the warning that it is missing
    with pytest.raises(InputError) as raised:
        glb_of_dropped(with_image(str(tmp_path / "private.png")), "a.glb")
    assert raised.value.code == "TXF-I16" and str(tmp_path) not in str(raised.value)


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
STL = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
DROPPED = {"a.STL": STL, "a.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"}


@pytest.mark.parametrize("name", DROPPED)
def test_a_mesh_of_any_format_can_be_dropped(name):
    data = glb_of_dropped(DROPPED[name].encode(), name)
    assert len(load(data).faces) == 1 and warnings_of(data) == []


def test_a_format_is_taken_by_its_suffix_and_another_is_told_those_that_are_read():
    for suffix in SUFFIXES[-2:]:
        with pytest.raises(InputError) as raised:
            glb_of_dropped(b"no such thing", f"a{suffix}")
        assert raised.value.code != "TXF-I05", suffix
    with pytest.raises(InputError, match=r"\.fbx is not a supported format; choose \.texf .*\.stl"):
        glb_of_dropped(b"Kaydara FBX Binary", "a.fbx")


def test_what_a_dropped_file_names_is_said_to_be_missing_and_what_to_do(tmp_path, monkeypatch):
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\n")
    monkeypatch.chdir(tmp_path)
    named = f"mtllib {{}}\nusemtl m\n{TRIANGLE}"
    for name in ("a.obj", str(tmp_path / "a.obj")):
        said = warnings_of(glb_of_dropped(named.format("a.mtl").encode(), name))
        assert "'a.mtl' is missing" in said[0] and "open it with texf-view instead" in said[-1]
    with pytest.raises(InputError) as raised:
        glb_of_dropped(named.format(tmp_path / "a.mtl").encode(), "a.obj")
    assert raised.value.code == "TXF-I16"
    document = {"asset": {"version": "2.0"}, "buffers": [{"uri": "a.bin", "byteLength": 36}], "nodes": [{"mesh": 0}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}
    with pytest.raises(InputError, match=r"a\.bin' is missing.*open it with texf-view instead"):
        glb_of_dropped(json.dumps(document).encode(), "a.gltf")


def test_what_is_dropped_is_read_under_the_limits(glb):
    if not sys.platform.startswith("linux"):
        pytest.skip("memory is capped by Linux's limits")
    with pytest.raises(LimitError) as raised:
        glb_of_dropped(glb, "a", Limits(isolate_bytes=1 << 12))
    assert raised.value.code == "TXF-L07"


def test_a_reader_of_meshes_that_crashes_is_an_error_of_the_file(glb, monkeypatch):
    from texfcodec.viewer import dropped as room

    monkeypatch.setattr(room, "run_child", lambda *_: subprocess.CompletedProcess([], -11, b"", b""))
    with pytest.raises(StreamError) as raised:
        glb_of_dropped(glb, "a.glb")
    assert raised.value.code == "TXF-S40" and raised.value.details["status"] == -11


# The GLB of a Scene


def test_a_scene_comes_back_from_its_glb_with_maps_uvs_and_colours():
    maps = {"roughness": noise(1), "metallic": noise(4), "emissive": noise(2), "normal": noise(3)}
    scene = mapped_sheet(maps, noise(0), span=3.0, double_sided=True,
                         parameters={"emissive": (1.0, 0.5, 1.0), "normal_scale": (0.5,)})
    scene.map_uv["emissive"] = scene.corner_uv * 0.5
    scene.corner_color = np.random.default_rng(0).random((*scene.faces.shape, 4), np.float32)
    scene.textures[0].wrap, scene.textures[scene.materials[0].maps["emissive"]].nearest = (1, 2), True
    again = load(glb_of_scene(scene))
    assert again.faces.shape == scene.faces.shape and again.warnings == scene.warnings == []
    for have, want in ((again.positions[again.faces], scene.positions[scene.faces]), (again.corner_uv, scene.corner_uv),
                       (again.map_uv["emissive"], scene.map_uv["emissive"]), (again.corner_color, scene.corner_color)):
        np.testing.assert_allclose(have, want, atol=1e-6)
    (one,), (other,) = again.materials, scene.materials
    assert (one.double_sided, one.parameters, one.maps.keys()) == (True, other.parameters, other.maps.keys())
    for name in other.maps:
        have, want = again.textures[one.maps[name]], scene.textures[other.maps[name]]
        assert (have.wrap, have.nearest) == (want.wrap, want.nearest)
        columns = list(BY_NAME[name].columns)
        np.testing.assert_array_equal(have.image[..., columns], want.image[..., columns])


def test_an_empty_scene_has_a_glb():
    assert "meshes" not in document_of(glb_of_scene(scene_of(np.zeros((0, 3)), np.zeros((0, 3)))))


def test_a_mesh_keeps_its_details_far_from_the_origin():
    positions, faces = sphere(6)
    again = load(glb_of_scene(scene_of(positions + 1e7, faces)))
    assert np.ptp(again.positions, axis=0) == pytest.approx(np.ptp(positions, axis=0), rel=1e-4)


@pytest.mark.parametrize("change, reads", [
    ({}, True), ({"extensionsUsed": ["KHR_materials_clearcoat"]}, True),
    ({"extensionsUsed": ["KHR_draco_mesh_compression"]}, False),
    ({"extensionsRequired": ["EXT_meshopt_compression"]}, False), ({"images": [{"uri": "a.png"}]}, False),
    ({"buffers": [{"uri": "data:;base64,AA==", "byteLength": 1}]}, True), ({"buffers": [3]}, False),
])  # fmt: skip
def test_a_file_is_shown_as_it_is_where_the_page_reads_it(tmp_path, change, reads):
    data = glb_of({"asset": {"version": "2.0"}, **change})
    (tmp_path / "a.glb").write_bytes(data)
    shown = glb_of_asset(str(tmp_path / "a.glb"), scene_of(*sphere(4)))
    assert is_read(data) is reads and (shown == data) is reads


@pytest.mark.parametrize("data", [b"", b"glTF", b"glTF" + bytes(16), b"glTF" + bytes(99), b"solid a"])
def test_what_is_no_glb_is_not_shown_as_it_is(data):
    assert is_read(data) is False
