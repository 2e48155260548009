"""Interrupts the five tools at random moments of their runs and says where one of them does not end as it should.

    python tests/interrupts.py [--moments 300] [--seed 0] [--tool texf-enc] [--cold]

A run must end with 130, one line on stderr (with --json one object on stdout), no child, no temporary and an untouched OUT; or with
0 and the whole result, where it had finished. Moments count from the first line of texfcodec.cli on, which the script knows by the
thread that waits for the signal; what an interpreter says before it is not ours. Needs Linux's /proc.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
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
0 0 0 0 0 0
1 0 0 250 0 0
0 1 0 0 250 0
0 0 1 0 0 250
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
SMALL = ("--resolution", "64", "--qp", "24")
RUNS = {
    "texf-enc": [("{mesh}", "{out}/a.texf", *SMALL), ("{mesh}", "{out}/a.texf", *SMALL, "--measure")],
    "texf-dec": [("{stream}", "{out}/a.glb"), ("{stream}", "{out}/a.obj", "--isolate", "--overwrite"),
                 ("{stream}", "{out}/a.gltf", "--atlas", "quality", "--overwrite")],
    "texf-info": [("{stream}",), ("{stream}", "--verify")],
    "texf-render": [("{stream}", "{out}/a.png", "--size", "256"),
                    ("{stream}", "{out}/a.png", "--size", "256", "--compare", "{mesh}")],
    "texf-eval": [("{mesh}", "{stream}", "--views", "2", "--size", "128")],
}  # fmt: skip


class Subject:
    """One command, how long it takes from its first line on, and what its output folder holds after a whole run."""

    def __init__(self, tool, arguments, folder, environment):
        self.tool, self.arguments, self.environment, self.scratch = tool, arguments, environment, folder / "scratch"
        self.files, self.seconds, self.ended = None, 0.0, None
        for _ in range(2):  # the first may be slow
            _, ended, out, said, self.files = self.run(folder, None, ())
            if ended != 0:
                raise SystemExit(f"{self.name} fails without any interrupt: {said.decode()}")
            self.seconds = self.took

    @property
    def name(self):
        return f"{self.tool} {' '.join(word for word in self.arguments if not word.startswith('{'))}".strip()

    def run(self, folder, moment, flags):
        """Runs it and interrupts it at a moment, None for never: (out folder before, exit code, stdout, stderr, folder after)."""
        out = Path(tempfile.mkdtemp(dir=folder))
        names = {"mesh": folder / "mesh.ply", "stream": folder / "stream.texf", "out": out}
        words = [word.format(**names) for word in self.arguments]
        for name in self.files or ():
            (out / name).write_bytes(b"old")
        before = contents(out)
        self.scratch.mkdir(exist_ok=True)
        program = [sys.executable, "-m", "texfcodec.cli." + self.tool.removeprefix("texf-"), *words, *flags]
        run = subprocess.Popen(program, cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                               env=self.environment | {"TMPDIR": str(self.scratch)}, start_new_session=True,
                               preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
        begin = wait_for_first_line(run)
        if moment is not None:
            time.sleep(moment)
            run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=600)
        self.took = time.monotonic() - begin
        return before, run.returncode, *said, contents(out)

    def faults(self, folder, moment, as_json):
        """What is wrong with a run that is interrupted `moment` seconds after its first line: sentences."""
        before, ended, out, said, after = self.run(folder, moment, ("--json",) if as_json else ())
        self.ended = ended
        left = [path.name for path in self.scratch.iterdir()]
        if left:
            yield f"leaves {left} among the temporary files"
        if ended == 0:
            if set(after) != set(self.files) or any(data == b"old" for data in after.values()):
                yield f"ends with 0 and leaves {sorted(after)} where {sorted(self.files)} belong"
            if said:
                yield f"ends with 0 and says {said.decode()!r}"
        elif ended != 130:
            yield f"ends with {ended}: {said.decode()!r}"
        else:
            if after != before:
                yield f"ends with 130 and changes the output folder from {sorted(before)} to {sorted(after)}"
            if not as_json and said != INTERRUPTED:
                yield f"ends with 130 and says {said.decode()!r}"
            if as_json and (said or not is_interrupted_as_json(out)):
                yield f"ends with 130 and says {out.decode()!r}, {said.decode()!r} as JSON"


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


def interrupt_all(folder, moments, seed=0, tools=tuple(RUNS), cold=False):
    """Interrupts each tool at so many random moments: ({tool: Counter of exit codes}, [one sentence for each fault])."""
    prepare(folder)
    environment = dict(os.environ) | {"PYTHONPATH": str(REPOSITORY)}
    chance, found, counts = random.Random(seed), [], {}
    for tool in tools:
        subjects = [Subject(tool, arguments, folder, environment) for arguments in RUNS[tool]]
        if cold:
            for subject in subjects:
                subject.environment, subject.seconds = environment | {"NUMBA_CACHE_DIR": str(folder / "cache")}, 20.0
        for number in range(moments):
            subject, moment = subjects[number % len(subjects)], None
            moment = chance.uniform(0, 1.05 * subject.seconds)
            told = list(subject.faults(folder, moment, chance.random() < 0.3))
            found += [f"{subject.name} at {moment:.4f} s of {subject.seconds:.2f} {fault}" for fault in told]
            counts.setdefault(tool, Counter())[subject.ended] += 1
    return counts, found


def main():
    """The command line: 0 where every run ended as it should."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=300, help="for each tool")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tool", choices=RUNS, action="append", help="only this one; may be repeated")
    parser.add_argument("--cold", action="store_true", help="with an empty kernel cache: interrupts while kernels are compiled")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts, found = interrupt_all(Path(folder), chosen.moments, chosen.seed, chosen.tool or tuple(RUNS), chosen.cold)
    for tool, codes in counts.items():
        ended = ", ".join(f"{times} with {code}" for code, times in sorted(codes.items(), reverse=True))
        print(f"{tool}: {codes.total()} interrupts, ended {ended}")
    print("\n".join(found) or "every one as it should")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
