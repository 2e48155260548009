"""Colours of files that do not say what they reach to: a value beyond the end changes nothing else."""

import numpy as np
import pytest
from format_files import FACES, ascii_ply
from mesh_files import SQUARE, Builder, load_bytes

from texfcodec.io.colour_range import unit_colours
from texfcodec.io.mtl import read_mtl
from texfcodec.io.parts import Notes

RAMP = np.linspace(0, 1, 60).reshape(-1, 3)


def of(values, kind=np.float32):
    notes = Notes()
    return unit_colours(np.asarray(values, kind), notes, "colours"), notes


@pytest.mark.parametrize("values, kind", [
    (RAMP, np.float32), (RAMP * 255, np.float32), (RAMP * 65535, np.float64), (np.rint(RAMP * 255), np.uint8),
    (np.rint(RAMP * 65535), np.uint16), (np.rint(RAMP * 255), np.uint16), (np.rint(RAMP * 255), np.int32),
    (np.rint(RAMP * 255) - 256 * (RAMP > 0.5), np.int8),
])
def test_a_ramp_is_the_same_in_every_range_and_type(values, kind):
    unit, notes = of(values, kind)
    np.testing.assert_allclose(unit, RAMP, atol=0.003)
    assert not any("clipped" in text for text in notes.remarks)


@pytest.mark.parametrize("over", [1.004, 1.5, 4.0, 300.0, 1e30, np.inf])
@pytest.mark.parametrize("reach", [1, 255])
def test_one_value_beyond_the_end_is_clipped_and_changes_no_other(over, reach):
    values = RAMP * reach
    values[10, 0] = over * reach
    unit, notes = of(values, np.float64)
    expected = RAMP.copy()
    expected[10, 0] = 1
    np.testing.assert_allclose(unit, expected, atol=1e-6)
    assert notes.remarks[-1] == "colours: 1 value is outside the range and clipped" and notes.dropped == []


def test_a_negative_value_is_clipped_and_nan_is_left_for_the_assembly():
    unit, notes = of([[-0.1, 0.5, 1.0], [np.nan, 0.2, 0.2]])
    assert unit[0, 0] == 0 and np.isnan(unit[1, 0]) and len(notes.remarks) == 1


def test_an_alpha_up_to_1_beside_colours_up_to_255_is_whole():
    unit, _ = of([[255, 128, 0, 1], [10, 20, 30, 0.5]])
    np.testing.assert_allclose(unit[:, 3], [1, 0.5])
    np.testing.assert_allclose(unit[0, :3], [1, 128 / 255, 0])


def test_all_colours_a_little_above_1_are_white():
    assert of(np.full((9, 3), 1.02))[0].min() == 1


def test_pure_colours_in_fractions_stay_pure():
    assert of([[1, 0, 0], [0, 1, 0], [1.0, 1.0, 1.01]])[0].max(axis=1).tolist() == [1, 1, 1]


def test_colours_of_a_gltf_above_1_are_clipped_with_a_remark(tmp_path):
    builder = Builder()
    color = np.array([[1.5, 0, 0], [0, 1, 0], [0, 0, -1], [0.5, 0.5, 0.5]], np.float32)
    builder.primitive(positions=SQUARE, attributes={"COLOR_0": builder.accessor(color)},
                      material=builder.material(pbr={"baseColorFactor": [1.5, 0.5, 0.5, 1]}))
    scene = load_bytes(tmp_path, builder, strict=True)
    assert scene.corner_color.max() == 1 and scene.corner_color.min() == 0 and scene.materials[0].factor[0] == 1
    assert sum("clipped" in text for text in scene.remarks) == 2


@pytest.mark.parametrize("suffix, text", [
    ("obj", "v 0 0 0 {0} 0.5 0\nv 1 0 0 0 {1} 0\nv 1 1 0 0 0 1\nf 1 2 3\n"),
    ("ply", ascii_ply(FACES, "3 0 1 2", ["0 0 0 {0} 0.5 0", "1 0 0 0 {1} 0", "1 1 0 0 0 1"],
                      "property float {name}red\nproperty float {name}green\nproperty float {name}blue\n")),
])
@pytest.mark.parametrize("name", ["", "diffuse_", "vertex_"])
def test_a_vertex_colour_above_1_changes_no_other(tmp_path, suffix, text, name):
    plain = load_bytes(tmp_path, text.format("1.0", "0.25", name=name), f"a.{suffix}", strict=True)
    above = load_bytes(tmp_path, text.format("1.004", "0.25", name=name), f"a.{suffix}", strict=True)
    np.testing.assert_allclose(above.corner_color, plain.corner_color, atol=1e-6)
    assert plain.corner_color.max() == 1 and any("clipped" in text for text in above.remarks)


@pytest.mark.parametrize("values, expected", [("1.2 0.5 0", [1, 0.21404, 0]), ("255 127.5 0", [1, 0.21404, 0])])
def test_a_kd_above_1_is_clipped_or_in_255ths(values, expected):
    notes = Notes()
    np.testing.assert_allclose(read_mtl(f"newmtl a\nKd {values}\n".encode(), notes)["a"].factor[:3], expected, atol=1e-4)
    assert len(notes.remarks) == 1 and notes.dropped == []
