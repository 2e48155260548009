"""Interface between the driver (run.py) and its parts (fit.py, frames.py, decode.py): a part is a module with one function

    def measure(context: Context) -> Iterator[Row]: ...

The driver runs the parts in order, writes the JSON after every row, and skips rows that an earlier run has written. A part asks
`context.wants(key)` before it measures a row, so that work already done costs nothing, and `context.left()` before long work. It
yields a row as soon as it is measured. An exception ends the part alone: the driver writes it as the row "<part>/error" and goes
on with the next part. A part imports torch, cupy, moderngl and the like inside measure(), never at the top.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class Row:
    """One measured row. key: "<part>/<asset>/<what>/<how>", unique; figures: JSON-ready facts (numbers with their unit in the
    name, e.g. "milliseconds_median", "seconds", "psnr_db"; strings; "skipped": a sentence where nothing was measured)."""

    key: str
    figures: dict[str, Any]


@dataclass
class Context:
    """What a part needs. inputs: folder that prepare.py has filled; work: folder for what is no result; out: folder for pictures,
    no folders below, 16 MiB a file; scale: share of the work, 1 in full, 0.001 in tests (fewer steps, smaller pictures, fewer
    repeats); device: "cuda" or "cpu"; done: figures of rows of earlier runs by key; deadline: of time.perf_counter()."""

    inputs: Path
    out: Path
    scale: float = 1.0
    device: str = "cuda"
    done: dict[str, dict[str, Any]] = field(default_factory=dict)
    deadline: float = float("inf")
    work: Path = Path("out/gpu_work")

    def wants(self, key: str) -> bool:
        """Whether no earlier run has measured the row."""
        return key not in self.done

    def wants_any(self, keys: Iterable[str]) -> bool:
        """Whether a row of several is missing."""
        return any(self.wants(key) for key in keys)

    def left(self) -> float:
        """Seconds until the driver has to end."""
        return self.deadline - time.perf_counter()

    def scaled(self, count: int, least: int = 1) -> int:
        """A count of steps, repeats or pixels at this scale."""
        return max(least, round(count * self.scale))
