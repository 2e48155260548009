"""What a decoded mesh looks like with images: fields over texels keep theirs and their UVs, fields over voxels share an atlas.

A Texf stands in a later room, so that signatures here say Any.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene import WRAP_CLAMP, Texture
from .atlas import check_arguments
from .bake import bake
from .texel_image import texel_image_and_uv


@dataclass(kw_only=True)
class Textured:
    """corner_uv: float64 [F, 3, 2], v downwards (glTF), beyond 0..1 where an image wraps; textures: Texture of each image, uint8
    [H, W, 3] or [H, W, 4]; looks: int64 [P, 2], (material, image) of every pair to write, in ascending order; face_look: int64
    [F] into looks; face_image: int64 [F] into textures; warnings: one sentence each."""

    corner_uv: np.ndarray
    textures: list[Texture]
    looks: np.ndarray
    face_look: np.ndarray
    face_image: np.ndarray
    warnings: list[str]


def image_count(texf: Any) -> int:
    """How many images textured() will have, known before the work."""
    if not len(texf.faces):
        return 0
    over_texels = [part.over_texels for part in texf.fields]
    return sum(over_texels) + (not all(over_texels))


def textured(texf: Any, texture_size: int | None = None, atlas: str = "auto") -> Textured:
    """Images and UVs of a decoded stream (Texf). texture_size, atlas: of the atlas of fields over voxels, see bake(); it is the
    first image. Raises InputError TXF-O10..O12."""
    check_arguments(texture_size, atlas)
    over_texels = np.array([part.over_texels for part in texf.fields], bool)
    fields, count = texf.face_field, len(texf.faces)
    corner_uv, face_image = np.zeros((count, 3, 2)), np.zeros(count, np.int64)
    textures, warnings = [], []
    baked_faces = np.flatnonzero(~over_texels[fields])
    if len(baked_faces):
        baked = bake(texf, texture_size, atlas, baked_faces)
        corner_uv[baked_faces] = baked.atlas.corner_uv
        image = baked.image if texf.has_alpha else np.ascontiguousarray(baked.image[..., :3])
        textures.append(Texture(image, (WRAP_CLAMP, WRAP_CLAMP)))
        warnings += baked.warnings
    elif count and (texture_size is not None or atlas != "auto"):
        warnings.append("every field is over texels and keeps its image: texture size and atlas method have no part")
    for number in np.flatnonzero(over_texels).tolist():
        image, corner_uv[fields == number] = texel_image_and_uv(texf, number)
        face_image[fields == number] = len(textures)
        textures.append(Texture(image, tuple(texf.fields[number].support.wrap)))
    return Textured(corner_uv=corner_uv, textures=textures, face_image=face_image, warnings=warnings, **_looks(texf, face_image))


def _looks(texf, face_image):
    """Pairs of material and image that faces have; a material that no face has stands there once."""
    used = np.column_stack([texf.face_material, face_image])
    idle = np.setdiff1d(np.arange(len(texf.materials)), texf.face_material)
    pairs = np.concatenate([used, np.column_stack([idle, np.zeros_like(idle)])])
    looks, number = np.unique(pairs, axis=0, return_inverse=True)
    return {"looks": looks, "face_look": number.reshape(-1)[: len(used)]}
