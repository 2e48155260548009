"""The rows of a run: one JSON object a line, the last of a name counts."""

import json


def read_rows(path):
    """Return the rows of a file of JSON lines, of each name the last; [] without the file. Truncated lines are skipped."""
    rows = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        rows[row["name"]] = row
    return list(rows.values())


def add_row(path, row):
    """Append a row to a file of JSON lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row, allow_nan=False) + "\n")


def strict_json(text):
    """Return the JSON object of a text, or a sentence if it is not one: NaN and Infinity are not JSON."""

    def refuse(name):
        raise ValueError(f"{name} is not JSON")

    try:
        value = json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return str(error)[:200]
    return value if isinstance(value, dict) else "not an object"
