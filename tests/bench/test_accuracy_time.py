"""Which settings pay: the table of knobs is whole, claims say what the figures say, a sweep goes on where it stopped."""

import csv
import json
import math
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from shapes import painted_sphere

from texfcodec.encoder.explain import BETTER, BUYS, DOMINATED, SAVES
from texfcodec.encoder.values import source_field
from texfcodec.options import RATES, EncodeOptions
from tools.bench import accuracy_bench, accuracy_time
from tools.bench.accuracy_bench import Bench, Measured, known_place, place_of, run_settings
from tools.bench.accuracy_fronts import (
    BYTES,
    DECIBELS,
    SECONDS,
    asset_of,
    beaten_presets,
    dominates,
    dominators,
    steps_of,
    to_change,
)
from tools.bench.accuracy_knobs import BY_NAME, KNOBS, NO_KNOB, STREAM, TEXELS, VOXELS, Place, curve_settings
from tools.bench.accuracy_page import csv_rows, page_of
from tools.bench.accuracy_plot import draw, front_of
from tools.bench.accuracy_time import settings_of

HOUSE, SCAN = Place(TEXELS, 512, 1024), Place(VOXELS, 1024, 2048, True)
ARGUMENTS = SimpleNamespace(threads=1, jobs=1, repeats=3, quick=False)


def test_every_option_has_a_knob_or_a_reason_for_none():
    turned = {name for knob in KNOBS for name in knob.options}
    options = {field.name for field in fields(EncodeOptions)}
    assert turned | set(NO_KNOB) == options and not turned & set(NO_KNOB)
    assert all(NO_KNOB.values())


@pytest.mark.parametrize("place", [HOUSE, SCAN, Place(VOXELS, 64)])
def test_every_setting_is_one_that_the_encoder_takes(place):
    for setting in settings_of(place, KNOBS, False):
        if setting["kind"] == "encode":
            options = {name: value for name, value in setting["options"].items() if name != "density"}
            EncodeOptions(**options)  # raises for what makes no sense
        json.dumps(setting)
    assert len(settings_of(place, KNOBS, True)) < len(settings_of(place, KNOBS, False))


def test_a_knob_is_turned_only_where_it_has_a_part():
    applies = {name: [knob.applies(place) for place in (HOUSE, SCAN, Place(VOXELS, 64))] for name, knob in BY_NAME.items()}
    assert applies["texel-size"] == [True, False, False] and applies["iterations"] == [False, True, True]
    assert applies["3DNTC-steps"] == [False, True, False] and applies["effort"] == [True] * 3


@pytest.mark.parametrize("knob", [k for k in KNOBS if k.default is not None], ids=lambda knob: knob.name)
def test_the_default_is_among_the_values_and_measured_once_with_that_of_other_knobs(knob):
    assert knob.default in knob.values and set(knob.quick) <= set(knob.values)
    if knob.name in ("effort", "QP", "K", "refinement", "partition", "area threshold", "density before a fit"):
        assert knob.settings(SCAN)[knob.default]["options"] == {"resolution": 1024, "qp": 28}


def test_front_is_what_no_other_beats_beyond_the_noise_of_time():
    given = [(1.0, 100, -30.0), (1.04, 100, -30.0), (2.0, 100, -30.0), (2.0, 90, -30.0), (1.03, 90, -31.0), (0.5, 200, -20.0)]
    costs = [(math.log(seconds), math.log(size), quality) for seconds, size, quality in given]
    assert dominators(costs, (SECONDS, BYTES, DECIBELS)) == [[4], [4], [0, 1, 3, 4], [4], [], []]
    assert dominators(costs, ((0, 0), BYTES, DECIBELS)) == [[], [0, 4], [0, 1, 3, 4], [4], [], []]
    a_hair_better = [(0.0, 9.0, -30.0), (0.0, 8.9995, -30.005)]
    assert dominators(a_hair_better, (SECONDS, BYTES, DECIBELS)) == [[], []]
    assert front_of([(2.0, 5.0), (1.0, 0.0), (3.0, 4.0), (1.0, -1.0)]) == [1, 0]


@pytest.mark.parametrize("seed", range(5))
def test_some_point_is_on_every_front_and_none_beats_itself_or_back(seed):
    axes = SECONDS, BYTES, DECIBELS
    costs = [tuple(row) for row in np.random.default_rng(seed).integers(0, 4, (40, 3)) * [0.03, 0.0007, 0.007]]
    found = dominators(costs, axes)
    assert any(not by for by in found) and all(i not in by for i, by in enumerate(found))
    assert not any(dominates(a, b, axes) and dominates(b, a, axes) for a in costs for b in costs)


def made_up(setting):
    """Measured of a setting: a kilobyte doubles with every 6 QP less and gains 2 dB; what is dearer than that is said here."""
    options, clocks = setting.get("options", {}), {"processor": (1.0, 0.98, 1.02), "wall": (3.0, 1.0, 9.0)}
    if setting["kind"] != "encode":
        number = setting.get("samples") or setting["views"] * setting["size"]
        return Measured(setting, clocks, 3, errors=(10 / number, -10 / number))
    qp, seconds, factor = options.get("qp") or RATES[options.get("rate", "r04")][1], 1.0, 1.0
    seconds, factor = {"fast": (0.5, 1.2), "best": (2.0, 0.9)}.get(options.get("effort"), (seconds, factor))
    if options.get("partition") == "off":
        seconds, factor = 0.8, 0.95  # better than the default
    if options.get("refine") == "render":
        seconds, factor = 9.0, 1.0  # for nothing
    psnr = 50 - 2 * qp / 6
    clocks["processor"] = (seconds, 0.98 * seconds, 1.02 * seconds)
    return Measured(setting, clocks, 3, round(1e6 * factor * 2 ** (-qp / 6)), 500, psnr, psnr if setting.get("image") else None)


def test_claims_follow_the_figures(tmp_path):
    settings = settings_of(SCAN, KNOBS, False)
    assets = [asset_of(name, SCAN, {accuracy_bench.key_of(s): made_up(s) for s in settings}) for name in ("vase", "scan")]
    asset = assets[0]
    assert asset.clock == "processor" and asset.spread == pytest.approx(8.0)  # too busy for the wall clock
    effort = {row.value: row for row in asset.rows["effort"]}
    assert [round(effort[name].percent) for name in ("fast", "balanced", "best")] == [20, 0, -10] and not effort["best"].by
    assert {row.value: row.by for row in asset.rows["refinement"]} == {"off": [], "auto": [], "render": ["off", "auto"]}
    steps = {(step.knob.name, step.value): step for step in steps_of(assets)}
    said = {key: step.verdict for key, step in steps.items()}
    assert said["effort", "fast"] == SAVES and said["effort", "best"] == BUYS and said["refinement", "render"] == DOMINATED
    assert said["partition", "off"] == BETTER
    assert steps["effort", "best"].bought == pytest.approx(10, abs=0.1)
    assert steps["effort", "fast"].bought == pytest.approx(40, abs=0.1)
    change = {what: names for what, names, *_ in to_change(assets)}
    assert change["partition: auto"] == ["vase", "scan"] and "effort: balanced" not in change
    assert set(beaten_presets(asset)) >= set(RATES) and "support: auto" not in change
    page = page_of(assets, ARGUMENTS, "accuracy_time.png")
    assert "**partition: auto** is dominated on most assets: 2 of 2" in page and "in processor seconds, because" in page
    assert "| effort | balanced to best | +1.00 s, -10.0 % | +1.00 s, -10.0 % | +1.00 s, -10.0 % | 10.0 % | buys bytes |" in page
    assert all(len(line) <= 130 for line in page.splitlines() if not line.startswith("|"))
    rows = list(csv_rows(assets))
    assert len({len(row) for row in rows}) == 1 and len(rows) > 100
    draw(assets, tmp_path / "plot.png")


def test_quality_beyond_the_curve_is_not_guessed():
    settings = settings_of(SCAN, [BY_NAME["effort"]], False)
    measured = {accuracy_bench.key_of(s): made_up(s) for s in settings}
    far = accuracy_bench.key_of(BY_NAME["effort"].settings(SCAN)["best"])
    measured[far].psnr_y = 80.0
    rows = {row.value: row.percent for row in asset_of("vase", SCAN, measured).rows["effort"]}
    assert rows["best"] is None and rows["fast"] is not None


def test_sweep_goes_on_from_its_lines_and_measures_again_under_other_conditions(tmp_path):
    tried, seconds = [], iter([4.0, 1.0, 20.0, 2.0, 1.0, 2.2, 1.0])

    class Fake:
        def run(self, setting, turn):
            tried.append((setting["options"]["qp"], turn))
            took = next(seconds, 3.0)
            return {"processor": took, "wall": 2 * took, "bytes": 1000, "geometry": 50, "psnr_y": None}

    settings, cache = [{"kind": "encode", "options": {"qp": qp}} for qp in (0, 10, 20)], tmp_path / "a.jsonl"
    first = run_settings(settings, Fake, cache, {"asset": "a"}, 3)
    assert tried == [(0, 0), (10, 0), (20, 0), (0, 1), (10, 1), (0, 2), (10, 2)]  # QP 20 has taken too long to be repeated
    assert [m.seconds["processor"] for m in first.values()] == [(2.2, 2.0, 4.0), (1.0, 1.0, 1.0), (20.0, 20.0, 20.0)]
    assert [m.psnr_y for m in first.values()] == [math.inf] * 3 and [m.runs for m in first.values()] == [3, 3, 1]
    with open(cache, "a") as file:
        file.write('{"asset": "a", "set')  # cut off by a kill
    tried.clear()
    assert run_settings(settings, Fake, cache, {"asset": "a"}, 3) == first and tried == []
    run_settings(settings[:1], Fake, cache, {"asset": "a"}, 4)
    assert tried == [(0, 3)]
    run_settings(settings[:1], Fake, cache, {"asset": "b"}, 1)
    assert tried == [(0, 3), (0, 0)]
    assert known_place(cache, {"asset": "a"}, lambda: SCAN) == SCAN == known_place(cache, {"asset": "a"}, lambda: HOUSE)


@pytest.mark.slow
def test_bench_measures_every_kind_of_setting_and_sets_the_density_back():
    usual, scene = (dict(source_field.TRANSFER_DENSITY), source_field.FITTED_DENSITY), painted_sphere(8)
    place = place_of(scene)
    assert place == Place(VOXELS, 512) or place == Place(VOXELS, 1024)
    bench = Bench(scene, Place(VOXELS, 32), 2000, 1, quick=True)
    bench.reference = (8, 64, 20_000)
    options = {"resolution": 32, "effort": "fast", "density": 3}
    fine, coarse, again = (bench.run({"kind": "encode", "options": options | {"qp": qp}, "image": True}, turn)
                           for qp, turn in ((10, 0), (40, 0), (40, 1)))
    assert (source_field.TRANSFER_DENSITY, source_field.FITTED_DENSITY) == usual
    assert fine["processor"] > 0 and fine["bytes"] > coarse["bytes"] == again["bytes"] and "psnr_y" not in again
    assert fine["psnr_y"] > coarse["psnr_y"] and fine["image_y"] > coarse["image_y"]
    views = bench.run({"kind": "views", "views": 8, "size": 64}, 0)
    assert views["errors"] == [0.0]  # the reference itself
    few, many = (bench.run({"kind": "samples", "samples": n}, 0)["errors"] for n in (50, 10_000))
    assert len(few) == accuracy_bench.SEEDS and np.abs(many).max() < np.abs(few).max() and len(set(few)) > 1


def test_command_writes_page_table_and_lines_and_names_a_missing_asset(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(accuracy_time, "place_of", lambda *_: Place(VOXELS, 32))
    monkeypatch.setattr(accuracy_time, "load", lambda path: painted_sphere(8))
    monkeypatch.setattr(accuracy_time, "QUICK_SAMPLES", 2000)
    monkeypatch.setattr(accuracy_bench, "WARM_K", 16)
    monkeypatch.setattr(accuracy_bench, "IMAGE_SIZE", 64)
    asset, page = tmp_path / "ball.ply", tmp_path / "docs" / "page.md"
    asset.write_bytes(b"any")
    page.parent.mkdir()
    given = ["--asset", str(asset), "--knob", "effort", "--quick", "--repeats", "1", "--out", str(tmp_path / "o"),
             "--page", str(page)]
    assert accuracy_time.main(given) == 0
    lines = (tmp_path / "o" / "ball.jsonl").read_text().splitlines()
    assert accuracy_time.main(given) == 0 and (tmp_path / "o" / "ball.jsonl").read_text().splitlines() == lines
    assert "| effort | balanced to fast |" in page.read_text() and "effort: " not in capsys.readouterr().err
    with open(tmp_path / "o" / "points.csv", newline="") as file:
        assert {row["knob"] for row in csv.DictReader(file)} >= {"effort", "QP"}
    assert accuracy_time.main([*given[2:], "--asset", str(asset), "none"]) != 0
    assert "none: there is no such asset" in capsys.readouterr().err


def test_metrics_are_judged_by_their_error_and_curves_stand_at_home():
    assert {knob.name for knob in KNOBS if knob.over == STREAM} == {"views of the metric", "samples of 3D-PSNR"}
    assert all("image" in s for s in curve_settings(HOUSE, TEXELS))
    assert not any("image" in s for s in curve_settings(HOUSE, VOXELS))
