"""Findings about a stream: rows by severity, a few of each code in full, all of them counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..bitstream.units import Unit
from ..errors import EXIT_DIFFERS, EXIT_LIMIT, EXIT_OK, EXIT_STREAM, EXIT_SUPPORT, TexfError
from ..findings import BY_CODE, ERROR, SEVERITIES, WARNING

MOST_OF_A_CODE = 100  # rows that are kept in full; further ones are counted
MOST_LETTERS = 200  # of a value that is a list or a text
# The worst comes first. A broken rule is broken for every decoder; what one does not know or will not hold, another may.
WORST_FIRST = (EXIT_STREAM, EXIT_SUPPORT, EXIT_LIMIT)


@dataclass(frozen=True)
class Oddity:
    """A finding that is not an error: a warning or a note. code: TXF-W.. of findings.py; the other fields: as of a TexfError."""

    code: str
    message: str
    clause: str | None = None
    offset: int | None = None
    value: Any = None
    allowed: Any = None


class Listing:
    """Findings about a stream so far. units: of the stream; the rows say in which of them each finding is."""

    def __init__(self, units: Sequence[Unit] = ()) -> None:
        self.units = units
        self.rows: dict[str, list[dict]] = {severity: [] for severity in SEVERITIES}
        self.of_code: Counter[str] = Counter()
        self.blamed: set[int] = set()  # numbers of units with an error

    def error(self, error: TexfError, number: int | None = None) -> None:
        """Add an error. number: index of its unit in units; if None, the unit that contains the error's offset."""
        self.blamed |= set() if number is None else {number}
        self._add(error.code, error.message, error.details, number)

    def oddity(self, oddity: Oddity, number: int | None = None) -> None:
        """Add a warning or note. number: index of its unit in units; if None, the unit that contains its offset."""
        self._add(oddity.code, oddity.message, vars(oddity), number)

    def _add(self, code, message, details, number):
        self.of_code[code] += 1
        if self.of_code[code] > MOST_OF_A_CODE:
            return
        row = BY_CODE[code]
        offset = details.get("offset")
        number = self._unit_at(offset) if number is None else number
        unit = None if number is None else self.units[number]
        self.rows[row.severity].append({
            "code": code, "severity": row.severity, "clause": details.get("clause"), "unit": number,
            "unit_type": unit and unit.type, "unit_name": unit and unit.name,
            "offset": unit.start if offset is None and unit is not None else offset,
            "value": _plain(details.get("value")), "allowed": _plain(details.get("allowed")), "message": message,
            "remedy": row.remedy})

    def _unit_at(self, offset):
        """Number of the whole unit that contains an offset, or None."""
        return next((n for n, u in enumerate(self.units) if offset is not None and u.start <= offset < u.stop), None)

    @property
    def findings(self) -> list[dict]:
        """All rows: errors, warnings, notes, each in the order of clause 9.2."""
        return [row for severity in SEVERITIES for row in self.rows[severity]]

    @property
    def counts(self) -> dict[str, int]:
        """Number of findings of each severity, including those that are left out of findings()."""
        total = dict.fromkeys(SEVERITIES, 0)
        for code, count in self.of_code.items():
            total[BY_CODE[code].severity] += count
        return total

    @property
    def left_out(self) -> dict[str, int]:
        """Number of findings by code that are left out of findings()."""
        return {code: count - MOST_OF_A_CODE for code, count in self.of_code.items() if count > MOST_OF_A_CODE}

    def exit_code(self, strict: bool = False) -> int:
        """Return the exit code of texf-validate for the worst finding. strict: whether warnings count."""
        codes = {BY_CODE[code].exit_code for code in self.of_code if BY_CODE[code].severity == ERROR}
        worst = next((code for code in WORST_FIRST if code in codes), EXIT_OK)
        return EXIT_DIFFERS if worst == EXIT_OK and strict and self.rows[WARNING] else worst


def _plain(value):
    """A value for JSON, truncated if it is long."""
    if value is None or isinstance(value, bool | int | str) and len(str(value)) <= MOST_LETTERS:
        return value
    if isinstance(value, float):
        return value if abs(value) < float("inf") else str(value)
    text = str(value)
    if len(text) > MOST_LETTERS:
        return text[:MOST_LETTERS] + "..."
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else text
