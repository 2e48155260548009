"""What rate_points.py has left in a folder: its rows, the rows that are missing, and the curves they form."""

import json
import math
from pathlib import Path

from texfcodec.batch.tasks import LOG, last_line
from texfcodec.core.json_text import json_text
from tools.bench.jobs import JOB, METRICS, MISSING, read_json, write_json

OURS = "texf", "texf_baked"  # methods; the latter's stream is the former's
AUTO = "TexF auto"  # the group of ours whose choices are left to the encoder
# What is compared, by name: the path to it in metrics.json.
PSNRS = {
    "3D-PSNR Y": ("psnr_3d", "y"),
    "3D-PSNR RGB": ("psnr_3d", "rgb"),
    "image PSNR Y": ("image", "psnr", "y"),
    "image PSNR RGB": ("image", "psnr", "rgb"),
}
MEASURES = {**PSNRS, "SSIM": ("image", "ssim")}
TOLD = ("asset", "setting", "group", "method", "state", "reason")  # of a row that is missing


def read_results(folder):
    """Return the metrics of all finished jobs of a folder of rate_points.py, sorted by path, or of a file of keep_rows()."""
    if Path(folder).is_file():
        return [row for row in _kept_rows(folder) if "state" not in row]
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(Path(folder).glob(f"*/*/{METRICS}"))]
    if not rows:
        raise SystemExit(f"{folder}: no job is finished there (ASSET/SETTING/metrics.json)")
    return rows


def keep_rows(path, rows, missing):
    """Write the rows of read_results() and read_missing() to a file, as lines of JSON."""
    Path(path).write_text("".join(json_text(row) + "\n" for row in rows + missing), encoding="utf-8")


def unpack_rows(path, folder):
    """Write the measured rows of a file of keep_rows() into a folder of rate_points.py as finished jobs, unless it has them."""
    for row in read_results(path):
        place = Path(folder) / row["asset"] / row["setting"]
        if not place.exists():
            place.mkdir(parents=True)
            for name in (JOB, METRICS):
                write_json(place / name, row)


def _kept_rows(path):
    return [json.loads(line) for line in Path(path).read_text(encoding="utf-8").splitlines()]


def read_missing(folder):
    """Return [{key of TOLD: text}] of jobs without metrics: what missing.json says, or "not finished" and the last log line."""
    if Path(folder).is_file():
        return [row for row in _kept_rows(folder) if "state" in row]
    missing = []
    for job in sorted({path.parent for name in (JOB, MISSING) for path in Path(folder).glob(f"*/*/{name}")}):
        if (job / METRICS).exists():
            continue
        facts = {"asset": job.parent.name, "setting": job.name, **(read_json(job / JOB) or {})}
        reason, log = read_json(job / MISSING), job / LOG
        facts |= reason or {"state": "not finished", "reason": last_line(log) if log.exists() else "it has not begun"}
        missing.append({key: str(facts.get(key, "")) for key in TOLD})
    return missing


def at(row, path):
    """Return the value of a nested dict at a path of keys; None if the path ends early."""
    for key in path:
        row = row.get(key) if isinstance(row, dict) else None
    return row


def value_of(row, measure):
    """Return a row's value of one of MEASURES: PSNR in dB, or SSIM; None if not measured, inf if exact."""
    value = at(row, MEASURES[measure])
    is_exact = measure in PSNRS and value is None and at(row, MEASURES[measure][:-1]) is not None
    return math.inf if is_exact else value


def quality_of(row, measure):
    """Return value_of() in dB, the unit in which curves are compared: SSIM as -10 log10(1 - SSIM)."""
    value = value_of(row, measure)
    if value is None or measure in PSNRS:
        return value
    return -10 * math.log10(1 - value) if value < 1 else math.inf


def measures_of(rows):
    """Return those of MEASURES that at least one row has, in their order."""
    return [measure for measure in MEASURES if any(value_of(row, measure) is not None for row in rows)]


def rate_of(row, kind):
    """Return the bytes of a row. kind: "total", or "texture" for all but geometry."""
    return row["bytes"]["total"] - (row["bytes"].get("geometry", 0) if kind == "texture" else 0)


def grouped(rows):
    """Return rows as {group: {asset: [row]}}, in the order in which they come."""
    groups = {}
    for row in rows:
        groups.setdefault(row["group"], {}).setdefault(row["asset"], []).append(row)
    return groups


def curve_points(rows, measure, kind):
    """Return [(bytes, dB, row)] sorted by bytes, without exact rows and those without the measure. kind: see rate_of()."""
    points = [(rate_of(row, kind), quality_of(row, measure), row) for row in rows]
    return sorted((p for p in points if p[1] is not None and math.isfinite(p[1])), key=lambda p: p[:2])


def curve_of(rows, measure, kind):
    """Return ([bytes], [dB]) of curve_points()."""
    points = curve_points(rows, measure, kind)
    return [rate for rate, _, _ in points], [quality for _, quality, _ in points]
