"""Shading normals of surface points, from the corners' normals and tangents and from normal maps. Every result is unit and
finite."""

from __future__ import annotations

import numpy as np

from .shading_points import cross, unit


def interpolate_corners(corner: np.ndarray, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
    """Interpolate values of face corners at points of faces.

    Parameters
    ----------
    corner : float32 [F, 3, C]
        Values at each face's corners.
    face : int64 [M]
        Face of each point.
    bary : float [M, 3]
        Barycentric coordinates.

    Returns
    -------
    float32 [M, C]
        Interpolated values.
    """
    weights = np.asarray(bary, np.float32)
    out = corner[face, 0] * weights[:, :1]
    out += corner[face, 1] * weights[:, 1:2]
    out += corner[face, 2] * weights[:, 2:]
    return out


def towards_viewer(normal: np.ndarray, geometric: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return normals, turned over if the face is seen from behind, as in glTF for double-sided materials.

    Parameters
    ----------
    normal : float32 [M, 3]
        Shading normals.
    geometric : float32 [M, 3]
        Normals of the faces, counter-clockwise.
    view : float32 [M, 3]
        From the points to the eye.

    Returns
    -------
    float32 [M, 3]
        Towards the eye.
    """
    behind = np.einsum("mk,mk->m", geometric, view) < 0
    return np.where(behind[:, None], -normal, normal)


def usable_normals(normal: np.ndarray, geometric: np.ndarray) -> np.ndarray:
    """Return unit normals, with a substitute for each that is zero or not finite.

    Parameters
    ----------
    normal : float32 [M, 3]
        First choice.
    geometric : float32 [M, 3]
        Second choice; the third is +z.

    Returns
    -------
    float32 [M, 3]
        Unit and finite.
    """
    up = np.zeros((3, len(normal)), np.float32)
    up[2] = 1
    return np.ascontiguousarray(unit(normal, unit(geometric, up)).T)


def tangent_space_normals(texel: np.ndarray, scale: np.ndarray | float, normal: np.ndarray, tangent: np.ndarray,
                          geometric: np.ndarray) -> np.ndarray:
    """Return the world normals that a tangent-space normal map gives at points.

    Parameters
    ----------
    texel : float [M, 2]
        Red and green, 0..255; 127.5 is 0. Blue follows from length 1, and is 0 if red and green are longer.
    scale : float or float [M]
        Of glTF's normalTexture.
    normal : float32 [M, 3]
        Interpolated.
    tangent : float32 [M, 4]
        Interpolated; the bitangent is cross(normal, tangent) times the fourth column.
    geometric : float32 [M, 3]
        Normals of the faces.

    Returns
    -------
    float32 [M, 3]
        Of length 1; the interpolated normal if the tangent or the texel is unusable, see usable_normals().
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
    """Return the world normals that a map of deviations in object space gives: normal + deviation, scaled to length 1.

    Parameters
    ----------
    deviation : float32 [M, 3]
        Values of the map, about -1..1.
    normal, geometric
        As of usable_normals().

    Returns
    -------
    float32 [M, 3]
        The normal if the sum is zero or not finite.
    """
    n = usable_normals(normal, geometric)
    with np.errstate(invalid="ignore", over="ignore"):
        total = n + np.asarray(deviation, np.float32)
        short = np.einsum("mk,mk->m", total, total) < 1e-10
    total[short] = n[short]
    return np.ascontiguousarray(unit(total, n.T).T)
