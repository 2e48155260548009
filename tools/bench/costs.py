"""Where the seconds of texf-enc and of texf-dec to GLB go, in two checkouts: the largest costs of each asset by function.

    python tools/bench/costs.py BEFORE AFTER ASSET.glb ... [--rate r03] [--most 10] [--out costs.json]
        [--page docs/reports/costs.md]

BEFORE, AFTER: folders of two checkouts (`git worktree add`), whose kernels are compiled. All threads are looked at every few
milliseconds. What a kernel or a library takes counts for the function of the package that called it; a thread that waits for
another takes nothing, one that waits for a child process does.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

WATCH = "--watch"  # the first word of a process that is watched; its package is that of PYTHONPATH
if not __package__:  # called as a file
    sys.path.pop(0)
    if sys.argv[1:2] != [WATCH]:
        sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

STEP = 0.004  # seconds between two looks
TOOLS = {"encode": "texfcodec.cli.enc", "save": "texfcodec.cli.dec"}
SIDES = "before", "after"
PACKAGE = f"{os.sep}texfcodec{os.sep}"
WAITS = {("threading.py", "wait"), ("threading.py", "_wait_for_tstate_lock"), ("threading.py", "join"), ("thread.py", "_worker"),
         ("queue.py", "get"), ("interrupts.py", "_wait")}  # where a thread does nothing, by file and function


def watch(module, words):
    """Runs a module of the command line; {"wall": seconds, "costs": {function: seconds}}."""
    import runpy

    seen, looks, over = Counter(), [0], threading.Event()

    def look():
        mine = threading.get_ident()
        while not over.wait(STEP):
            looks[0] += 1
            for thread, frame in sys._current_frames().items():
                name = None if thread == mine else place_of(frame)
                if name:
                    seen[name] += 1

    sampler = threading.Thread(target=look, daemon=True)
    sys.argv, begin = [module, *words], time.perf_counter()
    sampler.start()
    try:
        runpy.run_module(module, run_name="__main__")
    except SystemExit as end:
        if end.code:
            raise
    finally:
        over.set()
        sampler.join()
    wall = time.perf_counter() - begin
    return {"wall": wall, "costs": {name: count * wall / max(looks[0], 1) for name, count in seen.items()}}


def place_of(frame):
    """The innermost function of the package that a thread is in, as "room.file.function"; "imports" while it imports, None where
    it waits or is not in the package."""
    code = frame.f_code
    if (os.path.basename(code.co_filename), code.co_name) in WAITS:
        return None
    while frame is not None:
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        if "importlib._bootstrap" in file:
            return "imports"
        if PACKAGE in file:
            return os.path.splitext(file.rpartition(PACKAGE)[2])[0].replace(os.sep, ".") + "." + name
        frame = frame.f_back
    return None


def measure(roots, asset, rate):
    """{"encode", "save": {side: watch()}} of an asset; both sides save the stream of the second."""
    found = {"encode": {}, "save": {}}
    with tempfile.TemporaryDirectory() as folder:
        stream, mesh = Path(folder) / "made.texf", Path(folder) / "made.glb"
        words_of = {"encode": (str(asset), str(stream), "--rate", rate), "save": (str(stream), str(mesh), "--overwrite")}
        for what, words in words_of.items():
            for side, root in zip(SIDES, roots, strict=True):
                told = Path(folder) / "told.json"
                subprocess.run([sys.executable, __file__, WATCH, told, TOOLS[what], *words], check=True, cwd=root,
                               stdout=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": str(root)})
                found[what][side] = json.loads(told.read_text(encoding="utf-8"))
    return found


def page_of(found, most):
    """Markdown of {"commits": [2], "rate", "machine", "rows": {asset: measure()}}."""
    from tools.bench.result_tables import markdown_table, wrapped

    lines = ["# Where the seconds go", "",
             f"Made by bench/costs.py on {found['machine']}: commit {found['commits'][0]} before, {found['commits'][1]} after; "
             f"rate {found['rate']}, compiled kernels, one run each. Seconds of all threads together; what a kernel or a library "
             f"takes counts for the function that called it. The {most} largest costs of either side.", ""]
    for what, title in (("encode", "texf-enc"), ("save", "texf-dec to GLB")):
        lines += [f"## {title}", ""]
        for name, row in found["rows"].items():
            before, after = (row[what][side] for side in SIDES)
            largest = list(dict.fromkeys(one for side in (after, before) for one, _ in Counter(side["costs"]).most_common(most)))
            table = [[f"`{one}`", *(f"{side['costs'].get(one, 0.0):.2f}" for side in (before, after))] for one in largest]
            table.append(["all", *(f"{sum(side['costs'].values()):.1f}" for side in (before, after))])
            table.append(["by the wall clock", *(f"{side['wall']:.1f}" for side in (before, after))])
            lines += [*markdown_table([name, "s before", "s after"], table), ""]
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def main(arguments=None):
    """Command line of the tool."""
    from tools.bench.provenance import machine, state_of

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("roots", nargs=2, type=lambda text: Path(text).resolve(), metavar="FOLDER")
    parser.add_argument("assets", nargs="*", type=lambda text: Path(text).resolve())
    parser.add_argument("--rate", default="r03")
    parser.add_argument("--most", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("out/costs.json"))
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    if args.assets:
        found = {"commits": [state_of(root) for root in args.roots], "rate": args.rate, "machine": machine(), "rows": {}}
        args.out.parent.mkdir(parents=True, exist_ok=True)
        for asset in args.assets:
            found["rows"][asset.stem] = measure(args.roots, asset, args.rate)
            args.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    text = page_of(json.loads(args.out.read_text(encoding="utf-8")), args.most)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if sys.argv[1:2] == [WATCH]:
        Path(sys.argv[2]).write_text(json.dumps(watch(sys.argv[3], sys.argv[4:])), encoding="utf-8")
    else:
        main()
