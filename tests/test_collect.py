"""Tables say what the figures of rate_points.py say."""

import csv
import json
import sys

import numpy as np
import pytest

from texfcodec.quality.bd_rate import bd_rate
from tools import collect


def metrics(asset, group, number, total, y, rgb=None):
    return {"asset": asset, "group": group, "setting": f"{group}{number}", "package": "0", "code": "c", "bytes":
            {"total": total, "geometry": 100, "attributes": total - 100}, "psnr_3d": {"y": y, "rgb": rgb or y - 1, "samples": 9},
            "image": None, "seconds": {"encode": {"total": 1.5}, "decode": {"total": 0.5}},
            "memory": {"encode": {"peak": 2e8}, "decode": {"peak": None}}, "warnings": ["a", "b"]}


CURVES = {  # (asset, group): bytes, dB
    ("vase", "old"): ([300, 500, 900, 1700], [30.0, 33.0, 36.0, 39.0]),
    ("vase", "new"): ([280, 460, 830, 1600], [30.2, 33.1, 36.4, 39.2]),
    ("cup", "old"): ([200, 300, 500], [40.0, 42.0, None]),
    ("cup", "new"): ([210, 330, 600], [40.5, 41.9, 44.0]),
    ("lid", "old"): ([200, 300], [20.0, 22.0]),
    ("lid", "new"): ([210, 330], [40.5, 41.9]),
}


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
    (name, anchor, ours), = collect.pairs_of(collect.read_results(tmp_path), None, anchor_group="old")
    table, notes = collect.differences(anchor, ours, kind)
    texture = {key: ([s - less for s in sizes], psnr) for key, (sizes, psnr) in CURVES.items()}
    old_cup = [v[:2] for v in texture["cup", "old"]]  # without the lossless point
    expected = {"vase": bd_rate(*texture["vase", "old"], *texture["vase", "new"]),
                "cup": bd_rate(*old_cup, *texture["cup", "new"])}
    assert name == "new against old"
    assert {a: table[a]["3D-PSNR Y"] for a in expected} == expected and table["lid"]["3D-PSNR Y"] is None
    assert collect.mean_of(table)["3D-PSNR Y"] == (pytest.approx(np.mean(list(expected.values()))), 2)
    assert any("lid: the curves share no quality range" in note for note in notes)
    assert collect.mean_of(table)["image PSNR Y"] == (None, 0)


def test_collect_writes_tables_and_does_without_matplotlib(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    write_results(tmp_path / "new", "new")
    write_results(tmp_path / "old", "old")
    collect.main([str(tmp_path / "new"), str(tmp_path / "old"), "--out", str(tmp_path / "out")])
    assert "texfcodec[plots]" in capsys.readouterr().err
    with open(tmp_path / "out/results.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 9 and rows[0]["bytes.total"] == "210" and rows[0]["warnings"] == "a; b"
    text = (tmp_path / "out/results.md").read_text()
    assert "## BD-rate: new against old" in text and "| **mean** |" in text and "## cup" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in tables if "new0" in line or "setting" in line}) == 1


def test_collect_draws_each_asset(tmp_path):
    pytest.importorskip("matplotlib")
    write_results(tmp_path)
    collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--anchor-group", "old"])
    assert {p.name for p in (tmp_path / "out").glob("*.png")} == {"vase.png", "cup.png", "lid.png"}


def test_unknown_groups_and_empty_folders_are_named(tmp_path):
    with pytest.raises(SystemExit, match="no job is finished"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out")])
    write_results(tmp_path)
    with pytest.raises(SystemExit, match="no group 'newest', only new, old"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--anchor-group", "newest"])
