"""The batch tool goes on where it stopped and notices what differs."""

import json
import signal
import subprocess
import sys

import pytest
from batches import REPOSITORY, children_in, environment, stamps, wait_for, write_ball

from texfcodec.batch.folders import WORK
from texfcodec.batch.tasks import DONE, Outcome
from tools.bench import collect
from tools.bench.batch import not_ours, only_run, settle
from tools.bench.conditions import read_conditions
from tools.bench.jobs import Job, jobs_of
from tools.bench.rate_points import main
from tools.bench.results import keep_rows, read_missing, read_results

EVALUATION = "[evaluation]\nsamples = 2000\nviews = 2\nsize = 48\nssim = true\npictures = 1\npicture_size = 32\n"
PLUGIN = '''
import pickle

from tools.bench.methods import Method, method
from tools.bench.methods.texf import TexfMethod


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
    run = subprocess.run([sys.executable, REPOSITORY / "tools/bench/rate_points.py", folder / "all.toml", "--out", folder / "out",
                          "--jobs", "2"], capture_output=True, text=True, check=False, env=environment())
    return folder, run.returncode, run.stdout, run.stderr


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


def test_collect_shows_what_a_batch_has_left_and_what_it_has_not(batch, tmp_path):
    made, metrics = batch[0] / "out", json.loads((batch[0] / "out/ball/carbon/metrics.json").read_text())
    pictures = {path.name for path in (made / "ball/carbon").glob("*.webp")}
    assert metrics["pictures"] == [1] and pictures == {"picture_01.webp", "source_01.webp"}
    collect.main([str(made), "--out", str(tmp_path)])
    text = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert all(f"| {name} |" in text for name in ("qp24", "qp36", "carbon"))
    assert {row["setting"]: row["reason"] for row in read_missing(made)}.keys() == {"small", "unheard", "lie"}
    assert "not those of the encoder" in text.partition("## Missing")[2]


def test_same_command_redoes_only_what_is_not_finished_or_was_asked_otherwise(batch, capsys):
    folder = batch[0]
    before, head = stamps(folder / "out"), 'assets = ["ball"]\n' + EVALUATION
    settings = '[[settings]]\nname = "qp{qp}"\ngroup = "ours"\nresolution = 48\nqp = [24, 36]\n'
    for more, redone in (("", set()), ('effort = "fast"\n', {"ball/qp24", "ball/qp36"})):
        (folder / "some.toml").write_text(head + settings + more)
        assert main([str(folder / "some.toml"), "--out", str(folder / "out"), "--jobs", "2"]) == 0
        after = stamps(folder / "out")
        assert {name for name in before if after[name] != before[name]} == redone
        assert f"{len(redone)} done" in capsys.readouterr().out
        before = after


def test_identities_of_jobs_stay_what_they_were(tmp_path):
    """Else what was measured before would be measured again."""
    (tmp_path / "vase.ply").write_bytes(b"ply of a vase")
    (tmp_path / "c.toml").write_text('assets = ["vase"]\n[evaluation]\nviews = 2\n[[settings]]\nname = "q{qp}"\nqp = [24, 36]\n')
    jobs = jobs_of(read_conditions(tmp_path / "c.toml"), {"vase": tmp_path / "vase.ply"}, tmp_path)
    assert {job.name: job.facts["settings_sha256"] for job in jobs} == {
        "vase/q24": "161caba32d78982db6dd6e186c4427b110e0df15a6fefba31ebb5851011f75eb",
        "vase/q36": "1a271f7a47a5738a2bbf6e0cc5514a0fd4c775e6bd111336deffb1137066fd46"}


def test_jobs_of_other_code_are_redone_unless_kept(batch):
    folder = next((batch[0] / "out").glob("ball/carbon"))
    job = Job(folder, json.loads((folder / "job.json").read_text()))
    other = Job(folder, job.facts | {"code": "another"})
    assert job.metrics() and not other.metrics() and other.metrics(keep_old=True)


def test_kept_rows_stand_for_finished_jobs_elsewhere(batch, tmp_path, capsys):
    folder, rows = batch[0], tmp_path / "rows.jsonl"
    keep_rows(rows, read_results(folder / "out"), read_missing(folder / "out"))
    (folder / "one.toml").write_text('assets = ["ball"]\nplugins = ["more.py"]\n' + EVALUATION + """
[[settings]]
name = "carbon"
method = "carbon"
colour = "red"
""")
    assert main([str(folder / "one.toml"), "--out", str(tmp_path / "out"), "--rows", str(rows)]) == 0
    assert "0 done" in capsys.readouterr().out and read_results(tmp_path / "out") == read_results(rows)
    assert not_ours(tmp_path / "out/ball/carbon") is None


@pytest.fixture
def heeded_interrupt():
    """Ctrl-C as a terminal's child has it: what a script starts in its background ignores it, and hands that on."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="children are looked up in /proc")
def test_killed_and_interrupted_batches_leave_no_child_and_are_resumed(tmp_path, heeded_interrupt, capsys):
    write_ball(tmp_path)
    (tmp_path / "c.toml").write_text('assets = ["ball"]\n[evaluation]\nsamples = 100\nviews = 0\n[[settings]]\nname = "q{qp}"\n'
                                     'resolution = 16\neffort = "fast"\nqp = [24, 36]\n')
    out = tmp_path / "out"
    arguments = [str(tmp_path / "c.toml"), "--out", str(out)]
    kinds = (signal.SIGKILL, "q24", -signal.SIGKILL), (signal.SIGINT, "q36", 130)
    for number, awaited, code in kinds:
        run = subprocess.Popen([sys.executable, REPOSITORY / "tools/bench/rate_points.py", *arguments], stderr=subprocess.DEVNULL,
                               env=environment(), preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
        wait_for(lambda awaited=awaited: any(f'"setting": "{awaited}"' in text for text in job_texts(out)) and children_in(out))
        run.send_signal(number)
        assert run.wait(60) == code
        wait_for(lambda: not children_in(out))
    first = stamps(out)
    assert set(first) == {"ball/q24"}
    assert main(arguments) == 0 and "1 were finished before" in capsys.readouterr().out
    assert set(stamps(out)) == {"ball/q24", "ball/q36"} and stamps(out)["ball/q24"] == first["ball/q24"]


def job_texts(out):
    """job.json of the jobs that are at work."""
    return [path.read_text() for path in out.glob(f"{WORK}/*/*/job.json")]


def test_folder_of_somebody_else_is_left_alone(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("years of work")
    reason = not_ours(tmp_path / "mine")
    assert "left alone" in reason and (tmp_path / "mine/thesis.txt").exists()


def test_a_result_that_is_not_here_fails_its_job(tmp_path):
    assert "not here" in settle(Job(tmp_path / "a", {}), Outcome(DONE), tmp_path / "gone")


def test_two_runs_in_one_folder_are_refused(tmp_path):
    pytest.importorskip("fcntl")
    with only_run(tmp_path), pytest.raises(SystemExit, match="another run is using"):
        with only_run(tmp_path):
            pytest.fail("two at once")


def test_nothing_to_do_is_said(tmp_path, capsys):
    (tmp_path / "c.toml").write_text('assets = ["nowhere"]\n[[settings]]\nname = "a"\n')
    assert main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "none of the assets is there" in capsys.readouterr().err
