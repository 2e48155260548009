"""STL and OFF: both forms, their colours, what is left behind, and files that end early."""


import numpy as np
import pytest
from format_files import FACETS, stl, stl_text
from mesh_files import load_bytes, refusal

from texfcodec.io import stl as stl_file

SRGB_HALF = 0.2140


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("count", [1, 2, 1000])
def test_welding_keeps_distinct_rows_in_order_of_first_use_whatever_their_hashes(monkeypatch, count, kind):
    rows = np.random.default_rng(count).integers(-2, 3, (count, 3)).astype(kind) * kind(0.1)
    rows[::2] *= -1  # some zeros have a sign
    known = {}
    number = [known.setdefault(tuple(row + 0.0), len(known)) for row in rows]
    for hashes in (stl_file._hashes, lambda bits: np.zeros(len(bits), np.uint64), lambda bits: bits[:, 0].astype(np.uint64)):
        monkeypatch.setattr(stl_file, "_hashes", hashes)
        points, of = stl_file.weld(rows)
        np.testing.assert_array_equal(points, np.array(list(known), np.float64))
        np.testing.assert_array_equal(of, number)


@pytest.mark.parametrize("data", [stl(), stl(header=b"solid, but binary"), stl_text(), stl_text().upper().replace("E+", "e+"),
                                  stl_text().replace("\n", "\r\n")])
def test_stl_facets_share_their_vertices(tmp_path, data):
    scene = load_bytes(tmp_path, data, "a.stl", strict=True)
    np.testing.assert_array_equal(scene.positions[scene.faces], FACETS)
    assert len(scene.positions) == 4 and scene.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert scene.corner_color is None and scene.materials[0].texture == -1 and scene.dropped == []
    assert scene.remarks == ["normals of facets are left out: the corners give them too"]


def test_stl_without_normals_leaves_nothing_out_and_keeps_its_names(tmp_path):
    assert load_bytes(tmp_path, stl(normal=(0, 0, 0)), "a.stl").remarks == []
    scene = load_bytes(tmp_path, stl_text(normal="0 0 0") + stl_text(FACETS + 5, "other", "0 0 0"), "a.stl")
    assert scene.metadata == {"solids": ["a part", "other"]} and len(scene.faces) == 4 and scene.dropped == []


def test_minus_zero_is_the_same_place(tmp_path):
    facets = FACETS.copy()
    facets[1][0] = [-0.0, -0.0, 0.0]
    assert len(load_bytes(tmp_path, stl(facets), "a.stl").positions) == 4


def test_stl_colours_of_both_dialects(tmp_path):
    red, blue = 31 << 10, 31
    color = load_bytes(tmp_path, stl(attributes=(red | 1 << 15, 0)), "a.stl").corner_color
    assert color[0].tolist() == [[1, 0, 0, 1]] * 3 and color[1].tolist() == [[1, 1, 1, 1]] * 3
    header = b"a COLOR=" + bytes([188, 0, 0, 51]) + b" MATERIAL=" + bytes(12)
    scene = load_bytes(tmp_path, stl(attributes=(blue, 1 << 15), header=header), "a.stl")
    np.testing.assert_allclose(scene.corner_color[:, 0], [[1, 0, 0, 1], [0.5029, 0, 0, 0.2]], atol=1e-4)
    assert "MATERIAL of the STL header" in scene.dropped
    scene = load_bytes(tmp_path, stl(attributes=(7, 0)), "a.stl")
    assert scene.corner_color is None and "attribute bytes of facets" in scene.dropped


@pytest.mark.parametrize("data, code", [
    (stl(count=0)[:84], "TXF-I15"), (stl(count=3), "TXF-I23"), (stl(count=(1 << 32) - 1), "TXF-I23"), (stl()[:50], "TXF-I23"),
    (stl_text()[:-20], "TXF-I23"), (stl_text().replace("vertex 1", "vertex one"), "TXF-I23"), ("solid\nendsolid\n", "TXF-I15"),
    (stl_text().replace("   vertex 1.0 1.0 0.0\n", "", 1), "TXF-I23"), (stl(FACETS * np.nan), "TXF-I14"),
])
def test_broken_stl_files_end_in_their_code(tmp_path, data, code):
    assert refusal(tmp_path, data, "a.stl").code == code


def test_every_prefix_of_an_stl_is_refused(tmp_path):
    for data, spare in ((stl(), 0), (stl_text().encode(), len("solid a part\n") + 1)):
        codes = {refusal(tmp_path, data[:length], "a.stl").code for length in range(1, len(data) - spare)}
        assert codes <= {"TXF-I23", "TXF-I15"}


POINTS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
COLOURS = "0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n1 1 0 0 0 255 255\n0 1 0 188 0 0 51\n"


@pytest.mark.parametrize("text", [
    f"OFF\n4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n", f"OFF 4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n", f"4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n",
    f"# made here\noff\n\n4 1 # no edges\n{POINTS}4 0 1 2 3\n", f"OFF\r\n4 1 0\r\n{POINTS}4 0 1 2 3\r\n",
])
def test_off_in_its_spellings(tmp_path, text):
    scene = load_bytes(tmp_path, text, "a.off", strict=True)
    np.testing.assert_array_equal(scene.positions[scene.faces], FACETS)
    assert scene.dropped == [] and scene.corner_color is None and scene.warnings == []


def test_off_colours_of_vertices_and_faces(tmp_path):
    color = load_bytes(tmp_path, f"COFF\n4 1 0\n{COLOURS}4 0 1 2 3\n", "a.off").corner_color
    np.testing.assert_allclose(color[1], [[1, 0, 0, 1], [0, 0, 1, 1], [0.5029, 0, 0, 0.2]], atol=1e-4)
    fractions = COLOURS.replace("255", "1.0").replace("188", "0.5").replace("51", "0.25")
    color = load_bytes(tmp_path, f"COFF\n4 1 0\n{fractions}4 0 1 2 3\n", "a.off").corner_color
    np.testing.assert_allclose(color[1, 2], [SRGB_HALF, 0, 0, 0.25], atol=1e-4)
    color = load_bytes(tmp_path, f"OFF\n4 2 0\n{POINTS}3 0 1 2 255 0 0\n3 0 2 3\n", "a.off").corner_color
    assert color[:, 1].tolist() == [[1, 0, 0, 1], [1, 1, 1, 1]]
    color = load_bytes(tmp_path, f"OFF\n4 2 0\n{POINTS}3 0 1 2 0.5 0 1 0.25\n3 0 2 3 1 1 1 1\n", "a.off").corner_color
    np.testing.assert_allclose(color[:, 1], [[SRGB_HALF, 0, 1, 0.25], [1, 1, 1, 1]], atol=1e-4)


def test_off_names_what_it_leaves_behind(tmp_path):
    rows = "".join(f"{line} 0 0 1 255 0 0 51 0.5 0.5\n" for line in POINTS.splitlines())
    scene = load_bytes(tmp_path, f"STCNOFF\n4 2 0\n{rows}3 0 1 2 7\n3 0 2 3 1 0 0\n", "a.off")
    assert scene.dropped == ["indices into a colour map", "face colours (the vertices have colours too)",
                             "alpha of the colours (the format does not define transparency)"]
    assert scene.remarks == ["texture coordinates are left out: an OFF file has no texture"]
    assert scene.corner_color[0, 0, :3].tolist() == [1, 0, 0] and (scene.corner_normal == [0, 0, 1]).all()
    scene = load_bytes(tmp_path, f"OFF\n4 1 0\n{POINTS.replace(chr(10), ' 9' + chr(10))}3 0 1 2\n", "a.off")
    assert scene.remarks == ["1 numbers after the position of each vertex are left out",
                             "1 vertex that no face uses is left out"] and scene.dropped == []


def test_off_polygons_are_cut_in_their_plane(tmp_path):
    scene = load_bytes(tmp_path, "OFF\n5 1 0\n0 0 0\n4 0 0\n4 4 0\n2 1 0\n0 4 0\n5 0 1 2 3 4\n", "a.off")
    a, b, c = (scene.positions[scene.faces[:, k]] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert (areas > 0).all() and areas.sum() == pytest.approx(10)


@pytest.mark.parametrize("text, code", [
    ("OFF\n", "TXF-I23"), ("OFF\n4\n", "TXF-I23"), (f"OFF\n4 3 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
    (f"OFF\n4000000000000 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"), (f"OFF\n-4 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
    (f"OFF\nnan 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}3 0 1\n", "TXF-I23"),
    (f"OFF\n4 1 0\n{POINTS}-3 0 1 2\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}3 0 1 9\n", "TXF-I13"),
    (f"OFF\n4 1 0\n{POINTS}3 0 1 nan\n", "TXF-I13"), (f"OFF\n4 1 0\n{POINTS}3 0 1 two\n", "TXF-I23"),
    (f"OFF\n4 1 0\n{POINTS.replace('1 1 0', '1 1')}3 0 1 2\n", "TXF-I23"), (f"4OFF\n4 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
    ("OFF BINARY\n\0\0\0\x04", "TXF-I23"), ("OFF\n0 0 0\n", "TXF-I15"), (f"COFF\n4 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
    (f"OFF\n4 1 0\n{POINTS}3000000000000 0 1 2\n", "TXF-I23"),
])
def test_broken_off_files_end_in_their_code(tmp_path, text, code):
    assert refusal(tmp_path, text, "a.off").code == code
