"""docs/reports/fuzzing.md: what was run, what it reached, what it found."""

import json
from collections.abc import Iterable
from pathlib import Path

from fuzz.targets import TARGETS
from tools.bench.provenance import made_on

MENDED = Path(__file__).with_name("mended.json")
HEAD = """# Fuzzing

Made by `make -C tools fuzz PAGE=docs/reports/fuzzing.md` {made}, from the runs so far.

`tests/fuzz/` holds the targets, and `make -C tools fuzz SECONDS=n [TARGET=name]` runs them. A target takes bytes as choices,
writes legal syntax, bends one or two elements under right checksums, and runs the part of the decoder, or the loader, that it
is for. It may end in a value or in an error with a code; an exception, a crash, an input that takes longer than 10 s or adds
more than 256 MB to the process is a finding.

Every target runs in three ways: *plain*, compiled, at full speed; *guided*, without the compiler, by a search that keeps inputs
which reach new code (atheris where it is installed, else a loop of our own); *checked*, what was kept once more, compiled with
every index checked. *Coverage* is the share of the branches (`if`, `for`, `while`, entered and passed by) of the target's modules
that guided runs reached, without functions of the encoder's side; a run that stays under the *floor* fails, so that no target can
stop reaching what it is for without anybody noticing.
"""
FAULTS = """Every call to the system that a run of a tool makes, and every array that the package asks numpy for, fails once, one
after the other: a full disk, an input or output error, missing rights, a read-only disk, too many open files, no memory, an
output folder that vanishes (`make -C tools faults`). A run has to end with 0 and the whole output, or with a documented exit code
and the one TXF code that says what is wrong, without a traceback, a temporary or a partial output.
"""


def read_state(path: Path) -> list[dict]:
    """Lines of a state file, [] where there is none."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def _sum(rows, key):
    return sum(row[key] for row in rows)


def _line(cells):
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _target_line(name, rows):
    mine = [row for row in rows if row["target"] == name]
    plain, checked = ([row for row in mine if row["mode"] == mode] for mode in ("plain", "checked"))
    guided = [row for row in mine if row["mode"] in ("guided", "atheris")]
    reached = [row["coverage"] for row in guided if row["coverage"] is not None]
    share = f"{reached[-1]:.1f} %" if reached else "-"
    return _line([name, f"{_sum(plain, 'executions'):,}", f"{_sum(guided, 'executions'):,}", f"{_sum(checked, 'executions'):,}",
                  f"{_sum(mine, 'seconds'):,.0f}", share, f"{TARGETS[name].floor} %", sum(len(row["findings"]) for row in mine)])


def _missed(rows):
    """Modules of the last guided run of each target, with the places that none of these runs took."""
    last = {row["target"]: row for row in rows if row["missed"] or row["coverage"] is not None}
    named: dict[str, set] = {}
    for row in last.values():
        for module in [module for module in TARGETS[row["target"]].modules if "#" not in module]:  # those of which it saw all
            mine = {place.partition(":")[2] for place in row["missed"] if place.startswith(module + ":")}
            named[module] = named[module] & mine if module in named else mine
    return {module: places for module, places in sorted(named.items()) if places}


def _mended_lines(mended: Iterable[dict]):
    yield _line(["target", "what it found", "what was done"])
    yield "|---|---|---|"
    for one in mended:
        yield _line([one["target"], one["found"], one["mended"]])


def _fault_lines(rows):
    """The table of the last sweep of each run and kind of fault."""
    last = {(row["run"], row["kind"]): row for row in rows}
    yield _line(["run", "calls and arrays that failed", "ended with 0", "with a code", "badly"])
    yield "|---|---:|---:|---:|---:|"
    for name in dict.fromkeys(run for run, _ in last):
        mine = [row for (run, _), row in last.items() if run == name]
        whole = sum(row["codes"].get("0", 0) for row in mine)
        yield _line([name, f"{_sum(mine, 'faults'):,}", f"{whole:,}", f"{_sum(mine, 'faults') - whole:,}", _sum(mine, "bad")])


def page(rows: list[dict]) -> str:
    """The page as Markdown. rows: of fuzz/run.py and of fuzz/faults.py."""
    faults, rows = [row for row in rows if "run" in row], [row for row in rows if row.get("target") in TARGETS]
    total = _sum(rows, "executions")
    heads = ["target", "plain", "guided", "checked", "seconds", "coverage", "floor", "open findings"]
    lines = [HEAD.format(made=made_on()), _line(heads),
             "|---|" + "---:|" * (len(heads) - 1), *(_target_line(name, rows) for name in TARGETS), "",
             f"{total:,} executions of {len(TARGETS)} targets in {_sum(rows, 'seconds') / 60:,.0f} minutes.", "",
             "## Faults", "", FAULTS, *_fault_lines(faults), "",
             "## What was found, and mended", "", *_mended_lines(json.loads(MENDED.read_text(encoding="utf-8"))), "",
             "## Branches that no guided run has taken", "",
             "By the line of the statement, which was never entered, or with *not* never passed by.", ""]
    for module, places in _missed(rows).items():
        numbers = sorted(places, key=lambda place: (int(place.split()[0]), place))
        lines.append(f"- `{module}`: {', '.join(numbers)}")
    return "\n".join(lines) + "\n"


def write_page(path: Path, state: Path) -> None:
    """Writes the page of a state file."""
    path.write_text(page(read_state(state)), encoding="utf-8")
