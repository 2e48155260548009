"""Many jobs at a time, each step in a process of its own: progress, failures, interrupts, and the exit code."""

import itertools
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

from texfcodec.errors import EXIT_DIFFERS, EXIT_INTERRUPTED, EXIT_IO
from texfcodec.ground.colour_error import in_decibels
from texfcodec.options import default_threads
from tools.conditions import find_assets, read_conditions
from tools.jobs import JOB, LOG, METRICS, REPOSITORY, jobs_of, read_json, write_json

COMMAND = Path(__file__).with_name("rate_points.py")
STEPS = ("encode", "decode")


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
            code = children.run([str(COMMAND), "--step", step, str(job.folder)], log, job.facts["threads"])
            if code is None or children.stopped:
                return "interrupted"
            if code:
                return f"{step}: " + (f"ended by signal {-code}" if code < 0 else _last_line(job.folder / LOG))
    return None


def _last_line(path):
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), "it said nothing")[:300]


def run_batch(jobs, workers, show):
    """Runs jobs, `workers` at a time: {name: why it failed}. show(job, reason) is called as each ends. Ctrl-C and SIGTERM stop
    the children first."""
    children, failed = Children(), {}
    with ThreadPoolExecutor(workers) as pool, _terminated_as_interrupted():
        waiting = {pool.submit(run_job, job, children): job for job in jobs}
        try:
            for future in as_completed(waiting):
                job, reason = waiting[future], future.result()
                if reason:
                    failed[job.name] = reason
                show(job, reason)
        except BaseException:
            children.stop()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return failed


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
    made = read_json(job.folder / METRICS)
    quality = in_decibels(made["psnr_3d"]["y"])
    return f"{job.name}: {made['bytes']['total']} bytes, 3D-PSNR Y {quality}, {made['seconds']['encode']['total']:.2f} s"


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
                failed = run_batch(todo, workers, show)
    seconds = time.perf_counter() - begin
    print(f"{len(jobs)} jobs: {len(todo) - len(failed)} done in {seconds:.0f} s, {len(jobs) - len(todo)} were finished before, "
          f"{len(failed)} failed" + (f"; {len(missing)} assets passed over" if missing else ""))
    for name, reason in failed.items():
        print(f"  {name}: {reason}; see {args.out / name / LOG}")
    return EXIT_DIFFERS if failed else 0


def resumable(run, args):
    """The exit code of run(args), which goes on where it was stopped when it is called again; interrupted, it says so."""
    try:
        return run(args)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED
