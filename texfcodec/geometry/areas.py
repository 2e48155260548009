"""Areas of triangles, and points spread evenly by area over a surface."""

from collections.abc import Sequence

import numpy as np


def face_areas(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Areas of the faces in squared lattice steps, float64 [F]. lattice: int64 [V, 3]; faces: int64 [F, 3]."""
    u, v = edge_columns(lattice, faces)
    return np.sqrt(squared_cross(u, v)) / 2


def edge_columns(points: np.ndarray, faces: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return two edges of each face, from its first corner to the second and to the third, each as three columns x, y, z,
    float64 [F]. points: [V, 3]; faces: int64 [F, 3]. Columns are four times faster than rows of three."""
    first, second, third = (np.ascontiguousarray(faces[:, i]) for i in range(3))
    u, v = [], []
    for axis in range(3):
        column = np.ascontiguousarray(points[:, axis], np.float64)
        origin = column[first]
        u.append(column[second] - origin)
        v.append(column[third] - origin)
    return u, v


def squared_cross(u: list[np.ndarray], v: list[np.ndarray]) -> np.ndarray:
    """Return the squared lengths of the cross products of vectors u and v, float64 [F]. u, v: columns as edge_columns() returns
    them."""
    parts = [(u[i] * v[j] - u[j] * v[i]) ** 2 for i, j in ((1, 2), (2, 0), (0, 1))]
    return parts[0] + parts[1] + parts[2]


def sample_surface(positions: np.ndarray, faces: np.ndarray, count: int, seed: int | Sequence[int] = 0,
                   areas: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly by area over a triangle mesh: (face_index int64 [count], ascending; bary float64 [count, 3],
    non-negative, summing to 1 (to rounding), in the faces' corner order).

    positions: [V, 3] finite; faces: [F, 3] indices; areas: of the faces by relative_areas(), to save time in repeated calls;
    seed: of the random places. One point falls into each of `count` equal strips of the cumulative area. A face with the share s
    of all area therefore gets floor(s count) - 1 to ceil(s count) + 1 points, and a face without area gets none. The same
    arguments give the same points.

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
        raise ValueError("no face of the mesh has an area to sample")
    rng = np.random.default_rng(seed)
    target = (np.arange(count) + rng.random(count)) * (cumulative[-1] / count)
    face_index = np.searchsorted(cumulative, target, side="right")  # "right" steps over faces whose area is zero
    last = np.searchsorted(cumulative, cumulative[-1], side="left")  # rounding may lift the last target to the total
    face_index = np.minimum(face_index, last).astype(np.int64)
    root, t = np.sqrt(rng.random(count)), rng.random(count)
    return face_index, np.stack([1 - root, root * (1 - t), root * t], axis=1)


def relative_areas(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return face areas, float64 [F], in units of the squared largest extent of the mesh, so that no scale (1e-300 to 1e300)
    overflows or underflows. positions: [V, 3]; faces: [F, 3]."""
    used, faces = used_vertices(faces, len(positions))
    corners = positions[used]
    if not np.isfinite(corners).all():
        raise ValueError("positions must be finite")
    if not corners.any():
        return np.zeros(len(faces))
    corners = corners / np.abs(corners).max()  # first, so that the extent below is at most 2
    corners -= corners.min(axis=0)
    if not corners.any():
        return np.zeros(len(faces))
    return np.sqrt(squared_cross(*edge_columns(corners / corners.max(), faces))) / 2


def area_shares(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return face areas, float64 [F], as shares of the total; all 0 if the mesh has no area. positions: [V, 3]; faces: [F,
    3]."""
    areas = relative_areas(positions, faces)
    return areas / (areas.sum() or 1.0)


def used_vertices(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (ascending numbers of the vertices that faces use, int64 [n]; the faces with their corners renumbered to those).
    faces: int64 [F, 3] below count."""
    if 4 * faces.size < count:  # few faces of a large mesh: sorting them takes less than a walk over all vertices
        used, local = np.unique(faces, return_inverse=True)
        return used, local.reshape(-1, 3)
    there = np.zeros(count, bool)
    there[faces.reshape(-1)] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[faces]
