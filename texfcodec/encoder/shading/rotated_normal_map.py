"""Texels of normal maps in another frame: the mean of the rotations that all faces showing a texel need (encoder only)."""

from __future__ import annotations

import numpy as np

from ...field.texel_set import shown_area
from ...scene.factors import FLAT
from ..supports.texel_means import texel_means

FRACTION_BITS = 4  # of UVs; faces are divided into parts before


def mean_matrices(off: tuple[np.ndarray, np.ndarray, np.ndarray], others: tuple[np.ndarray, np.ndarray], scale: np.ndarray,
                  size: tuple[int, int], wrap: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices for the texels that some faces show.

    Parameters
    ----------
    off : (float64 [N, 3, 2], float64 [N, 3, 3, 3], float64 [N])
        UVs of faces that need a rotation, the matrix of each of their corners, and their areas.
    others : (float64 [M, 3, 2], float64 [M])
        UVs and areas of the faces that need the unit matrix.
    scale : float64 [2]
        From UVs to texels of the image.
    size, wrap : (int, int)
        (width, height) of the image; its modes.

    Returns
    -------
    (int64 [T], float64 [T, 3, 3])
        Texels as flat indices into the image, and the mean, by area, of the matrices of all faces that show each; none if the
        image repeats too often (texel_means).
    """
    steps = [np.floor(uv * (scale * (1 << FRACTION_BITS)) + 0.5).astype(np.int64) for uv in (off[0], others[0])]
    means = texel_means(steps[0], off[1].reshape(-1, 3, 9), off[2], FRACTION_BITS, size, wrap)
    corners = steps[1].reshape(-1, 2)
    right = shown_area(corners, np.arange(len(corners)).reshape(-1, 3), FRACTION_BITS, size, wrap, others[1])
    share = (means.area / (means.area + right.reshape(-1)[means.texel]))[:, None]
    return means.texel, (share * means.mean + (1 - share) * np.eye(3).ravel()).reshape(-1, 3, 3)


def rotate_normal_map(texels: np.ndarray, matrices: np.ndarray, scale: float) -> np.ndarray:
    """Return tangent-space normals in other frames.

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
