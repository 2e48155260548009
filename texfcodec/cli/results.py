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
    """results.jsonl in a folder for results: one JSON line per asset; the last line of a stream counts.

    lines: {name of a stream: its line}, as the file was when this object was made. A truncated line is ignored.
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
        """Append a row to the file as one line of JSON. Raises OSError and leaves the file unchanged if the disk is full."""
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
        """Return the row of an asset that an earlier run encoded from the same files, options and version and whose stream is
        unchanged; else None. words: the asset's options as words of a command line."""
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
    """Return the SHA-256 of a file's bytes in hexadecimal. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
