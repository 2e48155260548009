"""Interrupts the seven tools at random moments of their runs and says where one of them does not end as it should.

    python tests/interrupts.py [--moments 300] [--jobs 2] [--seed 0] [--tool texf-enc] [--cold] [--kill]

A run must end with 130, one line on stderr (with --json one object on stdout), no child, no temporary and an untouched OUT; or
with 0 and the whole result, where it had finished. Moments count from the first line of texfcodec.cli on, which the script knows
by the thread that waits for the signal; what an interpreter says before it is not ours. Needs Linux's /proc.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
INTERRUPTED = b"error TXF-C02: interrupted; nothing was written\n"
TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
end_header
0.""" + 2000 * "0" + """ 0 0 0 0 0
1 0 0 250 0 0
0 1 0 0 250 0
0 0 1 0 0 250
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
CHILD_SECONDS = 20.0  # after which children of a killed process must be gone
COLD_SECONDS = 20.0  # of a run that compiles its kernels, the part that is tried
SMALL = ("--resolution", "64", "--qp", "24")
RUNS = {
    "texf-enc": [("{mesh}", "{out}/a.texf", *SMALL)],
    "texf-dec": [("{stream}", "{out}/a.glb"), ("{stream}", "{out}/a.obj", "--isolate", "--overwrite"),
                 ("{stream}", "{out}/a.gltf", "--atlas", "quality", "--overwrite")],
    "texf-info": [("{stream}",), ("{stream}", "--verify")],
    "texf-validate": [("{stream}",), ("{stream}", "--isolate")],
    "texf-render": [("{stream}", "{out}/a.png", "--size", "256"),
                    ("{stream}", "{out}/a.png", "--size", "256", "--compare", "{mesh}")],
    "texf-eval": [("{mesh}", "{stream}", "--views", "2", "--size", "128")],
    "texf-view": [("{stream}", "--export", "{out}/a.html")],
}  # fmt: skip


class Ended:
    """How one run ended: code, out and said (stderr without progress lines), seconds from its first line on, what its output
    folder held before and after, names of temporaries it left, whether children outlived it."""

    def __init__(self, subject, folder, moment=None, flags=(), sent=signal.SIGINT):
        top = Path(tempfile.mkdtemp(dir=folder))
        place, scratch = top / "out", top / "scratch"
        place.mkdir()
        scratch.mkdir()
        for name in subject.files or ():
            (place / name).write_bytes(b"old")
        self.before = contents(place)
        run = subject.start(folder, place, scratch, flags)
        begin = wait_for_first_line(run)
        if moment is not None:
            time.sleep(moment)
            run.send_signal(sent)
        self.out, said = run.communicate(timeout=600)
        self.code, self.seconds = run.returncode, time.monotonic() - begin
        self.said = b"".join(line for line in said.splitlines(True) if not line.startswith(b"progress: "))
        deadline = time.monotonic() + (CHILD_SECONDS if sent == signal.SIGKILL else 0)
        while group_lives(run.pid) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.after, self.left, self.children = contents(place), [path.name for path in scratch.iterdir()], group_lives(run.pid)
        self.again = None
        if self.code == -signal.SIGKILL:
            second = subject.start(folder, place, scratch, subject.overwrite)
            second.communicate(timeout=600)
            self.again = second.returncode, contents(place)
        shutil.rmtree(top)


class Subject:
    """One command, how long it takes from its first line on, and the files of a whole run."""

    def __init__(self, tool, arguments, folder, environment):
        self.tool, self.arguments, self.environment, self.files = tool, arguments, environment, None
        for _ in range(2):  # the first may be slow
            whole = Ended(self, folder)
            if whole.code != 0:
                raise SystemExit(f"{self.name} fails without any interrupt: {whole.said.decode()}")
        self.files, self.seconds = whole.after, whole.seconds

    @property
    def overwrite(self):
        """What the command lacks to run again where its output stands."""
        return ("--overwrite",) if self.tool == "texf-dec" and "--overwrite" not in self.arguments else ()

    @property
    def name(self):
        return f"{self.tool} {' '.join(word for word in self.arguments if not word.startswith('{'))}".strip()

    def start(self, folder, place, scratch, flags):
        """The process, in a group of its own, with SIGINT as a shell in the foreground gives it."""
        names = {"mesh": folder / "mesh.ply", "stream": folder / "stream.texf", "out": place}
        words = [word.format(**names) for word in self.arguments]
        program = [sys.executable, "-m", "texfcodec.cli." + self.tool.removeprefix("texf-"), *words, *flags]
        return subprocess.Popen(program, cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                env=self.environment | {"TMPDIR": str(scratch)}, start_new_session=True,
                                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))

    def faults_of_killed(self, ended):
        """What is wrong after a run that could not see its end coming: sentences."""
        if ended.children:
            yield "leaves a child process"
        for name in sorted(set(self.files) & ended.after.keys()):
            if ended.after[name] not in (self.files[name], b"old"):
                yield f"leaves a part of {name}"
        if strange := sorted(name for name in ended.after if name not in self.files and not name.startswith(".")):
            yield f"leaves {strange} in sight"
        code, files = ended.again
        if code or any(files.get(name) != data for name, data in self.files.items()):
            yield f"cannot be run again: it ends with {code}"

    def faults(self, ended, as_json):
        """What is wrong with the end of an interrupted run: sentences."""
        if ended.left:
            yield f"leaves {ended.left} among the temporary files"
        if ended.children:
            yield "leaves a child process"
        if ended.code == 0:
            if set(ended.after) != set(self.files) or b"old" in ended.after.values():
                yield f"ends with 0 and leaves {sorted(ended.after)} where {sorted(self.files)} belong"
            if ended.said:
                yield f"ends with 0 and says {ended.said.decode()!r}"
        elif ended.code != 130:
            yield f"ends with {ended.code}: {ended.said.decode()!r}"
        else:
            if ended.after != ended.before:
                yield f"ends with 130 and changes the output folder from {sorted(ended.before)} to {sorted(ended.after)}"
            if not as_json and ended.said != INTERRUPTED:
                yield f"ends with 130 and says {ended.said.decode()!r}"
            if as_json and (ended.said or not is_interrupted_as_json(ended.out)):
                yield f"ends with 130 and says {ended.out.decode()!r}, {ended.said.decode()!r} as JSON"


def group_lives(group):
    """Whether any process of a group is there still."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def is_interrupted_as_json(out):
    """Whether stdout is the one object that tells of an interrupt."""
    try:
        error = json.loads(out)["error"]
    except (ValueError, KeyError, TypeError):
        return False
    return (error["code"], error["exit_code"]) == ("TXF-C02", 130) and out.count(b"\n") == 1


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def wait_for_first_line(run):
    """Time at which the process has a second thread, or has ended."""
    tasks = f"/proc/{run.pid}/task"
    while run.poll() is None and len(os.listdir(tasks)) < 2:
        time.sleep(0.0005)
    return time.monotonic()


def prepare(folder):
    """Writes the mesh and its stream."""
    from texfcodec import EncodeOptions, encode

    (folder / "mesh.ply").write_text(TETRAHEDRON)
    (folder / "stream.texf").write_bytes(encode(folder / "mesh.ply", EncodeOptions(resolution=64, qp=24)))


def interrupt_all(folder, moments, seed=0, tools=tuple(RUNS), cold=False, jobs=2, sent=signal.SIGINT):
    """Sends each tool a signal at so many random moments: ({tool: Counter of exit codes}, [one sentence for each fault])."""
    prepare(folder)
    environment = dict(os.environ) | {"PYTHONPATH": str(REPOSITORY)}
    chance, found, counts = random.Random(seed), [], {}

    def one(subject, share, as_json):
        moment = share * subject.seconds
        ended = Ended(subject, folder, moment, ("--json",) if as_json else (), sent)
        found = subject.faults_of_killed(ended) if ended.again else subject.faults(ended, as_json)
        return subject, ended.code, [f"{subject.name} at {moment:.4f} s of {subject.seconds:.2f} {fault}" for fault in found]

    with ThreadPoolExecutor(jobs) as pool:
        for tool in tools:
            subjects = [Subject(tool, arguments, folder, environment) for arguments in RUNS[tool]]
            for subject in subjects if cold else ():
                subject.environment, subject.seconds = environment | {"NUMBA_CACHE_DIR": str(folder / "cache")}, COLD_SECONDS
            draws = [(subjects[n % len(subjects)], chance.uniform(0, 1.05), chance.random() < 0.3) for n in range(moments)]
            for subject, code, told in pool.map(lambda draw: one(*draw), draws):
                counts.setdefault(subject.tool, Counter())[code] += 1
                found += told
    return counts, found


def main():
    """The command line: 0 where every run ended as it should."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=300, help="for each tool")
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tool", choices=RUNS, action="append", help="only this one; may be repeated")
    parser.add_argument("--kill", action="store_true", help="SIGKILL in place of Ctrl-C")
    parser.add_argument("--cold", action="store_true", help="with an empty kernel cache: interrupts while kernels are compiled")
    chosen = parser.parse_args()
    sent = signal.SIGKILL if chosen.kill else signal.SIGINT
    with tempfile.TemporaryDirectory() as folder:
        faults = 0
        for tool in chosen.tool or RUNS:
            counts, found = interrupt_all(Path(folder), chosen.moments, chosen.seed, (tool,), chosen.cold, chosen.jobs, sent)
            ended = ", ".join(f"{times} with {code}" for code, times in sorted(counts[tool].items(), reverse=True))
            print(f"{tool}: {chosen.moments} times {sent.name}, ended {ended}; {len(found)} faults", *found, sep="\n", flush=True)
            faults += len(found)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
