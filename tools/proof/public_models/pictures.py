"""Sheets of pictures: source and decoded mesh beside each other, drawn by three.js, which has loaders of its own."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from texfcodec.core.colour_error import in_decibels
from tools.proof.public_models.judge import findings_of, least_picture, worst_rgb
from tools.proof.public_models.rows import add_row
from tools.proof.public_models.run import node_modules

PAGE = Path(__file__).with_name("pictures.mjs")
WORST = 20  # pairs of the sheet "worst"


def draw(rows, count, cache, rows_file):
    """Draw `count` of the decoded models with three.js, evenly spread, and return rows with their pictures' facts. Sheets go to
    a folder of the cache, the worst pairs also to its folder "worst", and rows with pictures to rows_file. Raises SystemExit if
    nothing can be drawn."""
    out = cache / f"pictures-{rows_file.stem}"
    drawable = [row for row in rows if "measure" in row and not row["name"].lower().endswith(".off")]
    chosen = [drawable[i * len(drawable) // min(count, len(drawable))] for i in range(min(count, len(drawable)))]
    if not chosen:
        raise SystemExit("nothing can be drawn: no model was decoded")
    pairs = [pair_of(row) for row in chosen]
    shown = draw_pairs(pairs, cache, out)
    print(f"{len(chosen)} pairs in {out}", file=sys.stderr)
    order = sorted(range(len(pairs)), key=lambda i: least_picture(shown[i]))
    draw_pairs([pairs[i] for i in order[:WORST]], cache, out / "worst")
    pictures = dict(zip([row["name"] for row in chosen], shown, strict=True))
    rows = [row | ({"picture": pictures[row["name"]]} if row["name"] in pictures else {}) for row in rows]
    for row in rows:
        if row["name"] in pictures:
            row["findings"] = findings_of(row)
            add_row(rows_file, row)
    return rows


def pair_of(row):
    """Return the job of a row for pictures.mjs: its files, a caption, and the encoder's remarks on colours and units."""
    remarks = " ".join(row["encode"]["report"].get("remarks", []))
    unit, worst = re.search(r"a unit of (\S+) m\b", remarks), worst_rgb(row)
    text = "not measured" if worst != worst else in_decibels(worst)
    return {"source": row["source"], "mesh": row["mesh"], "text": f"{row['name']} \u00b7 worst part {text}",
            "linear": "read as linear" in remarks, "unit": float(unit[1]) if unit else 1.0}


def draw_pairs(pairs, cache, out):
    """Draw [{"source", "mesh", "text"}], paths relative to the cache, with three.js; return their facts. Sheets go to out."""
    modules = node_modules(cache)
    if modules is None:
        raise SystemExit("nothing can be drawn: npm could not install three.js")
    out.mkdir(parents=True, exist_ok=True)
    (out / "list.json").write_text(json.dumps({"root": str(cache.resolve()), "pairs": pairs}), encoding="utf-8")
    done = subprocess.run(["node", PAGE, (out / "list.json").resolve(), out.resolve()], cwd=modules, env=os.environ)
    if done.returncode:
        raise SystemExit("the browser failed: no pictures")
    return json.loads((out / "pairs.json").read_text(encoding="utf-8"))
