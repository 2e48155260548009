"""Estimates of the voxels and seconds of an encode, before anything is measured (encoder only).

The constants were fitted on every second of 31 models by name, 20 of ours and 11 public ones, at rate r03 on two cores of an AMD
EPYC, together with counts of texels and maps, which a dry run does not have. With these, 11 of the other 15 models were within 25
%.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..codecs import codec_of
from .supports.probe import VOXELS_PER_AREA

if TYPE_CHECKING:
    from ..options import EncodeOptions
    from ..scene.scene import Scene

# Seconds by the wall clock of two threads: of any encode, of the square root of the faces, and of a value over voxels.
ALWAYS, ROOT_OF_FACES, VOXEL = 1.66, 0.0263, 2.6e-6


def estimate(scene: Scene, options: EncodeOptions) -> tuple[int, float]:
    """Return (voxels, seconds) that an encode will need, guessed from the scene's surface area and its number of faces."""
    assert options.resolution is not None  # its __post_init__ fills it in
    corners = scene.positions[scene.faces]
    side = float((scene.positions.max(axis=0) - scene.positions.min(axis=0)).max()) or 1.0
    edges = (corners[:, 1:] - corners[:, :1]) / side
    area = float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()) / 2
    voxels = max(round(min(area * VOXELS_PER_AREA * options.resolution**2, float(options.resolution) ** 3)), 1)
    seconds = ALWAYS + ROOT_OF_FACES * len(scene.faces) ** 0.5 + VOXEL * voxels + codec_of(options.codec).seconds(options)
    return voxels, round(seconds, 1)
