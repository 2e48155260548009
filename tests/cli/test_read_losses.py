"""What the command lines say of a mesh of which something was not found or not read, and every format on stdin."""

import io
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from format_files import dae, stl, stl_text
from mesh_files import RED_BLUE, SQUARE, encoded, textured
from threemf_files import mesh, model, package

from texfcodec.cli.enc import _check_lines
from texfcodec.cli.inputs import load_mesh, open_asset
from texfcodec.cli.totals import Totals
from texfcodec.errors import InputError

EXACT = {"y": None, "rgb": None, "visible": True, "worst": None, "parts": []}
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
POINTS = "".join(" ".join(map(str, row)) + "\n" for row in SQUARE.tolist())
PLY = ("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
       f"property list uchar int vertex_index\nend_header\n{POINTS}4 0 1 2 3\n")


def remote():
    """A glTF as text, all in one file but for its image, which is on a network."""
    builder = textured()
    builder.tree["images"][0] = {"uri": "https://a.example/t.png"}
    return builder


def line(dropped=(), warnings=(), **check):
    return list(_check_lines({"check": {**EXACT, **check}, "dropped": list(dropped), "warnings": list(warnings)}))[0]


def test_the_result_line_names_losses_and_calls_nothing_exact_beside_them():
    assert line() == "checked: Y exact, RGB exact; no losses"
    assert line(["texture 'a'"]) == "checked: Y as read, RGB as read; losses: texture 'a'"
    assert line("abcde", y=40.0).endswith("Y 40.00 dB, RGB as read; losses: a, b, c and 2 more, listed above")
    assert line(warnings=["9 faces cross"]) == "checked: Y exact, RGB exact; 1 warning listed above"


def test_a_stream_that_is_not_checked_names_its_losses():
    assert list(_check_lines({"check": None, "dropped": ["a"], "warnings": []})) == ["not checked; losses: a"]
    assert list(_check_lines({"check": None, "dropped": [], "warnings": []})) == []


def test_a_lost_texture_is_in_every_report(call, tmp_path):
    (tmp_path / "a.glb").write_bytes(remote().glb())
    name = "texture 'https://a.example/t.png' of base colour"
    code, out, err = call("texf-enc", tmp_path / "a.glb", tmp_path / "a.texf", "--rate", "r01")
    assert code == 0 and f"losses: {name}" in out and "no losses" not in out + err and "RGB exact" not in out
    code, out, _ = call("texf-enc", tmp_path / "a.glb", tmp_path / "a.texf", "--rate", "r01", "--json")
    facts = json.loads(out)
    assert facts["dropped"] == [name] and "is remote" in facts["warnings"][0]
    code, _, err = call("texf-enc", tmp_path / "a.glb", tmp_path / "b.texf", "--rate", "r01", "--strict")
    assert code == 2 and "TXF-I27" in err and not (tmp_path / "b.texf").exists()
    totals = Totals()
    totals.add({"asset": "a.glb", "stream": {"bytes": 100}, "result": facts})
    said = " ".join(totals.lines())
    assert totals.facts()["assets_with_losses"] == 1 and "of what was read" in said and "exact" not in said


def gltf_text():
    import base64

    builder = textured()
    data = base64.b64encode(builder.blob).decode()
    buffers = [{"byteLength": len(builder.blob), "uri": f"data:application/octet-stream;base64,{data}"}]
    return json.dumps({**builder.tree, "buffers": buffers})


@pytest.mark.parametrize("source", [
    textured().glb(), gltf_text(), OBJ, "# from a scanner\n\n" + OBJ, "mtllib a.mtl\no thing\n" + OBJ, OBJ.encode("utf-16"),
    "#\n" * 9000 + OBJ, PLY, stl(), stl_text(), stl(header=b"solid"), f"OFF\n4 1 0\n{POINTS}4 0 1 2 3\n",
    f"# made here\nCOFF\n4 1 0\n{POINTS.replace(chr(10), ' 1 0 0 1' + chr(10))}4 0 1 2 3\n",
    dae(diffuse="<color>1 0 0 1</color>"),
    package(model(mesh())),
])
def test_every_format_that_one_file_holds_is_read_from_stdin(monkeypatch, source):
    data = source.encode() if isinstance(source, str) else source
    if b"COLLADA" in data[:200]:
        pytest.importorskip("collada", reason="pycollada is not installed: pip install 'texfcodec[formats]'")
    for reader in (lambda: load_mesh("-"), lambda: open_asset("-", False)):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data)))
        scene = reader()
        assert len(scene.faces) == 2 and list(scene.files) == ["-"] and np.isfinite(scene.positions).all()


@pytest.mark.parametrize("data", [encoded(RED_BLUE), b"verse 1\n", b"\0" * 100, b"solidarity", b"<html>", b"#\n"])
def test_what_is_no_mesh_is_refused_from_stdin(monkeypatch, data):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    with pytest.raises(InputError):
        load_mesh("-")
