"""What support "auto" will probably choose, told from cheap measures in a fraction of the time (encoder only).

For every image: how many texels the surface shows, from a small raster of the UVs; how many voxels it has, from its area; how
many bits a value of either takes, from Haar coefficients of a few windows of the image, as they are and at the voxels' size; and
what the voxels lose. How often the encoder chooses so, on assets that the constants were not made on too:
docs/reports/results.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .decide.supports import reason_for_voxels
from .decide.texel_images import image_groups
from .estimates.encode_cost import encode_cost

if TYPE_CHECKING:
    from .plan import Outline

LEANING = 0.6  # what else speaks for texels: the logarithm of bytes
UNSURE = 0.35  # of that logarithm: where the choice may as well be the other one
MANY_TIMES, FINER, COARSE, UV_SHARE = 1.25, 1.5, 0.7, 0.3  # from which on a reason is named


def advise(outline: Outline) -> dict:
    """What choose_supports() would probably make of an outline, JSON-ready: {"asked", "reason", "images": [{"image", "faces",
    "maps", "predicted", "times", "sure", "reasons", "texels", "shown_times", "voxels", "texels_per_voxel_edge", "bytes"}],
    "cost": of encode_cost(), "refinement"}.

    times: bytes over voxels to bytes over texels at equal quality; sure: whether that is clear of 1. Raises InputError."""
    request, surface = outline.request, outline.surface
    reason = reason_for_voxels(request) or ("requested" if request.support == "voxels" else "")
    rest, images = np.ones(len(surface.faces), bool), []
    groups = [] if reason else image_groups(outline.scene, surface)
    for group in groups:
        images.append(_advice(group, outline))
        rest[group.faces] &= images[-1]["predicted"] == "voxels"
    fitted = "fit" if request.may_fit and rest.any() else "off"
    return {"asked": request.support, "reason": reason, "images": images, "cost": encode_cost(outline, images, rest),
            "refinement": fitted if request.refine == "auto" else request.refine}


def _advice(group, outline):
    entry = {"image": list(group.size), "faces": len(group.faces), "maps": sorted(group.maps)}
    if outline.request.support == "texels":
        return entry | {"predicted": "texels", "sure": True, "reasons": ["requested"]}
    measures = outline.rd.image_measures(group, outline.surface)
    if measures is None:
        return entry | {"predicted": "voxels", "sure": True, "reasons": ["the surface has no area, or its UVs exceed the "
                                                                         "supported range"]}
    texels, voxels = measures.cost(outline.rd.step)
    entry["bytes"] = round(min(texels, voxels))
    score = np.log(voxels / texels) + LEANING
    predicted = "texels" if score > 0 else "voxels"
    return entry | {"predicted": predicted, "times": round(float(np.exp(score)), 3),
                    "sure": bool(abs(score) > UNSURE), "reasons": list(_reasons(measures, texels, group, predicted)),
                    "texels": round(measures.texels), "shown_times": round(measures.shown / measures.texels, 3),
                    "voxels": round(measures.voxels),
                    "texels_per_voxel_edge": round(measures.per_edge, 3)}


def _reasons(measures, texel_bytes, group, predicted):
    """What speaks for the support that was predicted."""
    if predicted == "voxels":
        if measures.uv_bytes > UV_SHARE * texel_bytes:
            yield f"UVs would take {measures.uv_bytes / texel_bytes:.0%} of what texels need"
        return
    if group.palette:
        yield "the image has flat colours, which take a texel each"
    if measures.shown > MANY_TIMES * measures.texels:
        yield f"the surface shows each texel {measures.shown / measures.texels:.1f} times, but it is coded once"
    if measures.per_edge > FINER:
        yield f"the image is {measures.per_edge:.1f} times finer than the voxels"
    if measures.per_edge < COARSE and not group.palette:
        yield f"the voxels are {1 / max(measures.per_edge, 1e-3):.1f} times finer than the image"
