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
from ..metrics.psnr_3d import SourceSamples
from ..options import EFFORTS, DecodeOptions, EncodeOptions
from ..report import Report
from .encode import Encoder
from .write import write

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .write import Encoded

SAMPLES = 250_000  # of 3D-PSNR: differences of 0.01 dB are seen
ENCODES = 4  # seconds for neighbours where none are given, in encodes of what was asked for
CURVE = (-4, 4, 12)  # QPs from that of the stream, for the curve that bytes at equal quality are read from
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
        flags = {"max_error": "near-lossless"}
        return " ".join(f"--{flags.get(name, name)} {value}" for name, value in self.change.items() if value is not False)


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
    """Yield the Neighbours of the options (settings one step away) that matter for an encoded stream, the most informative
    first. Not among them are position bits: 3D-PSNR samples both sides at the same places of the surface, and sees no moved
    surface."""
    codec, place = codec_of(options.codec), EFFORTS.index(options.effort)
    if not codec.joint:
        steps = ((place + 1, 1.5), (place - 1, 0.6))
        yield from (Neighbour({"effort": EFFORTS[at]}, factor) for at, factor in steps if 0 <= at < len(EFFORTS))
        fitted = encoded.choices.get("refinement", {}).get("kind", "off") != "off"
        if options.max_error is None and (fitted or options.refine == "off"):
            yield Neighbour({"refine": "off"}, 0.7) if fitted else Neighbour({"refine": "fit"}, 1.8)
        if encoded.counts["voxels"] and encoded.resolution and not encoded.counts["texels"]:
            for scale in (1 / K_STEP, K_STEP):
                change = {"resolution": round(encoded.resolution * scale)} | ({} if encoded.qp is None else {"qp": encoded.qp})
                if change["resolution"] <= 8192:
                    yield Neighbour(change, scale**2)
    if options.max_error is not None:
        bounds = {options.max_error // 2, min(2 * options.max_error + 1, 127)} - {options.max_error, 0}
        yield from (Neighbour({"max_error": bound, "lossless": False}) for bound in sorted(bounds))
    if "steps" in codec.options:
        yield from (Neighbour({"steps": n}, n / options.steps) for n in (options.steps // 2, 2 * options.steps) if n)


class _Bench:
    """Encodes and measures one scene."""

    def __init__(self, scene, options):
        self.scene, self.threads = scene, options.threads
        self.samples = SourceSamples(scene, SAMPLES, options.threads)

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
        return row | {"bytes": len(encoded.data), "psnr_y": self.samples.compare(texf)["y"]}


def explain_time(scene: Scene, options: EncodeOptions, encoded: Encoded, stages: dict[str, float],
                 budget: float | None = None) -> dict:
    """Measure the seconds of an encode by stage and the effects of other settings, JSON-ready.

    scene: Scene; options: as it was encoded; encoded: the result of that encode; stages: seconds by stage (Report.seconds);
    budget: seconds for neighbours, one of which is always tried; None: ENCODES times the encode. The base, options once more
    with warm kernels, and its rate curve come before them. Returns {"stages", "budget", "spent", "samples", "base",
    "neighbours", "not_tried"}: base and neighbours are rows {"change", "seconds", "processor_seconds", "bytes", "psnr_y",
    "percent", "per_second", "verdict"}. percent is bytes above those of the base at equal 3D-PSNR of Y; per_second is the
    percent that one second more saves, or one second less costs. A neighbour that cannot be coded has "reason" instead. Each
    setting runs once, so both figures go by processor seconds, which a busy machine changes little; settings that differ by
    NOISE or less count as equal.
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
    not_tried = []
    for neighbour in neighbours_of(requested, encoded):
        if rows and base["seconds"] * neighbour.factor > budget - (time.perf_counter() - first):
            not_tried.append(neighbour.name)
        else:
            rows.append({"change": neighbour.name} | _tried(bench, requested, neighbour, base, curve))
    spent = round(time.perf_counter() - begin, 3)
    return {"stages": stages, "budget": round(budget, 3), "spent": spent, "samples": SAMPLES, "base": base, "neighbours": rows,
            "not_tried": not_tried}


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
    of the encode; curve: such rows of the base at several QPs. If the row and the curve's first point are both lossless (psnr_y
    None), bytes alone count. None if the curve does not reach that PSNR."""
    if row["psnr_y"] is None:
        lossless = curve[0]["psnr_y"] is None
        return 100.0 * (row["bytes"] / curve[0]["bytes"] - 1) if lossless else None
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
