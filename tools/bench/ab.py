"""Two checkouts side by side, in turns, because the speed of a machine wanders by more than what a change gains.

    python tools/bench/ab.py pairs BEFORE AFTER ASSET.glb ... [--rate r03]
    python tools/bench/ab.py costs BEFORE AFTER ASSET.glb ... [--rate r03]
    python tools/bench/ab.py compiled CHECKOUT ASSET.glb                       docs/reports/first_run.md
    python tools/bench/ab.py speed BEFORE AFTER [--rounds 3] [--only EXPRESSION]

BEFORE, AFTER, CHECKOUT: a folder (`git worktree add`), or a commit of this repository, which is checked out for the run. All are
run by the Python that runs this.

pairs: seconds, memory and bytes of texf-enc and of texf-dec to GLB, whole processes with compiled kernels. costs: where these
seconds go, by function of the package: all threads are sampled every few milliseconds; what a kernel or a library takes counts
for the function that called it; a thread that waits for another takes nothing. compiled: the kernels of a first run, with an
empty cache, and the seconds of each without those that it calls. speed: tools/bench/test_speed.py of both, a round each in turn,
compared by pytest-benchmark. --out keeps what was measured as JSON; without assets the page is made of it. --page writes it.
"""

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack, contextmanager
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
WATCH = "--watch"  # the first word of a process that is watched; its package is that of PYTHONPATH
if not __package__:  # called as a file
    sys.path.pop(0)
    if sys.argv[1:2] != [WATCH]:
        sys.path.insert(0, str(REPOSITORY))

SIDES = "before", "after"
TOOLS = {"encode": "texfcodec.cli.enc", "save": "texfcodec.cli.dec"}
STEP = 0.004  # seconds between two samples
MOST_COSTS, MOST_KERNELS, SHORT = 10, 24, 0.005  # rows of a table; seconds of a kernel that was read from the cache
PACKAGE = f"{os.sep}texfcodec{os.sep}"
WAITS = {("threading.py", "wait"), ("threading.py", "_wait_for_tstate_lock"), ("threading.py", "join"), ("thread.py", "_worker"),
         ("queue.py", "get"), ("interrupts.py", "_wait")}  # where a thread does nothing, by file and function
SPEED = ("-m", "pytest", "-q", "tools/bench/test_speed.py", "-p", "no:cacheprovider", "--benchmark-only",
         "--benchmark-timer=time.process_time")


@contextmanager
def checked_out(name, repository=REPOSITORY):
    """Context manager: the folder of a checkout. name: that folder, or a commit, which is checked out while the block runs."""
    if Path(name).is_dir():
        yield Path(name).resolve()
        return
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "checkout"
        subprocess.run(["git", "-C", repository, "worktree", "add", "--quiet", "--detach", root, name], check=True)
        try:
            yield root
        finally:
            subprocess.run(["git", "-C", repository, "worktree", "remove", "--force", root], check=True)


def timed(words, root, cache=None):
    """Run Python with the package of a checkout; return {"wall", "processor": seconds, "memory": peak bytes}. words: arguments
    of Python; root: the checkout; cache: folder for compiled kernels. Raises CalledProcessError if it fails."""
    variables = os.environ | {"PYTHONPATH": str(root)} | ({"NUMBA_CACHE_DIR": str(cache)} if cache else {})
    begin = time.monotonic()
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, env=variables, cwd=root)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words)
    return {"wall": time.monotonic() - begin, "processor": used.ru_utime + used.ru_stime, "memory": 1024 * used.ru_maxrss}


def watched(kind, root, words, cache=None):
    """Run watch() in a process with the package of a checkout and return its result; words: a module and its arguments."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        timed([__file__, WATCH, kind, str(answer), *words], root, cache)
        return json.loads(answer.read_text(encoding="utf-8"))


# In the process that is watched.


def watch(kind, module, words):
    """Run a module of the command line here; return {"wall": seconds, kind: {name: seconds}}. kind: "costs" samples the time of
    each function, "compiled" counts the compilation of each kernel; words: arguments."""
    import runpy

    spent, over, samples = Counter(), threading.Event(), [0]

    def sample():
        while not over.wait(STEP):
            samples[0] += 1
            spent.update(filter(None, (place_of(frame) for thread, frame in sys._current_frames().items()
                                       if thread != threading.get_ident())))

    sampler = threading.Thread(target=sample, daemon=True)
    sys.argv, begin = [module, *words], time.perf_counter()
    sampler.start() if kind == "costs" else count_compiled(spent)
    try:
        runpy.run_module(module, run_name="__main__")
    except SystemExit as end:
        if end.code:
            raise
    over.set()
    wall = time.perf_counter() - begin
    factor = wall / max(samples[0], 1) if kind == "costs" else 1
    return {"wall": wall, kind: {name: seconds * factor for name, seconds in spent.items()}}


def place_of(frame):
    """Return the package's innermost function that a thread is in as "room.file.function"; "imports" during an import, None if
    the thread waits or is elsewhere. frame: the thread's innermost."""
    if (os.path.basename(frame.f_code.co_filename), frame.f_code.co_name) in WAITS:
        return None
    while frame is not None:
        file = frame.f_code.co_filename
        if "importlib._bootstrap" in file:
            return "imports"
        if PACKAGE in file:
            return f"{os.path.splitext(file.rpartition(PACKAGE)[2])[0].replace(os.sep, '.')}.{frame.f_code.co_name}"
        frame = frame.f_back
    return None


def count_compiled(spent):
    """Make Numba add the seconds that it takes for each kernel, without kernels within, to spent, a Counter."""
    from numba.core import compiler

    inner, usual = [0.0], compiler.compile_extra

    def compile_extra(typingctx, targetctx, func, *arguments, **options):
        begin = time.perf_counter()
        inner.append(0.0)
        try:
            return usual(typingctx, targetctx, func, *arguments, **options)
        finally:
            seconds = time.perf_counter() - begin
            spent[f"{func.__module__}.{func.__name__}"] += seconds - inner.pop()
            inner[-1] += seconds

    compiler.compile_extra = compile_extra


# What is measured.


def words_of(asset, stream, mesh, rate):
    """Return {"encode": [...], "save": [...]}, the arguments of texf-enc and texf-dec for paths and a rate such as "r04"."""
    return {"encode": [str(asset), str(stream), "--rate", rate], "save": [str(stream), str(mesh), "--overwrite"]}


def measure(kind, roots, asset, rate):
    """Encode an asset and save it as GLB on both sides; return {"encode", "save": {side: row}}: rows of timed() with "bytes" and
    "sha256" of the file, for kind "costs" those of watched(). roots: the checkouts. Both save the second's stream."""
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        files = {"encode": Path(folder) / "out.texf", "save": Path(folder) / "out.glb"}
        for what, words in words_of(asset, *files.values(), rate).items():
            runs[what] = {}
            for side, root in zip(SIDES, roots, strict=True):
                if kind == "costs":
                    runs[what][side] = watched(kind, root, [TOOLS[what], *words])
                else:
                    runs[what][side] = timed(["-m", TOOLS[what], *words], root) | _content(files[what])
    return runs


def _content(path):
    return {"bytes": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def first_runs(root, asset):
    """Encode and decode an asset with empty kernel caches; return {"texf-enc", "texf-dec": watched() with "files", their number
    in the cache}. Each has one process of one thread, so that all is seen; usually two processes share the work."""
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        words = words_of(asset, Path(folder) / "out.texf", Path(folder) / "out.glb", "r04")
        words["save"] += ["--engine", "numba"]
        for tool, what in (("texf-enc", "encode"), ("texf-dec", "save")):
            cache = Path(folder) / tool
            runs[tool] = watched("compiled", root, [TOOLS[what], *words[what], "--threads", "1", "--quiet"], cache)
            runs[tool]["files"] = sum(1 for _ in cache.rglob("*.nbc"))
    return runs


def speed(roots, rounds, only):
    """Run the benchmarks of test_speed.py in two checkouts in turn and print the comparison. roots: the checkouts; rounds: that
    count, after a first one that compiles; only: pytest's -k, or None."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds + 1):
            for side, root in zip(SIDES, roots, strict=True):
                store = [f"--benchmark-storage={folder}", f"--benchmark-save={side}"] if number else []
                subprocess.run([sys.executable, *SPEED, *store, *(["-k", only] if only else [])], cwd=root, check=True,
                               env=os.environ | {"PYTHONPATH": str(root)}, stdout=sys.stderr)
        subprocess.run([sys.executable, "-m", "pytest_benchmark", f"--storage={folder}", "compare", "--group-by=name",
                        "--sort=name", "--columns=min,median,rounds"], check=True)


# Pages.


def page_of(kind, report):
    """Return the Markdown page of a report: {"commits": of the sides, "machine", "rate", "rows": {asset: measured}}. kind:
    "pairs", "costs" or "compiled"."""
    from tools.bench.result_tables import wrapped

    lines = {"pairs": pairs_lines, "costs": costs_lines, "compiled": compiled_lines}[kind](report)
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def _origin(kind, report):
    commits = " before, ".join(report["commits"]) + (" after" if len(report["commits"]) > 1 else "")
    return f"Made by `tools/bench/ab.py {kind}` on {report['machine']}: commit {commits}"


def pairs_lines(report):
    """Return the page that compares seconds, memory and bytes of two sides, as lines, an asset a row. report: see page_of()."""
    from tools.bench.result_tables import markdown_table

    table, ratios = [], {}
    for name, row in report["rows"].items():
        cells = []
        for what in TOOLS:
            before, after = (row[what][side] for side in SIDES)
            for clock in ("wall", "processor"):
                ratios.setdefault((what, clock), []).append(after[clock] / before[clock])
                cells.append(f"{before[clock]:.1f}, {after[clock]:.1f}")
            cells.append("the same" if before["sha256"] == after["sha256"] else f"{after['bytes'] - before['bytes']:+,} bytes")
        last = row["encode"]["after"]
        table.append([name, f"{last['bytes']:,}", last["sha256"][:12], *cells, f"{last['processor'] / last['wall']:.2f}",
                      f"{last['memory'] / (1 << 20):,.0f}"])
    middle = {key: f"{100 * statistics.median(values):.0f} %" for key, values in ratios.items()}
    return ["# Two states side by side", "", f"{_origin('pairs', report)}; rate {report['rate']}, whole processes with compiled "
            "kernels, each asset by both in turn. Seconds are before, after; both save the same stream as GLB. Cores: processor "
            "seconds over those by the wall clock, of the encode after.", "",
            f"In the median an encode takes {middle['encode', 'wall']} of the time by the wall clock and "
            f"{middle['encode', 'processor']} of the processor's, a decode to GLB {middle['save', 'wall']} and "
            f"{middle['save', 'processor']}.", "",
            *markdown_table(["asset", "stream, bytes", "SHA-256", "encode, wall s", "processor s", "stream", "to GLB, wall s",
                             "processor s", "GLB", "cores", "MB, encode"], table)]


def costs_lines(report):
    """Return the page with the largest costs of either side, as lines, a table per asset and tool. report: see page_of()."""
    from tools.bench.result_tables import markdown_table

    lines = ["# Where the seconds go", "", f"{_origin('costs', report)}; rate {report['rate']}, compiled kernels, one run each. "
             "Seconds of all threads together; what a kernel or a library takes counts for the function that called it. The "
             f"{MOST_COSTS} largest costs of either side.", ""]
    for what, title in (("encode", "texf-enc"), ("save", "texf-dec to GLB")):
        lines += [f"## {title}", ""]
        for name, row in report["rows"].items():
            sides = [row[what][side] for side in SIDES]
            kernels = (kernel for side in sides[::-1] for kernel, _ in Counter(side["costs"]).most_common(MOST_COSTS))
            largest = dict.fromkeys(kernels)
            table = [[f"`{kernel}`", *(f"{side['costs'].get(kernel, 0.0):.2f}" for side in sides)] for kernel in largest]
            table += [["all", *(f"{sum(side['costs'].values()):.1f}" for side in sides)],
                      ["by the wall clock", *(f"{side['wall']:.1f}" for side in sides)]]
            lines += [*markdown_table([name, "s before", "s after"], table), ""]
    return lines


def compiled_lines(report):
    """Return the page on what a first run compiles, as lines: in all, by room, the longest. report: see page_of()."""
    from tools.bench.result_tables import markdown_table

    (asset, row), = report["rows"].items()
    kernels = {tool: Counter({n.removeprefix("texfcodec."): s for n, s in run["compiled"].items()}) for tool, run in row.items()}
    rooms = {tool: Counter() for tool in kernels}
    for tool, own in kernels.items():
        for name, seconds in own.items():
            rooms[tool][".".join(name.split(".")[:2 if name.startswith("numba") else -2]) or name] += seconds
    lines = ["# What a first run compiles", "", f"{_origin('compiled', report)}, with {asset}: one process of one thread with an "
             "empty cache. Seconds are each kernel's own, without the kernels that it calls. Usually a second process shares the "
             "work, and a first decode without a GLB goes through the WebAssembly decoder, which compiles no kernels.", "",
             *markdown_table(["tool", "seconds in all", "compiling", "kernels", "files in the cache"],
                             [[tool, f"{run['wall']:.1f}", f"{sum(kernels[tool].values()):.1f}", len(kernels[tool]), run["files"]]
                              for tool, run in row.items()])]
    for title, head, tables, most in (("By room", "kernels of", rooms, None), ("The longest", "kernel", kernels, MOST_KERNELS)):
        names = sorted(set().union(*tables.values()), key=lambda n: -max(table[n] for table in tables.values()))
        lines += ["", f"## {title}", "",
                  *markdown_table([head, *tables], [[n, *(f"{t[n]:.2f}" if t[n] > SHORT else "" for t in tables.values())]
                                                    for n in names[:most] if max(t[n] for t in tables.values()) > SHORT])]
    return lines


def run(args):
    """Measure what the parsed arguments request, unless they name no assets, and print and write the page."""
    from tools.bench.provenance import machine, state_of

    sides = 1 if args.kind == "compiled" else 2
    names, assets = args.words[:sides], [Path(word).resolve() for word in args.words[sides:]]
    if args.kind == "speed" or assets:
        with ExitStack() as stack:
            roots = [stack.enter_context(checked_out(name)) for name in names]
            if args.kind == "speed":
                return speed(roots, args.rounds, args.only)
            report = {"commits": [state_of(root) for root in roots], "rate": args.rate, "machine": machine(), "rows": {}}
            args.out.parent.mkdir(parents=True, exist_ok=True)
            if args.kind == "pairs":  # kernels are compiled before anything counts
                measure(args.kind, roots, assets[0], args.rate)
            for asset in assets:
                report["rows"][asset.stem] = (first_runs(roots[0], asset) if args.kind == "compiled"
                                              else measure(args.kind, roots, asset, args.rate))
                args.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    text = page_of(args.kind, json.loads(args.out.read_text(encoding="utf-8")))
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return None


def main(arguments=None):
    """Run the tool. arguments: the words of its command line, sys.argv by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("pairs", "costs", "compiled", "speed"))
    parser.add_argument("words", nargs="*", metavar="CHECKOUT ... ASSET", help="the checkouts, then assets")
    parser.add_argument("--rate", default="r03")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="of speed; one more compiles first")
    parser.add_argument("--only", metavar="EXPRESSION", help="benchmarks of speed, as pytest -k takes them")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="default: out/KIND.json")
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    args.out = args.out or Path(f"out/{args.kind}.json")
    run(args)


if __name__ == "__main__":
    if sys.argv[1:2] == [WATCH]:
        Path(sys.argv[3]).write_text(json.dumps(watch(sys.argv[2], sys.argv[4], sys.argv[5:])), encoding="utf-8")
    else:
        main()
