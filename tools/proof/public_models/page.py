"""docs/reports/public_models.md: what the rows of a run, of pairs, of kinds and of ladders say, in tables."""

import json
import math
import re
from collections import Counter
from pathlib import Path

from texfcodec.batch.tasks import package_code
from tools.bench.provenance import made_on
from tools.proof.public_models.judge import (
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

STEPS = (-math.inf, 20, 25, 30, 35, 40, 50, math.inf)  # dB
SEEN = Path(__file__).with_name("seen.json")  # {name: what somebody who looked at the pair saw}
WORST, VERDICTS = 20, ("ok", "named", "not shown", "FAULT", "INTERNAL ERROR")
HEAD = """# Public models

Made by `make -C tools public-models` (tools/proof/public_models) {made}; {older} of its rows are of an earlier state
of the package.

{models} models from {packages} packages of public registries, by name, version and hash; none of their files is in this
repository. All were new to this project when they were added. Each is coded at r04 ({fast} of them, the larger ones, with
--effort fast), decoded to GLB and compared with its source. {pairs} pairs of pictures were drawn by three.js: the source by its
own loader of the format and the decoded GLB, from the same two sides, in flat colours, in light and with all maps. A pair has
the least of these dB, over the pixels that either of the two covers. Of a source without normals the flat picture alone counts,
because each program makes up its own. Numbers of materials are taken as linear where the encoder's remark says so. A loss is
named where the result line lists it.
"""


def _table(head, rows, rule):
    return [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(map(str, row))} |" for row in rows), ""]


def decibels_of(row):
    """Return the least PSNR in dB of a row's pictures; None without pictures."""
    shown = row.get("picture")
    return least_picture(shown) if shown and "error" not in shown else None


def page_of(rows, kinds, ladders, packages):
    """Return the Markdown page. rows: of models, with pictures; kinds, ladders: rows of these runs; packages: their number."""
    pairs = [row for row in rows if decibels_of(row) is not None]
    lead = HEAD.format(made=made_on(), models=len(rows), packages=packages, pairs=len(pairs),
                       fast=sum("fast" in row.get("flags", ()) for row in rows),
                       older=sum(row.get("code") != package_code() for row in [*rows, *kinds]))
    parts = [lead, *_counts(rows, pairs), *_pairs(pairs), *_refusals(rows), *_kinds(kinds), *_ladders(ladders)]
    return "\n".join(parts).rstrip("\n") + "\n"


def _counts(rows, pairs):
    by_kind = Counter(kind for row in rows for kind in {kind for kind, _ in row["findings"]})
    formats = Counter(row["name"].rsplit(".", 1)[-1].lower() for row in rows)
    return [*_table(("", ""), (
        ("models", len(rows)), ("coded, decoded and compared", sum("measure" in row for row in rows)),
        ("refused with a code", sum(row["encode"]["exit"] in REFUSALS for row in rows)), ("internal errors", by_kind[INTERNAL]),
        ("longer than the limit of the run", by_kind[TOO_LONG]), ("reports that are no strict JSON", by_kind[NOT_JSON]),
        ("pairs of pictures", len(pairs)),
        (f"pairs under {LEAST_PICTURE:.0f} dB", sum(decibels_of(row) < LEAST_PICTURE for row in pairs)),
        ("of these without a named loss", by_kind[PICTURE]),
        ('"no losses" beside a warning that something is lost', by_kind[UNSAID]),
        ("models with a thing that no report names", by_kind[UNNAMED])), "|---|---:|"),
        f"By format: {', '.join(f'{count} {name}' for name, count in formats.most_common())}.\n"]


def _pairs(pairs):
    """How far apart pairs of pictures are, and the worst of them."""
    words, body = ["under 20", *(f"{a} to {b}" for a, b in zip(STEPS[1:-2], STEPS[2:-1], strict=True)), "50 and more"], []
    for name, low, high in zip(words, STEPS, STEPS[1:], strict=False):
        inside = [row for row in pairs if low <= decibels_of(row) < high]
        body.append((name, len(inside), sum(bool(losses_of(row)) for row in inside)))
    body.append(("the same", sum(decibels_of(row) == math.inf for row in pairs), ""))
    seen, worst = json.loads(SEEN.read_text(encoding="utf-8")) if SEEN.exists() else {}, []
    for row in sorted(pairs, key=decibels_of)[:WORST]:
        shown, losses = row["picture"], losses_of(row)
        figures = ("same" if shown[key] is None else f"{shown[key]:.1f}" for key in ("flat", "lit", "full"))
        worst.append((_short(row["name"]), *figures, seen.get(row["name"]) or (f"named: {_plain(losses[0])}" if losses else "")))
    return ["## Pairs\n", *_table(("dB", "pairs", "of these with a named loss"), body, "|---|---:|---:|"),
            f"## The {WORST} worst pairs\n",
            *_table(("model", "flat", "lit", "all maps", "what it is"), worst, "|---|---:|---:|---:|---|")]


def _refusals(rows):
    def reason(row):
        error = row["encode"]["report"].get("error") or {}
        return f"{error.get('code', 'none')}: {re.sub(r'[0-9]+', 'n', _plain(error.get('message', '')))[:90]}"

    refused = Counter(reason(row) for row in rows if row["encode"]["exit"] in REFUSALS)
    return ["## Refused\n", *_table(("code", "models"), refused.most_common(), "|---|---:|")] if refused else []


def _kinds(kinds):
    if not kinds:
        return []
    count = Counter((row["name"].split(": ")[0], row["verdict"]) for row in kinds)
    verdicts = [verdict for verdict in VERDICTS if any(row["verdict"] == verdict for row in kinds)]
    body = [(form, *(count[form, verdict] for verdict in verdicts)) for form in sorted({form for form, _ in count})]
    rest = [(row["name"], row["like"], *("" if row[key] is None else f"{row[key]:.1f}" for key in ("shows", "decoded")),
             ": ".join([row["verdict"], *map(_plain, row["losses"][:1])])) for row in kinds if row["verdict"] != "ok"]
    return ["## Kinds\n", f"{len(kinds)} generated files in each of which one property is the only thing that shows "
            "(tools/proof/public_models/kinds.py).", "*ok*: the decoded GLB shows it; *named*: it does not, and a loss says so; "
            "*not shown*: the other program does not show it either.\n",
            *_table(("format", *verdicts), body, "|---|" + "---:|" * len(verdicts)),
            *(_table(("not ok", "shown by", "without it", "decoded", ""), rest, "|---|---|---:|---:|---|") if rest else [])]


def _ladders(ladders):
    models, body = {}, []
    for row in ladders:
        if "check" in row["encode"]["report"]:
            models.setdefault(row["name"].split("@")[0], {})[row["flags"][1]] = row
    rates = sorted({rate for rungs in models.values() for rate in rungs})
    for name, rungs in sorted(models.items()):
        measured = [rungs[rate] for rate in rates if rate in rungs]
        values = [row["encode"]["report"]["check"]["rgb"] for row in measured]
        values = [math.inf if value is None else float(value) for value in values]
        points = [(row["bytes"]["stream"], value) for row, value in zip(measured, values, strict=True)]
        rises = all(b[1] >= a[1] - 0.1 for a, b in zip(points, points[1:], strict=False))
        body.append((_short(name), *(f"{size:,} {'exact' if value == math.inf else f'{value:.1f}'}" for size, value in points),
                     "yes" if rises else "**no**"))
    return ["## Ladders\n", "Bytes, and dB RGB of the encoder's check; each rate is to be better than the one before.\n",
            *_table(("model", *rates, "rises"), body, "|---|" + "---:|" * len(rates) + "---|")] if body else []


def _short(name):
    package, _, path = name.partition("/")
    return f"{package}: {path.rsplit('/', 1)[-1]}" if not name.startswith("@") else name.rsplit("/", 1)[-1]


def _plain(text):
    return text.replace("|", "/").replace("\n", " ")[:120]
