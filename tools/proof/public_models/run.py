"""One model after the other, or some at a time: texf-enc, texf-dec, validator and comparison, each in a process of its own."""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path

from texfcodec.batch.children import WARM_UP, Caps, Children, Overdue
from texfcodec.batch.local import terminated_as_interrupted
from texfcodec.batch.task_progress import progress
from texfcodec.batch.tasks import last_line, package_code
from texfcodec.errors import EXIT_INTERNAL
from tools.proof.public_models.judge import findings_of, reason_of
from tools.proof.public_models.measure import measured
from tools.proof.public_models.rows import add_row, read_rows, strict_json

RATE = "r03"
MEASURE = Path(__file__).with_name("measure.py")
VALIDATOR = Path(__file__).parents[1] / "validate_glb.mjs"
NODE_PACKAGES = {"gltf-validator": "2.0.0-dev.3.10", "three": "0.187.0", "playwright-core": "1.56.1"}


def run_all(entries, args, rows_file):
    """Code, decode and measure models in child processes; append the row of each to rows_file as it ends."""
    old = {(row["name"], row["sha256"]) for row in read_rows(rows_file)} if args.keep_old else set()
    todo = [entry for entry in entries if (entry.name, entry.model["sha256"]) not in old]
    modules, lock, children, out = node_modules(args.cache), threading.Lock(), Children(), args.cache / "coded" / rows_file.stem
    with open(os.devnull, "wb") as nowhere:
        children.run(WARM_UP, nowhere, nowhere, Caps(1))
    jobs = 1 if args.inside else max(args.jobs, 1)  # standard output is one for a process
    with progress(len(todo)) as show, ThreadPoolExecutor(jobs) as pool, terminated_as_interrupted():

        def perform(entry):
            room_in = Inside if args.inside else lambda folder: Room(folder, args, children)
            row = code_model(entry, args, modules, out, room_in)
            if children.stopped:
                return
            with lock:
                add_row(rows_file, row)
                show(entry.name, f"{entry.name}: {_line(row)}", bool(row["findings"]))

        try:
            for _ in pool.map(perform, todo):
                pass
        except BaseException:
            children.stop()
            raise


def node_modules(cache):
    """Return the folder below which node finds the glTF validator and three.js, installed by npm; None if that fails."""
    folder = cache / "node"
    if not all((folder / "node_modules" / name).is_dir() for name in NODE_PACKAGES):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text('{"private": true}', encoding="utf-8")
        wanted = [f"{name}@{version}" for name, version in NODE_PACKAGES.items()]
        words = ["npm", "install", "--silent", "--ignore-scripts", "--no-audit", "--no-fund", *wanted]
        if not shutil.which("npm") or subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL).returncode:
            print("npm could not install the validator: nothing is validated or drawn", file=sys.stderr)
            return None
    return folder


def code_model(entry, args, modules, out, room_in):
    """Encode, decode, validate and measure a model; return its row. out: folder for streams and meshes; room_in(folder): gives
    the Room, or a substitute, that runs the steps."""
    out = out / entry.package["name"].replace("/", "__")
    out.mkdir(parents=True, exist_ok=True)
    stem = re.sub(r"[^\w.-]", "_", entry.model["path"])
    source, stream, mesh = entry.path(args.cache), out / f"{stem}.texf", out / f"{stem}.glb"
    for path in (stream, mesh):
        path.unlink(missing_ok=True)
    row = {"name": entry.name, "source": str(source.relative_to(args.cache)), "sha256": entry.model["sha256"],
           "stream": str(stream.relative_to(args.cache)), "mesh": str(mesh.relative_to(args.cache)), "code": package_code(),
           "flags": _flags(args)}
    room = room_in(out / f"{stem}.work")
    try:
        _steps(row, room, (source, stream, mesh), _flags(args), modules)
    finally:
        shutil.rmtree(room.folder, ignore_errors=True)
    return row | {"findings": findings_of(row)}


def _flags(args):
    return ["--rate", args.rate, *(["--effort", args.effort] if getattr(args, "effort", None) else [])]


def _steps(row, room, paths, flags, modules):
    source, stream, mesh = map(str, paths)
    row["encode"] = room.tool("enc", source, stream, *flags, "--threads", "1", "--json")
    if not paths[1].exists():  # an internal error may come after the stream was written: that is measured all the same
        return
    row["decode"] = room.tool("dec", stream, mesh, "--threads", "1", "--json")
    if row["decode"]["exit"] != 0 or not paths[2].exists():
        return
    row["bytes"] = {"stream": paths[1].stat().st_size, "mesh": paths[2].stat().st_size,
                    "source": row["encode"]["report"].get("source", {}).get("bytes", paths[0].stat().st_size)}
    row["validator"] = _validated(paths[2], modules)
    row["measure"] = room.run([str(MEASURE), source, mesh], {})


def _answer(begin, code, text, log, default):
    """{"exit", "seconds", "report", "json", "log"} of a step. report: the JSON object of its stdout; json: "" or why it has
    none; log: its last words, where it failed. exit: None where it took too long, negative where a signal ended it."""
    report = strict_json(text)
    is_read = isinstance(report, dict)
    return {"exit": code, "seconds": round(time.monotonic() - begin, 2), "report": report if is_read else default,
            "json": "" if is_read else report, "log": log if code != 0 else ""}


class Room:
    """A folder for the output of child processes, and their limits of time and memory."""

    def __init__(self, folder, args, children):
        self.folder, self.children, self.seconds, self.memory = folder, children, args.seconds, args.memory
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)

    def tool(self, name, *words):
        return self.run(["-m", f"texfcodec.cli.{name}", *words], {"warnings": [], "dropped": [], "remarks": []})

    def run(self, words, default):
        out, log, begin = self.folder / "out", self.folder / "log", time.monotonic()
        with open(out, "wb") as to, open(log, "wb") as to_log:
            try:
                code = self.children.run(words, to, to_log, Caps(1, self.memory, begin + self.seconds))
            except Overdue:
                code = None
        return _answer(begin, code, out.read_text(encoding="utf-8", errors="replace"), last_line(log), default)


class Inside:
    """A Room whose steps run in this process, without caps: for files of our own, where most of the time would be starts."""

    def __init__(self, folder):
        self.folder = folder

    def tool(self, name, *words):
        out, log, begin, code = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO(), time.monotonic(), EXIT_INTERNAL
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(log):
            try:
                import_module(f"texfcodec.cli.{name}").main(list(words))
            except SystemExit as ended:
                code = ended.code or 0
        out.seek(0)
        return _answer(begin, code, out.read(), log.getvalue()[-200:], {})

    def run(self, words, default):
        return {"exit": 0, "seconds": 0.0, "report": measured(*words[1:]), "json": "", "log": ""}


def _validated(mesh, modules):
    """{"errors", "warnings", "messages"} by the Khronos validator, or None where it is not here."""
    if modules is None or not shutil.which("node"):
        return None
    done = subprocess.run(["node", VALIDATOR, mesh.resolve()], cwd=modules, capture_output=True, text=True, timeout=300)
    counts = re.search(r": (\d+) errors, (\d+) warnings", done.stdout)
    if counts is None:
        return {"errors": 1, "warnings": 0, "messages": [(done.stderr or "no answer")[:300]]}
    return {"errors": int(counts[1]), "warnings": int(counts[2]), "messages": done.stdout.splitlines()[1:6]}


def _line(row):
    """One line about a row."""
    if row["findings"]:
        return "; ".join(text for _, text in row["findings"])[:300]
    if row["encode"]["exit"] != 0:
        return f"refused: {reason_of(row['encode'])}"
    return f"{row['bytes']['stream']} bytes of {row['bytes']['source']}, {row['encode']['seconds']:.1f} s"
