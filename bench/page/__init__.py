"""The page of results: one HTML file with its data, style, script and pictures in it, which loads nothing."""

import base64
import hashlib
import math
import re
from pathlib import Path

import numpy as np

from bench.differences import summary
from bench.jobs import METRICS, read_json
from bench.results import PSNRS, at, measures_of, quality_of, rate_of, value_of
from texfcodec.core.json_text import json_text

PART = Path(__file__).parent
SCRIPTS = ("figures.js", "table.js", "curves.js", "pictures.js", "page.js")  # one module, in this order
KINDS = {".webp": "image/webp", ".png": "image/png"}


def write_page(path, rows, missing, pairs, kind, pictures):
    """Writes the page; its size in bytes.

    rows: measured and published ones; missing: of results.read_missing(); pairs: differences.Pair; kind: the rate of the curves;
    pictures: folder of the jobs whose pictures are embedded, or None.
    """
    made = page_of(page_data(rows, missing, pairs, kind, pictures))
    path.write_bytes(made)
    return len(made)


def page_of(data):
    """The whole page, UTF-8. Whatever comes from files is in one block of JSON; the script sets it as text and never as HTML."""
    style = (PART / "page.css").read_text(encoding="utf-8")
    script = "\n".join((PART / name).read_text(encoding="utf-8") for name in SCRIPTS)
    policy = f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'"
    parts = {"policy": policy, "style": style, "script": script, "data": _harmless(json_text(data))}
    template = (PART / "page.html").read_text(encoding="utf-8")
    parts["megabytes"] = f"{sum(map(len, (template, *parts.values()))) / 1e6:.1f}"
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], template).encode()


def _digest(text):
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _harmless(text):
    """JSON that cannot end the element that it stands in."""
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def page_data(rows, missing, pairs, kind, pictures=None):
    """What the script draws, ready for JSON."""
    known, images = pictures_of(pictures) if pictures else {}, {}
    told = []
    for row in rows:
        files = known.get((row["asset"], row["group"], row["setting"]), {})
        told.append(_row(row, kind) | {"pictures": {name: _index(images, file) for name, file in files.items()}})
    measured = [row for row in rows if "published" not in row]
    return {"kind": kind, "code": sorted({f"{row['package']} {row['code']}" for row in measured}),
            "measures": [{"name": m, "is_psnr": m in PSNRS} for m in measures_of(rows)], "rows": told, "missing": missing,
            "comparisons": [_comparison([p for p in pairs if p.other == other], kind)
                            for other in dict.fromkeys(pair.other for pair in pairs)],
            "images": list(images)}


def _row(row, kind):
    values = {measure: (value_of(row, measure), quality_of(row, measure)) for measure in measures_of([row])}
    return {**{key: row[key] for key in ("asset", "setting", "group")}, "published": row.get("published"),
            "bytes": row["bytes"]["total"], "geometry": row["bytes"].get("geometry", 0), "rate": rate_of(row, kind),
            "values": {measure: "exact" if math.isinf(value) else value for measure, (value, _) in values.items()},
            "decibels": {measure: "exact" if math.isinf(quality) else quality for measure, (_, quality) in values.items()},
            **{f"{side}_seconds": at(row, ("seconds", side, "total")) for side in ("encode", "decode")},
            **{f"{side}_memory": at(row, ("memory", side, "peak")) for side in ("encode", "decode")}}


def _comparison(pairs, kind):
    """{"against", "measures": {measure: [{"group", "assets": {asset: [percent, overlap, reason]}, "mean", "median"}]}} of pairs
    with the same anchor; mean and median: [percent, number of assets]."""
    measures = {}
    for pair in pairs:
        table = pair.differences(kind)
        for measure in dict.fromkeys(measure for row in table.values() for measure in row):
            found = {asset: row[measure] for asset, row in table.items()}
            cells = {asset: [one.percent, one.overlap, one.reason] for asset, one in found.items()}
            measures.setdefault(measure, []).append({"group": pair.name, "assets": cells, "mean": summary(found.values()),
                                                     "median": summary(found.values(), np.median)})
    return {"against": pairs[0].other, "measures": measures}


def pictures_of(folder):
    """{(asset, group, setting): {file's name without ending: path}} of the jobs' pictures: picture_VIEW and source_VIEW."""
    found = {}
    for path in sorted(Path(folder).glob(f"*/*/{METRICS}")):
        row = read_json(path) or {}
        files = [file for file in sorted(path.parent.glob("*_[0-9]*")) if file.suffix in KINDS]
        found[row.get("asset"), row.get("group"), row.get("setting")] = {file.stem: file for file in files}
    return found


def _index(images, file):
    """The place in images, {data URI: place}, of a file's content; equal pictures are embedded once."""
    uri = f"data:{KINDS[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"
    return images.setdefault(uri, len(images))
