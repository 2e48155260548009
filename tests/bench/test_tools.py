"""The measuring commands of tools/bench/: how they are called, and that what they print agrees with itself."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tools.bench import anchor_bdrate, attribute_tools, neural_time

REPOSITORY = Path(__file__).resolve().parents[2]
SPEEDS = {"enc_mpts", "dec_mpts"}
RATES = {"bd_y", "bd_yuv611", "bd_rgb", "bd_y_area"}
QPS = "22,34,46"
COMMANDS = ("accuracy_time", "anchor_bdrate", "attribute_tools", "collect", "everyday", "neural_time", "pictures", "rate_points")


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """Folder with a coloured and a grey cloud of a wavy sheet of 64 x 64 voxels, and steep anchor curves."""
    folder = tmp_path_factory.mktemp("clouds")
    generator = np.random.default_rng(5)
    x, y = (v.ravel() for v in np.mgrid[:64, :64])
    xyz = np.stack([x, y, (20 + 10 * np.sin(x / 9) * np.cos(y / 7)).astype(int)], 1)
    waves = 128 + 60 * np.sin(xyz @ generator.normal(0, 0.15, (3, 3))) + generator.normal(0, 12, (len(x), 3))
    rgb = np.clip(waves, 0, 255).astype(np.uint8)
    measures = ("psnr_y", "psnr_yuv611", "psnr_rgb", "psnr_y_area")
    anchor = {"K": 64, "points_rd": [{"bytes": 100 * 2**i, **dict.fromkeys(measures, 20 + 5 * i)} for i in range(7)]}
    shuffle = generator.permutation(len(x))
    for name, colours in (("colour", rgb), ("grey", np.repeat(rgb[:, :1], 3, axis=1))):
        np.savez(folder / f"{name}.npz", xyz=xyz[shuffle].astype(np.uint16), rgb=colours[shuffle],
                 area=generator.integers(1, 9, len(x)).astype(np.uint16))
        (folder / f"{name}.json").write_text(json.dumps(anchor))
    return folder


def test_anchor_json_has_every_measure_and_null_for_the_chroma_of_grey(clouds, capsys):
    anchor_bdrate.main(["--clouds", str(clouds), "--qp", QPS, "--json"])
    out, lines = capsys.readouterr()
    result = json.loads(out, parse_constant=pytest.fail)
    assert set(result) == {"clouds", "mean"} and set(result["clouds"]) == {"colour", "grey"}
    assert set(result["mean"]) == RATES | SPEEDS | {"peak_memory_bytes"}
    colour, grey = result["clouds"]["colour"], result["clouds"]["grey"]
    for row in (colour, grey):
        assert set(row) == set(result["mean"]) | {"num_points", "points"} and row["num_points"] == 4096
        assert all(set(row[k]) == {"1", "2"} and min(row[k].values()) > 0 for k in SPEEDS)
        assert [p["qp"] for p in row["points"]] == [22, 34, 46] and row["points"][0]["bytes"] > row["points"][2]["bytes"] > 0
    assert grey["bd_yuv611"] is None and grey["bd_y"] == pytest.approx(grey["bd_rgb"])
    assert result["mean"]["bd_yuv611"] == colour["bd_yuv611"]
    assert result["mean"]["bd_y"] == pytest.approx((colour["bd_y"] + grey["bd_y"]) / 2)
    assert result["mean"]["dec_mpts"]["2"] == pytest.approx((colour["dec_mpts"]["2"] + grey["dec_mpts"]["2"]) / 2)
    assert [line.split()[0] for line in lines.splitlines()] == ["colour", "grey", "mean"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from the process's account in /proc")
def test_decoder_memory_grows_with_the_cloud_and_leaves_the_parent_out(clouds):
    small = anchor_bdrate.load_cloud(clouds / "colour.npz")
    x, y = (v.ravel() for v in np.mgrid[:512, :512])
    keys = np.sort(anchor_bdrate.encode_morton(np.stack([x, y, 0 * x], 1)))
    flat = anchor_bdrate.Cloud(keys, np.full((len(x), 3), 90, np.uint8), np.ones(len(x), np.uint16), 512, [])
    peaks = [anchor_bdrate.decoder_memory(cloud, "fast") for cloud in (small, flat)]
    # this process has numba's compiler in it, more than 100 MiB
    assert 0 <= peaks[0] < 20e6 and peaks[1] > max(peaks[0], flat.keys.size * 3 * 4)


def test_a_folder_without_clouds_is_named(tmp_path):
    with pytest.raises(SystemExit, match="no NAME.npz"):
        anchor_bdrate.main(["--clouds", str(tmp_path)])


def test_attribute_tools_prints_a_row_per_change(clouds, tmp_path, capsys):
    attribute_tools.main(["--clouds", str(clouds), "--qp", QPS, "--out", str(tmp_path / "table.md")])
    assert capsys.readouterr().out == ""
    head, rule, *rows = (tmp_path / "table.md").read_text().splitlines()
    assert head.count("|") == rule.count("|") == 6
    cells = {row.split(" | ")[0].strip("| "): row.strip("| ").split(" | ")[1:] for row in rows}
    assert list(cells) == attribute_tools.changes_at("balanced") and all(len(c) == 4 for c in cells.values())
    assert cells["complete set"][:2] == ["0", "0"] and all(float(s) >= 0 for c in cells.values() for s in c[2:])
    assert float(cells["mixing off"][0]) > 0 and float(cells["no RDO"][0]) > 0


def test_changes_that_are_none_at_an_effort_have_no_row():
    assert attribute_tools.changes_at("fast") == [
        "complete set", "2 models", "4 models", "6 models", "8 models", "components do not follow", "filter of 2 stages",
        "kernel choice off", "no RDO"]
    assert "8 models" not in attribute_tools.changes_at("best") and "kernel choice off" in attribute_tools.changes_at("best")


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_called_as_files_from_anywhere_and_as_modules(command, tmp_path):
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for words, folder in (([REPOSITORY / f"tools/bench/{command}.py"], tmp_path), (["-m", f"tools.bench.{command}"], REPOSITORY)):
        line = [sys.executable, *words, "--help"]
        run = subprocess.run(line, cwd=folder, env=bare, capture_output=True, text=True, check=False)
        assert run.returncode == 0 and run.stdout.startswith("usage:"), run.stderr


def result(setting, group, rate, psnr, steps=None):
    """A row of rate_points.py, as far as neural_time.py reads it."""
    fit = None if steps is None else {"steps": steps, "asked_steps": steps}
    return {"setting": setting, "group": group, "asset": "a", "bytes": {"total": rate + 10, "geometry": 10},
            "seconds": {"encode": {"total": 9e9, "samples": 7, "fit": (steps or 0) / 100}},
            "facts": {} if fit is None else {"fit": fit}, "psnr_3d": {"y": psnr, "rgb": psnr - 2},
            "image": {"psnr": {"y": psnr - 1, "rgb": psnr - 3}}}


def test_fits_of_equal_steps_stand_against_the_rival(tmp_path, monkeypatch):
    rival = [result(f"astc_{n}", "ASTC", 2 * rate, psnr) for n, (rate, psnr) in enumerate([(100, 40), (200, 43), (400, 46)])]
    ours = [result(f"3dntc_{rate}_{steps}", "3DNTC", rate, psnr - (20 if steps == 1 else 0), steps)
            for rate, psnr in ((100, 40), (200, 43), (400, 46)) for steps in (1, 1000)]
    monkeypatch.setattr(neural_time, "read_results", lambda folder: ours + rival)
    monkeypatch.setattr("sys.argv", ["neural_time.py", str(tmp_path), "--out", str(tmp_path)])
    neural_time.main()
    text = (tmp_path / "neural.md").read_text()
    assert "| 1,000 | ASTC | -50.0 % |" in text and "| 1 | ASTC | none |" in text
    assert text.count("3dntc_") == 6 and text.count("astc_") == 3
    assert "| 3dntc_400_1000 | 400 | 1,000 | 17 |" in text  # sampling and fitting, no more


def test_fits_stand_under_their_own_asset(tmp_path, monkeypatch):
    rows = [result(f"3dntc_{rate}_{steps}", "3DNTC", rate - shift, 40, steps) | {"asset": asset}
            for steps in (1, 2) for rate in (100, 200) for asset, shift in (("vase", 0), ("cup", 5))]
    monkeypatch.setattr(neural_time, "read_results", lambda folder: rows)
    monkeypatch.setattr("sys.argv", ["neural_time.py", str(tmp_path), "--out", str(tmp_path)])
    neural_time.main()
    _, vase, cup = (tmp_path / "neural.md").read_text().split("## ")
    for section, name, sizes in ((vase, "vase", ["100", "100", "200", "200"]), (cup, "cup", ["95", "95", "195", "195"])):
        assert section.startswith(name) and re.findall(r"^\| 3dntc_\d+_\d \| (\d+) \|", section, re.MULTILINE) == sizes


def test_tables_of_the_documentation_keep_to_one_asset():
    """Bytes of a fit follow from its asset and the size asked for: rows of another asset show by theirs."""
    tables = {}
    for section in (REPOSITORY / "docs/design/neural.md").read_text(encoding="utf-8").split("\n### "):
        for size, resident in re.findall(r"^\| 3dntc_(\d+)_\d+ \| ([\d,]+) \|", section, re.MULTILINE):
            tables.setdefault(section.splitlines()[0], {}).setdefault(size, set()).add(resident)
    assert set(tables) == {"Basketball player", "Water bottle"}
    assert [name for name, sizes in tables.items() if any(len(found) > 1 for found in sizes.values())] == []
