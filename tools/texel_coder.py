"""The attribute coder on the texels that a surface uses, against AVIF on the whole image.

python tools/texel_coder.py ASSET.glb... [--effort balanced|best] [--qp 22,28,34,40] [--crop N] [--tools] [--lossless] [--out FILE]

Of each asset the largest base-colour image is taken. Its used texels are those that bilinear interpolation can ask at any point
of a face; they are coded as voxels (x, y, 0). AVIF codes the whole image (Pillow, speed 6, 4:2:0). PSNR is that over the used
texels, the bytes are those of the attribute unit's parameters and codewords, and of the AVIF file. Prints a Markdown table of
BD-rates, a row per asset: Y and RGB. --tools: a row per tool that is switched off, BD-rate against the complete set. --lossless:
bytes of max_error 0 against PNG and lossless WebP, of the whole image and with its unused texels black. --crop: only the N x N
window with most used texels, for quick experiments, and without AVIF.
"""

import argparse
import io
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

if not __package__:  # called as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from texfcodec.asset.load.files import load
from texfcodec.asset.scene import WRAP_CLAMP, WRAP_MIRROR, Scene
from texfcodec.asset.texel_cover import span_in_band
from texfcodec.ground.kernel import kernel

CHROMA_OFFSET = -1
QPS = "22,28,34,40"
AVIF_QUALITIES = (8, 15, 25, 35, 45, 55, 65, 75, 83, 90, 95)


@dataclass
class TexelImage:
    """An image and the texels of it that are used. image: uint8 [H, W, 3]; mask: bool [H, W]."""

    name: str
    image: np.ndarray
    mask: np.ndarray


@kernel
def _wrapped(i, size, wrap):
    """Texel that an index outside the image stands for."""
    if wrap == WRAP_CLAMP:
        return min(max(i, 0), size - 1)
    if wrap == WRAP_MIRROR:
        i %= 2 * size
        return 2 * size - 1 - i if i >= size else i
    return i % size


@kernel
def _mark(corners, wrap_s, wrap_t, mask):
    """Marks in mask uint8 [H, W] the texels less than one texel from a face in both directions. corners: float64 [F, 3, 2] in
    texels, texel i centred at i."""
    height, width = mask.shape
    for f in range(corners.shape[0]):
        ax, ay, bx, by, cx, cy = corners[f].ravel()
        top = np.int64(np.floor(min(ay, by, cy)))
        for j in range(top, np.int64(np.floor(max(ay, by, cy))) + 2):
            low, high = span_in_band(ax, ay, bx, by, cx, cy, j - 1.0, j + 1.0)
            if low > high:
                continue
            row = _wrapped(j, height, wrap_t)
            for i in range(np.int64(np.floor(low)), np.int64(np.floor(high)) + 2):
                mask[row, _wrapped(i, width, wrap_s)] = 1


def used_texels(scene: Scene, texture: int) -> np.ndarray:
    """Texels of a texture that bilinear interpolation asks anywhere on the surface: bool [H, W]."""
    image, wrap = scene.textures[texture].image, scene.textures[texture].wrap
    mask = np.zeros(image.shape[:2], np.uint8)
    own = np.isin(scene.face_material, [i for i, m in enumerate(scene.materials) if m.texture == texture])
    _mark(scene.corner_uv[own] * (image.shape[1], image.shape[0]) - 0.5, *wrap, mask)
    return mask.astype(bool)


def load_texels(path: Path) -> TexelImage:
    """The largest base-colour image of an asset and its used texels."""
    scene = load(path)
    used = {m.texture for m in scene.materials if m.texture >= 0}
    texture = max(sorted(used), key=lambda t: scene.textures[t].image.size)
    return TexelImage(path.stem, scene.textures[texture].image[:, :, :3].copy(), used_texels(scene, texture))
