"""The 3DNTC fit on the GPU: seconds and PSNR at held-out points, beside the kernels for processors.

Samples are drawn by child processes, since the parts of numba that they need are compiled meanwhile; another child compiles what
judges a payload. Fits by the processor's kernels that prepare.py has not measured go on beside everything else, and finish()
reads what they have reached.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
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
from texfcodec.errors import InputError

from . import prepare
from .rows import Context, Row

STEPS, LONG_STEPS = 30_000, 100_000
TRIALS = ((4096, "float16"), (16384, "float16"), (65536, "float16"), (16384, "tf32"))  # batches and products
BATCHES = (4096, 16384, 65536)  # at the large point
BLOCKS = (32, 64, 128)  # samples of a program, tried with the largest batch
TARGET_SECONDS = 20.0  # of 30,000 steps
LONG_LEFT = 90.0  # seconds that have to be left for the long fit
LARGE = "mpeg6"  # point with the most latents
PLAIN_STEPS, CPU_STEPS, TRIAL_STEPS = 500, 200, 200
MOST_FIT_SECONDS = 100.0
CPU_THREADS = 4  # a fit's kernels use no more
SAMPLES = ("position", "target", "share", "field")


# Child processes.


def _child(context, task, name, *arguments):
    """A process of main() below, its output in a file of the samples' folder."""
    environment = os.environ | ({} if task == "compile" else {"CUDA_VISIBLE_DEVICES": ""})
    with open(_folder(context) / f"{task}_{name}.log", "w") as log:
        return subprocess.Popen([sys.executable, "-m", "tools.gpu.fit", task, name, *map(str, arguments)], env=environment,
                                stdout=log, stderr=subprocess.STDOUT)


def _folder(context):
    """Where samples lie and children write; not among the results."""
    return context.work / "fit"


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


def compile_child(name: str, inputs: Path, batch: int, products: str) -> None:
    """Compiles the fused step of a batch on the GPU, so that it lies in Triton's cache; points stand anywhere in the cube."""
    taken = prepare.read(inputs / f"{name}.fit")
    design, tables, _ = next(iter(taken["designs"].values()))
    random, count = np.random.default_rng(0), 2 * batch
    samples = Samples(random.integers(0, 1 << 24, (count, 3)).astype(np.int32),
                      random.integers(0, 255, (count, design.components)).astype(np.uint8),
                      np.full((count, design.components), 255, np.uint8), np.zeros(count, np.int16))
    TorchFit(design, tables, samples, samples.taken(slice(0, 512)), 0, 1, batch=batch, products=products).warm(10)


def cpu_child(name: str, inputs: Path, folder: Path, steps: int) -> None:
    """Fits by the processor's kernels and writes the figures. name: asset_point."""
    asset, point = name.split("_")
    shown = lambda fit, _: (folder / f"cpu_{name}.log.json").write_text(json.dumps(fit.log))
    taken, drawn = prepare.read(inputs / f"{asset}.fit"), load_samples(folder, asset)
    figures = prepare.cpu_fit(taken, point, drawn, steps, CPU_THREADS, shown)
    part = folder / f"cpu_{name}.part"
    part.write_text(json.dumps(figures))
    part.rename(folder / f"cpu_{name}.json")


def load_samples(folder: Path, name: str) -> tuple[Samples, Samples]:
    """What draw_child() saved."""
    drawn, held = (Samples(*(np.load(folder / f"{name}_{kind}_{array}.npy") for array in SAMPLES)) for kind in ("drawn", "held"))
    return drawn, held


@dataclass
class Work:
    """Child processes that prepare the fits. steps: of a fit; drawing: by asset, and "kernels"; compiling: for the GPU, by
    asset."""

    context: Context
    steps: int
    drawing: dict[str, Any] = field(default_factory=dict)
    compiling: dict[str, list[Any]] = field(default_factory=dict)

    @classmethod
    def begun(cls, context: Context) -> Work:
        """The children, started."""
        work, folder = cls(context, context.scaled(STEPS, 20)), _folder(context)
        folder.mkdir(parents=True, exist_ok=True)
        threads = max(1, (os.cpu_count() or 2) // 2)
        for name in work.wanted():
            if not (folder / f"{name}.json").is_file():
                work.drawing[name] = _child(context, "draw", name, context.inputs, folder, work.steps, threads)
            if context.device == "cuda":
                trials = TRIALS if "fit/chosen" not in context.done or name != "player" else ()
                work.compiling[name] = [_child(context, "compile", name, context.inputs, *trial) for trial in trials]
        if work.wanted():
            work.drawing["kernels"] = _child(context, "warm", "all", context.inputs)
        return work

    def wanted(self) -> dict[str, tuple[str, ...]]:
        """Points by asset, of the assets whose rows are not complete."""
        context = self.context
        return {name: points for name, points in cases(context)
                if context.wants_any(f"fit/{name}/{point}/{kind}" for point in points for kind in _kinds(context, point))}

    def wait(self, name: str) -> None:
        """Waits for a child that draws. Raises RuntimeError with the end of its output where it failed."""
        child = self.drawing.pop(name, None)
        if child is not None and child.wait(timeout=max(self.context.left(), 1)):
            log = "warm_all" if name == "kernels" else f"draw_{name}"
            raise RuntimeError((_folder(self.context) / f"{log}.log").read_text()[-1500:])

    def wait_for_compilers(self, name: str) -> None:
        """Waits for what is compiled for an asset's fits on the GPU; where that fails, the fit itself says why."""
        for child in self.compiling.pop(name, []):
            child.wait(timeout=max(self.context.left(), 1))

    def fit_beside(self, name: str, points: tuple[str, ...]) -> None:
        """Starts the processor's fits of an asset that nobody has measured; they outlive this process."""
        for point in points:
            missing = self.context.wants(f"fit/{name}/{point}/cpu_kernels") and _cpu_figures(self.context, name, point) is None
            if missing and self.context.scale == 1:
                child = _child(self.context, "cpu", f"{name}_{point}", self.context.inputs, _folder(self.context), self.steps)
                (_folder(self.context) / f"cpu_{name}_{point}.pid").write_text(str(child.pid))

    def end(self) -> None:
        """Ends the children that still prepare."""
        for child in (*self.drawing.values(), *(child for name in self.compiling for child in self.compiling[name])):
            if child.poll() is None:
                child.terminate()
                child.wait()


def cases(context: Context) -> list[tuple[str, tuple[str, ...]]]:
    """(name, points) of the inputs that are there."""
    return [(name, points) for name, _, points in prepare.CASES if (context.inputs / f"{name}.fit").is_file()]


def _kinds(context, point):
    """Last names of the rows of a point without which it is not complete."""
    large = point == LARGE and context.device == "cuda"
    return "gpu", "cpu_step", *((f"batch{batch}_float16" for batch in BATCHES) if large else ())


def _cpu_figures(context, name, point):
    """What a processor's fit has reached: by prepare.py --cpu-fit, or by a child; None where neither has ended."""
    prepared, child = context.inputs / "cpu_fits.json", _folder(context) / f"cpu_{name}_{point}.json"
    known = json.loads(prepared.read_text()) if prepared.is_file() else {}
    key = f"{name}/{point}/{context.scaled(STEPS, 20)}"
    return known.get(key) or (json.loads(child.read_text()) if child.is_file() else None)


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
    work = Work.begun(context)
    try:
        for name, points in work.wanted().items():
            taken = prepare.read(context.inputs / f"{name}.fit")
            work.wait(name)
            facts = json.loads((_folder(context) / f"{name}.json").read_text())
            if context.wants(f"fit/{name}/draw"):
                yield Row(f"fit/{name}/draw", facts | {"threads": os.cpu_count()})
            work.wait("kernels")
            drawn = load_samples(_folder(context), name)
            cases = [Case(name, point, taken, drawn) for point in points]
            for case in cases:
                if context.wants(f"{case.key}/cpu_step"):  # alone, before the processor's fits begin
                    yield Row(f"{case.key}/cpu_step", cpu_step(case, context.scaled(CPU_STEPS, 2)))
            work.fit_beside(name, points)
            work.wait_for_compilers(name)
            for case in cases:
                yield from _fits(context, case, work.steps)
    finally:
        work.end()


def _fits(context, case, steps):
    chosen = context.done.get("fit/chosen")
    if chosen is None:
        yield from _trials(context, case, steps)
        chosen = context.done["fit/chosen"]
    if case.point == LARGE and context.device == "cuda":
        yield from _large(context, case, steps)
    key = f"{case.key}/gpu"
    if context.wants(key):
        tried = context.done.get(f"{case.key}/{chosen.get('trial')}", {})  # the same fit
        yield Row(key, tried if "seconds" in tried
                  else fitted(context, case, steps, batch=chosen["batch"], products=chosen["products"]))
    if case.point == "mpeg1" and context.wants(f"{case.key}/plain"):
        yield Row(f"{case.key}/plain", timed(context, case, context.scaled(PLAIN_STEPS, 2), step="plain", batch=chosen["batch"]))


def _large(context, case, steps):
    """What batches give at the large point, in as many steps and as many seconds, and which size of programs is fastest."""
    for batch in BATCHES:
        key = f"{case.key}/batch{batch}_float16"
        if context.wants(key) and context.left() > 30:
            yield Row(key, fitted(context, case, steps, batch=batch, products="float16"))
        each, key = context.done.get(key, {}).get("milliseconds_a_step"), f"{case.key}/seconds{TARGET_SECONDS:.0f}_{batch}"
        if each and context.wants(key) and context.left() > TARGET_SECONDS + 30:
            yield Row(key, fitted(context, case, round(1000 * TARGET_SECONDS / each), batch=batch, products="float16"))
    for block in BLOCKS:
        key = f"{case.key}/block{block}"
        if context.wants(key) and context.left() > 30:
            yield Row(key, timed(context, case, PLAIN_STEPS, batch=BATCHES[-1], products="float16", block=block))


def _trials(context, case, steps):
    """Fits with each batch, and with tf32; "fit/chosen" is what gives the most dB within the target."""
    tried = []
    for batch, products in TRIALS:
        key = f"{case.key}/batch{batch}_{products}"
        if context.wants(key) and context.left() > 30:
            yield Row(key, fitted(context, case, steps, batch=context.scaled(batch, 64), products=products))
        if "seconds" in context.done.get(key, {}):
            tried.append(context.done[key] | {"trial": f"batch{batch}_{products}"})
    quick = [row for row in tried if row["seconds"] <= TARGET_SECONDS] or tried
    usual = {"batch": context.scaled(TRIALS[0][0], 64), "products": "auto", "trial": ""}
    best = max(quick, key=lambda row: row["psnr_db"]) if quick else usual
    yield Row("fit/chosen", {name: best[name] for name in usual})


def fitted(context: Context, case: Case, steps: int, **settings: Any) -> dict[str, Any]:
    """Figures of a whole fit."""
    begin = time.perf_counter()
    fit = case.fit(context, **settings)
    set_up = time.perf_counter()
    fit.warm(steps)
    warm = time.perf_counter()
    fit._settled = lambda: False  # type: ignore[method-assign]  # all steps are taken, so that seconds compare
    first = fit._take_steps(min(context.scaled(TRIAL_STEPS, 2), steps), steps, None)
    each = (time.perf_counter() - warm) / len(first)
    longest = min(MOST_FIT_SECONDS, max(context.left() - 20, 1))
    figures = {"asked_steps": steps, "engine": "fused" if fit.engine is not None else "plain", "graph": bool(fit.graph),
               "products": fit.products, "batch": fit.layout.batch, "block": fit.layout.block, "latents": fit.design.rows,
               "samples": len(fit.samples), "setup_seconds": round(set_up - begin, 2), "compile_seconds": round(warm - set_up, 2),
               "first_milliseconds_a_step": round(1000 * each, 4), "distances": getattr(fit, "distances", []),
               "remarks": fit.remarks}
    if each * steps > longest:
        return figures | {"skipped": f"{steps} steps would take {each * steps:.0f} s"}
    try:
        fit.run(steps)
    except InputError as error:  # it has diverged
        return figures | {"error": str(error)}
    seconds = time.perf_counter() - warm
    errors = fit.errors(exact=True)
    judged, rgb = (fit_payload.pooled_psnr(errors, components) for components in (fit.judged, case.taken["rgb"]))
    return figures | {"steps": fit.step, "seconds": round(seconds, 2), "milliseconds_a_step": round(1000 * seconds / fit.step, 4),
                      "psnr_db": round(judged, 3), "psnr_rgb_db": round(rgb, 3), "log": fit.log}


def timed(context: Context, case: Case, steps: int, **settings: Any) -> dict[str, Any]:
    """Milliseconds of a step, of so many."""
    fit = case.fit(context, **settings)
    fit.warm(STEPS)
    fit._take_steps(min(steps, 60), STEPS, None)
    begin, first = time.perf_counter(), fit.step
    fit._take_steps(first + steps, STEPS, None)
    return {"steps": steps, "batch": fit.layout.batch, "engine": "fused" if fit.engine is not None else "plain",
            "block": fit.layout.block, "graph": bool(fit.graph), "remarks": fit.remarks,
            "milliseconds_a_step": round(1000 * (time.perf_counter() - begin) / steps, 4)}


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
    try:
        yield from _long(context)
        for name, points in cases(context):
            for point in points:
                yield from _cpu_row(context, name, point)
    finally:
        for path in _folder(context).glob("cpu_*.pid"):
            with contextlib.suppress(OSError):
                os.kill(int(path.read_text()), signal.SIGTERM)
            path.unlink()


def _long(context):
    key, chosen = "fit/player/mpeg6/gpu_100000", context.done.get("fit/chosen")
    usual = context.done.get("fit/player/mpeg6/gpu", {}).get("milliseconds_a_step")
    if chosen is None or usual is None or not context.wants(key):
        return
    needed = max(LONG_LEFT * min(context.scale * 10, 1), usual * context.scaled(LONG_STEPS) / 1000 + 20)
    if context.left() < needed:
        yield Row(f"{key}_left_out", {"skipped": f"{context.left():.0f} s were left"})
        return
    taken = prepare.read(context.inputs / "player.fit")
    case = Case("player", "mpeg6", taken, load_samples(_folder(context), "player"))
    yield Row(key, fitted(context, case, context.scaled(LONG_STEPS, 30), batch=chosen["batch"], products=chosen["products"]))


def _cpu_row(context, name, point):
    key, begun = f"fit/{name}/{point}/cpu_kernels", _folder(context) / f"cpu_{name}_{point}.pid"
    if not context.wants(key):
        return
    while (figures := _cpu_figures(context, name, point)) is None and begun.is_file() and context.left() > 5:
        time.sleep(0.5)
    if figures is not None:
        yield Row(key, figures)
    elif (log := begun.with_suffix(".log.json")).is_file():
        looks = json.loads(log.read_text())
        yield Row(f"{key}_cut", {"skipped": f"the processor's fit had taken {looks[-1]['step']:,} steps in "
                                            f"{looks[-1]['seconds']:.0f} s when the time was over", "log": looks})


def main() -> None:
    """What a child process does: task, name, inputs, then what the task takes."""
    task, name, inputs, *rest = sys.argv[1:]
    if task == "draw":
        draw_child(name, Path(inputs), Path(rest[0]), int(rest[1]), int(rest[2]))
    elif task == "compile":
        compile_child(name, Path(inputs), int(rest[0]), rest[1])
    elif task == "cpu":
        cpu_child(name, Path(inputs), Path(rest[0]), int(rest[1]))
    else:
        warm_child(Path(inputs))


if __name__ == "__main__":
    main()
