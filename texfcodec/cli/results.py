"""results.jsonl of texf-enc --batch: a line for each asset, appended whole, and whether an asset needs no more work."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any

from .. import __version__
from ..core.json_text import json_text
from .catalogue import RESULTS, Asset


class Results:
    """The results in a folder; the last line of a stream counts.

    lines: {stream: line of JSON}, as at the beginning. A truncated line is ignored.
    """

    def __init__(self, out: Path) -> None:
        self.out, self.path, line = out, out / RESULTS, b"\n"
        self.lines: dict[str, bytes] = {}
        with open(self.path, "rb") if self.path.exists() else io.BytesIO() as file:
            for line in file:
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    self.lines[json.loads(line)["out"]] = line
        self._is_whole = line.endswith(b"\n")

    def append(self, row: dict[str, Any]) -> None:
        """Appends a line, or raises OSError and leaves the file unchanged."""
        line = json_text(row).encode() + b"\n"
        line, number = line if self._is_whole else b"\n" + line, os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            size = os.fstat(number).st_size
            if os.write(number, line) != len(line):
                os.ftruncate(number, size)
                os.write(number, line)  # says what is wrong
                raise OSError(f"{self.path} cannot be written")
        finally:
            os.close(number)
        self._is_whole = True

    def finished(self, asset: Asset, words: tuple[str, ...]) -> dict[str, Any] | None:
        """The line of an asset that is already encoded from the same files, options and version, if its stream is unchanged; else
        None."""
        row = json.loads(self.lines.get(asset.out, b"{}"))
        if "stream" not in row or asset.error:
            return None
        same_request = (row.get("options"), row.get("package"), row.get("asset")) == (list(words), __version__, asset.name)
        stream = self.out / asset.out
        try:
            same = same_request and stream.stat().st_size == row["stream"]["bytes"] \
                and sha256_of(stream) == row["stream"]["sha256"] \
                and all(sha256_of(asset.path.parent / name) == digest for name, digest in row["files"].items())
        except (OSError, KeyError, TypeError, AttributeError):
            return None
        return row if same else None


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
