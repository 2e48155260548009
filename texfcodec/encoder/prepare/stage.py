"""First stage: the scene reduced to what has to be coded, on the reference lattice (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...geometry.canonical import MAX_BITS
from ...geometry.surface import make_surface, thin_faces
from ..faces import SourceSurface
from ..stages import Prepared
from .channel_weights import measured_weights
from .materials import needed_scene
from .uniform_colour import material_colours

if TYPE_CHECKING:
    from ...limits import Limits
    from ...report import Report
    from ...scene.scene import Scene

CELLS = 10  # along the longest side of a scene, in which faces are counted
FEWEST, MOST_LEFT_OUT = 12, 0.5  # faces that a cell has to lose, and share of its faces, from which on the lattice is too coarse
BITS_A_STEP = 2


@dataclass(frozen=True, kw_only=True)
class PrepareRequest:
    """Fields of EncodeOptions that the stage depends on. weight_size: side of the pictures that weigh channels, or 0."""

    position_bits: int
    position_bits_are_free: bool
    limits: Limits
    allow_empty: bool
    effects: str
    weight_size: int
    rate_is_free: bool
    threads: int


def prepare(scene: Scene, request: PrepareRequest, report: Report) -> Prepared:
    """Run the first stage: return the Prepared of a scene, reduced to what has to be coded. Raises InputError, LimitError."""
    with report.stage("lattice"):
        surface = reference_surface(scene, request)
    with report.stage("effects", (0, 2)):
        needs = needed_scene(scene, surface, request.effects)
    with report.stage("effects", (1, 2)):
        needed = needs.value.scene
        if request.weight_size:
            weights = measured_weights(needed, request.rate_is_free, request.weight_size, request.threads)
            needed = replace(needed, weights=weights)
        colours = material_colours(needed, surface)
    return Prepared(scene=needed, materials=needs.value.materials, surface=surface, colours=colours,
                    evidence={"effects": needs.evidence})


def reference_surface(scene: Scene, request: PrepareRequest) -> SourceSurface:
    """Return the Surface of a scene on the lattice of the requested position bits. If the encoder may choose the bits, it takes
    more as long as some part of the scene, a statue beside a large ground, would lose most of its faces. Raises InputError and
    LimitError as make_surface()."""
    surface = make_surface(scene, request)
    while request.position_bits_are_free and surface.cube.position_bits < MAX_BITS and _loses_a_part(scene, surface):
        bits = min(surface.cube.position_bits + BITS_A_STEP, MAX_BITS)
        surface = make_surface(scene, replace(request, position_bits=bits))
    return SourceSurface(surface)


def _loses_a_part(scene, surface):
    """Return whether the lattice removes half of the faces in some cell of the scene, but for those that every lattice
    removes, because they have no area in the source."""
    if not surface.cube.side:
        return False
    left = np.ones(len(scene.faces), bool)
    left[surface.origin_face] = False
    gone = np.flatnonzero(left)
    left[gone] = ~thin_faces(scene.positions, scene.faces, surface.cube.side, gone)
    if left.sum() < FEWEST:
        return False
    middle = scene.positions[scene.faces].mean(axis=1) - surface.cube.origin
    place = np.clip(np.floor(middle / surface.cube.side * CELLS), 0, CELLS - 1).astype(np.int64) @ (1, CELLS, CELLS**2)
    lost, all_there = np.bincount(place[left], minlength=CELLS**3), np.bincount(place, minlength=CELLS**3)
    return bool(((lost >= FEWEST) & (lost > MOST_LEFT_OUT * all_there)).any())
