"""Public models that this project has never seen, fetched by name and hash, coded, decoded and judged from outside.

python tools/proof/strangers [--cache out/strangers] [--only WORD...] [--round N] [--largest BYTES] [--most N] [--jobs N]
    [--rows FILE.jsonl] [--keep-old] [--summary-only] [--pictures N] [--before FILE.jsonl] [--code FOLDER] [--fetch-only]
    [--page FILE.md [--kinds FILE.jsonl] [--ladders FILE.jsonl]]
python tools/proof/strangers --add KIND:NAME:VERSION:MOST

Each model is coded at a rate, decoded to GLB, and compared with its source, in processes with capped time and memory. A line per
model goes to --rows; --keep-old leaves models alone that have one, so that the same command goes on where it was stopped. --code
measures the code of another checkout; --before takes the models of another file of rows and says what has changed. Exit code 7:
something falls short.
"""

import argparse
import sys
from pathlib import Path

if not __package__:  # called as a folder
    sys.path[0] = str(Path(__file__).resolve().parents[3])
    import tools.bench  # noqa: F401  these, whatever --code names
    import tools.proof  # noqa: F401

    if "--code" in sys.argv[:-1]:
        sys.path.insert(0, str(Path(sys.argv[sys.argv.index("--code") + 1]).resolve()))

from texfcodec.errors import EXIT_DIFFERS, EXIT_IO
from tools.bench.batch import resumable
from tools.proof.strangers.fetch import Unfetched, fetch_package
from tools.proof.strangers.judge import changed, summary
from tools.proof.strangers.listing import LARGEST, LIST, add_package, folder_of, read_list, strangers_of, write_list
from tools.proof.strangers.page import write_page
from tools.proof.strangers.pictures import draw
from tools.proof.strangers.rows import read_rows
from tools.proof.strangers.run import RATE, run_all


def _arguments(arguments):
    parser = argparse.ArgumentParser(prog="strangers", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("out/strangers"), metavar="DIR", help="packages, streams and pictures")
    parser.add_argument("--list", type=Path, default=LIST, metavar="FILE.json")
    parser.add_argument("--add", action="append", default=[], metavar="KIND:NAME:VERSION:MOST", help="add a package to the list")
    parser.add_argument("--only", action="append", metavar="WORD", help="models whose name holds it; repeatable")
    parser.add_argument("--largest", type=int, metavar="BYTES", help="models of at most so many bytes, side files apart")
    parser.add_argument("--most", type=int, metavar="N", help="the first N of them")
    parser.add_argument("--round", type=int, metavar="N", help="models that were added in it; with --add: the new package's")
    parser.add_argument("--ascending", action="store_true", help="small models first")
    parser.add_argument("--rate", default=RATE)
    parser.add_argument("--effort", help="of the encoder, where it is not the usual one")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="models at a time")
    parser.add_argument("--inside", action="store_true", help="one at a time in this process, uncapped: faster")
    parser.add_argument("--seconds", type=float, default=300, metavar="S", help="most for a model")
    parser.add_argument("--memory", type=int, default=6 << 30, metavar="BYTES", help="most for a process")
    parser.add_argument("--rows", type=Path, metavar="FILE.jsonl", help="[default: rows.jsonl in the cache]")
    parser.add_argument("--keep-old", action="store_true", help="leave models alone that have a row")
    parser.add_argument("--before", type=Path, metavar="FILE.jsonl", help="their models, and what has changed")
    parser.add_argument("--pictures", type=int, default=0, metavar="N", help="draw so many, source and decoded, on sheets of 20")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write a page of the rows")
    parser.add_argument("--kinds", type=Path, metavar="FILE.jsonl", help="rows of proof.strangers.kinds, for the page")
    parser.add_argument("--ladders", type=Path, metavar="FILE.jsonl", help="rows of some models at several rates, for the page")
    parser.add_argument("--code", metavar="FOLDER", help="a checkout whose texfcodec is measured")
    parser.add_argument("--fetch-only", action="store_true")
    parser.add_argument("--summary-only", action="store_true", help="of the rows that are there")
    return parser.parse_args(arguments)


def _chosen(args):
    strangers = strangers_of(read_list(args.list))
    known = {row["name"] for row in read_rows(args.before)} if args.before else ()

    def is_wanted(stranger):
        return ((not args.only or any(word in stranger.name for word in args.only))
                and (args.largest is None or stranger.model["bytes"] <= args.largest)
                and args.round in (None, stranger.package.get("round", 1))
                and (not args.before or stranger.name in known))

    chosen = sorted(filter(is_wanted, strangers), key=lambda stranger: stranger.model["bytes"] if args.ascending else 0)
    return chosen[: args.most]


def fetch(strangers, cache):
    """Those of the strangers whose package is here, and {package name: why not} of the others."""
    missing, packages = {}, {stranger.package["name"]: stranger.package for stranger in strangers}
    for name, package in packages.items():
        try:
            fetch_package(package, folder_of(package, cache), cache)
        except (Unfetched, OSError) as error:
            missing[name] = str(error)
            print(f"not fetched: {error}", file=sys.stderr)
    return [stranger for stranger in strangers if stranger.package["name"] not in missing], missing


def main(arguments=None):
    """Command line of the tool."""
    args = _arguments(arguments)
    args.cache.mkdir(parents=True, exist_ok=True)
    if args.add:
        packages = read_list(args.list) if args.list.exists() else []
        for text in args.add:
            packages = add_package(text, args.cache, packages, args.round or 1, args.largest or LARGEST)
            write_list(packages, args.list)
        print(f"{len(packages)} packages, {len(strangers_of(packages))} models")
        return 0
    rows_file = args.rows or args.cache / "rows.jsonl"
    here, missing = fetch(_chosen(args), args.cache)
    if not here:
        print("no package could be fetched: nothing to do", file=sys.stderr)
        return EXIT_IO
    if args.fetch_only:
        print(f"{len(here)} models in {args.cache}, {len(missing)} packages not fetched")
        return 0
    if not args.summary_only:
        run_all(here, args, rows_file)
    names = {stranger.name for stranger in here}
    rows = [row for row in read_rows(rows_file) if row["name"] in names]
    if args.pictures:
        rows = draw(rows, args.pictures, args.cache, rows_file)
    text, is_short = summary(rows, missing)
    print(text)
    if args.page:
        write_page(args.page, rows, args.kinds, args.ladders, len({stranger.package["name"] for stranger in here}))
    if args.before:
        print(changed(read_rows(args.before), rows))
    return EXIT_DIFFERS if is_short else 0


if __name__ == "__main__":
    sys.exit(resumable(main, None))
