"""Parts that are small beside the whole: a statue on a ground, a car in a street (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.edges import face_components

if TYPE_CHECKING:
    from ...geometry.surface import Surface

SMALL, MOST_PARTS = 1 / 6, 6  # side of a small part in that of all; parts that are named
PART_FACES, PART_SHARE = 48, 0.005  # that a small part has at least, faces and share of all faces


def small_parts(surface: Surface) -> list[np.ndarray]:
    """Return masks of the parts of a surface that are small beside the whole, each bool [F] over its faces. A part is the
    components with a side of at most SMALL of the whole's at about the same place; those of the most faces come first, at most
    MOST_PARTS. Loose bits of a scan do not count."""
    if not len(surface.faces):
        return []
    piece = face_components(surface.faces)
    corners, count = surface.lattice[surface.faces], int(piece.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(axis=1))
    np.maximum.at(high, piece, corners.max(axis=1))
    cell = SMALL * float((high.max(axis=0) - low.min(axis=0)).max())
    small = (high - low).max(axis=1) <= cell
    if not small.any() or small.all() or not cell:
        return []
    place = np.unique(np.floor((low + high) / 2 / cell), axis=0, return_inverse=True)[1].reshape(-1)
    own = np.where(small, place, -1)[piece]
    sizes = np.bincount(own[own >= 0])
    enough = np.flatnonzero(sizes >= max(PART_FACES, PART_SHARE * len(own)))
    return [own == number for number in enough[np.argsort(-sizes[enough], kind="stable")][:MOST_PARTS]]
