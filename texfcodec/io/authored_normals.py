"""Normals and tangents of files, placed and scaled to length 1 for a Scene; faces without normals are flat."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..report import plural

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .parts import Notes, Part

_SHORTEST = 1e-12  # of a stored normal: below it rounding has eaten the direction


def place_normals(normals: np.ndarray | None, linear: np.ndarray) -> np.ndarray | None:
    """Return normals [..., 3], of any length, multiplied by the inverse transpose of a node's matrix; None for None. linear: that
    matrix, float64 [3, 3].

    Cofactors stand for the inverse, so that a node that is flat along an axis still gives its surface a direction.
    """
    if normals is None:
        return None
    x, y, z = linear.T  # columns
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    return np.asarray(normals, np.float64) @ (cofactors.T * (-1.0 if np.linalg.det(linear) < 0 else 1.0))


def place_tangents(tangents: np.ndarray | None, linear: np.ndarray) -> np.ndarray | None:
    """Return tangents [..., 4] with directions multiplied by a node's matrix, float64 [3, 3]; None for None. If the matrix
    mirrors, w changes its sign."""
    if tangents is None:
        return None
    tangents = np.array(tangents, np.float64)
    tangents[..., :3] = tangents[..., :3] @ linear.T
    if np.linalg.det(linear) < 0:
        tangents[..., 3] *= -1.0
    return tangents


def fill_normals(scene: Scene, parts: list[Part], notes: Notes) -> None:
    """Fill scene.corner_normal and scene.corner_tangent if any Part has normals or tangents. parts: those that the faces came
    from, in order. Parts without normals are flat. A face normal replaces a broken normal, with one remark. Broken and absent
    tangents are zero."""
    if any(part.normal is not None for part in parts):
        scene.corner_normal, broken = _normals(scene, parts)
        if broken:
            notes.remark(plural(broken, "face corner has a normal that is", "face corners have normals that are")
                         + " zero, NaN or infinite; face normals are used instead")
    if any(part.tangent is not None for part in parts):
        scene.corner_tangent = _tangents(scene, parts)


def _normals(scene, parts):
    """(unit normals float32 [F, 3, 3], number of broken normals)."""
    out, row, broken = np.empty((len(scene.faces), 3, 3), np.float32), 0, 0
    for part in parts:
        rows = slice(row, row + len(part.faces))
        row = rows.stop
        if part.normal is None:
            out[rows] = face_normals(scene.positions, scene.faces[rows])[:, None]
            continue
        values, bad = _directions(part.normal)
        values, bad = (values[part.faces], bad[part.faces]) if values.ndim == 2 else (values, bad)
        out[rows] = values
        if bad.any():
            broken += int(bad.sum())
            faces = np.flatnonzero(bad.any(axis=1))
            flat = np.broadcast_to(face_normals(scene.positions, scene.faces[rows][faces])[:, None], (len(faces), 3, 3))
            mended = out[rows]  # a view
            mended[faces] = np.where(bad[faces][..., None], flat, mended[faces])
    return out, broken


def _tangents(scene, parts):
    """float32 [F, 3, 4]: length 1 and a side of -1 or 1, or zero."""
    out, row = np.zeros((len(scene.faces), 3, 4), np.float32), 0
    for part in parts:
        rows = slice(row, row + len(part.faces))
        row = rows.stop
        if part.tangent is None:
            continue
        side = np.asarray(part.tangent[..., 3], np.float64)
        direction, bad = _directions(part.tangent[..., :3])
        bad = bad | ~(np.abs(side) > 0)
        values = np.where(bad[..., None], 0.0, np.concatenate([direction, np.sign(side)[..., None]], axis=-1))
        out[rows] = values[part.faces] if values.ndim == 2 else values
    return out


def _directions(vectors):
    """(vectors [..., 3] scaled to length 1, bool [...] of vectors that have no direction)."""
    vectors = np.asarray(vectors, np.float64)
    largest = np.abs(vectors).max(axis=-1)
    bad = ~(np.isfinite(largest) & (largest > _SHORTEST))
    scaled = np.where(bad[..., None], 1.0, vectors) / np.where(bad, 1.0, largest)[..., None]
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True), bad


def face_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the unit normals of faces, float64 [F, 3]; (0, 0, 1) for faces without area. positions: float64 [V, 3]; faces: int64
    [F, 3]."""
    u, v = (positions[faces[:, i]] - positions[faces[:, 0]] for i in (1, 2))
    longest = np.maximum(np.abs(u).max(axis=1), np.abs(v).max(axis=1))[:, None]
    scale = np.where(longest > 0, longest, 1.0)
    normal = np.cross(u / scale, v / scale)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 0, normal / np.where(length > 0, length, 1.0), (0.0, 0.0, 1.0))
