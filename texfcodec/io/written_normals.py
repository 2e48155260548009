"""Shading normals for formats that are text or have normals at vertices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..texf import Texf

_STEPS = 10_000  # of a component, a hundredth of a degree
_SAME = 1 - 1e-4  # cosine of the angle, 0.8 degrees, within which normals at a vertex are one


def are_lit(texf: Texf) -> bool:
    """Return whether any material on faces of a decoded stream is lit, so that normals change the picture."""
    return any(not texf.materials[number].unlit for number in np.flatnonzero(np.bincount(texf.face_material)).tolist())


def distinct_normals(texf: Texf) -> tuple[np.ndarray, np.ndarray]:
    """Return (the distinct shading normals of face corners, float64 [N, 3] with four decimals; their index at each
    corner, int64 [F, 3])."""
    steps = np.rint(texf.shading_normals().reshape(-1, 3).astype(np.float64) * _STEPS).astype(np.int64) + _STEPS
    packed = (steps[:, 0] << 40) + (steps[:, 1] << 20) + steps[:, 2]
    kinds, index = np.unique(packed, return_inverse=True)
    parts = [(kinds >> shift) & ((1 << 20) - 1) for shift in (40, 20, 0)]
    return (np.stack(parts, axis=1) - _STEPS) / _STEPS, index.reshape(-1, 3)


def normals_at_vertices(texf: Texf, index: np.ndarray, count: int) -> np.ndarray | None:
    """Return the shading normal of each vertex, float32 [count, 3]; None if the corners at a vertex have several. index: vertex
    of every corner, int64 [F, 3], below count.
    Faces without area are ignored."""
    normal, corner = texf.shading_normals().reshape(-1, 3), index.ravel()
    first = np.zeros((count, 3), np.float32)
    there = np.repeat(face_areas(texf) > 0, 3)
    first[corner] = normal
    first[corner[there]] = normal[there]
    same = (first[corner] * normal).sum(axis=1) >= _SAME
    return first if bool(same[there].all()) else None


def face_areas(texf: Texf) -> np.ndarray:
    """Return twice the area of each face of a decoded stream, float64 [F], in squared steps of the position lattice."""
    a, b, c = (texf.lattice_positions[texf.faces[:, k]].astype(np.float64) for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)
