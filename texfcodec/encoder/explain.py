"""The seconds of an encode by stage, and the costs and gains of neighbouring settings: settings one step away, encoded and
measured."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..codecs import codec_of
from ..decoder import decode_stream
from ..errors import TexfError
from ..limits import UNLIMITED
from ..metrics.bd_rate import difference_at
from ..metrics.views import KeptViews, ViewSettings
from ..options import EFFORTS, RATES, DecodeOptions, EncodeOptions
from ..render.environment import DAYLIGHT
from ..report import Report
from .encode import Encoder
from .write import write

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .write import Encoded

VIEWS, SIZE = 8, 384  # of the pictures in daylight: a source's three or four and each stream's take less than an encode
ENCODES = 6  # seconds for neighbours where none are given, in encodes of what was asked for
SECONDS = {"fast": 0.7, "balanced": 1.0}  # of an effort over those of balanced, about
CURVE = (-4, 4, 12)  # QPs from that of the stream, for the curve that bytes at equal quality are read from
QP_STEP, BITS_STEP = 4, 2
K_STEP = 1.5
NOISE, GAIN = 0.05, 0.1  # share of seconds within which two encodes count as equally fast; percent of bytes that count
# Verdicts on a change: what it does to seconds and to bytes at equal quality.
BETTER, BUYS, SAVES, DOMINATED, EQUAL = "better", "buys", "saves", "dominated", "equal"


@dataclass(frozen=True)
class Neighbour:
    """A setting one step away from the requested ones. change: the EncodeOptions that differ; factor: its seconds over those of
    the base, a guess that only decides whether there is time for it."""

    change: dict
    factor: float = 1.0

    @property
    def name(self) -> str:
        """The change as flags of the command line."""
        flags = {name: name.replace("_", "-") for name in self.change} | {"max_error": "near-lossless"}
        return " ".join(f"--{flags[name]} {value}" for name, value in self.change.items() if value is not False)

    @property
    def is_rate(self) -> bool:
        """True if the change is another point of the rate curve, which no setting at this rate is compared with."""
        return self.change.keys() <= {"rate", "qp"}


def changed(options: EncodeOptions, **changes: object) -> EncodeOptions:
    """Return a copy of the options with changed fields and without a target. Fields that were left to the encoder are so
    again."""
    return options.without_target().changed(**{"measure": False, "checkpoint": None, **changes})


def as_made(options: EncodeOptions, encoded: Encoded) -> EncodeOptions:
    """Return options that repeat an encode without a search: if they hold a target, with the whole QP that the search ended
    at."""
    if options.target_bytes is None and options.target_psnr is None:
        return changed(options)
    return changed(options, qp=encoded.qp)


def neighbours_of(options: EncodeOptions, encoded: Encoded) -> Iterator[Neighbour]:
    """Yield the Neighbours of the options that matter for an encoded stream, the most informative first: the other efforts, the
    neighbouring rates, and settings one step away."""
    codec = codec_of(options.codec)
    if not codec.joint:
        yield from (Neighbour({"effort": effort}, SECONDS[effort] / SECONDS[options.effort])
                    for effort in EFFORTS if effort != options.effort)
        yield from _rates(options, encoded)
        fitted = encoded.choices.get("refinement", {}).get("kind", "off") != "off"
        if options.max_error is None and (fitted or options.refine == "off"):
            yield Neighbour({"refine": "off"}, 0.7) if fitted else Neighbour({"refine": "fit"}, 1.8)
        if encoded.counts["voxels"] and encoded.resolution and not encoded.counts["texels"]:
            for scale in (1 / K_STEP, K_STEP):
                change = {"resolution": round(encoded.resolution * scale)} | ({} if encoded.qp is None else {"qp": encoded.qp})
                if change["resolution"] <= 8192:
                    yield Neighbour(change, scale**2)
            if options.partition == "auto":
                yield Neighbour({"partition": "off"}, 0.9)
        bits = options.position_bits or codec.position_bits
        yield from (Neighbour({"position_bits": bits + step}) for step in (-BITS_STEP, BITS_STEP))
    if options.max_error is not None:
        bounds = {options.max_error // 2, min(2 * options.max_error + 1, 127)} - {options.max_error, 0}
        yield from (Neighbour({"max_error": bound, "lossless": False}) for bound in sorted(bounds))
    if "steps" in codec.options:
        yield from (Neighbour({"steps": n}, n / options.steps) for n in (options.steps // 2, 2 * options.steps) if n)


def _rates(options, encoded):
    """Yield the Neighbours at the next rates, or at the next QPs if the request names one."""
    at, rates = list(RATES).index(options.rate), list(RATES)
    if options.max_error is None and options.given["qp"] is None:
        yield from (Neighbour({"rate": rate}) for rate in rates[max(at - 1, 0) : at + 2] if rate != options.rate)
    elif encoded.qp is not None:
        yield from (Neighbour({"qp": qp}) for qp in (encoded.qp + QP_STEP, encoded.qp - QP_STEP) if 0 <= qp <= 63)


class _Bench:
    """Encodes and measures one scene."""

    def __init__(self, scene, options):
        self.scene, self.threads = scene, options.threads
        self.views = KeptViews(scene, VIEWS, SIZE, ViewSettings(environment=DAYLIGHT))

    def run(self, options):
        """Encode the scene with some options, decode the stream and measure it. Return (row {"seconds", "processor_seconds",
        "bytes", "psnr_y"}, Filled)."""
        begin, worked = time.perf_counter(), time.process_time()
        planned = Encoder(scene=self.scene).filled(options, Report())
        return self.code(planned, begin, worked), planned

    def code(self, planned, begin=None, worked=None):
        """Code a Filled, decode the stream and return its row as run() does. begin, worked: times of perf_counter and
        process_time from which seconds count; None: now."""
        begin = time.perf_counter() if begin is None else begin
        worked = time.process_time() if worked is None else worked
        encoded = write(planned, Report())
        row = {"seconds": round(time.perf_counter() - begin, 4), "processor_seconds": round(time.process_time() - worked, 4)}
        texf = decode_stream(encoded.data, DecodeOptions(threads=self.threads, limits=UNLIMITED), Report())
        return row | {"bytes": len(encoded.data), "psnr_y": self.views.compare(texf, self.threads)["psnr"]["y"]}


def explain_time(scene: Scene, options: EncodeOptions, encoded: Encoded, stages: dict[str, float],
                 budget: float | None = None) -> dict:
    """Measure the seconds of an encode by stage and the effects of other settings, JSON-ready.

    scene: Scene; options: as it was encoded; encoded: the result of that encode; stages: seconds by stage (Report.seconds);
    budget: seconds for neighbours, one of which is always tried; None: ENCODES times the encode. The base, options once more
    with warm kernels, and its rate curve come before them. Returns {"stages", "budget", "spent", "views", "base",
    "neighbours", "not_tried"}: base and neighbours are rows {"change", "seconds", "processor_seconds", "bytes", "psnr_y",
    "percent", "per_second", "verdict", "by"}. percent is bytes above those of the base at equal PSNR of Y of views in daylight;
    per_second is the percent that one second more saves, or one second less costs; by are the changes that dominate it, "" for
    the base. A neighbour that cannot be coded has "reason" instead. Each setting runs once, so both figures go by processor
    seconds, which a busy machine changes little; settings that differ by NOISE or less count as equal.
    """
    begin, requested = time.perf_counter(), as_made(options, encoded)
    bench = _Bench(scene, options)
    base, planned = bench.run(requested)
    budget = ENCODES * base["seconds"] if budget is None else budget
    qps = [] if encoded.qp is None else [qp for qp in (encoded.qp + step for step in CURVE) if 0 <= qp <= 63]
    curve = [base, *(bench.code(planned.with_qp(qp)) for qp in qps)]
    del planned
    first = time.perf_counter()
    rows: list[dict] = []
    points, not_tried = {"": base | {"percent": 0.0}}, []
    for neighbour in neighbours_of(requested, encoded):
        if rows and base["seconds"] * neighbour.factor > budget - (time.perf_counter() - first):
            not_tried.append(neighbour.name)
        else:
            rows.append({"change": neighbour.name} | _tried(bench, requested, neighbour, base, curve))
            if rows[-1].get("percent") is not None and not neighbour.is_rate:
                points[neighbour.name] = rows[-1]
    for name, row in points.items():
        row["by"] = [other for other, its in points.items() if other != name and BETTER == verdict(
            row["processor_seconds"], its["processor_seconds"], its["percent"] - row["percent"])]
    return {"stages": stages, "budget": round(budget, 3), "spent": round(time.perf_counter() - begin, 3), "views": VIEWS,
            "base": points[""], "neighbours": rows, "not_tried": not_tried}


def _tried(bench, requested, neighbour, base, curve):
    try:
        row, _ = bench.run(changed(requested, **neighbour.change))
    except TexfError as error:
        return {"reason": str(error)}
    percent = percent_of(curve, row)
    if percent is None:
        return row | {"percent": None, "per_second": None, "verdict": None}
    first, then = (side["processor_seconds"] for side in (base, row))
    return row | {"percent": round(percent, 2), "per_second": per_second(first, then, percent),
                  "verdict": verdict(first, then, percent)}


def percent_of(curve: list[dict], row: dict) -> float | None:
    """Return the percent by which the bytes of an encode exceed those of a rate curve at the same PSNR. row: {"bytes", "psnr_y"}
    of the encode; curve: such rows of the base at several QPs. If the row has the PSNR of the curve's first point (None: exact),
    bytes alone count. None if the curve does not reach that PSNR."""
    if row["psnr_y"] in (curve[0]["psnr_y"], None):
        return 100.0 * (row["bytes"] / curve[0]["bytes"] - 1) if row["psnr_y"] == curve[0]["psnr_y"] else None
    points = [p for p in curve if p["psnr_y"] is not None]
    try:
        return difference_at([p["bytes"] for p in points], [p["psnr_y"] for p in points], row["bytes"], row["psnr_y"])
    except ValueError:
        return None


def verdict(base_seconds: float, seconds: float, percent: float, noise: float = NOISE) -> str:
    """Return the verdict on a changed setting against the base. BETTER: not slower and fewer bytes, or faster and not more; BUYS
    bytes with seconds; SAVES seconds at a cost in bytes; DOMINATED by the base; or EQUAL. percent: of bytes, at equal quality;
    noise: share of seconds that count as equal."""
    slower, faster = seconds > base_seconds * (1 + noise), seconds * (1 + noise) < base_seconds
    smaller, larger = percent < -GAIN, percent > GAIN
    if slower:
        return BUYS if smaller else DOMINATED
    if faster:
        return SAVES if larger else BETTER
    return BETTER if smaller else DOMINATED if larger else EQUAL


def per_second(base_seconds: float, seconds: float, percent: float, noise: float = NOISE) -> float | None:
    """Return the percent of bytes that a further second saves or a saved second costs; None if verdict() sees no trade between
    bytes and seconds. Arguments as of verdict()."""
    trade = verdict(base_seconds, seconds, percent, noise) in (BUYS, SAVES)
    return round(percent / (base_seconds - seconds), 2) if trade else None
