"""Eight processes at once that code and decode the same: all are right, and no cache of kernels breaks, an empty one neither."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tools.proof.determinism import TINY

REPOSITORY = Path(__file__).resolve().parents[2]
CHILD = REPOSITORY / "tools" / "proof" / "determinism_child.py"
PROCESSES = 8
VECTORS = ("subset/k33", "subset/texels", "subset/maps_texels", "subset/neural_resident", "uncommon/filter_slices",
           "uncommon/slices_two_groups")
COLD_SCENES = ("tiny sphere",)  # coded with an empty cache, where each process compiles what it needs


def cases_of(scenes):
    """The cases of a job of determinism_child: scenes that are coded and decoded, vectors that are decoded."""
    coded = [{"name": name, "source": name, "options": TINY[name], "stream": None} for name in scenes]
    decoded = [{"name": name, "source": None, "options": {}, "stream": str(REPOSITORY / "conformance" / name / "in.texf")}
               for name in VECTORS]
    return [{"decode": {}, "keep": None, **case} for case in coded + decoded]


def together(count, cases, cache=None):
    """(seconds, [rows of each]) of so many processes at once. Each begins at another of the cases, so that different kernels, and
    kernels for different types, are compiled at the same time. cache: folder of kernels, the usual one without."""
    variables = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})
    begin, children = time.monotonic(), []
    for i in range(count):
        job = json.dumps({"threads": 2, "cases": cases[i % len(cases):] + cases[: i % len(cases)]})
        child = subprocess.Popen([sys.executable, str(CHILD)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                 stderr=subprocess.PIPE, env=variables, text=True, cwd=REPOSITORY)
        children.append(child)
        child.stdin.write(job)
        child.stdin.close()
    rows = [_rows(child) for child in children]
    return time.monotonic() - begin, rows


def _rows(child):
    """{case: row without its seconds} of a child that has been told its job, with its exit code."""
    said, log = child.stdout.read(), child.stderr.read()
    told = [json.loads(line) for line in said.splitlines()[1:]]
    rows = {row.pop("name"): {key: value for key, value in row.items() if key != "seconds"} for row in told}
    return {"exit code": child.wait(), "said": log[-500:] if child.returncode else "", "rows": rows}


def wrong(answers, expected):
    """What processes have got wrong: sentences."""
    for number, answer in enumerate(answers, 1):
        if answer["exit code"]:
            yield f"process {number} ended with {answer['exit code']}: {answer['said']}"
        yield from (f"process {number}, {name}: {answer['rows'].get(name, {}).get('error', 'another result')}"
                    for name, row in expected.items() if answer["rows"].get(name) != row)


def files_of(cache):
    """{file of compiled code or index: time of its last change} below a folder."""
    return {path.relative_to(cache).as_posix(): path.stat().st_mtime_ns for path in cache.rglob("*.nb[ci]")}


def run_together(count=PROCESSES):
    """{"warm", "cold", "after"}: seconds and faults of processes at once with compiled kernels, with an empty cache, and of one
    that comes after these, with the number of files that it changed."""
    every = cases_of(TINY)
    alone, (first,) = together(1, every)
    expected = first["rows"]
    faults = [f"alone: {text}" for text in wrong([first], expected)] if first["exit code"] or any(
        "error" in row for row in expected.values()) else []
    seconds, answers = together(count, every)
    found = {"processes": count, "alone": {"seconds": alone, "faults": faults},
             "warm": {"seconds": seconds, "faults": list(wrong(answers, expected))}}
    cold = cases_of(COLD_SCENES)
    few = {case["name"]: expected[case["name"]] for case in cold}
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        seconds, answers = together(count, cold, cache)
        before = files_of(cache)
        left = [path.name for path in cache.rglob("*.tmp.*")]
        found["cold"] = {"seconds": seconds, "faults": [*wrong(answers, few), *(f"left behind: {name}" for name in left)],
                         "files": len(before)}
        seconds, answers = together(1, cold, cache)
        after = files_of(cache)
        found["after"] = {"seconds": seconds, "faults": list(wrong(answers, few)),
                          "compiled": sum(before.get(name) != stamp for name, stamp in after.items())}
    return found


def together_faults(found):
    """What misses the target: sentences."""
    return [f"{name}: {fault}" for name in ("alone", "warm", "cold", "after") for fault in found[name]["faults"]]
