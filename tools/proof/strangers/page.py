"""docs/reports/strangers.md: what the rows of a run, of pairs, of kinds and of ladders say, in tables."""

import json
import re
from collections import Counter
from pathlib import Path

from texfcodec.batch.tasks import package_code
from tools.bench.provenance import made_on
from tools.proof.strangers.judge import (
    INTERNAL,
    LEAST_PICTURE,
    NOT_JSON,
    PICTURE,
    REFUSALS,
    TOO_LONG,
    UNNAMED,
    UNSAID,
    least_picture,
    losses_of,
)
from tools.proof.strangers.rows import read_rows

STEPS = (20, 25, 30, 35, 40, 50)  # dB
SEEN = Path(__file__).with_name("seen.json")  # {name: what somebody who looked at the pair saw}
WORST = 20
HEAD = """# Strangers

Made by `make -C tools strangers` (tools/proof/strangers) {made}; {older} of its rows are of an earlier state of the package.

{models} models from {packages} packages of public registries, by name, version and hash; none of their files is in this
repository. All were new to this project when they were added. Each is coded at r04 ({fast} of them, the larger ones, with
--effort fast), decoded to GLB and compared with its source. {pairs} pairs of pictures were drawn by three.js: the source by its
own loader of the format and the decoded GLB, from the same two sides, in flat colours, in light and with all maps. A pair has
the least of these dB, over the pixels that either of the two covers. Of a source without normals the flat picture alone counts,
because each program makes up its own. Numbers of materials are taken as linear where the encoder's remark says so. A loss is
named where the result line lists it.
"""


def decibels_of(row):
    """dB of a row's pair of pictures, None where it has none."""
    shown = row.get("picture")
    if not shown or "error" in shown:
        return None
    return least_picture(shown)


def page_of(rows, kinds, ladders, packages):
    """The page. rows: of strangers, with pictures; kinds, ladders: rows of these; packages: number of them."""
    pairs = [row for row in rows if decibels_of(row) is not None]
    fast = sum("fast" in row.get("flags", ()) for row in rows)
    older = sum(row.get("code") != package_code() for row in [*rows, *kinds])
    lead = HEAD.format(made=made_on(), models=len(rows), packages=packages, pairs=len(pairs), fast=fast, older=older)
    parts = [lead, *_counts(rows, pairs), *_distribution(pairs), *_worst(pairs), *_refusals(rows)]
    parts += [*_kinds(kinds), *_ladders(ladders)]
    return "\n".join(parts).rstrip("\n") + "\n"


def _counts(rows, pairs):
    by_kind = Counter(kind for row in rows for kind in {kind for kind, _ in row["findings"]})
    low = [row for row in pairs if decibels_of(row) < LEAST_PICTURE]
    table = (("models", len(rows)), ("coded, decoded and compared", sum("measure" in row for row in rows)),
             ("refused with a code", sum(row["encode"]["exit"] in REFUSALS for row in rows)),
             ("internal errors", by_kind[INTERNAL]), ("longer than the limit of the run", by_kind[TOO_LONG]),
             ("reports that are no strict JSON", by_kind[NOT_JSON]), ("pairs of pictures", len(pairs)),
             (f"pairs under {LEAST_PICTURE:.0f} dB", len(low)), ("of these without a named loss", by_kind[PICTURE]),
             ('"no losses" beside a warning that something is lost', by_kind[UNSAID]),
             ("models with a thing that no report names", by_kind[UNNAMED]))
    formats = Counter(row["name"].rsplit(".", 1)[-1].lower() for row in rows)
    yield from ("| | |", "|---|---:|", *(f"| {name} | {count} |" for name, count in table), "")
    yield f"By format: {', '.join(f'{count} {name}' for name, count in formats.most_common())}.\n"


def _distribution(pairs):
    values = [decibels_of(row) for row in pairs]
    edges = [float("-inf"), *STEPS, float("inf")]
    yield from ("## Pairs\n", "| dB | pairs | of these with a named loss |", "|---|---:|---:|")
    for low, high in zip(edges, edges[1:], strict=False):
        inside = [row for row, value in zip(pairs, values, strict=True) if low <= value < high]
        words = f"under {high}" if low < 0 else f"{low} and more" if high > 1e9 else f"{low} to {high}"
        yield f"| {words} | {len(inside)} | {sum(bool(losses_of(row)) for row in inside)} |"
    yield f"| the same | {sum(value == float('inf') for value in values)} | |\n"


def _worst(pairs):
    seen = json.loads(SEEN.read_text(encoding="utf-8")) if SEEN.exists() else {}
    yield from (f"## The {WORST} worst pairs\n", "| model | flat | lit | all maps | what it is |", "|---|---:|---:|---:|---|")
    for row in sorted(pairs, key=decibels_of)[:WORST]:
        shown, losses = row["picture"], losses_of(row)
        figures = " | ".join("same" if shown[key] is None else f"{shown[key]:.1f}" for key in ("flat", "lit", "full"))
        words = seen.get(row["name"]) or (f"named: {_plain(losses[0])}" if losses else "")
        yield f"| {_short(row['name'])} | {figures} | {words} |"
    yield ""


def _refusals(rows):
    refused = Counter(_reason(row) for row in rows if row["encode"]["exit"] in REFUSALS)
    if refused:
        lines = [f"| {code} | {count} |" for code, count in refused.most_common()]
        yield from ("## Refused\n", "| code | models |", "|---|---:|", *lines, "")


def _reason(row):
    error = row["encode"]["report"].get("error") or {}
    return f"{error.get('code', 'none')}: {re.sub(r'[0-9]+', 'n', _plain(error.get('message', '')))[:90]}"


def _kinds(kinds):
    if not kinds:
        return
    forms = sorted({row["name"].split(": ")[0] for row in kinds})
    verdicts = sorted({row["verdict"] for row in kinds}, key=lambda verdict: ("ok", "named", "not shown", "FAULT").index(verdict)
                      if verdict in ("ok", "named", "not shown", "FAULT") else 9)
    yield from ("## Kinds\n", f"{len(kinds)} generated files in each of which one property is the only thing that shows "
                "(strangers/kinds.py).", "*ok*: the decoded GLB shows it; *named*: it does not, and a loss says so; *not "
                "shown*: the other program does not show it either.\n",
                f"| format | {' | '.join(verdicts)} |", "|---|" + "---:|" * len(verdicts))
    for form in forms:
        counts = Counter(row["verdict"] for row in kinds if row["name"].startswith(form + ": "))
        yield f"| {form} | {' | '.join(str(counts[verdict]) for verdict in verdicts)} |"
    rest = [row for row in kinds if row["verdict"] != "ok"]
    if rest:
        yield from ("", "| not ok | shown by | without it | decoded | |", "|---|---|---:|---:|---|")
    for row in rest:
        figures = " | ".join("" if row[key] is None else f"{row[key]:.1f}" for key in ("shows", "decoded"))
        words = ": ".join([row["verdict"], *map(_plain, row["losses"][:1])])
        yield f"| {row['name']} | {row['like']} | {figures} | {words} |"
    yield ""


def _ladders(ladders):
    by_name = {}
    for row in ladders:
        if "check" in row["encode"]["report"]:
            by_name.setdefault(row["name"].split("@")[0], {})[row["flags"][1]] = row
    if not by_name:
        return
    rates = sorted({rate for rungs in by_name.values() for rate in rungs})
    yield from ("## Ladders\n", "Bytes, and dB RGB of the encoder's check; each rate is to be better than the one before.\n",
                f"| model | {' | '.join(rates)} | rises |", "|---|" + "---:|" * len(rates) + "---|")
    for name, rungs in sorted(by_name.items()):
        points = [(rungs[rate]["bytes"]["stream"], rungs[rate]["encode"]["report"]["check"]["rgb"])
                  for rate in rates if rate in rungs]
        finite = [(size, float("inf") if value is None else float(value)) for size, value in points]
        rises = all(b[1] >= a[1] - 0.1 for a, b in zip(finite, finite[1:], strict=False))
        cells = " | ".join(f"{size:,} {'exact' if value == float('inf') else f'{value:.1f}'}" for size, value in finite)
        yield f"| {_short(name)} | {cells} | {'yes' if rises else '**no**'} |"
    yield ""


def _short(name):
    package, _, path = name.partition("/")
    return f"{package}: {path.rsplit('/', 1)[-1]}" if not name.startswith("@") else name.rsplit("/", 1)[-1]


def _plain(text):
    return text.replace("|", "/").replace("\n", " ")[:120]


def write_page(path, rows, kinds_file, ladders_file, packages):
    """Writes the page of rows, and of two files of rows that may be missing."""
    kinds, ladders = (read_rows(file) if file else [] for file in (kinds_file, ladders_file))
    path.write_text(page_of(rows, kinds, ladders, packages), encoding="utf-8")
