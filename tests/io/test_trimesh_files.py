"""STL, OFF and 3MF by trimesh: what is read, what is named as left out, and files that end early, lie or nest."""

import zipfile

import numpy as np
import pytest
from damage import with_a_bit_flipped
from format_files import FACETS, stl, stl_text
from mesh_files import SQUARE, TWO, facing, load_bytes, outcome, refusal
from threemf_files import mesh, model, package

from texfcodec.errors import LimitError, SupportError, TexfError

POINTS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
COLOURS = "0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n1 1 0 0 0 255 255\n0 1 0 188 0 0 51\n"
QUAD = SQUARE[[[0, 1, 2], [2, 3, 0]]]
UPRIGHT = 0.0254 * SQUARE[:, [0, 2, 1]].astype(np.float64) * [1, 1, -1]  # from inches with Z up
MINUS_ZERO = np.where(FACETS == 0, -FACETS, FACETS)
MINUS_ZERO[0] = FACETS[0]
TWO_SOLIDS = stl_text() + stl_text(FACETS + 5, "other", "0 0 0")
GROUP = ('<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
         '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/></components></object>')
PLACED = package(model(mesh() + GROUP, '<item objectid="2" transform="0 2 0 -2 0 0 0 0 2 0 0 5"/>'))
INSIDE = '<object id="7"><components><component objectid="1" p:path="/3D/a.model"/></components></object>'
COLOURED = model('<m:colorgroup id="4"><m:color color="#00FF00FF"/></m:colorgroup><basematerials id="3"><base name="red" '
                 'displaycolor="#FF0000"/></basematerials>' + mesh('pid="4" p1="0"', 'pid="3" p1="0"'))
SUPPORT = model(mesh() + mesh(key="2").replace('type="model"', 'type="support" name="pillar"'),
                '<item objectid="1"/><item objectid="2"/>')


@pytest.mark.parametrize("name, data, corners, dropped", [
    ("a.stl", stl(), FACETS, []), ("a.stl", stl(header=b"solid, but binary"), FACETS, []), ("a.stl", stl_text(), FACETS, []),
    ("a.stl", stl_text().upper().replace("E+", "e+"), FACETS, []), ("a.stl", stl_text().replace("\n", "\r\n"), FACETS, []),
    ("a.stl", stl_text().replace("\n", "\r"), FACETS, []), ("a.stl", stl() + b"more", FACETS, []),
    ("a.stl", stl(MINUS_ZERO), FACETS, []), ("a.stl", stl(FACETS * np.float32(1e-9)), FACETS * np.float32(1e-9), []),
    ("a.stl", stl_text(name="größe").encode("latin-1"), FACETS, []),
    ("a.off", f"OFF # größe\n4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n".encode("latin-1"), FACETS, []),
    ("a.stl", TWO_SOLIDS, np.concatenate([FACETS, FACETS + 5]), []),
    ("a.stl", stl(attributes=(7, 0)), FACETS, ["attribute bytes of facets"]),
    ("a.off", f"OFF\n4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n", FACETS, []), ("a.off", f"OFF 4 1 0\n{POINTS}4 0 1 2 3\n", QUAD, []),
    ("a.off", f"4 2 0\n{POINTS}3 0 1 2\n3 0 2 3\n", FACETS, []), ("a.off", f"off\r\n4 1 0\r\n{POINTS}4 0 1 2 3\r\n", QUAD, []),
    ("a.off", f"# made here\noff\n\n4 1 # no edges\n{POINTS}4 0 1 2 3\n", QUAD, []),
    ("a.off", f"COFF\n4 1 0\n{COLOURS}4 0 1 2 3\n", QUAD, ["colours of vertices"]),
    ("a.off", f"OFF\n4 2 0\n{POINTS}3 0 1 2 255 0 0\n3 0 2 3\n", FACETS, ["colours of faces"]),
    ("a.off", f"OFF\n4 3 0\n{POINTS}2 0 1\n3 0 1 2\n3 0 2 3\n", FACETS, ["1 face with fewer than three corners"]),
    ("a.off", "STCNOFF\n4 1 0\n" + "".join(f"{line} 0 0 1 255 0 0 1 0 0\n" for line in POINTS.splitlines()) + "4 0 1 2 3\n",
     QUAD, ["colours of vertices"]),
    ("a.off", f"OFF\n4 1 0\n{POINTS.replace(chr(10), ' 9' + chr(10))}4 0 1 2 3\n", QUAD,
     ["numbers after the positions of vertices"]),
    ("a.off", "OFF\n5 1 0\n0 0 0\n2 0 0\n2 1 0\n1 2 0\n0 1 0\n5 0 1 2 3 4\n",
     np.array([[0, 0], [2, 0], [2, 1], [1, 2], [0, 1]])[[[0, 1, 2], [0, 2, 3], [0, 3, 4]]] @ np.eye(2, 3),
     ["the outline of concave polygons, cut as if they were convex"]),
    ("a.3mf", package(model(mesh())), UPRIGHT[TWO], []),
    ("a.3mf", package(model(mesh(), head='<metadata name="Title">Vase</metadata>')), UPRIGHT[TWO], []),
    ("a.3mf", package(COLOURED), UPRIGHT[TWO], ["3MF element 'color'", "3MF element 'colorgroup'", "3MF element 'base'",
                                                "3MF element 'basematerials'"]),
    ("a.3mf", package(SUPPORT), UPRIGHT[[*TWO, *TWO]], ["the type support of object 'pillar'"]),
])
def test_corners_are_read_and_what_is_left_out_is_named(tmp_path, name, data, corners, dropped):
    scene = load_bytes(tmp_path, data, name)
    np.testing.assert_allclose(scene.positions[scene.faces], corners, rtol=0, atol=1e-12)
    assert name != "a.stl" or len(np.unique(scene.positions, axis=0)) == len(scene.positions)
    assert scene.corner_color is None
    assert scene.dropped == dropped and sum("left out" in remark for remark in scene.remarks) == 1


@pytest.mark.parametrize("name, data, metadata", [
    ("a.stl", stl(), {}), ("a.stl", stl_text(name=""), {}), ("a.stl", TWO_SOLIDS, {"solids": ["a part", "other"]}),
    ("a.off", f"OFF\n4 1 0\n{POINTS}3 0 1 2\n", {}),
    ("a.3mf", package(model(mesh())), {"source_unit": "inch", "meshes": ["1"]}),
])
def test_names_and_units_are_kept(tmp_path, name, data, metadata):
    assert load_bytes(tmp_path, data, name).metadata == metadata


@pytest.mark.parametrize("attributes, header, colours, dropped", [
    ((31 << 10 | 1 << 15, 0), b"", [[1, 0, 0, 1], [1, 1, 1, 1]], []),
    ((31, 1 << 15), b"a COLOR=" + bytes([188, 0, 0, 51]), [[1, 0, 0, 1], [0.5029, 0, 0, 0.2]], []),
    ((31, 1 << 15), b"a COLOR=" + bytes([188, 0, 0, 51]) + b" MATERIAL=" + bytes(12), [[1, 0, 0, 1], [0.5029, 0, 0, 0.2]],
     ["MATERIAL of the STL header"]),
])
def test_colours_of_facets_are_read_in_both_dialects(tmp_path, attributes, header, colours, dropped):
    scene = load_bytes(tmp_path, stl(attributes=attributes, header=header), "a.stl")
    np.testing.assert_allclose(scene.corner_color, np.repeat(np.array(colours)[:, None], 3, axis=1), atol=1e-4)
    assert scene.dropped == dropped


def test_items_and_components_place_and_mirror(tmp_path):
    scene = load_bytes(tmp_path, PLACED, "a.3mf", strict=True)
    turned = np.stack([-2 * SQUARE[:, 1], 2 * (SQUARE[:, 0] + 10), SQUARE[:, 2] + 5], axis=1)
    np.testing.assert_allclose(scene.positions[:4], 0.0254 * turned[:, [0, 2, 1]] * [1, 1, -1], atol=1e-9)
    assert len(scene.faces) == 4 and (facing(scene)[:, 1] > 0).all()


@pytest.mark.parametrize("name, data, code", [
    *(("a.stl", data, code) for data, code in (
        (stl(count=0)[:84], "TXF-I15"), (stl(count=3), "TXF-I23"), (stl(count=(1 << 32) - 1), "TXF-I23"), (stl()[:50], "TXF-I23"),
        (stl_text()[:-20], "TXF-I23"), (stl_text().replace("vertex 1", "vertex one"), "TXF-I23"),
        ("solid\nendsolid\n", "TXF-I15"), (stl_text().replace("   vertex 1.0 1.0 0.0\n", "", 1), "TXF-I23"),
        (stl(FACETS * np.nan), "TXF-I14"), (stl(np.full_like(FACETS, np.inf)), "TXF-I14"),
        (stl_text().replace("1.0", "nan"), "TXF-I14"),
        (stl_text().replace("vertex 1.0 1.0", "vertex 1.0"), "TXF-I23"), ("endsolid solid", "TXF-I23"),
        (b"solid \xff\xfe" + bytes(range(256)) * 4, "TXF-I23"), (bytes(84), "TXF-I15"))),
    *(("a.off", text, code) for text, code in (
        (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 \xff\n", "TXF-I23"), ("OFF\n", "TXF-I23"),
        ("OFF\n4\n", "TXF-I23"), (f"OFF\n4 3 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
        (f"OFF\n4000000000000 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"), (f"OFF\n-4 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
        (f"OFF\nnan 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}3 0 1\n", "TXF-I23"),
        (f"OFF\n4 1 0\n{POINTS}-3 0 1 2\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}3 0 1 9\n", "TXF-I23"),
        (f"OFF\n4 1 0\n{POINTS}3 0 1 nan\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}3 0 1 two\n", "TXF-I23"),
        (f"OFF\n4 1 0\n{POINTS.replace('1 1 0', '1 1')}3 0 1 2\n", "TXF-I23"), (f"4OFF\n4 1 0\n{POINTS}3 0 1 2\n", "TXF-I23"),
        ("OFF BINARY\n\0\0\0\x04", "TXF-I23"), ("OFF\n0 0 0\n", "TXF-I15"), (f"OFF\n4 1 0\n{POINTS}2 0 1\n", "TXF-I15"),
        (f"OFF\n4 1 0\n{POINTS}3000000000000 0 1 2\n", "TXF-I23"), (f"OFF\n4 1 0\n{POINTS}{10**30} 0 1 2\n", "TXF-I23"),
        (f"OFF\n4 1 0\n{POINTS.replace('1 1 0', '1 inf 0')}3 0 1 2\n", "TXF-I14"))),
    *(("a.3mf", package(text), code) for text, code in (
        ("not XML", "TXF-I24"), ("<?xml version='1.0' encoding='nan'?><model/>", "TXF-I24"), (model(""), "TXF-I24"),
        (model(mesh(), ""), "TXF-I15"), (model(mesh(), "<item/>"), "TXF-I24"), (SUPPORT.replace("</build>", ""), "TXF-I24"),
        (model(mesh(), '<item objectid="1" transform="1 2 3"/>'), "TXF-I24"),
        (model(mesh().replace('x="1.0"', 'x="one"')), "TXF-I24"), (model(mesh().replace('v3="3"', 'v3="9"')), "TXF-I13"),
        (model(mesh().replace('v3="3"', f'v3="{10**30}"')), "TXF-I13"), (model(mesh().replace('x="1.0"', 'x="nan"')), "TXF-I14"),
        (model('<object id="1"><components><component objectid="1"/></components></object>'), "TXF-I19"),
        (model(mesh(), '<item objectid="1" p:path="/nowhere.model"/>'), "TXF-I31"), (model(INSIDE), "TXF-I31"),
        (model(mesh() + INSIDE.replace('objectid="1"', 'objectid="7"'), '<item objectid="7"/>'), "TXF-I31"))),
    ("a.3mf", package(model(mesh()), "3D/other.model"), "TXF-I24"), ("a.3mf", package(model(mesh()))[:-30], "TXF-I24"),
])
def test_broken_files_end_in_their_code(tmp_path, name, data, code):
    assert refusal(tmp_path, data, name).code == code


def test_every_prefix_of_an_stl_is_refused(tmp_path):
    for data, spare in ((stl(), 0), (stl_text().encode(), len("solid a part\n") + 1)):
        codes = {refusal(tmp_path, data[:length], "a.stl").code for length in range(1, len(data) - spare)}
        assert codes <= {"TXF-I23", "TXF-I15"}


def test_nesting_cannot_ask_for_any_number_of_objects(tmp_path):
    levels = "".join(f'<object id="{n}"><components>' + f'<component objectid="{n + 1}"/>' * 10 + "</components></object>"
                     for n in range(1, 12))
    error = refusal(tmp_path, package(model(levels + mesh(key="12"))), "a.3mf")
    assert isinstance(error, LimitError) and error.code == "TXF-I41"


def test_a_part_that_unpacks_to_too_much_is_refused_before_it_does(tmp_path, monkeypatch):
    monkeypatch.setattr("texfcodec.io.trimesh_files.MAX_PART", 10_000)
    data = package(model(mesh()) + " " * 20_000)
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("unpacked"))
    assert isinstance(refusal(tmp_path, data, "a.3mf"), LimitError)


def test_entities_cannot_grow_the_xml(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "' + "ha" * 2000 + '">' + "".join(
        f'<!ENTITY {b} "{f"&{a};" * 100}">' for a, b in zip("abcd", "bcde", strict=True)) + "]>"
    text = model(mesh(), head='<metadata name="Title">&e;</metadata>').replace("?>", "?>" + bomb, 1)
    assert refusal(tmp_path, package(text), "a.3mf").code == "TXF-I24"


def test_damaged_archives_end_in_a_scene_or_a_coded_error(tmp_path):
    data = package(model(mesh()))
    damaged = [data[:length] for length in range(1, len(data), 7)] + list(with_a_bit_flipped(data))[::3]
    ends = [outcome(tmp_path / "a.3mf", piece) for piece in damaged]
    codes = {end.code for end in ends if isinstance(end, TexfError)}
    assert "TXF-I24" in codes and codes <= {"TXF-I24", "TXF-I06", "TXF-I13", "TXF-I15", "TXF-I41"}


def test_a_3mf_without_its_packages_is_refused_by_their_names(tmp_path, monkeypatch):
    import trimesh

    def missing(*_, **__):
        raise ImportError("No module named 'lxml'")

    monkeypatch.setattr(trimesh, "load_scene", missing)
    error = refusal(tmp_path, package(model(mesh())), "a.3mf")
    assert isinstance(error, SupportError) and error.code == "TXF-I35" and "lxml" in error.message


def test_a_reader_that_prints_or_raises_anything_leaves_no_traceback(tmp_path, monkeypatch, capfd):
    import logging

    import trimesh

    def raising(*_, **__):
        logging.getLogger("trimesh").warning("a traceback", exc_info=True)
        raise SyntaxError("of another kind")

    monkeypatch.setattr(trimesh, "load_scene", raising)
    assert refusal(tmp_path, stl(), "a.stl").code == "TXF-I23" and "traceback" not in capfd.readouterr().err
