"""The 3DNTC fit on the GPU: seconds and PSNR at held-out points, beside the kernels for processors.

Samples are drawn by child processes, since the parts of numba that they need are compiled meanwhile; another child compiles what
judges a payload. Fits by the processor's kernels that prepare.py has not measured go on beside everything else, and finish()
reads what they have reached.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from texfcodec.codecs.neural import fit_payload, fit_samples
from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_samples import Samples
from texfcodec.codecs.neural.fit_torch import TorchFit

from . import prepare
from .rows import Context, Row

STEPS, LONG_STEPS = 30_000, 100_000
BATCHES = (4096, 16384, 65536)
TARGET_SECONDS = 20.0  # of 30,000 steps
LONG_LEFT = 90.0  # seconds that have to be left for the long fit
PLAIN_STEPS, CPU_STEPS, TRIAL_STEPS = 500, 200, 200
MOST_FIT_SECONDS = 100.0
CPU_THREADS = 4  # a fit's kernels use no more
SAMPLES = ("position", "target", "share", "field")


# Child processes.


def _child(context, *arguments):
    environment = os.environ | {"CUDA_VISIBLE_DEVICES": "", "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen([sys.executable, "-m", "tools.gpu.fit", *map(str, arguments)], env=environment,
                            stdout=open(context.out / f"fit_{arguments[0]}_{arguments[1]}.log", "w"), stderr=subprocess.STDOUT)


def draw_child(name: str, inputs: Path, folder: Path, steps: int, threads: int) -> None:
    """Draws the samples of an asset and saves them, and with them the seconds that it took."""
    fit_samples.MOST_WORKERS = max(threads, fit_samples.MOST_WORKERS)
    taken = prepare.read(inputs / f"{name}.fit")
    begin = time.perf_counter()
    drawn = prepare.draw(taken, steps, threads)
    seconds = time.perf_counter() - begin
    for kind, samples in zip(("drawn", "held"), drawn, strict=True):
        for array in SAMPLES:
            np.save(folder / f"{name}_{kind}_{array}.npy", getattr(samples, array))
    (folder / f"{name}.json").write_text(json.dumps({"seconds": round(seconds, 2), "samples": len(drawn[0])}))


def warm_child(inputs: Path) -> None:
    """Compiles the kernels that set a fit up, step it and judge it, so that they lie in the cache."""
    name, point = next((name, points[0]) for name, _, points in prepare.CASES if (inputs / f"{name}.fit").is_file())
    taken = prepare.read(inputs / f"{name}.fit")
    design, tables, _ = taken["designs"][point]
    samples = taken["source"].draw(8192, [1, 2])
    fit = Fit(design, tables, samples, samples.taken(slice(0, 512)), 0, 2, judged=taken["judged"])
    fit.run(1)
    fit.errors(exact=True)


def cpu_child(name: str, point: str, inputs: Path, folder: Path, steps: int) -> None:
    """Fits by the processor's kernels and writes the figures."""
    taken = prepare.read(inputs / f"{name}.fit")
    figures = prepare.cpu_fit(taken, point, load_samples(folder, name), steps, CPU_THREADS)
    (folder / f"cpu_{name}_{point}.json").write_text(json.dumps(figures))


def load_samples(folder: Path, name: str) -> tuple[Samples, Samples]:
    """What draw_child() saved."""
    drawn, held = (Samples(*(np.load(folder / f"{name}_{kind}_{array}.npy") for array in SAMPLES)) for kind in ("drawn", "held"))
    return drawn, held


@dataclass
class Work:
    """What goes on beside the measuring. folder: of samples; drawing, fitting: child processes by name."""

    context: Context
    steps: int
    folder: Path
    drawing: dict[str, Any] = field(default_factory=dict)
    fitting: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def begun(cls, context: Context) -> Work:
        """The children that draw samples and compile, started."""
        work = cls(context, context.scaled(STEPS, 20), context.out / "fit_samples")
        work.folder.mkdir(parents=True, exist_ok=True)
        threads = max(1, (os.cpu_count() or 2) // 2)
        for name, points in work.cases():
            wanted = [f"fit/{name}/{point}" for point in points]
            if not (work.folder / f"{name}.json").is_file() and context.wants_any(wanted):
                work.drawing[name] = _child(context, "draw", name, context.inputs, work.folder, work.steps, threads)
        work.drawing["kernels"] = _child(context, "warm", "all", context.inputs)
        return work

    def cases(self) -> list[tuple[str, tuple[str, ...]]]:
        """(name, points) of the inputs that are there."""
        return [(name, points) for name, _, points in prepare.CASES if (self.context.inputs / f"{name}.fit").is_file()]

    def wait(self, name: str) -> float:
        """Seconds waited for a child that draws. Raises RuntimeError with the end of its output where it failed."""
        begin, child = time.perf_counter(), self.drawing.pop(name, None)
        if child is not None and child.wait(timeout=max(self.context.left(), 1)):
            log = self.context.out / f"fit_{'warm_all' if name == 'kernels' else f'draw_{name}'}.log"
            raise RuntimeError(log.read_text()[-1500:])
        return time.perf_counter() - begin

    def fit_beside(self, name: str, points: tuple[str, ...]) -> None:
        """Starts the processor's fits of an asset that nobody has measured."""
        known = cpu_figures(self.context)
        for point in points:
            key = f"{name}/{point}/{self.steps}"
            if key not in known and self.context.wants(f"fit/{name}/{point}/cpu_kernels"):
                self.fitting[key] = _child(self.context, "cpu", f"{name}_{point}", self.context.inputs, self.folder, self.steps)

    def end(self) -> None:
        """Ends what is still running."""
        for child in (*self.drawing.values(), *self.fitting.values()):
            if child.poll() is None:
                child.terminate()
                child.wait()


def cpu_figures(context: Context) -> dict[str, Any]:
    """What prepare.py --cpu-fit has written."""
    path = context.inputs / "cpu_fits.json"
    return json.loads(path.read_text()) if path.is_file() else {}


_work: dict[int, Work] = {}  # by id of the context: finish() takes up what measure() has begun


# The fits.


@dataclass(frozen=True)
class Case:
    """An asset at a point, with its samples."""

    name: str
    point: str
    taken: dict[str, Any]
    drawn: tuple[Samples, Samples]

    @property
    def key(self) -> str:
        return f"fit/{self.name}/{self.point}"

    def fit(self, context: Context, **settings: Any) -> TorchFit:
        """A fit on the context's device."""
        design, tables, _ = self.taken["designs"][self.point]
        return TorchFit(design, tables, *self.drawn, prepare.SEED, os.cpu_count() or 1, judged=self.taken["judged"],
                        device=context.device, **settings)


def measure(context: Context) -> Iterator[Row]:
    """Rows of the fit; see rows.py."""
    work = _work[id(context)] = Work.begun(context)
    for name, points in work.cases():
        taken = prepare.read(context.inputs / f"{name}.fit")
        work.wait(name)
        if context.wants(f"fit/{name}/draw"):
            yield Row(f"fit/{name}/draw", json.loads((work.folder / f"{name}.json").read_text()) | {"threads": os.cpu_count()})
        work.wait("kernels")
        work.fit_beside(name, points)
        drawn = load_samples(work.folder, name)
        for point in points:
            yield from _fits(context, Case(name, point, taken, drawn), work.steps)


def _fits(context, case, steps):
    chosen = context.done.get("fit/chosen")
    if chosen is None:
        yield from _trials(context, case, steps)
        chosen = context.done["fit/chosen"]
    key = f"{case.key}/gpu"
    if context.wants(key):
        yield Row(key, fitted(context, case, steps, batch=chosen["batch"], products=chosen["products"]))
    if case.point == "mpeg1" and context.wants(f"{case.key}/plain"):
        yield Row(f"{case.key}/plain", timed(context, case, context.scaled(PLAIN_STEPS, 2), step="plain", batch=chosen["batch"]))
    if context.wants(f"{case.key}/cpu_step"):
        yield Row(f"{case.key}/cpu_step", cpu_step(case, context.scaled(CPU_STEPS, 2)))


def _trials(context, case, steps):
    """Fits with each batch, and with tf32; "fit/chosen" is what gives the most dB within the target."""
    tried = []
    settings = [(batch, "float16") for batch in BATCHES] + [(BATCHES[1], "tf32")]
    for batch, products in settings:
        key = f"{case.key}/batch{batch}_{products}"
        if context.wants(key) and context.left() > 30:
            yield Row(key, fitted(context, case, steps, batch=context.scaled(batch, 64), products=products))
        if "seconds" in context.done.get(key, {}):
            tried.append(context.done[key] | {"products": products})
    quick = [row for row in tried if row["seconds"] <= TARGET_SECONDS] or tried
    best = max(quick, key=lambda row: row["psnr_db"]) if quick else {"batch": context.scaled(BATCHES[0], 64), "products": "auto"}
    yield Row("fit/chosen", {"batch": best["batch"], "products": best["products"]})


def fitted(context: Context, case: Case, steps: int, **settings: Any) -> dict[str, Any]:
    """Figures of a whole fit."""
    begin = time.perf_counter()
    fit = case.fit(context, **settings)
    made = time.perf_counter()
    fit.warm(steps)
    warm = time.perf_counter()
    fit._settled = lambda: False  # type: ignore[method-assign]  # all steps are taken, so that seconds compare
    errors = fit._take_steps(min(context.scaled(TRIAL_STEPS, 2), steps), steps, None)
    each = (time.perf_counter() - warm) / len(errors)
    longest = min(MOST_FIT_SECONDS, max(context.left() - 20, 1))
    figures = {"asked_steps": steps, "engine": "fused" if fit.engine is not None else "plain", "graph": bool(fit.graph),
               "products": fit.products, "batch": fit.layout.batch, "block": fit.layout.block, "latents": fit.design.rows,
               "samples": len(fit.samples), "setup_seconds": round(made - begin, 2), "compile_seconds": round(warm - made, 2),
               "first_milliseconds_a_step": round(1000 * each, 4), "distances": getattr(fit, "distances", []),
               "remarks": fit.remarks}
    if each * steps > longest:
        return figures | {"skipped": f"{steps} steps would take {each * steps:.0f} s"}
    fit.run(steps)
    seconds = time.perf_counter() - warm
    rgb = fit_payload.pooled_psnr(fit.errors(exact=True), case.taken["rgb"])
    return figures | {"steps": fit.step, "seconds": round(seconds, 2), "milliseconds_a_step": round(1000 * seconds / fit.step, 4),
                      "psnr_db": round(fit.psnr(exact=True), 3), "psnr_rgb_db": round(rgb, 3), "log": fit.log}


def timed(context: Context, case: Case, steps: int, **settings: Any) -> dict[str, Any]:
    """Milliseconds of a step, of so many."""
    fit = case.fit(context, **settings)
    fit.warm(STEPS)
    fit._take_steps(min(steps, 60), STEPS, None)
    begin, first = time.perf_counter(), fit.step
    fit._take_steps(first + steps, STEPS, None)
    return {"steps": steps, "batch": fit.layout.batch, "engine": "fused" if fit.engine is not None else "plain",
            "graph": bool(fit.graph), "milliseconds_a_step": round(1000 * (time.perf_counter() - begin) / steps, 4),
            "remarks": fit.remarks}


def cpu_step(case: Case, steps: int) -> dict[str, Any]:
    """Milliseconds of a step of the processor's kernels on this machine, over a part of the samples."""
    from concurrent.futures import ThreadPoolExecutor

    design, tables, _ = case.taken["designs"][case.point]
    few = case.drawn[0].taken(slice(None, None, max(1, len(case.drawn[0]) >> 18)))
    fit = Fit(design, tables, few, case.drawn[1].taken(slice(0, 512)), prepare.SEED, os.cpu_count() or 1)
    with ThreadPoolExecutor(fit.threads) as pool:
        fit._take_steps(2, STEPS, pool)
        begin = time.perf_counter()
        fit._take_steps(2 + steps, STEPS, pool)
        seconds = time.perf_counter() - begin
    return {"steps": steps, "milliseconds_a_step": round(1000 * seconds / steps, 3), "threads": CPU_THREADS,
            "cores": os.cpu_count()}


def finish(context: Context) -> Iterator[Row]:
    """After the other parts: the long fit if there is time for it, and what the processor's fits have reached."""
    work = _work.pop(id(context), None) or Work(context, context.scaled(STEPS, 20), context.out / "fit_samples")
    try:
        yield from _long(context, work)
        for name, points in work.cases():
            for point in points:
                yield from _cpu_row(context, work, name, point)
    finally:
        work.end()


def _long(context, work):
    key, chosen = "fit/player/mpeg6/gpu_100000", context.done.get("fit/chosen")
    usual = context.done.get("fit/player/mpeg6/gpu", {}).get("milliseconds_a_step")
    if chosen is None or usual is None or not context.wants(key):
        return
    if context.left() < max(LONG_LEFT * min(context.scale * 10, 1), usual * context.scaled(LONG_STEPS) / 1000 + 20):
        yield Row(key + "/error", {"skipped": f"{context.left():.0f} s were left"})
        return
    taken = prepare.read(context.inputs / "player.fit")
    case = Case("player", "mpeg6", taken, load_samples(work.folder, "player"))
    yield Row(key, fitted(context, case, context.scaled(LONG_STEPS, 30), batch=chosen["batch"], products=chosen["products"]))


def _cpu_row(context, work, name, point):
    key = f"fit/{name}/{point}/cpu_kernels"
    if not context.wants(key):
        return
    known, child = cpu_figures(context).get(f"{name}/{point}/{work.steps}"), work.fitting.get(f"{name}/{point}/{work.steps}")
    path = work.folder / f"cpu_{name}_{point}.json"
    if known is None and child is not None:
        try:
            child.wait(timeout=max(context.left() - 5, 0.1))
        except subprocess.TimeoutExpired:
            return
        known = json.loads(path.read_text()) if path.is_file() else None
    if known is not None:
        yield Row(key, known)


def main() -> None:
    """What a child process does."""
    parser = argparse.ArgumentParser()
    parser.add_argument("task", choices=("draw", "warm", "cpu"))
    parser.add_argument("name")
    parser.add_argument("inputs", type=Path)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("steps", type=int, nargs="?")
    parser.add_argument("threads", type=int, nargs="?")
    given = parser.parse_args()
    if given.task == "draw":
        draw_child(given.name, given.inputs, given.folder, given.steps, given.threads)
    elif given.task == "warm":
        warm_child(given.inputs)
    else:
        cpu_child(*given.name.split("_"), given.inputs, given.folder, given.steps)


if __name__ == "__main__":
    main()
