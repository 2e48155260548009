"""Totals of a batch: bytes in and out, median and worst PSNR, assets with warnings and losses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from ..core.colour_error import in_decibels
from ..report import plural

MEASURES = {"y": "Y", "rgb": "RGB"}  # of an asset's check, and what they are called


@dataclass
class Totals:
    """Totals of a batch.

    assets: number with streams; source_bytes, stream_bytes: their sums; psnr: by measure, (dB, name of the asset) of each,
    infinite if exact; warned, lossy: number with warnings, and with dropped properties; failed: number without a stream.
    """

    assets: int = 0
    source_bytes: int = 0
    stream_bytes: int = 0
    warned: int = 0
    lossy: int = 0
    failed: int = 0
    psnr: dict[str, list[tuple[float, str]]] = field(default_factory=lambda: {name: [] for name in MEASURES})

    def add(self, row: dict[str, Any]) -> None:
        """Add an asset to the totals. row: its line of results.jsonl, as a dict."""
        if "error" in row:
            self.failed += 1
            return
        result = row.get("result") or {}
        self.assets += 1
        self.source_bytes += result.get("source", {}).get("bytes", 0)
        self.stream_bytes += row["stream"]["bytes"]
        self.warned += bool(result.get("warnings"))
        self.lossy += bool(result.get("dropped"))
        checks = [part.get("check") or {} for part in result.get("streams", [result])]  # a scene has one for each stream
        for name in MEASURES:
            values = [check[name] for check in checks if check.get("visible", True) and name in check]
            if values:
                self.psnr[name].append((min(math.inf if value is None else value for value in values), row["asset"]))

    def facts(self) -> dict[str, Any]:
        """Facts for --json; a PSNR of None is exact."""
        return {"assets": self.assets, "failed": self.failed,
                "source_bytes": self.source_bytes, "stream_bytes": self.stream_bytes,
                "psnr": {name: self._of_psnr(values) for name, values in self.psnr.items() if values},
                "assets_with_warnings": self.warned, "assets_with_losses": self.lossy}

    def _of_psnr(self, values):
        worst, asset = min(values)
        return {"median": median(value for value, _ in values), "worst": worst, "worst_asset": asset, "assets": len(values)}

    def _in_words(self, decibels):
        """A PSNR in words; infinity is not called exact if some assets lost something when they were read."""
        return "as read" if math.isinf(decibels) and self.lossy else in_decibels(None if math.isinf(decibels) else decibels)

    def lines(self) -> Iterator[str]:
        """Lines for people."""
        if not self.assets:
            return
        times = f", {self.source_bytes / self.stream_bytes:.3g} times smaller" if self.stream_bytes < self.source_bytes else ""
        yield f"{self.source_bytes} bytes became {self.stream_bytes}{times}"
        read = "; of what was read, without the losses" if self.lossy else ""
        for name, values in self.psnr.items():
            if values:
                of = self._of_psnr(values)
                middle, worst = (self._in_words(of[which]) for which in ("median", "worst"))
                yield f"PSNR {MEASURES[name]}: median {middle}, worst {worst} ({of['worst_asset']}){read}"
        warned, lossy = (plural(count, "asset", "assets") for count in (self.warned, self.lossy))
        yield f"{warned} with warnings, {lossy} with losses"


def losses_in_words(result: dict[str, Any]) -> str:
    """Return the number and the first of an asset's losses and warnings, for people: "; 2 losses, the first: animation 'walk'".
    result: the JSON result of texf-enc."""
    lists = (result.get("dropped"), "loss", "losses"), (result.get("warnings"), "warning", "warnings")
    return "".join(f"; {plural(len(texts), singular, many)}{', the first' * (len(texts) > 1)}: {texts[0]}"
                   for texts, singular, many in lists if texts)
