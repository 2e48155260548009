"""What a batch comes to: bytes in and out, median and worst PSNR, assets with warnings and losses; and what an asset lost."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from ..core.colour_error import in_decibels

MEASURES = {"y": "Y", "rgb": "RGB"}  # of an asset's check, and what they are called


@dataclass
class Totals:
    """Of the assets that have streams: bytes of their sources and streams; psnr: by measure, (dB, name of the asset), infinite
    where it is exact; warned, lossy: assets with warnings, and with properties that are not coded; failed: how many have none."""

    assets: int = 0
    source_bytes: int = 0
    stream_bytes: int = 0
    warned: int = 0
    lossy: int = 0
    failed: int = 0
    psnr: dict[str, list[tuple[float, str]]] = field(default_factory=lambda: {name: [] for name in MEASURES})

    def add(self, row: dict[str, Any]) -> None:
        """Takes in a line of results.jsonl."""
        if "error" in row:
            self.failed += 1
            return
        result = row.get("result") or {}
        self.assets += 1
        self.source_bytes += result.get("source", {}).get("bytes", 0)
        self.stream_bytes += row["stream"]["bytes"]
        self.warned += bool(result.get("warnings"))
        self.lossy += bool(result.get("dropped"))
        check = result.get("check") or {}
        for name in MEASURES if check.get("visible", True) else ():
            if name in check:
                self.psnr[name].append((math.inf if check[name] is None else check[name], row["asset"]))

    def facts(self) -> dict[str, Any]:
        """For --json; a PSNR of None is exact."""
        return {"assets": self.assets, "failed": self.failed,
                "source_bytes": self.source_bytes, "stream_bytes": self.stream_bytes,
                "psnr": {name: self._of_psnr(found) for name, found in self.psnr.items() if found},
                "assets_with_warnings": self.warned, "assets_with_losses": self.lossy}

    def _of_psnr(self, found):
        worst, asset = min(found)
        return {"median": median(value for value, _ in found), "worst": worst, "worst_asset": asset, "assets": len(found)}

    def _in_words(self, decibels):
        """A PSNR; nothing is called exact where assets are as they were read, without their losses."""
        return "as read" if math.isinf(decibels) and self.lossy else in_decibels(None if math.isinf(decibels) else decibels)

    def lines(self) -> Iterator[str]:
        """For people."""
        if not self.assets:
            return
        times = f", {self.source_bytes / self.stream_bytes:.3g} times smaller" if self.stream_bytes < self.source_bytes else ""
        yield f"{self.source_bytes} bytes became {self.stream_bytes}{times}"
        read = "; of what was read, without the losses" if self.lossy else ""
        for name, found in self.psnr.items():
            if found:
                of = self._of_psnr(found)
                middle, worst = (self._in_words(of[which]) for which in ("median", "worst"))
                yield f"PSNR {MEASURES[name]}: median {middle}, worst {worst} ({of['worst_asset']}){read}"
        yield f"{_assets(self.warned)} with warnings, {_assets(self.lossy)} with losses"


def _assets(count):
    return f"{count} asset{'s' * (count != 1)}"


def losses_of(result: dict[str, Any]) -> dict[str, Any]:
    """What the line of an asset says of its losses: {"losses": {"count", "first"}, "warnings": the same}, without what there is
    none of."""
    found = {"losses": result.get("dropped") or [], "warnings": result.get("warnings") or []}
    return {name: {"count": len(texts), "first": texts[0]} for name, texts in found.items() if texts}


def losses_in_words(named: dict[str, Any]) -> str:
    """losses_of() for people: "; 2 losses, the first: animation 'walk'"."""
    parts = []
    for name, of in named.items():
        word = name if of["count"] != 1 else {"losses": "loss", "warnings": "warning"}[name]
        parts.append(f"; {of['count']} {word}{', the first' * (of['count'] > 1)}: {of['first']}")
    return "".join(parts)
