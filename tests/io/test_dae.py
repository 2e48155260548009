"""COLLADA: placement, textures and their UV set, polygons, what is left behind, and files that are no COLLADA."""

import sys

import numpy as np
import pytest
from damage import with_a_bit_flipped
from format_files import TRIANGLES, UV, dae, numbers
from mesh_files import RED_BLUE, SQUARE, TWO, encoded, facing, load_bytes, refusal

from texfcodec.errors import SupportError, TexfError
from texfcodec.scene.scene import ALPHA_BLEND, WRAP_CLAMP, WRAP_REPEAT


@pytest.fixture
def scene_of(tmp_path):
    """Pieces of a document -> Scene, with the texture beside it."""
    pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    (tmp_path / "t ex.png").write_bytes(encoded(RED_BLUE))

    def run(strict=True, **pieces):
        return load_bytes(tmp_path, dae(**pieces), "a.dae", strict=strict)

    return run


def test_a_textured_square_of_upright_axes_and_metres_stays_as_it_is(scene_of):
    scene = scene_of()
    np.testing.assert_array_equal(scene.positions[scene.faces], SQUARE[TWO])
    np.testing.assert_allclose(scene.corner_uv, SQUARE[TWO][..., :2] * [1, -1] + [0, 1])
    assert scene.materials[0].name == "paint" and scene.materials[0].factor.tolist() == [1] * 4
    assert scene.textures[0].image[0, 1].tolist() == [0, 0, 255, 255] and scene.textures[0].wrap == (WRAP_REPEAT,) * 2
    assert scene.metadata == {"source_up_axis": "Y", "source_unit_in_metres": 1.0}
    assert scene.remarks == ["no image uses TEXCOORD_1; it is left out"] and scene.dropped == scene.warnings == []


def test_the_uv_set_that_the_material_binds_is_taken(scene_of):
    bound = '<bind_vertex_input semantic="UV0" input_semantic="TEXCOORD" input_set="3"/>'
    scene = scene_of(bound=bound, sampler="<wrap_s>CLAMP</wrap_s><wrap_t>WRAP</wrap_t>")
    assert scene.corner_uv[..., 0].max() == 0.5 and scene.textures[0].wrap == (WRAP_CLAMP, WRAP_REPEAT)
    assert scene.remarks == ["no image uses TEXCOORD_0; it is left out"] and scene.dropped == []


def test_nodes_place_and_mirror(scene_of):
    scene = scene_of(node="<translate>0 0 5</translate><scale>-2 1 1</scale>")
    np.testing.assert_allclose(scene.positions, SQUARE * [-2, 1, 1] + [0, 0, 5])
    assert (facing(scene)[:, 2] > 0).all()
    place = scene.positions[scene.faces]
    np.testing.assert_allclose(scene.corner_uv[..., 0], place[..., 0] / -2)


def test_a_node_that_looks_somewhere_is_turned_there(scene_of):
    """By the specification of COLLADA: x is right, y nearly up, and the point of interest lies along -z."""
    scene = scene_of(node="<scale>2 2 2</scale><lookat>1 2 3 1 2 -5 1 1 0</lookat>")
    turn = np.array([[1, 1, 0], [-1, 1, 0], [0, 0, 2**0.5]]) / 2**0.5
    np.testing.assert_allclose(scene.positions, 2 * (SQUARE @ turn.T + [1, 2, 3]), atol=1e-6)
    scene = scene_of(strict=False, node="<lookat>1 2 3 1 2 3 0 1 0</lookat>")
    np.testing.assert_allclose(scene.positions, SQUARE + [1, 2, 3])
    assert scene.dropped == ["where a node looks (lookat)"] and len(scene.warnings) == 1
    assert any("9 float values" in text for text in scene_of(strict=False, node="<lookat>1 2</lookat>").warnings)


def test_concave_polygons_are_cut(scene_of):
    points = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [2, 1, 0], [0, 4, 0]])
    surface = ('<polylist count="1" material="skin"><input semantic="VERTEX" source="#v" offset="0"/><vcount>5</vcount>'
               "<p>0 1 2 3 4</p></polylist>")
    scene = scene_of(surface=surface, points=points, diffuse="<color>1 0.5 0 1</color>")
    areas = 0.5 * facing(scene)[:, 2]
    assert (areas > 0).all() and areas.sum() == pytest.approx(10)
    np.testing.assert_allclose(scene.materials[0].factor, [1, 0.21404, 0, 1], atol=1e-5)
    assert scene.materials[0].texture == -1


def test_colours_of_corners_are_decoded(scene_of):
    inputs = '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="COLOR" source="#c" offset="1"/>'
    surface = TRIANGLES.format(inputs=inputs, indices="0 0 1 1 2 0 0 1 2 1 3 1")
    scene = scene_of(surface=surface, sources=numbers("c", "1 0 0 0.5 0 1", "RGB"), diffuse="<color>1 1 1 1</color>")
    np.testing.assert_allclose(scene.corner_color[0], [[1, 0, 0, 1], [0.2140, 0, 1, 1], [1, 0, 0, 1]], atol=1e-4)


@pytest.mark.parametrize("text, alpha", [
    ('<transparent opaque="A_ONE"><color>0 0 0 1</color></transparent><transparency><float>0.25</float></transparency>', 0.25),
    ('<transparent opaque="RGB_ZERO"><color>1 1 1 1</color></transparent><transparency><float>0.25</float></transparency>', 0.75),
    ("<transparency><float>0</float></transparency>", 1.0),
])
def test_transparency_by_its_modes(scene_of, text, alpha):
    material = scene_of(diffuse="<color>1 0 0 1</color>", effect=text).materials[0]
    assert material.factor[3] == pytest.approx(alpha, abs=1e-5) and (material.alpha_mode == ALPHA_BLEND) == (alpha < 1)


def test_transparency_that_hides_some_and_leaves_nothing_opaque_is_turned_round(scene_of):
    text = "<transparent><color>1 1 1 1</color></transparent><transparency><float>0</float></transparency>"
    scene = scene_of(diffuse="<color>1 0 0 1</color>", effect=text)
    assert scene.materials[0].factor[3] == 1 and "no material of the COLLADA file is opaque" in scene.warnings[-1]
    assert scene.dropped == ["alpha in the COLLADA file (guessed)"]


def test_decimal_commas_are_read_as_points(scene_of, tmp_path):
    half = (SQUARE + 0.5).tolist()
    asset = '<asset><unit name="centimetre" meter="0.01"/></asset>'
    plain = scene_of(points=half, asset=asset)
    text = dae(points=half, asset=asset).replace(UV.replace("1", "0.5"), UV)
    head, array = text.split('<float_array id="p-a"')
    array, tail = array.split("<", 1)
    array = f'<float_array id="p-a"{array.replace(".", ",")}<'
    scene = load_bytes(tmp_path, head.replace('"0.01"', '"0,01"') + array + tail, "a.dae", strict=True)
    np.testing.assert_array_equal(scene.positions, plain.positions)
    assert scene.metadata == plain.metadata and "decimal commas" in scene.remarks[0]


@pytest.mark.parametrize("broken, says", [
    (lambda text: text.replace("0.0 0.0 0.0", "0.0 zero 0.0", 1), "Corrupted float array"),
    (lambda text: text.replace('url="#g"', 'url="#other"'), "other"),
])
def test_what_pycollada_cannot_read_is_in_the_error(scene_of, tmp_path, broken, says):
    error = refusal(tmp_path, broken(dae()), "a.dae")
    assert error.code == "TXF-I24" and says in error.message and "no part of its surface can be read" in error.message


def test_lights_and_cameras_that_cannot_be_read_are_no_loss_of_surface(scene_of):
    node = '<instance_camera url="#gone"/><instance_light url="#gone"/>'
    found = scene_of(node=node)
    assert found.warnings == [] and found.dropped == ["lights"] and "cameras are left out" in found.remarks


def test_what_is_not_carried_is_named(scene_of):
    more = ('<library_cameras><camera id="k"><optics><technique_common><perspective><xfov>1</xfov><znear>1</znear><zfar>2</zfar>'
            "</perspective></technique_common></optics></camera></library_cameras><library_lights><light id='l'>"
            "<technique_common><ambient><color>1 1 1</color></ambient></technique_common></light></library_lights>")
    inputs = '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#p" offset="0"/>'
    effect = "<specular><color>0.5 0.4 0.5 1</color></specular><shininess><float>50</float></shininess>"
    scene = scene_of(surface=TRIANGLES.format(inputs=inputs, indices="0 1 2 0 2 3"), more=more, effect=effect,
                     diffuse="<color>1 1 1 1</color>")
    assert {"lights", "specular of material 'paint'"} <= set(scene.dropped) and "NORMAL" not in scene.dropped
    assert {"cameras are left out", "shininess of COLLADA materials is left out"} <= set(scene.remarks)
    corners = scene.positions[scene.faces]  # which are its normals too
    np.testing.assert_allclose(scene.corner_normal[0, 1], corners[0, 1] / np.linalg.norm(corners[0, 1]), atol=1e-6)


def test_missing_textures_and_lines(scene_of, tmp_path):
    (tmp_path / "t ex.png").unlink()
    assert "TXF-I16" in scene_of(strict=False).warnings[0]
    lines = '<lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>'
    both = TRIANGLES.format(inputs='<input semantic="VERTEX" source="#v" offset="0"/>', indices="0 1 2 0 2 3") + lines
    found = scene_of(strict=False, surface=both)
    assert any("not made of triangles" in text for text in found.warnings) and "lines of geometry 'g'" in found.dropped
    strips = both.replace("lines", "linestrips") + '<linestrips count="0"/>'
    found = scene_of(strict=False, surface=strips)
    assert len(found.faces) == 2 and "2 sets of line strips" in found.dropped


@pytest.mark.parametrize("text, code", [
    (b"<?xml version='1.0'?><COLLADA", "TXF-I24"), (b"<?xml version='1.0'?><html/>", "TXF-I15"), (b"no XML", "TXF-I24"),
    (dae().replace("?>", "?><!DOCTYPE x [<!ENTITY e SYSTEM 'file:///etc/hostname'>]>", 1), "TXF-I24"),
    (dae().replace("0 1 2 0 2 3", "0 1 2 0 2 9"), "TXF-I24"), (dae(points=np.where(SQUARE, np.inf, 0)), "TXF-I14"),
    (dae().replace("0 1 2 0 2 3", "0 1 2 0 2 -3"), "TXF-I13"), (dae().replace("0 1 2 0 2 3", "0 1 2 0"), "TXF-I24"),
    (dae(surface='<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><vcount>2000000000</vcount><p>0 1 2</p>'
         "</polylist>"), "TXF-I24"),
    (encoded(RED_BLUE), "TXF-I06"),
])
def test_broken_documents_end_in_their_code(scene_of, tmp_path, text, code):
    assert refusal(tmp_path, text, "a.dae").code == code


def test_damaged_documents_end_in_a_scene_or_a_coded_error(scene_of, tmp_path):
    data, codes = dae().encode(), set()
    for damaged in list(with_a_bit_flipped(data))[::9]:
        try:
            load_bytes(tmp_path, damaged, "a.dae")
        except TexfError as error:
            codes.add(error.code)
    assert "TXF-I24" in codes


def test_without_the_package_the_error_names_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "collada", None)
    error = refusal(tmp_path, dae(), "a.dae")
    assert isinstance(error, SupportError) and error.code == "TXF-I35" and 'pip install "texfcodec[formats]"' in error.message


def test_what_a_constant_material_emits_is_all_that_shows(scene_of, tmp_path):
    """It has no diffuse colour; a white one under it would be all that is seen."""
    text = dae(diffuse="<color>1 1 1 1</color>")
    text = text.replace("<lambert><diffuse>", "<constant><emission>").replace("</diffuse>", "</emission>")
    text = text.replace("<color>1 1 1 1</color>", "<color>0 1 0 1</color>")
    (material,) = load_bytes(tmp_path, text.replace("</lambert>", "</constant>"), "b.dae").materials
    assert material.unlit and material.factor.tolist() == [0, 1, 0, 1] and "emissive" not in material.parameters
