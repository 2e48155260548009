"""Alpha of 0: what exporters mean by it, materials that nobody sees, and measurements of nothing."""

import json

import numpy as np
import pytest
from mesh_files import RED_BLUE, SQUARE_UV, Builder, encoded, load_bytes

from texfcodec import EncodeOptions, InputError, Report
from texfcodec.api import encode_to_result
from texfcodec.cli.enc import main as run_enc
from texfcodec.scene.scene import ALPHA_BLEND, ALPHA_OPAQUE

OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 2\n"
MESHLAB = "#\n# Wavefront material file\n# Converted by Meshlab Group\n#\n\n"
CLEAR = np.array([[[255, 0, 0, 0], [0, 0, 255, 255]]], np.uint8)  # the left half is clear


def obj(folder, first, second, head="", **options):
    """The OBJ file with two materials of these statements."""
    (folder / "a.mtl").write_text(f"{head}newmtl a\n{first}\nnewmtl b\n{second}\n")
    return load_bytes(folder, OBJ, "a.obj", **options)


def alphas(scene):
    return [float(material.factor[3]) for material in scene.materials]


@pytest.mark.parametrize("first, second, head, expected, says", [
    ("Tr 1.000000", "Tr 1.000000", MESHLAB, [1, 1], "Tr in the MTL file"),
    ("Tr 1", "Tr 1", "", [1, 1], "Tr in the MTL file"),
    ("Tr 0.25", "Tr 1", MESHLAB, [0.25, 1], "Tr in the MTL file"),
    ("Tr 0", "Tr 0", MESHLAB, [1, 1], ""),
    ("Tr 0.25", "Tr 1", "", [0.25, 1], "Tr in the MTL file"),
    ("Tr 0", "Tr 1", "", [1, 0], ""),
    ("d 0.2", "d 0", "", [0.8, 1], "no material of the MTL file"),
    ("Tr 0.5", "Tr 0", "", [0.5, 1], ""),
    ("d 1\nTr 1", "d 1\nTr 0", "", [1, 1], "disagree; d is used"),
    ("d 0.3\nTr 0.7", "Kd 1 1 1", "", [0.3, 1], ""),
    ("d 0", "d 0", "", [1, 1], "no material of the MTL file"),
])
def test_tr_and_d_are_read_as_their_exporters_mean_them(tmp_path, first, second, head, expected, says):
    scene = obj(tmp_path, first, second, head)
    np.testing.assert_allclose(alphas(scene), expected)
    assert [bool(says) and says in text for text in scene.remarks + scene.warnings[: len(scene.dropped)]] == [True] * bool(says)
    assert [m.alpha_mode for m in scene.materials] == [ALPHA_OPAQUE if alpha == 1 else ALPHA_BLEND for alpha in expected]
    assert len(scene.warnings) == expected.count(0) + len(scene.dropped)


def glb(image=None, uv=SQUARE_UV, mode="BLEND", factor=1.0, colour=None, wrap=10497, **more):
    builder = Builder()
    texture = None if image is None else builder.texture(encoded(image), magFilter=9729, wrapS=wrap)
    material = builder.material(texture, alphaMode=mode, pbr={"baseColorFactor": [1, 1, 1, factor]}, **more)
    attributes = {} if colour is None else {"COLOR_0": builder.accessor(np.array(colour, np.float32))}
    builder.primitive(uv=uv, material=material, attributes=attributes)
    return builder


LEFT = (SQUARE_UV * [0.4, 1]).astype(np.float32)
MIRRORED = 33648


@pytest.mark.parametrize("builder, seen", [
    (glb(factor=0.0), False), (glb(factor=0.01), True), (glb(factor=0.0, mode="OPAQUE"), True),
    (glb(CLEAR), True), (glb(CLEAR, LEFT), False), (glb(CLEAR, LEFT - np.float32(3)), False), (glb(CLEAR, LEFT, "OPAQUE"), True),
    (glb(RED_BLUE, factor=0.3, mode="MASK"), False), (glb(RED_BLUE, factor=0.3, mode="MASK", alphaCutoff=0.3), True),
    (glb(colour=[[1, 1, 1, 0]] * 4), False), (glb(colour=[[1, 1, 1, 0]] * 3 + [[1, 1, 1, 1]]), True),
    (glb(CLEAR, colour=[[1, 1, 1, 0]] * 4), False),
    (glb(CLEAR, LEFT + np.float32([1, 0])), False), (glb(CLEAR, LEFT + np.float32([1, 0]), wrap=MIRRORED), True),
    (glb(CLEAR, LEFT + np.float32([1.55, 0]), wrap=MIRRORED), False),
])
def test_what_nobody_can_see_is_a_warning(tmp_path, builder, seen):
    warnings = load_bytes(tmp_path, builder).warnings
    assert [("material 'm' is invisible" in warning) for warning in warnings] == [True] * (not seen)


def test_one_visible_texel_in_the_middle_of_a_face_is_seen(tmp_path):
    image = np.zeros((64, 64, 4), np.uint8)
    image[40, 33, 3] = 255
    assert load_bytes(tmp_path, glb(image)).warnings == []
    image[40, 33, 3] = 0
    assert len(load_bytes(tmp_path, glb(image)).warnings) == 1


def test_measuring_nothing_says_so_and_writes_the_stream(tmp_path, capsys):
    (tmp_path / "a.glb").write_bytes(glb(factor=0.0).glb())
    report = Report()
    made = encode_to_result(tmp_path / "a.glb", EncodeOptions(resolution=8, qp=30, threads=1, measure=True), report)
    assert made.psnr_3d is None and any("the surface is invisible" in warning for warning in report.warnings)
    out = tmp_path / "a.texf"
    with pytest.raises(SystemExit) as ended:
        run_enc([str(tmp_path / "a.glb"), str(out), "--resolution", "8", "--measure", "--json", "--threads", "1"])
    facts = json.loads(capsys.readouterr().out)
    assert not ended.value.code and facts["psnr_3d"] is None
    assert any("PSNR cannot be computed" in line for line in facts["warnings"])


def test_a_target_on_nothing_visible_ends_well(tmp_path):
    (tmp_path / "a.glb").write_bytes(glb(factor=0.0).glb())
    assert len(encode_to_result(tmp_path / "a.glb", EncodeOptions(target_bytes=4000, threads=1)).data) <= 4000
    with pytest.raises(InputError, match="TXF-I94"):
        encode_to_result(tmp_path / "a.glb", EncodeOptions(target_psnr=30.0, threads=1))
