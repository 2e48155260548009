"""Sheets of pictures: source and decoded mesh beside each other, drawn by three.js, which has loaders of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

from proof.strangers.judge import findings_of, worst_rgb
from proof.strangers.rows import add_row
from proof.strangers.run import node_modules
from texfcodec.core.colour_error import in_decibels

PAGE = Path(__file__).with_name("pictures.mjs")


def draw(rows, count, cache, rows_file):
    """Rows with what three.js shows of `count` of them, evenly spread over those that were decoded. Sheets go to the folder
    pictures of the cache, and rows with pictures to the file. Raises SystemExit where nothing can be drawn."""
    modules, out = node_modules(cache), cache / f"pictures-{rows_file.stem}"
    drawable = [row for row in rows if "measure" in row and not row["name"].lower().endswith(".off")]
    chosen = [drawable[i * len(drawable) // min(count, len(drawable))] for i in range(min(count, len(drawable)))]
    if modules is None or not chosen:
        raise SystemExit("nothing can be drawn: no model was decoded, or npm could not install three.js")
    out.mkdir(parents=True, exist_ok=True)
    pairs = [{"source": row["source"], "mesh": row["mesh"], "text": f"{row['name']} \u00b7 worst part {_worst(row)}"}
             for row in chosen]
    (out / "list.json").write_text(json.dumps({"root": str(cache.resolve()), "pairs": pairs}), encoding="utf-8")
    done = subprocess.run(["node", PAGE, (out / "list.json").resolve(), out.resolve()], cwd=modules, env=os.environ)
    if done.returncode:
        raise SystemExit("the browser failed: no pictures")
    shown = dict(zip([row["name"] for row in chosen], json.loads((out / "pairs.json").read_text(encoding="utf-8")), strict=True))
    print(f"{len(chosen)} pairs in {out}", file=sys.stderr)
    return [_with_picture(row, shown.get(row["name"]), rows_file) for row in rows]


def _worst(row):
    worst = worst_rgb(row)
    return "not measured" if worst != worst else in_decibels(worst)


def _with_picture(row, picture, rows_file):
    if picture is None:
        return row
    row = row | {"picture": picture}
    row["findings"] = findings_of(row)
    add_row(rows_file, row)
    return row
