"""The page of a run: python -m tools.gpu.page FOLDER/gpu.json > docs/reports/gpu.md"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Rows = dict[str, dict[str, Any]]
NAMES = {"player": "basketball player", "bottle": "water bottle, all maps", "helmet": "damaged helmet", "room": "room"}
PAPER_CARD = "NVIDIA RTX A6000"
HOW = """`python -m tools.gpu.run --out FOLDER` measures it and goes on where it was cut. `python -m
tools.gpu.page tools/gpu/measured.json > docs/reports/gpu.md` writes this page from the rows that are kept."""
FIT_HOW = """Samples are drawn on the machine's processor, as in every fit; seconds of a fit are its steps with 20 looks at
the held-out points, without drawing, set-up and compilation, which stand beside them. dB are those of the integer evaluation
at 65,536 held-out points of the surface, over all components. One seed gives the same samples, batches and first values on
the GPU and on the processor; payloads of two runs on a GPU differ in their last bits, because atomic additions have no order.
Kernels for the processor take batches of 4,096 samples, and four threads at most."""
FRAME_HOW = """Frames of 2048 x 2048 pixels over the 16 views of the metric, milliseconds by the device's timers: the median, and
what 95 % of the frames keep. *Compute* draws a visibility buffer in compute kernels, then shades the visible pixels in one
pass; *tensor cores* evaluates the network there in 16 bits. *Fragments* are the shaders of the browser's viewer through EGL; a
datacentre card has few units for them. PSNR is against pictures of `texf-render`, at places where both show the surface."""
REPRESENTATIONS = {"voxels": "explicit voxels", "texels": "texels", "uv": "UV texture", "3dntc-near": "3DNTC, near",
                   "3dntc-far": "3DNTC, far", "3dntc": "3DNTC, near"}
WAYS = {"compute": "compute", "plain": "compute", "tensor": "compute, tensor cores", "fragments": "fragments"}


def page(record: dict[str, Any]) -> str:
    """Markdown of a run's JSON."""
    rows: Rows = record["rows"]
    machines = list(_machines(record["machines"])) or ["No GPU has been at hand yet."]
    lines = ["# On a GPU", "", *machines, "", HOW, ""]
    for title, table in (("Beside the paper", _beside), ("The fit", _fit), ("Batches", _batches), ("Frames", _frames)):
        table_lines = list(table(rows))
        lines += [f"## {title}", "", *(table_lines or ["Not measured."]), ""]
    lines += ["## What was not measured", "", *_left_out(rows), ""]
    return "\n".join(lines)


def _machines(machines):
    cards = {f"{facts['device']}, driver {facts['driver']}, {facts['cores']} processor cores; Python {facts['python']}, torch "
             f"{facts['torch']}, Triton {facts['triton']}, numba {facts['numba']}.": None for facts in machines}
    yield from cards
    if len(cards) > 1:
        yield "The runs were on more than one machine, and rows do not say on which."
    for number, facts in enumerate(machines, 1):
        if parts := facts.get("part_seconds"):
            yield f"Seconds of run {number}: " + ", ".join(f"{part} {taken:.0f}" for part, taken in parts.items()) + "."


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
            threads = f", {figures['threads']} threads of {figures['cores']} cores" if "threads" in figures else ""
            where = what[parts[3]] + threads
            body.append([f"{NAMES.get(parts[1], parts[1])}, {parts[2]}", where, *(form(figures) for _, form in FIT)])
    if body:
        yield from (FIT_HOW, "")
        yield from _grid(["asset, point", "on", *(name for name, _ in FIT)], body)
        yield ""
        yield from _cut(rows)
        drawn = {key.split("/")[1]: figures for key, figures in rows.items() if key.endswith("/draw")}
        for name, figures in drawn.items():
            yield f"Drawing {figures['samples']:,} samples of {NAMES.get(name, name)} took {figures['seconds']:.1f} s."
        yield from sorted({f"- {remark}" for figures in rows.values() for remark in figures.get("remarks", [])})


def _cut(rows):
    """What a processor's fit that was cut had reached, beside the GPU's with the same batches."""
    for key, figures in rows.items():
        name = key.removesuffix("/cpu_kernels_cut")
        for look in rows.get(f"{name}/batch4096_float16", {}).get("log", []) if name != key else []:
            cut = figures["log"][-1]
            if look["step"] == cut["step"]:
                yield (f"The processor's fit of {name.removeprefix('fit/')} was cut after {cut['step']:,} steps "
                       f"({cut['seconds']:.0f} s) at {cut['psnr']:.2f} dB; the GPU's with the same batches "
                       f"had {look['psnr']:.2f} dB there "
                       f"({look['seconds']:.1f} s).")


def _batches(rows):
    body = []
    for key, figures in rows.items():
        name, _, what = key.removeprefix("fit/").rpartition("/")
        if "batch" in figures and what.startswith(("batch", "seconds")):
            asset, point = name.split("/")
            body.append([f"{NAMES.get(asset, asset)}, {point}", figures["products"], str(figures["block"]),
                         *(form(figures) for title, form in FIT[:-2])])
    if body:
        yield from _grid(["asset, point", "products", "program", *(name for name, _ in FIT[:-2])], body)
        chosen = rows.get("fit/chosen")
        if chosen:
            yield ""
            yield (f"Taken: {chosen['batch']:,} samples, {chosen['products']}: the most dB of those that take 30,000 steps "
                   "in 20 s (basketball player, mpeg1).")
            yield ("The rates are the same for all batches: gradients are sums, divided by their running mean squares. "
                   "*Program*: samples that a program of the kernels takes.")
    blocks = [(key, figures) for key, figures in rows.items() if "/block" in key and "batch" in figures]
    if blocks:
        yield ""
        yield from _grid(["programs asked for", "taken", "batch", "ms a step"],
                         [[key.rpartition("/block")[2], str(figures["block"]), f"{figures['batch']:,}",
                           f"{figures['milliseconds_a_step']:.3f}"] for key, figures in blocks])


def _frames(rows):
    shown = [("visibility, ms", "visibility_ms_median", "{:.3f}"), ("shading, ms", "shading_ms_median", "{:.3f}"),
             ("frame, ms", "frame_ms_median", "{:.3f}"), ("95 %, ms", "frame_ms_95", "{:.3f}"),
             ("visible pixels", "visible_pixels_mean", "{:,}"), ("PSNR, dB", "psnr_db", "{:.1f}"), ("holds", "holds", "{}"),
             ("rate", "rate", "{}")]
    body = [[NAMES.get(asset, asset), REPRESENTATIONS.get(what, what), WAYS[how],
             *(_cell(figures, name, form) for _, name, form in shown)] for asset, what, how, figures in _drawn(rows)]
    if body:
        yield from (FRAME_HOW, "", *_grid(["asset", "values", "by", *(title for title, _, _ in shown)], body), "")
    for key, figures in rows.items():
        if key.endswith("/check"):
            plain, tensor, worst = (figures[f"{name}_error_of_255"] for name in ("plain_mean", "tensor_mean", "tensor_worst"))
            yield (f"- {NAMES[key.split('/')[1]]}, 3DNTC at {figures['points']:,} points against the integer evaluation: mean "
                   f"error {plain:.4f} of 255 in 32 bits, {tensor:.4f} by tensor cores (at most {worst:.2f}).")


def _drawn(rows):
    """(asset, representation, way, figures) of rows that have a frame's time."""
    for key, figures in rows.items():
        if key.startswith("frames/") and "frame_ms_median" in figures:
            yield *key.split("/")[1:], figures


def _range(values, form):
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def _beside(rows):
    drawn = list(_drawn(rows))
    times = lambda what, way, name: [figures[name] for _, kind, how, figures in drawn if kind == what and how == way]
    body = []
    if explicit := times("voxels", "compute", "frame_ms_median"):
        slow = times("voxels", "fragments", "frame_ms_median")
        body.append(["explicit field, ms a frame", "4.5 to 5.3 (190 to 222 frames a second)",
                     _range(explicit, "{:.2f}") + " by compute" + (f", {_range(slow, '{:.1f}')} by fragments" if slow else "")])
    if near := times("3dntc-near", "tensor", "frame_ms_median"):
        slow = times("3dntc", "fragments", "frame_ms_median")
        ours = _range(near, "{:.2f}") + " by compute" + (f", {_range(slow, '{:.0f}')} by fragments" if slow else "")
        body += [["3DNTC, ms a frame at 2048 x 2048", "10.8", ours],
                 ["of it decoding (ours: all shading)", "6.5",
                  _range(times("3dntc-near", "tensor", "shading_ms_median"), "{:.2f}")]]
    long = rows.get("fit/player/mpeg6/gpu_100000", {})
    if "seconds" in long:
        body.append(["3DNTC, seconds of 100,000 steps", "1,006", f"{long['seconds']:.1f} (mpeg6, {long['psnr_db']:.2f} dB)"])
    short = rows.get("fit/player/mpeg1/gpu", {})
    if "seconds" in short:
        body.append(["seconds of a rival's 2D network; ours: 3DNTC, 30,000 steps", "35",
                     f"{short['seconds']:.1f} (mpeg1, {short['psnr_db']:.2f} dB)"])
    if body:
        yield from _grid(["", f"paper, {PAPER_CARD}", "ours, the card above"], body)
        yield ""
        yield ("The cards differ, and drawing by compute is another way to draw: the columns say what is possible where, not "
               "which method is faster.")


def _left_out(rows):
    yield "- other cards, such as an H100 or the paper's: none was at hand"
    yield ("- the water bottle again: its fit is older than the even choice of samples that fill no program (8 of 16,392 of a "
           "batch, the end of the surface's curve then)")
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
