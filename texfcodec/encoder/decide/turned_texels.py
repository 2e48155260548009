"""Texels of normal maps in another frame: the mean of what all faces that show a texel need (encoder only)."""

from __future__ import annotations

import numpy as np

from ...field.texel_set import shown_area
from ...scene.factors import FLAT
from ..texel_field import FULL_BITS
from ..texel_means import texel_means


def mean_matrices(uv: np.ndarray, between: np.ndarray, area: np.ndarray, off: np.ndarray, size: tuple[int, int],
                  wrap: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """What the texels need that some faces show.

    Parameters
    ----------
    uv : int64 [N, 3, 2]
        Of all faces, in steps of 2**-FULL_BITS texels.
    between : float64 [N, 3, 3, 3]
        What each corner of a face needs.
    area : float64 [N]
        Of the faces.
    off : bool [N]
        The faces that need something; the others need the unit matrix.
    size, wrap : (int, int)
        (width, height) of the image; its modes.

    Returns
    -------
    (int64 [T], float64 [T, 3, 3])
        Texels as flat indices into the image, and the mean, by area, of what all faces that show each need; none where the image
        repeats too often (texel_means).
    """
    found = texel_means(uv[off], between[off].reshape(-1, 3, 9), area[off], FULL_BITS, size, wrap)
    others = uv[~off].reshape(-1, 2)
    right = shown_area(others, np.arange(len(others)).reshape(-1, 3), FULL_BITS, size, wrap, area[~off]).reshape(-1)[found.texel]
    share = (found.area / (found.area + right))[:, None]
    return found.texel, (share * found.mean + (1 - share) * np.eye(3).ravel()).reshape(-1, 3, 3)


def turned_texels(texels: np.ndarray, matrices: np.ndarray, scale: float) -> np.ndarray:
    """Tangent-space normals in other frames.

    Parameters
    ----------
    texels : float32 [T, 2]
        x and y, 0..255; z follows from length 1.
    matrices : float64 [T, 3, 3]
        From the old frame into the new.
    scale : float
        Of the map, glTF's normalTexture.scale, which stays.

    Returns
    -------
    float64 [T, 3]
        Whole numbers in 0..255, of length 1 as directions. A normal that would point inwards lies in the plane.
    """
    xy = texels.astype(np.float64) / FLAT - 1
    normal = np.column_stack([scale * xy, np.sqrt(np.maximum(1 - (xy**2).sum(axis=1), 0.0))])
    normal = np.einsum("nij,nj->ni", matrices, normal)
    normal[:, 2] = np.maximum(normal[:, 2], 0.0)
    normal[:, :2] /= scale or 1.0
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    return np.clip(np.rint((normal + 1) * FLAT), 0, 255)
