"""glTF scenes: whole files by texf-enc OUT.glb and by `gltf-transform optimize`, at equal PSNR in light.

python tools/bench/scenes.py FILE.glb ... [--rows FILE.jsonl] [--page docs/reports/scenes.md]

Both files are loaded and drawn at rest, in daylight, 8 views of 512 pixels. Needs the command gltf-transform of
@gltf-transform/cli (TEXFCODEC_GLTF_TRANSFORM names another). Rows that FILE.jsonl has are not measured again.
"""

import argparse
import json
import math
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # run as a command
    sys.path.insert(0, str(REPOSITORY))

import texfcodec  # noqa: E402
from texfcodec.io.load import load  # noqa: E402
from texfcodec.metrics.views import ViewSettings, compare_views  # noqa: E402
from texfcodec.render.environment import DAYLIGHT  # noqa: E402
from tools.bench.provenance import made_on  # noqa: E402
from tools.bench.result_tables import markdown_table, wrapped  # noqa: E402

RATES = ("r01", "r03", "r05", "r06")
MATCH = 99.0  # dB of equal pictures
WORDS = ("--compress", "draco", "--texture-compress", "avif")


def psnr_in_light(source, file):
    """PSNR of Y of a file's pictures against a Scene's, in dB; MATCH for equal ones."""
    settings = ViewSettings(environment=DAYLIGHT, mipmaps=True)
    return compare_views(source, load(file), views=8, size=512, settings=settings)["psnr"]["y"] or MATCH


def by_rival(path, folder):
    """(file, seconds of wall) of gltf-transform."""
    command = shlex.split(os.environ.get("TEXFCODEC_GLTF_TRANSFORM", "gltf-transform"))
    out, begin = Path(folder) / "rival.glb", time.perf_counter()
    subprocess.run([*command, "optimize", str(path), str(out), *WORDS], check=True, capture_output=True, timeout=900)
    return out, time.perf_counter() - begin


def by_us(path, folder, rate):
    """(file, seconds of wall) of encode_gltf()."""
    out, begin = Path(folder) / f"{rate}.glb", time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        out.write_bytes(texfcodec.encode_gltf(path, {"rate": rate}).data)
    return out, time.perf_counter() - begin


def measured(path):
    """The row of a file: bytes of the source and, by method, [bytes, dB, seconds]."""
    source, row = load(path), {"name": path.stem if path.suffix == ".glb" else path.parent.name}
    row["source"] = sum(source.files.values())
    with tempfile.TemporaryDirectory() as folder:
        for name in ("rival", *RATES):
            out, seconds = by_rival(path, folder) if name == "rival" else by_us(path, folder, name)
            row[name] = [out.stat().st_size, round(psnr_in_light(source, out), 2), round(seconds, 1)]
    return row


def bytes_at(row, decibels):
    """(bytes of ours at a PSNR between rates, a word on how they are known)."""
    points = sorted((row[rate][1], row[rate][0]) for rate in RATES)
    if decibels <= points[0][0]:
        return points[0][1], "r01 is closer"
    for (low, fewer), (high, more) in zip(points[:-1], points[1:], strict=True):
        if low <= decibels <= high:
            share = (decibels - low) / max(high - low, 1e-9)
            return math.exp((1 - share) * math.log(fewer) + share * math.log(more)), ""
    return points[-1][1], "r06 is less close"


def page_of(rows):
    """The Markdown of a page."""
    lines, shares = [], []
    for row in sorted(rows, key=lambda row: row["name"]):
        (size, decibels, seconds), (least, psnr, own_seconds) = row["rival"], row["r03"]
        ours, how = bytes_at(row, decibels)
        shares.append(100 * ours / size)
        lines.append([row["name"], f"{row['source']:,}", f"{size:,}", f"{decibels:.1f}", f"{ours:,.0f}", f"{shares[-1]:.0f} %",
                      how, f"{least:,}", f"{psnr:.1f}", f"{own_seconds:.1f}", f"{seconds:.1f}"])
    head = ["scene", "source", "gltf-transform", "dB", "ours at that dB", "share", "", "r03", "dB", "s", "theirs, s"]
    text = (f"Made by `make -C tools scenes` (tools/bench/scenes.py) {made_on()}. Whole files: `gltf-transform optimize "
            f"{' '.join(WORDS)}` and `texf-enc scene.glb out.glb`. Bytes of ours are between those of {', '.join(RATES)} at the "
            "rival's PSNR of Y in daylight, 8 views of 512 pixels at rest; where r01 is closer, they are those of r01. Seconds "
            "are of wall, as a whole program (theirs) and in one process (ours).")
    last = f"Median {statistics.median(shares):.0f} %, from {min(shares):.0f} to {max(shares):.0f} %."
    return "\n".join(wrapped(["# Scenes", "", text, "", *markdown_table(head, lines), "", last])) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--rows", type=Path, default=Path("out/scenes.jsonl"))
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    arguments.rows.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in arguments.rows.read_text().splitlines()] if arguments.rows.exists() else []
    for path in arguments.files:
        if not {path.stem, path.parent.name} & {row["name"] for row in rows}:
            rows.append(measured(path))
            with arguments.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            print(json.dumps(rows[-1]), flush=True)
    if arguments.page:
        arguments.page.write_text(page_of(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
