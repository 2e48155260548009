"""Two checkouts side by side: seconds, memory and bytes of texf-enc and of texf-dec to GLB, asset by asset in turns, because the
speed of a machine wanders by more than what a change gains.

    python tools/bench/pairs.py BEFORE AFTER ASSET.glb ... [--rate r03] [--out pairs.json] [--page docs/reports/pairs.md]

BEFORE, AFTER: folders of two checkouts (`git worktree add`), run with the Python that runs this; the first asset is coded once by
each without being counted, so that kernels are compiled. Without assets the page is made of what the file holds.
"""

import argparse
import hashlib
import json
import statistics
import sys
import tempfile
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.processes import timed
from tools.bench.provenance import machine, state_of
from tools.bench.result_tables import markdown_table, wrapped

SIDES = "before", "after"


def measure(roots, asset, rate):
    """{"encode", "save": {side: timed(), with "bytes" and "sha256" of what was written}} of an asset. Both sides save the stream
    of the second."""
    out = {"encode": {}, "save": {}}
    with tempfile.TemporaryDirectory() as folder:
        stream, mesh = Path(folder) / "made.texf", Path(folder) / "made.glb"
        for side, root in zip(SIDES, roots, strict=True):
            row = timed(("texfcodec.cli.enc", str(asset), str(stream), "--rate", rate), root)
            out["encode"][side] = row | _content(stream)
        for side, root in zip(SIDES, roots, strict=True):
            out["save"][side] = timed(("texfcodec.cli.dec", str(stream), str(mesh), "--overwrite"), root) | _content(mesh)
    return out


def _content(path):
    return {"bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def page_of(found):
    """Markdown of {"commits": [2], "rate", "machine", "rows": {asset: measure()}}."""
    rows, table, ratios = found["rows"], [], {}
    for name, row in rows.items():
        cells = []
        for what in ("encode", "save"):
            before, after = (row[what][side] for side in SIDES)
            for clock in ("wall", "processor"):
                ratios.setdefault((what, clock), []).append(after[clock] / before[clock])
                cells.append(f"{before[clock]:.1f}, {after[clock]:.1f}")
            cells.append("the same" if before["sha256"] == after["sha256"] else f"{after['bytes'] - before['bytes']:+,} bytes")
        made = row["encode"]["after"]
        table.append([name, f"{made['bytes']:,}", made["sha256"][:12], *cells, f"{made['processor'] / made['wall']:.2f}",
                      f"{made['memory'] / (1 << 20):,.0f}"])
    middle = {key: f"{100 * statistics.median(values):.0f} %" for key, values in ratios.items()}
    lines = ["# Two states side by side", "",
             f"Made by bench/pairs.py on {found['machine']}: commit {found['commits'][0]} before, {found['commits'][1]} after; "
             f"rate {found['rate']}, whole processes with compiled kernels, each asset by both in turn. Seconds are before, "
             "after; both save the same stream as GLB. Cores: processor seconds over those by the wall clock, of the encode "
             "after.", "",
             f"In the median an encode takes {middle['encode', 'wall']} of the time by the wall clock and "
             f"{middle['encode', 'processor']} of the processor's, a decode to GLB {middle['save', 'wall']} and "
             f"{middle['save', 'processor']}.", ""]
    lines += markdown_table(["asset", "stream, bytes", "SHA-256", "encode, wall s", "processor s", "stream", "to GLB, wall s",
                             "processor s", "GLB", "cores", "MB, encode"], table)
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roots", nargs=2, type=lambda text: Path(text).resolve(), metavar="FOLDER")
    parser.add_argument("assets", nargs="*", type=lambda text: Path(text).resolve())
    parser.add_argument("--rate", default="r03")
    parser.add_argument("--out", type=Path, default=Path("out/pairs.json"))
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    if args.assets:
        measure(args.roots, args.assets[0], args.rate)
        found = {"commits": [state_of(root) for root in args.roots], "rate": args.rate, "machine": machine(), "rows": {}}
        args.out.parent.mkdir(parents=True, exist_ok=True)
        for asset in args.assets:
            found["rows"][asset.stem] = measure(args.roots, asset, args.rate)
            args.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    text = page_of(json.loads(args.out.read_text(encoding="utf-8")))
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
