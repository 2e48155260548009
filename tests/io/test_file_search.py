"""Files that a mesh names: what is looked for where, what is a remark, and that what is not there is a loss in every reader."""

import json
import unicodedata

import numpy as np
import pytest
from format_files import FACES, ascii_ply, dae
from mesh_files import RED_BLUE, encoded, load_bytes, refusal, textured

from texfcodec.io.file_search import find_file, is_remote, readings
from texfcodec.io.load import load
from texfcodec.io.parts import Notes

OBJ = "mtllib {}\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl {}\nf 1/1 2/2 3/3\n"
CUP = unicodedata.normalize("NFC", "tassé.png")


def put(folder, name, data=b"x"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


@pytest.fixture
def home(tmp_path):
    """The mesh's folder, in one of its own, so that nothing else is above it."""
    return put(tmp_path, "asset/models/pot.obj").parent


@pytest.mark.parametrize("name, there", [
    ("wood.PNG", "Wood.png"), ("wood.jpeg", "wood.JPG"), ("maps\\wood.png", "maps/wood.png"), ("maps/wood.png", "wood.png"),
    ("C:\\art\\me\\maps\\wood.png", "wood.png"), ("C:\\art\\pot\\maps\\wood.png", "maps/wood.png"),
    ("/srv/art/wood.png", "wood.png"), ("wood.png", "textures/wood.png"), ("wood.png", "Textures/4k/wood.png"),
    ("wood.png", "pot_files/wood.png"), ("wood.png", "../textures/wood.png"), ("textures/wood.png", "../textures/wood.png"),
    ("wood.png", "../wood.png"), ('"my wood.png"', "my wood.png"), ("my%20wood.png", "My Wood.png"),
    ("file:///C:/art/wood.png", "wood.png"), ("..\\..\\else\\wood.png", "wood.png"),
    (unicodedata.normalize("NFD", CUP), CUP), (CUP, unicodedata.normalize("NFD", CUP)),
    ("纹理.png".encode("gbk").decode("latin-1"), "纹理.png"),
    ("テクスチャ.png".encode("cp932").decode("latin-1"), "テクスチャ.png"),
    ("表.png".encode("cp932").decode("latin-1"), "表.png"), ("дерево.png".encode("cp1251").decode("latin-1"), "дерево.png"),
    ("纹理.png", "纹理.png".encode("gbk").decode("cp437")), ("纹理.png", "纹理.png".encode("gbk").decode("latin-1")),
    ("图\\纹理.png".encode("gbk").decode("latin-1"), "图/纹理.png"), ("%CE%C6%C0%ED.png", "纹理.png"),
])
def test_a_file_under_another_name_or_in_another_folder_is_a_remark(home, name, there):
    path, notes = put(home, there), Notes()
    notes.path = home / "pot.obj"
    found = find_file(home, name, notes)
    assert found is not None and found.samefile(path)
    assert notes.dropped == notes.warnings == [] and len(notes.remarks) == 1 and "is read from" in notes.remarks[0]


@pytest.mark.parametrize("name, there", [("wood.png", "wood.png"), ("maps/wood.png", "maps/wood.png"), ("a%20b.png", "a b.png")])
def test_a_file_at_its_place_is_no_remark(home, name, there):
    path, notes = put(home, there), Notes()
    assert find_file(home, name, notes) == path and notes.remarks == []


@pytest.mark.parametrize("name, there", [
    ("wood.png", "other_asset/wood.png"), ("wood.png", "../chair/wood.png"), ("wood.png", "wood.bmp"), ("wood.png", "wood.png/x"),
    ("http://a.example/wood.png", "wood.png"), ("", "wood.png"), ("..", "wood.png"), ("a\0b", "wood.png"),
    ("x" * 5000, "wood.png"),
])
def test_files_of_other_meshes_and_names_that_are_none_are_not_taken(home, name, there):
    put(home, there)
    assert find_file(home, name, Notes()) is None


def test_a_choice_between_several_files_is_a_loss(home):
    for name in ("WOOD.png", "Wood.png"):
        put(home, name)
    notes = Notes()
    assert find_file(home, "wood.png", notes).name == "WOOD.png"
    assert notes.dropped == ["file 'wood.png' (guessed among 2 files)"] and len(notes.warnings) == 1


def test_a_folder_is_read_once_however_many_names_are_missing(home, monkeypatch):
    import os

    seen, notes, scandir = [], Notes(), os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: seen.append(str(path)) or scandir(path))
    for number in range(50):
        assert find_file(home, f"maps/missing {number}.png", notes) is None
    assert len(seen) == len(set(seen)) <= 4


def test_addresses_are_told_from_files():
    assert is_remote("https://a.example/t.png") and is_remote("s3://bucket/t.png")
    assert not any(map(is_remote, ("C:\\t.png", "C:/t.png", "file:///t.png", "t:u.png", "t.png")))


def test_ascii_has_one_reading():
    assert readings("wood.png") == [] and "纹" in readings("纹".encode("gbk").decode("latin-1"))


# Readers.


@pytest.mark.parametrize("coding", ["gbk", "cp932", "utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("other", ["gbk", "utf-8"])
def test_obj_and_mtl_may_be_in_different_encodings(home, coding, other):
    put(home, "木目.png", encoded(RED_BLUE))
    put(home, "材.mtl", "newmtl 材料\r\nmap_Kd -bm 1.0 木目.png\r\n".encode(other))
    scene = load(put(home, "pot.obj", OBJ.format("材.mtl", "材料").encode(coding)), strict=True)
    assert scene.materials[0].texture == 0 and scene.dropped == scene.warnings == []
    assert scene.textures[0].image[0, 0].tolist() == [255, 0, 0, 255]
    assert (scene.materials[0].name, scene.textures[0].name) == ("材料", "木目.png")


def test_an_mtl_is_not_cut_at_bytes_that_are_line_ends_in_other_encodings(home):
    name = "\u5305\u8857.png"  # GBK has 0x85 and 0xA0 in characters like these, which Python takes for ends and blanks of lines
    data = name.encode("gbk")
    for extra in (b"\x85\x40", b"\xa0\xa1"[:1] + b"\x40"):
        data = extra + data
    put(home, data.decode("gb18030"), encoded(RED_BLUE))
    put(home, "a.mtl", b"newmtl m\nmap_Kd " + data + b"\n")
    assert load(put(home, "pot.obj", OBJ.format("a.mtl", "m").encode())).materials[0].texture == 0


def test_half_a_character_is_no_continuation(home):
    put(home, "a.mtl", "newmtl 表\nKd 1 0 0\n".encode("cp932"))
    scene = load(put(home, "pot.obj", OBJ.format("a.mtl", "表").encode("cp932")), strict=True)
    assert scene.materials[0].factor[:3].tolist() == [1, 0, 0] and len(scene.faces) == 1


def test_an_obj_that_names_no_library_takes_that_of_its_name(home):
    put(home, "pot.mtl", b"newmtl clay\nKd 1 0 0\n")
    scene = load(put(home, "pot.obj", OBJ.format("", "clay").replace("mtllib \n", "").encode()), strict=True)
    assert scene.materials[0].factor[:3].tolist() == [1, 0, 0]
    assert "'pot.mtl', which the OBJ file does not name" in scene.remarks[0]


@pytest.mark.parametrize("text, lost", [
    (OBJ.format("gone.mtl", "a"), ["material file 'gone.mtl'", "material 'a' (not defined)"]),
    (OBJ.replace("mtllib {}\n", "").format("a"), ["material 'a' (not defined)"]),
])
def test_materials_of_an_obj_that_are_not_there_are_losses(home, text, lost):
    assert load_bytes(home, text, "pot.obj").dropped == lost


def test_a_missing_texture_is_a_loss_in_every_reader(tmp_path):
    pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    builder = textured()
    builder.tree["images"][0] = {"uri": "gone.png"}
    put(tmp_path, "a.mtl", b"newmtl m\nmap_Kd gone.png\n")
    ply = ascii_ply(FACES, "3 0 1 2", [f"{x} {y} 0 {x} {y}" for x, y in ((0, 0), (1, 0), (1, 1))],
                    "property float s\nproperty float t\n", "comment TextureFile gone.png\n")
    files = {"a.glb": builder, "a.obj": OBJ.format("a.mtl", "m"), "a.ply": ply, "a.dae": dae().replace("t%20ex.png", "gone.png")}
    for name, source in files.items():
        scene = load_bytes(tmp_path, source, name)
        assert scene.dropped == ["texture 'gone.png' of base colour"], name
        assert scene.warnings == [
            "texture file 'gone.png' is missing or unreadable; base colour is drawn without it (TXF-I16)"], name
        assert refusal(tmp_path, source, name, strict=True).code == "TXF-I16"


def test_a_remote_image_is_called_remote(tmp_path):
    builder = textured()
    builder.tree["images"][0] = {"uri": "https://a.example/t.png"}
    scene = load_bytes(tmp_path, builder)
    assert scene.dropped == ["texture 'https://a.example/t.png' of base colour"]
    assert "is remote; nothing is downloaded" in scene.warnings[0] and "missing" not in scene.warnings[0]
    assert refusal(tmp_path, builder, strict=True).code == "TXF-I27"


def test_a_remote_buffer_is_called_remote(tmp_path):
    tree = json.dumps({**textured().tree, "buffers": [{"uri": "https://a.example/t.bin", "byteLength": 400}]})
    error = refusal(tmp_path, tree, "a.gltf")
    assert error.code == "TXF-I10" and "is remote" in error.message


def test_broken_texture_coordinates_and_colours_are_losses(tmp_path):
    builder = textured()
    attributes = builder.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = builder.accessor(np.full((4, 3), np.nan, np.float32))
    attributes["TEXCOORD_0"] = builder.accessor(np.full((4, 2), np.nan, np.float32))
    assert load_bytes(tmp_path, builder).dropped == ["texture coordinates (NaN or infinite)", "colours of vertices (NaN)"]
