"""Colours of OBJ vertices in their many ways, what of the statements is named, and which statements of MTL refuse nothing."""

import numpy as np
import pytest
from mesh_files import load_bytes, refusal

from texfcodec.io.mtl import read_mtl
from texfcodec.io.parts import Notes

POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
COLORS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)]
SHOWN = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
V = [f"v {x} {y} {z}" for x, y, z in POINTS]
FACE = "f 1 2 3 4"


def hexes(colors):
    return "".join(f"ff{r:02x}{g:02X}{b:02x}" for r, g, b in colors)


@pytest.mark.parametrize("lines", [
    [*V, "#MRGB " + hexes(COLORS), FACE], [*V, "#MRGB " + hexes(COLORS[:3]), "#MRGB " + hexes(COLORS[3:]), "#End", FACE],
    [FACE.replace("f", "#f"), *V, FACE, "#MRGB " + hexes(COLORS)],
    [*V[:2], "#MRGB " + hexes(COLORS[:2]), *V[2:], "#MRGB " + hexes(COLORS[2:]), FACE],
    [f"{v}\n#vcolor {r / 255} {g / 255} {b / 255}" for v, (r, g, b) in zip(V, COLORS, strict=True)] + [FACE],
    [*V, *(f"#vcolor {r} {g} {b}" for r, g, b in COLORS), FACE],
    [f"{v} {r} {g} {b}" for v, (r, g, b) in zip(V, COLORS, strict=True)] + ["#MRGB " + hexes(COLORS[::-1]), FACE],
    [f"{v} {r} {g} {b}" for v, (r, g, b) in zip(V, COLORS, strict=True)] + [FACE],
    [f"{v} {r / 255:.1f} {g / 255:.1f} {b / 255:.1f} 1.0" for v, (r, g, b) in zip(V, COLORS, strict=True)] + [FACE],
    [f"{v} 1.0 {r / 255:.1f} {g / 255:.1f} {b / 255:.1f}" for v, (r, g, b) in zip(V, COLORS, strict=True)] + [FACE],
])
def test_every_way_to_write_colours_of_vertices_is_read(tmp_path, lines):
    scene = load_bytes(tmp_path, "\n".join(lines) + "\n", "a.obj", strict=True)
    color = np.empty((4, 3))
    color[scene.faces] = scene.corner_color[..., :3]
    assert color.tolist() == SHOWN and scene.dropped == scene.warnings == []


@pytest.mark.parametrize("comment, lost", [
    ("#MRGB " + hexes(COLORS[:2]), "some colours in comments"), ("#MRGB " + hexes(COLORS * 2), "some colours in comments"),
    ("#MRGB no colour", "colours in comments of the OBJ file (not readable)"),
    ("#vcolor 1 0", "colours in comments of the OBJ file (not readable)"),
])
def test_colours_in_comments_that_do_not_fit_are_a_loss(tmp_path, comment, lost):
    scene = load_bytes(tmp_path, "\n".join([*V, comment, FACE]), "a.obj")
    assert len(scene.dropped) == 1 and scene.dropped[0].startswith(lost) and len(scene.faces) == 2


def test_alpha_behind_colours_and_weights_are_losses(tmp_path):
    rows = "\n".join(f"{v} 1 0 0 0.5" for v in V)
    assert "alpha of the colours" in load_bytes(tmp_path, f"{rows}\n{FACE}", "a.obj").dropped[0]
    assert load_bytes(tmp_path, "\n".join([*(f"{v} 1 0 0 1 7" for v in V), FACE]), "a.obj").dropped == [
        "numbers of vertices from the eighth on (OBJ statement 'v', 8 numbers)"]
    assert load_bytes(tmp_path, "\n".join([*(f"{v} 2" for v in V), FACE]), "a.obj").dropped == [
        "weights of vertices (OBJ statement 'v')"]


def test_curves_and_lines_are_counted_and_groups_refuse_nothing(tmp_path):
    text = "\n".join([*V, "mg 1 0.5", "s off", "g all", "cstype bezier", "deg 3", "curv 0 1 1 2 3 4", "parm u 0 1", "end",
                      "l 1 2", "l 2 3", FACE])
    assert load_bytes(tmp_path, text, "a.obj").dropped == ["1 free-form curve", "2 lines"]
    scene = load_bytes(tmp_path, "\n".join([*V, "shadow_obj b.obj", "frob 1", FACE]), "a.obj")
    assert scene.dropped == ["OBJ statement 'frob'"] and scene.remarks == ["OBJ statement 'shadow_obj' is left out"]
    assert load_bytes(tmp_path, "\n".join([*V, "mg 1 0.5", "s off", "lod 3", FACE]), "a.obj", strict=True).dropped == []
    assert len(load_bytes(tmp_path, "\r".join([*V, FACE.replace("f", "fo")]), "a.obj", strict=True).faces) == 2


@pytest.mark.parametrize("lines, says", [
    ([*V, "p 1", "p 2"], "it has 2 points"), ([*V, "l 1 2 3"], "it has 1 line"), (V, "it has 4 vertices without faces"),
    ([*V, "surf 0 1 0 1 1 2 3 4"], "it has 1 free-form surface"),
])
def test_an_obj_without_triangles_says_what_it_has(tmp_path, lines, says):
    error = refusal(tmp_path, "\n".join(lines), "a.obj")
    assert error.code == "TXF-I15" and error.message == f"the input has no triangles: {says}"


@pytest.mark.parametrize("text", [
    "Ns 250.000000\nKa 1.000000 1.000000 1.000000\nKs 0.500000 0.500000 0.500000\nKe 0 0 0\nNi 1.450000\nd 1.000000\nillum 2",
    "Ns 10.0000\nNi 1.5000\nd 1.0000\nTr 0.0000\nTf 1.0000 1.0000 1.0000\nillum 2\nKa 0.5882 0.5882 0.5882\nKs 0 0 0\nKe 0 0 0",
    "Ka 0.2 0.2 0.2\nKs 1 1 1\nTr 1\nillum 2\nNs 0", "Pr 0.5\nPm 0\nPs 0\nPc 0\nPcr 0\naniso 0\nanisor 0\nsharpness 60",
    "Ka 0.1 0.2 0.3\nmap_Ka a.png\nmap_Kd -bm 1 -blendu on -mm 0 1 -t 0 0 0 a.png",
])
def test_what_every_exporter_writes_is_at_most_a_remark(text):
    notes = Notes(strict=True)
    read_mtl(f"newmtl a\n{text}\n".encode(), notes)
    assert notes.dropped == notes.warnings == []


@pytest.mark.parametrize("line, lost", [
    ("Ks 1 0.8 0.2", "Ks"), ("map_Ks s.png", "map_Ks"), ("map_Ka b.png", "map_Ka"), ("Pc 1", "Pc"),
    ("Tf 1 0 0", "Tf"), ("refl -type sphere r.png", "refl"),
])
def test_what_shows_is_a_loss(line, lost):
    notes = Notes()
    read_mtl(f"newmtl a\nmap_Kd a.png\n{line}\n".encode(), notes)
    assert notes.dropped == [f"{lost} of material 'a'"]


def test_emission_roughness_and_metal_of_an_mtl_are_read(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nKe 2 1 0\nPr 0.25\nPm 1\nnewmtl n\n")
    text = "\n".join(["mtllib a.mtl", *V, "usemtl m", FACE, "usemtl n", FACE])
    glowing, plain = load_bytes(tmp_path, text, "a.obj", strict=True).materials
    assert glowing.parameters["emissive"] == pytest.approx((1.0, 0.214, 0.0), abs=1e-3)  # coded as Kd is
    assert (glowing.parameters["emissive_strength"], glowing.parameters["roughness"]) == ((2.0,), (0.25,))
    assert glowing.parameters.get("metallic", (1.0,)) == (1.0,)
    assert plain.parameters == {"metallic": (0.0,)}
