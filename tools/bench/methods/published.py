"""Curves that others have published, read from CSV to stand in tables beside what was run here. No method: nothing is coded.

The first line names the columns: method, asset, source, "bytes" or "bpp", and one measure as the tables name it
(results.MEASURES; "psnr" is image PSNR RGB); others are passed over. A row is a point, its source says where it was published.
With bpp there is a column "count" of the points or pixels that it is over, so that all rates are bytes. The material is other
than ours unless the asset is measured here too, and even then programs and machines are others: tables mark these rows.
"""

import csv
import math

MOST_ROWS = 100_000
RATES, COUNT = ("bytes", "bpp"), "count"
SHORT = {"psnr": "image PSNR RGB"}


def read_published(path):
    """The points of a CSV file: [{"method", "asset", "rate", "measure", "quality", "source"}], rate in bytes and quality as
    numbers. OSError; ValueError: a sentence, with the line that is wrong."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))[: MOST_ROWS + 1]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"it is no text of comma-separated values: {error}") from None
    if not rows or len(rows) > MOST_ROWS:
        raise ValueError(f"there must be a line of names and 1 to {MOST_ROWS} rows")
    names = {name.strip().lower(): name for name in rows[0] if name}
    rate, measure = _one(names, RATES), _one(names, _measures())
    for name in ("method", "asset", "source", *([COUNT] if rate == "bpp" else [])):
        if name not in names:
            raise ValueError(f"there is no column {name}, only {', '.join(names)}")
    points = []
    for line, row in enumerate(rows, 2):
        told = {name: _text(line, row, names, name) for name in ("method", "asset", "source")}
        size = _number(line, row, names, rate, 0) * (1 if rate == "bytes" else _number(line, row, names, COUNT, 0) / 8)
        points.append(told | {"rate": size, "measure": _measures()[measure],
                              "quality": _number(line, row, names, measure, -math.inf)})
    return points


def _measures():
    """Names of measures as the tables spell them, by the same in small letters, and short ones."""
    from tools.bench.results import MEASURES

    return {name.lower(): name for name in MEASURES} | SHORT


def _one(names, known):
    """The one name among known that a column has."""
    found = [name for name in known if name in names]
    if len(found) != 1:
        raise ValueError(f"there must be one column of {', '.join(known)}, and there are {len(found)}")
    return found[0]


def _text(line, row, names, name):
    value = (row[names[name]] or "").strip()
    if not value:
        raise ValueError(f"line {line}: {name} is empty")
    return value


def _number(line, row, names, name, above):
    given = row[names[name]]
    try:
        value = float(given)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value) or value <= above:
        raise ValueError(f"line {line}: {name} must be a number{' above 0' if above == 0 else ''}, not {given!r}")
    return value
