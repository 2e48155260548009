"""Jobs on a Dask cluster: a real scheduler and real workers on the loopback, some of them killed."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from batches import REPOSITORY, children_in, environment, stamps, wait_for, write_ball

from texfcodec.batch.cluster import files_of, run_there
from texfcodec.batch.folders import WORK, only_run, work_room
from texfcodec.batch.tasks import Task, package_code
from texfcodec.errors import InputError
from tools.bench.rate_points import main

pytest.importorskip("distributed", reason='pip install "texfcodec[cluster]"')
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="children are looked up in /proc")
CONDITIONS = """assets = ["ball"]
[evaluation]
samples = 100
views = 0
[[settings]]
name = "q{qp}"
resolution = 16
effort = "fast"
qp = [24, 30]
"""


def start(*words, folder):
    """A part of Dask as a process; what it says goes to a file."""
    with open(folder / "dask.log", "ab") as log:
        return subprocess.Popen([sys.executable, "-m", *words], stdout=log, stderr=log, cwd=folder, env=environment(),
                                start_new_session=True)


def end(process):
    """Kills it with what it has started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait()


class Loopback:
    """A scheduler, and workers that come and go; folder: theirs."""

    scheduler = None

    def __init__(self):
        self.workers = []

    def begin(self, folder):
        """A scheduler is there after it, and what is started from here on works in the folder."""
        self.folder = folder
        if self.scheduler and self.scheduler.poll() is None:
            return
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.scheduler = start("distributed.cli.dask_scheduler", "--host", self.address, "--no-dashboard", folder=folder)

    def worker(self, name, *words):
        """A worker of one thread without a nanny, so that a kill is for good."""
        self.workers.append(start("distributed.cli.dask_worker", self.address, "--no-nanny", "--no-dashboard", "--nthreads", "1",
                                  "--local-directory", str(self.folder / name), *words, folder=self.folder))
        return self.workers[-1]


@pytest.fixture(scope="module")
def loopback():
    """The one scheduler of these tests, but after the one that ends it."""
    made = Loopback()
    yield made
    end(made.scheduler)


@pytest.fixture
def cluster(loopback, tmp_path):
    """A cluster without a worker; those that a test starts end with it."""
    loopback.begin(tmp_path)
    yield loopback
    while loopback.workers:
        end(loopback.workers.pop())


def begin_batch(folder, cluster):
    """rate_points.py as a process, in a folder that gets the ball and CONDITIONS."""
    write_ball(folder)
    (folder / "c.toml").write_text(CONDITIONS)
    command = [sys.executable, REPOSITORY / "tools/bench/rate_points.py", folder / "c.toml", "--out", folder / "out"]
    return subprocess.Popen([*command, "--scheduler", cluster.address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            env=environment(), preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))


@pytest.mark.slow
@LINUX
def test_a_killed_worker_costs_only_its_own_job_and_an_interrupt_its_children(cluster, tmp_path):
    """The second client, in a folder of its own, is interrupted in the middle; the first sees nothing of it."""
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    first = begin_batch(tmp_path / "one", cluster)
    assert "has no workers" in first.stderr.readline()
    victim = cluster.worker("victim")
    wait_for(lambda: children_in(tmp_path / "one/out"))
    lost = child_pids(tmp_path / "one/out")
    os.kill(victim.pid, signal.SIGKILL)
    wait_for(lambda: not lost & child_pids(tmp_path / "one/out"))
    cluster.worker("heir")
    second = begin_batch(tmp_path / "two", cluster)
    wait_for(lambda: children_in(tmp_path / "two/out"))
    second.send_signal(signal.SIGINT)
    said = second.communicate(timeout=60)[1]
    assert second.returncode == 130 and "the same command resumes it" in said
    wait_for(lambda: not children_in(tmp_path / "two/out"))
    out, said = first.communicate(timeout=120)
    assert first.returncode == 0 and "2 jobs: 2 done" in out and "0 failed" in out, out + said
    assert len([line for line in said.splitlines() if line.startswith("[")]) == 2
    assert set(stamps(tmp_path / "one/out")) == {"ball/q24", "ball/q30"}
    assert not (tmp_path / "one/out" / WORK).exists() and not children_in(tmp_path / "one/out")


def child_pids(out):
    """Of the processes that work on a job of this folder."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_text()
        except OSError:
            continue
        if "--step" in line and str(out) in line:
            found.add(path.parent.name)
    return found


LOOK = '''
import json, resource, sys
from pathlib import Path
source, folder, threads = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
names = sorted(path.relative_to(source.parents[1]).as_posix() for path in source.parents[1].rglob("*") if path.is_file())
(folder / "answer.json").write_text(json.dumps({
    "source": str(source), "names": names, "folder": str(folder), "threads": threads,
    "memory": resource.getrlimit(resource.RLIMIT_DATA)[0]}))
'''
BLIND = '''
from texfcodec.batch import cluster
cluster._sees = cluster._has = lambda *_: False
'''


def ended_tasks(cluster, tasks, out):
    """{name: (outcome, what the script LOOK found or None)} of tasks that ran on the cluster."""
    found = {}

    def ended(task, outcome, folder):
        answer = folder / "answer.json"
        found[task.name] = outcome, json.loads(answer.read_text()) if answer.exists() else None

    with only_run(out), work_room(out) as room:
        run_there(tasks, cluster.address, room, ended, print)
    return found


@pytest.fixture
def script(tmp_path):
    """A function: the commands that run a script of this text on the asset, in the folder, with the threads."""

    def commands(text):
        path = tmp_path / f"{len(list(tmp_path.glob('*.py')))}.py"
        path.write_text(text)
        return (("look", (str(path), "{input}", "{folder}", "{threads}")),)

    return commands


def test_a_worker_hands_on_its_caps_and_what_is_not_of_its_code_or_too_slow_is_told(cluster, script, tmp_path):
    cluster.worker("thin", "--memory-limit", "3GB", "--resources", "texf=1")
    source = tmp_path / "a.txt"
    source.write_text("asset")
    fits = Task(name="fits", commands=script(LOOK), input=source, threads=7, package=package_code())
    tasks = [fits, replace(fits, name="foreign", package="another"),
             replace(fits, name="slow", commands=script("import threading; threading.Event().wait(60)"), seconds=0.7),
             replace(fits, name="crashed", commands=script("import os; os.abort()"), memory=1 << 30)]
    found = ended_tasks(cluster, tasks, tmp_path / "out")
    assert {name: outcome.state for name, (outcome, _) in found.items()} == {
        "fits": "done", "foreign": "unsuited", "slow": "overdue", "crashed": "failed"}
    answer = found["fits"][1]
    assert (answer["threads"], answer["memory"]) == (1, 3_000_000_000)
    assert answer["source"] == str(source) and answer["folder"].startswith(str(tmp_path / "out" / WORK))
    assert "another version of texfcodec" in found["foreign"][0].reason and "longer than 0.7 s" in found["slow"][0].reason
    assert "signal 6, with a memory limit of 1073741824 bytes" in found["crashed"][0].reason


def test_without_a_shared_folder_assets_and_results_go_through_the_scheduler(cluster, script, tmp_path):
    (tmp_path / "blind.py").write_text(BLIND)
    cluster.worker("blind", "--preload", str(tmp_path / "blind.py"))
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/a.obj").write_text("mtllib ../looks/a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "looks").mkdir()
    (tmp_path / "looks/a.mtl").write_text("newmtl a\nKd 1 0 0\n")
    task = Task(name="look", commands=script(LOOK), input=tmp_path / "meshes/a.obj")
    tasks = [replace(task, name=f"look {n}", files={"job.json": str(n)}) for n in range(3)]
    found = ended_tasks(cluster, tasks, tmp_path / "out")
    assert [outcome.state for outcome, _ in found.values()] == ["done"] * 3
    for _, answer in found.values():
        assert answer["names"] == ["looks/a.mtl", "meshes/a.obj"]
        assert not answer["source"].startswith(str(tmp_path / "meshes")) and str(tmp_path / "out") not in answer["folder"]
    write_ball(tmp_path)
    (tmp_path / "c.toml").write_text(CONDITIONS.replace("[24, 30]", "[30]"))
    assert main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "real"), "--scheduler", cluster.address]) == 0
    made = json.loads((tmp_path / "real/ball/q30/metrics.json").read_text())
    assert made["bytes"]["total"] == (tmp_path / "real/ball/q30/stream.texf").stat().st_size
    assert {path.name for path in (tmp_path / "real/ball/q30").iterdir()} >= {"job.json", "encode.json", "log.txt"}
    assert not list((tmp_path / "blind").rglob("stream.texf"))


def test_files_of_an_asset_are_those_that_the_loader_opens_under_the_names_that_it_uses(tmp_path):
    """Though one is a link; and one that cannot be loaded is itself."""
    (tmp_path / "a.obj").write_text("mtllib looks/a.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/b.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "looks").symlink_to("elsewhere")
    (tmp_path / "looks/a.mtl").symlink_to("b.mtl")
    (tmp_path / "link").symlink_to(tmp_path)
    assert list(files_of(tmp_path / "link/a.obj")) == ["a.obj", "looks/a.mtl"]
    (tmp_path / "broken.glb").write_bytes(b"glTF and no more")
    assert files_of(tmp_path / "broken.glb") == {"broken.glb": tmp_path / "broken.glb"}


def test_a_cluster_that_cannot_be_reached_is_said_once_its_time_is_up(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("texfcodec.batch.cluster.CONNECT_SECONDS", 0.5)
    write_ball(tmp_path)
    (tmp_path / "c.toml").write_text(CONDITIONS)
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        address, begin = f"tcp://127.0.0.1:{taken.getsockname()[1]}", time.monotonic()
        assert main([str(tmp_path / "c.toml"), "--out", str(tmp_path / "out"), "--scheduler", address]) == 2
    said = capsys.readouterr().err
    assert "TXF-C05" in said and address in said and "Traceback" not in said and time.monotonic() - begin < 10


def test_a_scheduler_that_goes_away_ends_the_run_and_keeps_what_is_done(cluster, script, tmp_path):
    cluster.worker("short")
    source = tmp_path / "a.txt"
    source.write_text("asset")
    quick = Task(name="quick", commands=script(LOOK), input=source)
    endless = replace(quick, name="endless", commands=script("import threading; threading.Event().wait(600)"))
    done = []

    def ended(task, outcome, folder):
        done.append((task.name, outcome.state))
        end(cluster.scheduler)

    with only_run(tmp_path / "out"), work_room(tmp_path / "out") as room, pytest.raises(InputError, match="is gone"):
        run_there([quick, endless], cluster.address, room, ended, print)
    assert done == [("quick", "done")]
