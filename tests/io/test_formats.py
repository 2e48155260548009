"""What a file is by its first bytes, text in UTF-16, and the table of formats."""

import importlib
import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import trimesh
from format_files import FACES, ascii_ply
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, TWO, encoded, load_bytes, refusal, textured

from texfcodec.errors import InputError
from texfcodec.io.formats import FORMATS, SUFFIXES, format_of
from texfcodec.io.load import load, read_source
from texfcodec.io.placing import Placing

OBJ = "mtllib m.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\n"
MTL = "newmtl paint\nKd 0.5 0.25 1\nmap_Kd é.png\n"
PLY = ascii_ply(FACES, "3 0 1 2", head="comment größe\n")


# The table.


def test_every_format_has_a_reader_and_one_suffix():
    assert len(set(SUFFIXES)) == len(FORMATS) and format_of(".exe") is None
    for entry in FORMATS:
        module = importlib.import_module(f"texfcodec.io.{entry.module}")
        assert callable(getattr(module, entry.function)) and format_of(entry.suffix) is entry


def test_the_packages_that_formats_need_stand_in_the_extra():
    from conftest import REPOSITORY

    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extra = " ".join(project["optional-dependencies"]["formats"])
    needed = {entry.package for entry in FORMATS if entry.package} | {"networkx", "opengl-basisu", "meshoptimizer"}
    assert len(needed) == 5 and all(package in extra for package in needed)


def test_the_table_costs_no_numpy():
    program = "import sys, texfcodec.io.formats; print('numpy' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False"]


@pytest.mark.parametrize("module", ["enc", "eval"])
def test_the_command_lines_name_every_format(module):
    tool = importlib.import_module(f"texfcodec.cli.{module}")
    command = tool.enc if module == "enc" else tool.evaluate
    assert " ".join(SUFFIXES) in " ".join(command.help.split())


def test_an_unknown_suffix_is_answered_with_the_list_and_a_guess(tmp_path):
    error = refusal(tmp_path, encoded(RED_BLUE), "a.fbx")
    assert error.code == "TXF-I05" and error.details["allowed"] == " ".join(SUFFIXES)
    assert error.details["looks_like"] == "a PNG image"


def test_bytes_and_open_files_are_sources_and_numbers_are_none(tmp_path):
    (tmp_path / "a.gltf").write_bytes(b"{}")
    with (tmp_path / "a.gltf").open("rb") as file:
        assert read_source(file) == (b"{}", tmp_path) and read_source(b"{}")[0] == b"{}"
    with pytest.raises(InputError, match="TXF-I05"):
        read_source(7)


# Wrong magic.


@pytest.mark.parametrize("name, data, words", [
    ("a.obj", textured().glb(), "named .obj but starts like a binary glTF"),
    ("a.gltf", textured().glb(), "named .gltf but starts like a binary glTF"),
    ("a.glb", json.dumps(textured().tree).encode(), "named .glb but starts like JSON, as in a .gltf"),
    ("a.ply", json.dumps(textured().tree).encode(), "named .ply but starts like JSON"),
    ("a.glb", PLY.encode(), "named .glb but starts like a Stanford PLY"),
    ("a.obj", PLY.encode(), "named .obj but starts like a Stanford PLY"),
    ("a.obj", encoded(RED_BLUE), "named .obj but starts like a PNG image"),
    ("a.gltf", encoded(RED_BLUE, "JPEG"), "starts like a JPEG image"),
    ("a.glb", encoded(RED_BLUE, "WEBP"), "starts like a WebP image"),
    ("a.glb", b"PK\x03\x04 and so on", "starts like a ZIP archive"),
    ("a.obj", b"\x1f\x8b\x08\0", "starts like a gzip file"),
    ("a.glb", b"DRACO\x02\x02", "starts like a bare Draco mesh"),
    ("a.glb", b"\x89TXF\r\n\x1a\n\0", "starts like a texf stream"),
    ("a.obj", b"Kaydara FBX Binary  \0", "starts like an FBX file"),
    ("a.glb", b"<!DOCTYPE html><html>", "starts like a web page"),
    ("a.obj", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    ("a.glb", b"\x01\x02\x03\x04", "named .glb but does not start like a .glb file"),
    ("a.obj", "v 0 0 0\n".encode("utf-16-le"), "starts like UTF-16 text without a byte order mark"),
    ("a.glb", "{}".encode("utf-16"), "starts like UTF-16 text"),
    ("a.obj", b"\xff\xfe\x00\xd8v", "the file has the byte order mark of UTF-16 but is not valid UTF-16"),
])
def test_a_wrong_suffix_is_answered_with_what_the_file_looks_like(tmp_path, name, data, words):
    error = refusal(tmp_path, data, name)
    assert error.code == "TXF-I06" and words in str(error)


def test_the_sample_stream_is_recognised(tmp_path):
    from conftest import REPOSITORY

    stream = next((REPOSITORY / "conformance").rglob("*.texf")).read_bytes()
    assert "texf-dec decodes it" in refusal(tmp_path, stream, "a.obj").message


# Text with a byte order mark.

ENCODINGS = ("utf-8-sig", "utf-16", "utf-16-be", "utf-32")


def marked(text, encoding):
    """Bytes with a byte order mark whatever the encoding."""
    return ("\ufeff" + text if encoding == "utf-16-be" else text).encode(encoding)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_obj_and_mtl_are_read_by_their_byte_order_mark(tmp_path, encoding):
    (tmp_path / "m.mtl").write_bytes(marked(MTL, encoding))
    (tmp_path / "é.png").write_bytes(encoded(RED_BLUE))
    for text in (OBJ, OBJ.partition("paint\n")[2]):  # the mark may stand before any statement
        scene = load_bytes(tmp_path, marked(text, encoding), "a.obj", strict=True)
        np.testing.assert_array_equal(scene.positions[scene.faces], SQUARE[TWO[:1]])
    scene = load_bytes(tmp_path, marked(OBJ, encoding), "a.obj", strict=True)
    assert scene.textures[0].name == "é.png"
    np.testing.assert_allclose(scene.materials[0].factor, [0.21404, 0.05088, 1, 1], atol=1e-5)
    assert scene.dropped == []


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_gltf_and_ply_text_are_read_by_their_byte_order_mark(tmp_path, encoding):
    builder = textured()
    (tmp_path / "mesh.bin").write_bytes(builder.blob)
    tree = {**builder.tree, "buffers": [{"byteLength": len(builder.blob), "uri": "mesh.bin"}]}
    scene = load_bytes(tmp_path, marked(json.dumps(tree), encoding), "a.gltf", strict=True)
    np.testing.assert_array_equal(scene.corner_uv, SQUARE_UV[TWO])
    scene = load_bytes(tmp_path, marked(PLY, encoding), "a.ply", strict=True)
    assert scene.faces.tolist() == [[0, 1, 2]] and scene.metadata == {"comments": ["größe"]}


# Files that another program wrote.


@pytest.mark.parametrize("suffix, packages", [(".stl", ()), (".off", ()), (".dae", ("collada",)), (".3mf", ()),
                                              (".ply", ()), (".obj", ()), (".glb", ())])
def test_what_trimesh_writes_is_read(tmp_path, suffix, packages):
    for package in packages:
        pytest.importorskip(package, reason=f"trimesh writes {suffix} with the package {package}")
    mesh = trimesh.creation.torus(1.0, 0.3, major_sections=12, minor_sections=8)
    if suffix == ".3mf":  # which has Z up and millimetres
        mesh.copy().apply_scale(1000).export(tmp_path / f"a{suffix}")
        mesh.apply_transform(Placing("Z").matrix)
    else:
        mesh.export(tmp_path / f"a{suffix}")
    scene = load(tmp_path / f"a{suffix}")
    assert len(scene.faces) == len(mesh.faces)
    corners = scene.positions[scene.faces].reshape(-1, 9), mesh.triangles.reshape(-1, 9)
    found, expected = (np.sort(rows.reshape(-1, 3).round(4), axis=0) for rows in corners)
    np.testing.assert_allclose(found, expected, atol=2e-4)
    a, b, c = (scene.positions[scene.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(mesh.volume, rel=1e-4)


# Alpha where the format has no modes


def test_alpha_that_nothing_asks_for_is_named(tmp_path):
    for alpha, named in ((128, 1), (255, 0)):
        rows = [f"{x} {y} 0 10 20 30 {alpha}" for x, y in ((0, 0), (1, 0), (0, 1))]
        more = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))
        scene = load_bytes(tmp_path, ascii_ply(FACES, "3 0 1 2", rows, more), "a.ply")
        assert sum("alpha" in name for name in scene.dropped) == named
