"""Many small assets through a Dask cluster on the loopback: nothing is lost, the streams are those of texf-enc alone, and what
Dask adds to a task.

Encodes show that the results are right, and what they take with and without Dask. What Dask itself adds is too small to be seen
beside them, so naps go the same way, from cluster.Run over scheduler and worker and back, with a sleep in the encoder's place.
"""

import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from texfcodec.batch import cluster
from texfcodec.batch.folders import only_run, work_room
from texfcodec.batch.local import run_here
from texfcodec.batch.tasks import DONE, Outcome, Task, package_code

REPOSITORY = Path(__file__).resolve().parents[2]
WORKERS = 2, 4, 8
ENCODED, NAPS = 8, 1000  # assets, and tasks that sleep, for each number of workers
NAP_SECONDS = 0.05
OPTIONS = ("--resolution", "16", "--qp", "30", "--effort", "fast", "--no-check")
STREAM, PATIENCE = "stream.texf", 180  # seconds until the workers are there
NAP_TARGET = 0.05  # processor seconds of client and scheduler together for a task: a hundredth of the smallest encode


def nap(task, size, room, sent):
    """In the place of cluster.work: sleeps, and answers as a worker does that has run a task."""
    from distributed import get_worker

    time.sleep(NAP_SECONDS)
    return cluster.Answer(Outcome(DONE), get_worker().address, task.name)


def write_assets(folder, count):
    """Paths of so many PLY files of a few hundred faces, each different."""
    from shapes import painted_sphere

    from texfcodec.api import decode
    from texfcodec.encoder.encode import encode_scene
    from texfcodec.options import EncodeOptions

    folder.mkdir()
    paths = [folder / f"{i:04d}.ply" for i in range(count)]
    for i, path in enumerate(paths):
        scene = painted_sphere(8 + i % 5, seed=i)
        decode(encode_scene(scene, EncodeOptions(resolution=16, qp=20, effort="fast", threads=1)).data).save(path)
    return paths


def encodes(paths):
    """A Task of each asset, as texf-enc --batch makes them."""
    words = ("-m", "texfcodec.cli.enc", "{input}", "{folder}/" + STREAM, "--quiet", "--threads", "{threads}", *OPTIONS)
    return [Task(name=path.stem, commands=(("encode", words),), input=path, package=package_code()) for path in paths]


@contextmanager
def loopback(workers, folder):
    """(address, scheduler, [worker]) of a cluster of processes, workers of one thread each; ended after it."""
    from distributed import Client

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    variables = os.environ | {"PYTHONPATH": str(REPOSITORY)}

    def start(*words):
        return subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                                cwd=folder, env=variables)

    processes = [start("distributed.cli.dask_scheduler", "--host", address, "--no-dashboard")]
    try:
        processes += [start("distributed.cli.dask_worker", address, "--no-nanny", "--no-dashboard", "--nthreads", "1",
                            "--local-directory", str(folder / f"worker {i}")) for i in range(workers)]
        with Client(address, timeout=PATIENCE, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)
        yield address, processes[0], processes[1:]
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


def spent(process):
    """Processor seconds of a process and of those of its children that have ended."""
    words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK")


def spent_here(who=resource.RUSAGE_SELF):
    """Processor seconds of this process, or of its children that have ended."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def collected(run, tasks, out):
    """(seconds by the wall clock, {name: (state, stream or None)}, how many ended twice). run(tasks, room, ended)."""
    found, twice, begin = {}, 0, time.monotonic()

    def ended(task, outcome, folder):
        nonlocal twice
        stream = folder / STREAM
        twice += task.name in found
        found[task.name] = outcome.state, stream.read_bytes() if stream.exists() else None

    with only_run(out), work_room(out) as room:
        run(tasks, room, ended)
    return time.monotonic() - begin, found, twice


def alone(tasks, out):
    """A row of the tasks without Dask, two at a time, and {name: (state, stream)}."""
    begin = spent_here(resource.RUSAGE_CHILDREN)
    seconds, found, _ = collected(lambda some, room, ended: run_here(some, 2, room, ended), tasks, out)
    return {"seconds": seconds, "processor": spent_here(resource.RUSAGE_CHILDREN) - begin}, found


def encode_of(path):
    """{"seconds": of the processor that texf-enc takes for a file, its kernels compiled, "bytes": of the stream}."""
    command = [sys.executable, "-m", "texfcodec.cli.enc", str(path), str(path.with_suffix(".texf")), "--quiet"]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    begin = spent_here(resource.RUSAGE_CHILDREN)
    subprocess.run(command, cwd=REPOSITORY, check=True)
    return {"seconds": spent_here(resource.RUSAGE_CHILDREN) - begin, "bytes": path.with_suffix(".texf").stat().st_size}


def on_cluster(tasks, workers, out, expected=None):
    """A row of the tasks on a cluster. expected: {name: (state, stream)} that must come back; None: any outcome that is DONE."""
    out.mkdir(exist_ok=True)
    with loopback(workers, out) as (address, scheduler, helpers):
        before = spent(scheduler), sum(map(spent, helpers)), spent_here()
        seconds, found, twice = collected(
            lambda some, room, ended: cluster.run_there(some, address, room, ended, lambda text: None), tasks, out / "run")
        after = spent(scheduler), sum(map(spent, helpers)), spent_here()
    used = dict(zip(("scheduler", "helpers", "client"), (b - a for a, b in zip(before, after, strict=True)), strict=True))
    wrong = [name for name, answer in found.items() if (answer != expected[name] if expected else answer[0] != DONE)]
    return {"workers": workers, "tasks": len(tasks), "seconds": seconds, **used, "twice": twice, "wrong": wrong,
            "lost": sorted({task.name for task in tasks} - found.keys())}


def run_cluster(encoded=ENCODED, naps=NAPS):
    """What is measured: {"alone": row, "encodes": [row], "naps": [row], "sample": of the demo asset at its default rate
    {"seconds": of the processor, "bytes": of the stream}, "load": the load average of the machine}."""
    from texfcodec.demo.asset import write_sample

    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = write_assets(folder / "assets", encoded)
        tasks = encodes(paths)
        single, streams = alone(tasks, folder / "alone")
        single["failed"] = [name for name, (state, stream) in streams.items() if state != DONE or not stream]
        write_sample(folder / "sample.glb")
        sample = encode_of(folder / "sample.glb")
        rows = [on_cluster(tasks, workers, folder / f"{workers} workers", streams) for workers in WORKERS]
        idle = [Task(name=f"nap {i}", commands=(), input=paths[0]) for i in range(naps)]
        with patch.object(cluster, "work", nap):
            idle_rows = [on_cluster(idle, workers, folder / f"{workers} napping") for workers in WORKERS]
    return {"alone": single, "encodes": rows, "naps": idle_rows, "sample": sample, "load": load}


def overhead_of(row):
    """Processor seconds that client and scheduler take for a task."""
    return (row["scheduler"] + row["client"]) / row["tasks"]


def cluster_faults(found):
    """Sentences on what misses its target."""
    faults = [f"{name} was not encoded alone" for name in found["alone"]["failed"]]
    for kind in ("encodes", "naps"):
        for row in found[kind]:
            for key, what in (("lost", "lost"), ("wrong", "another result")):
                faults += [f"{kind}, {row['workers']} workers, {name}: {what}" for name in row[key]]
            if row["twice"]:
                faults.append(f"{kind}, {row['workers']} workers: {row['twice']} tasks ended twice")
    return faults + [f"{row['workers']} workers: client and scheduler take {overhead_of(row):.3f} s a task"
                     for row in found["naps"] if overhead_of(row) > NAP_TARGET]
