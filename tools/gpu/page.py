"""The page of a run: python -m tools.gpu.page FOLDER/gpu.json > docs/reports/gpu.md"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Rows = dict[str, dict[str, Any]]
NAMES = {"player": "basketball player", "bottle": "water bottle, all maps", "helmet": "damaged helmet", "room": "room"}
PAPER = """The paper's figures are those of an NVIDIA RTX A6000: 190 to 222 frames a second for explicit fields (4.5 to 5.3 ms),
10.8 ms a frame for 3DNTC at 2048 x 2048, 6.5 ms of it decoding, and 1,006 s for a fit of 100,000 steps (35 s for a rival's
2D network)."""
HOW = """`python -m tools.gpu.run --out FOLDER` measures it, `python -m tools.gpu.page FOLDER/gpu.json` writes this page.
Samples are drawn on the machine's processor, as in every fit; seconds of a fit are its steps with 20 looks at the held-out
points, without drawing, set-up and compilation, which stand beside them. dB are those of the integer evaluation at 65,536
held-out points of the surface, over all components. One seed gives the same samples, batches and first values on the GPU and on
the processor; payloads of two runs on a GPU differ in their last bits, because atomic additions have no order."""


def page(record: dict[str, Any]) -> str:
    """Markdown of a run's JSON."""
    rows: Rows = record["rows"]
    machines = list(_machines(record["machines"])) or ["No GPU has been at hand yet."]
    lines = ["# On a GPU", "", *machines, "", PAPER, "", HOW, ""]
    for title, table in (("The fit", _fit), ("Batches", _batches), ("Frames", _frames), ("Decoding", _decode)):
        made = list(table(rows))
        lines += [f"## {title}", "", *(made or ["Not measured."]), ""]
    lines += ["## What was not measured", "", *(list(_left_out(rows)) or ["Nothing of the plan is missing."]), ""]
    return "\n".join(lines)


def _machines(machines):
    for facts in machines[-1:]:
        yield (f"{facts['device']}, driver {facts['driver']}, {facts['cores']} processor cores; Python {facts['python']}, torch "
               f"{facts['torch']}, Triton {facts['triton']}, numba {facts['numba']}.")
    seconds = {part: taken for facts in machines for part, taken in facts.get("part_seconds", {}).items()}
    if seconds:
        yield "Seconds of the parts: " + ", ".join(f"{part} {taken:.0f}" for part, taken in seconds.items()) + "."


def _grid(head: list[str], body: list[list[str]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in body:
        yield "| " + " | ".join(row) + " |"


def _cell(figures: dict[str, Any], name: str, form: str = "{}") -> str:
    value = figures.get(name)
    return "" if value is None else form.format(value)


FIT: list[tuple[str, Callable[[dict], str]]] = [
    ("engine", lambda r: _cell(r, "engine") or "processor"), ("batch", lambda r: _cell(r, "batch", "{:,}")),
    ("steps", lambda r: _cell(r, "steps", "{:,}")), ("seconds", lambda r: _cell(r, "seconds", "{:.1f}")),
    ("ms a step", lambda r: _cell(r, "milliseconds_a_step", "{:.3f}")), ("dB", lambda r: _cell(r, "psnr_db", "{:.2f}")),
    ("dB, RGB", lambda r: _cell(r, "psnr_rgb_db", "{:.2f}")), ("set-up, s", lambda r: _cell(r, "setup_seconds", "{:.1f}")),
    ("compilation, s", lambda r: _cell(r, "compile_seconds", "{:.1f}"))]


def _fit(rows):
    what = {"gpu": "GPU", "plain": "GPU, plain torch (a part of the steps)", "gpu_100000": "GPU", "cpu_kernels": "processor",
            "cpu_step": "processor, this machine (a part of the steps)"}
    body = []
    for key, figures in sorted(rows.items()):
        parts = key.split("/")
        if parts[0] == "fit" and len(parts) == 4 and parts[3] in what:
            where = what[parts[3]] + (f", {figures['threads']} threads" if "threads" in figures else "")
            body.append([f"{NAMES.get(parts[1], parts[1])}, {parts[2]}", where, *(form(figures) for _, form in FIT)])
    if body:
        yield from _grid(["asset, point", "on", *(name for name, _ in FIT)], body)
        yield ""
        drawn = {key.split("/")[1]: figures for key, figures in rows.items() if key.endswith("/draw")}
        for name, figures in drawn.items():
            yield f"Drawing {figures['samples']:,} samples of {NAMES.get(name, name)} took {figures['seconds']:.1f} s."
        yield from sorted({f"- {remark}" for figures in rows.values() for remark in figures.get("remarks", [])})


def _batches(rows):
    body = [[f"{figures['batch']:,}", figures["products"], *(form(figures) for name, form in FIT if name not in ("batch",))]
            for key, figures in rows.items() if "/batch" in key and "batch" in figures]
    if body:
        yield from _grid(["batch", "products", *(name for name, _ in FIT if name != "batch")], body)
        chosen = rows.get("fit/chosen")
        if chosen:
            yield ""
            yield (f"Taken: {chosen['batch']:,} samples, {chosen['products']}: the most dB of those that take 30,000 steps in "
                   "20 s. The rates are the same for all batches: gradients are sums, divided by their running mean squares.")


def _frames(rows):
    yield from _any(rows, "frames")


def _decode(rows):
    yield from _any(rows, "decode")


def _any(rows, part):
    """Rows of a part whose figures are its own, a table for each set of names."""
    kinds: dict[tuple, list] = {}
    for key, figures in rows.items():
        if key.startswith(f"{part}/") and not {"skipped", "error"} & set(figures):
            plain = {name: value for name, value in figures.items() if isinstance(value, int | float | str)}
            kinds.setdefault(tuple(plain), []).append([key.removeprefix(f"{part}/"), *(f"{v}" for v in plain.values())])
    for names, body in kinds.items():
        yield from _grid(["", *(name.replace("_", " ") for name in names)], body)
        yield ""


def _left_out(rows):
    for part in ("fit", "frames", "decode"):
        if not any(key.startswith(f"{part}/") for key in rows):
            yield f"- {part}: no run has measured it"
    for key, figures in rows.items():
        reason = figures.get("skipped") or figures.get("error")
        if reason:
            yield f"- {key}: {reason}"


def main() -> None:
    """Command line."""
    print(page(json.loads(Path(sys.argv[1]).read_text())), end="")


if __name__ == "__main__":
    main()
