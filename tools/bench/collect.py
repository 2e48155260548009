"""Tables, BD-rates, plots and a page of what rate_points.py has measured.

python tools/bench/collect.py DIR [ANCHOR_DIR] --out FOLDER [--group G] [--against A ...] [--rate texture|total]
        [--published FILE.csv]
                        [--no-pictures]

Writes results.csv (a row per finished job, every figure of its metrics.json), results.md (a table per asset, then BD-rates, then
what is missing and why) and results.html (the same as one file for a browser, with pictures and, where plotly is installed, the
rate curves of each group of settings; it loads nothing).

A curve is one asset's settings of one group. With ANCHOR_DIR every group of DIR (or G alone) stands against the group A there, or
the one of the same name, or the only one; without it, against each group A of DIR. BD-rate is the mean difference of rate at
equal quality in percent, negative where fewer bytes are needed (metrics/bd_rate.py); exact points are left out. SSIM is compared
in decibels, -10 log10(1 - SSIM), LPIPS as -10 log10(LPIPS). --rate texture, as the paper does it, counts all bytes but geometry;
total counts geometry as well.

FILE.csv holds points that others have published (baselines/published.py). They are marked, and stand in a BD-rate only where
their asset is one of DIR's. Pictures are in the page where the conditions ask for them ([evaluation] pictures).
"""

import argparse
import sys
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.differences import pairs_of
from tools.bench.page import write_page
from tools.bench.result_tables import as_markdown, report, write_csv
from tools.bench.results import keep_rows, published_rows, read_missing, read_results


def read_published_rows(path):
    """Rows of a file of published points; none without a path. Ends the program with a sentence."""
    if path is None:
        return []
    from tools.bench.methods.published import read_published

    try:
        return published_rows(read_published(path))
    except (OSError, ValueError) as error:
        raise SystemExit(f"{path}: {error}") from None


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, metavar="DIR")
    parser.add_argument("anchor", type=Path, nargs="?", metavar="ANCHOR_DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--group", metavar="G", help="compare this group only")
    parser.add_argument("--against", "--anchor-group", metavar="A", action="append", help="compare with this group; repeatable")
    parser.add_argument("--rate", choices=("texture", "total"), default="texture", help="which bytes count")
    parser.add_argument("--published", type=Path, metavar="FILE.csv", help="points that others have published")
    parser.add_argument("--no-pictures", action="store_true", help="leave the pictures out of the page")
    parser.add_argument("--keep", type=Path, metavar="FILE.jsonl", help="also keep the rows in one file, which stands for DIR "
                        "here and in paper_table.py, pictures left out")
    args = parser.parse_args(arguments)
    rows, anchors = read_results(args.results), read_results(args.anchor) if args.anchor else None
    missing, every = read_missing(args.results), rows + read_published_rows(args.published)
    compared = args.against or ([None] if anchors is not None else [])
    pairs = [pair for anchor_group in compared for pair in pairs_of(every, anchors, args.group, anchor_group)]
    args.out.mkdir(parents=True, exist_ok=True)
    if args.keep:
        keep_rows(args.keep, rows, missing)
    write_csv(every, args.out / "results.csv")
    blocks = report(every, missing, pairs, args.rate)
    (args.out / "results.md").write_text(as_markdown(blocks), encoding="utf-8")
    shown = every + [row | {"group": f"{row['group']} (anchor)"} for row in anchors or []]
    size = write_page(args.out / "results.html", blocks, shown, args.rate, None if args.no_pictures else args.results)
    print(f"{args.out}: results.csv, results.md, results.html ({size / 1e6:.1f} MB)")


if __name__ == "__main__":
    main()
