"""What accuracy costs: seconds, bytes and decibels of one asset over the encoder's settings, and which settings others beat.

python tools/accuracy_time.py --asset PATH|sample [--quick] --out FOLDER

Sweeps K and QP, effort, the transfer's samples per voxel edge, and refinement by kind and iterations, each against the package's
defaults. A point is the median of 3 encodes in this process, with all threads and warm kernels, loading left out; the bytes of
the stream, geometry left out; and the 3D-PSNR of Y. --quick takes a few points at K 1024 and fewer samples. Writes points.csv,
points.md, points.png (where matplotlib is installed) and points.jsonl, a line per encode: the same command goes on from there,
and measures again what other code, another asset or another number of threads has measured.

A setting is dominated where another one is no worse in seconds, bytes and decibels and better in one of them; seconds that
differ by 5 % or less count as equal, and better is from 0.1 % of bytes and 0.01 dB on. At one K and QP bytes and decibels become
one number: with B0 bytes of the defaults there and s the slope in dB per doubling of bytes of the defaults' own curve over QP at
B0,

    quality at equal bytes = dB - s * log2(bytes / B0)

is what a setting would reach at the bytes of the defaults, and seconds against that is the second front.
"""

import argparse
import csv
import itertools
import json
import math
import statistics
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from texfcodec.api import decode, encode, encode_to_result
from texfcodec.asset.load.files import load
from texfcodec.choose.prepare import TRANSFER_DENSITY
from texfcodec.options import EFFORTS, RATES, REFINEMENTS, DecodeOptions, EncodeOptions, default_threads
from texfcodec.quality.measure import SourceSamples
from tools.batch import resumable, warm_cache
from tools.conditions import SAMPLE
from tools.jobs import code_of
from tools.plots import load_pyplot, logarithmic
from tools.result_tables import markdown_table
from tools.results import rate_of

NOISE = 0.05  # seconds that differ by no more count as equal
RUNS = 3
BASE = (1024, 28)  # K and QP at which one setting after the other is changed
RESOLUTIONS, QPS, DENSITIES = (512, 1024, 1536, 2048), (24, 26, 28, 32, 36), (2, 3, 4, 6, 8)
ITERATIONS = (10, 100)  # of inverse rendering, beside the default; it takes a minute, and so is asked for at BASE alone
WARM_RESOLUTION = 256
SAMPLES, QUICK_SAMPLES = 1_000_000, 200_000
COLUMNS = ("name", "resolution", "qp", "effort", "density", "refine", "iterations", "seconds", "spread", "bytes", "geometry",
           "psnr_y", "dominated_by", "quality_at_equal_bytes")
DEFAULTS = EncodeOptions()


@dataclass(frozen=True)
class Point:
    """One setting of the sweep. density: of the transfer; refine, iterations: of EncodeOptions; None: the package's default."""

    resolution: int
    qp: int
    effort: str = DEFAULTS.effort
    density: int | None = None
    refine: str | None = None
    iterations: int | None = None

    @property
    def name(self):
        parts = [f"K {self.resolution} QP {self.qp}", self.effort if self.effort != DEFAULTS.effort else None,
                 self.density and f"density {self.density}", self.refine and f"refine {self.refine}",
                 self.iterations and f"x{self.iterations}"]
        return " ".join(p for p in parts if p)

    def options(self, threads):
        """EncodeOptions of this point; its density is set by transfer_density."""
        chosen = {"refine": self.refine, "refine_iterations": self.iterations}
        return EncodeOptions(resolution=self.resolution, qp=self.qp, effort=self.effort, threads=threads,
                             **{k: v for k, v in chosen.items() if v is not None})


@dataclass
class Measured:
    """A point and what it took. seconds: median of its runs; spread: longest run over shortest, less 1; bytes: all but geometry;
    quality: at equal bytes, for points of BASE; by: names of the points that dominate it."""

    point: Point
    seconds: float
    bytes: int
    geometry: int
    psnr_y: float
    spread: float = 0.0
    quality: float | None = None
    by: list = field(default_factory=list)

    @property
    def name(self):
        return self.point.name


def sweep(quick):
    """The points to measure, without doubles, BASE first."""
    k, qp = BASE
    points = [Point(k, qp)]
    if quick:
        points += [Point(k, other) for other in (24, 32)]
        points += [Point(k, qp, effort) for effort in EFFORTS]
        points += [Point(k, qp, density=2, refine="off"), Point(k, qp, refine="off")]
    else:
        points += [Point(*each) for each in ((r, q) for r in RESOLUTIONS for q in QPS)]
        points += [Point(*each, effort) for effort in EFFORTS for each in RATES.values()]
        points += [Point(k, qp, density=d, refine="off") for d in DENSITIES]
        for kind in (r for r in REFINEMENTS if r != DEFAULTS.refine):
            points += [Point(k, q, refine=kind) for q in ((qp,) if kind == "render" else (24, 28, 32, 36))]
        points += [Point(k, qp, refine="render", iterations=n) for n in ITERATIONS]
    return list(dict.fromkeys(points))


@contextmanager
def transfer_density(effort, density):
    """The transfer's most samples per voxel edge at an effort, for a while; None changes nothing."""
    usual = TRANSFER_DENSITY[effort]
    TRANSFER_DENSITY[effort] = usual if density is None else density
    try:
        yield
    finally:
        TRANSFER_DENSITY[effort] = usual


class Bench:
    """Runs points of one asset."""

    def __init__(self, scene, samples, threads):
        self.scene, self.threads, self.warm = scene, threads, set()
        self.samples = SourceSamples(scene, samples, threads)

    def run(self, point, with_quality):
        """One encode with warm kernels: {"seconds", "bytes", "geometry", "psnr_y"}, the last None where it is lossless or was not
        asked for."""
        options, kind = point.options(self.threads), (point.effort, point.refine)
        with transfer_density(point.effort, point.density):
            if kind not in self.warm:
                encode(self.scene, replace(options, resolution=WARM_RESOLUTION, refine_iterations=1))
                self.warm.add(kind)
            begin = time.perf_counter()
            made = encode_to_result(self.scene, options)
            seconds = time.perf_counter() - begin
        psnr = None
        if with_quality:
            texf = decode(made.data, DecodeOptions(threads=self.threads))
            psnr = self.samples.compare(texf, made.face_field)["y"]
        return {"seconds": round(seconds, 4), "bytes": rate_of({"bytes": made.sizes}, "texture"),
                "geometry": made.sizes["geometry"], "psnr_y": psnr}


def run_sweep(points, bench, cache, conditions):
    """Measured of every point, in their order. All points are run once, then all again, so that a busy spell of the machine does
    not meet one of them alone; runs that a line of the file `cache` has under these conditions are not repeated. conditions:
    JSON-ready dict of what else the figures depend on; bench: function that returns the Bench."""
    runs = read_runs(cache, conditions)
    for number, (turn, point) in enumerate(itertools.product(range(RUNS), points), 1):
        known = runs.setdefault(point, [])
        if len(known) > turn:
            continue
        known.append(bench().run(point, not known))
        with open(cache, "a", encoding="utf-8") as file:
            file.write(json.dumps({**conditions, "point": vars(point), "run": known[-1]}) + "\n")
        print(f"[{number}/{RUNS * len(points)}] {point.name}: {known[-1]['seconds']:.2f} s, {known[-1]['bytes']:,} bytes",
              file=sys.stderr, flush=True)
    return [measured_of(point, runs[point]) for point in points]


def measured_of(point, runs):
    """Measured of the runs of a point."""
    seconds, first = [r["seconds"] for r in runs], runs[0]
    return Measured(point, statistics.median(seconds), first["bytes"], first["geometry"],
                    math.inf if first["psnr_y"] is None else first["psnr_y"], max(seconds) / min(seconds) - 1)


def read_runs(cache, conditions):
    """{Point: its runs} of the lines with these conditions; a line that was cut off is passed over, and ended."""
    text, runs = cache.read_text(encoding="utf-8") if cache.exists() else "", {}
    if text and not text.endswith("\n"):
        with open(cache, "a", encoding="utf-8") as file:
            file.write("\n")
    for line in text.splitlines():
        try:
            line = json.loads(line)
        except ValueError:
            continue
        if all(line.get(k) == v for k, v in conditions.items()):
            runs.setdefault(Point(**line["point"]), []).append(line["run"])
    return runs


# Fronts. Costs are tuples where less is better, with a (slack, gain) for each: what may be worse by the slack and still counts as
# no worse, and what counts as better only from the gain on. Only seconds have slack, so that no two settings dominate each other.

SECONDS, BYTES, DECIBELS = (math.log1p(NOISE), math.log1p(NOISE)), (0.0, 0.001), (0.0, 0.01)  # logarithms, and -dB


def dominates(a, b, axes):
    """Whether costs a are no worse than costs b throughout and better in one."""
    sides = list(zip(a, b, axes, strict=True))
    return all(x <= y + slack for x, y, (slack, _) in sides) and any(x < y - gain for x, y, (_, gain) in sides)


def dominators(costs, axes):
    """For each of the costs the indices of those that dominate it; the front are those with an empty list."""
    return [[i for i, a in enumerate(costs) if dominates(a, b, axes)] for b in costs]


def slope_at(sizes, psnr, size):
    """dB per doubling of bytes of a rate curve at a size in bytes; by PCHIP, or through the two points where there are two."""
    from scipy.interpolate import PchipInterpolator

    order = np.argsort(sizes)
    x, y = np.log2(np.asarray(sizes, np.float64)[order]), np.asarray(psnr, np.float64)[order]
    return float((y[1] - y[0]) / (x[1] - x[0]) if len(x) == 2 else PchipInterpolator(x, y).derivative()(np.log2(size)))


def equal_bytes_quality(psnr, size, base_size, slope):
    """dB that a setting would reach at base_size bytes, by the local slope."""
    return psnr - slope * math.log2(size / base_size)


def weigh(measured):
    """Fills `by` of all and `quality` of the points of BASE; returns (those points, their dominators in seconds and quality, the
    slope)."""
    costs = [(math.log(m.seconds), math.log(m.bytes), -m.psnr_y) for m in measured]
    for row, beaten in zip(measured, dominators(costs, (SECONDS, BYTES, DECIBELS)), strict=True):
        row.by = [measured[i].name for i in beaten]
    curve = [m for m in measured if m.point == Point(BASE[0], m.point.qp) and math.isfinite(m.psnr_y)]
    base = next((m for m in curve if m.point.qp == BASE[1]), None)
    if base is None or len(curve) < 2:
        raise SystemExit(f"the defaults have no rate curve at K {BASE[0]}: this asset is coded without loss")
    slope = slope_at([m.bytes for m in curve], [m.psnr_y for m in curve], base.bytes)
    there = [m for m in measured if (m.point.resolution, m.point.qp) == BASE]
    for m in there:
        m.quality = equal_bytes_quality(m.psnr_y, m.bytes, base.bytes, slope)
    return there, dominators([(math.log(m.seconds), -m.quality) for m in there], (SECONDS, DECIBELS)), slope


# What is written.


def write_csv(measured, path):
    """A row per point."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for m in measured:
            p = m.point
            density = TRANSFER_DENSITY[p.effort] if p.density is None else p.density
            writer.writerow([m.name, p.resolution, p.qp, p.effort, density, p.refine or DEFAULTS.refine,
                             p.iterations or "", f"{m.seconds:.4f}", f"{m.spread:.3f}", m.bytes, m.geometry, f"{m.psnr_y:.4f}",
                             "; ".join(m.by), "" if m.quality is None else f"{m.quality:.4f}"])


def report(title, measured, there, beaten, slope):
    """points.md: the claims first, then both tables."""
    lines = [f"# Accuracy and time: {title}", "",
             f"Encode seconds are medians of {RUNS}, warm; bytes are all but geometry's {measured[0].geometry:,}. Dominated: "
             "another setting is no worse in each and better in one, by more than 5 % of seconds, 0.1 % of bytes or 0.01 dB.",
             "", noise_seen(measured), ""]
    lines += ["## Presets and defaults", "", *(f"- {claim}" for claim in claims(measured)), ""]
    lines += [f"## At K {BASE[0]}, QP {BASE[1]}", "",
              f"Quality at equal bytes = dB - s * log2(bytes / B0): the defaults take B0 = {there[0].bytes:,} bytes, and gain "
              f"s = {slope:.3f} dB per doubling of bytes over QP there. Bytes at equal dB say the same the other way.", ""]
    rows = []
    for m, by in sorted(zip(there, beaten, strict=True), key=lambda pair: pair[0].seconds):
        percent = 100 * (2 ** ((there[0].quality - m.quality) / slope) - 1)
        rows.append([m.name, f"{m.seconds:.2f}", f"{m.bytes:,}", f"{m.psnr_y:.2f}", f"{m.quality:.2f}", f"{percent:+.1f} %",
                     _names([there[i].name for i in by])])
    head = ["setting", "s", "bytes", "dB", "dB at equal bytes", "bytes at equal dB", "dominated by"]
    lines += [*markdown_table(head, rows), "", "## All settings: seconds, bytes, dB", ""]
    rows = [[m.name, f"{m.seconds:.2f}", f"{m.bytes:,}", f"{m.psnr_y:.2f}", _names(m.by)]
            for m in sorted(measured, key=lambda m: m.bytes)]
    return "\n".join([*lines, *markdown_table(["setting", "s", "bytes", "dB", "dominated by"], rows), ""])


def noise_seen(measured):
    """A sentence on how far the runs of a point lie apart: whether the seconds are worth their tolerance."""
    spreads = sorted(m.spread for m in measured)
    middle, most = (100 * statistics.median(spreads), 100 * spreads[-1])
    quiet = "" if middle <= 100 * NOISE else " **The machine was too busy for claims about seconds.**"
    return f"A point's slowest run takes {middle:.0f} % longer than its fastest in the median, {most:.0f} % at most.{quiet}"


def _names(names):
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") if names else "front"


def claims(measured):
    """A sentence per preset, at the default effort: whether it lies on the front of seconds, bytes and dB."""
    rows = {m.point: m for m in measured}
    for name, (resolution, qp) in RATES.items():
        m = rows.get(Point(resolution, qp))
        what = f"{name} (K {resolution}, QP {qp}, {DEFAULTS.effort}"
        if m is None:
            yield f"{what}): not in this sweep"
        else:
            place = f"dominated by {_names(m.by)}" if m.by else "on the front"
            yield f"{what}; {m.seconds:.2f} s, {m.bytes:,} bytes, {m.psnr_y:.2f} dB): {place}"


def draw(measured, there, beaten, path):
    """Both fronts as points.png; a sentence on stderr where matplotlib is not installed."""
    pyplot = load_pyplot()
    if pyplot is None:
        return
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(14, 6))
    front = sorted((m.seconds, m.quality) for m, by in zip(there, beaten, strict=True) if not by)
    left.plot(*zip(*front, strict=True), "-", color="tab:green", label="front")
    for m, by in zip(there, beaten, strict=True):
        left.plot(m.seconds, m.quality, "x" if by else "o", color="tab:red" if by else "tab:green")
        left.annotate(m.name.removeprefix(f"K {BASE[0]} QP {BASE[1]}").strip() or "defaults", (m.seconds, m.quality), fontsize=8,
                      xytext=(4, 4), textcoords="offset points")
    left.set(title=f"K {BASE[0]}, QP {BASE[1]}: dominated settings crossed", xlabel="encode, seconds",
             ylabel="3D-PSNR Y at equal bytes, dB")
    shown = [m for m in measured if math.isfinite(m.psnr_y)]
    for marker, kept in (("o", [m for m in shown if not m.by]), ("x", [m for m in shown if m.by])):
        dots = right.scatter([m.bytes / 1000 for m in kept], [m.psnr_y for m in kept], c=[m.seconds for m in kept], marker=marker,
                             vmin=min(m.seconds for m in shown), vmax=max(m.seconds for m in shown), cmap="viridis")
    figure.colorbar(dots, ax=right, label="encode, seconds")
    for m in (m for m in shown if m.by):
        right.annotate(m.name, (m.bytes / 1000, m.psnr_y), fontsize=6, xytext=(4, -3), textcoords="offset points")
    presets = {Point(*point): name for name, point in RATES.items()}
    for m in (m for m in shown if m.point in presets):
        right.annotate(presets[m.point], (m.bytes / 1000, m.psnr_y), fontsize=9, weight="bold", xytext=(-12, 6),
                       textcoords="offset points")
    right.set(title="all settings; o: front of seconds, bytes and dB, x: dominated", xlabel="bytes, thousands",
              ylabel="3D-PSNR Y, dB")
    logarithmic(right)
    for panel in (left, right):
        panel.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run(args):
    """The sweep of the command line; its exit code."""
    from hashlib import sha256

    from texfcodec.asset.sample_asset import make_sample

    own, threads, samples = str(args.asset) == SAMPLE, default_threads(), QUICK_SAMPLES if args.quick else SAMPLES
    if not own and not args.asset.is_file():
        raise SystemExit(f"{args.asset}: there is no such file")
    args.out.mkdir(parents=True, exist_ok=True)
    asset = SAMPLE if own else sha256(args.asset.read_bytes()).hexdigest()
    conditions = {"asset": asset, "code": code_of("texf", ()), "threads": threads, "samples": samples}
    made = []

    def bench():  # not before there is something to measure
        if not made:
            warm_cache()
            made.append(Bench(make_sample() if own else load(args.asset), samples, threads))
        return made[0]

    measured = run_sweep(sweep(args.quick), bench, args.out / "points.jsonl", conditions)
    there, beaten, slope = weigh(measured)
    write_csv(measured, args.out / "points.csv")
    text = report(args.asset.stem, measured, there, beaten, slope)
    (args.out / "points.md").write_text(text, encoding="utf-8")
    draw(measured, there, beaten, args.out / "points.png")
    print("\n".join(claims(measured)))
    return 0


def main(arguments=None):
    """Command line of the tool; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", type=Path, required=True, metavar="PATH", help="a mesh, or \"sample\"")
    parser.add_argument("--quick", action="store_true", help="a few points, in two minutes")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    return resumable(run, parser.parse_args(arguments))


if __name__ == "__main__":
    sys.exit(main())
