"""The jobs of a condition file, here or on a cluster: what each becomes as a task, its folder, the summary and the exit code."""

import shutil
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

from texfcodec.batch.children import WARM_UP, Caps, Children
from texfcodec.batch.folders import only_run as only_run_of_package
from texfcodec.batch.folders import work_room
from texfcodec.batch.local import run_here
from texfcodec.batch.task_progress import progress
from texfcodec.batch.tasks import FULL, LOG, Task, package_code
from texfcodec.core.colour_error import in_decibels
from texfcodec.errors import EXIT_DIFFERS, EXIT_INTERRUPTED, EXIT_IO, EXIT_SUPPORT, InputError
from texfcodec.options import default_threads
from tools.bench import verify
from tools.bench.conditions import find_assets, read_conditions
from tools.bench.jobs import JOB, METRICS, MISSING, as_text, jobs_of, read_json

COMMAND, STEPS = "{root}/tools/bench/rate_points.py", ("encode", "decode")


def task_of(job, caps):
    """Return the Task (texfcodec.batch) that runs a Job. caps: its threads, memory and seconds, by name."""
    commands = tuple((step, (COMMAND, "--step", step, "{folder}", "{input}", "{threads}")) for step in STEPS)
    return Task(name=job.name, commands=commands, input=job.path, files={JOB: as_text(job.facts)}, enough=MISSING,
                unsuited=EXIT_SUPPORT, package=package_code(), **caps)


def not_ours(folder):
    """Return a sentence if a job's folder holds other files than a job's, so that it must not be replaced; else None."""
    inside = [path.name for path in folder.iterdir()] if folder.exists() else []
    if inside and not any(name.startswith(JOB) for name in inside):
        return f"{folder} is not a job's folder, and is left alone"
    return None


def settle(job, outcome, folder):
    """Move the folder of an attempt to the job's place, replacing an earlier one. Return None, or a sentence about why the job
    failed. On a full disk the earlier one stays."""
    if outcome.state == FULL or not folder.exists():
        return outcome.reason or f"{folder} is not here"
    try:
        job.folder.parent.mkdir(parents=True, exist_ok=True)
        old = folder.with_name(folder.name + ".old")
        if job.folder.exists():
            job.folder.rename(old)
        folder.rename(job.folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        return outcome.reason or f"{type(error).__name__}: {error}"
    return outcome.reason or None


class Batch:
    """A run of jobs. show(name, line, is_bad): displays an end. failed: {name: why}; is_full: whether a disk was full."""

    def __init__(self, jobs, show):
        self.jobs, self.show, self.failed, self.is_full = {job.name: job for job in jobs}, show, {}, False

    def run(self, args, room, caps):
        """Run all jobs, args.jobs at a time here, or on the Dask cluster at args.scheduler. room: folder for attempts; caps: as
        of task_of(). Ctrl-C and SIGTERM stop them."""
        tasks = []
        for job in self.jobs.values():
            if reason := not_ours(job.folder):
                self._fail(job, reason)
            else:
                tasks.append(task_of(job, caps))
        if args.scheduler:
            from texfcodec.batch.cluster import run_there

            run_there(tasks, args.scheduler, room, self._ended, lambda text: print(text, file=sys.stderr, flush=True))
        else:
            run_here(tasks, args.jobs, room, self._ended)

    def _ended(self, task, outcome, folder):
        job, self.is_full = self.jobs[task.name], self.is_full or outcome.state == FULL
        if reason := settle(job, outcome, folder):
            self._fail(job, reason)
        else:
            self.show(job.name, result_line(job), False)

    def _fail(self, job, reason):
        self.failed[job.name] = reason
        self.show(job.name, f"{job.name}: failed: {reason}", True)


def result_line(job):
    """Return one line about a job that has ended without a fault: bytes, PSNR and seconds, or why it was not run."""
    metrics = read_json(job.folder / METRICS)
    if metrics is None:
        row = read_json(job.folder / MISSING)
        return f"{job.name}: {row['state']}: {row['reason']}"
    quality = in_decibels(metrics["psnr_3d"]["y"]) if metrics["psnr_3d"] else "not measured"
    return f"{job.name}: {metrics['bytes']['total']} bytes, 3D-PSNR Y {quality}, {metrics['seconds']['encode']['total']:.2f} s"


@contextmanager
def only_run(out):
    """Context manager: lock the folder of results against other runs. Ends the program if one is at work there."""
    with ExitStack() as stack:
        try:
            stack.enter_context(only_run_of_package(out))
        except InputError as error:
            raise SystemExit(error.message) from None
        yield


def warm_cache():
    """Compiles the kernels once, before many processes would all do it."""
    from texfcodec.precompile import kernels_compiled

    if not kernels_compiled():
        print("first run: compiling kernels, about 30 s, once", file=sys.stderr)
        Children().run(WARM_UP, subprocess.DEVNULL, subprocess.DEVNULL, Caps(default_threads()))


def run_conditions(args):
    """Run the condition file of the command line (args, of rate_points.py); return the exit code."""
    return run_batch(args, read_conditions(args.records[0], args.evaluation, args.asset))


def run_verify(args):
    """Run the recorded points that args select once more, print the page that compares them, and return the exit code."""
    points, left_out = verify.selected(args)
    points, absent = verify.absent(points, args)
    code = run_batch(args, verify.conditions_of(points))
    if not points or code not in (0, EXIT_DIFFERS):
        return code
    runs = verify.runs_of(points, args.out)
    text = verify.page_of(runs, left_out + absent, args)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return 0 if verify.is_same(runs) else EXIT_DIFFERS


def run_batch(args, conditions):
    """Run all jobs of conditions, the dict of read_conditions(), that are not finished; return the exit code."""
    args.jobs = min(max(args.jobs, 1), 256)
    seconds = conditions["limit_seconds"] if args.limit_seconds is None else args.limit_seconds
    caps = {"threads": max(default_threads() // args.jobs, 1), "memory": args.memory_limit, "seconds": seconds}
    with only_run(args.out):
        folders = [f for f in (args.assets, *(path.parent for path in args.records[:1])) if f]
        assets, missing = find_assets(conditions["assets"], folders, args.out)
        for name in missing:
            print(f"{name}: not in {' or '.join(map(str, folders))}, passed over", file=sys.stderr)
        jobs = jobs_of(conditions, assets, args.out)
        if not jobs:
            print("none of the assets is there: nothing to do", file=sys.stderr)
            return EXIT_IO
        return _run_jobs(jobs, args, caps, len(missing))


def _run_jobs(jobs, args, caps, absent):
    todo, begin = [job for job in jobs if not job.is_finished(args.keep_old)], time.perf_counter()
    with progress(len(todo)) as show, work_room(args.out) as room:
        batch = Batch(todo, show)
        if todo:
            if not args.scheduler:
                warm_cache()
            try:
                batch.run(args, room, caps)
            except InputError as error:
                print(f"{error}; the same command goes on from here", file=sys.stderr)
                return EXIT_IO
    _sum_up(jobs, batch, absent, time.perf_counter() - begin)
    return EXIT_IO if batch.is_full else EXIT_DIFFERS if batch.failed else 0


def _sum_up(jobs, batch, absent, seconds):
    rows = [(job, row["state"]) for job in jobs if not job.metrics(True) and (row := job.row()) and job.name not in batch.failed]
    without = {state: [job.name for job, said in rows if said == state] for state in ("missing", "does not apply")}
    here = sum(name in batch.jobs for names in without.values() for name in names)
    done, before = len(batch.jobs) - len(batch.failed) - here, len(jobs) - len(batch.jobs)
    print(f"{len(jobs)} jobs: {done} done in {seconds:.0f} s, {before} were finished before, {len(batch.failed)} failed"
          + (f"; {len(without['missing'])} need what is not installed" if without["missing"] else "")
          + (f"; {len(without['does not apply'])} do not apply" if without["does not apply"] else "")
          + (f"; {absent} assets passed over" if absent else ""))
    for reason in dict.fromkeys(job.row()["reason"] for job, state in rows if state == "missing"):
        print(f"  not installed: {reason}")
    for name, reason in batch.failed.items():
        log = batch.jobs[name].folder / LOG
        print(f"  {name}: {reason}" + (f"; see {log}" if log.exists() else ""))


def resumable(run, args):
    """Return the exit code of run(args). Ctrl-C gives EXIT_INTERRUPTED and a line that the same command resumes the run."""
    try:
        return run(args)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED
