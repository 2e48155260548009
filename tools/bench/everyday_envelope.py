"""How a stream stands against what everyday.py's rivals can do: bytes at equal image PSNR.

The envelope is, at each PSNR, the least bytes over all curves; a curve is one codec at one scale with one choice of UV bits, and
its first point serves for less than its PSNR as well, so that the envelope nowhere falls. Every curve, ours too, is its
lower-left front (points that are larger and not better than another are left out) with the logarithm of the bytes interpolated
over PSNR by PCHIP, as bd_rate() does. The convex hull of the points is not taken: nobody can encode what lies on its chords.

This rule gives -28.4, +28.3, +330.1, +0.9, -16.5 and -20.5 % on the six curves that were there before this tool, whose table says
-28, +28, +330, +1, -17 and -20, and the same figures at single points (helmet +167 to +505 %). Piecewise linear ("linear") it is
-27.7, +29.6, +317.1, 0.0, -17.6 and -19.7, and +161 to +504.
"""

import json
from collections import defaultdict

import numpy as np
from scipy.interpolate import PchipInterpolator

from tools.bench.results import AUTO, read_results

INTERPOLATIONS = ("pchip", "linear")
STEPS = 4000
CURVE = ("codec", "scale", "uv_bits", "colour_bits")


def front(points):
    """The lower-left front of (bytes, PSNR) pairs: those with more PSNR than every smaller one, in that order."""
    kept = []
    for size, psnr in sorted(points, key=lambda p: (p[0], -p[1])):
        if not kept or psnr > kept[-1][1]:
            kept.append((size, psnr))
    return kept


def log_bytes(points, psnr, interpolation):
    """Logarithm of the bytes that a curve needs at each PSNR, float64 [N]: those of its first point below its range, inf above.
    points: (bytes, PSNR) pairs of a front; psnr: float64 [N]."""
    quality, sizes = np.array([p[1] for p in points]), np.log([p[0] for p in points])
    inside = np.clip(psnr, quality[0], quality[-1])
    smooth = interpolation == "pchip" and len(points) > 1
    out = PchipInterpolator(quality, sizes)(inside) if smooth else np.interp(inside, quality, sizes)
    return np.where(psnr > quality[-1], np.inf, out)


def curves_of(points, measure):
    """Fronts of the rival points, [(key, front)]; points without an error in the measure are left out."""
    groups = defaultdict(list)
    for p in points:
        if p[measure] is not None:
            groups[tuple(p.get(name) for name in CURVE)].append((p["total_bytes"], p[measure]))
    return [(key, front(pairs)) for key, pairs in groups.items()]


def envelope(curves, psnr, interpolation=INTERPOLATIONS[0]):
    """(logarithm of the least bytes float64 [N], number of the curve that has them int64 [N]) at each PSNR, float64 [N]; inf
    where no curve goes so far."""
    table = np.array([log_bytes(points, psnr, interpolation) for _, points in curves])
    return table.min(axis=0), table.argmin(axis=0)


def bd_rate_against(curves, ours, interpolation=INTERPOLATIONS[0]):
    """Mean difference in percent of our (bytes, PSNR) pairs from the envelope, over the common range of PSNR; None where there is
    none. Negative: ours is smaller."""
    ours = front(ours)
    if not ours or not curves:
        return None
    low = max(ours[0][1], min(points[0][1] for _, points in curves))
    high = min(ours[-1][1], max(points[-1][1] for _, points in curves))
    if not low < high:
        return None
    psnr = np.linspace(low, high, STEPS + 1)
    difference = log_bytes(ours, psnr, interpolation) - envelope(curves, psnr, interpolation)[0]
    return float(np.expm1(np.trapezoid(difference, dx=1 / STEPS)) * 100)


def point_differences(curves, points, measure, interpolation=INTERPOLATIONS[0]):
    """For each of our points the difference in percent from the envelope at its PSNR; below the rivals' range from their smallest
    point, None above it."""
    out = []
    for p in points:
        exact = p[measure] is None
        rival = np.inf if exact else envelope(curves, np.array([p[measure]]), interpolation)[0][0]
        out.append(float(np.expm1(np.log(p["total"]) - rival) * 100) if np.isfinite(rival) else None)
    return out


def compacted(record):
    """The record without the curves that are nowhere the least in any measure: the envelope is the same, from fewer figures."""
    kept = set()
    for measure in ("y", "rgb", "yuv"):
        curves = curves_of(record["points"], measure)
        if not curves:
            continue
        low, high = min(points[0][1] for _, points in curves), max(points[-1][1] for _, points in curves)
        for interpolation in INTERPOLATIONS:
            kept |= {curves[i][0] for i in envelope(curves, np.linspace(low, high, STEPS + 1), interpolation)[1]}
    return record | {"points": [p for p in record["points"] if tuple(p.get(name) for name in CURVE) in kept]}


def read_records(paths, word, key="points"):
    """{asset: record} of JSON files and of folders with them; a file holds one record, or several by asset. Kept are those that
    have points under the key, of which each holds the word: "codec" for rivals, "rate" for ours, so that both may lie in one
    folder. Of an asset that comes twice the later stands. A .jsonl file holds rows that collect.py --keep has kept, see
    rate_records()."""
    records = {}
    for path in paths:
        for file in sorted(path.glob("*.json")) if path.is_dir() else [path]:
            held = rate_records(file) if file.suffix == ".jsonl" else json.loads(file.read_text(encoding="utf-8"))
            held = {held["asset"]: held} if "asset" in held else held
            records |= {name: one for name, one in held.items() if one.get(key) and all(word in p for p in one[key])}
    return records


def rate_records(path):
    """{asset: {"points": [a point of ours as everyday.py measures it]}} of the rows of AUTO in a file of rate_points.py."""
    records = {}
    for row in read_results(path):
        if row["group"] == AUTO:
            psnr = row["image"]["psnr"]
            point = {"rate": row["options"]["rate"], "total": row["bytes"]["total"], **{m: psnr[m] for m in ("y", "rgb", "yuv")}}
            records.setdefault(row["asset"], {"points": []})["points"].append(point)
    return records


def table(rivals, ours, key="points", measure="y", interpolation=INTERPOLATIONS[0]):
    """Markdown: a row per asset that both have, our points and their differences, the BD-rate; then mean and median."""
    lines = [f"| asset | our bytes, PSNR {measure.upper()}, against the least bytes at that PSNR | BD-rate |", "|---|---|---|"]
    rates = []
    for name in sorted(set(rivals) & set(ours)):
        curves, points = curves_of(rivals[name]["points"], measure), ours[name][key]
        pairs = [(p["total"], p[measure]) for p in points if p[measure] is not None]
        rate = bd_rate_against(curves, pairs, interpolation)
        rates += [] if rate is None else [rate]
        said = [told(p, d, measure, (p["total"], p[measure]) in front(pairs))
                for p, d in zip(points, point_differences(curves, points, measure, interpolation), strict=True)]
        lines.append(f"| {name} | {'; '.join(said)} | {'none' if rate is None else f'{rate:+.1f} %'} |")
    if rates:
        lines += [f"| mean of {len(rates)} | | {np.mean(rates):+.1f} % |", f"| median | | {np.median(rates):+.1f} % |"]
    return "\n".join(lines) + "\n"


def told(point, difference, measure, is_kept):
    """One of our points for people; an asterisk: not on our own front, and so not in the BD-rate."""
    psnr = "exact" if point[measure] is None else f"{point[measure]:.1f} dB"
    against = "no rival" if difference is None else f"{difference:+.0f} %"
    return f"{point['rate']}{'' if is_kept else '*'} {point['total']:,} B {psnr} {against}"
