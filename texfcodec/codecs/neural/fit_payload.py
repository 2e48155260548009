"""Fits a 3DNTC payload to a codec's source: design, samples, fitting engine, refinement on pictures (encoder only)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.json_text import json_ready
from ...scene.channels import ALPHA, BASE_COLOUR, COLOURS
from .design import choose_design
from .fit import BATCH, Fit, pooled_psnr
from .fit_samples import Source

if TYPE_CHECKING:
    from ...report import Report
    from ...scene.channels import Channel
    from ..base import Source as CodecSource
    from .neural_options import NeuralOptions
    from .payload import Payload, Tables

HELD_OUT = 1 << 16
LEAST_SAMPLES, MOST_SAMPLES = 1 << 18, 1 << 24  # on the surface; each is met about eight times, or more often


def _engine(options):
    """The class that fits: torch if it detects a GPU or is requested, else the kernels of train.py."""
    if options.fit_engine == "numba":
        return Fit
    from .fit_torch import TorchFit, cuda_is_there

    return TorchFit if options.fit_engine == "torch" or cuda_is_there() else Fit


def _begun(options, report, *arguments: Any, judged):
    """The fit before its first step. If the GPU fails, it uses the kernels of train.py and adds a remark to the report."""
    engine: Any = _engine(options)
    try:
        fit = engine(*arguments, options.seed, options.threads, judged=judged)
        if engine is not Fit:
            fit.warm(options.steps)
            report.remarks += fit.remarks
        return fit
    except RuntimeError as error:  # torch's errors of devices, drivers and memory
        report.remarks.append(f"the fit takes the processor, because the GPU failed: {str(error).splitlines()[0]}")
        kernels: Any = Fit
        return kernels(*arguments, options.seed, options.threads, judged=judged)


def fit_payload(source: CodecSource, options: NeuralOptions, report: Report) -> tuple[Payload, list[Tables], dict]:
    """Fits a payload for all fields of a codecs.base.Source: (payload.Payload, its Tables by field, choices).

    The choices are "resident" (bytes on the GPU), "fit" (the log) and "refinement".
    """
    surface, components = source.surface, sum(channel.components for channel in source.channels)
    with report.stage("design"):
        design = choose_design(source.surfaces, surface.cube.position_bits, components, options)
    wanted = int(np.clip(options.steps * BATCH // 8, LEAST_SAMPLES, MOST_SAMPLES))
    with report.stage("samples"):
        shown = Source(source, options.threads)
        drawn = shown.draw_busy(wanted, [options.seed, 0]), shown.draw(HELD_OUT, [options.seed, 1])
    places = components_of(shown.channels)
    judged = [c for channel, span in places.items() if channel is not ALPHA for c in span]

    def look(fit, steps):
        row = fit.log[-1]
        left = row["seconds"] / row["step"] * (steps - row["step"])
        report.note = f"{row['psnr']:.2f} dB, {left:.0f} s left"
        report.progress("fit", row["step"], steps)
        report.note = ""

    with report.stage("fit"):
        fit = _begun(options, report, design.payload, design.tables, *drawn, judged=judged)
        checkpoint = None if options.checkpoint is None else Path(options.checkpoint)
        fit.run(options.steps, look, checkpoint)
        reached = _reached(fit, places)
    with report.stage("refine"):
        refinement = _refined(fit, shown, surface.cube.position_bits, options, report)
    payload = fit.payload()
    facts = {"engine": type(fit).__name__, "steps": fit.step, "asked_steps": options.steps,
             "seconds": round(fit.seconds, 2), "samples": len(fit.samples), **reached, "log": fit.log,
             "levels": [{"resolution": level.resolution, "rows": level.rows} for level in payload.levels]}
    return payload, design.tables, {"resident": design.resident, "fit": facts, "refinement": refinement}


def components_of(channels: Sequence[Channel]) -> dict[Channel, range]:
    """Return for each channel the range of its components, as all channels' components follow one another."""
    ends = np.cumsum([channel.components for channel in channels]).tolist()
    return {channel: range(end - channel.components, end) for channel, end in zip(channels, ends, strict=True)}


def _reached(fit, places):
    """The report's entries on a fit's errors: PSNR of the integer evaluation, for base colour, for all judged components and by
    channel; None without error."""
    errors = fit.errors(exact=True)
    psnr = json_ready({c.name: round(pooled_psnr(errors, span), 3) for c, span in places.items()})
    return {"psnr_rgb": psnr[BASE_COLOUR.name], "psnr_channels": psnr,
            **json_ready({"psnr_judged": round(pooled_psnr(errors, fit.judged), 3)})}


def _refined(fit, source, position_bits, options, report):
    """Refines a fit on pictures if requested. Returns the report's entries."""
    reason = {"auto": "more fit steps gain more in the same time", "off": "switched off"}.get(options.refine, "")
    if not reason:
        reason = _unseen_by_pictures(source.channels) or ("" if source.on_pictures else "no renderer is available")
    facts = {"asked": options.refine, "kind": "off", "reason": reason}
    if reason:
        return facts
    log, kept = source.on_pictures(fit, source, position_bits, lambda *n: report.progress("refine", *n), seed=options.seed,
                                   iterations=options.refine_iterations)
    facts |= {"iterations": log, "kept_iteration": log[kept]["iteration"]}
    if not kept:
        return facts | {"reason": "no held-out view improved"}
    return facts | {"kind": "render", "reason": "requested", **_reached(fit, components_of(source.channels))}


def _unseen_by_pictures(channels):
    """Reason why a refinement on pictures of base colour would let other outputs drift; "" if there are no others."""
    if not set(channels) <= set(COLOURS):
        return "the pictures do not show the asset's maps"
    return "the picture loss does not include the asset's alpha" if ALPHA in channels else ""
