"""What tests/load/run.py measures of many assets: a batch through faults, and tasks through a Dask cluster.

Encodes on the cluster show that the results are right, and what they take with and without Dask. What Dask itself adds is too
small to be seen beside them, so naps go the same way, from cluster.Run over scheduler and worker and back.
"""

import json
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np

from load.parts import HERE, REPOSITORY, coded
from texfcodec.api import decode, inspect
from texfcodec.batch import cluster
from texfcodec.batch.folders import LOCK, WORK, only_run, work_room
from texfcodec.batch.local import run_here
from texfcodec.batch.tasks import DONE, Outcome, Task, package_code
from texfcodec.errors import TexfError

# A batch with faults

ENC = (sys.executable, "-m", "texfcodec.cli.enc")
GOOD, KILLS, STOPS = 18, 6, 3  # good assets, encoders killed, batches killed
DISK, SMALL_FILE = 24 << 10, 400  # bytes of a disk that is soon full, and that a file may have where files may not grow
OPTIONS = ("--resolution", "24", "--qp", "30", "--effort", "fast")
CODES = {"broken.glb": "TXF-I07", "gone.stl": "TXF-I01", "empty.obj": None, "huge.ply": None, "noise.ply": None, "cut.glb": None}
HUGE = ("ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 4000000000\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n")


def write_spheres(folder, count, faces, form=lambda i: "{:04d}.ply"):
    """Names of so many small painted spheres in a folder, each another; faces: a side, for a number."""
    from shapes import painted_sphere

    names = [form(i).format(i) for i in range(count)]
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        small = {} if name.endswith(".ply") else {"texture_size": 32}
        decode(coded(painted_sphere(faces + i % 5, seed=i), resolution=16, qp=20, threads=1)).save(folder / name, **small)
    return names


def write_catalogue(folder, count):
    """Names of `count` good assets, PLY, GLB and OBJ in turn; those of CODES are written beside them."""
    good = write_spheres(folder, count, 3, lambda i: f"part {i % 4}/{{:03d}}{('.ply', '.glb', '.obj')[i % 3]}")
    whole = (folder / "part 1" / "001.glb").read_bytes()
    for name, data in (("cut.glb", whole[: len(whole) // 2]), ("broken.glb", b"glTF and no more"), ("empty.obj", b""),
                       ("noise.ply", random.Random(0).randbytes(4000)), ("huge.ply", HUGE.encode())):
        (folder / name).write_bytes(data)
    (folder / "gone.stl").symlink_to(folder / "nowhere.stl")
    return good


UNWRITTEN = HERE | {"PYTHONDONTWRITEBYTECODE": "1"}  # Python keeps a module that a full disk has cut short


class Day:
    """One folder of results and how often the batch was tried. tries: a row for each try."""

    def __init__(self, catalogue, out):
        self.catalogue, self.out, self.tries, self.random = catalogue, out, [], random.Random(1)

    def words(self, out):
        """The command."""
        return [*ENC, "--batch", str(self.catalogue), "--out", str(out), "--jobs", "2",
                "--limit-seconds", "60", "--memory-limit", str(2 << 30), *OPTIONS]

    def start(self, **keywords):
        """The batch as a process."""
        return subprocess.Popen(self.words(self.out), cwd=REPOSITORY, env=UNWRITTEN, stdout=subprocess.DEVNULL,
                                stderr=subprocess.DEVNULL, **keywords)

    def note(self, fault, code):
        """Keeps how a try ended; returns its exit code."""
        self.tries.append({"fault": fault, "exit code": code, "streams": len(list(self.out.rglob("*.texf")))})
        return code

    def encoders(self):
        """Process ids of the encoders of the batch."""
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes()
            except OSError:
                continue
            if os.fsencode(self.out / WORK) in words and b"batch.child" in words:
                yield int(path.parent.name)

    def kill_encoders(self, kills):
        """Encoders are killed as they come; what they coded fails, the batch goes on to its end."""
        run, killed = self.start(), 0
        while run.poll() is None:
            there = list(self.encoders()) if killed < kills else []
            if there:
                try:
                    os.kill(self.random.choice(there), signal.SIGKILL)
                    killed += 1
                except ProcessLookupError:
                    pass
            time.sleep(self.random.uniform(0.3, 1.5))
        self.note(f"{killed} encoders killed", run.returncode)

    def kill(self):
        """The batch itself is killed once it has begun to code; how many of its encoders do not end with it."""
        run = self.start()
        while run.poll() is None and not list(self.encoders()):
            time.sleep(0.05)
        time.sleep(self.random.uniform(0, 2))
        run.kill()
        run.wait()
        end = time.monotonic() + 20
        while list(self.encoders()) and time.monotonic() < end:
            time.sleep(0.1)
        self.note("the batch killed", run.returncode)
        return len(list(self.encoders()))

    def limit_files(self):
        """No file may have more than SMALL_FILE bytes."""
        run = self.start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_FILE, SMALL_FILE)))
        self.note(f"no file may have more than {SMALL_FILE} bytes", run.wait())

    def fill_disk(self):
        """The results are on a disk of DISK bytes, which are kept when it is full; False where the system mounts none."""
        with tempfile.TemporaryDirectory() as folder:
            mount = ["unshare", "-Urm", "sh", "-c", f'mount -t tmpfs -o size={DISK} none "$0" && "$@"; code=$?; '
                     f'mkdir -p "{self.out}"; cp -a "$0"/. "{self.out}"/; exit $code', folder]
            try:
                if subprocess.run([*mount[:2], "mount", "-t", "tmpfs", "none", folder], capture_output=True).returncode:
                    return False
            except OSError:
                return False
            run = subprocess.run([*mount, *self.words(Path(folder))], cwd=REPOSITORY, env=UNWRITTEN, capture_output=True)
            self.note(f"a disk of {DISK >> 10} kB", run.returncode)
        return True

    def unsound(self):
        """Streams that cannot be read to their end."""
        for path in self.out.rglob("*.texf"):
            try:
                inspect(path)
            except TexfError:
                yield f"a stream is cut short: {path.name}"

    def wrong_streams(self, good):
        """What is wrong with the streams in the end: each must be that of texf-enc alone, and there must be no other file."""
        wanted, alone = {}, self.out.parent / "alone.texf"
        for name in good:
            subprocess.run([*ENC, str(self.catalogue / name), str(alone), "--quiet", *OPTIONS], cwd=REPOSITORY, check=True)
            wanted[str(Path(name).with_suffix(".texf"))] = alone.read_bytes()
        found = {path.relative_to(self.out).as_posix(): path.read_bytes() for path in self.out.rglob("*") if path.is_file()}
        for name in (LOCK, "results.jsonl"):
            found.pop(name, None)
        yield from (f"no stream of {name}" for name in wanted.keys() - found.keys())
        yield from (f"left behind: {name}" for name in found.keys() - wanted.keys())
        yield from (f"another stream of {name}" for name in wanted.keys() & found.keys() if wanted[name] != found[name])

    def wrong_lines(self, good):
        """What is wrong with the last line of every asset in results.jsonl."""
        rows = {row["asset"]: row for row in map(json.loads, (self.out / "results.jsonl").read_text().splitlines())}
        yield from (f"no line, or an error, of {name}" for name in good if "stream" not in rows.get(name, {}))
        for name, code in CODES.items():
            error = rows.get(name, {}).get("error")
            if error is None or (code and error["code"] != code) or error["exit_code"] not in (2, 3, 5, 6):
                yield f"{name} has the answer {error}"


def run_batch(count=GOOD, kills=KILLS, stops=STOPS):
    """{"assets", "bad", "tries", "faults", "mounted", "seconds"}: a batch through a day of faults, the same command each time."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        good = write_catalogue(top / "meshes", count)
        day = Day(top / "meshes", top / "out")
        mounted = day.fill_disk()
        faults = list(day.unsound())
        day.limit_files()
        day.kill_encoders(kills)
        faults += [f"{left} encoders outlive their batch" for left in [day.kill() for _ in range(stops)] if left]
        day.note("none", day.start().wait())
        again = day.note("none, once more", day.start().wait())
        faults += [*day.wrong_streams(good), *day.wrong_lines(good)]
        faults += [] if again == 7 else [f"the last try ends with {again}, where 7 says that bad assets are left"]
        return {"assets": count, "bad": len(CODES), "tries": day.tries, "faults": faults, "mounted": mounted,
                "seconds": time.monotonic() - begin}


# Through a Dask cluster

WORKERS, ENCODED, NAPS, NAP_SECONDS = (2, 4, 8), 8, 1000, 0.05  # assets, and tasks that sleep, for each number of workers
STREAM, PATIENCE = "stream.texf", 180  # seconds until the workers are there
ENCODE = ("-m", "texfcodec.cli.enc", "{input}", "{folder}/" + STREAM, "--quiet", "--threads", "{threads}", "--resolution", "16",
          "--qp", "30", "--effort", "fast", "--no-check")


def nap(task, size, room, sent):
    """In the place of cluster.work: sleeps, and answers as a worker does that has run a task."""
    from distributed import get_worker

    time.sleep(NAP_SECONDS)
    return cluster.Answer(Outcome(DONE), get_worker().address, task.name)


@contextmanager
def loopback(workers, folder):
    """(address, scheduler, [worker]) of a cluster of processes, workers of one thread each; ended after it."""
    from distributed import Client

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    lines = [("scheduler", "--host", address, "--no-dashboard"), *(
        ("worker", address, "--no-nanny", "--no-dashboard", "--nthreads", "1", "--local-directory", str(folder / f"worker {i}"))
        for i in range(workers))]
    processes = [subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{role}", *words], stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL, cwd=folder, env=HERE) for role, *words in lines]
    try:
        with Client(address, timeout=PATIENCE, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)
        yield address, processes[0], processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _spent(process):
    """Processor seconds of a process and of those of its children that have ended."""
    words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK")


def _spent_here(who=resource.RUSAGE_SELF):
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def _collected(run, tasks, out):
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


def on_cluster(tasks, workers, out, expected=None):
    """A row of the tasks on a cluster. expected: {name: (state, stream)} that must come back; None: any outcome that is DONE."""
    out.mkdir(exist_ok=True)
    with loopback(workers, out) as (address, scheduler, helpers):
        spent = lambda: np.array([_spent(scheduler), sum(map(_spent, helpers)), _spent_here()])
        before = spent()
        seconds, found, twice = _collected(
            lambda some, room, ended: cluster.run_there(some, address, room, ended, lambda text: None), tasks, out / "run")
        used = dict(zip(("scheduler", "helpers", "client"), (spent() - before).tolist(), strict=True))
    bad = [name for name, answer in found.items() if (answer != expected[name] if expected else answer[0] != DONE)]
    return {"workers": workers, "tasks": len(tasks), "seconds": seconds, **used, "twice": twice, "wrong": bad,
            "lost": sorted({task.name for task in tasks} - found.keys())}


def _sample_cost(folder):
    """{"seconds" of the processor that texf-enc takes for the demo asset, its kernels compiled, "bytes" of the stream}."""
    from texfcodec.demo.asset import write_sample

    write_sample(folder / "sample.glb")
    for _ in range(2):
        begin = _spent_here(resource.RUSAGE_CHILDREN)
        subprocess.run([*ENC, str(folder / "sample.glb"), str(folder / "sample.texf"), "--quiet"], cwd=REPOSITORY, check=True)
    return {"seconds": _spent_here(resource.RUSAGE_CHILDREN) - begin, "bytes": (folder / "sample.texf").stat().st_size}


def run_cluster(encoded=ENCODED, naps=NAPS, workers=WORKERS):
    """{"alone": row without Dask, two at a time, "encodes": [row], "naps": [row], "sample": the demo asset's cost, "load": the
    load average of the machine}."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [folder / "assets" / name for name in write_spheres(folder / "assets", encoded, 8)]
        tasks = [Task(name=path.stem, commands=(("encode", ENCODE),), input=path, package=package_code()) for path in paths]
        begin = _spent_here(resource.RUSAGE_CHILDREN)
        seconds, streams, _ = _collected(lambda some, room, ended: run_here(some, 2, room, ended), tasks, folder / "alone")
        single = {"seconds": seconds, "processor": _spent_here(resource.RUSAGE_CHILDREN) - begin,
                  "failed": [name for name, (state, stream) in streams.items() if state != DONE or not stream]}
        rows = [on_cluster(tasks, count, folder / f"{count} workers", streams) for count in workers]
        idle = [Task(name=f"nap {i}", commands=(), input=paths[0]) for i in range(naps)]
        with patch.object(cluster, "work", nap):
            idle_rows = [on_cluster(idle, count, folder / f"{count} napping") for count in workers]
        return {"alone": single, "encodes": rows, "naps": idle_rows, "sample": _sample_cost(folder), "load": load}
