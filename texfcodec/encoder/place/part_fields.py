"""Fields of their own for small parts over voxels that the common K would blur (encoder only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...options import MOST_RESOLUTION
from ..decision import Decision
from ..mesh.small_parts import small_parts
from ..prepare.uniform_colour import is_uniform
from ..supports.probe import VOXEL_CELL
from ..supports.trial import Trials

MOST_PART_VOXELS = 1 << 22  # of one part


@dataclass(frozen=True)
class PartFields:
    """face_field: int64 [F], number of each face's field, -1 over texels; own: (K, offset of its values to the rate's QP) of the
    fields of small parts, by number."""

    face_field: np.ndarray
    own: dict[int, tuple[int, int]]


def choose_part_fields(face_field: np.ndarray, colours: np.ndarray, trials: Trials) -> Decision[PartFields]:
    """Return the Decision on the PartFields of a surface: a small part over voxels gets a field of its own if K leaves it
    further from the source than the rate promises. Its own K is doubled until the promise is kept, or up to the limits.
    face_field: int64 [F], field of each face before, -1 over texels; colours: of material_colours(); trials: Trials on the
    surface."""
    own: dict[int, tuple[int, int]] = {}
    price, surface = trials.price, trials.surface
    is_open = price.coder is not None and price.is_free and price.has_promise and price.max_error is None
    if not is_open or not (face_field >= 0).any():
        return Decision(PartFields(face_field, own), {})
    face_field = face_field.copy()
    for part in small_parts(surface):
        faces = np.flatnonzero(part & (face_field >= 0))
        if not len(faces) or is_uniform(trials.materials, colours, surface.material[faces]):
            continue
        chosen = _finer(faces, trials)
        if chosen is not None:
            number = int(face_field.max()) + 1
            face_field[faces], own[number] = number, chosen
    kept = np.unique(face_field[face_field >= 0])  # a part may have been all of a field
    face_field = np.where(face_field >= 0, np.searchsorted(kept, face_field), -1)
    own = {int(np.searchsorted(kept, number)): chosen for number, chosen in own.items()}
    rows = [{"field": number, "resolution": resolution} for number, (resolution, _) in own.items()]
    return Decision(PartFields(face_field, own), {"parts": rows} if own else {})


def _finer(faces, trials):
    """Return (K, QP offset) of a part's own field, None if the common K keeps the promise."""
    region = trials.region(faces)
    if region is None or trials.keeps_promise(trials.voxels(region, trials.price.resolution, VOXEL_CELL), region):
        return None
    chosen, k = None, 2 * trials.price.resolution
    while k <= MOST_RESOLUTION and region.voxels(k) <= MOST_PART_VOXELS:
        probe = trials.voxels(region, k, VOXEL_CELL)
        chosen = k, probe.qp_offset
        if trials.keeps_promise(probe, region):
            break
        k *= 2
    return chosen
