"""Our streams against what a user would pick instead, GLB with Draco and AVIF, WebP or JPEG images, at equal image PSNR.

    collect.py tools/bench/rates/all_assets.jsonl tools/bench/everyday [MORE ...] --table everyday --out FILE.md [--measure y]

The first is our points: rows of rate_points.py, of which the group "TexF auto" counts. Others are the rivals': folders of records
of single assets, or rows of tools/conditions/everyday_rivals.toml. A record is {"asset", "points": [{"codec", "scale", "uv_bits",
"colour_bits", "total_bytes", "y", "rgb", "yuv"}]}, PSNR over 16 views of 1024 x 1024; of an asset that comes twice the later one
stands.

The envelope is, at each PSNR, the least bytes over all curves; a curve is one codec at one scale with one choice of UV bits, and
its first point serves for less than its PSNR as well, so that the envelope nowhere falls. Every curve, ours too, is its
lower-left front (points that are larger and not better than another have an asterisk and are left out) with the logarithm of the
bytes interpolated over PSNR by PCHIP, as bd_rate() does. The convex hull of the points is not taken: nobody can encode what lies
on its chords.
"""

import json
from collections import defaultdict

import numpy as np
from scipy.interpolate import PchipInterpolator

from tools.bench.result_tables import markdown_table
from tools.bench.results import AUTO, read_results

STEPS = 4000
CURVE = ("codec", "scale", "uv_bits", "colour_bits")
MEASURES = ("y", "rgb", "yuv")


def front(points):
    """Return the lower-left front of (bytes, PSNR) pairs, by bytes: those with more PSNR than every smaller one."""
    kept = []
    for size, psnr in sorted(points, key=lambda p: (p[0], -p[1])):
        if not kept or psnr > kept[-1][1]:
            kept.append((size, psnr))
    return kept


def log_bytes(points, psnr):
    """Return the logarithm of the bytes that a front of (bytes, PSNR) pairs needs at each psnr, float64 [N]: that of its first
    point below its range, inf above."""
    quality, sizes = np.array([p[1] for p in points]), np.log([p[0] for p in points])
    inside = np.clip(psnr, quality[0], quality[-1])
    out = PchipInterpolator(quality, sizes)(inside) if len(points) > 1 else np.interp(inside, quality, sizes)
    return np.where(psnr > quality[-1], np.inf, out)


def curves_of(points, measure):
    """Return the fronts of rival points, [(key, front)], in a measure; points without a finite value are left out."""
    groups = defaultdict(list)
    for p in points:
        if p[measure] is not None:
            groups[tuple(p.get(name) for name in CURVE)].append((p["total_bytes"], p[measure]))
    return [(key, front(pairs)) for key, pairs in groups.items()]


def envelope(curves, psnr):
    """Return at each psnr, float64 [N], (logarithm of the least bytes of all curves, float64 [N]; index of that curve, int64
    [N]); inf beyond all curves."""
    table = np.array([log_bytes(points, psnr) for _, points in curves])
    return table.min(axis=0), table.argmin(axis=0)


def bd_rate_against(curves, ours):
    """Return the mean difference in percent of our (bytes, PSNR) pairs from the envelope of curves over their common range of
    PSNR; None without one. Negative: ours is smaller."""
    ours = front(ours)
    if not ours or not curves:
        return None
    low = max(ours[0][1], min(points[0][1] for _, points in curves))
    high = min(ours[-1][1], max(points[-1][1] for _, points in curves))
    if not low < high:
        return None
    psnr = np.linspace(low, high, STEPS + 1)
    difference = log_bytes(ours, psnr) - envelope(curves, psnr)[0]
    return float(np.expm1(np.trapezoid(difference, dx=1 / STEPS)) * 100)


def point_differences(curves, points, measure):
    """Return for each of our points the difference in percent from the envelope of curves at its PSNR; below their range from
    their smallest point, None above it."""
    out = []
    for p in points:
        exact = p[measure] is None
        rival = np.inf if exact else envelope(curves, np.array([p[measure]]))[0][0]
        out.append(float(np.expm1(np.log(p["total"]) - rival) * 100) if np.isfinite(rival) else None)
    return out


def rival_records(paths):
    """Return {asset: [rival point]} from folders of records and from rows of rate_points.py."""
    records = {}
    for path in paths:
        for file in sorted(path.glob("*.json")) if path.is_dir() else []:
            held = json.loads(file.read_text(encoding="utf-8"))
            records[held["asset"]] = held["points"]
        if not path.is_dir() or not any(path.glob("*.json")):
            points = defaultdict(list)
            for row in (row for row in read_results(path) if row["method"] == "uv"):
                point = row["options"] | {"codec": row["group"], "total_bytes": row["bytes"]["total"]}
                points[row["asset"]].append(point | {m: row["image"]["psnr"][m] for m in MEASURES})
            records |= points
    return records


def our_points(path):
    """Return {asset: [{"rate", "total", "y", "rgb", "yuv"}]} from the rows of group AUTO at rates r01 to r05."""
    points = defaultdict(list)
    for row in read_results(path):
        if row["group"] == AUTO and row["options"].get("rate", "r06") < "r06":
            points[row["asset"]].append({"rate": row["options"]["rate"], "total": row["bytes"]["total"],
                                         **{m: row["image"]["psnr"][m] for m in MEASURES}})
    return points


def page(args):
    """Return the lines of a table: a row per asset with our points, their differences and the BD-rate; then mean and median."""
    ours, rivals, measure = our_points(args.results[0]), rival_records(args.results[1:]), args.measure
    if not set(rivals) & set(ours):
        raise SystemExit("no asset has both rival curves and points of ours")
    lines, rates = [], []
    for name in sorted(set(rivals) & set(ours)):
        curves, points = curves_of(rivals[name], measure), ours[name]
        pairs = [(p["total"], p[measure]) for p in points if p[measure] is not None]
        rate = bd_rate_against(curves, pairs)
        rates += [] if rate is None else [rate]
        said = [_point_text(p, d, measure, (p["total"], p[measure]) in front(pairs))
                for p, d in zip(points, point_differences(curves, points, measure), strict=True)]
        lines.append([name, "none" if rate is None else f"{rate:+.1f} %", "; ".join(said)])
    for name, of in (("mean", np.mean), ("median", np.median)):
        lines += [[f"{name} of {len(rates)}", f"{of(rates):+.1f} %", ""]] if rates else []
    head = ["asset", "BD-rate", f"our bytes, PSNR {measure.upper()}, against the least bytes at that PSNR"]
    return markdown_table(head, lines, 3)


def _point_text(point, difference, measure, is_kept):
    """One of our points for people; an asterisk: not on our own front, and so not in the BD-rate."""
    psnr = "exact" if point[measure] is None else f"{point[measure]:.1f} dB"
    against = "no rival" if difference is None else f"{difference:+.0f} %"
    return f"{point['rate']}{'' if is_kept else '*'} {point['total']:,} B {psnr} {against}"
