"""Areas of triangles, and points spread evenly by area over a surface."""

from collections.abc import Sequence

import numpy as np


def face_areas(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas of the faces in squared lattice steps, float64 [F]. lattice: int64 [V, 3]; faces: int64 [F, 3]."""
    a, b, c = (lattice[faces[:, i]].astype(np.float64) for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def sample_surface(positions: np.ndarray, faces: np.ndarray, count: int, seed: int | Sequence[int] = 0,
                   areas: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly by area over a triangle mesh.

    positions: [V, 3] finite; faces: [F, 3] indices. Returns face_index int64 [count], ascending, and bary float64 [count, 3],
    non-negative, summing to 1 (to rounding), in the faces' corner order. One point falls into each of `count` equal strips of
    the cumulative area, so a face with the share s of all area gets floor(s count) - 1 to ceil(s count) + 1 points, and one
    without area gets none. areas: of relative_areas, where many calls are made. The same arguments give the same points.

    Raises ValueError for bad indices, corners that are not finite, and meshes without area.
    """
    positions, faces = np.asarray(positions, dtype=np.float64), np.asarray(faces)
    if count < 0:
        raise ValueError(f"count must not be negative, not {count}")
    if positions.ndim != 2 or positions.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"positions and faces must be [V, 3] and [F, 3], not {list(positions.shape)}, {list(faces.shape)}")
    if faces.dtype.kind not in "iu" or (len(faces) and not (faces.min() >= 0 and faces.max() < len(positions))):
        raise ValueError(f"faces must hold integers from 0 to {len(positions) - 1}")
    if count == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    cumulative = np.cumsum(relative_areas(positions, faces) if areas is None else areas)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise ValueError("the mesh has no face with area to sample")
    rng = np.random.default_rng(seed)
    target = (np.arange(count) + rng.random(count)) * (cumulative[-1] / count)
    face_index = np.searchsorted(cumulative, target, side="right")  # "right" steps over faces whose area is zero
    last = np.searchsorted(cumulative, cumulative[-1], side="left")  # rounding may lift the last target to the total
    face_index = np.minimum(face_index, last).astype(np.int64)
    root, t = np.sqrt(rng.random(count)), rng.random(count)
    return face_index, np.stack([1 - root, root * (1 - t), root * t], axis=1)


def relative_areas(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Face areas float64 [F] in units of the squared largest extent, so that no scale (1e-300 to 1e300) over- or underflows."""
    corners = positions[faces].reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise ValueError("positions must be finite")
    if not corners.any():
        return np.zeros(len(faces))
    corners = corners / np.abs(corners).max()  # first, so that the extent below is at most 2
    corners -= corners.min(axis=0)
    if not corners.any():
        return np.zeros(len(faces))
    a, b, c = np.moveaxis((corners / corners.max()).reshape(-1, 3, 3), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
