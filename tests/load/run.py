"""What holds under load: memory over hundreds of calls, processes at once, a batch with faults, memory of refused files, what
streams at the bounds of a level take, how time and memory grow with the faces of a mesh, and tasks of a Dask cluster.

python tests/load/run.py [--part slope|together|batch|refused|levels|faces|cluster ...] [--out FOLDER]
                         [--page docs/reports/load.md] [--calls N] [--every]

Each part leaves a file in the folder; the page is made of all that lie there, so that parts may be measured one by one. --every
puts every faulty vector through texf-dec, and not the worst ten alone. Exit code 7: a part of the folder misses its target.
"""

import argparse
import json
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

if not __package__:  # called as a file
    sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[2] / "tests")]

from load.many import ENCODED, GOOD, NAP_SECONDS, run_batch, run_cluster
from load.parts import CALLS, FEW, SIZES, WARM, WORST, run_faces, run_levels, run_refused, run_slopes, run_together
from texfcodec.core.json_text import json_text
from texfcodec.errors import EXIT_DIFFERS
from tools.bench.plots import load_pyplot
from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table, wrapped

MB, MILLION = 1 << 20, 10**6
SLOPE, PEAK = 20_000, 256 << 20  # targets: bytes a call, and of a process that refuses a file
STEEPEST, NAP = 1.25, 0.05  # exponent of seconds over faces, texels or voxels; processor seconds of Dask's own a task


# Sentences on what misses its target


def slope_faults(found):
    return [f"{kind}: {row['bytes a call']:,} bytes a call" for kind, row in found.items() if row["bytes a call"] > SLOPE]


def together_faults(found):
    return [f"{name}: {fault}" for name in ("alone", "warm", "cold", "after") for fault in found[name]["faults"]]


def refused_faults(found):
    rows = [item for key in ("rows", "tool") for item in found[key].items()]
    return [*(f"{name}: {row['peak'] >> 20} MB" for name, row in rows if row["peak"] > PEAK),
            *(f"{name}: decoded" for name, row in rows if row["code"] == 0),
            *(f"{name}: its process fell" for name in found["fallen"])]


def levels_faults(found):
    return [f"the stream for {row['kind']} of level {row['level']} has {row['count']:,} of {row['bound']:,}"
            for row in found["rows"] if not 0.5 < row["count"] / row["bound"] <= 1]


def slopes(found):
    """{kind: {"encode", "save": exponents of seconds over sizes, by least squares over the logarithms}} of run_faces()."""
    def exponent(own, step):
        seconds = np.maximum([row[step]["seconds"] for row in own], 1e-9)
        return float(np.polyfit(np.log([row["count"] for row in own]), np.log(seconds), 1)[0])

    kinds = dict.fromkeys(row["kind"] for row in found["rows"])
    kinds = {kind: [row for row in found["rows"] if row["kind"] == kind] for kind in kinds}
    return {kind: {step: exponent(own, step) for step in ("encode", "save")} for kind, own in kinds.items()}


def faces_faults(found):
    of = {row["kind"]: row["of"] for row in found["rows"]}
    return [f"{kind}: seconds of {step} grow with the power {power:.2f} of the {of[kind]}"
            for kind, powers in slopes(found).items() for step, power in powers.items() if power > STEEPEST]


def overhead_of(row):
    """Processor seconds that client and scheduler take for a task."""
    return (row["scheduler"] + row["client"]) / row["tasks"]


def cluster_faults(found):
    faults = [f"{name} was not encoded alone" for name in found["alone"]["failed"]]
    for kind in ("encodes", "naps"):
        for row in found[kind]:
            for key, what in (("lost", "lost"), ("wrong", "another result")):
                faults += [f"{kind}, {row['workers']} workers, {name}: {what}" for name in row[key]]
            faults += [f"{kind}, {row['workers']} workers: {row['twice']} tasks ended twice"] if row["twice"] else []
    return faults + [f"{row['workers']} workers: client and scheduler take {overhead_of(row):.3f} s a task"
                     for row in found["naps"] if overhead_of(row) > NAP]


# Sections of the page: paragraphs, and tables as (head, rows)


def _slope(found):
    yield (f"Resident memory of one process after each call, by least squares after the first {WARM:.0%} of the calls, in which "
           f"caches fill; at most {SLOPE:,} bytes a call. Small scenes of seven kinds take turns: voxels, texels, alpha, maps, "
           "lossless, fast, 3DNTC. ± is the standard error of the slope. The allocator of the C library has one arena here: with "
           "its usual number, each of which keeps what threads have freed, encoding goes up in steps of 25 MB to some 350 MB and "
           "stays there.")
    yield ["what", "calls", "bytes a call", "MB at first", "MB at last"], [
        [kind, row["calls"], f"{row['bytes a call']:,} ± {row['error']:,}", f"{row['first'] / MB:.1f}", f"{row['last'] / MB:.1f}"]
        for kind, row in found.items()]


def _together(found):
    alone, warm, cold, after = (found[name]["seconds"] for name in ("alone", "warm", "cold", "after"))
    yield (f"Each of {found['processes']} codes and decodes the same scenes and vectors, beginning at another; all streams and "
           f"arrays must be those of one alone, which took {alone:.0f} s. With compiled kernels the {found['processes']} took "
           f"{warm:.0f} s, with an empty cache, where each compiles what it finds missing, {cold:.0f} s. They left "
           f"{found['cold']['files']} files of kernels; one process that came after them took {after:.0f} s and wrote "
           f"{found['after']['compiled']} of these again.")


def _batch(found):
    yield (f"`texf-enc --batch` over {found['assets']} good assets and {found['bad']} bad ones (not there, empty, noise, cut "
           "short, a header of 4,000,000,000 vertices, no glTF), two at a time, disturbed and called again with the same words, "
           f"{found['seconds']:.0f} s in all. In the end every good asset must have the stream that `texf-enc` alone makes of "
           "it, every bad one a coded error, and no other file may be there."
           + ("" if found["mounted"] else " The full disk was left out: this system mounts none for us."))
    yield ["disturbed by", "exit code", "streams then"], [[row[key] for key in ("fault", "exit code", "streams")]
                                                          for row in found["tries"]]


def _refused(found):
    rows, tool = found["rows"], found["tool"]
    base = "; ".join(f"{name} {size / MB:.0f} MB" for name, size in found["baselines"].items())
    yield (f"The highest resident memory of a process that refuses one of the {len(rows)} faulty conformance vectors; at most "
           f"{PEAK // MB} MB. Much of it is there before the first byte is read: {base}. Every vector was read in a fork of one "
           f"warm process that held {found['idle'] / MB:.0f} MB; the highest reached "
           f"{max(r['peak'] for r in rows.values()) / MB:.0f} MB. The table has the {WORST} highest of those that `texf-dec` "
           f"refused in a process of its own, which {len(tool)} did.")
    yield ["vector", "exit code", "MB, texf-dec", "MB that it added in a fork"], [
        [name, tool[name]["code"], f"{tool[name]['peak'] / MB:.1f}", f"{(rows[name]['peak'] - rows[name]['began']) / MB:.1f}"]
        for name in sorted(tool, key=lambda name: -tool[name]["peak"])[:WORST]]


def _levels(found):
    yield ("Decoding, with kernels compiled and two threads, of streams that come near one bound of bitstream_spec.md 10.1 each: "
           "tori of vertex colours over voxels, a sheet with waves and noise over texels. Memory is what the process held at "
           "most beyond the idle decoder. Both are proportional to the counts (10.1). Latents were not measured.")
    yield ["level", "near the bound of", "count", "bound", "bytes of the stream", "seconds", "MB", "bytes of memory each"], [
        [row["level"], row["kind"], f"{row['count']:,}", f"{row['bound']:,}", f"{row['bytes']:,}", f"{row['seconds']:.1f}",
         f"{row['memory'] / MB:,.0f}", f"{row['memory'] / row['count']:.0f}"] for row in found["rows"]]


def _faces(found):
    yield ("Encoding with the usual options and decoding to GLB, two threads, kernels compiled, of meshes made by "
           "tests/load/meshes.py: scans, and inputs that are hard. Texels and voxels grow on one scan of "
           f"{FEW:,} faces whose mesh is kept. Seconds are of the processor; silent is the longest part of "
           "them without a word of progress. Memory is what the process held at most beyond what it held before, the image "
           "included. The exponent is of the power of the size that the seconds grow with, by least squares over the "
           f"logarithms; at most {STEEPEST}.")
    head = ["mesh", "size", "s, encode", "s silent", "bytes of memory each", "s, to GLB", "s silent", "bytes of memory each"]
    yield head, [[row["kind"], f"{row['count']:,} {row['of']}",
                  *(cell for step in (row["encode"], row["save"]) for cell in (
                      f"{step['seconds']:.1f}", f"{step['silence']:.1f}", f"{step['memory'] / row['count']:,.0f}"))]
                 for row in found["rows"]]
    yield ["mesh", "exponent, encode", "exponent, to GLB"], [[kind, f"{own['encode']:.2f}", f"{own['save']:.2f}"]
                                                             for kind, own in slopes(found).items()]


def _cluster(found):
    alone, naps, count, sample = found["alone"], found["naps"], found["encodes"][0]["tasks"], found["sample"]
    yield ("Scheduler and workers as processes on the loopback, workers of one thread, all on the processors named above. "
           f"{count} generated spheres of some hundred faces are coded by `texf-enc --effort fast --no-check` in a process each, "
           f"first without Dask, two at a time: {alone['seconds']:.0f} s, {1000 * alone['processor'] / count:,.0f} ms of the "
           "processor each. Every one must come back once, with the same stream. More workers than cores only show that nothing "
           f"breaks. What Dask adds is seen with {naps[0]['tasks']:,} tasks that sleep {1000 * NAP_SECONDS:.0f} ms in the "
           f"encoder's place. The load average of the machine was {found['load']:.1f} before: the lower, the more seconds by the "
           "wall clock say. Milliseconds a task are of the processor.")
    share = lambda row: f"{row['tasks'] * NAP_SECONDS / row['workers'] / row['seconds']:.0%}"
    yield ["tasks", "workers", "count", "s", "tasks a second", "share of what the workers could do", "scheduler, ms a task",
           "client, ms a task", "workers, ms a task"], [
        [kind, row["workers"], row["tasks"], f"{row['seconds']:.0f}", f"{row['tasks'] / row['seconds']:.1f}",
         share(row) if kind == "naps" else "",
         *(f"{1000 * row[key] / row['tasks']:.1f}" for key in ("scheduler", "client", "helpers"))]
        for kind in ("encodes", "naps") for row in found[kind]]
    apart = max(naps[-1]["scheduler"], naps[-1]["client"]) / naps[-1]["tasks"]
    yield (f"**What 10^6 assets would take**, computed and not measured: assets like the demo asset at its default rate take "
           f"{sample['seconds']:.0f} s of the processor each, {MILLION * sample['seconds'] / 3600:,.0f} core hours in all, and "
           f"{MILLION * sample['bytes'] / 1e9:,.0f} GB of streams. Client and scheduler, which cannot be shared out, are two "
           f"processes; the busier one takes {1000 * apart:.1f} ms a task, {MILLION * apart / 86400:.1f} days for 10^6 tasks, so "
           f"that one cluster feeds {sample['seconds'] / apart:,.0f} cores at most with such encodes.")


class Part(NamedTuple):
    """measure: function of the arguments; faults, section: of what it measured."""

    title: str
    measure: Callable
    faults: Callable
    section: Callable


PARTS = {
    "slope": Part("The same again and again", lambda args: run_slopes(args.calls), slope_faults, _slope),
    "together": Part("Processes at once", lambda args: run_together(args.processes), together_faults, _together),
    "batch": Part("A batch with faults", lambda args: run_batch(args.assets), lambda found: found["faults"], _batch),
    "refused": Part("Memory of refused files", lambda args: run_refused(args.every), refused_faults, _refused),
    "levels": Part("At the bounds of a level", lambda args: run_levels(), levels_faults, _levels),
    "faces": Part("Many faces, texels and voxels", lambda args: run_faces(args.faces, large=args.large), faces_faults, _faces),
    "cluster": Part("Through a Dask cluster", lambda args: run_cluster(args.encodes), cluster_faults, _cluster)}


def draw(found, path):
    """Seconds over counts, a line a kind, encode and save, into a PNG; whether matplotlib is there to do so."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    figure, panels = pyplot.subplots(2, 3, figsize=(12, 7), layout="constrained")
    for panel, (step, of) in zip(panels.flat, product(("encode", "save"), ("faces", "texels", "voxels")), strict=True):
        for kind in dict.fromkeys(row["kind"] for row in found["rows"] if row["of"] == of):
            own = [row for row in found["rows"] if row["kind"] == kind]
            panel.plot([row["count"] for row in own], [row[step]["seconds"] for row in own], marker="o", label=kind)
        title = "encode" if step == "encode" else "decode to GLB"
        panel.set(xscale="log", yscale="log", xlabel=of, ylabel=f"processor seconds, {title}")
        panel.grid(True, which="both", alpha=0.3)
        panel.legend(fontsize=7, loc="lower right")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return True


def page_of(found, picture=None):
    """docs/reports/load.md. found: {part: what it measured}; picture: path of draw()'s plot from the page."""
    lines = ["# Under load", "", f"Made by `make -C tools load` (tests/load/run.py) {made_on()}.", ""]
    for part in filter(found.__contains__, PARTS):
        lines += [f"## {PARTS[part].title}", ""]
        for block in PARTS[part].section(found[part]):
            lines += [*([block] if isinstance(block, str) else markdown_table(*block)), ""]
        lines += [f"![processor seconds over faces, texels and voxels]({picture})", ""] if picture and part == "faces" else []
        missed = PARTS[part].faults(found[part])
        lines += ["**Missed:**", "", *(f"- {text}" for text in missed), ""] if missed else ["Nothing misses its target.", ""]
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="repeatable; without it all of them")
    parser.add_argument("--page-only", action="store_true", help="measure nothing")
    parser.add_argument("--out", type=Path, default=Path("out/load"))
    parser.add_argument("--calls", type=int, default=CALLS, metavar="N", help="of each kind")
    parser.add_argument("--processes", type=int, default=8, metavar="N", help="at once")
    parser.add_argument("--assets", type=int, default=GOOD, metavar="N", help="good ones of the batch")
    parser.add_argument("--faces", type=int, nargs="+", default=SIZES, metavar="N", help="of the meshes that grow")
    parser.add_argument("--large", action="store_true", help="let them grow up to three million faces: another half hour")
    parser.add_argument("--encodes", type=int, default=ENCODED, metavar="N", help="for each size of the cluster")
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    files = {part: args.out / f"{part}.json" for part in PARTS}
    for part in [] if args.page_only else args.part or PARTS:
        files[part].write_text(json_text(PARTS[part].measure(args), indent=1), encoding="utf-8")
    found = {part: json.loads(file.read_text(encoding="utf-8")) for part, file in files.items() if file.exists()}
    plot = args.page.parent / "pictures" / "load.png" if args.page and "faces" in found else None
    text = page_of(found, "pictures/load.png" if plot and draw(found["faces"], plot) else None)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return EXIT_DIFFERS if any(PARTS[part].faults(found[part]) for part in found) else 0


if __name__ == "__main__":
    sys.exit(main())
