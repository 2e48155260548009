"""Which refinement a field gets, whether it pays, and what the report says of it (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.colour_error import decibels
from ...scene.channels import BASE_COLOUR
from ...scene.fetch import pack_source
from ..decide.probe import LEFT_BY_FIT
from ..decide.trial import coding_mse
from .surface_fit import HELD_OUT, HELD_OUT_SEED, FieldSurface, fit_surface

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ...options import EncodeOptions
    from ...report import Report
    from ..source_field import SourceField

COLOUR = BASE_COLOUR.name  # what a fit moves
PROBE = 1 << 14  # surface points that tell how far the transfer is from the source
LEAST_GAIN = 0.03  # dB at the coded quality; what promised less gained nothing after coding (QP 46 to 58, two assets)
MOST_VOXELS = 10_000_000  # "auto" leaves larger fields alone: a fit takes about 150 bytes a voxel


def refine_fields(source: Source, fields: list[SourceField], options: EncodeOptions, report: Report) -> dict:
    """Refines the colours of the SourceFields in place, as options.refine asks; returns what the report says of it.

    source: codecs.base.Source; fields: by number. Each field keeps its transfer where its refined colours are not closer to the
    source at points that the fit has not seen.
    """
    reason = _reason_against(fields, options)
    facts: dict[str, Any] = {"asked": options.refine, "kind": "off", "reason": reason or "asked for"}
    if reason:
        return facts
    surfaces = [_field_surface(source, i, field, options) for i, field in enumerate(fields)]
    if options.refine == "auto":
        facts["predicted_gain_db"] = round(_predicted_gain(surfaces, fields, options), 3)
        if facts["predicted_gain_db"] < LEAST_GAIN:
            return facts | {"reason": "coding hides what a fit would gain"}
        facts["reason"] = "the transfer is further off than coding hides"
    facts |= {"kind": "fit", "fields": [_fit(s, f, options, report) for s, f in zip(surfaces, fields, strict=True)]}
    return facts | (_render(surfaces, fields, options, report) if options.refine == "render" else {})


def _reason_against(fields, options):
    if options.refine == "off":
        return "switched off"
    if not fields:
        return "there is no field over voxels"
    if options.max_error is not None:
        return "the voxels' own values were asked for"
    if all(field.one_colour for field in fields):
        return "one colour: nothing to refine"
    if options.refine == "auto" and options.effort == "fast":
        return "effort fast does without"
    if options.refine == "auto" and sum(len(f.keys) for f in fields) > MOST_VOXELS:
        return "too many voxels for the memory that a fit takes; --refine fit does it all the same"
    return ""


def _field_surface(source, number, field, options):
    surface, mine = source.surface, source.face_field == number
    return FieldSurface(surface.lattice, surface.faces[mine], pack_source(source.scene, surface.origin_face[mine]),
                        surface.cube.position_bits, options.resolution, field.keys, field.support.brick_map)


def _predicted_gain(surfaces, fields, options):
    """dB that a fit would gain at the quality that coding leaves."""
    error, voxels = 0.0, sum(len(f.keys) for f in fields)
    for surface, field in zip(surfaces, fields, strict=True):
        if not surface.has_area:
            continue
        points = surface.sample(PROBE, HELD_OUT_SEED, options.threads)
        error += surface.error(field.planes[COLOUR], *points, options.threads)["y"] * len(field.keys) / voxels
    floor = coding_mse(options.reckoned_qp)
    return decibels(floor + LEFT_BY_FIT * error) - decibels(floor + error)


def _fit(surface, field, options, report):
    """Fits one field, keeps the better of fit and transfer, and returns what the report says: {"psnr_y_before", "psnr_y_after",
    "kept"}, dB at held-out points."""
    if not surface.has_area:
        return {"psnr_y_before": None, "psnr_y_after": None, "kept": False}
    points = surface.sample(HELD_OUT, HELD_OUT_SEED, options.threads)
    before = surface.error(field.planes[COLOUR], *points, options.threads)
    fitted = fit_surface(surface, field.planes[COLOUR], options.threads, on_progress=lambda *n: report.progress("refine", *n))
    after = surface.error(fitted, *points, options.threads)
    kept = after["rgb"] < before["rgb"]
    if kept:
        field.planes[COLOUR] = fitted
    return {"psnr_y_before": _finite(before["y"]), "psnr_y_after": _finite(after["y"]), "kept": kept}


def _finite(mse):
    return round(decibels(mse), 3) if mse else None


def _render(surfaces, fields, options, report):
    """Inverse rendering on top of the fit: what the report says of it."""
    from .inverse_render import refine_by_rendering  # here, because the renderer takes long to import and few ask for it

    colours, log, kept = refine_by_rendering(surfaces, [f.planes[COLOUR] for f in fields], options.threads,
                                             iterations=options.refine_iterations,
                                             on_progress=lambda *n: report.progress("refine", *n))
    for field, colour in zip(fields, colours, strict=True):
        field.planes[COLOUR] = np.ascontiguousarray(colour)
    return {"kind": "fit and render" if kept else "fit", "iterations": log, "kept_iteration": log[kept]["iteration"]}
