"""Whole materials in light against what a user would pick instead: Draco with all its attributes, and every map as AVIF.

    collect.py tools/bench/materials [MORE ...] --table lit --out FILE.md

Folders of records NAME.ours.json and NAME.rivals.json, {"asset", "positions": bytes, "points": [{"total", "psnr_y"}]}, or rows of
tools/conditions/lit.toml, the rivals' of the method uv; pictures are in daylight. Our bytes in percent of the rival's at equal
PSNR of Y, over the range that both have: of everything, and of everything but what Draco takes for positions and faces alone.
"""

import json
from collections import defaultdict

import numpy as np

from texfcodec.metrics.bd_rate import bd_rate
from tools.bench.result_tables import markdown_table
from tools.bench.results import at, read_results

MOST, MEAN = 75, 45  # the target, of total bytes: percent of the rival's on every asset, and on average
SIDES = "ours", "rivals"


def read_points(path):
    """Read a folder of records or of rows; return {asset: {side: [(bytes, bytes without positions, dB of Y or None)]}}."""
    points = defaultdict(dict)
    if path.is_dir() and any(path.glob("*.ours.json")):
        for side in SIDES:
            for file in sorted(path.glob(f"*.{side}.json")):
                held = json.loads(file.read_text(encoding="utf-8"))
                points[held["asset"]][side] = [(p["total"], p["total"] - held["positions"], p["psnr_y"]) for p in held["points"]]
        return points
    for row in read_results(path):
        point = row["bytes"]["total"], row["bytes"]["total"] - row["bytes"]["geometry"], at(row, ("image", "psnr", "y"))
        points[row["asset"]].setdefault(SIDES[row["method"] == "uv"], []).append(point)
    return points


def percent(ours, rivals):
    """Return the bytes of ours, [(bytes, dB)], in percent of a rival's at equal quality; a sentence without a common range.
    Exact pictures have no PSNR and are left out."""
    curves = [hull([point for point in side if point[1] is not None]) for side in (rivals, ours)]
    try:
        return 100 + bd_rate(*zip(*curves[0], strict=True), *zip(*curves[1], strict=True))
    except (TypeError, ValueError) as error:
        return f"no common range: {error}"[:90]


def hull(points):
    """Return the lower hull of (bytes, PSNR) points, bytes over PSNR. A curve through all points that no other beats would climb
    whenever bits that do not pay there gain a hundredth of a dB; a hull of the logarithm of bytes, concave over PSNR, would
    promise what nobody has coded."""
    def slope(a, b):
        return (b[0] - a[0]) / (b[1] - a[1])

    kept = []
    for point in sorted(points):
        if kept and point[1] <= kept[-1][1] + 1e-6:
            continue
        if kept and point[0] == kept[-1][0]:
            kept.pop()
        while len(kept) > 1 and slope(kept[-2], kept[-1]) >= slope(kept[-2], point):
            kept.pop()
        kept.append(point)
    return kept


def page(args):
    """Return the lines of a table: every asset that both sides have, and the target. args: of collect.py."""
    by_asset = {asset: sides for path in args.results for asset, sides in read_points(path).items()}
    lines, totals = [], []
    for asset in sorted(by_asset):
        if set(by_asset[asset]) == set(SIDES):
            ours, rivals = (by_asset[asset][side] for side in SIDES)
            both = [percent([(p[n], p[2]) for p in ours], [(p[n], p[2]) for p in rivals]) for n in (0, 1)]
            totals += [] if isinstance(both[0], str) else [both[0]]
            lines.append([asset, *(share if isinstance(share, str) else f"{share:.0f} %" for share in both)])
    if totals:
        lines += [[f"all {len(totals)}", f"mean {np.mean(totals):.0f} %, at most {max(totals):.0f} %", ""],
                  ["target", f"mean {MEAN} %, at most {MOST} %", ""]]
    return markdown_table(["asset", "all bytes", "without positions"], lines, 3)
