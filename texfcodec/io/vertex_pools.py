"""Vertices that several meshes of a file share: each mesh takes those that its faces use, so that memory is linear in faces."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np


def used_rows(indices: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return (numbers of the rows that indices refer to, ascending; indices renumbered to those rows), or None if they refer to
    all `count` rows or if an index is out of range. indices: integers of any shape, which the second array keeps. Time is linear
    in indices, not in rows."""
    if not indices.size or indices.min() < 0 or indices.max() >= count:
        return None
    if indices.size < count // 8:
        rows, inverse = np.unique(indices, return_inverse=True)
        return rows.astype(np.int64), inverse.reshape(indices.shape)
    used = np.zeros(count, bool)
    used[indices] = True
    return None if used.all() else (np.flatnonzero(used), (np.cumsum(used) - 1)[indices])


class VertexPools:
    """The vertex pools of a file, with flags for the vertices that faces use."""

    def __init__(self) -> None:
        self._pools: dict[Hashable, tuple[np.ndarray, np.ndarray]] = {}

    def take(self, key: Hashable, positions: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
        """Mark the vertices that a mesh uses and return (their rows of the pool, or None for all; indices into these rows). key:
        of the pool; positions: [V, 3] of all its vertices, as stored; indices: integers of any shape."""
        if key not in self._pools:
            self._pools[key] = positions, np.zeros(len(positions), bool)
        used = self._pools[key][1]
        taken = used_rows(indices, len(positions))
        if taken is None:
            inside = indices[(indices >= 0) & (indices < len(positions))]
            used[inside] = True
            return None, indices
        used[taken[0]] = True
        return taken

    def unused(self) -> tuple[int, int]:
        """(number of vertices that no face uses, number of those that are NaN or infinite)."""
        count = broken = 0
        for positions, used in self._pools.values():
            left = np.flatnonzero(~used)
            count += len(left)
            if len(left) and positions.dtype.kind == "f":
                broken += int((~np.isfinite(positions[left]).all(axis=1)).sum())
        return count, broken
