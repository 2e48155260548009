"""How fine the maps of a field have to be: a smooth one takes fewer bytes, and less time, on a coarser level of its support
(encoder only).

Rarely: the coder spends next to nothing on the fine levels of a smooth map, so that only effort "best" looks. Of some forty maps
of seven assets, at r01 and r03, two went coarser, for less than 100 bytes; looking took a tenth of the encoding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...scene.channels import COLOURS
from ..decision import Decision
from ..estimates.map_levels import means
from ..map_planes import joined

if TYPE_CHECKING:
    from ...codecs.base import Source
    from ...field.texels import TexelSupport
    from ...field.voxels import VoxelSupport
    from ..coder import Coder
    from ..rd import RateDistortion
    from ..source_field import SourceField

LEAST_CELLS = 1 << 12  # a field that is smaller stays as it is


def coarsen_maps(part: SourceField, source: Source, rd: RateDistortion) -> Decision[SourceField]:
    """The SourceField with the planes of its maps at the level that suits each. source: what is coded; base colour and alpha
    stay."""
    evidence = []
    for group in source.groups:
        names = [channel.name for channel in group.channels if channel.name in part.planes]
        if group.channels[0] in COLOURS or not names:
            continue
        plane, shift = joined(part, group)
        support = part.support.coarser(shift)
        levels, costs = _levels(plane, support, rd, rd.planes.shifted(part.qp_offset).for_group(group, source.scene.weights))
        if levels:
            coarse = group.split(means(support, plane, levels))
            part = part.with_planes({name: coarse[name] for name in names}, dict.fromkeys(names, shift + levels))
        evidence.append({"channels": names, "level_shift": shift + levels, "costs": costs})
    return Decision(part, evidence)


def _levels(plane: np.ndarray, support: VoxelSupport | TexelSupport, rd: RateDistortion, coder: Coder) -> tuple[int, list[float]]:
    """(levels to leave out, costs of those that were tried), where trying may pay."""
    idle = rd.effort != "best" or coder.for_plane(plane).codec is not coder.codec
    if idle or len(support) < LEAST_CELLS or coder.qp is None or rd.max_error is not None:
        return 0, []
    return rd.map_levels(plane, support, coder)
