"""What an encode will probably take, from counts that are there before anything is coded (encoder only).

The constants were made on every second of 31 models by name, our 20 and 11 strangers', at rate r03 on two cores of an AMD EPYC.
Of the other 15 the seconds of 11 are told within 25 % (20 % in the median) and the bytes of 7 (31 %).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...codecs import codec_of
from ...geometry.areas import face_areas
from .probe import VOXELS_PER_AREA

if TYPE_CHECKING:
    from ...options import EncodeOptions
    from ..plan import Outline

# Seconds by the wall clock of two threads: of any encode, of the square root of the faces, of a value over texels and over
# voxels, of an image beyond the first, and of maps that have to be judged in light
ALWAYS, ROOT_OF_FACES, TEXEL, VOXEL, IMAGE, LIT = 1.66, 0.0263, 5.2e-7, 2.6e-6, 0.61, 2.6
# Bytes: of the faces to this power, of a byte of the images' measures, and of a value over voxels that no image has
FACE_BYTES, FACE_POWER, MEASURED, VOXEL_BYTES = 21.4, 0.7, 0.85, 0.05


def encode_cost(outline: Outline, images: list[dict], rest: np.ndarray) -> dict:
    """{"seconds", "bytes", "faces", "texels", "voxels"} of an outline, JSON-ready: a guess, and what it is made of.

    images: entries of advise(); rest: bool [F], the faces that probably go over voxels. Texels and voxels are values: places
    times what each holds, a colour and the maps that vary.
    """
    request, surface = outline.request, outline.surface
    channels = sum(bool(told["coded"]) for told in outline.evidence["effects"])
    assert request.resolution is not None  # EncodeOptions fills it in
    scale = (request.resolution / (1 << surface.cube.position_bits)) ** 2
    places = float(face_areas(surface.lattice, surface.faces[rest]).sum()) * scale * VOXELS_PER_AREA if rest.any() else 0.0
    voxels = min(places, float(request.resolution) ** 3) * (1 + channels)
    texels = sum(entry.get("texels", 0) * (1 + len(entry["maps"])) for entry in images if entry["predicted"] == "texels")
    seconds = seconds_of(request, len(surface.faces), voxels) + TEXEL * texels + IMAGE * max(len(images) - 1, 0)
    seconds += LIT if channels else 0
    size = (FACE_BYTES * len(surface.faces) ** FACE_POWER + MEASURED * sum(entry.get("bytes", 0) for entry in images)
            + (0 if images else VOXEL_BYTES * voxels))
    return {"seconds": round(seconds, 1), "bytes": round(size), "faces": len(surface.faces), "texels": texels,
            "voxels": round(voxels)}


def seconds_of(request: EncodeOptions, faces: int, voxels: float) -> float:
    """Of a scene of which nothing else is known."""
    return ALWAYS + ROOT_OF_FACES * faces**0.5 + VOXEL * voxels + codec_of(request.codec).seconds(request)
