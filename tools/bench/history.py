"""What `make bench` measured, run after run: a line of JSON a run, and two of them side by side.

python tools/bench/history.py FILE.jsonl [--append BENCHMARK.json] [--compare] [--before COMMIT] [--page FILE.md]

--append: the JSON of pytest-benchmark (--benchmark-json) becomes a line, with the processor seconds of whole processes beside
it. --compare: the last line against the one before it on the same machine, or against that of a commit, as a Markdown table; exit
code 1 where a benchmark is slower in both its fastest run and its median. --page: the history as a page, with a plot where
matplotlib is there.
"""

import argparse
import json
import platform
import statistics
import sys
import tempfile
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.plots import load_pyplot
from tools.bench.processes import timed
from tools.bench.result_tables import markdown_table, wrapped

SLOWER = 0.10  # from which on a benchmark is slower: of the fastest run and of the median, because either alone is noisy
SHOWN, DRAWN = 8, 6  # last runs on the page; benchmarks of the plot, the longest
PROCESS_RUNS = 3
PROCESSES = {"process: texf-enc": ("texfcodec.cli.enc", "{folder}/sample.glb", "{folder}/sample.texf", "--quiet"),
             "process: texf-dec": ("texfcodec.cli.dec", "{folder}/sample.texf", "{folder}/out.glb", "--quiet")}


def run_of(found, processes):
    """A line of the history, as a dict. found: the JSON of pytest-benchmark; processes: of process_rows().

    "rows" holds {"min", "median", "rounds"} by the benchmark's name, in seconds of the processor, which other work on the machine
    disturbs least."""
    machine, commit = found["machine_info"], found["commit_info"]
    rows = {row["name"]: {key: row["stats"][key] for key in ("min", "median", "rounds")} for row in found["benchmarks"]}
    return {"commit": commit["id"], "dirty": commit["dirty"], "date": found["datetime"],
            "processor": machine["cpu"].get("brand_raw") or platform.processor() or machine["machine"],
            "cores": machine["cpu"].get("count"), "python": machine["python_version"], "rows": rows | processes}


def process_rows():
    """Rows of texf-enc and texf-dec on the demo asset, each in a process of its own, in seconds of the processor."""
    from texfcodec.demo.asset import write_sample

    with tempfile.TemporaryDirectory() as folder:
        write_sample(Path(folder) / "sample.glb")
        return {name: _spread([timed([word.format(folder=folder) for word in words])["processor"] for _ in range(PROCESS_RUNS)])
                for name, words in PROCESSES.items()}


def _spread(seconds):
    return {"min": min(seconds), "median": statistics.median(seconds), "rounds": len(seconds)}


def read_runs(path):
    """The lines of a history, oldest first; none where there is no file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def is_same_machine(run, other):
    """Whether the seconds of two runs may be compared."""
    return all(run[key] == other[key] for key in ("processor", "cores", "python"))


def run_before(runs, commit=None):
    """What the last run is compared with: the last before it on the same machine, of a commit where one is named by its first
    digits; None where there is none."""
    suited = [run for run in runs[:-1] if is_same_machine(run, runs[-1]) and run["commit"].startswith(commit or "")]
    return suited[-1] if suited else None


def compared(before, after):
    """[(name, before, after, ratio of the fastest, ratio of the median, whether it is slower)] of rows that both runs have."""
    out = []
    for name, row in after["rows"].items():
        if name in before["rows"]:
            old = before["rows"][name]
            fastest, median = (row[key] / old[key] for key in ("min", "median"))
            out.append((name, old, row, fastest, median, min(fastest, median) > 1 + SLOWER))
    return out


def comparison_lines(before, after):
    """The Markdown of compared()."""
    yield f"{name_of(after)} against {name_of(before)}"
    yield ""
    rows = [[name, _seconds(old["min"]), _seconds(row["min"]), f"{fastest:.2f}", f"{median:.2f}", "**slower**" if slower else ""]
            for name, old, row, fastest, median, slower in compared(before, after)]
    yield from markdown_table(["benchmark", "before, s", "after, s", "ratio of the fastest", "ratio of the median", ""], rows)


def name_of(run):
    """A run in words."""
    return f"{run['commit'][:8]}{' (changed)' if run['dirty'] else ''} of {run['date'][:16].replace('T', ' ')}"


def _seconds(value):
    return f"{value:.3g}"


def page_of(runs, picture=None):
    """docs/reports/bench.md: the last runs on the machine of the last one. picture: name of the plot beside the page, or None."""
    last = runs[-1]
    shown = [run for run in runs if is_same_machine(run, last)][-SHOWN:]
    lines = ["# Seconds, run after run", "",
             f"Made by `make bench PAGE=docs/reports/bench.md` (tools/bench/history.py) on {last['cores']} cores of "
             f"{last['processor']}, Python {last['python']}: the fastest run of each benchmark in seconds of the processor: what "
             "tools/bench/test_speed.py calls on the demo asset (in brackets: threads), and processes with compiled kernels. "
             f"A run is slower where the fastest and the median both are, by more than {SLOWER:.0%}.", ""]
    if picture:
        lines += [f"![seconds of the last runs]({picture})", ""]
    heads = [f"{run['commit'][:8]}{'*' * run['dirty']} {run['date'][:10]}" for run in shown]
    rows = [[name, *(_seconds(run["rows"][name]["min"]) if name in run["rows"] else "" for run in shown)]
            for name in last["rows"]]
    lines += [*markdown_table(["benchmark", *heads], rows), ""]
    if any(run["dirty"] for run in shown):
        lines += ["\\* with changes that the commit does not have.", ""]
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def draw(runs, path):
    """Draws the longest benchmarks over the runs on the machine of the last one; whether matplotlib is there to do so."""
    pyplot = load_pyplot()
    if pyplot is None:
        return False
    shown = [run for run in runs if is_same_machine(run, runs[-1])][-SHOWN:]
    names = sorted(runs[-1]["rows"], key=lambda name: -runs[-1]["rows"][name]["min"])[:DRAWN]
    figure, panel = pyplot.subplots(figsize=(8, 4))
    for name in names:
        at = [i for i, run in enumerate(shown) if name in run["rows"]]
        panel.plot(at, [shown[i]["rows"][name]["min"] for i in at], marker="o", label=name)
    panel.set_xticks(range(len(shown)), [run["commit"][:8] for run in shown], rotation=30)
    panel.set_ylim(bottom=0)
    panel.set_ylabel("seconds, the fastest run")
    panel.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
    return True


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("history", type=Path, metavar="FILE.jsonl")
    parser.add_argument("--append", type=Path, metavar="BENCHMARK.json", help="of pytest-benchmark")
    parser.add_argument("--compare", action="store_true", help="the last run with the one before it")
    parser.add_argument("--before", metavar="COMMIT", help="compare with the last run of this commit")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    if args.append:
        append(args.history, run_of(json.loads(args.append.read_text(encoding="utf-8")), process_rows()))
    runs = read_runs(args.history)
    if not runs:
        parser.error(f"{args.history} has no runs")
    if args.page:
        picture = args.page.with_suffix(".svg")
        args.page.write_text(page_of(runs, picture.name if draw(runs, picture) else None), encoding="utf-8")
    return compare(runs, args.before) if args.compare or args.before else 0


def append(path, run):
    """Writes one more line to a history."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a", encoding="utf-8") as file:
        file.write(json.dumps(run, sort_keys=True) + "\n")


def compare(runs, commit=None):
    """Prints the last run against the one before it, or that of a commit; the exit code."""
    before = run_before(runs, commit)
    if before is None:
        print(f"nothing to compare {name_of(runs[-1])} with: no earlier run" + (f" of {commit}" if commit else "") +
              " on this machine")
        return 0
    print("\n".join(comparison_lines(before, runs[-1])))
    return int(any(slower for *_, slower in compared(before, runs[-1])))


if __name__ == "__main__":
    sys.exit(main())
