"""Reports are JSON that strict readers take, whatever figure stands in them."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from texfcodec import EncodeOptions, encode_to_result
from texfcodec.core.json_text import json_ready, json_text
from texfcodec.precompile import small_scene
from texfcodec.scene.scene import ALPHA_OPAQUE

REPOSITORY = Path(__file__).resolve().parents[2]
ASSETS = sorted((REPOSITORY.parent / "shared/assets").glob("*.glb"))
QUICK = ("--resolution", "128", "--qp", "28", "--effort", "fast")
OVER_TEXELS = ("--rate", "r01", "--effort", "fast")  # of all that house_mask shows
PLANTED = (float("inf"), float("-inf"), float("nan"), np.float32("nan"), np.float64("-inf"), np.int64(1 << 40), np.bool_(True),
           np.array([[1.5, np.inf], [np.nan, 2.0]], np.float32), np.array([3, 4], np.uint8), np.array(np.inf), (1, float("nan")),
           {2, 3}, Path("a.glb"), {np.int64(3): {"deep": [float("inf")]}})

# Where json.dumps() is called by itself, and why that is no report.
PLAIN = {
    "texfcodec/core/json_text.py": "the writer of reports itself",
    "texfcodec/io/gltf/reader.py": "the length of metadata alone",
    "texfcodec/demo/asset.py": "the glTF of the demo asset",
    "texfcodec/sandbox/limited_process.py": "the request to a child process",
    "texfcodec/sandbox/isolate.py": "a child's answer, which its parent checks",
}


def strictly(text):
    """The value of a JSON text; infinities and NaN, which Python reads too, are refused."""
    def refuse(word):
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def leaves(value, path=()):
    """Paths of everything in a report that holds nothing more."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = [leaf for key, item in items for leaf in leaves(item, (*path, key))]
    return found or [path]


def with_leaf(value, path, planted):
    """A copy of a report with one leaf replaced."""
    if not path:
        return planted
    copy = value.copy()
    copy[path[0]] = with_leaf(copy[path[0]], path[1:], planted)
    return copy


def at(value, path):
    for key in path:
        value = value[key]
    return value


@pytest.fixture(scope="module")
def asset(tmp_path_factory):
    """Two sheets of one colour each that cross, as an OBJ."""
    folder = tmp_path_factory.mktemp("sheets")
    (folder / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (folder / "a.obj").write_text("mtllib a.mtl\nv 0 0 .5\nv 1 0 .5\nv 1 1 .5\nv 0 1 .5\nv .5 0 0\nv .5 1 0\nv .5 1 1\nv .5 0 1\n"
                                  "usemtl red\nf 1 2 3\nf 1 3 4\nusemtl blue\nf 5 6 7\nf 5 7 8\n")
    return folder / "a.obj"


def test_every_field_of_a_report_may_hold_what_json_knows_not(call, asset, tmp_path):
    code, out, _ = call("texf-enc", asset, tmp_path / "a.texf", "--json", "--resolution", 32, "--qp", 28, "--effort", "fast")
    report = strictly(out)
    paths = leaves(report)
    assert code == 0 and len(paths) > 60 and json_ready(report) == report
    for planted in PLANTED:
        for path in paths:
            plain = strictly(json_text(with_leaf(report, path, planted)))
            got = at(plain, path)
            assert with_leaf(plain, path, None) == with_leaf(report, path, None)  # no other field is touched
            if isinstance(planted, float) and not np.isfinite(planted):
                assert got is None
    assert json_ready(PLANTED[7:10]) == [[[1.5, None], [None, 2.0]], [3, 4], None]
    assert json_ready(PLANTED[5:7]) == [1 << 40, True] and json_ready(PLANTED[12:]) == ["a.glb", {"3": {"deep": [None]}}]
    with pytest.raises(ValueError):
        strictly('{"a": Infinity}')


def test_fields_of_one_colour_are_exact_and_their_report_is_json(call, asset, tmp_path):
    """The PSNR of a partition trial is infinite where the surfaces that are parted have one colour each."""
    code, out, _ = call("texf-enc", asset, tmp_path / "a.texf", "--json", "--resolution", 32, "--qp", 28, "--effort", "fast")
    trials = strictly(out)["partition"]["trials"]
    assert code == 0 and trials[0]["psnr_y_after"] is None and trials[0]["psnr_y_before"] > 10
    made = encode_to_result(asset, EncodeOptions(resolution=32, qp=28, effort="fast"))
    assert made.choices["partition"]["trials"] == trials and strictly(json.dumps(made.choices, allow_nan=False)) == made.choices


def test_metadata_that_no_json_holds_are_written_back_without_them(tmp_path):
    from texfcodec import decode, encode

    scene = small_scene()
    scene.metadata = {"depth": float("inf"), "scale": 2.0}
    texf = decode(encode(scene, EncodeOptions(resolution=16, qp=40, effort="fast", threads=1)))
    assert texf.metadata == {"depth": None, "scale": 2.0} and texf.materials[0].alpha_mode == ALPHA_OPAQUE
    texf.metadata = {"depth": float("nan"), "name": "half of a pair: \ud800", "scale": 2.0}  # as other encoders may write them
    texf.save(tmp_path / "a.gltf", texture_size=64)
    extras = strictly((tmp_path / "a.gltf").read_text(encoding="utf-8"))["asset"]["extras"]["texf"]
    assert extras == {"depth": None, "name": "half of a pair: ?", "scale": 2.0}


def test_reports_have_one_writer():
    files = (REPOSITORY / "texfcodec").rglob("*.py")
    texts = {path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8") for path in files}
    dumping = {name for name, text in texts.items() for node in ast.walk(ast.parse(text))
               if isinstance(node, ast.Attribute) and node.attr in ("dump", "dumps") and getattr(node.value, "id", "") == "json"}
    assert dumping == set(PLAIN)


@pytest.mark.skipif(not ASSETS, reason="../shared is not here: the large assets are not part of the repository")
@pytest.mark.parametrize("path", ASSETS, ids=lambda path: path.stem)
def test_every_asset_has_a_report_that_strict_readers_take(call, path, tmp_path):
    for words in (QUICK, OVER_TEXELS) if path.stem == "house_mask" else (QUICK,):
        code, out, _ = call("texf-enc", path, tmp_path / "a.texf", "--json", "--threads", 1, *words)
        report = strictly(out)
        assert code == 0 and report["bytes"]["total"] == (tmp_path / "a.texf").stat().st_size
        partition = report["partition"]
        assert "trials" in partition or any(why in partition["reason"] for why in ("one colour", "over texels"))
