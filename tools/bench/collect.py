"""Tables, BD-rates, plots and pages of what rate_points.py has measured.

    python tools/bench/collect.py DIR [ANCHOR_DIR] --out FOLDER [--group G] [--against A ...] [--rate texture|total]
        [--keep FILE.jsonl]
    python tools/bench/collect.py DIR ... --table NAME --out FILE.md [--against A] [--assets FOLDER] [--measure y|rgb|yuv]

Writes results.csv (a row per finished job, every figure of its metrics.json), results.md (a table per asset, then BD-rates, then
what is missing and why) and, where plotly is installed, results.html (the rate curves of each group of settings, one file for a
browser that loads nothing).

A curve is one asset's settings of one group. With ANCHOR_DIR every group of DIR (or G alone) stands against the group A there, or
the one of the same name, or the only one; without it, against each group A of DIR. BD-rate is the mean difference of rate at
equal quality in percent, negative where fewer bytes are needed (metrics/bd_rate.py); exact points are left out. SSIM is compared
in decibels, -10 log10(1 - SSIM). --rate texture, as the paper does it, counts all bytes but geometry;
total counts geometry as well. Pictures lie in the jobs' folders where the conditions ask for them ([evaluation] pictures).

With --table a page of docs/ or its tables, Markdown, by the module of that name in tools/bench/tables: paper (results.md),
accuracy (accuracy_time.md), everyday (texels.md), lit (materials.md), maps and neural (neural.md).
"""

import argparse
import pkgutil
import sys
from importlib import import_module
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench import tables
from tools.bench.differences import pairs_of
from tools.bench.page import write_page
from tools.bench.result_tables import as_markdown, report, wrapped, write_csv
from tools.bench.results import keep_rows, read_missing, read_results

TABLES = [module.name for module in pkgutil.iter_modules(tables.__path__)]


def write_results(args):
    """Write results.csv, results.md and results.html of the results that the parsed arguments name."""
    if len(args.results) > 2:
        raise SystemExit("without --table there are a folder and, if wanted, one to compare it with")
    folder, *others = args.results
    rows, missing = read_results(folder), read_missing(folder)
    anchors = read_results(others[0]) if others else None
    compared = args.against or ([None] if others else [])
    pairs = [pair for anchor_group in compared for pair in pairs_of(rows, anchors, args.group, anchor_group)]
    args.out.mkdir(parents=True, exist_ok=True)
    if args.keep:
        keep_rows(args.keep, rows, missing)
    write_csv(rows, args.out / "results.csv")
    (args.out / "results.md").write_text(as_markdown(report(rows, missing, pairs, args.rate)), encoding="utf-8")
    shown = rows + [row | {"group": f"{row['group']} (anchor)"} for row in anchors or []]
    size = write_page(args.out / "results.html", shown, args.rate)
    print(f"{args.out}: results.csv, results.md" + (f", results.html ({size / 1e6:.1f} MB)" if size else ""))


def write_table(args):
    """Write the Markdown page of a module in tables/, which the parsed arguments name, or its table alone."""
    lines = import_module(f"tools.bench.tables.{args.table}").page(args)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text("\n".join(wrapped(lines)).rstrip() + "\n", encoding="utf-8")
    print(args.out)


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="or FILE.md, of a table")
    parser.add_argument("--table", choices=TABLES, help="write this table")
    parser.add_argument("--group", metavar="G", help="compare this group only")
    parser.add_argument("--against", "--anchor-group", metavar="A", action="append", help="compare with this group; repeatable")
    parser.add_argument("--rate", choices=("texture", "total"), default="texture", help="which bytes count")
    parser.add_argument("--assets", type=Path, metavar="FOLDER", help="where the assets are, for the table paper")
    parser.add_argument("--measure", choices=("y", "rgb", "yuv"), default="y", help="of the table everyday")
    parser.add_argument("--keep", type=Path, metavar="FILE.jsonl", help="also keep the rows in one file, which stands for DIR "
                        "here, pictures left out")
    args = parser.parse_args(arguments)
    (write_table if args.table else write_results)(args)


if __name__ == "__main__":
    main()
