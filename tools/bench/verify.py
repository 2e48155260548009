"""rate_points.py --verify: the recorded points of ours, made again by the present code, and the page of what differs.

A record is a file of rows that collect.py --keep has kept (.jsonl), or NAME.ours.json of tools/bench/materials. Each point
becomes a job with its options and one thread, which is not measured; points with the same options share one. Points of other
methods are left out, as are fits of 3DNTC payloads without --neural: they take minutes each. """

import json
import shlex
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

from tools.bench.conditions import EVALUATION, find_assets
from tools.bench.jobs import REPOSITORY, key_of
from tools.bench.provenance import made_on
from tools.bench.result_tables import as_markdown, wrapped
from tools.bench.results import OURS, read_results

METHOD, NEURAL = "texf", "3dntc"
RECORDS = "rates/*.jsonl", "materials/*.ours.json"
NOT_MEASURED = EVALUATION | {"samples": 0, "views": 0}


@dataclass(frozen=True, kw_only=True)
class Point:
    """A recorded rate point of our codec. record: path of its file; options: of the method; bytes: {"total", other counts};
    values: hash of the decoded values, None if unrecorded."""

    record: Path
    asset: str
    setting: str
    options: dict
    bytes: dict
    values: str | None = None

    @property
    def job(self):
        """The name of the job that makes it again, by its options."""
        return f"again_{key_of(self.options)}"


def read_points(path):
    """Return the Points of our codec in a record file; [] if it holds those of rivals only."""
    if path.suffix == ".jsonl":
        return [Point(record=path, asset=row["asset"], setting=row["setting"], options=row["options"], bytes=row["bytes"],
                      values=row["reconstruction_sha256"]) for row in read_results(path) if row["method"] in OURS]
    held = json.loads(path.read_text(encoding="utf-8"))
    return [Point(record=path, asset=held["asset"], setting=f"QP {p['qp']}", options={"rate": "r03", "qp": p["qp"]},
                  bytes={"total": p["total"], "attributes": p["map_bytes"]}) for p in held["points"] if "qp" in p]


def default_records():
    """Paths of the committed records."""
    return [path for pattern in RECORDS for path in sorted((REPOSITORY / "tools" / "bench").glob(pattern))]


def selected(args):
    """Return (Points that the parsed arguments select, sentences on those left out). Ends the program if a name is unknown."""
    points = []
    for path in args.records or default_records():
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


def conditions_of(points):
    """Return conditions, as read_conditions() does of a file, that encode these Points again."""
    settings = {(p.asset, p.job): {"setting": p.job, "group": "again", "method": METHOD, "assets": [p.asset],
                                   "options": p.options} for p in points}
    return {"assets": list(dict.fromkeys(p.asset for p in points)), "plugins": [], "limit_seconds": None,
            "evaluation": NOT_MEASURED, "settings": list(settings.values())}


def absent(points, args):
    """Return (Points whose assets are there, sentences about the others)."""
    _, missing = find_assets(list(dict.fromkeys(p.asset for p in points)), [args.assets] if args.assets else [], args.out)
    for name in missing:
        print(f"{name}: not in {args.assets}, passed over", file=sys.stderr)
    left = [p for p in points if p.asset in missing]
    return [p for p in points if p not in left], ([f"Passed over, because the assets are not there: {len(left)} points of "
                                                   f"{', '.join(missing)}."] if left else [])


def runs_of(points, out):
    """Return [(Point, run)]: a run has "bytes", "values", processor "seconds" of the new job, or "error". out: folder of
    jobs."""
    runs = []
    for point in points:
        folder = out / point.asset / point.job
        try:
            row = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
            run = {"bytes": row["bytes"], "values": row["reconstruction_sha256"],
                   "seconds": row["seconds"]["encode"]["processor"]}
        except FileNotFoundError:
            log = folder / "log.txt"
            run = {"error": log.read_text(encoding="utf-8").strip().splitlines()[-1] if log.exists() else "it has not run"}
        runs.append((point, run))
    return runs


def changes_of(point, run):
    """Return {byte count: bytes more than recorded} of the counts of a run that differ from its Point's."""
    return {name: run["bytes"].get(name, 0) - size for name, size in point.bytes.items() if run["bytes"].get(name, 0) != size}


def percent_of(point, run):
    """Return by how many percent a run has more bytes than its Point."""
    return 100 * (run["bytes"]["total"] / point.bytes["total"] - 1)


def is_same(runs):
    """Return whether all runs of runs_of() have the recorded bytes."""
    return not any("error" in run or changes_of(point, run) for point, run in runs)


def page_of(runs, left_out, args):
    """Return the Markdown page. runs: of runs_of(); left_out: sentences about Points not encoded; args: the parsed arguments."""
    done = [(point, run) for point, run in runs if "error" not in run]
    same, encodes = sum(not changes_of(*pair) for pair in done), {(point.asset, point.job): run for point, run in done}.values()
    lead = (f"Made by `{command_of(args)}` {made_on()}: points of ours that other commits have measured, encoded again with "
            f"their recorded options by this one, {len(encodes)} encodes in {sum(run['seconds'] for run in encodes):.0f} "
            "processor seconds.")
    said = (f"**{same} of {len(runs)} points have the same bytes.** Percent are of the recorded bytes, positive where there are "
            "more now. Same values: of the points whose record has the hash of the decoded values, those that have it still.")
    blocks = [("h1", "Recorded points, encoded again"), *(("p", text) for text in (lead, said, *left_out)),
              ("table", summary(runs))]
    for record in dict.fromkeys(point.record for point, _ in runs):
        if lines := [line_of(*pair) for pair in done if pair[0].record == record and changes_of(*pair)]:
            blocks += [("h2", shown(record)), ("table", (["asset", "setting", "recorded", "now", "%", "of which"], lines, 2))]
    if failed := [[shown(point.record), point.asset, point.setting, run["error"]] for point, run in runs if "error" in run]:
        blocks += [("h2", "Failed"), ("table", (["record", "asset", "setting", "error"], failed, 4))]
    return "\n".join(wrapped(as_markdown(blocks).splitlines())).rstrip() + "\n"


def line_of(point, run):
    """Return the cells of a row in the table of Points whose bytes differ."""
    parts = [f"{name} {by:+,}" for name, by in changes_of(point, run).items() if name != "total"]
    return [point.asset, point.setting, f"{point.bytes['total']:,}", f"{run['bytes']['total']:,}",
            f"{percent_of(point, run):+.2f}", ", ".join(parts)]


def summary(runs):
    """Return (head, lines, texts) of the table with a line per record."""
    lines = []
    for record in dict.fromkeys(point.record for point, _ in runs):
        here = [(point, run) for point, run in runs if point.record == record]
        done = [(point, run) for point, run in here if "error" not in run]
        hashed = [point.values == run["values"] for point, run in done if point.values]
        percents = [percent_of(*pair) for pair in done]
        spread = [f"{of:+.2f}" for of in (statistics.median(percents), max(percents, key=abs))] if percents else ["", ""]
        lines.append([shown(record), len(here), sum(not changes_of(*pair) for pair in done),
                      f"{sum(hashed)} of {len(hashed)}" if hashed else "", len(here) - len(done), *spread])
    return ["record", "points", "same bytes", "same values", "failed", "median, %", "largest, %"], lines


def shown(path):
    """Return a path as the page shows it: relative to the repository, or the name alone if it is elsewhere."""
    path = path.resolve()
    return path.relative_to(REPOSITORY).as_posix() if path.is_relative_to(REPOSITORY) else path.name


def command_of(args):
    """Return the command that repeats the page, without the folders of this machine."""
    assets = [word for name in args.asset for word in ("--asset", name)]
    return shlex.join(["python", "tools/bench/rate_points.py", *map(shown, args.records), "--verify", "--out", "out/again",
                       "--assets", "FOLDER", *assets, *["--neural"] * args.neural])
