"""First stage: the scene reduced to what has to be coded, on the reference lattice (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..stages import Prepared
from .channel_weights import measured_weights
from .materials import needed_scene
from .reference_lattice import reference_surface
from .uniform_colour import material_colours

if TYPE_CHECKING:
    from ...limits import Limits
    from ...report import Report
    from ...scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class PrepareRequest:
    """Fields of EncodeOptions that the stage depends on. measures_weights: whether pictures weigh the channels."""

    position_bits: int
    position_bits_are_free: bool
    limits: Limits
    allow_empty: bool
    effects: str
    measures_weights: bool
    rate_is_free: bool
    threads: int


def prepare(scene: Scene, request: PrepareRequest, report: Report) -> Prepared:
    """Return the Prepared of a scene. Raises InputError, LimitError."""
    with report.stage("lattice"):
        surface = reference_surface(scene, request)
    with report.stage("effects", (0, 2)):
        needs = needed_scene(scene, surface, request.effects)
    with report.stage("effects", (1, 2)):
        needed = needs.value.scene
        if request.measures_weights:
            needed = replace(needed, weights=measured_weights(needed, request.rate_is_free, request.threads))
        colours = material_colours(needed, surface)
    return Prepared(scene=needed, materials=needs.value.materials, surface=surface, colours=colours,
                    evidence={"effects": needs.evidence})
