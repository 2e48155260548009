"""docs/reports/stability.md from the table and the worst trials."""

import re

from tools.bench.provenance import made_on
from tools.proof.stability.case import Case, Worst
from tools.proof.stability.plots import PICTURES
from tools.proof.stability.table import CASES, GROUPS

HEAD = """# How far off it can get

Made by `make -C tools stability` (tools/proof/stability) {made}.

The table of cases is also what tests/proof/test_stability.py runs. Each case stresses one thing, says how large the error may
be and why, and measures it against exact fractions, the reference decoder, or a formula. Half of the trials are
random, by seed; every other one is a step of a search that changes some of the choices of the worst trial so far and keeps what
is worse. *By* says which of them found the worst. A bound of 0 means that nothing differs. Of heavy cases the size is told
beside the trials: *small* as in the tests, *usual* as the case says, *most* with --most.
"""
SIZES = ("small", "usual", "most")
TABLE = ("| case | bound | worst | share | by | trials | seconds |", "|---|---:|---:|---:|---|---:|---:|")
ROW = re.compile(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \| [^|]+ \| (?:seeds|search) \| [\d,]+(?: \w+)? \| [\d.]+ \|$", re.MULTILINE)


def number(value: float) -> str:
    """A value in few digits; more where it is close to 1, as bounds of rounding are."""
    return f"{value:.10g}" if 0 < abs(value - 1) < 1e-3 else f"{value:.4g}"


def bound_of(case: Case) -> str:
    """The bound with its unit."""
    return f"{number(case.bound)} {case.unit}"


def row_of(case: Case, worst: Worst) -> str:
    """A case's row."""
    size = f" {SIZES[worst.size]}" if case.heavy else ""
    share = f"{100 * worst.value / case.bound:.3g} %" if case.bound else "none"
    return (f"| {case.name} | {bound_of(case)} | {number(worst.value)} | {share} | {worst.by} | {worst.trials:,}{size} | "
            f"{worst.seconds:.1f} |")


def page_of(found: dict[str, Worst], pictures: list[str]) -> str:
    """The page. found: Worst by the name of the case; pictures: files of those that were drawn."""
    out = [HEAD.format(made=made_on()), *TABLE, *(row_of(CASES[name], worst) for name, worst in found.items()), "",
           f"{len(found)} cases, {sum(w.trials for w in found.values()):,} trials."]
    for group in GROUPS:
        mine = [case for case in CASES.values() if case.group == group and case.name in found]
        if not mine:
            continue
        out += ["", f"## {group}", ""]
        for case in mine:
            out.append(f"- **{case.name}** ({case.stresses}). {case.why}")
        for file, (owner, text) in PICTURES.items():
            if owner == group and file in pictures:
                out += ["", f"![{text}](pictures/{file})", "", text]
    return "\n".join(out) + "\n"


def rows_of(page: str) -> dict[str, tuple[str, float]]:
    """(bound with its unit, worst value) by the name of the case, from a page."""
    return {m[1]: (m[2], float(m[3])) for m in ROW.finditer(page)}
