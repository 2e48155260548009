"""Prefiltering of images that are much finer than the voxels of their faces: a voxel shows their mean (encoder only).

A voxel is filled from a few samples along its edge. If a hundred texels lie along that edge, the samples are noise, which takes a
megabyte and does not look like the smaller mip level that viewers show there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...geometry.areas import face_areas
from ..supports.image_groups import textures_of

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Scene

MOST_TEXELS = 1e18  # of UVs without bounds: enough to make any image one texel
FINEST = 16.0  # texels along an edge of a voxel; beyond, an image is shrunk by powers of two until it has so many


def prefilter_textures(scene: Scene, surface: Surface, over_voxels: np.ndarray, resolution: int) -> Scene:
    """Return the scene with images shrunk to at most FINEST texels along a voxel's edge. over_voxels: bool [F], faces of the
    surface that go into voxels; images that any other face shows stay unchanged; resolution: K of the voxels."""
    kept = {t for m in np.unique(surface.material[~over_voxels]) for t in textures_of(scene.materials[m]).values()}
    times: dict[int, float] = {}
    for number in np.unique(surface.material[over_voxels]):
        faces = np.flatnonzero(over_voxels & (surface.material == number))
        area = face_areas(surface.lattice, surface.faces[faces]).sum() * (resolution / (1 << surface.cube.position_bits)) ** 2
        for name, texture in textures_of(scene.materials[number]).items():
            if texture < 0:  # values at face corners
                continue
            texels = _texels(scene, name, texture, surface.origin_face[faces])
            finer = float(np.sqrt(texels / max(area, 1e-9))) / FINEST
            times[texture] = min(finer, times.get(texture, np.inf))
    textures = [_shrunk(texture, 2 ** int(np.ceil(np.log2(times[number])))) if times.get(number, 0) > 1 and number not in kept
                else texture for number, texture in enumerate(scene.textures)]
    return replace(scene, textures=textures)


def _texels(scene, name, texture, rows):
    """Return texels that faces of the scene show of one of their textures, each as often as it is shown."""
    uv = scene.map_uv.get(name, scene.corner_uv)[rows]
    height, width = scene.textures[texture].image.shape[:2]
    with np.errstate(all="ignore"):
        (ax, ay), (bx, by) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
        texels = np.abs(ax * by - ay * bx) / 2 * width * height
    return min(float(texels[np.isfinite(texels)].sum()), MOST_TEXELS)


def _shrunk(texture, times):
    """Return a Texture of means over squares of so many texels a side, or over the whole image."""
    from PIL import Image

    height, width = texture.image.shape[:2]
    size = max(1, round(width / times)), max(1, round(height / times))
    return replace(texture, image=np.asarray(Image.fromarray(texture.image).resize(size, Image.Resampling.BOX)))
