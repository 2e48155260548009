"""Baking: a decoded texture field painted into an atlas, texel by texel, in bounded memory.

A Texf stands in a later room, so that signatures here say Any.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import InputError
from ...ground.kernel import kernel
from ..scene import ALPHA_OPAQUE
from ..texel_cover import nearest_on_triangle, span_in_band
from .atlas import Atlas, make_atlas

BLOCK = 1 << 19  # texels asked of the field at once: about 40 MB in flight


@dataclass
class Baked:
    """image: uint8 [H, W, 4] RGBA, sRGB-coded, straight alpha, row 0 at v = 0; every texel filled. warnings: sentences."""

    atlas: Atlas
    image: np.ndarray
    warnings: list = field(default_factory=list)


def bake(texf: Any, texture_size: int | None = None, atlas: str | Atlas = "auto", chosen: np.ndarray | None = None) -> Baked:
    """Unwrap a decoded mesh and paint its fields into the atlas.

    texf: decoded stream (Texf); texture_size: side in texels or None; atlas: "auto", "quality", "fast" or a ready Atlas of the
    same faces; chosen: int64 [n], numbers of the faces to paint, or None for all. Returns Baked, its atlas over the chosen faces.
    Raises InputError TXF-O10..O12 (see make_atlas). At 4096 x 4096 it needs about 300 MB.

    A texel shows the surface point under its centre; texels within one texel of a face show that face's nearest point, so that
    bilinear lookups at chart edges stay on the surface; all others carry on the neighbouring colours, so mip levels stay clean.
    """
    chosen = np.arange(len(texf.faces)) if chosen is None else np.asarray(chosen, np.int64)
    if isinstance(atlas, Atlas):
        _check_atlas(atlas, len(chosen))
    else:
        faces, resolution = texf.faces[chosen], _resolution(texf, chosen)
        atlas = make_atlas(texf.positions, faces, texture_size, atlas, resolution, groups=texf.face_field[chosen])
    texels = np.ascontiguousarray(atlas.corner_uv * np.array([atlas.width, atlas.height], np.float64))
    owner = cover(texels, atlas.width, atlas.height)
    image = np.zeros((atlas.height, atlas.width, 4), np.uint8)
    _paint(texf, chosen, texels, owner, image)
    covered = owner >= 0
    if texf.has_alpha:
        fill_gaps(image[..., 3:], covered)
        fill_gaps(image[..., :3], covered & ~_invisible(texf, chosen, owner, image))
    else:
        image[..., 3] = 255
        fill_gaps(image[..., :3], covered)
    return Baked(atlas, image, list(atlas.warnings))


def cover(texels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Which face each texel shows: int32 [height, width], -1 where no face comes within one texel.

    texels: float64 [F, 3, 2] corners in texels. A texel centre inside a face is that face's; otherwise the nearest face's.
    """
    owner = np.full((height, width), -1, np.int32)
    nearness = np.full((height, width), np.inf, np.float32)
    _cover(texels, owner, nearness)
    return owner


def fill_gaps(image: np.ndarray, known: np.ndarray) -> None:
    """Fill texels that are not known from the known ones around them, in place (push-pull; mip levels see no gap).

    image: uint8 [H, W, C]; known: bool [H, W]. Without any known texel the image stays as it is.
    """
    if known.all() or not known.any():
        return
    coarse = np.zeros(((image.shape[0] + 1) // 2, (image.shape[1] + 1) // 2, image.shape[2]), np.uint8)
    coarse_known = np.zeros(coarse.shape[:2], np.bool_)
    _push(image, known, coarse, coarse_known)
    fill_gaps(coarse, coarse_known)
    _pull(image, known, coarse)


def _check_atlas(atlas, count):
    """Kernels index by these numbers: an atlas made for another mesh must not reach them."""
    uv = atlas.corner_uv
    if uv.shape != (count, 3, 2) or not ((uv >= 0) & (uv <= 1)).all():
        raise InputError("TXF-O10", "the atlas does not belong to this mesh", faces=count, value=str(uv.shape))


def _resolution(texf, chosen):
    """Voxels along the longest side of the chosen faces."""
    if len(chosen) == len(texf.faces) or not texf.side > 0:
        return texf.resolution
    longest = np.ptp(texf.positions[texf.faces[chosen]].reshape(-1, 3), axis=0).max(initial=0.0)
    return max(int(np.ceil(texf.resolution * min(longest / texf.side, 1.0))), 1)


def _paint(texf, chosen, texels, owner, image):
    """Ask the fields of the chosen faces for every covered texel, a band of rows at a time."""
    positions, faces = np.ascontiguousarray(texf.positions, np.float64), np.ascontiguousarray(texf.faces[chosen], np.int64)
    rows = max(BLOCK // owner.shape[1], 1)
    for top in range(0, owner.shape[0], rows):
        band = owner[top : top + rows]
        row, col = np.nonzero(band >= 0)
        if len(row) == 0:
            continue
        face = band[row, col].astype(np.int64)
        points = _surface_points(col + 0.5, row + (top + 0.5), face, texels, faces, positions)
        image[top + row, col] = to_bytes(texf.query(points, chosen[face]))


def to_bytes(rgba: np.ndarray) -> np.ndarray:
    """Colours 0..255 rounded to uint8; anything that is not a number becomes 0."""
    return np.nan_to_num(np.rint(np.clip(rgba, 0.0, 255.0)), nan=0.0).astype(np.uint8)


def _invisible(texf, chosen, owner, image):
    """Texels whose colour nobody can see (alpha 0 on a blended or masked face) and which therefore say nothing about it."""
    sees_alpha = np.array([m.alpha_mode != ALPHA_OPAQUE for m in texf.materials] + [True])
    face_sees = np.append(sees_alpha[np.asarray(texf.face_material, np.int64)[chosen]], False)  # last: what owner -1 asks
    return (image[..., 3] == 0) & face_sees[owner]


@kernel
def _cover(texels, owner, nearness):
    """See cover(). Bounds: rows and columns are clipped to the image before they index it; F < 2**31."""
    height, width = owner.shape
    for f in range(texels.shape[0]):
        ax, ay = texels[f, 0, 0], texels[f, 0, 1]
        bx, by = texels[f, 1, 0], texels[f, 1, 1]
        cx, cy = texels[f, 2, 0], texels[f, 2, 1]
        top = max(int(np.ceil(min(ay, by, cy) - 1.5)), 0)
        bottom = min(int(np.floor(max(ay, by, cy) + 0.5)), height - 1)
        for row in range(top, bottom + 1):
            left, right = span_in_band(ax, ay, bx, by, cx, cy, row - 0.5, row + 1.5)
            if left > right:
                continue
            for col in range(max(int(np.ceil(left - 1.5)), 0), min(int(np.floor(right + 0.5)), width - 1) + 1):
                if nearness[row, col] == 0.0:
                    continue
                distance, _, _ = nearest_on_triangle(col + 0.5, row + 0.5, ax, ay, bx, by, cx, cy)
                if distance < nearness[row, col]:
                    nearness[row, col] = distance
                    owner[row, col] = f


@kernel
def _surface_points(x, y, face, texels, faces, positions):
    """World points float64 [M, 3] that the texel centres (x, y) show on their faces (the nearest point when outside)."""
    out = np.empty((len(face), 3))
    for i in range(len(face)):
        t = texels[face[i]]
        _, wa, wb = nearest_on_triangle(x[i], y[i], t[0, 0], t[0, 1], t[1, 0], t[1, 1], t[2, 0], t[2, 1])
        corner = faces[face[i]]
        for k in range(3):
            out[i, k] = wa * positions[corner[0], k] + wb * positions[corner[1], k] + (1.0 - wa - wb) * positions[corner[2], k]
    return out


@kernel
def _push(image, known, coarse, coarse_known):
    """Each coarse texel is the mean of its known fine texels."""
    for row in range(coarse.shape[0]):
        for col in range(coarse.shape[1]):
            rows, cols = min(2 * row + 2, image.shape[0]), min(2 * col + 2, image.shape[1])
            count = 0
            for r in range(2 * row, rows):
                for c in range(2 * col, cols):
                    count += known[r, c]
            if count == 0:
                continue
            coarse_known[row, col] = True
            for k in range(image.shape[2]):
                total = count // 2
                for r in range(2 * row, rows):
                    for c in range(2 * col, cols):
                        if known[r, c]:
                            total += image[r, c, k]
                coarse[row, col, k] = total // count


@kernel
def _pull(image, known, coarse):
    """Unknown fine texels take their coarse texel's colour: exactly what a mip level would average."""
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            if not known[row, col]:
                for k in range(image.shape[2]):
                    image[row, col, k] = coarse[row // 2, col // 2, k]
