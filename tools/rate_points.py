"""Rate points: every asset coded by every method at every setting and measured, a folder per job; may be stopped at any moment.

python tools/rate_points.py CONDITIONS.toml --out DIR [--jobs N] [--assets FOLDER] [--keep-old]

CONDITIONS.toml (see conditions/):

    title = "what this is for"                        # optional
    assets = ["sample", "bball_0001", "meshes/a.obj"] # in FOLDER, else beside this file; "sample" is the package's own
    plugins = ["my_codec.py"]                         # optional: further methods, beside this file; see tools/baselines
    [evaluation]                                      # optional, as is each line
    samples = 1000000                                 # surface points of 3D-PSNR
    views = 16                                        # rendered views; 0: no image measures
    size = 2048
    ssim = false
    [[settings]]                                      # any number of them
    name = "{effort}_{rate}"                          # a folder name
    group = "{effort}"                                # optional (the method): settings that form one curve
    method = "texf"                                   # optional
    assets = ["sample"]                               # optional: for these only
    effort = ["fast", "best"]                         # the rest goes to the method; a list makes a setting of each value, two
    rate = ["r01", "r02"]                             # lists one of each pair, and {NAME} stands for the value

A job is one asset at one setting in DIR/ASSET/SETTING: job.json (what was asked for, by which code), the method's own files
(ours: stream.texf), encode.json, log.txt (what the two processes said) and metrics.json, written last and by rename. Encoding
and decoding run in fresh processes of their own, warmed up on a tiny mesh before clock and memory count, with cores / N threads
each. The same command does only what is not finished: jobs whose settings, asset and code are those of their metrics.json stay
as they are (--keep-old: of whatever code). Where the decoder's values are not those of the encoder's reconstruction the job
fails. A failed job stops no other and is tried again by the next run; assets that are not there are named and passed over.

Exit code: 0 all jobs are finished, 1 the conditions are wrong, 2 the command line is, or there is nothing to do, 7 a job failed
or differs, 130 interrupted. Tables and plots are made by collect.py.
"""

import argparse
import hashlib
import inspect
import itertools
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
import traceback
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from baselines import find

import texfcodec
from texfcodec.errors import EXIT_DIFFERS, EXIT_IO
from texfcodec.options import default_threads

SCHEMA = 1
EXIT_INTERRUPTED = 130
SAMPLE = "sample"
SUFFIXES = ("", ".glb", ".gltf", ".obj", ".ply")
EVALUATION = {"samples": 1_000_000, "views": 16, "size": 2048, "ssim": False}
LEAST = {"samples": 1, "views": 0, "size": 16}
JOB, ENCODED, METRICS, LOG = "job.json", "encode.json", "metrics.json", "log.txt"
NAME = re.compile(r"\w[\w.+-]*")
STEPS = ("encode", "decode")
REPOSITORY = Path(__file__).resolve().parents[1]


# Conditions: the TOML file becomes jobs.


def read_conditions(path):
    """{"assets", "plugins", "evaluation", "settings"} of a condition file, checked; ends the program with a sentence."""
    try:
        with open(path, "rb") as file:
            given = tomllib.load(file)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SystemExit(f"{path}: {error}") from None
    try:
        _check_keys("the file", given, {"title", "assets", "plugins", "evaluation", "settings"})
        assets, plugins = _names(given, "assets"), _names({"plugins": [], **given}, "plugins")
        if not assets:
            raise ValueError("assets is empty")
        found = {"assets": assets, "plugins": [str(Path(path).parent.resolve() / p) for p in plugins],
                 "evaluation": _evaluation(given.get("evaluation", {}))}
        tables = given.get("settings")
        if not isinstance(tables, list) or not tables:
            raise ValueError("there is no [[settings]] table")
        found["settings"] = [s for number, table in enumerate(tables, 1) for s in _expanded(number, table, found)]
        names = [s["setting"] for s in found["settings"]]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two settings are called {name!r}")
    except ValueError as error:
        raise SystemExit(f"{path}: {error}") from None
    return found


def _check_keys(where, table, allowed):
    if not isinstance(table, dict):
        raise ValueError(f"{where} must be a table")
    for key in table:
        if key not in allowed:
            raise ValueError(f"{where} has an unknown key {key!r}; there are {', '.join(sorted(allowed))}")


def _names(table, key):
    values = table.get(key)
    if not isinstance(values, list) or not all(isinstance(v, str) and v for v in values):
        raise ValueError(f"{key} must be a list of names, as in {key} = [\"a\", \"b\"]")
    return values


def _evaluation(table):
    _check_keys("[evaluation]", table, set(EVALUATION))
    for key, value in table.items():
        if type(value) is not type(EVALUATION[key]) or value < LEAST.get(key, 0):
            kind = "true or false" if key == "ssim" else f"a whole number, {LEAST[key]} or more"
            raise ValueError(f"[evaluation] {key} must be {kind}, not {value!r}")
    return EVALUATION | table


def _expanded(number, table, conditions):
    """Settings [{"setting", "group", "method", "assets", "options"}] of one table; its lists are multiplied out."""
    where = f"[[settings]] number {number}"
    if not isinstance(table, dict) or not isinstance(table.get("name"), str):
        raise ValueError(f"{where} has no name")
    method, assets = table.get("method", "texf"), _names({"assets": conditions["assets"], **table}, "assets")
    for name in assets:
        if name not in conditions["assets"]:
            raise ValueError(f"{where}: {name!r} is none of the file's assets")
    try:
        known = find(method, conditions["plugins"]).options
    except LookupError as error:
        raise ValueError(f"{where}: {error}") from None
    options = {k: v for k, v in table.items() if k not in ("name", "group", "method", "assets")}
    _check_keys(f"{where} ({table['name']!r})", options, set(known))
    lists, made = {k: v if isinstance(v, list) else [v] for k, v in options.items()}, []
    for key, values in lists.items():
        if not values or not all(isinstance(v, str | int) or isinstance(v, float) and math.isfinite(v) for v in values):
            raise ValueError(f"{where}: {key} must be text, a number, true, false or a list of these, not {options[key]!r}")
    for values in itertools.product(*lists.values()):
        chosen = dict(zip(options, values, strict=True))
        try:
            name, group = (str(table.get(key, default)).format(**chosen) for key, default in (("name", ""), ("group", method)))
        except (KeyError, IndexError, ValueError) as error:
            raise ValueError(f"{where}: name and group may only use {{...}} for a key of the table, not {error}") from None
        if not NAME.fullmatch(name):
            raise ValueError(f"{where}: the name {name!r} is no folder name of letters, digits and . _ + -")
        made.append({"setting": name, "group": group, "method": method, "assets": assets, "options": chosen})
    return made


def find_assets(names, folders, out):
    """({name as given: path}, names that are in none of the folders). "sample" is made in out where it is not there yet."""
    found, missing = {}, []
    for name in names:
        places = [folder / (name + suffix) for folder in folders for suffix in SUFFIXES]
        path = _sample(out) if name == SAMPLE else next((p for p in places if p.is_file()), None)
        if path is None:
            missing.append(name)
        else:
            found[name] = path.resolve()
    return found, missing


def _sample(out):
    path = out / SAMPLE / "source.glb"
    if not path.exists():
        from texfcodec.asset.sample_asset import write_sample

        path.parent.mkdir(parents=True, exist_ok=True)
        write_sample(path)
    return path


@dataclass
class Job:
    """One asset at one setting. facts: what job.json holds."""

    folder: Path
    facts: dict

    @property
    def name(self):
        return f"{self.facts['asset']}/{self.facts['setting']}"

    def metrics(self, keep_old=False):
        """The finished job's metrics, or None; those of other code count with keep_old only."""
        found = read_json(self.folder / METRICS) or {}
        same = found.get("settings_sha256") == self.facts["settings_sha256"]
        return found if same and (keep_old or found.get("code") == self.facts["code"]) else None


def jobs_of(conditions, assets, out, threads):
    """All jobs, asset by asset. assets: {name as given: path}."""
    code = {name: code_of(name, conditions["plugins"]) for name in {s["method"] for s in conditions["settings"]}}
    jobs, names = [], {}
    for given, path in assets.items():
        name, asset_sha256 = SAMPLE if given == SAMPLE else path.stem, _sha256(path.read_bytes())
        if name in names:
            raise SystemExit(f"two assets are called {name!r}: {names[name]} and {path}")
        names[name] = path
        for setting in conditions["settings"]:
            if given not in setting["assets"]:
                continue
            settled = {"schema": SCHEMA, "asset": name, "asset_sha256": asset_sha256, "evaluation": conditions["evaluation"],
                       **{key: setting[key] for key in ("setting", "group", "method", "options")}}
            facts = {**settled, "settings_sha256": _sha256(json.dumps(settled, sort_keys=True).encode()),
                     "code": code[setting["method"]], "package": texfcodec.__version__, "asset_path": str(path),
                     "plugins": conditions["plugins"], "threads": threads}
            jobs.append(Job(out / name / setting["setting"], facts))
    return jobs


def code_of(method, plugins):
    """16 digits over what results depend on: the sources of the package and of the method, and the method's version()."""
    found = find(method, plugins)
    total = hashlib.sha256(found.version().encode())
    for path in (*sorted((REPOSITORY / "texfcodec").rglob("*.py")), Path(inspect.getfile(type(found)))):
        total.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def _sha256(data):
    return hashlib.sha256(data).hexdigest()


def read_json(path):
    """What a JSON file holds; None where there is none or only half of one."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def write_json(path, value):
    """Writes beside the path and renames, so that a file of this name is always whole."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(part, path)


# Steps: what a child process does, in a job's folder.


class Differs(Exception):
    """The decoder's values are not the encoder's."""


def run_step(step, folder):
    """The whole life of a child process; its exit code. It ends with its parent, whose end of stdin closes then."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    folder = Path(folder)
    try:
        job = read_json(folder / JOB)
        if code_of(job["method"], job["plugins"]) != job["code"]:
            raise RuntimeError("the code has changed since the batch began")
        (encode_step if step == "encode" else decode_step)(folder, job)
    except Exception as error:
        traceback.print_exc()
        return EXIT_DIFFERS if isinstance(error, Differs) else 1
    return 0


def _end_with_parent():
    os.read(0, 1)
    if hasattr(os, "killpg") and os.getpgid(0) == os.getpid():  # with whatever the method has started
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


def encode_step(folder, job):
    """Codes the asset; leaves the method's files and encode.json."""
    from texfcodec.asset.load.files import load
    from texfcodec.report import Report

    method, report = find(job["method"], job["plugins"]), Report()
    method.warm_up(job["options"], job["threads"])
    memory, begin = Memory(), time.perf_counter()
    scene = load(job["asset_path"])
    loaded = time.perf_counter()
    facts = method.encode(scene, job["options"], folder, job["threads"], report)
    seconds = {"total": round(time.perf_counter() - loaded, 6), **report.seconds}
    write_json(folder / ENCODED, {"load_seconds": round(loaded - begin, 6), "seconds": seconds, "memory": memory.result(),
                                  "warnings": list(dict.fromkeys([*scene.warnings, *report.warnings])),
                                  "dropped": list(dict.fromkeys([*scene.dropped, *report.dropped])), "facts": facts})


def decode_step(folder, job):
    """Decodes, compares with the encoder's reconstruction, measures; leaves metrics.json."""
    from texfcodec.asset.load.files import load
    from texfcodec.report import Report

    method, report, encoded = find(job["method"], job["plugins"]), Report(), read_json(folder / ENCODED)
    method.warm_up(job["options"], job["threads"])
    memory, begin = Memory(), time.perf_counter()
    decoded = method.decode(folder, job["options"], job["threads"], report)
    seconds, peaks = {"total": round(time.perf_counter() - begin, 6), **report.seconds}, memory.result()
    facts, values = encoded["facts"], method.values_sha256(decoded)
    sent = facts.pop("reconstruction_sha256")
    if sent != values:
        raise Differs(f"the decoder's values are not those of the encoder's reconstruction: {values} is not {sent}")
    begin = time.perf_counter()
    measured = measures(load(job["asset_path"]), decoded, method.face_field(folder), job["evaluation"], job["threads"])
    write_json(folder / METRICS, {
        **{k: job[k] for k in ("schema", "asset", "setting", "group", "method", "options", "settings_sha256", "code", "package")},
        "bytes": facts.pop("bytes"), **measured, "facts": facts,
        "seconds": {"load": encoded["load_seconds"], "encode": encoded["seconds"], "decode": seconds,
                    "measure": round(time.perf_counter() - begin, 6)},
        "memory": {"encode": encoded["memory"], "decode": peaks}, "threads": job["threads"],
        "warnings": encoded["warnings"], "dropped": encoded["dropped"],
        "reconstruction_sha256": sent, "decoded_sha256": values})


def measures(scene, decoded, face_field, evaluation, threads):
    """{"psnr_3d", "image"} of what was decoded, a Texf or a Scene; image is None where no views are asked for."""
    from texfcodec.quality.measure import SourceSamples
    from texfcodec.quality.views import compare_views, mesh_psnr_3d
    from texfcodec.texf import Texf

    if isinstance(decoded, Texf):
        psnr = SourceSamples(scene, evaluation["samples"], threads).compare(decoded, face_field)
    else:
        psnr = mesh_psnr_3d(scene, decoded, evaluation["samples"], threads)
    measured = {"psnr_3d": psnr, "image": None}
    if evaluation["views"]:
        measured["image"] = compare_views(scene, decoded, views=evaluation["views"], size=evaluation["size"],
                                          ssim=evaluation["ssim"], threads=threads)
    return measured


class Memory:
    """Resident memory of this process from now on, in bytes; the system's record of the peak is set back first."""

    def __init__(self):
        from texfcodec.report import peak_memory_bytes

        self._peak = peak_memory_bytes
        try:
            Path("/proc/self/clear_refs").write_text("5")
        except OSError:  # another system, or one that forbids it: the peak then holds the warm-up too
            pass
        self.idle = self._resident("VmRSS")

    @staticmethod
    def _resident(field):
        from anchor_bdrate import resident

        try:
            return resident(field)
        except (OSError, KeyError):
            return None

    def result(self):
        """{"peak", "idle"}: the highest since, and what the process held before; None where the system does not tell."""
        return {"peak": self._resident("VmHWM") or self._peak(), "idle": self.idle}


# Batch: jobs in child processes.


class Children:
    """The processes that are alive, so that all can be stopped at once."""

    def __init__(self):
        self._lock, self._alive, self.stopped = threading.Lock(), set(), False

    def run(self, arguments, log, threads):
        """Runs Python with arguments to its end, stdout and stderr into log; its exit code, or None once stopped."""
        caps = {f"{name}_NUM_THREADS": str(threads) for name in ("OMP", "OPENBLAS", "MKL")}
        paths = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))
        with self._lock:
            if self.stopped:
                return None
            child = subprocess.Popen([sys.executable, *arguments], stdin=subprocess.PIPE, stdout=log, stderr=log,
                                     start_new_session=True, env={**os.environ, **caps, "PYTHONPATH": paths})
            self._alive.add(child)
        try:
            return child.wait()
        except BaseException:
            self.stop()
            raise
        finally:
            child.stdin.close()
            with self._lock:
                self._alive.discard(child)

    def stop(self):
        """Kills them all, with what they have started."""
        with self._lock:
            self.stopped = True
            for child in self._alive:
                if child.poll() is not None:
                    continue
                if hasattr(os, "killpg"):
                    os.killpg(child.pid, signal.SIGKILL)
                else:
                    child.kill()


def run_job(job, children):
    """Both steps of one job: None, or a sentence about why it failed."""
    try:
        return _make_folder(job) or _run_steps(job, children)
    except OSError as error:
        return f"{type(error).__name__}: {error}"


def _make_folder(job):
    """The job's folder, with job.json alone in it; a sentence where it is none of ours."""
    if job.folder.exists():
        inside = [path.name for path in job.folder.iterdir()]
        if inside and not any(name.startswith(JOB) for name in inside):
            return f"{job.folder} is not a job's folder, and is left alone"
        old = job.folder.with_name(f".{job.folder.name}.old")  # renamed first: half a removed folder would not be known again
        shutil.rmtree(old, ignore_errors=True)
        job.folder.rename(old)
        shutil.rmtree(old)
    job.folder.mkdir(parents=True)
    write_json(job.folder / JOB, job.facts)
    return None


def _run_steps(job, children):
    with open(job.folder / LOG, "wb") as log:
        for step in STEPS:
            code = children.run([__file__, "--step", step, str(job.folder)], log, job.facts["threads"])
            if code is None or children.stopped:
                return "interrupted"
            if code:
                return f"{step}: " + (f"ended by signal {-code}" if code < 0 else _last_line(job.folder / LOG))
    return None


def _last_line(path):
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), "it said nothing")[:300]


def run_batch(jobs, workers, show):
    """Runs jobs, `workers` at a time; show(job, reason) is called as each ends. Ctrl-C and SIGTERM stop the children first."""
    children = Children()
    with ThreadPoolExecutor(workers) as pool, _terminated_as_interrupted():
        waiting = {pool.submit(run_job, job, children): job for job in jobs}
        try:
            for future in as_completed(waiting):
                show(waiting[future], future.result())
        except BaseException:
            children.stop()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


@contextmanager
def _terminated_as_interrupted():
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number, frame):
        raise KeyboardInterrupt

    usual = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, usual)


@contextmanager
def progress(total):
    """A function for run_batch's show: a bar with the time left where stderr is a terminal, else a line per job."""
    ended = itertools.count(1)
    if not sys.stderr.isatty():
        yield lambda job, reason: print(f"[{next(ended)}/{total}] {told(job, reason)}", file=sys.stderr, flush=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description:32}"), BarColumn(24), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=1e9) as bar:
        task = bar.add_task("", total=total)

        def show(job, reason):
            if reason:
                bar.console.print(told(job, reason), markup=False, highlight=False)
            bar.update(task, advance=1, description=job.name)

        yield show


def told(job, reason):
    """One line about a job that has ended."""
    if reason:
        return f"{job.name}: failed: {reason}"
    from texfcodec.ground.colour_error import in_decibels

    made = read_json(job.folder / METRICS)
    y = made["psnr_3d"]["y"]
    return f"{job.name}: {made['bytes']['total']} bytes, 3D-PSNR Y {in_decibels(y)}, {made['seconds']['encode']['total']:.2f} s"


@contextmanager
def only_run(out):
    """Ends the program where another run is at work in the same folder; the system drops the lock with its process."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / ".lock", "wb") as lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # not a POSIX system: nobody looks after it there
            pass
        except OSError:
            raise SystemExit(f"another run is at work in {out}") from None
        yield


def warm_cache():
    """Compiles the kernels once, before many processes would all do it."""
    from texfcodec.warmup import kernels_compiled

    if not kernels_compiled():
        print("first run: compiling kernels, about 30 s, once", file=sys.stderr)
        Children().run(["-m", "texfcodec.cli.enc", "--warmup"], subprocess.DEVNULL, default_threads())


def run_conditions(args):
    """The batch of the command line; its exit code."""
    conditions = read_conditions(args.conditions)
    workers = min(max(args.jobs, 1), 256)
    with only_run(args.out):
        folders = [f for f in (args.assets, args.conditions.parent) if f]
        assets, missing = find_assets(conditions["assets"], folders, args.out)
        for name in missing:
            print(f"{name}: not in {' or '.join(map(str, folders))}, passed over", file=sys.stderr)
        jobs = jobs_of(conditions, assets, args.out, max(default_threads() // workers, 1))
        if not jobs:
            print("none of the assets is there: nothing to do", file=sys.stderr)
            return EXIT_IO
        todo, failed, begin = [j for j in jobs if not j.metrics(args.keep_old)], {}, time.perf_counter()
        if todo:
            warm_cache()
            with progress(len(todo)) as show:

                def note(job, reason):
                    if reason:
                        failed[job.name] = reason
                    show(job, reason)

                run_batch(todo, workers, note)
    seconds = time.perf_counter() - begin
    print(f"{len(jobs)} jobs: {len(todo) - len(failed)} done in {seconds:.0f} s, {len(jobs) - len(todo)} were finished before, "
          f"{len(failed)} failed" + (f"; {len(missing)} assets passed over" if missing else ""))
    for name, reason in failed.items():
        print(f"  {name}: {reason}; see {args.out / name / LOG}")
    return EXIT_DIFFERS if failed else 0


def main(arguments=None):
    """Command line of the tool; the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["--step"]:
        return run_step(*arguments[1:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("conditions", type=Path, metavar="CONDITIONS.toml")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="jobs at a time")
    parser.add_argument("--assets", type=Path, metavar="FOLDER", help="where the assets are")
    parser.add_argument("--keep-old", action="store_true", help="keep what other states of the code have finished")
    args = parser.parse_args(arguments)
    try:
        return run_conditions(args)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
