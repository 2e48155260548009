"""Tables say what the figures of rate_points.py say."""

import csv
import html
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from batches import metrics

from texfcodec.metrics.bd_rate import bd_rate
from tools.bench import collect, page
from tools.bench.differences import Difference, pairs_of, rate_difference, summary
from tools.bench.results import curve_of, quality_of, read_missing, read_results

CURVES = {  # (asset, group): bytes, dB
    ("vase", "old"): ([300, 500, 900, 1700], [30.0, 33.0, 36.0, 39.0]),
    ("vase", "new"): ([280, 460, 830, 1600], [30.2, 33.1, 36.4, 39.2]),
    ("cup", "old"): ([200, 300, 500], [40.0, 42.0, None]),
    ("cup", "new"): ([210, 330, 600], [40.5, 41.9, 44.0]),
    ("lid", "old"): ([200, 300], [20.0, 22.0]),
    ("lid", "new"): ([210, 330], [40.5, 41.9]),
}


HOSTILE = "</script><img src=x onerror=\"document.title=1\"><b>"
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("command", ["ab", "attributes", "collect", "pictures", "rate_points"])
def test_commands_are_called_as_files_from_anywhere_and_as_modules(command, tmp_path):
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for words, folder in (([REPOSITORY / f"tools/bench/{command}.py"], tmp_path), (["-m", f"tools.bench.{command}"], REPOSITORY)):
        line = [sys.executable, *words, "--help"]
        run = subprocess.run(line, cwd=folder, env=bare, capture_output=True, text=True, check=False)
        assert run.returncode == 0 and run.stdout.startswith("usage:"), run.stderr


def write_results(folder, only=None):
    """A results folder of CURVES."""
    for (asset, group), points in CURVES.items():
        for number, (total, y) in enumerate(zip(*points, strict=True)):
            if only in (None, group):
                place = folder / asset / f"{group}{number}"
                place.mkdir(parents=True)
                (place / "metrics.json").write_text(json.dumps(metrics(asset, group, number, total, y, 50.0 + number)))


@pytest.mark.parametrize("kind, less", [("texture", 100), ("total", 0)])
def test_differences_are_those_of_bd_rate(tmp_path, kind, less):
    write_results(tmp_path)
    pair, = pairs_of(read_results(tmp_path), None, anchor_group="old")
    table = pair.differences(kind)
    texture = {key: ([s - less for s in sizes], psnr) for key, (sizes, psnr) in CURVES.items()}
    old_cup = [v[:2] for v in texture["cup", "old"]]  # without the lossless point
    expected = {"vase": bd_rate(*texture["vase", "old"], *texture["vase", "new"]),
                "cup": bd_rate(*old_cup, *texture["cup", "new"])}
    found = {asset: row["3D-PSNR Y"] for asset, row in table.items()}
    assert (pair.name, pair.other) == ("new", "old")
    assert {asset: found[asset].percent for asset in expected} == expected and found["lid"].percent is None
    assert summary(found.values()) == (pytest.approx(np.mean(list(expected.values()))), 2)
    assert "share no quality range" in found["lid"].reason and found["lid"].overlap == 0
    assert found["vase"].overlap == pytest.approx((39.0 - 30.2) / (39.0 - 30.0)) and found["vase"].reason is None
    assert list(table["vase"]) == ["3D-PSNR Y", "3D-PSNR RGB"]  # what nobody has measured is no column


def test_collect_writes_tables(tmp_path):
    write_results(tmp_path / "new", "new")
    write_results(tmp_path / "old", "old")
    collect.main([str(tmp_path / "new"), str(tmp_path / "old"), "--out", str(tmp_path / "out")])
    with open(tmp_path / "out/results.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 9 and rows[0]["bytes.total"] == "210" and rows[0]["warnings"] == "a; b"
    text = (tmp_path / "out/results.md").read_text()
    assert "## BD-rate: new against old" in text and "| **mean** |" in text and "## cup" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in tables if "new0" in line or "setting" in line}) == 1


def test_unknown_groups_and_empty_folders_are_named(tmp_path):
    with pytest.raises(SystemExit, match="no job is finished"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out")])
    write_results(tmp_path)
    with pytest.raises(SystemExit, match="no group 'newest', only new, old"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--anchor-group", "newest"])


def test_median_is_that_of_the_assets_that_have_a_value():
    found = [Difference(percent, 1.0, None) for percent in (-40.0, 10.0, None, -30.0, 90.0)]
    assert summary(found) == (7.5, 4) and summary(found, np.median) == (-10.0, 4)
    assert summary([Difference(None, None, "why")], np.median) == (None, 0)


def image_row(total, **image):
    measured = {"psnr": {"y": 30.0, "rgb": None}, "ssim": None, "lpips": None, **image}
    return metrics("vase", "g", 0, total, 30.0) | {"image": measured}


def test_ssim_is_compared_by_its_distance_from_one_in_decibels():
    """Of two curves that lose the same at half the bytes, -50 %; on SSIM itself the curve between the points would be another."""
    losses = (0.2, 0.05, 0.0125)
    anchor, ours = ([image_row(100 + size * 4**i, ssim=1 - loss) for i, loss in enumerate(losses)]
                    for size in (1000, 500))
    assert [quality_of(row, "SSIM") for row in ours] == pytest.approx([-10 * np.log10(loss) for loss in losses])
    assert rate_difference(anchor, ours, "SSIM") == pytest.approx(-50)
    assert quality_of(image_row(9, ssim=1.0), "SSIM") == np.inf and quality_of(image_row(9), "SSIM") is None
    assert quality_of(image_row(9), "image PSNR RGB") == np.inf


def test_against_several_groups_makes_a_table_of_groups_by_assets_for_each(tmp_path):
    write_results(tmp_path)
    for number, total in enumerate((150, 260, 460)):
        place = tmp_path / f"vase/third{number}"
        place.mkdir()
        (place / "metrics.json").write_text(json.dumps(metrics("vase", "third", number, total, 30.5 + 3 * number)))
    collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--against", "old", "--anchor-group", "third"])
    text = (tmp_path / "out/results.md").read_text()
    assert "## BD-rate against old" in text and "## BD-rate against third" in text
    table = text.partition("## BD-rate against old")[2].partition("### 3D-PSNR Y")[2].splitlines()[2:6]
    assert table[0] == "| group | cup | lid | vase | mean | median |"
    assert [line.split(" | ")[0] for line in table[2:]] == ["| new", "| third"] and table[3].split(" | ")[1:3] == ["-", "-"]
    third = next(pair for pair in pairs_of(read_results(tmp_path), None, None, "old") if pair.name == "third")
    found = third.differences("texture")["vase"]["3D-PSNR Y"]
    assert f"{found.percent:+.2f} ({100 * found.overlap:.0f} %)" in table[3]
    assert "- none for new, lid: the curves share no quality range" in text


def test_missing_rows_are_listed_with_their_reason(tmp_path):
    write_results(tmp_path)
    told = {"setting": "q1", "group": "rival", "method": "elic", "asset": "cup", "state": "missing",
            "reason": "elic is not here; | name it"}
    for place, name, text in (("cup/q1", "missing.json", json.dumps(told)), ("cup/q2", "job.json", json.dumps({"group": "mine"})),
                              ("cup/q2", "log.txt", "Traceback\nValueError: no luck\n\n"), ("cup/new0", "missing.json", "{}")):
        (tmp_path / place).mkdir(exist_ok=True)
        (tmp_path / place / name).write_text(text)
    collect.main([str(tmp_path), "--out", str(tmp_path / "out")])
    assert read_missing(tmp_path) == [told, {
        "asset": "cup", "setting": "q2", "group": "mine", "method": "", "state": "not finished", "reason": "ValueError: no luck"}]
    lines = (tmp_path / "out/results.md").read_text().partition("## Missing")[2].strip().splitlines()
    assert lines[2] == "| rival | elic | missing | cup | 1 | elic is not here; \\| name it |" and len(lines) == 4


def test_kept_rows_make_the_same_tables(tmp_path):
    write_results(tmp_path)
    (tmp_path / "cup/gone").mkdir(parents=True)
    (tmp_path / "cup/gone/missing.json").write_text(json.dumps({"state": "missing", "reason": "not here"}))
    kept, first, second = (tmp_path / name for name in ("rows.jsonl", "first", "second"))
    collect.main([str(tmp_path), "--out", str(first), "--against", "old", "--keep", str(kept)])
    collect.main([str(kept), "--out", str(second), "--against", "old"])
    assert "not here" in (first / "results.md").read_text()
    for name in ("results.md", "results.csv"):
        assert (first / name).read_text() == (second / name).read_text(), name


def test_curves_are_those_that_bd_rates_compare_and_names_stay_text(tmp_path):
    pytest.importorskip("plotly")
    write_results(tmp_path)
    rows = [row | {"group": row["group"] + HOSTILE} for row in read_results(tmp_path) if row["asset"] == "vase"]
    figure = page.figure_of(rows, "texture")
    assert {trace["meta"] for trace in figure["data"]} == {b["label"] for b in figure["layout"]["updatemenus"][0]["buttons"]}
    for trace in figure["data"]:
        group = [row for row in rows if html.escape(row["group"]) == trace["name"]]
        assert (trace["x"], trace["y"]) == curve_of(group, trace["meta"], "texture") and len(trace["x"]) >= 2
    assert page.write_page(tmp_path / "results.html", rows, "texture") > 1e6
    text = (tmp_path / "results.html").read_text(encoding="utf-8")
    assert HOSTILE not in text and "<script src" not in text


def test_tables_do_without_plotly(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "plotly.io", None)
    write_results(tmp_path)
    collect.main([str(tmp_path), "--out", str(tmp_path / "out")])
    assert "texfcodec[plots]" in capsys.readouterr().err and not (tmp_path / "out/results.html").exists()


def test_every_file_and_target_that_docs_name_is_there():
    pages = [REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md")] + sorted((REPOSITORY / "docs").rglob("*.md"))
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    files = set(re.findall(r"tools/[a-z]+/[A-Za-z_/]+\.(?:py|toml|jsonl)", text))
    assert len(files) > 20 and [name for name in files if not (REPOSITORY / name).exists()] == []
    for makefile, pattern in (("tools/Makefile", r"make -C\stools ([a-z0-9-]+)"), ("Makefile", r"`make ([a-z0-9-]+)")):
        targets = set(re.findall(r"^([a-z0-9-]+):", (REPOSITORY / makefile).read_text(encoding="utf-8"), re.MULTILINE))
        assert (named := set(re.findall(pattern, text)) - {"-c"}) and named <= targets | {"-"}, named - targets
    for table in re.findall(r"--table ([a-z]+)", text):
        assert table in collect.TABLES


def test_make_help_has_a_line_for_each_target():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    phony = re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[1].split()
    lines = [name for name in phony if re.search(rf"^{name}:.*  # \w", makefile, re.MULTILINE)]
    assert 12 <= len(phony) <= 14 and lines == phony
