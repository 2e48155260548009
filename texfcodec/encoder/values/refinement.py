"""The choice of the refinement of a field, its gain, and its entry in the report (encoder only)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.colour_error import decibels
from ...report import Step, no_step
from ...scene.channels import BASE_COLOUR
from ...scene.fetch import pack_source
from ..decision import Decision
from ..supports.probe import LEFT_BY_FIT
from .source_field import field_keys
from .surface_fit import HELD_OUT, HELD_OUT_SEED, FieldSurface, fit_surface

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ..caches import Cache
    from ..price import Lagrangian
    from .source_field import SourceField
    from .stage import FillRequest

COLOUR = BASE_COLOUR.name  # what a fit moves
PROBE = 1 << 14  # surface points that tell how far the transfer is from the source
LEAST_GAIN = 0.03  # dB at the coded quality; what promised less gained nothing after coding (QP 46 to 58, two assets)
MOST_VOXELS = 10_000_000  # "auto" leaves larger fields alone: a fit takes about 150 bytes a voxel


def refine_fields(source: Source, fields: list[SourceField], price: Lagrangian, wanted: FillRequest,
                  cache: Cache, step: Step = no_step) -> Decision[list[SourceField]]:
    """Return the Decision on SourceFields whose colours are fitted to the source's surface, as wanted.refine requests.

    source: codecs.base.Source; fields: over voxels, by number; cache: of fitted fields; step: of Report.stage(). Each field
    keeps its transferred colours if the refined ones are not closer to the source at points that the fit has not seen.
    """
    reason = _reason_against(fields, price, wanted.refine)
    evidence: dict[str, Any] = {"asked": wanted.refine, "kind": "off", "reason": reason or "requested"}
    if reason:
        return Decision(fields, evidence)
    surfaces = [_field_surface(source, i, field) for i, field in enumerate(fields)]
    if wanted.refine == "auto":
        evidence["predicted_gain_db"] = round(_predicted_gain(surfaces, fields, price), 3)
        if evidence["predicted_gain_db"] < LEAST_GAIN:
            return Decision(fields, evidence | {"reason": "coding would hide the gain of a fit"})
        evidence["reason"] = "coding would not hide the error of the transfer"
    keys = field_keys("fit", source, fields, price.resolution)
    fits = [cache.get(key, partial(_fit, surface, part, price.threads, step))
            for key, surface, part in zip(keys, surfaces, fields, strict=True)]
    fields = [part.with_planes({COLOUR: fit.value.planes[COLOUR]}) for part, fit in zip(fields, fits, strict=True)]
    evidence = evidence | {"kind": "fit", "fields": [fit.evidence for fit in fits]}
    if wanted.refine != "render":
        return Decision(fields, evidence)
    rendered = _render(surfaces, fields, price.threads, wanted.refine_iterations, step)
    return Decision(rendered.value, evidence | rendered.evidence)


def _reason_against(fields, price, refine):
    if refine == "off":
        return "switched off"
    if not fields:
        return "there is no field over voxels"
    if price.max_error is not None:
        return "an error bound was requested"
    if all(field.is_uniform for field in fields):
        return "the surface has one colour"
    if refine == "auto" and price.effort == "fast":
        return "effort fast excludes a fit"
    if refine == "auto" and sum(len(f.keys) for f in fields) > MOST_VOXELS:
        return "a fit of so many voxels takes much memory; --refine fit forces it"
    return ""


def _field_surface(source, number, field):
    surface, in_field = source.surface, source.face_field == number
    return FieldSurface(surface.lattice, surface.faces[in_field], pack_source(source.scene, surface.origin_face[in_field]),
                        surface.cube.position_bits, field.support.resolution, field.keys, field.support.brick_map)


def _predicted_gain(surfaces, fields, price):
    """Return the dB that a fit would gain at the quality of coding."""
    error, voxels = 0.0, sum(len(f.keys) for f in fields)
    for surface, field in zip(surfaces, fields, strict=True):
        if not surface.has_area:
            continue
        points = surface.sample(PROBE, HELD_OUT_SEED, price.threads)
        error += surface.error(field.planes[COLOUR], *points, price.threads)["y"] * len(field.keys) / voxels
    return price.gain(error, LEFT_BY_FIT * error)


def _fit(surface, field, threads, step):
    """Return the better of fit and transfer of one field, and {"psnr_y_before", "psnr_y_after", "kept"}, dB at held-out
    points."""
    if not surface.has_area:
        return Decision(field, {"psnr_y_before": None, "psnr_y_after": None, "kept": False})
    points = surface.sample(HELD_OUT, HELD_OUT_SEED, threads)
    before = surface.error(field.planes[COLOUR], *points, threads)
    fitted = fit_surface(surface, field.planes[COLOUR], threads, on_progress=step)
    after = surface.error(fitted, *points, threads)
    kept = after["rgb"] < before["rgb"]
    field = field.with_planes({COLOUR: fitted}) if kept else field
    return Decision(field, {"psnr_y_before": _finite(before["y"]), "psnr_y_after": _finite(after["y"]), "kept": kept})


def _finite(mse):
    return round(decibels(mse), 3) if mse else None


def _render(surfaces, fields, threads, iterations, step):
    """Return the Decision on inverse rendering on top of the fit."""
    from .inverse_render import refine_by_rendering  # here, because the renderer takes long to import and few ask for it
    from .pictures import Schedule

    start, schedule = [field.planes[COLOUR] for field in fields], Schedule(iterations=iterations)
    colours, log, kept = refine_by_rendering(surfaces, start, threads, schedule, on_progress=step)
    fields = [field.with_planes({COLOUR: np.ascontiguousarray(c)}) for field, c in zip(fields, colours, strict=True)]
    return Decision(fields, {"kind": "fit and render" if kept else "fit", "iterations": log,
                             "kept_iteration": log[kept]["iteration"]})
