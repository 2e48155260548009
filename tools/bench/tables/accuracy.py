"""docs/reports/accuracy_time.md: what accuracy costs in time, from the jobs of tools/conditions/accuracy.toml and metrics.toml.

A group of settings is a knob, "{knob}_{value}" the name of a setting. Bytes at equal quality: percent of bytes above the curve
that the defaults have over QP at the same support, at the setting's own dB, so that settings of different bytes and decibels
become one number. A setting is dominated where another value of its knob is no worse in seconds and bytes at equal quality and
better in one. Seconds are the encoder's own on the processor, whatever else the machine does. """

import math
import statistics
from collections import Counter, defaultdict
from typing import NamedTuple

from texfcodec.encoder.explain import BETTER, BUYS, DOMINATED, EQUAL, GAIN, NOISE, SAVES, per_second, verdict
from texfcodec.metrics.bd_rate import difference_at
from tools.bench.plots import load_pyplot, logarithmic
from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table
from tools.bench.results import at, grouped, read_results

VERDICTS = {BETTER: "**better than the default**", BUYS: "buys bytes", SAVES: "saves time", DOMINATED: "no gain",
            EQUAL: "the same"}
DECIBELS, ERROR, BASE_QP, REACH = 0.01, 0.005, "QP_28", 1.0  # gains in dB; REACH: dB beyond the curve's ends that it is asked for
QUALITY, IMAGE = ("psnr_3d", "y"), ("image", "psnr", "y")


class Knob(NamedTuple):
    """A setting that is varied. text: what it is; values: from cheap to dear, "" for numbers; curve: group of its rate curve, ""
    without; auto: whether the rest is left to the encoder; hindsight: whether the default chooses among the other values, and
    pays for it."""

    text: str
    default: str | None
    values: str = ""
    curve: str = "QP"
    auto: bool = False
    hindsight: bool = False
    quality: tuple = QUALITY


KNOBS = {
    "preset": Knob("rate preset, all else left to the encoder", "r04", auto=True),
    "preset with effort": Knob("as the presets, at another effort", None, auto=True),
    "effort": Knob("tools of the coder, partition and weights", "balanced", "fast balanced best"),
    "QP": Knob("quantisation, by image PSNR", "28", "44 36 32 28 24 20 12", quality=IMAGE),
    "K": Knob("voxels along the longest side, times the usual", "1", curve="QP, voxels"),
    "texel size": Knob("texels along an image's side, times the source's", "1", curve="QP, texels"),
    "support": Knob("voxels or texels, at r03", "auto", "voxels texels auto", auto=True, hindsight=True),
    "refinement": Knob("of the colours before coding", "auto", "off auto render", "QP, voxels"),
    "iterations": Knob("of inverse rendering", "30", curve="QP, voxels"),
    "density": Knob("the transfer's samples per voxel edge, no fit after it", "4", curve="QP, voxels"),
    "density before a fit": Knob("the same where a surface fit follows", "3", curve="QP, voxels"),
    "area threshold": Knob("1/256 voxel faces of surface below which a voxel goes", "77", curve="QP, voxels"),
    "partition": Knob("of the mesh into fields where surfaces meet", "auto", "off auto", "QP, voxels"),
    "position bits": Knob("of a vertex coordinate, by image PSNR, because 3D-PSNR does not see where the surface has moved", "14",
                          quality=IMAGE),
    "near-lossless D": Knob("largest error of a coded value, 0: lossless; no fit", None, "8 4 2 1 0"),
    "3DNTC steps": Knob("of the fit, mpeg1", "15000", curve=""),
    "3DNTC size": Knob("points of the paper, 1000 steps", "mpeg1", curve=""),
}


class Cell(NamedTuple):
    """A value of a knob on one asset. percent: bytes above the curve at equal quality, None if out of its range; by: values that
    dominate it."""

    value: str
    seconds: float
    size: int
    quality: float
    percent: float | None
    by: tuple = ()


def dominates(a, b):
    """Return whether a, (seconds, other costs with the gain that counts), is no worse than b throughout and better in one.
    Seconds within NOISE count as equal."""
    (fast, ours), (slow, theirs) = a, b
    no_worse = fast <= slow * (1 + NOISE) and all(x <= y for (x, _), (y, _) in zip(ours, theirs, strict=True))
    better = fast * (1 + NOISE) < slow or any(x < y - gain for (x, gain), (y, _) in zip(ours, theirs, strict=True))
    return no_worse and better


def dominated(points):
    """Return for each of points, (seconds, ((cost, gain), ...)), the indices of those that dominate it."""
    return [[i for i, a in enumerate(points) if dominates(a, b)] for b in points]


def seconds_of(row):
    """Return the processor seconds of a row's encode, or those by the wall clock if an older row has no others."""
    return at(row, ("seconds", "encode", "processor")) or row["seconds"]["encode"]["total"]


def value_of(row):
    """Return the value of the varied setting of a row."""
    return row["setting"].partition("_")[2].replace("_", " ")


def cells_of(name, by_group, asset):
    """Return the [Cell] of a knob (name) on an asset, in the order of its values. by_group: of results.grouped()."""
    knob = KNOBS[name]
    rows = by_group.get(name, {}).get(asset, [])
    order = knob.values.split()
    rows = sorted(rows, key=lambda row: order.index(value_of(row)) if order else _number(value_of(row)))
    curve = curve_of(by_group, asset, knob)
    cells = []
    for row in rows:
        size, quality = row["bytes"]["total"], at(row, knob.quality)
        quality = math.inf if quality is None else quality
        cells.append(Cell(value_of(row), seconds_of(row), size, quality, percent_at(curve, size, quality)))
    if name == "QP":  # it is the curve
        return cells
    has_percent = any(cell.percent is not None for cell in cells)
    known = [cell for cell in cells if cell.percent is not None or not has_percent]
    beaten_sets = dominated([(cell.seconds, ((cell.percent, GAIN),) if has_percent else
                              ((cell.size, 0.001 * cell.size), (-cell.quality, DECIBELS))) for cell in known])
    by = {cell.value: tuple(known[i].value for i in beaten) for cell, beaten in zip(known, beaten_sets, strict=True)}
    return [cell._replace(by=by.get(cell.value, ())) for cell in cells]


def _number(text):
    try:
        return float(text), text
    except ValueError:
        return math.inf, text


def curve_of(by_group, asset, knob):
    """Return the rate curve of a knob's defaults over QP, [(bytes, dB)], without points that another beats in both; may be
    []."""
    rows = by_group.get(knob.curve, {}).get(asset) or by_group.get(knob.curve and "QP", {}).get(asset, [])
    points = sorted((row["bytes"]["total"], at(row, knob.quality)) for row in rows if at(row, knob.quality) is not None)
    return [point for i, point in enumerate(points) if all(quality < point[1] for _, quality in points[:i])]


def percent_at(curve, size, quality):
    """Return by how many percent size is above a curve at a quality in dB; None beyond the curve's ends or if it is []."""
    if len(curve) < 2 or not curve[0][1] - REACH <= quality <= curve[-1][1] + REACH:
        return None
    try:
        return difference_at([b for b, _ in curve], [q for _, q in curve], size, quality)
    except ValueError:
        return None


def steps_of(table):
    """Return [(knob, value, {asset: (extra seconds, extra bytes in percent, verdict)})] of the values next to the default.
    table: {knob: {asset: [Cell]}}."""
    steps = []
    for name, by_asset in table.items():
        trades, knob = defaultdict(dict), KNOBS[name]
        for asset, cells in by_asset.items() if name not in ("preset", "QP") else ():
            cells = [cell for cell in cells if cell.percent is not None]
            place = next((i for i, cell in enumerate(cells) if cell.value == knob.default), None)
            for cell in [] if place is None else cells[max(place - 1, 0): place] + cells[place + 1: place + 2]:
                base = cells[place]
                percent = 100 * ((100 + cell.percent) / (100 + base.percent) - 1)
                trades[cell.value][asset] = (cell.seconds - base.seconds, percent, verdict(base.seconds, cell.seconds, percent))
        steps += [(name, value, trade) for value, trade in trades.items()]
    return steps


def step_lines(table, assets):
    """Return Markdown lines on what one more second buys, by knob and asset. table: as of steps_of()."""
    rows = []
    for name, value, trades in steps_of(table):
        bought = [gain for seconds, percent, word in trades.values() if word not in (BETTER, DOMINATED)
                  and (gain := per_second(1e9, 1e9 + seconds, percent, 0.0)) is not None]
        middle = [statistics.median(trade[i] for trade in trades.values()) for i in (0, 1)]
        word = Counter(trade[2] for trade in trades.values()).most_common(1)[0][0]
        rows.append([name, f"{KNOBS[name].default} to {value}", *(_trade(*trades[a][:2]) if a in trades else "" for a in assets),
                     _trade(*middle), f"{statistics.median(bought):.1f} %" if bought else "",
                     "hindsight" if KNOBS[name].hindsight else VERDICTS[word]])
    return markdown_table(["knob", "step", *assets, "median", "a second more buys", "verdict"], rows, 2)


def _trade(seconds, percent):
    return f"{seconds:+.2f} s, {percent:+.1f} %"


def changes_of(table):
    """Return lines on presets and defaults that are dominated on an asset, the most frequent first. table: see steps_of()."""
    votes, judged = defaultdict(list), Counter()
    for name, by_asset in table.items():
        for asset, cells in by_asset.items():
            for cell in cells:
                if cell.value == KNOBS[name].default and not KNOBS[name].hindsight and name != "preset":
                    judged[name] += 1
                    votes[name] += [f"{asset}: {', '.join(cell.by[:2])}"] if cell.by else []
    for asset, beaten in beaten_presets(table).items():
        for preset, by in beaten.items():
            judged[preset] += 1
            votes[preset] += [f"{asset}: {', '.join(by[:2])}"] if by else []
    ranked = sorted((name for name in votes if votes[name]), key=lambda name: -len(votes[name]) / judged[name])
    return [f"- **{name}**{': ' + KNOBS[name].default if name in KNOBS else ''} is dominated on {len(votes[name])} of "
            f"{judged[name]} ({'; '.join(votes[name])})" for name in ranked] or ["No preset and no default is dominated."]


def beaten_presets(table):
    """Return {asset: {"preset rNN": settings that dominate it in seconds, bytes and dB}}, among those that leave as much to the
    encoder. table: as of steps_of()."""
    beaten_by_asset = {}
    for asset in dict.fromkeys(asset for by_asset in table.values() for asset in by_asset):
        rows = [(f"{name} {cell.value}", cell) for name, by_asset in table.items() if KNOBS[name].auto
                and not KNOBS[name].hindsight for cell in by_asset.get(asset, [])]
        by = dominated([(c.seconds, ((c.size, 0.001 * c.size), (-c.quality, DECIBELS))) for _, c in rows])
        beaten_by_asset[asset] = {name: [rows[i][0] for i in beaten] for (name, _), beaten in zip(rows, by, strict=True)
                                  if name.startswith("preset r") and "effort" not in name}
    return beaten_by_asset


def knob_lines(table, assets):
    """Return the lines of a Markdown table per knob: a row per value, a column per asset. table: as of steps_of()."""
    for name, by_asset in table.items():
        columns = [asset for asset in assets if by_asset.get(asset)]
        values = list(dict.fromkeys(cell.value for asset in columns for cell in by_asset[asset]))
        rows = [[f"{value} (default)" if value == KNOBS[name].default else value,
                 *(next(map(_cell, (c for c in by_asset[asset] if c.value == value)), "") for asset in columns)]
                for value in values]
        yield from [f"### {name}", "", f"{KNOBS[name].text[0].upper()}{KNOBS[name].text[1:]}.", "",
                    *markdown_table([name, *columns], rows), ""]


def _cell(cell):
    quality = "" if math.isinf(cell.quality) else f", {cell.quality:.2f} dB"
    percent = "" if cell.percent is None else f", **{cell.percent:+.1f} %**"
    return f"{'~ ' if cell.by else ''}{cell.seconds:.2f} s, {cell.size:,} B{quality}{percent}"


def metric_lines(rows, assets):
    """Return lines on what the metrics cost and miss: rows of the group "metric" at several evaluations against the largest of
    them, root mean square over seeds."""
    kinds = (("views of the metric", IMAGE, lambda row: (row["image"]["size"], row["image"]["views"]) if row["image"] else None),
             ("samples of 3D-PSNR", QUALITY, lambda row: None if row["image"] else row["psnr_3d"]["samples"]))
    for title, path, key in kinds:
        readings = defaultdict(list)
        for row in rows:
            if key(row) is not None and at(row, path) is not None:
                readings[row["asset"], key(row)].append((at(row, path), row["seconds"]["measure"]))
        if not readings:
            continue
        most, lines = max(value for _, value in readings), []
        for value in sorted({value for _, value in readings} - {most}):
            line = [f"{value[1]} x {value[0]}" if isinstance(value, tuple) else f"{value:,}"]
            for asset in assets:
                runs = readings.get((asset, value))
                truth = statistics.fmean(y for y, _ in readings.get((asset, most), [(math.nan, 0)]))
                line.append("" if not runs else f"{statistics.fmean(s for _, s in runs):.2f} s, "
                            f"{math.sqrt(statistics.fmean((y - truth) ** 2 for y, _ in runs)):.3f} dB")
            lines.append(line)
        yield from [f"### {title}", "", *markdown_table([title, *assets], lines), ""]


def draw(table, assets, path):
    """Plot bytes saved at equal quality against seconds for each asset, with the front, to path. Return False without
    matplotlib."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    lines = -(-len(assets) // 2)
    figure, panels = pyplot.subplots(lines, min(len(assets), 2), figsize=(14, 4.6 * lines), squeeze=False)
    for panel, asset in zip(panels.flat, assets, strict=False):
        cells = [(name, cell) for name, by_asset in table.items() if name != "QP" for cell in by_asset.get(asset, [])
                 if cell.percent is not None and (cell.value != KNOBS[name].default or KNOBS[name].auto)]
        points = sorted((cell.seconds, -cell.percent, f"{name} {cell.value}", KNOBS[name].auto) for name, cell in cells)
        front = [p for i, p in enumerate(points) if all(other[1] < p[1] for other in points[:i])]
        panel.plot([p[0] for p in front], [p[1] for p in front], "-", color="#1b7f3b", lw=2, zorder=1)
        for seconds, saved, label, auto in points:
            panel.plot(seconds, max(saved, -40), "s" if auto else "x", color="#1f4e9c" if auto else "#9a9a9a")
            panel.annotate(label, (seconds, max(saved, -40)), xytext=(6, 4), textcoords="offset pixels", fontsize=7)
        panel.set(title=asset, xlabel="encode, processor seconds, one thread", ylabel="bytes saved at equal quality, %")
        logarithmic(panel)
        panel.grid(alpha=0.25)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return True


def page(args):
    """Return the lines of the whole page. args: parsed arguments of collect.py; the plot goes into pictures/ beside args.out."""
    every = [row for folder in args.results for row in read_results(folder)]
    rows = [row for row in every if row["group"] != "metric"]
    by_group, assets = grouped(rows), list(dict.fromkeys(row["asset"] for row in rows))
    table = {name: {asset: cells for asset in assets if (cells := cells_of(name, by_group, asset))} for name in KNOBS
             if name in by_group}
    shares = ", ".join(f"{row['asset']} {100 * row['bytes']['geometry'] / row['bytes']['total']:.0f} %" for row in rows
                       if row["setting"] == BASE_QP)
    plot = args.out.parent / "pictures" / "accuracy_time.png"
    lines = ["# What accuracy costs in time", "", f"{', '.join(assets)}; one thread, warm kernels, processor seconds of an "
             f"encode without loading, once. Made by `make -C tools accuracy` {made_on()}.", "",
             f"Bytes are those of the whole stream (geometry at QP 28: {shares}). *Bytes at equal quality* compares a setting "
             "with the curve that the defaults have over QP, at the setting's own 3D-PSNR of Y. A setting is dominated where "
             f"another is no worse and better in one thing, by more than {100 * NOISE:.0f} % of seconds, {GAIN} % of bytes or "
             f"{DECIBELS} dB.", ""]
    if draw(table, assets, plot):
        lines += [f"![bytes saved at equal quality against seconds, an asset a panel](pictures/{plot.name})", "",
                  "The green line is the front: no setting is both faster and smaller. Blue squares leave all else to the "
                  "encoder.", ""]
    lines += ["## What one more second buys", "", "A step from the default, up or down: seconds, and bytes at equal quality. The "
              "verdict is what most assets say; *hindsight* is a value that the default may choose by itself, and pays for "
              "finding out.", "", *step_lines(table, assets), "", "## To change", "", *changes_of(table), ""]
    lines += ["## Knob by knob", "", "Seconds, bytes, dB, and in bold the bytes above the defaults' curve at equal quality; ~ "
              "marks what another value of the same knob dominates. An empty cell was not measured, or has no meaning for the "
              "asset.", "", *knob_lines(table, assets)]
    return [*lines, *metric_lines([row for row in every if row["group"] == "metric"], assets)]
