"""Axes and units of the formats that state them: what stands in the file stands in the Scene, in metres."""

import numpy as np
import pytest
from format_files import dae
from mesh_files import load_bytes
from threemf_files import mesh, model, package

TOWER = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 9], [0, 0, 9]])  # along z


@pytest.mark.parametrize("axis, order", [("Z_UP", [0, 1, 2]), (" z_up\n", [0, 1, 2]), ("Y_UP", [0, 2, 1]), ("X_UP", [2, 1, 0]),
                                         ("", [0, 2, 1]), ("W_UP", [0, 2, 1])])
@pytest.mark.parametrize("unit, metres", [('<unit name="inch" meter="0.0254"/>', 0.0254), ("", 1.0), ('<unit meter="-2"/>', 1.0),
                                          ('<unit name="centimeter" meter="0.01"/>', 0.01)])
def test_a_collada_tower_stands_and_is_in_metres(tmp_path, axis, order, unit, metres):
    pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    up = f"<up_axis>{axis}</up_axis>" * bool(axis)
    text = dae(points=TOWER[:, order], asset=f"<asset>{unit}{up}</asset>", diffuse="<color>1 1 1 1</color>")
    scene = load_bytes(tmp_path, text, "a.dae", strict=True)
    assert np.ptp(scene.positions, axis=0).argmax() == 1
    np.testing.assert_allclose(scene.positions[:, 1].max(), 9 * metres, rtol=1e-6)
    moved = order != [0, 2, 1] or metres != 1
    assert sum("turned and scaled" in text for text in scene.remarks) == moved and scene.dropped == []


@pytest.mark.parametrize("axis", ["X_UP", "Y_UP", "Z_UP"])
def test_turning_mirrors_nothing(tmp_path, axis):
    pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    surface = ('<triangles count="4" material="skin"><input semantic="VERTEX" source="#v" offset="0"/>'
               "<p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>")
    scene = load_bytes(tmp_path, dae(surface, points, asset=f"<asset><up_axis>{axis}</up_axis></asset>",
                                     diffuse="<color>1 1 1 1</color>"), "a.dae", strict=True)
    assert np.linalg.det(scene.positions[scene.faces]).sum() / 6 == pytest.approx(1 / 6)


@pytest.mark.parametrize("unit, metres", [("millimeter", 1e-3), ("inch", 0.0254), ("meter", 1.0), ("micron", 1e-6),
                                          ("ell", 1e-3)])
def test_a_3mf_stands_and_is_in_metres(tmp_path, unit, metres):
    tall = mesh().replace('y="1', 'y="0').replace('z="0', 'z="9', 1)
    scene = load_bytes(tmp_path, package(model(tall, unit=unit)), "a.3mf", strict=True)
    assert scene.positions[:, 1].max() == pytest.approx(9 * metres) and scene.positions[:, 1].min() == 0


@pytest.mark.parametrize("suffix, text", [
    ("obj", "v 0 0 0\nv 1 0 0\nv 0 0 9\nf 1 2 3\n"),
    ("stl", "solid\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 9\nendloop\nendfacet\nendsolid\n"),
])
def test_formats_that_state_nothing_are_neither_turned_nor_talked_of(tmp_path, suffix, text):
    scene = load_bytes(tmp_path, text, f"a.{suffix}", strict=True)
    assert scene.positions.max(axis=0).tolist() == [1, 0, 9]
    assert not any("turned" in text for text in scene.remarks + scene.warnings)
