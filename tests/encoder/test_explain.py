"""--explain-time: where the time went, neighbours that make sense, verdicts that follow the figures, and time that is kept to."""

import json

import pytest
from shapes import painted_sphere

from texfcodec.cli.explain_lines import explain_lines
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.explain import ENCODES, changed, explain_time, neighbours_of, per_second, percent_of, verdict
from texfcodec.limits import Limits
from texfcodec.metrics.bd_rate import difference_at
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.scene import Scene

SMALL = {"resolution": 32, "qp": 28, "threads": 1}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return painted_sphere(8)


@pytest.mark.parametrize("seconds, percent, said, bought", [
    (2.0, -10.0, "buys", 10.0), (0.5, 10.0, "saves", 20.0), (2.0, 0.0, "dominated", None), (1.02, 3.0, "dominated", None),
    (0.5, -1.0, "better", None), (0.5, 0.0, "better", None), (1.02, -1.0, "better", None), (0.98, 0.05, "equal", None),
])
def test_verdict_weighs_seconds_against_bytes(seconds, percent, said, bought):
    assert verdict(1.0, seconds, percent) == said and per_second(1.0, seconds, percent) == bought


def test_bytes_at_equal_quality_follow_the_curve_and_its_ends():
    sizes, psnr = [400, 100, 200], [34.0, 30.0, 32.0]  # 2 dB a doubling
    for quality, there in ((32.0, 200), (33.0, 282.84), (36.0, 800), (28.0, 50)):
        assert difference_at(sizes, psnr, 1.1 * there, quality) == pytest.approx(10.0, abs=0.01)
    with pytest.raises(ValueError, match="two points"):
        difference_at([1], [30.0], 1, 30.0)
    lossless = {"bytes": 100, "psnr_y": None}
    assert percent_of([lossless], {"bytes": 120, "psnr_y": None}) == pytest.approx(20.0)
    assert percent_of([lossless], {"bytes": 120, "psnr_y": 40.0}) is None
    assert percent_of([{"bytes": 9, "psnr_y": 40.0}], lossless) is None


def test_a_change_leaves_free_what_was_free():
    free = changed(EncodeOptions(target_bytes=9000), effort="fast")
    assert free.rate_is_free and free.position_bits_are_free and free.target_bytes is None and free.effort == "fast"
    given = changed(EncodeOptions(resolution=64, position_bits=12), qp=20)
    assert (given.rate_is_free, given.resolution, given.position_bits, given.qp) == (False, 64, 12, 20)


@pytest.mark.parametrize("options, expected, absent", [
    ({}, {"--effort fast", "--resolution 48 --qp 28", "--qp 24", "--position-bits 12"}, "near-lossless"),
    ({"effort": "fast", "qp": None, "rate": "r01"}, {"--effort balanced", "--rate r02"}, "--rate r03"),
    ({"qp": None, "lossless": True}, {"--near-lossless 1", "--resolution 21"}, "refine"),
    ({"qp": None, "max_error": 4}, {"--near-lossless 2", "--near-lossless 9"}, "refine"),
    ({"refine": "off"}, {"--refine fit"}, "--refine off"),
])
def test_neighbours_are_settings_one_step_away(scene, options, expected, absent):
    asked = EncodeOptions(**SMALL | options)
    found = list(neighbours_of(asked, encode_scene(scene, asked)))
    names = [neighbour.name for neighbour in found]
    assert expected <= set(names) and not any(absent in name for name in names) and len(set(names)) == len(names)
    for neighbour in found:
        assert changed(asked, **neighbour.change) != asked


def test_explanation_measures_the_base_and_stops_when_its_time_is_up(scene):
    options, report = EncodeOptions(**SMALL), Report()
    made = encode_scene(scene, options, report)
    told = explain_time(scene, options, made, report.seconds, 0.0)
    assert told["base"]["bytes"] == len(made.data) and len(told["neighbours"]) == 1 and told["not_tried"]
    told = explain_time(scene, options, made, report.seconds, 100.0)
    assert not told["not_tried"] and json.loads(json.dumps(told)) == told
    rows = {row["change"]: row for row in told["neighbours"]}
    assert rows["--effort fast"]["bytes"] >= 0.95 * told["base"]["bytes"]
    assert rows["--resolution 48 --qp 28"]["psnr_y"] > rows["--resolution 21 --qp 28"]["psnr_y"]
    assert all(row["verdict"] for row in rows.values() if row["percent"] is not None)


def test_a_neighbour_that_cannot_be_coded_says_why(scene):
    made = encode_scene(scene, EncodeOptions(**SMALL))
    options = EncodeOptions(**SMALL, limits=Limits(voxels=round(1.6 * made.counts["voxels"])))
    told = explain_time(scene, options, made, {}, 100.0)
    refused = next(row for row in told["neighbours"] if row["change"].startswith("--resolution 48"))
    assert "voxels" in refused["reason"] and any(refused["reason"] in line for line in explain_lines(told))


def test_encoder_explains_its_time_in_lines_and_json(call, tmp_path):
    source, out = tmp_path / "square.obj", tmp_path / "a.texf"
    source.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    given = ["texf-enc", source, out, "--resolution", "32", "--qp", "28", "--threads", "1"]
    told = json.loads(call(*given, "--explain-time", "--json")[1])["explained"]
    assert told["budget"] == pytest.approx(ENCODES * told["base"]["seconds"], abs=0.01) and "load" in told["stages"]
    code, lines, _ = call(*given, "--explain-seconds", "30")
    assert code == 0 and lines.startswith("time by stage: ") and "saved per extra second" in lines and "--effort fast" in lines
    assert out.stat().st_size == told["base"]["bytes"] and "explained" not in json.loads(call(*given, "--json")[1])
    code, _, err = call(*given, "--explain-time", "--dry-run")
    assert code == 1 and "cannot be combined" in err
