"""Seconds that an encode will probably take, from counts that are there before anything is coded (encoder only).

The constants were made on every second of 31 models by name, our 20 and 11 strangers', at rate r03 on two cores of an AMD EPYC,
together with counts of texels and maps, which a dry run does not have: with them 11 of the other 15 were within 25 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...codecs import codec_of

if TYPE_CHECKING:
    from ...options import EncodeOptions

# Seconds by the wall clock of two threads: of any encode, of the square root of the faces, and of a value over voxels.
ALWAYS, ROOT_OF_FACES, VOXEL = 1.66, 0.0263, 2.6e-6


def seconds_of(request: EncodeOptions, faces: int, voxels: float) -> float:
    """Seconds by the wall clock for a scene of which nothing else is known."""
    return ALWAYS + ROOT_OF_FACES * faces**0.5 + VOXEL * voxels + codec_of(request.codec).seconds(request)
