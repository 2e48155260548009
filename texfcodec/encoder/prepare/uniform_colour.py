"""Materials that show a single colour on all of a surface: recognised by content before any trial, so that they need none
(encoder only).

A single colour takes a few bytes and next to no voxels: no support, no partition and no fit makes it look better or cost less.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...scene.fetch import pack_source, sample_source, wrapped
from ...scene.scene import ALPHA_OPAQUE
from .materials import shown_texels

if TYPE_CHECKING:
    from ...geometry.surface import Surface
    from ...scene.scene import Material, Scene

EXACT_UV_BITS = 4  # below the texel, when every colour that a face shows has to be seen
NOTHING_TO_PROBE = "the surface has one colour, so there is nothing to choose"
FEW = 64  # faces, or rows and columns of an image, that are looked at before all are


def material_colours(scene: Scene, surface: Surface) -> np.ndarray:
    """Return the single colour that each material shows on a surface, float32 [materials, 4]: RGBA in 0..255, colour sRGB-coded.
    It is NaN if colour or alpha varies, if that takes long to see, and for materials without faces."""
    out = np.full((len(scene.materials), 4), np.nan, np.float32)
    used, first = np.unique(surface.material, return_index=True)
    flat = [i for i, number in enumerate(used) if _is_flat(scene, surface, int(number))]
    if flat:
        # Other images are left out of the source, which would copy them.
        numbers = set(used[flat].tolist())
        plain = [m if i in numbers else replace(m, texture=-1) for i, m in enumerate(scene.materials)]
        source = pack_source(replace(scene, materials=plain), surface.origin_face[first[flat]])
        out[used[flat]] = sample_source(source, np.arange(len(flat)), np.tile([1.0, 0.0, 0.0], (len(flat), 1)))
    return out


def uniform_colour(colours: np.ndarray, materials: np.ndarray) -> np.ndarray | None:
    """Return the single colour that faces of these materials show, RGBA float32 [4]; None if there are several, or it is not
    known. colours: of material_colours; materials: int64 [F], material of each face."""
    shown = colours[np.unique(materials)]
    return shown[0] if len(shown) and (shown == shown[0]).all() else None


def is_uniform(materials: list[Material], colours: np.ndarray, numbers: np.ndarray) -> bool:
    """Return whether faces show a single colour and no maps. colours: of material_colours(); numbers: int64 [F], their
    materials."""
    return uniform_colour(colours, numbers) is not None and not any(materials[m].maps for m in np.unique(numbers))


def _is_flat(scene, surface, number):
    """Return whether all faces of a material show a single colour."""
    material, rows = scene.materials[number], surface.origin_face[surface.material == number]
    spread = rows[:: max(1, len(rows) // FEW)]
    for some in (spread, rows):
        if scene.corner_color is not None and not _are_alike(scene.corner_color[some].reshape(-1, 4)):
            return False
    if material.texture < 0:
        return True
    texture = scene.textures[material.texture]
    columns = slice(0, 3 if material.alpha_mode == ALPHA_OPAQUE else 4)
    if _image_is_flat(texture.image[..., columns]):
        return True
    for some in (spread, rows):
        if not _are_alike(_texels_at_corners(scene.corner_uv[some], texture)[:, columns]):
            return False
    shown = shown_texels(scene.corner_uv[rows], texture, EXACT_UV_BITS)
    return shown is not None and _are_alike(texture.image[shown[:, 1], shown[:, 0]][:, columns])


def _are_alike(values):
    """Return whether all rows are equal. values: [N, C], N at least 1."""
    return bool((values == values[0]).all())


def _image_is_flat(image):
    few = image[:: max(1, image.shape[0] // FEW), :: max(1, image.shape[1] // FEW)]
    return all(_are_alike(part.reshape(-1, part.shape[2])) for part in (few, image))


def _texels_at_corners(uv, texture):
    """Return the texel that each corner lies in, uint8 [N, 4]; rows that differ if a corner lies in none."""
    image = texture.image
    if not (np.abs(uv) < 1e6).all():
        return np.array([[0] * 4, [255] * 4], np.uint8)
    x, y = (wrapped(np.floor(uv[..., axis].reshape(-1) * size).astype(np.int64), size, mode)
            for axis, size, mode in ((0, image.shape[1], texture.wrap[0]), (1, image.shape[0], texture.wrap[1])))
    return image[y, x]
