"""Public models that this project has never seen, fetched by name and hash, coded, decoded and judged from outside.

python tools/proof/public_models [--cache out/public_models] [--only WORD...] [--round N] [--largest BYTES] [--most N] [--jobs N]
    [--rows FILE.jsonl] [--keep-old] [--summary-only] [--pictures N] [--before FILE.jsonl]
    [--page FILE.md [--kinds FILE.jsonl] [--ladders FILE.jsonl]]
python tools/proof/public_models --add KIND:NAME:VERSION:MOST

Each model is coded at a rate, decoded to GLB, and compared with its source, in processes with capped time and memory. A line per
model goes to --rows; --keep-old leaves models alone that have one, so that the same command goes on where it was stopped.
--before takes the models of another file of rows and says what has changed. Exit code 7: something falls short.
"""

import argparse
import sys
from pathlib import Path

if not __package__:  # called as a folder
    sys.path[0] = str(Path(__file__).resolve().parents[3])

from texfcodec.errors import EXIT_DIFFERS, EXIT_INTERRUPTED, EXIT_IO
from tools.proof.public_models.fetch import fetch
from tools.proof.public_models.judge import changed, summary
from tools.proof.public_models.listing import LARGEST, add_package, entries_of, read_list, write_list
from tools.proof.public_models.page import page_of
from tools.proof.public_models.pictures import draw
from tools.proof.public_models.rows import read_rows
from tools.proof.public_models.run import RATE, run_all


def _arguments(arguments):
    parser = argparse.ArgumentParser(prog="public_models", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--cache", type=Path, default=Path("out/public_models"), metavar="DIR", help="packages, streams and pictures")
    add("--add", action="append", default=[], metavar="KIND:NAME:VERSION:MOST", help="add a package to the list")
    add("--only", action="append", metavar="WORD", help="models whose name holds it; repeatable")
    add("--largest", type=int, metavar="BYTES", help="models of at most so many bytes, side files apart")
    add("--most", type=int, metavar="N", help="the first N of them")
    add("--round", type=int, metavar="N", help="models that were added in it; with --add: the new package's")
    add("--rate", default=RATE)
    add("--effort", help="of the encoder, where it is not the usual one")
    add("--jobs", type=int, default=1, metavar="N", help="models at a time")
    add("--inside", action="store_true", help="one at a time in this process, uncapped: faster")
    add("--seconds", type=float, default=300, metavar="S", help="most for a model")
    add("--memory", type=int, default=6 << 30, metavar="BYTES", help="most for a process")
    add("--rows", type=Path, metavar="FILE.jsonl", help="[default: rows.jsonl in the cache]")
    add("--keep-old", action="store_true", help="leave models alone that have a row")
    add("--before", type=Path, metavar="FILE.jsonl", help="their models, and what has changed")
    add("--pictures", type=int, default=0, metavar="N", help="draw so many, source and decoded, on sheets of 20")
    add("--page", type=Path, metavar="FILE.md", help="write a page of the rows")
    add("--kinds", type=Path, metavar="FILE.jsonl", help="rows of public_models.kinds, for the page")
    add("--ladders", type=Path, metavar="FILE.jsonl", help="rows of some models at several rates, for the page")
    add("--summary-only", action="store_true", help="of the rows that are there")
    return parser.parse_args(arguments)


def _chosen(args):
    known = {row["name"] for row in read_rows(args.before)} if args.before else ()
    return [entry for entry in entries_of(read_list())
            if (not args.only or any(word in entry.name for word in args.only))
            and (args.largest is None or entry.model["bytes"] <= args.largest)
            and args.round in (None, entry.package.get("round", 1))
            and (not args.before or entry.name in known)][: args.most]


def _run(args):
    args.cache.mkdir(parents=True, exist_ok=True)
    if args.add:
        packages = read_list()
        for text in args.add:
            packages = add_package(text, args.cache, packages, args.round or 1, args.largest or LARGEST)
            write_list(packages)
        print(f"{len(packages)} packages, {len(entries_of(packages))} models")
        return 0
    rows_file = args.rows or args.cache / "rows.jsonl"
    here, missing = fetch(_chosen(args), args.cache)
    if not here:
        print("no package could be fetched: nothing to do", file=sys.stderr)
        return EXIT_IO
    if not args.summary_only:
        run_all(here, args, rows_file)
    names = {entry.name for entry in here}
    rows = [row for row in read_rows(rows_file) if row["name"] in names]
    rows = draw(rows, args.pictures, args.cache, rows_file) if args.pictures else rows
    text, is_short = summary(rows, missing)
    print(text)
    if args.page:
        kinds, ladders = (read_rows(file) if file else [] for file in (args.kinds, args.ladders))
        args.page.write_text(page_of(rows, kinds, ladders, len({entry.package["name"] for entry in here})), encoding="utf-8")
    if args.before:
        print(changed(read_rows(args.before), rows))
    return EXIT_DIFFERS if is_short else 0


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    try:
        return _run(_arguments(arguments))
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
