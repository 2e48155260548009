"""Which parts of the surface become fields over texels, which over voxels (encoder only)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..codecs import codec_of
from .images import image_groups
from .texel_field import TexelPlan, fraction_bits_for

if TYPE_CHECKING:
    from ..asset.scene import Scene
    from ..geometry.surface import Surface
    from ..options import EncodeOptions
    from ..report import Report


def choose_supports(scene: Scene, surface: Surface, options: EncodeOptions, report: Report) -> tuple[list[TexelPlan], dict]:
    """The fields over texels to make, and what the report says of it; the rest of the surface goes into voxels."""
    if options.support == "voxels" or codec_of(options.codec).joint:
        return [], {"reason": "asked for"}
    groups = image_groups(scene, surface)
    plans = [_plan(group, options) for group in groups]
    return plans, {"reason": "asked for"}


def _plan(group, options):
    longest = max(group.size)
    wanted = longest if options.texel_size is None else min(options.texel_size, longest)
    size = tuple(max(1, round(side * wanted / longest)) for side in group.size)
    return TexelPlan(group, size, fraction_bits_for(group, size, options.qp))


def without_faces(surface: Surface, gone: np.ndarray) -> Surface:
    """A surface without some of its faces. gone: bool [F]."""
    if not gone.any():
        return surface
    return replace(surface, faces=surface.faces[~gone], origin_face=surface.origin_face[~gone], material=surface.material[~gone])
