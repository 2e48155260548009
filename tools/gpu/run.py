"""Measure everything on a GPU:

    python -m tools.gpu.run --out FOLDER [--inputs FOLDER] [--seconds 480] [--only fit,frames,decode]

Runs the parts in order as far as the seconds go, each in a process of its own, prints rows as they come, and keeps them in
FOLDER/gpu.json; a later run with the same folder measures what is missing. `--cpu --scale 0.001` is the test. A machine without a
network needs out/gpu_inputs (of prepare.py), and wheels of what is missing there:

    cp out/gpu_inputs/gpu.json "$OUT"  # only where an earlier run is to go on
    PYTHONPATH=. python3 -m tools.gpu.run --inputs out/gpu_inputs --out "$OUT" --seconds 480
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .rows import Context, Row

PARTS = ("fit", "frames", "decode")
FINISHING = ("fit",)  # have a finish()
MOST_SECONDS = {"fit": 0.5, "frames": 0.5, "decode": 0.25}  # share of the seconds that a part may take of the others'
LEAST_SECONDS, GRACE = 5.0, 15.0
SHOWN = 400  # characters of a row that are printed


def machine() -> dict[str, Any]:
    """The device, its driver, and the libraries."""
    facts: dict[str, Any] = {"python": platform.python_version(), "cores": os.cpu_count(), "processor": platform.machine()}
    for name in ("torch", "triton", "numba", "numpy"):
        try:
            facts[name] = importlib.import_module(name).__version__
        except ImportError:
            facts[name] = None
    try:
        query = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
        answer = subprocess.run(query, capture_output=True, text=True, check=True).stdout
        name, driver, memory = answer.splitlines()[0].split(", ")
        facts |= {"device": name, "driver": driver, "memory": memory}
    except (OSError, subprocess.CalledProcessError, IndexError, ValueError):
        facts |= {"device": "none", "driver": None}
    return facts


class Record:
    """The JSON of a run: {"machines": [...], "rows": {key: figures}}. path: read if it is there, written after every row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        kept = json.loads(path.read_text()) if path.is_file() else {}
        self.machines: list[dict[str, Any]] = kept.get("machines", [])
        self.rows: dict[str, dict[str, Any]] = kept.get("rows", {})

    def add(self, row: Row) -> None:
        """Keep, print and write a row."""
        self.rows[row.key] = row.figures
        text = json.dumps({name: value for name, value in row.figures.items() if name != "log"})
        print(f"{row.key}  {text if len(text) <= SHOWN else text[:SHOWN] + ' ...'}", flush=True)
        self.write()

    def write(self) -> None:
        """Write and rename."""
        part = self.path.with_suffix(".part")
        part.write_text(json.dumps({"machines": self.machines, "rows": self.rows}, indent=1))
        part.replace(self.path)


def measured(part: str, name: str, context: Context) -> Iterator[Row]:
    """Rows of a function of a part; an error ends it and becomes a row."""
    try:
        module = importlib.import_module(f"tools.gpu.{part}")
    except ModuleNotFoundError as error:
        yield Row(f"{part}/error", {"skipped": f"the part cannot be loaded: {error}"})
        return
    if not hasattr(module, name):
        return
    try:
        yield from getattr(module, name)(context)
    except Exception as error:  # whatever a device, a compiler or a driver raises: the other parts still run
        lines = traceback.format_exc().splitlines()
        yield Row(f"{part}/error", {"error": f"{type(error).__name__}: {error}"[:600], "trace": lines[-12:]})


def run_alone(context: Context, part: str, name: str, record: Record) -> None:
    """Add the rows of one function of a part, in this process."""
    for row in measured(part, name, context):
        record.add(row)


def run(given: argparse.Namespace, parts: list[str]) -> None:
    """Measure the parts, then what they have left for the end, each in a process of its own: a fault of one device program ends
    all that follows in its process."""
    deadline, path = time.perf_counter() + given.seconds, given.out / "gpu.json"
    record = Record(path)
    record.machines.append(facts := machine())
    record.write()
    print(json.dumps(facts), flush=True)
    for name, part in [("measure", part) for part in parts] + [("finish", part) for part in parts if part in FINISHING]:
        left, begin = deadline - time.perf_counter(), time.perf_counter()
        if left < LEAST_SECONDS:
            continue
        most = left if name == "finish" or len(parts) == 1 else min(left, MOST_SECONDS[part] * given.seconds)
        command = [sys.executable, "-u", "-m", "tools.gpu.run", *given.arguments, "--only", part, "--alone", name, "--seconds",
                   f"{most:.0f}"]
        try:
            code = subprocess.run(command, timeout=most + GRACE, check=False).returncode
            fault = f"the process ended with code {code}" if code else ""
        except subprocess.TimeoutExpired:
            fault = f"the process was ended after {most + GRACE:.0f} s"
        record = Record(path)
        if fault:
            record.add(Row(f"{part}/error", {"error": fault}))
        taken = record.machines[-1].setdefault("part_seconds", {})
        taken[f"{part} {name}"] = round(time.perf_counter() - begin, 1)
        record.write()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--inputs", type=Path, default=Path("out/gpu_inputs"))
    parser.add_argument("--work", type=Path, default=Path("out/gpu_work"), help="folder for what is no result")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=480.0)
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--alone", help="function of the one part, to be run in this process")
    given = parser.parse_args()
    given.arguments = sys.argv[1:]
    if given.cpu:
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other take longer where cores are shared
    given.out.mkdir(parents=True, exist_ok=True)
    parts = [part for part in PARTS if part in given.only.split(",")]
    if not given.alone:
        run(given, parts)
        return
    record = Record(given.out / "gpu.json")
    record.rows.pop(f"{parts[0]}/error", None)
    context = Context(inputs=given.inputs, out=given.out, scale=given.scale, device="cpu" if given.cpu else "cuda",
                      done=record.rows, deadline=time.perf_counter() + given.seconds, work=given.work)
    run_alone(context, parts[0], given.alone, record)


if __name__ == "__main__":
    main()
