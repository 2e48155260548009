"""A day's worth of texf-enc --batch in miniature: a catalogue with bad assets, and faults while it is worked through.

Encoders are killed, the batch itself is, the disk is full, files may not grow; after each the same command is called again. In
the end every good asset must have the stream that it has when coded alone, every bad one a coded error, and nothing else may be
left.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from texfcodec.batch.folders import LOCK, WORK

REPOSITORY = Path(__file__).resolve().parents[2]
OPTIONS = ("--resolution", "24", "--qp", "30", "--effort", "fast")
CAPS = ("--limit-seconds", "60", "--memory-limit", str(2 << 30))
GOOD = 18
KILLS, STOPS = 6, 3  # encoders killed, and batches
DISK = 24 << 10  # bytes of a disk that is soon full
SMALL_FILE = 400  # bytes that a file may have where files may not grow
CODES = {"broken.glb": "TXF-I07", "gone.stl": "TXF-I01", "empty.obj": None, "huge.ply": None, "noise.ply": None, "cut.glb": None}


def write_catalogue(folder, count):
    """`count` good assets, PLY, GLB and OBJ in turn, and those of CODES; {name of a good one: the stream it becomes}."""
    from shapes import painted_sphere

    from texfcodec.api import decode
    from texfcodec.encoder.encode import encode_scene
    from texfcodec.options import EncodeOptions

    folder.mkdir(parents=True)
    good = {}
    for i in range(count):
        name = f"{i:03d}{('.ply', '.glb', '.obj')[i % 3]}"
        coded = encode_scene(painted_sphere(3 + i % 5, seed=i), EncodeOptions(resolution=16, qp=20, effort="fast", threads=1))
        place = folder / f"part {i % 4}"
        place.mkdir(exist_ok=True)
        decode(coded.data).save(place / name, **({} if i % 3 == 0 else {"texture_size": 32}))
        good[f"{place.name}/{name}"] = None
    whole = (folder / "part 1" / "001.glb").read_bytes()
    (folder / "cut.glb").write_bytes(whole[: len(whole) // 2])
    (folder / "broken.glb").write_bytes(b"glTF and no more")
    (folder / "empty.obj").write_bytes(b"")
    (folder / "noise.ply").write_bytes(random.Random(0).randbytes(4000))
    (folder / "huge.ply").write_text("ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
                                     "property float z\nelement face 4000000000\nproperty list uchar int vertex_indices\n"
                                     "end_header\n0 0 0\n")
    (folder / "gone.stl").symlink_to(folder / "nowhere.stl")
    return list(good)


class Day:
    """One folder of results and how often it was tried. said: a line for each try."""

    def __init__(self, catalogue, out):
        self.catalogue, self.out, self.said, self.random = catalogue, out, [], random.Random(1)

    def words(self, out=None):
        """The command."""
        return [sys.executable, "-m", "texfcodec.cli.enc", "--batch", str(self.catalogue), "--out", str(out or self.out),
                "--jobs", "2", *CAPS, *OPTIONS]

    def start(self, **keywords):
        """The batch as a process."""
        return subprocess.Popen(self.words(), cwd=REPOSITORY, env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **keywords)

    def note(self, what, code):
        """Keeps what a try came to."""
        made = len(list(self.out.rglob("*.texf"))) if self.out.exists() else 0
        self.said.append({"fault": what, "exit code": code, "streams": made})
        print(f"{what}: exit code {code}, {made} streams", flush=True)


def encoders_in(out):
    """Numbers of the processes that code into the working folder of a batch."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes()
        except OSError:
            continue
        if os.fsencode(out / WORK) in words and b"batch.child" in words:
            found.append(int(path.parent.name))
    return found


def with_killed_encoders(day, kills=KILLS):
    """Encoders are killed as they come; what they coded fails, the batch goes on to its end."""
    run, killed = day.start(), 0
    while run.poll() is None:
        found = encoders_in(day.out) if killed < kills else []
        if found:
            try:
                os.kill(day.random.choice(found), signal.SIGKILL)
                killed += 1
            except ProcessLookupError:
                pass
        time.sleep(day.random.uniform(0.3, 1.5))
    day.note(f"{killed} encoders killed", run.returncode)


def with_killed_batch(day):
    """The batch itself is killed once it has begun to code; its encoders must end with it: number of those that do not."""
    run = day.start()
    while run.poll() is None and not encoders_in(day.out):
        time.sleep(0.05)
    time.sleep(day.random.uniform(0, 2))
    run.kill()
    run.wait()
    end = time.monotonic() + 20
    while encoders_in(day.out) and time.monotonic() < end:
        time.sleep(0.1)
    day.note("the batch killed", run.returncode)
    return len(encoders_in(day.out))


def with_small_files(day):
    """No file may have more than SMALL_FILE bytes."""
    import resource

    run = day.start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL_FILE, SMALL_FILE)))
    day.note(f"no file may have more than {SMALL_FILE} bytes", run.wait())


def with_full_disk(day):
    """The results are on a disk of DISK bytes, which are kept when it is full; False where the system mounts none."""
    with tempfile.TemporaryDirectory() as folder:
        mount = ["unshare", "-Urm", "sh", "-c", f'mount -t tmpfs -o size={DISK} none "$0" && "$@"; code=$?; '
                 f'mkdir -p "{day.out}"; cp -a "$0"/. "{day.out}"/; exit $code', folder]
        try:
            if subprocess.run([*mount[:2], "mount", "-t", "tmpfs", "none", folder], capture_output=True, check=False).returncode:
                return False
        except OSError:
            return False
        words = day.words(Path(folder))
        run = subprocess.run([*mount, *words], cwd=REPOSITORY, env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
                             capture_output=True, check=False)
        day.note(f"a disk of {DISK >> 10} kB", run.returncode)
    return True


def run_batch(count=GOOD, kills=KILLS, stops=STOPS):
    """{"assets", "tries", "faults", "seconds", "mounted"}: the day, and what was wrong with it."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        good = write_catalogue(top / "meshes", count)
        day = Day(top / "meshes", top / "out")
        mounted = with_full_disk(day)
        faults = [f"a stream is cut short: {name}" for name in unsound(day.out)]
        with_small_files(day)
        with_killed_encoders(day, kills)
        left = [with_killed_batch(day) for _ in range(stops)]
        faults += [f"{number} encoders outlive their batch" for number in left if number]
        day.note("none", day.start().wait())
        again = day.start().wait()
        day.note("none, once more", again)
        faults += [*wrong_streams(day, good), *wrong_lines(day, good)]
        faults += [] if again == 7 else [f"the last try ends with {again}, where 7 says that bad assets are left"]
        return {"assets": count, "bad": len(CODES), "tries": day.said, "faults": faults, "mounted": mounted,
                "seconds": time.monotonic() - begin}


def unsound(out):
    """Names of streams in a folder that cannot be read to their end."""
    from texfcodec.api import inspect
    from texfcodec.errors import TexfError

    for path in out.rglob("*.texf"):
        try:
            inspect(path)
        except TexfError:
            yield path.name


def wrong_streams(day, good):
    """What is wrong with the streams in the end: each must be that of texf-enc alone, and there must be no other file."""
    wanted = {}
    for name in good:
        alone = day.out.parent / "alone.texf"
        subprocess.run([sys.executable, "-m", "texfcodec.cli.enc", str(day.catalogue / name), str(alone), "--quiet", *OPTIONS],
                       cwd=REPOSITORY, check=True)
        wanted[str(Path(name).with_suffix(".texf"))] = alone.read_bytes()
    found = {path.relative_to(day.out).as_posix(): path.read_bytes() for path in day.out.rglob("*") if path.is_file()}
    for name in (LOCK, "results.jsonl"):
        found.pop(name, None)
    yield from (f"no stream of {name}" for name in wanted.keys() - found.keys())
    yield from (f"left behind: {name}" for name in found.keys() - wanted.keys())
    yield from (f"another stream of {name}" for name in wanted.keys() & found.keys() if wanted[name] != found[name])


def wrong_lines(day, good):
    """What is wrong with the last line of every asset in results.jsonl."""
    rows = {row["asset"]: row for row in map(json.loads, (day.out / "results.jsonl").read_text().splitlines())}
    yield from (f"no line, or an error, of {name}" for name in good if "stream" not in rows.get(name, {}))
    for name, code in CODES.items():
        told = rows.get(name, {}).get("error")
        if told is None or (code and told["code"] != code) or told["exit_code"] not in (2, 3, 5, 6):
            yield f"{name} has the answer {told}"


def batch_faults(found):
    """What was wrong: sentences."""
    return found["faults"]
