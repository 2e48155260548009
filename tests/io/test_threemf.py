"""3MF: placement, textures, colours, base materials, print data that is named, and archives that lie."""

import zipfile

import numpy as np
import pytest
from damage import with_a_bit_flipped
from mesh_files import RED_BLUE, SQUARE, TWO, encoded, load_bytes, refusal
from threemf_files import mesh, model, package

from texfcodec.errors import LimitError, TexfError
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_MIRROR

UPRIGHT = 0.0254 * SQUARE[:, [0, 2, 1]] * [1, 1, -1]  # from inches with Z up


@pytest.mark.parametrize("start", ["3D/3dmodel.model", "3D/other.model"])
def test_a_plain_object_stands_upright_and_in_metres(tmp_path, start):
    scene = load_bytes(tmp_path, package(model(mesh()), start), "a.3mf", strict=True)
    np.testing.assert_allclose(scene.positions[scene.faces], UPRIGHT[TWO], atol=1e-9)
    assert scene.metadata == {"source_unit": "inch"} and scene.warnings == [] and scene.dropped == []
    assert scene.corner_color is None and scene.materials[0].name == "default"


def test_items_and_components_place_and_mirror(tmp_path):
    group = ('<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
             '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/></components></object>')
    data = package(model(mesh() + group, '<item objectid="2" transform="0 2 0 -2 0 0 0 0 2 0 0 5"/>'))
    scene = load_bytes(tmp_path, data, "a.3mf", strict=True)
    turned = np.stack([-2 * SQUARE[:, 1], 2 * (SQUARE[:, 0] + 10), SQUARE[:, 2] + 5], axis=1)
    np.testing.assert_allclose(scene.positions[:4], 0.0254 * turned[:, [0, 2, 1]] * [1, 1, -1], atol=1e-9)
    normals = np.cross(*(scene.positions[scene.faces[:, k]] - scene.positions[scene.faces[:, 0]] for k in (1, 2)))
    assert len(scene.faces) == 4 and (normals[:, 1] > 0).all()


def test_objects_in_other_parts_are_found(tmp_path):
    link = '<object id="7"><components><component objectid="1" p:path="/3D/parts/a.model"/></components></object>'
    data = package(model(link, '<item objectid="7"/>'), **{"3D_slash_parts_slash_a_dot_model": model(mesh(), "")})
    assert len(load_bytes(tmp_path, data, "a.3mf", strict=True).faces) == 2


def test_textures_with_their_tile_styles(tmp_path):
    resources = ('<m:texture2d id="5" path="/3D/Textures/t.png" contenttype="image/png" tilestyleu="mirror" tilestylev="clamp" '
                 'filter="nearest"/>'
                 '<m:texture2dgroup id="6" texid="5"><m:tex2coord u="0" v="0"/><m:tex2coord u="1" v="0"/>'
                 '<m:tex2coord u="1" v="0.75"/></m:texture2dgroup>')
    data = package(model(resources + mesh('pid="6" p1="0" p2="1" p3="2"', 'pid="6" p1="1"')),
                   **{"3D_slash_Textures_slash_t_dot_png": encoded(RED_BLUE)})
    scene = load_bytes(tmp_path, data, "a.3mf", strict=True)
    assert scene.corner_uv.tolist() == [[[0, 1], [1, 1], [1, 0.25]], [[1, 1]] * 3]
    assert scene.textures[0].wrap == (WRAP_MIRROR, WRAP_CLAMP) and scene.textures[0].image[0, 1].tolist() == [0, 0, 255, 255]
    assert scene.dropped == [] and scene.textures[0].nearest
    assert [material.name for material in scene.materials] == ["t.png"]
    missing = package(model(resources + mesh('pid="6" p1="0"', 'pid="6" p1="1"')))
    assert "TXF-I16" in load_bytes(tmp_path, missing, "a.3mf").warnings[0]
    assert refusal(tmp_path, missing, "a.3mf", strict=True).code == "TXF-I16"


def test_colours_at_corners_and_base_materials(tmp_path):
    resources = ('<basematerials id="3"><base name="red" displaycolor="#FF0000"/><base name="glass" displaycolor="#BC000033"/>'
                 '</basematerials><m:colorgroup id="4"><m:color color="#00FF00FF"/><m:color color="#0000FF80"/></m:colorgroup>')
    body = mesh('pid="4" p1="0" p2="1" p3="0"', "", "1", 'pid="3" pindex="1"')
    scene = load_bytes(tmp_path, package(model(resources + body)), "a.3mf", strict=True)
    np.testing.assert_allclose(scene.corner_color[0], [[0, 1, 0, 1], [0, 0, 1, 128 / 255], [0, 1, 0, 1]], atol=1e-6)
    assert (scene.corner_color[1] == 1).all()
    glass = scene.materials[scene.face_material[1]]
    assert glass.name == "glass" and glass.alpha_mode == ALPHA_BLEND
    np.testing.assert_allclose(glass.factor, [0.5029, 0, 0, 0.2], atol=1e-4)


def test_support_of_a_print_is_left_out_by_name(tmp_path):
    text = model(mesh() + mesh(key="2").replace('type="model"', 'type="support" name="pillar"'),
                 '<item objectid="1"/><item objectid="2"/>')
    scene = load_bytes(tmp_path, package(text), "a.3mf")
    assert len(scene.faces) == 2 and scene.dropped == ["object 'pillar' of the type support"]


def test_print_data_and_unknown_groups_are_named(tmp_path):
    head = '<metadata name="Title">Vase</metadata>'
    resources = '<m:compositematerials id="9" matid="3"><m:composite values="1"/></m:compositematerials>'
    data = package(model(resources + mesh('pid="9" p1="0"', ""), head=head),
                   **{"Metadata_slash_slic3r_dot_config": b"layers", "Metadata_slash_thumbnail_dot_png": b"x"})
    scene = load_bytes(tmp_path, data, "a.3mf")
    assert sorted(scene.dropped) == ["3MF element 'composite'", "3MF element 'compositematerials'",
                                     "property group '9' (missing or not supported)"]
    assert sorted(scene.remarks)[:2] == ["3MF part 'Metadata/slic3r.config' is left out",
                                     "3MF part 'Metadata/thumbnail.png' is left out"]
    assert "property group '9'" in scene.warnings[0] and scene.metadata == {"source_unit": "inch", "3mf": {"Title": "Vase"}}


@pytest.mark.parametrize("text, code", [
    ("not XML", "TXF-I24"), ("<?xml version='1.0' encoding='nan'?><model/>", "TXF-I24"), (model(""), "TXF-I24"),
    (model(mesh(), ""), "TXF-I15"), (model(mesh(), "<item/>"), "TXF-I24"),
    (model(mesh(), '<item objectid="1" transform="1 2 3"/>'), "TXF-I24"), (model(mesh('pid="8" p1="x"')), "TXF-I24"),
    (model(mesh().replace('x="1.0"', 'x="one"')), "TXF-I24"), (model(mesh().replace('v3="3"', 'v3="9"')), "TXF-I13"),
    (model(mesh().replace('v3="3"', f'v3="{10**30}"')), "TXF-I24"), (model(mesh().replace('x="1.0"', 'x="nan"')), "TXF-I14"),
    (model('<m:colorgroup id="4"><m:color color="#00FF00"/></m:colorgroup>' + mesh('pid="4" p1="1"')), "TXF-I24"),
    (model('<m:colorgroup id="4"><m:color color="green"/></m:colorgroup>' + mesh()), "TXF-I24"),
    (model('<basematerials id="4"/>' + mesh('pid="4" p1="0"')), "TXF-I24"),
    (model('<m:texture2dgroup id="4" texid="5"><m:tex2coord u="0" v="0"/></m:texture2dgroup>' + mesh('pid="4" p1="0"')),
     "TXF-I24"),
    (model('<object id="1"><components><component objectid="1"/></components></object>'), "TXF-I19"),
    (model(mesh(), '<item objectid="1" p:path="/nowhere.model"/>'), "TXF-I24"),
])
def test_bent_models_end_in_their_code(tmp_path, text, code):
    assert refusal(tmp_path, package(text), "a.3mf").code == code


def test_nesting_cannot_ask_for_any_number_of_objects(tmp_path):
    levels = "".join(f'<object id="{n}"><components>' + f'<component objectid="{n + 1}"/>' * 10 + "</components></object>"
                     for n in range(1, 12))
    error = refusal(tmp_path, package(model(levels + mesh(key="12"))), "a.3mf")
    assert isinstance(error, LimitError) and error.code == "TXF-I41"


def test_a_part_that_unpacks_to_too_much_is_refused_before_it_does(tmp_path, monkeypatch):
    monkeypatch.setattr("texfcodec.io.threemf.MAX_PART", 10_000)
    data = package(model(mesh()) + " " * 20_000)
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda self, entry: b"<a/>" if "rels" in entry.filename else pytest.fail("read"))
    assert isinstance(refusal(tmp_path, data, "a.3mf"), LimitError)


def test_entities_cannot_grow_the_xml(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "' + "ha" * 2000 + '">' + "".join(
        f'<!ENTITY {b} "{f"&{a};" * 100}">' for a, b in zip("abcd", "bcde", strict=True)) + "]>"
    text = model(mesh(), head='<metadata name="Title">&e;</metadata>').replace("?>", "?>" + bomb, 1)
    assert refusal(tmp_path, package(text), "a.3mf").code == "TXF-I24"


def test_damaged_archives_end_in_a_scene_or_a_coded_error(tmp_path):
    data, codes = package(model(mesh())), set()
    damaged = [data[:length] for length in range(1, len(data), 7)] + list(with_a_bit_flipped(data))[::3]
    for piece in damaged:
        try:
            load_bytes(tmp_path, piece, "a.3mf")
        except TexfError as error:
            codes.add(error.code)
    assert "TXF-I24" in codes and codes <= {"TXF-I24", "TXF-I06", "TXF-I13", "TXF-I15", "TXF-I41"}
