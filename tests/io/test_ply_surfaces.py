"""PLY's other surfaces and layouts: triangle strips, range grids, colours of corners, textures by number; and what is named."""

import struct

import numpy as np
import pytest
from format_files import FACES, XYZ, ascii_ply
from mesh_files import RED_BLUE, SQUARE, encoded, facing, load_bytes, refusal

from texfcodec.io.ply_strips import strip_triangles


def naive_strip(indices):
    """The triangles of a strip one by one."""
    faces, run = [], []
    for index in indices:
        if index < 0:
            run = []
            continue
        run.append(index)
        if len(run) >= 3:
            a, b, c = run[-3:] if len(run) % 2 else (run[-2], run[-3], run[-1])
            faces += [[a, b, c]] * (len({a, b, c}) == 3)
    return faces


def test_strips_are_those_of_the_naive_reading():
    rng = np.random.default_rng(1)
    for _ in range(200):
        rows = [rng.integers(-2, 6, rng.integers(0, 12)).clip(-1) for _ in range(rng.integers(1, 4))]
        values, lengths = np.concatenate([np.zeros(0, np.int64), *rows]), np.array([len(row) for row in rows])
        expected = [face for row in rows for face in naive_strip(row.tolist())]
        assert strip_triangles(values.astype(np.int32), lengths[lengths > 0]).tolist() == expected


@pytest.mark.parametrize("kind, letter, restart", [("int", "i", -1), ("uint", "I", 0xFFFFFFFF), ("short", "h", -1),
                                                   ("float", "f", -1)])
def test_a_binary_strip_faces_one_way_across_its_restarts(tmp_path, kind, letter, restart):
    strip = [0, 1, 3, 2, restart, 3, 1, 2]
    head = (f"ply\nformat binary_big_endian 1.0\nelement vertex 4\n{XYZ}element tristrips 1\n"
            f"property list int {kind} vertex_index\nend_header\n")
    data = head.encode() + SQUARE.astype(">f4").tobytes() + struct.pack(f">i8{letter}", 8, *strip)
    scene = load_bytes(tmp_path, data, "a.ply", strict=True)
    assert scene.faces.tolist() == [[0, 1, 3], [3, 1, 2], [3, 1, 2]] and scene.remarks == []


def test_colours_of_faces_are_a_loss_beside_those_of_vertices(tmp_path):
    red = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    points = [" ".join(map(str, point)) + " 255 0 0" for point in SQUARE.tolist()]
    scene = load_bytes(tmp_path, ascii_ply(FACES + red, "4 0 1 2 3 0 0 255", points, red), "a.ply")
    assert scene.dropped == ["colours of faces (the vertices have colours too)"]
    assert scene.corner_color[..., :3].reshape(-1, 3).tolist() == [[1, 0, 0]] * 6


def test_faces_and_strips_of_one_file_are_both_read(tmp_path):
    text = ascii_ply("element face 1\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
                     "property uchar blue\nelement tristrips 1\nproperty list int int vertex_indices\n",
                     "3 0 1 2 255 0 0\n3 0 2 3")
    scene = load_bytes(tmp_path, text, "a.ply", strict=True)
    assert scene.positions[scene.faces].tolist() == SQUARE[[[0, 1, 2], [0, 2, 3]]].tolist()
    assert scene.corner_color[:, 0, :3].tolist() == [[1, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("depth, jumps, says", [(-400, 6, ["6 triangles across jumps in depth left out"]), (0.2, 0, [])])
def test_a_range_grid_becomes_triangles_that_face_the_scanner(tmp_path, depth, jumps, says):
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    points = np.stack([x, y, 0.1 * x], axis=-1).reshape(-1, 3)
    points[7, 2] = depth  # of the far wall
    rows = [f"1 {number}" if number != 19 else "0" for number in range(20)]
    text = ascii_ply("element range_grid 20\nproperty list uchar int vertex_indices\n", "\n".join(rows), points,
                     head="obj_info num_cols 5\nobj_info num_rows 4\n")
    scene = load_bytes(tmp_path, text, "a.ply", strict=True)
    assert (facing(scene)[:, 2] > 0).all() and scene.positions[:, 2].min() == 0
    assert len(scene.faces) == 23 - jumps and scene.remarks[:-1] == says  # the last is of vertices without faces


def test_a_range_grid_without_its_size_is_named(tmp_path):
    text = ascii_ply("element range_grid 4\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list int int "
                     "vertex_indices\n", "1 0\n1 1\n1 2\n1 3\n3 0 1 2")
    assert load_bytes(tmp_path, text, "a.ply").dropped == ["range grid (of unknown size)"]


def test_colours_of_corners_and_faces_without_an_image(tmp_path):
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(encoded(RED_BLUE))
    text = ascii_ply("element face 3\nproperty list uchar int vertex_index\nproperty list uchar float texcoord\n"
                     "property int texnumber\nproperty list uchar float color\n",
                     "\n".join(f"3 0 1 2 6 0 0 1 0 1 1 {number} 9 1 0 0 0 1 0 0 0 1" for number in (1, -1, 0)),
                     head="comment TextureFile a.png\ncomment TextureFile b.png\n")
    scene = load_bytes(tmp_path, text, "a.ply", strict=True)
    assert scene.face_material.tolist() == [1, 2, 0] and scene.materials[2].texture == -1
    assert scene.corner_color[0, :, :3].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize("names", ["red green blue", "Red Green Blue", "r g b", "diffuse_red diffuse_green diffuse_blue",
                                   "color_r color_g color_b", "vertex_red vertex_green vertex_blue", "c.red c.green c.blue"])
def test_colours_are_found_by_any_names_that_say_it(tmp_path, names):
    more = "".join(f"property float {name}\n" for name in names.split())
    text = ascii_ply(FACES, "4 0 1 2 3",
                     [" ".join(map(str, point)) + " 1 0 1" for point in SQUARE.tolist()], more)
    assert load_bytes(tmp_path, text, "a.ply", strict=True).corner_color[0, 0].tolist() == [1, 0, 1, 1]


@pytest.mark.parametrize("property_, row, lost", [
    ("property float ambient_red\nproperty float ambient_green\nproperty float ambient_blue\n", " 1 0 0",
     ["PLY property 'ambient_red' of vertex", "PLY property 'ambient_green' of vertex", "PLY property 'ambient_blue' of vertex"]),
    ("property float rgb\n", " 1", ["PLY property 'rgb' of vertex"]),
    ("property float red\n", " 1", ["PLY property 'red' of vertex"]), ("property float confidence\n", " 1", []),
    ("property float Quality\nproperty int scalar_Depth\n", " 1 2", []),
])
def test_a_property_that_could_show_is_a_loss_and_a_measurement_is_not(tmp_path, property_, row, lost):
    text = ascii_ply(FACES, "4 0 1 2 3",
                     [" ".join(map(str, point)) + row for point in SQUARE.tolist()], property_)
    scene = load_bytes(tmp_path, text, "a.ply")
    assert scene.dropped == lost and len(scene.remarks) == (0 if lost else row.count(" "))


def test_numbers_of_textures_that_are_not_there_and_odd_lists_are_losses(tmp_path):
    (tmp_path / "a.png").write_bytes(encoded(RED_BLUE))
    text = ascii_ply("element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int "
                     "texnumber\n", "4 0 1 2 3 6 0 0 1 0 1 1 7", head="comment TextureFile a.png\n")
    assert load_bytes(tmp_path, text, "a.ply").dropped == [
        "texture coordinates of face corners (PLY property 'texcoord')", "textures of faces (numbers beyond the TextureFiles)",
        "texture 'a.png' (no texture coordinates)"]


@pytest.mark.parametrize("more, elements, rows, says", [
    ("", "", "", "it has 4 points without faces"),
    ("property float f_dc_0\nproperty float rot_0\nproperty float scale_0\n", "", "", "it has 4 Gaussian splats"),
    ("", "element edge 1\nproperty int vertex1\nproperty int vertex2\n", "0 1",
     "it has 4 points without faces, 1 rows of 'edge'"),
])
def test_a_ply_without_triangles_says_what_it_has(tmp_path, more, elements, rows, says):
    points = [" ".join(map(str, point)) + " 0" * more.count("property") for point in SQUARE.tolist()]
    error = refusal(tmp_path, ascii_ply(elements, rows, points, more), "a.ply")
    assert error.code == "TXF-I15" and error.message.endswith(says)
