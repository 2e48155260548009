"""The benchmarks of this checkout and of a commit in turns, and what is slower: the speed of a machine wanders by more than the
10 % that are told, so that two runs of `make bench` an hour apart cannot tell a change from it.

    python tools/bench/turns.py COMMIT [--rounds 3] [--only EXPRESSION]

The commit is checked out beside and run by the same Python. Each side runs what it has in tools/bench/test_speed.py once a
round, in
seconds of the processor, and whole processes as tools/bench/history.py does: some two minutes a side and round. Prints the
latter's table over all rounds. Exit code 1 where a benchmark is slower in both its fastest run and its median.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.history import PROCESSES, compared, comparison_lines, run_of
from tools.bench.processes import timed

REPOSITORY = Path(__file__).resolve().parents[2]
PYTEST = ("-m", "pytest", "-q", "tools/bench/test_speed.py", "-p", "no:cacheprovider", "--benchmark-only",
          "--benchmark-max-time=0.5", "--benchmark-timer=time.process_time")


@contextmanager
def checked_out(commit, repository=REPOSITORY):
    """A folder with a commit, while the block runs."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "before"
        subprocess.run(["git", "-C", repository, "worktree", "add", "--quiet", "--detach", root, commit], check=True)
        try:
            yield root
        finally:
            subprocess.run(["git", "-C", repository, "worktree", "remove", "--force", root], check=True)


def round_of(root, only=None):
    """One round of a checkout: a line of the history, as run_of() makes it."""
    from texfcodec.demo.asset import write_sample

    with tempfile.TemporaryDirectory() as folder:
        told, place = Path(folder) / "told.json", os.environ | {"PYTHONPATH": str(root)}
        words = [sys.executable, *PYTEST, f"--benchmark-json={told}", *(["-k", only] if only else [])]
        subprocess.run(words, cwd=root, env=place, check=True, stdout=sys.stderr)
        write_sample(Path(folder) / "sample.glb")
        processes = {name: timed([word.format(folder=folder) for word in words], root)["processor"] for name, words in
                     PROCESSES.items()}
        rows = {name: {"min": seconds, "median": seconds, "rounds": 1} for name, seconds in processes.items()}
        return run_of(json.loads(told.read_text(encoding="utf-8")), rows)


def merged(runs):
    """Rounds of one side as one run: of each benchmark the fastest of all, and the median of the rounds' medians."""
    rows = {name: {"min": min(run["rows"][name]["min"] for run in runs),
                   "median": statistics.median(run["rows"][name]["median"] for run in runs),
                   "rounds": sum(run["rows"][name]["rounds"] for run in runs)} for name in runs[0]["rows"]}
    return runs[-1] | {"rows": rows}


def main(arguments=None):
    """Command line of the tool; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", metavar="COMMIT")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="default: %(default)s; one more compiles first")
    parser.add_argument("--only", metavar="EXPRESSION", help="benchmarks, as pytest -k takes them")
    args = parser.parse_args(arguments)
    with checked_out(args.commit) as root:
        rounds = [(round_of(root, args.only), round_of(REPOSITORY, args.only)) for _ in range(args.rounds + 1)]
    before, after = (merged(side) for side in zip(*rounds[1:], strict=True))
    print("\n".join(comparison_lines(before, after)))
    return int(any(slower for *_, slower in compared(before, after)))


if __name__ == "__main__":
    sys.exit(main())
