"""How large the error gets in every hard case: random trials and a search for the worst.

python tools/proof/stability [--case NAME...] [--seconds 5] [--trials N] [--small | --most] [--state FILE.jsonl] [--page FILE.md]

Ends with 7 where a bound is broken. --state keeps a line per case: the same command goes on after the last of them, so that a
run may be stopped; without the file it begins anew. --page, which goes with all cases, writes the page, with its pictures in
pictures/ beside it where matplotlib is installed.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

if not __package__:  # called as a folder
    sys.path[0] = str(Path(__file__).resolve().parents[3])

from tools.proof.stability.case import MOST, PAGE, TEST, Worst, worst_of
from tools.proof.stability.page import page_of, row_of
from tools.proof.stability.plots import draw
from tools.proof.stability.table import CASES

BROKEN = 7


def _arguments(arguments):
    parser = argparse.ArgumentParser(prog="stability", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", action="append", choices=CASES, metavar="NAME", help="of these cases only; repeatable")
    parser.add_argument("--seconds", type=float, default=5, metavar="S", help="begin no more trials of a case after so long")
    parser.add_argument("--trials", type=int, metavar="N", help="at most so many trials a case")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--small", dest="size", action="store_const", const=TEST, default=PAGE, help="heavy cases as in the tests")
    size.add_argument("--most", dest="size", action="store_const", const=MOST, help="heavy cases as large as they go")
    parser.add_argument("--state", type=Path, metavar="FILE.jsonl", help="what was found: read first, then added to")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    parsed = parser.parse_args(arguments)
    if parsed.page and parsed.case:
        parser.error("--page goes with all cases")
    return parsed


def _known(state):
    """Worst by the name of the case, of a state; none without one."""
    rows = map(json.loads, state.read_text(encoding="utf-8").splitlines()) if state and state.exists() else ()
    return {row.pop("case"): Worst(**row) for row in rows}


def _run(case, args):
    """The Worst of a case, noted in the state."""
    worst_of(case, trials=1)  # compiles, so that the seconds are those of trials
    worst = worst_of(case, args.trials, args.seconds, args.size)
    if args.state:
        args.state.parent.mkdir(parents=True, exist_ok=True)
        with args.state.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"case": case.name} | asdict(worst)) + "\n")
    return worst


def main(arguments: list[str] | None = None) -> int:
    """Command line of the tool."""
    args = _arguments(arguments)
    known, found, broken = _known(args.state), {}, []
    for name in args.case or CASES:
        case = CASES[name]
        found[name] = known.get(name) or _run(case, args)
        print(row_of(case, found[name]), flush=True)
        if found[name].value > case.bound:
            broken.append(name)
            print(f"broken: {name}, answers {list(found[name].answers)}", file=sys.stderr)
    if args.page:
        args.page.parent.mkdir(parents=True, exist_ok=True)
        args.page.write_text(page_of(found, draw(args.page.parent / "pictures")), encoding="utf-8")
    return BROKEN if broken else 0


if __name__ == "__main__":
    sys.exit(main())
