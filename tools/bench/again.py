"""The recorded points of ours, encoded again by the present code: whether records of older commits still have its bytes.

python tools/bench/again.py --assets FOLDER [--rows FILE ...] [--asset NAME ...] [--neural] [--jobs N] [--state FILE.jsonl]
                      [--page FILE.md]

FILE: rows that collect.py --keep has kept of rate_points.py (.jsonl), a record of `materials.py ours` or of `everyday.py measure`
(.json); by default those of tools/bench/. Each point is encoded with its options and one thread, not measured. Points of
other methods are left out, as are fits of 3DNTC payloads without --neural: they take minutes each. Points with the same options
are encoded once.

The page says how many points have the same bytes, all recorded byte counts of a point, and which have not; where a record has the
hash of the decoded values, how many have the same values, and so the same quality too. It is printed, and written to --page.

--state keeps a line per encode, by the code that made it: the same command does only what is not finished. What has failed is
tried again. --jobs works at so many assets at a time, longest first, each in a process of its own. Assets that are not there are
named and passed over.

Exit code: 0 all points have the same bytes, 1 the code has changed meanwhile, 2 the command line is wrong or there is nothing to
do, 7 a point differs or has failed, 130 interrupted.
"""

import argparse
import json
import shlex
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from texfcodec.batch.folders import work_room
from texfcodec.batch.local import run_here
from texfcodec.batch.task_progress import progress
from texfcodec.batch.tasks import Task
from texfcodec.errors import EXIT_DIFFERS, EXIT_IO, EXIT_SUPPORT, TexfError
from tools.bench.accuracy_bench import key_of, read_runs
from tools.bench.batch import only_run, resumable, warm_cache
from tools.bench.conditions import find_assets
from tools.bench.everyday_envelope import read_records
from tools.bench.jobs import JOB, REPOSITORY, as_text, code_of, read_json
from tools.bench.methods import find
from tools.bench.provenance import made_on
from tools.bench.result_tables import as_markdown, wrapped
from tools.bench.results import OURS, read_results

METHOD = "texf"
NEURAL = "3dntc"
RECORDS = "rates/*.jsonl", "materials/*.ours.json"


@dataclass(frozen=True, kw_only=True)
class Point:
    """A recorded point. record: path of its file; options: dict for EncodeOptions; bytes: {"total", other counts}; values: hash
    of the decoded values, None where the record has none; seconds: of the recorded encode, 0 where the record has none."""

    record: Path
    asset: str
    setting: str
    options: dict
    bytes: dict
    values: str | None = None
    seconds: float = 0


def read_points(path):
    """The Points of ours of a record; none where it holds those of rivals only."""
    if path.suffix == ".jsonl":
        return [Point(record=path, asset=row["asset"], setting=row["setting"], options=row["options"], bytes=row["bytes"],
                      values=row["reconstruction_sha256"], seconds=row["seconds"]["encode"]["total"])
                for row in read_results(path) if row["method"] in OURS]
    # Geometry of everyday.py counts UVs, that of the method does not: total and attributes say as much.
    points = [Point(record=path, asset=name, setting=p["rate"], options={"rate": p["rate"], **record["settings"]},
                    bytes={key: p[key] for key in ("total", "attributes")}, seconds=p["encode_seconds"])
              for name, record in read_records([path], "rate").items() for p in record["points"]]
    return points + [Point(record=path, asset=name, setting=f"QP {p['qp']}", options={"rate": "r03", "qp": p["qp"]},
                           bytes={"total": p["total"], "attributes": p["map_bytes"]})  # options: those of our_record()
                     for name, record in read_records([path], "qp").items() for p in record["points"]]


def encode_step(folder, asset):
    """The life of a child process: encodes an asset with all options of the job in a folder, a line of the state each; its exit
    code."""
    from texfcodec.io.load import load

    job = read_json(Path(folder) / JOB)
    scene = load(asset)
    for options in job["options"]:
        run = encoded(scene, options)
        if code_of(METHOD, ()) != job["code"]:  # before the line is written, because modules may have been read at any time
            print("the code has changed since the command was called", file=sys.stderr)
            return EXIT_SUPPORT
        line = {"code": job["code"], "setting": setting_of(job["asset"], job["asset_sha256"], options), "run": run}
        with open(job["state"], "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
    return 0


def encoded(scene, options):
    """{"bytes", "values", "seconds" of the processor} of a Scene, or {"error": a sentence}."""
    from texfcodec.report import Report

    begin = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            facts = find(METHOD).encode(scene, options, Path(folder), 1, Report())
    except TexfError as error:  # without its details, which may hold the places of one machine
        return {"error": f"{error.code}: {error.message}"}
    except Exception as error:  # a record may have what this code does not know; the other points go on
        return {"error": f"{type(error).__name__}: {error}"}
    return {"bytes": facts["bytes"], "values": facts["reconstruction_sha256"], "seconds": time.process_time() - begin}


def setting_of(asset, asset_sha256, options):
    """What an encode is known by in the state."""
    return {"asset": asset, "asset_sha256": asset_sha256, "options": options}


def encode_beside(todo, args, code):
    """Encodes in child processes; {asset: why its process failed}. todo: {asset: (path, sha256, [options])}."""
    failed, tasks = {}, []
    for asset, (path, digest, options) in todo.items():
        job = {"asset": asset, "asset_sha256": digest, "options": options, "code": code, "state": str(args.state.resolve())}
        tasks.append(Task(name=asset, commands=(("encode", ("{root}/tools/bench/again.py", "--step", "{folder}", "{input}")),),
                          input=path, files={JOB: as_text(job)}, unsuited=EXIT_SUPPORT))
    with progress(len(tasks)) as show, work_room(args.state.parent) as room:
        def ended(task, outcome, folder):
            if outcome.reason:
                failed[task.name] = outcome.reason
            show(task.name, f"{task.name}: {outcome.reason or f'{len(todo[task.name][2])} encoded'}", bool(outcome.reason))

        run_here(tasks, args.jobs, room, ended)
    return failed


def encode_again(points, assets, args):
    """[(Point, its run as of encoded())]; Points with the same options share a run. assets: {name: path} of all their assets."""
    code, digests = code_of(METHOD, ()), {name: sha256(path.read_bytes()).hexdigest() for name, path in assets.items()}
    keyed = [(point, key_of(setting_of(point.asset, digests[point.asset], point.options))) for point in points]
    known, wanted, seconds, failed = read_runs(args.state, {"code": code}), {}, {}, {}
    for point, key in keyed:
        if key not in known or "error" in known[key][-1]:
            wanted.setdefault(point.asset, {})[key] = point.options
            seconds[key] = max(point.seconds, seconds.get(key, 0))
    if wanted:
        warm_cache()
        longest = sorted(wanted, key=lambda asset: -sum(seconds[key] for key in wanted[asset]))
        failed = encode_beside({a: (assets[a], digests[a], list(wanted[a].values())) for a in longest}, args, code)
        if code_of(METHOD, ()) != code:
            raise SystemExit("no page: the code has changed since the command was called")
        known = read_runs(args.state, {"code": code})
    return [(point, known[key][-1] if key in known else {"error": failed[point.asset]}) for point, key in keyed]


def changes_of(point, run):
    """{byte count: bytes more than recorded} of those that differ."""
    return {name: run["bytes"].get(name, 0) - size for name, size in point.bytes.items() if run["bytes"].get(name, 0) != size}


def percent_of(point, run):
    """Bytes more than recorded, in percent of these."""
    return 100 * (run["bytes"]["total"] / point.bytes["total"] - 1)


def page_of(found, left_out, args):
    """The page, Markdown. found: of encode_again(); left_out: sentences about points that were not encoded."""
    done = [(point, run) for point, run in found if "error" not in run]
    same, runs = sum(not changes_of(*pair) for pair in done), {id(run): run for _, run in done}.values()
    lead = (f"Made by `{command_of(args)}` {made_on()}: points of ours that other commits have "
            f"measured, encoded again with their recorded options by this one, {len(runs)} encodes in "
            f"{sum(run['seconds'] for run in runs):.0f} processor seconds.")
    said = (f"**{same} of {len(found)} points have the same bytes.** Percent are of the recorded bytes, positive where there are "
            "more now. Same values: of the points whose record has the hash of the decoded values, those that have it still.")
    blocks = [("h1", "Recorded points, encoded again"), *(("p", text) for text in (lead, said, *left_out)),
              ("table", summary(found))]
    for record in dict.fromkeys(point.record for point, _ in found):
        if lines := [line_of(*pair) for pair in done if pair[0].record == record and changes_of(*pair)]:
            blocks += [("h2", shown(record)), ("table", (["asset", "setting", "recorded", "now", "%", "of which"], lines, 2))]
    if failed := [[shown(point.record), point.asset, point.setting, run["error"]] for point, run in found if "error" in run]:
        blocks += [("h2", "Failed"), ("table", (["record", "asset", "setting", "error"], failed, 4))]
    return "\n".join(wrapped(as_markdown(blocks).splitlines())).rstrip() + "\n"


def line_of(point, run):
    """Cells of the table of what differs."""
    parts = [f"{name} {by:+,}" for name, by in changes_of(point, run).items() if name != "total"]
    return [point.asset, point.setting, f"{point.bytes['total']:,}", f"{run['bytes']['total']:,}",
            f"{percent_of(point, run):+.2f}", ", ".join(parts)]


def summary(found):
    """Content of the table with a line per record."""
    lines = []
    for record in dict.fromkeys(point.record for point, _ in found):
        here = [(point, run) for point, run in found if point.record == record]
        done = [(point, run) for point, run in here if "error" not in run]
        hashed = [point.values == run["values"] for point, run in done if point.values]
        percents = [percent_of(*pair) for pair in done]
        spread = [f"{of:+.2f}" for of in (statistics.median(percents), max(percents, key=abs))] if percents else ["", ""]
        lines.append([shown(record), len(here), sum(not changes_of(*pair) for pair in done),
                      f"{sum(hashed)} of {len(hashed)}" if hashed else "", len(here) - len(done), *spread])
    return ["record", "points", "same bytes", "same values", "failed", "median, %", "largest, %"], lines


def shown(path):
    """A path as the page shows it: from the repository, of others the name."""
    path = path.resolve()
    return path.relative_to(REPOSITORY).as_posix() if path.is_relative_to(REPOSITORY) else path.name


def command_of(args):
    """The command that repeats the page, without the places of one machine."""
    words = [*(["--rows", *map(shown, args.rows)] if args.rows else []), *(["--asset", *args.asset] if args.asset else [])]
    return shlex.join(["python", "tools/bench/again.py", "--assets", "FOLDER", *words, *["--neural"] * args.neural])


def selected(args):
    """(Points of the command line, sentences about those that it leaves out); ends the program where it names what is not
    there."""
    points = []
    for path in args.rows or default_records():
        try:
            points += read_points(path)
        except (OSError, ValueError, LookupError, AttributeError, TypeError) as error:
            raise SystemExit(f"{path} is no record of ours: {type(error).__name__}: {error}") from None
    if unknown := set(args.asset) - {p.asset for p in points}:
        raise SystemExit(f"no point of ours is recorded of {', '.join(sorted(unknown))}")
    points = [p for p in points if p.asset in args.asset or not args.asset]
    kept = [p for p in points if p.options.get("codec") != NEURAL or args.neural]
    left = len(points) - len(kept)
    return kept, [f"Left out: {left} fits of 3DNTC payloads, which --neural encodes again."] if left else []


def default_records():
    """Paths of the committed records."""
    return [path for pattern in RECORDS for path in sorted((REPOSITORY / "tools" / "bench").glob(pattern))]


def run(args):
    """The command line's work; its exit code."""
    points, left_out = selected(args)
    with only_run(args.state.parent):
        assets, missing = find_assets(list(dict.fromkeys(p.asset for p in points)), [args.assets], args.state.parent)
        for name in missing:
            print(f"{name}: not in {args.assets}, passed over", file=sys.stderr)
        if not assets:
            print("there is no point of an asset that is there: nothing to do", file=sys.stderr)
            return EXIT_IO
        if missing:
            left_out.append(f"Passed over, because the assets are not there: {sum(p.asset in missing for p in points)} points of "
                            f"{', '.join(missing)}.")
        found = encode_again([p for p in points if p.asset in assets], assets, args)
    text = page_of(found, left_out, args)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(text)
    return EXIT_DIFFERS if any("error" in run or changes_of(p, run) for p, run in found) else 0


def main(arguments=None):
    """Command line of the tool; the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["--step"]:
        return encode_step(*arguments[1:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", type=Path, required=True, metavar="FOLDER", help="where the assets are")
    parser.add_argument("--rows", type=Path, nargs="+", default=[], metavar="FILE", help="records, in place of those of bench/")
    parser.add_argument("--asset", nargs="+", default=[], metavar="NAME", help="points of these assets only")
    parser.add_argument("--neural", action="store_true", help="3DNTC payloads as well")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="assets at a time")
    parser.add_argument("--state", type=Path, default=Path("out/again.jsonl"), metavar="FILE.jsonl")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the page here too")
    args = parser.parse_args(arguments)
    args.jobs = min(max(args.jobs, 1), 256)
    return resumable(run, args)


if __name__ == "__main__":
    sys.exit(main())
