"""How large the error gets in every hard case (tests/bounds.py): random trials and a search for the worst.

python tools/proof/stability.py [--case NAME...] [--seconds 5] [--trials N] [--small | --most] [--state FILE.jsonl]
                                [--page FILE.md]

The cases stand in tests/<room>/test_*_bounds.py. Ends with 7 where a bound is broken. --state keeps a line per case: the same
command goes on after the last of them. --page, which goes with all cases, writes the page, with its pictures in pictures/ beside
it where matplotlib is installed.
"""

import argparse
import importlib
import json
import re
import sys
from collections.abc import Callable
from dataclasses import asdict
from decimal import Decimal
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
ROOMS = {name: REPOSITORY / "tests" / room for room, name in (
    ("geometry", "coordinate"), ("field", "field"), ("codecs", "transform"), ("codecs", "entropy"), ("encoder", "fit"),
    ("codecs", "neural"), ("render", "look"))}
for folder in (REPOSITORY, REPOSITORY / "tests", *ROOMS.values()):  # as pytest finds them
    if str(folder) not in sys.path:
        sys.path.append(str(folder))

from bounds import MOST, PAGE, TEST, Case, Draws, Worst, worst_of  # noqa: E402

from tools.bench.plots import load_pyplot  # noqa: E402
from tools.bench.provenance import made_on  # noqa: E402

MODULES = {name: importlib.import_module(f"test_{name}_bounds") for name in ROOMS}
GROUPS = (*(module.case.name for module in MODULES.values()), "Floats of the encoder")
CASES = {case.name: case for name in GROUPS for module in MODULES.values() for kind in ("case", "fits", "floats")
         for case in getattr(module, kind, ()) if case.group == name}
BROKEN = 7
HEAD = """# How far off it can get

Made by `make -C tools stability` (tools/proof/stability.py) {made}.

The cases are also what the tests of their rooms run (test_*_bounds.py). Each case stresses one thing, says how large the error
may be and why, and measures it against exact fractions, the reference decoder, or a formula. Half of the trials are random,
by seed; every other one is a step of a search that changes some of the choices of the worst trial so far and keeps what
is worse. *By* says which of them found the worst. A bound of 0 means that nothing differs. Of heavy cases the size stands
beside the trials: *small* as in the tests, *usual* as the case says, *most* with --most.
"""
SIZES = ("small", "usual", "most")
TABLE = ("| case | bound | worst | share | by | trials | seconds |", "|---|---:|---:|---:|---|---:|---:|")
ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \| [^|]+ \| (?:seeds|search) \| [\d,]+(?: \w+)? \| [\d.]+ \|$", re.MULTILINE)


# The page


def number(value: float) -> str:
    """Return a value as text in few digits, more if it is close to 1, as bounds of rounding are."""
    return f"{value:.10g}" if 0 < abs(value - 1) < 1e-3 else f"{value:.4g}"


def bound_of(case: Case) -> str:
    """Return the bound of a case as text, with its unit."""
    return f"{number(case.bound)} {case.unit}"


def row_of(case: Case, worst: Worst) -> str:
    """Return the row of a case in the Markdown table, with its worst value."""
    size = f" {SIZES[worst.size]}" if case.heavy else ""
    share = f"{100 * worst.value / case.bound:.3g} %" if case.bound else "none"
    return (f"| {case.name} | {bound_of(case)} | {number(worst.value)} | {share} | {worst.by} | {worst.trials:,}{size} | "
            f"{worst.seconds:.1f} |")


def rows_of(page: str) -> dict[str, tuple[str, float]]:
    """Return {name of a case: (bound with its unit, worst value)} from the text of a page."""
    return {m[1]: (m[2], float(m[3])) for m in ROW.finditer(page)}


def page_of(worst_by_case: dict[str, Worst], pictures: list[str]) -> str:
    """Return the text of the page. worst_by_case: {name: Worst}; pictures: file names of the plots."""
    out = [HEAD.format(made=made_on()), *TABLE, *(row_of(CASES[name], worst) for name, worst in worst_by_case.items()), "",
           f"{len(worst_by_case)} cases, {sum(w.trials for w in worst_by_case.values()):,} trials."]
    for group in GROUPS:
        rows = [f"- **{case.name}** ({case.stress}). {case.why}" for case in CASES.values()
                if case.group == group and case.name in worst_by_case]
        out += ["", f"## {group}", "", *rows] if rows else []
        for file, (owner, text, _) in PICTURES.items():
            out += ["", f"![{text}](pictures/{file})", "", text] if rows and owner == group and file in pictures else []
    return "\n".join(out) + "\n"


# Pictures


def draw_scales(panel: object) -> None:
    """Plot the error of positions against the scale of the mesh, at the origin and away from it. panel: axes of matplotlib."""
    room = MODULES["coordinate"]
    for away, name in ((0, "at the origin"), (1e6, "1e6 extents away"), (1e12, "1e12 extents away")):
        worst = []
        for exponent in SCALES:
            scale = 10.0**exponent
            unit = np.concatenate([[[0] * 3, [1] * 3], np.random.default_rng(exponent + 1000).random((20, 3))])
            worst.append(room.rounding_of(unit * scale + min(scale * away, 0.8 * room.MAX_COORDINATE), 20))
        panel.plot(list(SCALES), worst, ".", markersize=3, label=name)
    panel.axhline(1, color="black", linewidth=0.8)
    panel.set(xlabel="scale, power of ten", ylabel="half lattice steps and an ulp", ylim=(0.6, 1.05))


def draw_levels(panel: object) -> None:
    """Plot the largest error of fixed point after each level of the transform. panel: axes of matplotlib."""
    room = MODULES["transform"]
    for total, children, name in ((room.REACHABLE, room.rebuilt, "kernels, 2^28 voxels"),
                                  (room.BEYOND, room.in_plain_integers, "clause, 2^40 voxels")):
        runs = [room.levels_down(Draws(np.random.default_rng(i)), total, children) for i in range(RUNS)]
        panel.plot(range(1, room.LEVELS + 1), np.max(runs, axis=0), "o-", markersize=3, label=name)
    levels = np.array([1, room.LEVELS])
    panel.plot(levels, room.ULPS_A_LEVEL * levels, color="black", linewidth=0.8, label="bound")
    panel.set(xlabel="level", ylabel="ulps of 1/4096 level")


def draw_ties(panel: object) -> None:
    """Plot how near coefficients come to a rounding tie, and the error of the encoder's floats. panel: axes of matplotlib."""
    ties, errors = [], []
    for i in range(BLOCKS):
        scaled, exact, _, _ = MODULES["transform"].scaled_block(Draws(np.random.default_rng(i)))
        for node, (value, _) in exact.items():
            ties.append(float(abs(value % 1) - Decimal("0.5")))
            errors.append(float(abs(Decimal(float(scaled[node])) - value)))
    for values, name in ((errors, "error of the floats"), (ties, "distance from a tie")):
        panel.hist(np.log10(np.maximum(np.abs(values), 1e-18)), np.arange(-18, 0.5, 0.5), alpha=0.6, label=name)
    panel.set(xlabel="power of ten of a step", ylabel="coefficients", yscale="log")


SCALES, RUNS, BLOCKS = range(-289, 150, 3), 200, 600
# By file: the group that it belongs to, its caption, and the function that draws it into a panel
PICTURES: dict[str, tuple[str, str, Callable[[object], None]]] = {
    "stability_scale.png": (GROUPS[0], f"Worst of 22 positions on 20 bits at each of {len(SCALES)} scales: nothing depends on "
                            "the scale.", draw_scales),
    "stability_levels.png": ("Transform and quantisation", f"The furthest child of {RUNS} chains of random blocks, by level.",
                             draw_levels),
    "stability_ties.png": (GROUPS[-1], f"Coefficients of {BLOCKS} random blocks: how far the floats are off, and how far the "
                           "nearest tie is.", draw_ties)}


def draw(folder: Path) -> list[str]:
    """Draw all plots into a folder and return their file names; [] without matplotlib."""
    pyplot = load_pyplot()
    if pyplot is None:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    for file, (_, _, draw_panel) in PICTURES.items():
        figure, panel = pyplot.subplots(figsize=(6, 3), layout="tight")
        draw_panel(panel)
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
        figure.savefig(folder / file, dpi=80)
        pyplot.close(figure)
    return list(PICTURES)


# The command


def _arguments(arguments: list[str] | None) -> argparse.Namespace:
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


def _run(case: Case, args: argparse.Namespace) -> Worst:
    """The Worst of a case, noted in the state."""
    worst_of(case, trials=1)  # compiles, so that the seconds are those of trials
    worst = worst_of(case, args.trials, args.seconds, args.size)
    if args.state:
        args.state.parent.mkdir(parents=True, exist_ok=True)
        with args.state.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"case": case.name} | asdict(worst)) + "\n")
    return worst


def main(arguments: list[str] | None = None) -> int:
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    args = _arguments(arguments)
    rows = map(json.loads, args.state.read_text(encoding="utf-8").splitlines()) if args.state and args.state.exists() else ()
    known, worst_by_case, broken = {row.pop("case"): Worst(**row) for row in rows}, {}, []
    for name in args.case or CASES:
        case = CASES[name]
        worst_by_case[name] = known.get(name) or _run(case, args)
        print(row_of(case, worst_by_case[name]), flush=True)
        if worst_by_case[name].value > case.bound:
            broken.append(name)
            print(f"broken: {name}, answers {list(worst_by_case[name].answers)}", file=sys.stderr)
    if args.page:
        args.page.parent.mkdir(parents=True, exist_ok=True)
        args.page.write_text(page_of(worst_by_case, draw(args.page.parent / "pictures")), encoding="utf-8")
    return BROKEN if broken else 0


if __name__ == "__main__":
    sys.exit(main())
