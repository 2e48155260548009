"""Tables, BD-rates and plots of what rate_points.py has measured.

python tools/collect.py DIR [ANCHOR_DIR] --out FOLDER [--group G] [--anchor-group A] [--rate texture|total]

Writes results.csv (a row per finished job, every figure of its metrics.json), results.md (a table per asset, then BD-rates) and,
if matplotlib is there, an ASSET.png with the rate curves of each group of settings.

A curve is one asset's settings of one group. With ANCHOR_DIR every group of DIR (or G alone) stands against the group A there, or
the one of the same name, or the only one; without it, against the group A of DIR. BD-rate is the mean difference of rate at equal
quality in percent, negative where fewer bytes are needed (quality/bd_rate.py); lossless points are left out. --rate texture, as
the paper does it, counts all bytes but geometry; total counts geometry as well.
"""

import argparse
import csv
import json
import sys
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from texfcodec.ground.colour_error import EXACT
from texfcodec.quality.bd_rate import bd_rate
from tools.plots import load_pyplot, logarithmic

# What is compared, by name: the path to it in metrics.json.
MEASURES = {
    "3D-PSNR Y": ("psnr_3d", "y"),
    "3D-PSNR RGB": ("psnr_3d", "rgb"),
    "image PSNR Y": ("image", "psnr", "y"),
    "image PSNR RGB": ("image", "psnr", "rgb"),
}
PLOTTED = ("3D-PSNR Y", "image PSNR RGB")
COLUMNS = ("setting", "group", "bytes", "geometry", "texture", *MEASURES, "SSIM", "encode, s", "decode, s", "encode, MB",
           "decode, MB")


def read_results(folder):
    """The metrics of all finished jobs of a folder of rate_points.py, in the order of their paths."""
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(Path(folder).glob("*/*/metrics.json"))]
    if not rows:
        raise SystemExit(f"{folder}: no job is finished there (ASSET/SETTING/metrics.json)")
    return rows


def at(row, path):
    """The value at a path of keys; None where the path ends early."""
    for key in path:
        row = row.get(key) if isinstance(row, dict) else None
    return row


def rate_of(row, kind):
    """Bytes of a row: "total", or "texture", all but geometry."""
    return row["bytes"]["total"] - (row["bytes"].get("geometry", 0) if kind == "texture" else 0)


def grouped(rows):
    """{group: {asset: its rows}} in the order in which they come."""
    found = {}
    for row in rows:
        found.setdefault(row["group"], {}).setdefault(row["asset"], []).append(row)
    return found


def curve_of(rows, measure, kind):
    """([bytes], [dB]) by bytes, without lossless rows and those that were not measured so."""
    points = sorted((rate_of(r, kind), q) for r in rows if (q := at(r, MEASURES[measure])) is not None)
    return [rate for rate, _ in points], [quality for _, quality in points]


def rate_difference(anchor, rows, measure, kind="texture"):
    """BD-rate of one curve's rows against an anchor's in one of MEASURES, in percent; ValueError says why there is none."""
    return bd_rate(*curve_of(anchor, measure, kind), *curve_of(rows, measure, kind))


def pairs_of(rows, anchors, group=None, anchor_group=None):
    """[(name, {asset: rows} of the anchor, {asset: rows})] to compare. anchors: rows of another folder, or None."""
    ours = grouped(rows)
    theirs = ours if anchors is None else grouped(anchors)
    for name, known in ((group, ours), (anchor_group, theirs)):
        if name is not None and name not in known:
            raise SystemExit(f"there is no group {name!r}, only {', '.join(known)}")
    pairs = []
    for name in [group] if group else ours:
        other = anchor_group or (name if name in theirs else next(iter(theirs)) if len(theirs) == 1 else None)
        if other is None:
            raise SystemExit(f"the anchor has no group {name!r}; say which with --anchor-group: {', '.join(theirs)}")
        shared = group is not None or any(asset in theirs[other] for asset in ours[name])
        if shared and (anchors is not None or name != other):
            pairs.append((f"{name} against {other}", theirs[other], ours[name]))
    return pairs


def differences(anchor, rows, kind):
    """({asset: {measure: percent or None}}, notes on what is missing) for the assets that both sides have."""
    table, notes = {}, {}
    for asset in (a for a in rows if a in anchor):
        table[asset] = {}
        for measure in MEASURES:
            try:
                table[asset][measure] = rate_difference(anchor[asset], rows[asset], measure, kind)
            except ValueError as error:
                table[asset][measure] = None
                notes.setdefault(f"{asset}: {error}", []).append(measure)
    return table, [f"{text} ({', '.join(measures)})" for text, measures in notes.items()]


def mean_of(table):
    """{measure: (mean over the assets that have a value, or None, their number)}."""
    there = {m: [row[m] for row in table.values() if row[m] is not None] for m in MEASURES}
    return {m: (float(np.mean(values)) if values else None, len(values)) for m, values in there.items()}


# What is written.


def flat(row, prefix=""):
    """A nested dict with dotted keys; lists become text."""
    out = {}
    for key, value in row.items():
        if isinstance(value, dict):
            out |= flat(value, f"{prefix}{key}.")
        else:
            out[prefix + key] = "; ".join(map(str, value)) if isinstance(value, list) else value
    return out


def write_csv(rows, path):
    """A row per job; columns in the order in which they are met."""
    rows = [flat(row) for row in rows]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def markdown_table(head, lines, texts=1):
    """Lines of a Markdown table; texts: number of columns at the left that are no numbers."""
    rule = ["---"] * texts + ["---:"] * (len(head) - texts)
    return ["| " + " | ".join(cells) + " |" for cells in (head, rule, *lines)]


def asset_table(rows):
    """Markdown lines of one asset's jobs, smallest first in each group."""
    order = sorted(rows, key=lambda r: (r["group"], r["bytes"]["total"]))
    lines = []
    for r in order:
        sizes = [r["bytes"]["total"], r["bytes"].get("geometry", 0), rate_of(r, "texture")]
        seconds = [f"{r['seconds'][side]['total']:.2f}" for side in ("encode", "decode")]
        memory = [_number(r["memory"][side]["peak"], ".0f", 1e-6) for side in ("encode", "decode")]
        lines.append([r["setting"], r["group"], *(f"{size:,}" for size in sizes), *(_decibels(r, m) for m in MEASURES.values()),
                      _number(at(r, ("image", "ssim")), ".4f"), *seconds, *memory])
    return markdown_table(COLUMNS, lines, 2)


def _decibels(row, path):
    value = at(row, path)
    return "-" if at(row, path[:-1]) is None else EXACT if value is None else f"{value:.2f}"


def _number(value, form, factor=1):
    return "-" if value is None else format(value * factor, form)


def difference_table(table):
    """Markdown lines of the BD-rates of differences()."""
    lines = [[asset, *(_number(row[m], "+.2f") for m in MEASURES)] for asset, row in table.items()]
    means = mean_of(table)
    lines.append(["**mean**", *(_number(mean, "+.2f") + (f" ({n})" if n < len(table) else "") for mean, n in means.values())])
    return markdown_table(["asset", *MEASURES], lines)


def report(rows, pairs, kind):
    """The whole results.md."""
    lines, codes = ["# Rate points", ""], sorted({f"{r['package']} {r['code']}" for r in rows})
    lines += [f"{len(rows)} jobs; code {', '.join(codes)}" + ("; **not all by the same code**" if len(codes) > 1 else ""), ""]
    for asset in dict.fromkeys(r["asset"] for r in rows):
        lines += [f"## {asset}", "", *asset_table([r for r in rows if r["asset"] == asset]), ""]
    for name, anchor, ours in pairs:
        table, notes = differences(anchor, ours, kind)
        lines += [f"## BD-rate: {name}", "", f"Percent of {kind} bytes at equal quality; negative needs fewer.", ""]
        lines += [*difference_table(table), ""] if table else ["The two have no asset in common.", ""]
        lines += [*(f"- none for {note}" for note in notes), ""] if notes else []
    return "\n".join(lines)


def draw(rows, anchors, kind, out):
    """ASSET.png for each asset; False, and a sentence on stderr, where matplotlib is not installed."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    for asset in dict.fromkeys(r["asset"] for r in rows):
        figure, panels = pyplot.subplots(1, len(PLOTTED), figsize=(6 * len(PLOTTED), 4.5), squeeze=False)
        for panel, measure in zip(panels[0], PLOTTED, strict=True):
            _draw_panel(panel, asset, measure, kind, ((rows, "o-", ""), (anchors or [], "s--", " (anchor)")))
        figure.tight_layout()
        figure.savefig(out / f"{asset}.png", dpi=110)
        pyplot.close(figure)
    return True


def _draw_panel(panel, asset, measure, kind, sides):
    for rows, style, suffix in sides:
        for group, by_asset in grouped(rows).items():
            sizes, quality = curve_of(by_asset.get(asset, []), measure, kind)
            if sizes:
                panel.plot([size / 1000 for size in sizes], quality, style, label=group + suffix)
    panel.set(title=f"{asset}: {measure}", xlabel=f"{kind} bytes, thousands", ylabel="dB")
    logarithmic(panel)
    panel.grid(alpha=0.3)
    if panel.lines:
        panel.legend()


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, metavar="DIR")
    parser.add_argument("anchor", type=Path, nargs="?", metavar="ANCHOR_DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--group", metavar="G", help="compare this group only")
    parser.add_argument("--anchor-group", metavar="A", help="compare with this group")
    parser.add_argument("--rate", choices=("texture", "total"), default="texture", help="which bytes count")
    args = parser.parse_args(arguments)
    rows, anchors = read_results(args.results), read_results(args.anchor) if args.anchor else None
    compared = anchors is not None or args.anchor_group is not None
    pairs = pairs_of(rows, anchors, args.group, args.anchor_group) if compared else []
    args.out.mkdir(parents=True, exist_ok=True)
    write_csv(rows, args.out / "results.csv")
    (args.out / "results.md").write_text(report(rows, pairs, args.rate) + "\n", encoding="utf-8")
    drawn = draw(rows, anchors, args.rate, args.out)
    print(f"{args.out}: results.csv, results.md" + (", a plot per asset" if drawn else ""))


if __name__ == "__main__":
    main()
