"""The batch tool goes on where it stopped and notices what differs; its tables and fronts say what the figures say."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from shapes import painted_sphere

from texfcodec.quality.bd_rate import bd_rate

REPOSITORY = Path(__file__).resolve().parents[1]
EVALUATION = "[evaluation]\nsamples = 2000\nviews = 2\nsize = 48\nssim = true\n"
PLUGIN = '''
import pickle

from baselines import Method, method
from baselines.texf import TexfMethod


@method("liar")
class Liar(TexfMethod):
    """Ours, with a wrong hash of the reconstruction."""

    def encode(self, *arguments):
        return super().encode(*arguments) | {"reconstruction_sha256": "0" * 64}


@method("carbon")
class Carbon(Method):
    """Hands the source through."""

    options = ("colour",)

    def encode(self, scene, options, folder, threads, report):
        (folder / "scene").write_bytes(pickle.dumps(scene))
        return {"bytes": {"total": 12, "geometry": 4}, "reconstruction_sha256": None, "colour": options["colour"]}

    def decode(self, folder, options, threads, report):
        return pickle.loads((folder / "scene").read_bytes())
'''


@pytest.fixture(autouse=True)
def tools_path(monkeypatch):
    monkeypatch.syspath_prepend(str(REPOSITORY / "tools"))


def write_ball(folder):
    """ball.ply, a small sphere with vertex colours."""
    scene = painted_sphere(8)
    colours = np.zeros((len(scene.positions), 3), np.int64)
    colours[scene.faces] = np.rint(255 * np.clip(scene.corner_color[..., :3], 0, 1))
    head = ["ply", "format ascii 1.0", f"element vertex {len(scene.positions)}", *(f"property float {c}" for c in "xyz"),
            *(f"property uchar {c}" for c in ("red", "green", "blue")), f"element face {len(scene.faces)}",
            "property list uchar int vertex_indices", "end_header"]
    rows = [f"{x:.6f} {y:.6f} {z:.6f} {r} {g} {b}" for (x, y, z), (r, g, b) in zip(scene.positions, colours, strict=True)]
    (folder / "ball.ply").write_text("\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in scene.faces)]) + "\n")


def stamps(out):
    """{ASSET/SETTING: time at which it was finished}."""
    return {p.parent.relative_to(out).as_posix(): p.stat().st_mtime_ns for p in out.glob("*/*/metrics.json")}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """A folder after a batch in which some jobs must fail: (folder, exit code, stdout, stderr)."""
    folder = tmp_path_factory.mktemp("batch")
    write_ball(folder)
    (folder / "broken.glb").write_bytes(b"glTF but no more than that")
    (folder / "more.py").write_text(PLUGIN)
    head = 'assets = ["sample", "ball", "broken", "nowhere"]\nplugins = ["more.py"]\n' + EVALUATION
    (folder / "all.toml").write_text(head + '''
[[settings]]
name = "qp{qp}"
group = "ours"
assets = ["ball", "nowhere"]
resolution = 48
qp = [24, 36]
[[settings]]
name = "small"
assets = ["sample", "broken"]
resolution = 64
effort = "fast"
[[settings]]
name = "unheard"
assets = ["ball"]
effort = "heroic"
[[settings]]
name = "lie"
assets = ["ball"]
method = "liar"
resolution = 32
[[settings]]
name = "carbon"
assets = ["ball"]
method = "carbon"
colour = "red"
''')
    run = subprocess.run([sys.executable, REPOSITORY / "tools/rate_points.py", folder / "all.toml", "--out", folder / "out",
                          "--jobs", "2"], capture_output=True, text=True, check=False, env=environment())
    return folder, run.returncode, run.stdout, run.stderr


def environment():
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))}


def test_failed_jobs_give_exit_7_and_stop_no_other(batch):
    folder, code, out, err = batch
    assert code == 7, err
    assert set(stamps(folder / "out")) == {"ball/qp24", "ball/qp36", "ball/carbon", "sample/small"}
    assert "7 jobs: 4 done" in out and "3 failed" in out and "1 assets passed over" in out and "nowhere" in err
    for name, reason in (("broken/small", "TXF-I33"), ("ball/unheard", "effort"), ("ball/lie", "not those of the encoder")):
        assert any(name in line and reason in line for line in out.splitlines()), out
        assert (folder / "out" / name / "log.txt").stat().st_size and (folder / "out" / name / "job.json").exists()
    assert len([line for line in err.splitlines() if line.startswith("[")]) == 7


def test_metrics_hold_what_was_promised(batch):
    out = batch[0] / "out"
    fine, coarse = (json.loads((out / f"ball/qp{qp}/metrics.json").read_text()) for qp in (24, 36))
    assert fine["bytes"]["total"] == (out / "ball/qp24/stream.texf").stat().st_size > coarse["bytes"]["total"]
    assert fine["psnr_3d"]["y"] > coarse["psnr_3d"]["y"] and fine["psnr_3d"]["samples"] == 2000
    assert fine["image"]["psnr"]["rgb"] > coarse["image"]["psnr"]["rgb"] and 0 < fine["image"]["ssim"] <= 1
    assert fine["reconstruction_sha256"] == fine["decoded_sha256"] != coarse["decoded_sha256"]
    for side, stage in (("encode", "attributes"), ("decode", "voxelise")):
        assert fine["seconds"][side]["total"] >= fine["seconds"][side][stage] > 0
        assert fine["memory"][side]["peak"] >= (fine["memory"][side]["idle"] or 0)
    job = json.loads((out / "ball/qp24/job.json").read_text())
    assert job["settings_sha256"] == fine["settings_sha256"] and len(job["asset_sha256"]) == 64 and job["code"] == fine["code"]


def test_method_that_decodes_to_a_mesh_is_measured_too(batch):
    made = json.loads((batch[0] / "out/ball/carbon/metrics.json").read_text())
    assert made["psnr_3d"]["y"] is None or made["psnr_3d"]["y"] > 50
    assert made["image"]["psnr"]["rgb"] is None and made["facts"] == {"colour": "red"}


def test_same_command_redoes_only_what_is_not_finished_or_was_asked_otherwise(batch, capsys):
    import rate_points

    folder = batch[0]
    before, head = stamps(folder / "out"), 'assets = ["ball"]\n' + EVALUATION
    settings = '[[settings]]\nname = "qp{qp}"\ngroup = "ours"\nresolution = 48\nqp = [24, 36]\n'
    for more, redone in (("", set()), ('effort = "fast"\n', {"ball/qp24", "ball/qp36"})):
        (folder / "some.toml").write_text(head + settings + more)
        assert rate_points.main([str(folder / "some.toml"), "--out", str(folder / "out"), "--jobs", "2"]) == 0
        after = stamps(folder / "out")
        assert {name for name in before if after[name] != before[name]} == redone
        assert f"{len(redone)} done" in capsys.readouterr().out
        before = after


def test_jobs_of_other_code_are_redone_unless_kept(batch):
    import rate_points

    folder = next((batch[0] / "out").glob("ball/carbon"))
    job = rate_points.Job(folder, json.loads((folder / "job.json").read_text()))
    other = rate_points.Job(folder, job.facts | {"code": "another"})
    assert job.metrics() and not other.metrics() and other.metrics(keep_old=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="children are looked up in /proc")
def test_killed_and_interrupted_batches_leave_no_child_and_are_resumed(tmp_path, capsys):
    import rate_points

    write_ball(tmp_path)
    (tmp_path / "c.toml").write_text('assets = ["ball"]\n' + EVALUATION + '[[settings]]\nname = "q{qp}"\nresolution = 32\n'
                                     "qp = [24, 36]\n")
    out = tmp_path / "out"
    arguments = [str(tmp_path / "c.toml"), "--out", str(out)]
    kinds = (signal.SIGKILL, "q24", -signal.SIGKILL), (signal.SIGINT, "q36", 130)
    for number, awaited, code in kinds:
        run = subprocess.Popen([sys.executable, REPOSITORY / "tools/rate_points.py", *arguments], stderr=subprocess.DEVNULL,
                               env=environment(), preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
        wait_for(lambda awaited=awaited: (out / "ball" / awaited / "job.json").exists() and children_in(out))
        run.send_signal(number)
        assert run.wait(20) == code
        wait_for(lambda: not children_in(out))
    first = stamps(out)
    assert set(first) == {"ball/q24"}
    assert rate_points.main(arguments) == 0 and "1 were finished before" in capsys.readouterr().out
    assert set(stamps(out)) == {"ball/q24", "ball/q36"} and stamps(out)["ball/q24"] == first["ball/q24"]


def wait_for(condition, seconds=30):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def children_in(out):
    """Command lines of live processes that work on a job of this folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"--step" in words and any(word.startswith(os.fsencode(out)) for word in words):
            found.append(words)
    return found


def test_folder_of_somebody_else_is_left_alone(tmp_path):
    import rate_points

    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("years of work")
    reason = rate_points.run_job(rate_points.Job(tmp_path / "mine", {}), rate_points.Children())
    assert "left alone" in reason and (tmp_path / "mine/thesis.txt").exists()


def test_two_runs_in_one_folder_are_refused(tmp_path):
    import rate_points

    pytest.importorskip("fcntl")
    with rate_points.only_run(tmp_path), pytest.raises(SystemExit, match="another run is at work"):
        with rate_points.only_run(tmp_path):
            pytest.fail("two at once")


SETTING = '[[settings]]\nname = "a"\n'


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("assets = [\n", "c.toml: .*at end of document"),
        ('assets = "sample"\n' + SETTING, "assets must be a list of names"),
        ("assets = []\n" + SETTING, "assets is empty"),
        ('assets = ["sample"]\n', r"no \[\[settings\]\] table"),
        ('asset = ["sample"]\n' + SETTING, "unknown key 'asset'; there are assets, "),
        ('assets = ["sample"]\n[evaluation]\nviews = -1\n' + SETTING, "views must be a whole number, 0 or more, not -1"),
        ('assets = ["sample"]\n[evaluation]\nssim = 1\n' + SETTING, "ssim must be true or false"),
        ('assets = ["sample"]\n[[settings]]\nqp = 3\n', "number 1 has no name"),
        ('assets = ["sample"]\n' + SETTING + SETTING, "two settings are called 'a'"),
        ('assets = ["sample"]\n' + SETTING + "quality = 3\n", "number 1 .'a'. has an unknown key 'quality'; there are .*, qp, "),
        ('assets = ["sample"]\n' + SETTING + 'method = "mp3"\n', "there is no method 'mp3', only .*texf"),
        ('assets = ["sample"]\n' + SETTING + 'assets = ["vase"]\n', "'vase' is none of the file's assets"),
        ('assets = ["sample"]\n' + SETTING + "qp = []\n", r"qp must be text, a number, .* not \[\]"),
        ('assets = ["sample"]\n' + SETTING + "qp = 1979-05-27\n", "qp must be text, a number"),
        ('assets = ["sample"]\n[[settings]]\nname = "{rate}"\nqp = 3\n', "may only use .* not 'rate'"),
        ('assets = ["sample"]\n[[settings]]\nname = "../a"\n', "no folder name"),
        ('assets = ["sample"]\nplugins = ["none.py"]\n' + SETTING, "none.py cannot be loaded"),
    ],
)
def test_mistakes_in_conditions_are_named(tmp_path, text, sentence):
    import rate_points

    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(SystemExit, match=sentence):
        rate_points.main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_committed_conditions_are_sound():
    import rate_points

    for path in sorted((REPOSITORY / "conditions").glob("*.toml")):
        conditions = rate_points.read_conditions(path)
        assert "sample" in conditions["assets"] and conditions["settings"]
    assert len(rate_points.read_conditions(REPOSITORY / "conditions/paper.toml")["settings"]) == 18


def test_nothing_to_do_is_said(tmp_path, capsys):
    import rate_points

    (tmp_path / "c.toml").write_text('assets = ["nowhere"]\n' + SETTING)
    assert rate_points.main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "none of the assets is there" in capsys.readouterr().err


# collect.py


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
    import collect

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
    import collect

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
    import collect

    write_results(tmp_path)
    collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--anchor-group", "old"])
    assert {p.name for p in (tmp_path / "out").glob("*.png")} == {"vase.png", "cup.png", "lid.png"}


def test_unknown_groups_and_empty_folders_are_named(tmp_path):
    import collect

    with pytest.raises(SystemExit, match="no job is finished"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out")])
    write_results(tmp_path)
    with pytest.raises(SystemExit, match="no group 'newest', only new, old"):
        collect.main([str(tmp_path), "--out", str(tmp_path / "out"), "--anchor-group", "newest"])


# accuracy_time.py


def test_front_is_what_no_other_beats_beyond_the_noise_of_time():
    from accuracy_time import BYTES, DECIBELS, SECONDS, dominators

    given = [(1.0, 100, -30.0), (1.04, 100, -30.0), (2.0, 100, -30.0), (2.0, 90, -30.0), (1.03, 90, -31.0), (0.5, 200, -20.0)]
    costs = [(math.log(seconds), math.log(size), quality) for seconds, size, quality in given]
    assert dominators(costs, (SECONDS, BYTES, DECIBELS)) == [[4], [4], [0, 1, 3, 4], [4], [], []]
    assert dominators(costs, ((0, 0), BYTES, DECIBELS)) == [[], [0, 4], [0, 1, 3, 4], [4], [], []]
    a_hair_better = [(0.0, 9.0, -30.0), (0.0, 8.9995, -30.005)]
    assert dominators(a_hair_better, (SECONDS, BYTES, DECIBELS)) == [[], []]


@pytest.mark.parametrize("seed", range(5))
def test_some_point_is_on_every_front_and_none_beats_itself_or_back(seed):
    from accuracy_time import BYTES, DECIBELS, SECONDS, dominates, dominators

    axes = SECONDS, BYTES, DECIBELS
    costs = [tuple(row) for row in np.random.default_rng(seed).integers(0, 4, (40, 3)) * [0.03, 0.0007, 0.007]]
    found = dominators(costs, axes)
    assert any(not by for by in found) and all(i not in by for i, by in enumerate(found))
    assert not any(dominates(a, b, axes) and dominates(b, a, axes) for a in costs for b in costs)


def test_quality_at_equal_bytes_follows_the_slope():
    from accuracy_time import equal_bytes_quality, slope_at

    sizes, psnr = [400, 100, 200, 800], [34.0, 30.0, 32.0, 36.0]  # 2 dB a doubling
    assert slope_at(sizes, psnr, 300) == pytest.approx(2.0) == slope_at(sizes[:2], psnr[:2], 100)
    assert equal_bytes_quality(36.0, 800, 200, 2.0) == pytest.approx(32.0)


def test_sweep_holds_every_preset_once_and_the_defaults_first():
    from accuracy_time import BASE, RATES, Point, sweep

    points = sweep(False)
    assert len(points) == len(set(points)) and points[0] == Point(*BASE) == sweep(True)[0]
    assert {Point(*rate) for rate in RATES.values()} <= set(points) and len(sweep(True)) < 12
    assert len({p.name for p in points}) == len(points)


def test_sweep_goes_on_from_its_lines_and_measures_again_under_other_conditions(tmp_path):
    from accuracy_time import Point, run_sweep

    tried, seconds = [], iter([4.0, 1.0, 2.0, 1.0, 2.2, 1.0])

    class Fake:
        def run(self, point, with_quality):
            tried.append((point.qp, with_quality))
            return {"seconds": next(seconds, 3.0), "bytes": 1000 - point.qp, "geometry": 50,
                    "psnr_y": 60.0 - point.qp if with_quality and point.qp else None}

    points, cache = [Point(64, qp) for qp in (0, 10, 20)], tmp_path / "points.jsonl"
    first = run_sweep(points[:2], Fake, cache, {"asset": "a"})
    assert tried == [(0, True), (10, True), (0, False), (10, False), (0, False), (10, False)]
    assert [(m.seconds, m.bytes, m.psnr_y) for m in first] == [(2.2, 1000, math.inf), (1.0, 990, 50.0)]
    assert first[0].spread == pytest.approx(1.0)
    with open(cache, "a") as file:
        file.write('{"asset": "a", "poi')  # cut off by a kill
    tried.clear()
    assert run_sweep(points[:2], Fake, cache, {"asset": "a"}) == first and tried == []
    assert len(run_sweep(points, Fake, cache, {"asset": "a"})) == 3 and tried == [(20, True), (20, False), (20, False)]
    run_sweep(points, Fake, cache, {"asset": "b"})
    assert len(tried) == 12
    assert len(run_sweep(points, Fake, cache, {"asset": "a"})) == 3 and len(tried) == 12


def test_report_names_what_beats_a_preset(tmp_path):
    from accuracy_time import RATES, Measured, Point, claims, draw, report, weigh, write_csv

    def row(point, seconds=1.0, factor=1.0, gain=0.0):
        return Measured(point, seconds, round(factor * 2 ** (20 - point.qp / 6)), 50, 60.0 - point.qp + gain)

    points = [row(Point(1024, 28)), *(row(Point(1024, qp)) for qp in (24, 32, 36))]
    points += [row(Point(1024, 28, "fast"), 0.5, 1.1), row(Point(1024, 28, density=6), 1.2, gain=-0.1),
               row(Point(1024, 32, "fast"), 0.5, 0.9)]
    there, beaten, slope = weigh(points)
    assert slope == pytest.approx(6.0, abs=0.05) and [m.name for m in there][0] == "K 1024 QP 28"
    assert [bool(by) for by in beaten] == [False, False, True]
    said = dict(zip(RATES, claims(points), strict=True))
    assert "on the front" in said["r03"] and "not in this sweep" in said["r06"]
    assert "dominated by K 1024 QP 32 fast" in said["r02"]
    text = report("vase", points, there, beaten, slope)
    assert "log2(bytes / B0)" in text and "5 %" in text and text.count("front |") >= 2
    write_csv(points, tmp_path / "points.csv")
    assert len((tmp_path / "points.csv").read_text().splitlines()) == len(points) + 1
    draw(points, there, beaten, tmp_path / "points.png")


def test_bench_measures_and_sets_the_density_back():
    from accuracy_time import TRANSFER_DENSITY, Bench, Point

    usual, bench = dict(TRANSFER_DENSITY), Bench(painted_sphere(8), 2000, 1)
    fine, coarse, unasked = (bench.run(Point(32, qp, "fast", density=3), asked) for qp, asked in ((10, 1), (40, 1), (40, 0)))
    assert TRANSFER_DENSITY == usual and fine["seconds"] > 0 and unasked["psnr_y"] is None
    assert fine["bytes"] > coarse["bytes"] == unasked["bytes"] and fine["psnr_y"] > coarse["psnr_y"]
