"""Whole materials: results of rate_points.py whose conditions ask for errors of maps, against the group of --against.

A table per asset (bytes without geometry, decibels by channel, degrees of normals, pooled) and the BD-rate of every other group
of settings against the anchor's: of all channels pooled, and of each alone at the bytes of the whole set.
"""

from texfcodec.core.colour_error import in_decibels
from texfcodec.metrics.bd_rate import bd_rate
from tools.bench.result_tables import markdown_table
from tools.bench.results import at, grouped, rate_of, read_results

POOLED = ("pooled", "plain")


def measures_of(rows):
    """Return {name: path in metrics.json} of the pooled errors and of the channels that all rows have."""
    shared = set.intersection(*({*row["maps"]["channels"]} for row in rows))
    channels = [name for name in rows[0]["maps"]["channels"] if name in shared]
    return {**{name: ("maps", name) for name in POOLED}, **{name: ("maps", "channels", name, "psnr") for name in channels}}


def asset_table(rows):
    """Return the lines of a Markdown table: a row per setting, by group and bytes."""
    measures = measures_of(rows)
    angles = [name for name in measures if at(rows[0], ("maps", "channels", name, "mean_degrees")) is not None]
    head = ["", "bytes", *measures, *(f"{name}, degrees" for name in angles), "encode, s"]
    lines = []
    for row in sorted(rows, key=lambda r: (r["group"], rate_of(r, "texture"))):
        degrees = [row["maps"]["channels"][name] for name in angles]
        lines.append([row["setting"], f"{rate_of(row, 'texture'):,}", *(in_decibels(at(row, m)).removesuffix(" dB")
                      for m in measures.values()), *(f"{d['mean_degrees']:.2f} ({d['p95_degrees']:.2f})" for d in degrees),
                      f"{row['seconds']['encode']['total']:.0f}"])
    return markdown_table(head, lines)


def difference_table(rows, anchor):
    """Return the lines of a Markdown table: BD-rate in percent of each group against the group `anchor`, by measure."""
    measures, groups = measures_of(rows), grouped(rows)
    lines = []
    for name in (group for group in groups if group != anchor):
        curves = [[row for curve in groups[group].values() for row in curve] for group in (anchor, name)]
        lines.append([f"{name} against {anchor}", *(_difference(*curves, path) for path in measures.values())])
    return markdown_table(["", *measures], lines)


def _difference(anchor, rows, path):
    points = [[(rate_of(row, "texture"), at(row, path)) for row in side if at(row, path) is not None]
              for side in (anchor, rows)]
    try:
        return f"{bd_rate(*zip(*points[0], strict=True), *zip(*points[1], strict=True)):+.1f} %"
    except (TypeError, ValueError):  # no common range of quality, or fewer than two points
        return "none"


def page(args):
    """Return the lines of the page. args: of collect.py."""
    rows = [row for folder in args.results for row in read_results(folder) if row.get("maps")]
    anchor = (args.against or [None])[0]
    if anchor not in grouped(rows):
        raise SystemExit(f"there is no group {anchor!r} with errors of maps, only {', '.join(grouped(rows)) or 'none'}")
    lines = []
    for asset in dict.fromkeys(row["asset"] for row in rows):
        asset_rows = [row for row in rows if row["asset"] == asset]
        lines += [f"## {asset}", "", *asset_table(asset_rows), "", *difference_table(asset_rows, anchor), ""]
    return lines
