"""What falls short in a row, by the targets of the collection, and the summary of many rows."""

import math
import re
import statistics
from collections import Counter

from texfcodec.core.colour_error import in_decibels
from texfcodec.errors import EXIT_INTERNAL, EXIT_IO, EXIT_LIMIT, EXIT_SUPPORT

LEAST_DB = 30.0  # RGB of a part at the rate of the run
LARGEST_MESH, CONTAINER = 2.0, 2048  # times the source; bytes of a GLB's JSON, which a file of twelve triangles may have less of
SMALL = 0.001  # a part of so little of the surface is not looked at
ALPHA_OFF, SIZE_OFF = 0.02, 0.01  # mean error of alpha; of the box
LEAST_PICTURE, LEAST_COVER = 30.0, 0.9  # dB and shared pixels of two pictures of another program, whose filters differ a little
SAYS_QUALITY, SAYS_SIZE = r"\bdB\b|quality|fidelity", r"larger|bigger"
# Losses that change no picture of a still model, and words of a warning that something is lost.
LOOKLESS = (r"animation|skin|joint|camera|\blights?\b|extras|hierarchy|(?<!of )\bnodes?\b|copyright|\bnames?\b|variant|scene|"
            r"user data|\bpoints\b|\blines\b|generator|metadata|"
            r"^(?:Ns|Ka|Ks|Ni|Tf|illum|sharpness|specular|shininess|ambient|index_of_refraction) of material")
SAYS_LOST = (r"not found|not read|cannot|ignored|\blost\b|missing|guess|skipped|not supported|does not exist|left out|unreadable|"
             r"broken|not applied")
REFUSALS = (EXIT_IO, EXIT_SUPPORT, EXIT_LIMIT)

INTERNAL, TOO_LONG, NOT_JSON = "internal error", "too long", "no strict JSON"
NOT_MEASURED, POOR, ALPHA, SIZE = "not measured", "part under 30 dB", "alpha differs", "size differs"
LARGER, LARGE_MESH, INVALID, UNNAMED = "stream larger than source", "GLB over twice the source", "validator", "unnamed loss"
PICTURE, UNSAID = "picture differs", '"no losses" beside a loss'
KINDS = (INTERNAL, TOO_LONG, NOT_JSON, NOT_MEASURED, POOR, ALPHA, SIZE, LARGER, LARGE_MESH, INVALID, UNNAMED, PICTURE, UNSAID)


def findings_of(row):
    """Return [[kind, sentence]] on what is wrong in the row of a model's run. A refusal with an error code is not."""
    findings = [item for step in ("encode", "decode") if step in row for item in _of_tool(step, row[step])]
    if "measure" not in row:
        return findings
    said = [text for step in ("encode", "decode") for kind in ("warnings", "dropped", "remarks")
            for text in row[step]["report"].get(kind, [])]
    said += [f"{effect['channel']}: {effect['reasons']}" for effect in row["encode"]["report"].get("effects", [])]
    warned = " ".join(row["encode"]["report"].get("warnings", []) + row["decode"]["report"].get("warnings", []))
    findings += [*_of_bytes(row["bytes"], warned), *_of_measure(row, said, warned)]
    if (issues := row["validator"]) and issues["errors"] + issues["warnings"]:
        text = " / ".join(issues["messages"])[:200]
        findings.append([INVALID, f"{issues['errors']} errors, {issues['warnings']} warnings: {text}"])
    report = row["encode"]["report"]
    lost = [] if report.get("dropped") else [text for text in report.get("warnings", []) if re.search(SAYS_LOST, text)]
    return [*findings, *([UNSAID, text[:200]] for text in lost[:1]), *_of_picture(row)]


def _of_tool(step, run):
    code = run["exit"]
    if code is None:
        yield [TOO_LONG, f"{step} took longer than {run['seconds']:.0f} s"]
    elif code == EXIT_INTERNAL or code < 0 or (code and (code not in REFUSALS or step == "decode")):
        yield [INTERNAL, f"{step} ended with {code}: {reason_of(run)}"]
    elif run["json"]:
        yield [NOT_JSON, f"{step}: {run['json']}"]


def reason_of(run):
    """Return why a tool ended with an error: the code and message of its JSON, or the end of its log."""
    error = run["report"].get("error")
    return (f"{error.get('code')} {error.get('message')}" if isinstance(error, dict) else run["log"])[:200]


def _of_bytes(sizes, warned):
    if sizes["stream"] > sizes["source"] and not re.search(SAYS_SIZE, warned):
        yield [LARGER, f"{sizes['stream']} bytes of {sizes['source']}"]
    if sizes["mesh"] > LARGEST_MESH * sizes["source"] + CONTAINER:
        yield [LARGE_MESH, f"{sizes['mesh']} bytes of {sizes['source']}, {sizes['mesh'] / sizes['source']:.1f} times"]


def _of_measure(row, said, warned):
    measured = row["measure"]
    if measured["exit"] != 0 or measured["json"]:
        yield [NOT_MEASURED, f"measure ended with {measured['exit']}: {measured['log'] or measured['json']}"]
        return
    facts = measured["report"]
    poor = [part for part in seen_parts(facts) if part["rgb"] is not None and part["rgb"] < LEAST_DB]
    if poor and not re.search(SAYS_QUALITY, warned):
        worst = min(poor, key=lambda part: part["rgb"])
        yield [POOR, f"{len(poor)} of {len(facts['parts'])} parts; {worst['material']!r} has {worst['rgb']:.1f} dB RGB "
                     f"on {100 * worst['share']:.1f} % of the surface"]
    alpha = max((part["alpha"] for part in facts["parts"] if part["share"] >= SMALL), default=0)
    if alpha > ALPHA_OFF and not re.search(SAYS_QUALITY, warned):
        yield [ALPHA, f"by {alpha:.3f} on average"]
    if facts["size"] > SIZE_OFF:
        yield [SIZE, f"the boxes differ by {100 * facts['size']:.1f} %"]
    unnamed = [thing for thing, words in facts["holds"] if not re.search(words, "\n".join(said), re.IGNORECASE)]
    if unnamed and row["encode"]["exit"] == 0:  # otherwise it could name nothing
        yield [UNNAMED, ", ".join(unnamed)]


def losses_of(row):
    """Return the losses that a row's reports name and that a picture of a still model could show."""
    reports = [row[step]["report"] for step in ("encode", "decode")]
    named = [text for report in reports for text in report.get("dropped") or [] if not re.search(LOOKLESS, text, re.IGNORECASE)]
    warned = [text for report in reports for text in report.get("warnings") or []]
    return named + [text for text in warned if re.search(f"{SAYS_LOST}|{SAYS_QUALITY}", text)]


def least_picture(shown):
    """Return the lowest PSNR in dB of a pair's pictures; infinite if they are the same, or if three.js could not load it. For a
    source without normals only the flat picture counts, because each program makes up its own."""
    values = [shown.get(key) for key in (("flat",) if shown.get("made") else ("flat", "lit", "full"))]
    return min((value for value in values if value is not None), default=math.inf)


def _of_picture(row):
    """What three.js shows otherwise, without a word about it; what it cannot load falls short of nothing."""
    shown = row.get("picture", {})
    if not shown or "error" in shown or losses_of(row):
        return
    if least_picture(shown) < LEAST_PICTURE:
        figures = ", ".join(f"{key} {shown[key]:.1f}" for key in ("flat", "lit", "full", "inner") if shown[key] is not None)
        yield [PICTURE, f"{figures} dB in three.js"]
    elif shown["size"] > SIZE_OFF:
        yield [PICTURE, f"the boxes differ by {100 * shown['size']:.1f} % in three.js"]
    elif shown["cover"] < LEAST_COVER:
        yield [PICTURE, f"only {100 * shown['cover']:.0f} % of the pixels are covered in both"]


def seen_parts(facts):
    """Return the parts of a measurement that are visible and have a share of at least SMALL."""
    return [part for part in facts["parts"] if part["points"] and part["share"] >= SMALL]


def worst_rgb(row):
    """Return the PSNR of RGB in dB of the worst part of a row: None if all are exact, NaN if nothing was measured."""
    values = [part["rgb"] for part in seen_parts(row["measure"]["report"])] if row.get("measure", {}).get("exit") == 0 else []
    return min((value for value in values if value is not None), default=None) if values else math.nan


def summary(rows, missing):
    """Return (text for people, whether there are findings) of a run's rows. missing: {package: why it was not fetched}."""
    coded = [row for row in rows if "measure" in row]
    refused = [row for row in rows if row["encode"]["exit"] in REFUSALS]
    kinds = Counter(kind for row in rows for kind in {kind for kind, _ in row["findings"]})
    lines = [f"{len(rows)} models: {len(coded)} coded, decoded and compared, {len(refused)} refused, "
             f"{sum(bool(row['findings']) for row in rows)} fall short"]
    lines += [f"  {kinds[kind]:4} {kind}" for kind in KINDS if kinds[kind]]
    lines += _figures(coded)
    for kind in KINDS:
        short = [(row["name"], text) for row in rows for of, text in row["findings"] if of == kind]
        lines += ["", f"{kind}:"] if short else []
        lines += [f"  {name}: {text}" for name, text in short]
    lines += ["", "refused:"] if refused else []
    lines += [f"  {row['name']}: {reason_of(row['encode'])}" for row in refused]
    lines += [f"not fetched: {why}" for why in missing.values()]
    return "\n".join(lines), bool(kinds)


def _figures(coded):
    """Median and worst of the measured figures."""
    if not coded:
        return []
    finite = sorted(value for value in map(worst_rgb, coded) if value is not None and value == value)
    lines = [f"  worst part RGB: median {in_decibels(statistics.median(finite))}, worst {in_decibels(finite[0])}, "
             f"{sum(worst_rgb(row) is None for row in coded)} exact"] if finite else []
    sizes = [row["bytes"] for row in coded]
    figures = (("stream / source", [size["stream"] / size["source"] for size in sizes]),
               ("GLB / source", [size["mesh"] / size["source"] for size in sizes]),
               ("encode seconds", [row["encode"]["seconds"] for row in coded]),
               ("decode seconds", [row["decode"]["seconds"] for row in coded]),
               ("encode MiB", [row["encode"]["report"].get("peak_memory_bytes", 0) / 2**20 for row in coded]))
    return lines + [f"  {name}: median {statistics.median(values):.3g}, worst {max(values):.3g}" for name, values in figures]


def changed(before, after):
    """Return text that compares the rows of two runs of the same models: counts by kind, and models that got worse."""
    old, new = ({row["name"]: row for row in rows} for rows in (before, after))
    both = [name for name in new if name in old]
    counts = [Counter(kind for name in both for kind in {kind for kind, _ in rows[name]["findings"]}) for rows in (old, new)]
    lines = ["", f"against the rows before, {len(both)} models in both:"]
    lines += [f"  {kind}: {counts[0][kind]} -> {counts[1][kind]}" for kind in KINDS if counts[0][kind] + counts[1][kind]]
    for name in both:
        worse = {kind for kind, _ in new[name]["findings"]} - {kind for kind, _ in old[name]["findings"]}
        lines += [f"  new with {name}: {', '.join(sorted(worse))}"] if worse else []
    return "\n".join(lines)
