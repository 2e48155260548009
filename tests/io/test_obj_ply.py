"""OBJ with its materials and PLY: every feature on small files made here, every fault with its code."""

import struct

import numpy as np
import pytest
from mesh_files import RED_BLUE, SQUARE, SQUARE_UV, TWO, encoded, outcome

from texfcodec.errors import InputError
from texfcodec.io.mtl import read_mtl
from texfcodec.io.parts import Notes
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP

# OBJ.

OBJ = """mtllib my lib.mtl
o thing
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 9 9 9
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
usemtl paint
f 1/1/1 2/2/1 3/3/1 4/4/1
usemtl plain
f -5//1 -4//1 -3//1
f 1 2 3  # three corners
l 1 2
"""
MTL = """newmtl paint
Kd 0.5 0.25 1
d 0.5
Ns 10
map_Kd -s 2 3 -o 0.5 -clamp on my tex.png
map_Bump bump.png
newmtl plain
Kd 0 0 1
"""


@pytest.fixture
def obj(tmp_path, loaded):
    (tmp_path / "my lib.mtl").write_text(MTL)
    (tmp_path / "my tex.png").write_bytes(encoded(RED_BLUE))
    (tmp_path / "bump.png").write_bytes(encoded(np.arange(16, dtype=np.uint8).reshape(4, 4)))
    return lambda text=OBJ, **options: loaded(text, "a.obj", **options)


def test_obj_with_materials_polygons_and_negative_indices(obj):
    scene = obj(strict=True)
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 1, 2]]
    assert scene.face_material.tolist() == [0, 0, 1, 1] and len(scene.positions) == 4
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [2, 3] + [0.5, 0]
    np.testing.assert_allclose(scene.corner_uv[1], (uv * [1, -1] + [0, 1])[[0, 2, 3]])
    assert not scene.corner_uv[2:].any()
    paint, plain = scene.materials
    np.testing.assert_allclose(paint.factor, [0.21404, 0.05088, 1, 0.5], atol=1e-5)  # sRGB-coded, as viewers show Kd
    assert paint.alpha_mode == ALPHA_BLEND and paint.name == "paint"
    assert plain.factor.tolist() == [0, 0, 1, 1] and plain.texture == -1
    assert scene.textures[0].wrap == (WRAP_CLAMP, WRAP_CLAMP) and scene.textures[0].name == "my tex.png"
    assert scene.dropped == ["1 line", "map_Bump of material 'paint', a map of heights"]
    assert "Ns in the MTL file is left out" in scene.remarks
    assert scene.metadata == {"objects": ["thing"]}


@pytest.mark.parametrize("head, red", [("# Blender 4.0.1 MTL File: 'a.blend'", 0.5), ("# Created by hand", 0.21404)])
def test_kd_is_linear_where_blender_wrote_it_and_as_viewers_show_it_elsewhere(head, red):
    notes = Notes(strict=False)
    material = read_mtl(f"{head}\nnewmtl a\nKd 0.5 0 1\n".encode(), notes)["a"]
    np.testing.assert_allclose(material.factor, [red, 0, 1, 1], atol=1e-5)
    said = "colours of the MTL file are read as linear, as Blender writes them; many viewers show them darker"
    assert [*notes.remarks] == [said] * (red == 0.5)


def test_nothing_is_said_of_blender_where_coding_makes_no_difference():
    notes = Notes()
    assert read_mtl(b"# Blender 4.0.1\nnewmtl a\nKd 1 0 1\n", notes)["a"].factor.tolist() == [1, 0, 1, 1] and notes.remarks == []


@pytest.mark.parametrize("text, dropped, warned", [
    ("Kd 0 0 0\nnewmtl a\n", [], ""), ("newmtl a\nKd spectral f.rfl\n", ["Kd spectral of material 'a'"], ""),
    ("newmtl a\nmap_Kd -mm 0 2 t.png\n", ["map_Kd option -mm of material 'a'"], ""),
    ("newmtl a\nmap_Kd -bm 2 t.png\n", [], ""),
    ("newmtl a\nKd 0 0 0\nmap_Kd t.png\n", ["Kd of material 'a' (black under a texture)"], "a texture and a black Kd"),
    ("newmtl a\nKd nan 0 0\n", ["colour of material 'a' (NaN or infinite)"], "NaN or infinite"),
])
def test_what_an_mtl_says_in_vain_leaves_the_material_white(text, dropped, warned):
    notes = Notes()
    assert read_mtl(text.encode(), notes)["a"].factor.tolist() == [1, 1, 1, 1]
    assert notes.dropped == dropped and [warned in text for text in notes.warnings] == [True] * bool(warned)


@pytest.mark.parametrize("line", ["map_Kd -s one 1 a.png", "norm", "Ke nan 0 0"])
def test_a_statement_that_cannot_be_read_is_named_with_its_line(line):
    with pytest.raises(InputError) as caught:
        read_mtl(f"newmtl a\n{line}\n".encode(), Notes())
    assert caught.value.code == "TXF-I20" and caught.value.details == {"line": 2, "value": line}


@pytest.mark.parametrize("line", ["map_Kd", "map_Kd -s 1 1", "map_Kd "])
def test_a_map_without_a_file_is_a_loss_and_no_error(line):
    notes = Notes()
    assert not read_mtl(f"newmtl a\n{line}\n".encode(), notes)["a"].texture
    assert notes.dropped == ["map_Kd of material 'a' (no file name)"]


def test_an_unknown_option_is_named_and_the_file_is_read():
    notes = Notes()
    assert read_mtl(b"newmtl a\nmap_Kd -gloss 0.5 my tex.png\n", notes)["a"].texture == "my tex.png"
    assert notes.dropped == ["map_Kd option -gloss of material 'a'"]


def test_indents_groups_and_objects_without_a_name_change_nothing(loaded):
    scene = loaded("o\ng left\ns 1\n  v 0 0 0\nv 1 0 0\n v 1 1 0\nf 1 2 3\n", "a.obj", strict=True)
    assert scene.positions.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]] and scene.faces.tolist() == [[0, 1, 2]]
    assert scene.dropped == scene.warnings == [] and "objects" not in scene.metadata


def test_faces_before_the_broken_one_and_faces_of_nothing_are_told_apart(refused):
    error = refused("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nf 1/1 2 3\n", "a.obj")
    assert error.code == "TXF-I20" and error.details == {"line": 5, "value": "f 1/1 2 3"}
    error = refused("f 1 2 3\n", "a.obj")
    assert error.code == "TXF-I13" and error.details["vertices"] == 0


def test_a_lone_sign_that_takes_the_number_of_the_next_face_is_refused_without_a_line(refused):
    error = refused("v 0 0 0\nv 1 0 0\nv 1 1 0\nf +\nf 1 2 3\n", "a.obj")
    assert (error.code, error.message) == ("TXF-I20", "an OBJ face cannot be read") and error.details == {}


def test_obj_tolerates_line_ends_continuations_and_missing_files(loaded, refused):
    text = "mtllib none.mtl\r\nusemtl a\r\nv 0 0 0\r\nv 1 0 0\r\nv 1 \\\r\n 1 0\r\nf 1/ 2/ \\\r\n 3/\r\n"
    scene = loaded(text, "a.obj")
    assert scene.faces.tolist() == [[0, 1, 2]] and scene.positions[2].tolist() == [1, 1, 0]
    assert "none.mtl" in scene.warnings[0] and "'a' is not defined" in scene.warnings[1]
    assert refused(text, "a.obj", strict=True).code == "TXF-I16"


def test_obj_vertex_colors_are_decoded_from_srgb(loaded):
    text = "v 0 0 0 1 0.5 0\nv 1 0 0 0 0 0\nv 1 1 0\nf 1 2 3\n"
    color = loaded(text, "a.obj").corner_color[0]
    np.testing.assert_allclose(color, [[1, 0.21404, 0, 1], [0, 0, 0, 1], [1, 1, 1, 1]], atol=1e-4)
    color = loaded(text.replace("1 0.5 0\n", "255 127.5 0\n", 1), "a.obj").corner_color[0]
    np.testing.assert_allclose(color[0], [1, 0.21404, 0, 1], atol=1e-4)


@pytest.mark.parametrize("line, code", [
    ("v 1 2", "TXF-I20"), ("v 1 2 x", "TXF-I20"), ("f 1 2 0", "TXF-I20"), ("f 1 2 y", "TXF-I20"), ("f 1 2 9", "TXF-I13"),
    ("f -1 -2 -9", "TXF-I13"), ("f 1/9 2/9 3/9", "TXF-I13"), ("f 1/1/1 2 3/3", "TXF-I20"), ("v nan 0 0\nf 4 1 2", "TXF-I14"),
    ("f 1/1/1/1 2/2/2/2 3/3/3/3", "TXF-I20"),
])
def test_broken_obj_lines_are_named(refused, line, code):
    error = refused(f"v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\n{line}\nf 1 2 3\n", "a.obj")
    assert error.code == code and (code != "TXF-I20" or error.details["line"] == 5)


# PLY.


def ply(form, uv=("s", "t"), texture="comment TextureFile tex.png\n", faces=TWO, lists="uchar int"):
    """A PLY square with colours and UVs (v upwards) in one of the three forms."""
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", *uv))
    head = (f"ply\nformat {form} 1.0\n{texture}comment made here\nelement vertex 4\n{names}property uchar red\n"
            f"property uchar green\nproperty uchar blue\nproperty float quality\nelement face {len(faces)}\n"
            f"property list {lists} vertex_indices\nend_header\n")
    color = [[255, 188, 0]] * 4
    if form == "ascii":
        rows = [[*p, *([u, 1 - v] if uv else []), *c, 0.5] for p, (u, v), c in zip(SQUARE, SQUARE_UV, color, strict=True)]
        lines = [" ".join(str(x) for x in row) for row in rows] + [" ".join(map(str, (len(f), *f))) for f in faces]
        return (head + "\n".join(lines) + "\n").encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{order}{3 + len(uv)}f3Bf", *p, *([u, 1 - v] if uv else []), *c, 0.5)
                    for p, (u, v), c in zip(SQUARE, SQUARE_UV, color, strict=True))
    return head.encode() + body + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")


def test_ply_in_capitals_is_read(loaded):
    text = ("PLY\r\nformat ascii 1.0\r\nelement vertex 3\r\nproperty float x\r\nproperty float y\r\nproperty float z\r\n"
            "element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n0 0 0\r\n1 0 0\r\n0 1 0\r\n3 0 1 2\r\n")
    assert loaded(text, "a.ply").faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("uv", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_ply_with_colors_and_texture(tmp_path, loaded, form, uv):
    (tmp_path / "tex.png").write_bytes(encoded(RED_BLUE))
    scene = loaded(ply(form, uv), "a.ply", strict=True)
    np.testing.assert_array_equal(scene.positions[scene.faces], SQUARE[TWO])
    np.testing.assert_allclose(scene.corner_uv, SQUARE_UV[TWO], atol=1e-6)
    np.testing.assert_allclose(scene.corner_color[0, 0], [1, 0.5029, 0, 1], atol=1e-4)
    assert scene.materials[0].texture == 0 and scene.dropped == []
    assert scene.remarks == ["PLY property 'quality' of vertex is left out"]
    assert scene.metadata == {"comments": ["made here"]}


@pytest.mark.parametrize("form", FORMS)
def test_ply_polygons_of_mixed_size_and_no_texture(loaded, form):
    scene = loaded(ply(form, texture="", faces=[[0, 1, 2], [0, 1, 2, 3]]), "a.ply")
    assert scene.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
    assert scene.remarks[0].startswith("texture coordinates") and scene.dropped == [] and not scene.corner_uv.any()


def test_ply_texture_coordinates_and_colors_per_face(tmp_path, loaded):
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(encoded(RED_BLUE))
    text = ("ply\r\nformat ascii 1.0\r\ncomment TextureFile a.png\r\ncomment TextureFile b.png\r\nelement vertex 3\r\n"
            "property float x\r\nproperty float y\r\nproperty float z\r\nelement face 2\r\n"
            "property list uchar int vertex_index\r\nproperty list uchar float texcoord\r\nproperty int texnumber\r\n"
            "property uchar red\r\nproperty uchar green\r\nproperty uchar blue\r\nproperty uchar alpha\r\nend_header\r\n"
            "0 0 0\r\n1 0 0\r\n1 1 0\r\n3 0 1 2 6 0 0 1 0 1 1 0 255 0 0 51\r\n3 0 2 1 6 0 1 1 1 1 .25 1 0 255 0 255\r\n")
    scene = loaded(text, "a.ply")
    assert scene.corner_uv.tolist() == [[[0, 1], [1, 1], [1, 0]], [[0, 0], [1, 0], [1, 0.75]]]
    assert scene.face_material.tolist() == [0, 1] and [texture.name for texture in scene.textures] == ["a.png", "b.png"]
    np.testing.assert_allclose(scene.corner_color[:, 2], [[1, 0, 0, 0.2], [0, 1, 0, 1]], atol=1e-6)


def test_ply_elements_that_are_not_read_are_named_and_headers_may_have_blanks(loaded):
    elements = "".join(f"element {name} {rows}\nproperty int a\n" for name, rows in (("edge", 1), ("camera", 1), ("empty", 0)))
    head = ply("ascii", (), "").replace(b"ascii 1.0\n", f"ascii 1.0\n\ncomment\n{elements}".encode())
    scene = loaded(head.replace(b"end_header\n", b"end_header\n7\n8\n"), "a.ply")
    assert scene.faces.tolist() == [[0, 1, 2], [0, 2, 3]] and scene.metadata == {"comments": ["made here"]}
    assert scene.dropped == ["PLY element 'edge' (1 row)"]
    assert scene.remarks == ["PLY element 'camera' is left out", "PLY property 'quality' of vertex is left out"]


def test_ply_without_faces_has_no_triangles(refused):
    error = refused(ply("ascii").replace(b"vertex_indices", b"edges"), "a.ply")
    assert (error.code, error.message) == ("TXF-I15", "the input has no triangles: it has 4 points without faces, "
                                                      "2 rows of 'face'")


def test_ply_texture_without_coordinates_is_a_warning(tmp_path, loaded):
    (tmp_path / "tex.png").write_bytes(encoded(RED_BLUE))
    scene = loaded(ply("ascii", ()), "a.ply")
    assert scene.warnings == ["the file names a texture but has no texture coordinates; UV (0, 0) is used"]
    assert scene.materials[0].texture == 0 and not scene.corner_uv.any()


@pytest.mark.parametrize("red, green, share", [("1.0", "0.5", 1), ("255", "127.5", 1), ("0.5", "0.25", 0.21404)])
def test_ply_colours_that_are_floats_reach_to_1_or_to_255(loaded, red, green, share):
    text = ply("ascii", (), "").replace(b"uchar red", b"float red").replace(b"uchar green", b"float green")
    color = loaded(text.replace(b" 255 188 0 ", f" {red} {green} 0 ".encode()), "a.ply").corner_color[0, 0]
    np.testing.assert_allclose(color[0], share, atol=1e-4)
    assert 0.04 < color[1] < color[0] / 3 and color[2] == 0


def test_a_negative_length_in_a_binary_ply_is_named(refused):
    data = ply("binary_little_endian", lists="char int")
    at = data.index(b"end_header\n") + 11 + 4 * (5 * 4 + 3 + 4)
    assert data[at] == 3
    error = refused(data[:at] + b"\xff" + data[at + 1 :], "a.ply")
    assert error.code == "TXF-I21" and "a list has a negative length" in error.message


@pytest.mark.parametrize("form", FORMS)
def test_every_prefix_of_a_ply_is_refused_or_read(tmp_path, form):
    data = ply(form)
    found = [outcome(tmp_path / "a.ply", data[:length]) for length in range(len(data) - 2)]
    assert {error.code for error in found} <= {"TXF-I04", "TXF-I06", "TXF-I21", "TXF-I13", "TXF-I15"}


@pytest.mark.parametrize("old, new, code", [
    (b"vertex 4", b"vertex 4000000000000", "TXF-I21"), (b"vertex 4", b"vertex -4", "TXF-I21"),
    (b"float x", b"quad x", "TXF-I21"), (b"float x", b"float w", "TXF-I21"), (b"ascii", b"ebcdic", "TXF-I21"),
    (b"3 0 1 2", b"3 0 1 9", "TXF-I13"), (b"3 0 1 2", b"3 0 1 -2", "TXF-I13"), (b"3 0 1 2", b"3 0 1 nan", "TXF-I13"),
    (b"3 0 1 2", b"-3 0 1 2", "TXF-I21"), (b"3 0 1 2", b"3 0 1 two", "TXF-I21"),
    (b"element face 2\n", b"element nothing 999999999999\nelement face 2\n", "TXF-I21"),
])
def test_broken_ply_files_end_in_their_code(refused, old, new, code):
    data = ply("ascii")
    assert old in data
    assert refused(data.replace(old, new), "a.ply").code == code
