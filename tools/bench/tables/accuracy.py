"""docs/reports/accuracy_time.md: what accuracy costs in time, from rows of tools/bench/ladders.py; NOTE says how they compare."""

import json
import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np

from texfcodec.encoder.explain import NOISE
from tools.bench.plots import load_pyplot, logarithmic
from tools.bench.provenance import made_on
from tools.bench.result_tables import markdown_table
from tools.bench.tables.lit import hull

REACH, AIMS = 0.5, (40, 82)  # dB beyond a curve's ends; qualities of the base whose PSNRs all rungs are compared at
USUAL = {"ours": "balanced", "avif6": 6, "webp4": 4, "jxl": 7, "etc1s": 0, "uastc": 0, "hevc": "slow", "tmc13": "raht"}
BASE, OURS = ("avif6", 6, 1), ("ours", "balanced", 1)
NOTE = (
    "Bytes are those of whole files, in percent of Draco with AVIF at speed 6, at the PSNR of Y in daylight (the scan: unlit; "
    "8 views of 512 pixels) that this has at qualities 40 and 82. A tool's usual effort is measured at several and "
    "interpolated there; another effort is measured at one and keeps its ratio to the usual one. Tools that do not come near "
    "that PSNR are compared at their own. Seconds are of the processor, with one thread, of coding from arrays and of "
    "decoding to arrays, ours by the native library, as wheels have it; those of whole programs are of the process, and of our "
    "loader. Means over assets are geometric; a rung that is measured on fewer assets (hollow marks: slow ones, where a large "
    "asset would take minutes) has the mean of its ratios to the tool's usual effort there. The grey line is the front: no rung "
    "is both faster and smaller.")
KNOBS = (
    "Each asset at r03 and balanced beside one change, as texf-enc --explain-time shows it for an asset of your own: its "
    "processor seconds in units of ours, its bytes at equal PSNR in daylight, and how often which verdict. What stays "
    "although a column may speak for it: position bits (12 cost the fish 22 % more bytes in light, and the encoder takes more "
    "than 14 where pictures show it); partition, K and refinement, which the encoder chooses by asset and pays for finding "
    "out; three samples an edge before a surface fit, where two save the player 0.7 % and cost house_mask over voxels 12 %.")
ABSENT = (
    "Not here: UVAtlas, which takes 100 to 1,700 s; toktx (KTX2 is coded by Basis Universal's encoder, as a library); images "
    "by gltfpack, whose build for npm codes none. HEVC over new UVs (xatlas) and TMC13 over our voxels code base colours "
    "alone, so they stand with the scan. glTF knows no JPEG XL, and few browsers do.")
# Names for readers, colours and marks; at most ten.
TOOLS = {"ours": ("texfcodec", "#c2410c", "o"), "avif6": ("Draco, AVIF", "#1f4e9c", "s"),
         "webp4": ("Draco, WebP", "#1b7f3b", "^"), "jxl": ("Draco, JPEG XL", "#7c3aed", "v"),
         "etc1s": ("Draco, KTX2 ETC1S", "#0891b2", "D"), "uastc": ("Draco, KTX2 UASTC", "#64748b", "d"),
         "hevc": ("UV-Reparam, HEVC", "#be185d", "P"), "tmc13": ("TMC13, our voxels", "#a16207", "X"),
         "gltf-transform": ("gltf-transform optimize", "#111111", "*"),
         "gltfpack": ("gltfpack", "#8a8a8a", "p"), "texf-enc": ("texf-enc", "#c2410c", "*")}
PROGRAMS = "texf-enc", "gltf-transform", "gltfpack"


class Cell(NamedTuple):
    """A rung on an asset, or in the mean of `assets` ones. percent: bytes, of the base's at equal PSNR; encode, decode: processor
    seconds; wall: of encoding; size, psnr: of its middle point."""

    percent: float
    encode: float
    decode: float
    wall: float
    size: float = 0.0
    psnr: float = 0.0
    assets: int = 1

    def seconds(self, side):
        return getattr(self, side)


def mean(values):
    """Return the geometric mean of positive numbers."""
    return math.exp(math.fsum(map(math.log, values)) / len(values))


class Curve:
    """Bytes and seconds of a rung over PSNR on an asset. rows: its points, those off the hull left out."""

    def __init__(self, rows):
        kept = set(hull([(row["bytes"], row["psnr"]) for row in rows]))
        rows = sorted((row for row in rows if (row["bytes"], row["psnr"]) in kept), key=lambda row: row["psnr"])
        self.psnr, self.logs = [row["psnr"] for row in rows], np.array([logs_of(row) for row in rows])

    def reaches(self, psnr):
        """Return whether the points come within REACH of a PSNR."""
        return self.psnr[0] - REACH <= psnr <= self.psnr[-1] + REACH

    def at(self, psnr):
        """Logarithms of (bytes, seconds to encode, to decode, of wall) at a PSNR: linear between points and beyond the ends."""
        if len(self.psnr) == 1:
            return self.logs[0]
        n = int(np.clip(np.searchsorted(self.psnr, psnr), 1, len(self.psnr) - 1))
        share = (psnr - self.psnr[n - 1]) / (self.psnr[n] - self.psnr[n - 1])
        return (1 - share) * self.logs[n - 1] + share * self.logs[n]


def logs_of(row):
    """Return the logarithms that Curve.at() returns, of a row."""
    return np.log([row["bytes"], *(max(seconds, 1e-4) for seconds in (row["encode"][0], row["decode"][0], row["encode"][1]))])


def usual_of(rung):
    """Return the usual rung of a rung's tool."""
    return rung[0], USUAL.get(rung[0], rung[1]), 1


def cells_of(rows):
    """Return {(tool, effort, threads): {asset: Cell}} of rows, in their order."""
    points, cells = defaultdict(lambda: defaultdict(list)), defaultdict(dict)
    for row in rows:
        points[row["asset"]][row["tool"], row["effort"], row["threads"]].append(row)
    for asset, rungs in points.items():
        curves = {rung[0]: Curve(rungs.get(usual_of(rung), held)) for rung, held in rungs.items()}
        aims = [row["psnr"] for row in rungs.get(BASE, []) if row["point"] in AIMS]
        for rung, held in rungs.items() if BASE in rungs else ():
            cells[rung][asset] = cell_of(held, curves[rung[0]], curves[BASE[0]], aims)
    return cells


def cell_of(held, usual, base, aims):
    """Return the Cell of a rung's rows on an asset. usual, base: Curves of the tool's usual effort and of BASE; aims: PSNRs."""
    reached = [psnr for psnr in aims if usual.reaches(psnr)]
    if reached and len(usual.psnr) > 1:
        offset = np.mean([logs_of(row) - usual.at(row["psnr"]) for row in held], axis=0)
        logs = [usual.at(psnr) + offset for psnr in reached]
    else:
        reached, logs = [row["psnr"] for row in held], [logs_of(row) for row in held]
    shares = [ours[0] - base.at(psnr)[0] for psnr, ours in zip(reached, logs, strict=True) if base.reaches(psnr)]
    percent = math.exp(np.mean(shares)) if shares else math.nan
    middle = sorted(held, key=lambda row: row["bytes"])[len(held) // 2]
    return Cell(100 * percent, *np.exp(np.mean(logs, axis=0)[1:]).tolist(), middle["bytes"], middle["psnr"])


def means_of(cells):
    """Return {rung: Cell} of the mean over assets, without the tools that code the scan alone. cells: of cells_of()."""
    known = {rung: {asset: cell for asset, cell in held.items() if math.isfinite(cell.percent)}
             for rung, held in cells.items() if rung[0] not in ("hevc", "tmc13")}

    def ratios(rung, other):
        both = [(cell, known[other][asset]) for asset, cell in known[rung].items() if asset in known.get(other, {})]
        return np.array([mean([a[i] / b[i] for a, b in both]) for i in range(4)]) if both else None

    whole, means = np.array([mean([cell[i] for cell in known[BASE].values()]) for i in range(4)]), {}
    for rung, held in known.items():
        steps = ratios(rung, usual_of(rung)), ratios(usual_of(rung), BASE) if usual_of(rung) in known else None
        if steps[0] is not None and steps[1] is not None:
            means[rung] = Cell(*(whole * steps[0] * steps[1]).tolist(), assets=len(held))
    return means


def front(points, side):
    """Return the rungs on the front, fastest first. points: {rung: Cell}; side: "encode" or "decode"."""
    kept, least = [], math.inf
    for rung, cell in sorted(points.items(), key=lambda item: (item[1].seconds(side), item[1].percent)):
        if cell.percent < least:
            kept.append(rung)
            least = cell.percent
    return kept


def plotted(points):
    """Return those of {rung: Cell} with one thread and a percent, without texf-enc, and gltfpack, which codes no images."""
    return {rung: cell for rung, cell in points.items()
            if rung[2] == 1 and rung[0] not in ("texf-enc", "gltfpack") and math.isfinite(cell.percent)}


def draw_panel(panel, points, side, title):
    """Draw the ladders of {rung: Cell} and their front into a matplotlib panel."""
    by_tool = defaultdict(list)
    for rung, cell in plotted(points).items():
        by_tool[rung[0]].append((cell.seconds(side), cell.percent, rung[1], cell.assets))
    line = [points[rung] for rung in front(plotted(points), side)]
    panel.step([c.seconds(side) for c in line], [c.percent for c in line], where="post", color="#cfcfcf", lw=6, zorder=0)
    most = max(cell.assets for cell in points.values())
    for tool, (name, colour, mark) in ((tool, look) for tool, look in TOOLS.items() if tool in by_tool):
        held = by_tool[tool]
        held.sort()
        panel.plot([h[0] for h in held], [h[1] for h in held], "-", color=colour, lw=1, label=name, marker=mark, ms=5)
        few = [h for h in held if h[3] < most]
        panel.plot([h[0] for h in few], [h[1] for h in few], mark, color=colour, mfc="white", ms=5)
        for seconds, percent, effort, _ in (held[0], held[-1]) if len(held) > 1 and side == "encode" else ():
            panel.annotate(effort, (seconds, percent), xytext=(3, 4), textcoords="offset points", fontsize=7, color=colour)
    panel.set(title=title, xlabel=f"{side}, processor seconds, one thread", ylabel="bytes at equal PSNR, % of AVIF 6",
              yscale="log")
    logarithmic(panel)
    panel.grid(alpha=0.25, which="both")
    from matplotlib.ticker import NullFormatter

    panel.set_yticks([25, 50, 100, 200, 400, 800], ["25", "50", "100", "200", "400", "800"])
    panel.yaxis.set_minor_formatter(NullFormatter())


def draw(cells, means, folder):
    """Write accuracy_time.png, the mean, and accuracy_time_assets.png into a folder. Return False without matplotlib."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    assets = list(cells[BASE])
    by_asset = {asset: {rung: held[asset] for rung, held in cells.items() if asset in held} for asset in assets}
    for name, shape, jobs in (
            ("accuracy_time", (1, 2), [(means, "encode", "mean: encode"), (means, "decode", "mean: decode")]),
            ("accuracy_time_assets", (-(-len(assets) // 2), 2), [(by_asset[asset], "encode", asset) for asset in assets])):
        figure, panels = pyplot.subplots(*shape, figsize=(13, 4.8 * shape[0]), squeeze=False)
        for panel, job in zip(panels.flat, jobs, strict=False):
            draw_panel(panel, *job)
        names = {label: handle for panel in panels.flat for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)}
        figure.legend(names.values(), names, loc="lower center", ncols=5, fontsize=9)
        figure.tight_layout(rect=(0, 0.6 / figure.get_figheight(), 1, 1))
        figure.savefig(folder / f"{name}.png", dpi=100)
        pyplot.close(figure)
    return True


def mean_lines(means):
    """Return the Markdown table of all rungs in the mean. means: of means_of()."""
    fronts = {side: front(plotted(means), side) for side in ("encode", "decode")}
    rows = [[TOOLS[rung[0]][0], rung[1], cell.assets, f"{cell.percent:.0f} %",
             *(f"{'**' * (rung in fronts[side])}{cell.seconds(side):.{places}f}{'**' * (rung in fronts[side])}"
               for side, places in (("encode", 2), ("decode", 3)))]
            for tool in TOOLS for rung, cell in sorted(means.items(), key=lambda item: item[1].encode)
            if rung[0] == tool and rung in plotted(means)]
    return markdown_table(["tool", "effort", "assets", "bytes", "encode, s", "decode, s"], rows, 2)


def share_of(cell):
    """Return the bytes of a Cell in words: percent, or kB where AVIF does not come as close."""
    return f"{cell.percent:.0f} %" if math.isfinite(cell.percent) else f"{cell.size / 1e3:,.0f} kB ({cell.psnr:.1f} dB)"


def asset_lines(cells):
    """Return the Markdown table of ours by asset: each effort beside AVIF at speed 6."""
    efforts = [rung for rung in cells if rung[0] == "ours" and rung[2] == 1]
    rows = []
    for asset, base in cells[BASE].items():
        held = [cells[rung].get(asset) for rung in efforts]
        rows.append([asset, f"{base.encode:.1f} s, {base.decode:.2f} s",
                     *("" if cell is None else f"{share_of(cell)}, {cell.encode:.1f} s, {cell.decode:.2f} s" for cell in held)])
    return markdown_table(["asset", "AVIF 6", *(rung[1] for rung in efforts)], rows)


def program_lines(cells):
    """Return the Markdown table of whole programs by asset."""
    rungs = [rung for rung in cells if rung[0] in PROGRAMS]
    rows = [[asset, *("" if (cell := cells[rung].get(asset)) is None else
                      f"{cell.size / 1e3:,.0f} kB, {cell.psnr:.1f} dB, {cell.encode:.1f} s" for rung in rungs)]
            for asset in cells[BASE]]
    return markdown_table(["asset", *(f"{TOOLS[rung[0]][0]} {rung[1]}" for rung in rungs)], rows)


def thread_lines(cells):
    """Return the Markdown table of rungs that are measured with two threads: seconds with one and two."""
    rows = []
    for rung in (rung for rung in cells if rung[2] == 2):
        single = cells[*rung[:2], 1]
        pairs = [(single[asset], cell) for asset, cell in cells[rung].items() if asset in single]
        figures = [", ".join(f"{mean([pair[n].seconds(side) for pair in pairs]):.2f} s" for side in ("encode", "wall"))
                   for n in (0, 1)]
        rows.append([TOOLS[rung[0]][0], rung[1], len(pairs), *figures])
    return markdown_table(["tool", "effort", "assets", "one thread: processor, wall", "two threads: processor, wall"], rows, 2)


def knob_lines(rows):
    """Return the Markdown table of settings one step from r03: explain_time() of every asset."""
    by_change, assets = defaultdict(dict), [row["asset"] for row in rows]
    for row in rows:
        for step in row["explained"]["neighbours"]:
            if step.get("percent") is not None:
                seconds = row["explained"]["base"]["processor_seconds"]
                by_change[step["change"]][row["asset"]] = step["processor_seconds"] / seconds, step["percent"], step["verdict"]
    lines = []
    for change, held in by_change.items():
        words = [held[asset][2] for asset in held]
        lines.append([change, *(f"{held[a][0]:.2f}, {held[a][1]:+.1f} %" if a in held else "" for a in assets),
                      f"{mean([h[0] for h in held.values()]):.2f}, {mean([100 + h[1] for h in held.values()]) - 100:+.1f} %",
                      ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))])
    return markdown_table(["step", *assets, "mean", "verdicts"], lines)


def sentences(means):
    """Return the sentence that says where ours is slow and where fast."""
    ours, base = means.get(OURS), means[BASE]
    if ours is None:
        return "Ours is not measured."
    shown = plotted(means)
    worse = [rung for rung, cell in shown.items() if rung[0] != "ours" and cell.encode > ours.encode * (1 + NOISE)]
    slower, fronts = ("; ".join(f"{TOOLS[rung[0]][0]} {rung[1]}" for rung in rungs)
                      for rungs in (worse, front(shown, "encode")))
    return (f"At balanced, ours takes {ours.percent:.0f} % of the bytes of AVIF at speed 6, {ours.encode / base.encode:.1f} "
            f"times its seconds to encode and {ours.decode / base.decode:.0f} times to decode. Slower to encode than ours: "
            f"{slower or 'nothing'}. On the front of encoding, fastest first: {fronts}.")


def page(args):
    """Return the lines of the whole page. args: parsed arguments of collect.py; the plots go into pictures/ beside args.out."""
    every = [json.loads(line) for path in args.results for line in path.read_text(encoding="utf-8").splitlines()]
    cells = cells_of([row for row in every if "bytes" in row])
    means, knobs = means_of(cells), [row for row in every if "explained" in row]
    lines = ["# What accuracy costs in time", "", sentences(means), ""]
    panels = []
    if draw(cells, means, args.out.parent / "pictures"):
        panels = ["![the same, an asset a panel](pictures/accuracy_time_assets.png)", ""]
        lines += ["![bytes at equal PSNR against seconds, in the mean](pictures/accuracy_time.png)", ""]
    lines += [f"Made by `make -C tools accuracy` {made_on()}, from rows of tools/bench/ladders.py. {NOTE}"]
    lines += ["", ABSENT, "", "## By asset", "", *panels, *asset_lines(cells), ""]
    lines += ["## All rungs, in the mean", "", "In bold: on the front.", "", *mean_lines(means), ""]
    lines += ["## Whole programs", "", *program_lines(cells), "", "## Two threads", "", *thread_lines(cells), ""]
    return [*lines, *(["## Settings one step away", "", KNOBS, "", *knob_lines(knobs)] if knobs else [])]
