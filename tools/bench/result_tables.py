"""Results as CSV, and as a report of blocks that become Markdown.

A block is (kind, content): "h1", "h2", "h3" and "p" with a text, "ul" with texts, "table" with (head, lines, number of columns
at the left that are no numbers).
"""

import csv
import math
import textwrap

import numpy as np

from texfcodec.core.colour_error import EXACT
from tools.bench.differences import summary
from tools.bench.results import PSNRS, at, measures_of, rate_of, value_of

SUMMARIES = {"mean": np.mean, "median": np.median}


def write_csv(rows, path):
    """Write rows (dicts of jobs) to a CSV file, a row per job; columns are in the order of their first appearance."""
    rows = [flat(row) for row in rows]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def flat(row, prefix=""):
    """Return a nested dict as a flat one with dotted keys, each after prefix; lists become text."""
    out = {}
    for key, value in row.items():
        if isinstance(value, dict):
            out |= flat(value, f"{prefix}{key}.")
        else:
            out[prefix + key] = "; ".join(map(str, value)) if isinstance(value, list) else value
    return out


def markdown_table(head, lines, texts=1):
    """Return the lines of a Markdown table. head: titles; lines: rows of cells; texts: number of left columns that hold text."""
    rule = ["---"] * texts + ["---:"] * (len(head) - texts)
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |" for cells in (head, rule, *lines)]


def wrapped(lines):
    """Yield lines of Markdown with prose wrapped at 130 columns; tables, pictures and headings stay as they are."""
    for line in lines:
        if line.startswith(("|", "#", "!")) or len(line) <= 130:
            yield line
        else:
            yield from textwrap.wrap(line, 130, subsequent_indent="  " if line.startswith("- ") else "", break_long_words=False,
                                     break_on_hyphens=False)


def as_markdown(blocks):
    """Return the Markdown of a report. blocks: (kind, content), where kind is "h1" to "h3", "p", "table" or "ul"."""
    marks, lines = {"h1": "# ", "h2": "## ", "h3": "### ", "p": ""}, []
    for kind, content in blocks:
        if kind in marks:
            lines += [marks[kind] + content, ""]
        elif kind == "table":
            lines += [*markdown_table(*content), ""]
        elif kind == "ul":
            lines += [*(f"- {text}" for text in content), ""]
    return "\n".join(lines)


def report(rows, missing, pairs, kind):
    """Return the blocks of results.md, for as_markdown(). missing: of read_missing(); pairs: [Pair]; kind: see rate_of()."""
    codes = sorted({f"{row['package']} {row['code']}" for row in rows})
    blocks = [("h1", "Rate points"), ("p", f"{len(rows)} jobs; code {', '.join(codes)}"
                                      + ("; **not all by the same code**" if len(codes) > 1 else ""))]
    for asset in dict.fromkeys(row["asset"] for row in rows):
        blocks += [("h2", asset), ("table", asset_table([row for row in rows if row["asset"] == asset]))]
    for other in dict.fromkeys(pair.other for pair in pairs):
        blocks += comparison([pair for pair in pairs if pair.other == other], kind)
    return blocks + ([("h2", "Missing"), ("table", missing_table(missing))] if missing else [])


def asset_table(rows):
    """Return (head, lines, texts) of the table of one asset's rows, by group and bytes."""
    measures = measures_of(rows)
    head = ["setting", "group", "bytes", "geometry", "texture", *measures, "encode, s", "decode, s", "encode, MB", "decode, MB"]
    lines = []
    for row in sorted(rows, key=lambda r: (r["group"], r["bytes"]["total"])):
        sizes = [row["bytes"]["total"], row["bytes"].get("geometry", 0), rate_of(row, "texture")]
        seconds = [_number(at(row, ("seconds", side, "total")), ".2f") for side in ("encode", "decode")]
        memory = [_number(at(row, ("memory", side, "peak")), ".0f", 1e-6) for side in ("encode", "decode")]
        quality = [_measured(row, measure) for measure in measures]
        lines.append([row["setting"], row["group"], *(f"{size:,}" for size in sizes), *quality, *seconds, *memory])
    return head, lines, 2


def missing_table(missing):
    """Return (head, lines, texts) of the table of read_missing(): jobs of a group that lack the same share a line."""
    jobs = {}
    for row in missing:
        jobs.setdefault(tuple(row[key] for key in ("group", "method", "state", "reason")), []).append(row)
    lines = [[group, method, state, ", ".join(dict.fromkeys(row["asset"] for row in rows)), len(rows), reason]
             for (group, method, state, reason), rows in jobs.items()]
    return ["group", "method", "state", "assets", "jobs", "reason"], lines, 6


def _measured(row, measure):
    value = value_of(row, measure)
    return EXACT if value is not None and math.isinf(value) else _number(value, ".2f" if measure in PSNRS else ".4f")


def _number(value, form, factor=1):
    return "-" if value is None else format(value * factor, form)


def comparison(pairs, kind):
    """Return the blocks of the BD-rates of pairs with the same anchor: for one pair a table by asset, for more a table per
    measure with a line per pair."""
    tables = {pair.name: pair.differences(kind) for pair in pairs}
    names, other = list(tables), pairs[0].other
    blocks = [("h2", f"BD-rate: {names[0]} against {other}" if len(names) == 1 else f"BD-rate against {other}"),
              ("p", f"Percent of {kind} bytes at equal quality; negative needs fewer. In brackets the part of both curves' range "
               "of quality that overlaps, or the number of assets in a mean or median of not all.")]
    if not any(tables.values()):
        return [*blocks, ("p", "The two have no asset in common.")]
    if any("SSIM" in row for table in tables.values() for row in table.values()):
        blocks.append(("p", "SSIM is compared in decibels, -10 log10(1 - SSIM)."))
    blocks += [("table", _by_asset(tables[names[0]]))] if len(names) == 1 else _by_measure(tables)
    notes = {}
    for name, table in tables.items():
        for asset, row in table.items():
            for measure, difference in row.items():
                if difference.reason:
                    where = asset if len(names) == 1 else f"{name}, {asset}"
                    notes.setdefault(f"{where}: {difference.reason}", []).append(measure)
    return blocks + ([("ul", [f"none for {text} ({', '.join(measures)})" for text, measures in notes.items()])] if notes else [])


def _by_asset(table):
    """A line per asset, a column per measure."""
    measures = list(dict.fromkeys(measure for row in table.values() for measure in row))
    lines = [[asset, *(_percent(row[m]) for m in measures)] for asset, row in table.items()]
    for name, of in SUMMARIES.items():
        lines.append([f"**{name}**", *(_summary([row[m] for row in table.values()], of) for m in measures)])
    return ["asset", *measures], lines


def _by_measure(tables):
    """Blocks: for each measure a line per group, a column per asset."""
    measures = list(dict.fromkeys(measure for table in tables.values() for row in table.values() for measure in row))
    assets, blocks = list(dict.fromkeys(asset for table in tables.values() for asset in table)), []
    for measure in measures:
        cells = []
        for name, table in tables.items():
            differences = [table.get(asset, {}).get(measure) for asset in assets]
            cells.append([name, *map(_percent, differences), *(_summary(differences, of) for of in SUMMARIES.values())])
        blocks += [("h3", measure), ("table", (["group", *assets, *SUMMARIES], cells))]
    return blocks


def _percent(difference):
    if difference is None or difference.percent is None:
        return "-"
    return f"{difference.percent:+.2f} ({100 * difference.overlap:.0f} %)"


def _summary(differences, of):
    value, number = summary([difference for difference in differences if difference is not None], of)
    return _number(value, "+.2f") + (f" ({number})" if 0 < number < len(differences) else "")
