"""Baking: fits decoded fields into an atlas, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...scene.scene import ALPHA_OPAQUE
from ...scene.srgb import to_bytes
from .chart_padding import continue_over_borders
from .fill_uncovered import fill_uncovered
from .system import AtlasSystem
from .unwrap import Atlas, make_atlas

if TYPE_CHECKING:
    from ...texf import Texf


@dataclass
class Baked:
    """An atlas with the baked colours. image: uint8 [H, W, 4] RGBA, sRGB-coded, straight alpha, row 0 at v = 0, every texel
    filled; system: the AtlasSystem that fitted it; warnings: sentences."""

    atlas: Atlas
    image: np.ndarray
    system: AtlasSystem
    warnings: list = field(default_factory=list)


def bake(texf: Texf, texture_size: int | None = None, atlas: str | Atlas = "auto", chosen: np.ndarray | None = None) -> Baked:
    """Unwrap a decoded mesh and fit an image of its base colour and alpha to its fields.

    texf: decoded stream (Texf); texture_size: side in texels or None; atlas: "auto", "quality", "fast" or a ready Atlas of the
    same faces; chosen: int64 [n], numbers of the faces to bake, or None for all. Returns Baked, its atlas over the chosen faces.
    Raises InputError TXF-O10..O12 (see make_atlas). At 4096 x 4096 it needs about 700 MB.

    Texels are chosen so that bilinear look-ups come closest to the fields (least squares, see AtlasSystem). Texels that no
    look-up on the surface reaches continue the neighbouring colours, so that mip levels stay clean.
    """
    chosen = np.arange(len(texf.faces)) if chosen is None else np.asarray(chosen, np.int64)
    if isinstance(atlas, Atlas):
        _check_atlas(atlas, len(chosen))
    else:
        faces, resolution = texf.faces[chosen], _resolution(texf, chosen)
        atlas = make_atlas(texf.positions, faces, texture_size, atlas, resolution, texf.face_field[chosen], texf.threads)
    system = AtlasSystem(atlas, texf.positions, texf.faces[chosen])
    image = np.zeros((atlas.height, atlas.width, 4), np.uint8)
    (_bake_blended if texf.has_alpha else _bake_opaque)(texf, chosen, system, image)
    return Baked(atlas, image, system, list(atlas.warnings))


def _bake_opaque(texf, chosen, system, image):
    """Fill an image, uint8 [H, W, 4], with colours and alpha 255."""
    image[..., 3] = 255
    values = system.fitted(lambda points, face: texf.query(points, chosen[face])[:, :3], 3, threads=texf.threads)
    image[system.covered, :3] = to_bytes(values)
    fill_uncovered(image[..., :3], system.covered | continue_over_borders(image[..., :3], system))


def _bake_blended(texf, chosen, system, image):
    """Fill an image with colours and alpha. Invisible colours, at alpha 0 on blended or masked faces, have no weight."""
    sees_alpha = np.array([m.alpha_mode != ALPHA_OPAQUE for m in texf.materials])[texf.face_material[chosen]]

    def colours(points, face):
        rgba = texf.query(points, chosen[face])
        return np.column_stack([rgba[:, :3], np.where((rgba[:, 3] <= 0) & sees_alpha[face], 0, 1)])

    alpha = system.fitted(lambda points, face: texf.query(points, chosen[face])[:, 3:], 1, threads=texf.threads)
    image[system.covered, 3:] = to_bytes(alpha)
    image[system.covered, :3] = to_bytes(system.fitted(colours, 3, weighted=True, threads=texf.threads))
    known = system.covered.copy()
    known[known] = (alpha[:, 0] >= 0.5) | ~sees_alpha[system.owner[known]]
    beyond = continue_over_borders(image, system)
    fill_uncovered(image[..., 3:], system.covered | beyond)
    fill_uncovered(image[..., :3], known | (beyond & (image[..., 3] > 0)))


def _check_atlas(atlas, count):
    """Raises InputError TXF-O10 if an atlas belongs to another mesh, because kernels index by its numbers."""
    uv = atlas.corner_uv
    if uv.shape != (count, 3, 2) or not ((uv >= 0) & (uv <= 1)).all():
        raise InputError("TXF-O10", "the atlas does not belong to this mesh", faces=count, value=str(uv.shape))


def _resolution(texf, chosen):
    """Number of voxels along the longest side of the chosen faces."""
    if len(chosen) == len(texf.faces) or not texf.side > 0:
        return texf.resolution
    longest = np.ptp(texf.positions[texf.faces[chosen]].reshape(-1, 3), axis=0).max(initial=0.0)
    return max(int(np.ceil(texf.resolution * min(longest / texf.side, 1.0))), 1)
