"""Shading normals of surface points, from the corners' normals and tangents and from normal maps. Every result is unit and
finite."""

from __future__ import annotations

import numpy as np

from .surface import cross, unit


def interpolate_corners(corner: np.ndarray, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
    """What corners hold, float32 [F, 3, C], at points of faces int64 [M] with barycentric coordinates [M, 3]: float32 [M, C]."""
    weights = np.asarray(bary, np.float32)
    out = corner[face, 0] * weights[:, :1]
    out += corner[face, 1] * weights[:, 1:2]
    out += corner[face, 2] * weights[:, 2:]
    return out


def towards_viewer(normal: np.ndarray, geometric: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Normals [M, 3], turned over where the face is seen from behind, as glTF asks of double-sided materials. geometric: [M, 3]
    of the face, counter-clockwise; view: [M, 3] from the point to the eye."""
    behind = np.einsum("mk,mk->m", geometric, view) < 0
    return np.where(behind[:, None], -normal, normal)


def usable_normals(normal: np.ndarray, geometric: np.ndarray) -> np.ndarray:
    """Unit normals float32 [M, 3]: normal; where that is zero or not finite, geometric; where that is neither, +z."""
    up = np.zeros((3, len(normal)), np.float32)
    up[2] = 1
    return np.ascontiguousarray(unit(normal, unit(geometric, up)).T)


def tangent_space_normals(texel: np.ndarray, scale: np.ndarray | float, normal: np.ndarray, tangent: np.ndarray,
                          geometric: np.ndarray) -> np.ndarray:
    """World normals float32 [M, 3] of a tangent-space map.

    texel: [M, 2] red and green, 0..255; 127.5 is 0; blue follows from length 1, and is 0 where red and green are longer. scale:
    [M] or one, of glTF's normalTexture; normal: [M, 3], interpolated; tangent: [M, 4], interpolated, with the bitangent's sign,
    which is cross(normal, tangent) times it; geometric: [M, 3] of the face. Where the tangent or the texel is of no use, the
    result is the interpolated normal; where that is of no use, the geometric one; see usable_normals().
    """
    n = usable_normals(normal, geometric).T
    t = unit(tangent[:, :3], np.zeros_like(n))
    b = cross(n, t) * np.where(tangent[:, 3] < 0, np.float32(-1), np.float32(1))
    scale = np.asarray(scale, np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = np.ascontiguousarray(np.asarray(texel, np.float32).T) * np.float32(2 / 255) - 1
        z = np.sqrt(np.maximum(1 - x * x - y * y, np.float32(0)))
        bent = (x * scale) * t + (y * scale) * b + z * n
        useful = (t * t).sum(axis=0) > 0.5
        bent = np.where(useful, bent, n)
    return np.ascontiguousarray(unit(bent.T, n).T)


def deviated_normals(deviation: np.ndarray, normal: np.ndarray, geometric: np.ndarray) -> np.ndarray:
    """World normals float32 [M, 3] of a map of deviations in object space: normal + deviation, renewed in length. deviation: [M,
    3]; where the sum is zero or not finite the result is the normal; normal and geometric as in usable_normals()."""
    n = usable_normals(normal, geometric)
    with np.errstate(invalid="ignore", over="ignore"):
        total = n + np.asarray(deviation, np.float32)
        short = np.einsum("mk,mk->m", total, total) < 1e-10
    total[short] = n[short]
    return np.ascontiguousarray(unit(total, n.T).T)
