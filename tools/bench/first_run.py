"""What a first run compiles: the kernels of texf-enc and of texf-dec to a GLB with an empty cache, and the seconds of each.

    python tools/bench/first_run.py MESH.glb [--page docs/reports/first_run.md] [--most 24]

One thread and one process each, so that all of it is seen; usually two processes share it. The seconds of a kernel are its own,
without those of kernels that it calls.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tools.bench.provenance import machine, state_of
from tools.bench.result_tables import markdown_table, wrapped

ROOT = Path(__file__).resolve().parents[2]
SHORT = 0.005  # seconds below which a kernel was read from the cache or is not worth a row


def watch(module, words):
    """Runs a module of texfcodec's command line and returns {"wall": seconds, "kernels": {name: seconds of its own}}."""
    import runpy

    from numba.core import compiler

    spent, inner, usual = Counter(), [0.0], compiler.compile_extra

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
    sys.argv, begin = [module, *words], time.perf_counter()
    try:
        runpy.run_module(module, run_name="__main__")
    except SystemExit as end:
        if end.code:
            raise
    return {"wall": time.perf_counter() - begin, "kernels": dict(spent)}


def first_runs(mesh):
    """{"texf-enc", "texf-dec": of watch(), with an empty cache each} of an asset and its stream."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        stream, out, told = (str(Path(name) / leaf) for leaf in ("made.texf", "made.glb", "told.json"))
        for tool, module, words in (("texf-enc", "texfcodec.cli.enc", (str(mesh), stream, "--threads", "1", "--quiet")),
                                    ("texf-dec", "texfcodec.cli.dec", (stream, out, "--threads", "1", "--quiet", "--engine",
                                                                       "numba"))):
            cache = Path(name) / tool
            subprocess.run([sys.executable, str(Path(__file__).resolve()), "--watch", told, module, *words], check=True,
                           env=os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)})
            found[tool] = json.loads(Path(told).read_text(encoding="utf-8"))
            found[tool]["files"] = sum(1 for _ in cache.rglob("*.nbc"))
    return found


def page_of(found, mesh, commit, most):
    """Markdown of first_runs()."""
    kernels = {tool: {n.removeprefix("texfcodec."): s for n, s in row["kernels"].items()} for tool, row in found.items()}
    lines = ["# What a first run compiles", "",
             f"Made by bench/first_run.py on {machine()}, commit {commit}, with {Path(mesh).name}: one process of one thread "
             "with an empty cache. Seconds are each kernel's own, without the kernels that it calls. Usually a second process "
             "shares the work, and a first decode without a GLB goes through the WebAssembly decoder, which compiles no "
             "kernels.", ""]
    lines += markdown_table(["tool", "seconds in all", "compiling", "kernels", "files in the cache"],
                            [[tool, f"{row['wall']:.1f}", f"{sum(row['kernels'].values()):.1f}", str(len(row["kernels"])),
                              str(row["files"])] for tool, row in found.items()])
    rooms = {tool: Counter() for tool in kernels}
    for tool, own in kernels.items():
        for name, seconds in own.items():
            rooms[tool][".".join(name.split(".")[:2 if name.startswith("numba") else -2]) or name] += seconds
    for title, tables, count in (("By room", rooms, None), ("The longest", kernels, most)):
        names = sorted({n for t in tables.values() for n in t}, key=lambda n: -max(t.get(n, 0) for t in tables.values()))
        lines += ["", f"## {title}", ""]
        lines += markdown_table(["kernels of" if count is None else "kernel", *tables],
                                [[n, *(f"{t.get(n, 0):.2f}" if t.get(n, 0) > SHORT else "" for t in tables.values())]
                                 for n in names[:count] if max(t.get(n, 0) for t in tables.values()) > SHORT])
    return "\n".join(wrapped(lines)).rstrip() + "\n"


def main(arguments=None):
    """Command line of the tool."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=lambda text: Path(text).resolve())
    parser.add_argument("--page", type=Path, metavar="FILE.md")
    parser.add_argument("--most", type=int, default=24, metavar="N", help="rows of the longest")
    args = parser.parse_args(arguments)
    text = page_of(first_runs(args.mesh), args.mesh, state_of(ROOT), args.most)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--watch"]:
        out, watched, *rest = sys.argv[2:]
        Path(out).write_text(json.dumps(watch(watched, rest)), encoding="utf-8")
    else:
        main()
