"""Fuzzes every target: compiled at full speed, guided by coverage without the compiler, what was kept with indices checked.

    python tests/fuzz/run.py [--seconds 20] [--target NAME ...] [--out out/fuzz] [--state FILE.jsonl] [--page FILE.md]
                             [--mode plain|guided|checked ...] [--engine auto|own|atheris]
                             [--floors]

Each target takes so many seconds of the processor in each mode. Inputs that reach new code are kept in OUT/corpus and taken up by
the next run; findings are files in OUT/findings. --state adds a line for each run, and --page writes the table of all lines. Exit
code 7: there is a finding, or a target reaches less of its modules than its floor in floors.json says. Floors hold from
FLOOR_SECONDS on; --floors sets them anew.
"""

import argparse
import importlib.util
import json
import sys
import time
from pathlib import Path

if __package__ in (None, ""):
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from fuzz.execution import Answer, Request  # noqa: E402
from fuzz.page import read_state, write_page  # noqa: E402
from fuzz.supervision import WITHOUT_JIT, checked, confirm, is_real, supervise  # noqa: E402
from fuzz.targets import FLOORS, FLOORS_FILE, TARGETS, Target  # noqa: E402

MODES = ("plain", "guided", "checked")
FLOOR_SECONDS = 5.0  # a shorter run is not held against the floors
MARGIN = 5  # per cent of the branches, between what was reached and a floor
FAILED = 7


def engines() -> tuple[str, ...]:
    """Guides that are installed, the best first."""
    return ("atheris", "own") if importlib.util.find_spec("atheris") else ("own",)


def run_mode(target: Target, mode: str, seconds: float, seed: int, out: Path, engine: str) -> list[tuple[str, Answer]]:
    """(mode as it is called in the state, answer) of what a mode takes."""
    corpus, found = str(out / "corpus" / target.name), str(out / "findings")
    if mode == "plain":
        return [("plain", supervise(Request(target.name, "plain", seconds, seed, corpus, found)))]
    if mode == "checked":
        replayed = Request(target.name, "replay", seconds, seed, corpus, found)
        return [("checked", supervise(replayed, checked(out / "checked_kernels")))]
    answers = []
    if engine == "atheris":
        from fuzz.atheris_loop import run_atheris

        answers.append(("atheris", run_atheris(target, seconds, seed, Path(corpus), Path(found))))
        seconds = min(seconds, 1.0)  # our own loop then only counts what was reached
    return [*answers, ("guided", supervise(Request(target.name, "guided", seconds, seed, corpus, found), WITHOUT_JIT))]


def coverage(answer: Answer) -> float | None:
    """Per cent of the branches of a target's modules that were taken, None where nobody looked."""
    total = len(answer.taken) + len(answer.missed)
    return 100 * len(answer.taken) / total if total else None


def row_of(target: Target, mode: str, answer: Answer, findings: list) -> dict:
    """A line of the state."""
    reached = coverage(answer)
    return {"target": target.name, "mode": mode, "executions": answer.executions, "seconds": round(answer.seconds, 1),
            "outcomes": answer.outcomes, "coverage": reached and round(reached, 1), "missed": answer.missed, "kept": answer.kept,
            "findings": findings}


def fuzz(target: Target, arguments: argparse.Namespace, seed: int) -> tuple[list[dict], list[str]]:
    """(lines of the state, one sentence for each fault) of one target."""
    rows, faults = [], []
    for mode in arguments.mode:
        for name, answer in run_mode(target, mode, arguments.seconds, seed, arguments.out, arguments.engine):
            findings = [confirm(one, arguments.out / "findings", arguments.out / "checked_kernels") for one in answer.findings]
            findings = [one for one in findings if is_real(one)]
            rows.append(row_of(target, name, answer, findings))
            faults += [f"{target.name}: {one['kind']} {one['place']}, {one['file']}" for one in findings]
            reached = rows[-1]["coverage"]
            if reached is not None and arguments.seconds >= FLOOR_SECONDS and reached < target.floor:
                faults.append(f"{target.name}: reaches {reached} % of branches, less than its floor of {target.floor} %")
            told = "" if reached is None else f", {reached} % of branches, floor {target.floor} %"
            print(f"{target.name} {name}: {answer.executions} executions in {answer.seconds:.0f} s{told}, "
                  f"{len(findings)} findings", flush=True)
    return rows, faults


def write_floors(state: Path) -> None:
    """Sets the floor of every target that the state tells of to MARGIN points under what its last guided run reached."""
    reached = {row["target"]: row["coverage"] for row in read_state(state) if row["coverage"] is not None}
    floors = {name: int(reached[name]) - MARGIN if name in reached else FLOORS[name] for name in TARGETS}
    FLOORS_FILE.write_text(json.dumps(floors, indent=1) + "\n", encoding="utf-8")


def parse(words: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of the processor, for each target in each mode")
    parser.add_argument("--target", action="append", choices=list(TARGETS), help="only this one; may be repeated")
    parser.add_argument("--mode", action="append", choices=MODES, help="only this one; may be repeated")
    parser.add_argument("--engine", choices=("auto", "own", "atheris"), default="auto", help="what guides")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--state", type=Path, help="default: state.jsonl in OUT")
    parser.add_argument("--page", type=Path, help="write this page from the state; with --seconds 0 nothing runs before")
    parser.add_argument("--floors", action="store_true", help="set the floors by the state; with --seconds 0 nothing runs before")
    parser.add_argument("--seed", type=int, help="default: another one each time")
    arguments = parser.parse_args(words)
    arguments.mode, arguments.target = arguments.mode or list(MODES), arguments.target or list(TARGETS)
    arguments.state = arguments.state or arguments.out / "state.jsonl"
    arguments.engine = engines()[0] if arguments.engine == "auto" else arguments.engine
    return arguments


def main(words: list[str] | None = None) -> int:
    """The command line: 0, or FAILED."""
    arguments, faults = parse(words), []
    arguments.state.parent.mkdir(parents=True, exist_ok=True)
    for name in arguments.target if arguments.seconds > 0 else ():
        seed = arguments.seed if arguments.seed is not None else int(time.time())
        rows, found = fuzz(TARGETS[name], arguments, seed)
        faults += found
        with open(arguments.state, "a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
    if arguments.floors:
        write_floors(arguments.state)
    if arguments.page:
        write_page(arguments.page, arguments.state)
    print(*(faults or ["no findings"]), sep="\n")
    return FAILED if faults else 0


if __name__ == "__main__":
    sys.exit(main())
