"""tools/gpu on the processor, at a thousandth of the work: what it measures, and that it goes on where it was cut."""

import json
import subprocess
import sys
import types
from pathlib import Path

import pytest
from asset_strategies import Asset, usual

from tools.gpu import fit, page, prepare, run
from tools.gpu.rows import Context, Row

REPOSITORY = Path(__file__).resolve().parents[2]
HINT = "torch is not installed: pip install texfcodec[ntc]"
KEY = "fit/bottle/mpeg1"


def driver(out, *more):
    command = [sys.executable, "-m", "tools.gpu.run", "--out", out, "--cpu", "--scale", "0.001", *more]
    done = subprocess.run([str(part) for part in command], cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads((out / "gpu.json").read_text())


@pytest.mark.long
def test_a_fit_is_measured_and_a_second_run_measures_what_is_missing(tmp_path):
    pytest.importorskip("torch", reason=HINT)
    (tmp_path / "sheet.glb").write_bytes(Asset((usual("noise"),)).glb())
    prepare.write(prepare.capture(tmp_path / "sheet.glb", ("mpeg1",), 2), tmp_path / "inputs" / "bottle.fit")
    settings = "--inputs", tmp_path / "inputs", "--work", tmp_path / "work", "--only", "fit"
    first = driver(tmp_path / "out", *settings)["rows"]
    assert not [key for key in first if key.endswith("/error")], first
    assert {f"{KEY}/gpu", f"{KEY}/plain", f"{KEY}/cpu_step", "fit/chosen", "fit/bottle/draw"} <= set(first)
    fitted = first[f"{KEY}/gpu"]
    assert fitted["steps"] == 30 and fitted["psnr_db"] > 8 and fitted["engine"] == "plain"
    cut = {key: figures for key, figures in first.items() if key != f"{KEY}/cpu_step"}
    (tmp_path / "out" / "gpu.json").write_text(json.dumps({"machines": [], "rows": cut}))
    second = driver(tmp_path / "out", *settings)
    assert second["rows"].keys() == first.keys() and second["rows"][f"{KEY}/gpu"] == fitted
    assert "water bottle, all maps, mpeg1 | GPU | plain |" in page.page(second)


def test_an_error_of_a_part_is_a_row_beside_those_before_it(tmp_path, monkeypatch):
    def measure(context):
        yield Row("broken/a", {"seconds": 1})
        raise RuntimeError("no such device")

    monkeypatch.setitem(sys.modules, "tools.gpu.broken", types.SimpleNamespace(measure=measure))
    record = run.Record(tmp_path / "gpu.json")
    run.run_alone(Context(tmp_path, tmp_path), "broken", "measure", record)
    kept = run.Record(tmp_path / "gpu.json").rows
    assert kept["broken/a"] == {"seconds": 1} and kept["broken/error"]["error"] == "RuntimeError: no such device"
    assert "broken/error: RuntimeError" in page.page({"machines": [run.machine()], "rows": kept})


def test_the_page_is_made_of_the_rows_that_are_kept():
    kept = json.loads((REPOSITORY / "tools" / "gpu" / "measured.json").read_text())
    assert page.page(kept) == (REPOSITORY / "docs" / "reports" / "gpu.md").read_text()


def test_a_process_that_dies_is_a_row_and_the_next_part_runs(tmp_path, monkeypatch):
    commands = []

    def ended(command, timeout, check):
        commands.append(command[command.index("--only") + 1])
        return types.SimpleNamespace(returncode=-11)

    monkeypatch.setattr(run.subprocess, "run", ended)
    monkeypatch.setattr(run, "machine", dict)
    run.run(types.SimpleNamespace(seconds=100.0, out=tmp_path, arguments=[]), ["fit", "frames"])
    rows = json.loads((tmp_path / "gpu.json").read_text())["rows"]
    assert commands == ["fit", "frames", "fit"] and "code -11" in rows["frames/error"]["error"]


def test_a_part_keeps_to_its_share_of_the_seconds(tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr(run.subprocess, "run", lambda command, timeout, check: given.append(command) or
                        types.SimpleNamespace(returncode=0))
    monkeypatch.setattr(run, "machine", dict)
    run.run(types.SimpleNamespace(seconds=100.0, out=tmp_path, arguments=[]), ["fit", "frames"])
    assert [float(command[command.index("--seconds") + 1]) for command in given] == pytest.approx([50, 50, 100], abs=2)


def test_the_large_point_is_fitted_with_each_batch_for_as_many_steps_and_seconds(tmp_path, monkeypatch):
    milliseconds = lambda settings: settings | {"milliseconds_a_step": settings["batch"] / 65536}
    monkeypatch.setattr(fit, "fitted", lambda context, case, steps, **settings: milliseconds(settings) | {"steps": steps})
    monkeypatch.setattr(fit, "timed", lambda context, case, steps, **settings: settings)
    context = Context(tmp_path, tmp_path)
    for row in fit._large(context, types.SimpleNamespace(key="fit/player/mpeg6"), 30_000):
        context.done[row.key] = row.figures
    rows = {key.removeprefix("fit/player/mpeg6/"): figures for key, figures in context.done.items()}
    assert [rows[f"batch{batch}_float16"]["steps"] for batch in fit.BATCHES] == [30_000] * 3
    assert [rows[f"seconds20_{batch}"]["steps"] for batch in fit.BATCHES] == [320_000, 80_000, 20_000]
    assert [rows[f"block{block}"]["block"] for block in fit.BLOCKS] == list(fit.BLOCKS)


def test_a_processors_fit_that_is_cut_says_how_far_it_came(tmp_path):
    context = Context(tmp_path, tmp_path, work=tmp_path, deadline=0.0)
    (tmp_path / "fit").mkdir()
    (tmp_path / "fit" / "cpu_player_mpeg6.pid").write_text("1")
    (tmp_path / "fit" / "cpu_player_mpeg6.log.json").write_text(json.dumps([{"step": 4500, "seconds": 70.2}]))
    rows = list(fit._cpu_row(context, "player", "mpeg6"))
    assert [row.key for row in rows] == ["fit/player/mpeg6/cpu_kernels_cut"]
    assert rows[0].figures["skipped"] == "the processor's fit had taken 4,500 steps in 70 s when the time was over"
