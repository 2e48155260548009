"""The rows of a run: one JSON object a line, the last of a name counts."""

import json


def read_rows(path):
    """[row] of a file, in the order of their first line; none where it is not there. A line that was cut off is passed over."""
    rows = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        rows[row["name"]] = row
    return list(rows.values())


def add_row(path, row):
    """Appends a row."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row, allow_nan=False) + "\n")


def strict_json(text):
    """The JSON object of a text, or a sentence about why it is none: NaN and Infinity are not JSON."""

    def refuse(name):
        raise ValueError(f"{name} is not JSON")

    try:
        value = json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return str(error)[:200]
    return value if isinstance(value, dict) else "not an object"
