"""TEXF_stream: a GLB or glTF that carries a .texf stream beside a coarse level of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from mesh_files import Builder, load_bytes, read_glb, textured
from shapes import mapped_sheet, noise, painted_sphere

from texfcodec import DecodeOptions, EncodeOptions, Limits, Report, decode, encode, encode_to_result, inspect
from texfcodec.cli.inputs import load_asset
from texfcodec.errors import InputError, LimitError, SupportError
from texfcodec.io.load import load
from texfcodec.io.save import as_glb, save

REPOSITORY = Path(__file__).resolve().parents[2]
VECTORS = REPOSITORY / "conformance"


def coded(scene, **options):
    return encode(scene, EncodeOptions(**({"resolution": 64, "qp": 16, "refine": "off"} | options)))


@pytest.fixture(scope="module")
def sheet():
    """A stream of a field over texels."""
    return coded(mapped_sheet({}, noise(3)), support="texels")


def carrying(stream, lod=3, **options):
    """(bytes, what save() tells) of a GLB that carries a stream."""
    return as_glb(decode(stream, DecodeOptions(lod=lod)), stream=stream, **options)


def carried_in(path):
    """The bytes that the extension names, by the JSON and not by our reader."""
    document, binary = read_glb(path)
    (scene,) = document["scenes"]
    view = document["bufferViews"][scene["extensions"]["TEXF_stream"]["bufferView"]]
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def bent(stream=b"", **extension):
    """A Builder of a textured square whose scene carries bytes; extension: what stands in the extension instead."""
    builder = textured()
    builder.tree["extensionsUsed"] = ["TEXF_stream"]
    builder.tree["scenes"][0]["extensions"] = {"TEXF_stream": extension or {"bufferView": builder.view(stream)}}
    return builder


def assert_same(scene, other):
    for name in ("positions", "faces", "face_material", "corner_uv"):
        assert np.array_equal(getattr(scene, name), getattr(other, name)), name
    assert len(scene.textures) == len(other.textures)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(scene.textures, other.textures, strict=True))


# Writing.


def test_the_stream_rides_untouched_beside_a_coarse_level(sheet, tmp_path):
    told = save(decode(sheet, {"lod": 3}), tmp_path / "a.glb", stream=sheet, texture_format="png")
    document, binary = read_glb(tmp_path / "a.glb")
    assert carried_in(tmp_path / "a.glb") == sheet
    assert document["extensionsUsed"] == ["TEXF_stream"] and "extensionsRequired" not in document
    plain, _ = as_glb(decode(sheet, {"lod": 3}), texture_format="png")
    assert told["carried"] == {"stream": len(sheet), "fallback": (tmp_path / "a.glb").stat().st_size - len(sheet)}
    assert 0 < told["carried"]["fallback"] - len(plain) < 250
    del document["scenes"][0]["extensions"], document["extensionsUsed"]
    shown = json.loads(plain[20 : 20 + int.from_bytes(plain[12:16], "little")])
    assert document["bufferViews"].pop() and {**document, "buffers": 0} == {**shown, "buffers": 0}


def test_a_gltf_carries_it_in_its_buffer(sheet, tmp_path):
    told = save(decode(sheet, {"lod": 3}), tmp_path / "a.gltf", stream=sheet)
    total = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert sheet in (tmp_path / "a.bin").read_bytes() and sum(told["carried"].values()) == total
    assert_same(load(tmp_path / "a.gltf"), load_bytes(tmp_path, as_glb(decode(sheet), texture_format="png")[0]))


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.npz"])
def test_other_formats_carry_none(sheet, tmp_path, name):
    with pytest.raises(InputError, match="TXF-O18"):
        save(decode(sheet), tmp_path / name, stream=sheet)
    assert list(tmp_path.iterdir()) == []


def test_what_carries_nothing_says_so(sheet, tmp_path):
    assert save(decode(sheet), tmp_path / "a.glb")["carried"] is None
    assert "extensions" not in read_glb(tmp_path / "a.glb")[0]["scenes"][0]


def test_an_empty_mesh_is_carried():
    stream = (VECTORS / "uncommon" / "empty" / "in.texf").read_bytes()
    data, _ = carrying(stream)
    assert decode(data).faces.shape == (0, 3)
    with pytest.raises(InputError, match="TXF-I15"):
        load(data)


# Reading.


@pytest.mark.parametrize("support", ["texels", "voxels"])
def test_loading_gives_the_scene_of_the_stream(support):
    if support == "texels":
        stream = coded(mapped_sheet({"roughness": noise(5)}, noise(3)), support="texels")
    else:
        stream = coded(painted_sphere(12), support="voxels")
    scene = load(carrying(stream)[0])
    assert_same(scene, load(as_glb(decode(stream), texture_format="png")[0]))
    assert scene.metadata == decode(stream).metadata and scene.warnings == [] and scene.dropped == []
    assert f"the carried stream ({len(stream)} bytes) is read instead of its fallback" in scene.remarks


def test_the_encoder_codes_the_stream_and_not_the_fallback(sheet):
    made = encode_to_result(carrying(sheet)[0], {"strict": True, "qp": 16, "refine": "off"})
    assert inspect(made.data)["fields"][0]["width"] == 32 and any("fallback" in text for text in made.remarks)


def test_decode_and_inspect_take_the_stream_out(sheet, tmp_path):
    data, _ = carrying(sheet)
    (tmp_path / "a.glb").write_bytes(data)
    with open(tmp_path / "a.glb", "rb") as file:
        for given in (data, tmp_path / "a.glb", file):
            assert np.array_equal(decode(given).fields[0].rgba, decode(sheet).fields[0].rgba)
    assert inspect(data) == inspect(sheet)
    with pytest.raises(InputError, match="TXF-I26"):
        decode(textured().glb())


FAULTS = {  # what is wrong: (Builder, code of the reason)
    "cut short": (lambda stream: bent(stream[:200]), "TXF-S02"),
    "damaged": (lambda stream: bent(stream[:-40] + bytes([stream[-40] ^ 1]) + stream[-39:]), "TXF-S"),
    "empty": (lambda stream: bent(b""), "TXF-S"),
    "of another version": (lambda stream: bent((VECTORS / "faulty" / "version" / "in.texf").read_bytes()), "TXF-U04"),
    "no stream": (lambda stream: bent(b"glTF" * 20), "TXF-S01"),
    "no such bufferView": (lambda stream: bent(bufferView=99), "TXF-I09"),
    "no bufferView": (lambda stream: bent(version=1), "TXF-I09"),
    "a bufferView that is no number": (lambda stream: bent(bufferView=True), "TXF-I09"),
}


@pytest.mark.parametrize("fault", [*FAULTS, "bufferView leaves the buffer", "extension is no object"])
def test_a_broken_stream_gives_the_fallback_and_a_warning(sheet, tmp_path, fault):
    make, code = FAULTS.get(fault, (bent, "TXF-I"))
    builder = make(sheet)
    if fault == "bufferView leaves the buffer":
        builder.tree["bufferViews"][-1]["byteLength"] += 1000
    elif fault == "extension is no object":
        builder.tree["scenes"][0]["extensions"]["TEXF_stream"] = [1]
    scene = load_bytes(tmp_path, builder)
    assert len(scene.faces) == 2 and len(scene.textures) == 1
    (warning,) = scene.warnings
    assert "(TXF-I25)" in warning and f"({code}" in warning and "fallback" in warning and scene.dropped == ["the carried stream"]
    with pytest.raises(InputError, match="TXF-I25"):
        load_bytes(tmp_path, builder, strict=True)


def test_what_is_drawn_of_a_file_that_carries_a_stream_is_the_stream(sheet, tmp_path):
    path, report, inputs = tmp_path / "a.glb", Report(), []
    path.write_bytes(carrying(sheet)[0])
    texf = load_asset(str(path), DecodeOptions(threads=1), inputs, report)
    assert np.array_equal(texf.fields[0].rgba, decode(sheet).fields[0].rgba)
    assert inputs == [str(path)] and report.remarks == [f"{path}: the carried stream is read instead of its fallback"]


def test_a_stream_over_the_limits_gives_the_fallback(sheet):
    scene = load(bent(sheet).glb(), limits=Limits(faces=1))
    assert len(scene.faces) == 2 and "TXF-L03" in scene.warnings[0]


def test_extensions_that_break_the_tree_are_errors_with_a_code(sheet):
    builder = bent(sheet)
    builder.tree["scenes"][0]["extensions"] = 5
    with pytest.raises(InputError, match="TXF-I09"):
        load(builder.glb())


def test_only_the_default_scene_is_asked(sheet):
    builder = bent(sheet)
    builder.tree["scenes"].append({"nodes": [0]})
    builder.tree["scene"] = 1
    assert len(load(builder.glb()).faces) == 2
    with pytest.raises(InputError, match="TXF-I26"):
        decode(builder.glb())


@pytest.mark.parametrize("data", [b"glTF", b"glTF" + bytes(30), Builder().glb()[:-3]])
def test_a_broken_glb_given_as_a_stream_is_an_error_with_a_code(data):
    with pytest.raises((InputError, SupportError, LimitError), match="TXF-I"):
        decode(data)


# Command lines.


def test_texf_dec_writes_it_and_takes_it_out(sheet, tmp_path, call):
    source, glb, back = tmp_path / "a.texf", tmp_path / "a.glb", tmp_path / "b.texf"
    source.write_bytes(sheet)
    code, out, _ = call("texf-dec", source, glb, "--carry-stream", "--json")
    facts = json.loads(out)
    assert code == 0 and facts["texels"] == 16 and sum(facts["carried"].values()) == glb.stat().st_size
    code, out, _ = call("texf-dec", glb, back, "--json")
    assert code == 0 and back.read_bytes() == sheet and json.loads(out)["bytes"]["total"] == len(sheet)
    _, out, _ = call("texf-dec", source, glb, "--carry-stream", "--lod", 0)
    assert f"carries the stream ({len(sheet)} bytes) and a fallback (" in out and "1024 texels" in out
    _, out, _ = call("texf-dec", source, glb, "--carry-stream", "--fallback-faces", 7, "--json")
    assert json.loads(out)["faces"] <= 7 and carried_in(glb) == sheet
    assert call("texf-dec", source, glb, "--fallback-faces", 7)[0] == 1
    assert call("texf-dec", source, tmp_path / "c.ply", "--carry-stream")[0] == 2
    assert call("texf-dec", source, tmp_path / "c.texf", "--carry-stream")[0] == 1
    assert "TXF-O07" in call("texf-dec", source, source)[2]


def test_tools_draw_and_measure_the_stream_itself(sheet, tmp_path, call):
    source, glb, broken = (tmp_path / name for name in ("a.texf", "a.glb", "b.glb"))
    source.write_bytes(sheet)
    glb.write_bytes(carrying(sheet)[0])
    broken.write_bytes(bent(sheet[:-9]).glb())
    code, out, _ = call("texf-eval", glb, glb, "--views", 2, "--size", 64, "--no-3d", "--json")
    assert code == 0 and "fallback" in json.loads(out)["remarks"][0]
    said = {}
    for path in (source, glb, broken):
        code, out, err = call("texf-render", path, path.with_suffix(path.suffix + ".png"), "--size", 64, "--json")
        assert code == 0, out + err
        said[path] = json.loads(out)
    assert (tmp_path / "a.texf.png").read_bytes() == (tmp_path / "a.glb.png").read_bytes()
    assert said[source]["remarks"] == [] and "is read instead of its fallback" in said[glb]["remarks"][0]
    assert said[broken]["remarks"] == [] and "TXF-I25" in said[broken]["warnings"][0]
