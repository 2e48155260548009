"""Number of values of a source, whatever will be coded of it: the base of the price of a byte (encoder only).

At the same step a bit of values buys the same squared error of values: with fewer values on the same surface each bit shows on
more of the picture. That number must not depend on any choice, or a finer rate could be a cheaper one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.areas import face_areas
from .probe import VOXELS_PER_AREA

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from .image_groups import ImageGroup

REFERENCE_K, LEAST_K = 1024, 256  # no source counts as coarser than voxels of the latter


def reference_values(surface: Surface, groups: list[ImageGroup], others: np.ndarray) -> float:
    """Return the number of values that a source counts as, for the price of a byte: as if the whole surface were as dense as its
    coded content. An image has its texels, but at most as many as voxels of REFERENCE_K; everything else has such voxels.
    Palettes and flat colours do not count.

    others: bool [F], faces outside of the groups that show more than one colour.
    """
    voxels = face_areas(surface.lattice, surface.faces) * (REFERENCE_K / (1 << surface.cube.position_bits)) ** 2 * VOXELS_PER_AREA
    whole = float(voxels.sum())
    parts = [(float(voxels[group.faces].sum()), texels_shown(group)) for group in groups if not group.palette]
    parts.append((float(voxels[others].sum()), np.inf))
    covered = sum(own for own, _ in parts)
    density = sum(min(pair) for pair in parts) / covered if covered else 1.0
    return max(whole * max(density, (LEAST_K / REFERENCE_K) ** 2), 1.0)


def texels_shown(group: ImageGroup) -> float:
    """Return the rough number of texels that the faces of a group show of its image, each counted once at most."""
    u, v = group.uv[:, 1] - group.uv[:, 0], group.uv[:, 2] - group.uv[:, 0]
    return min(float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2), group.size[0] * group.size[1])
