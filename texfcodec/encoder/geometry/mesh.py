"""A triangle mesh as the encoder's geometry takes and returns it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Mesh(NamedTuple):
    """positions: float64 [V, 3]; faces: int64 [F, 3] into positions."""

    positions: np.ndarray
    faces: np.ndarray

    def checked(self) -> Mesh:
        """The same in contiguous float64 and int64. Raises ValueError for shapes, indices and positions that are none."""
        positions = np.ascontiguousarray(self.positions, np.float64).reshape(-1, 3)
        faces = np.ascontiguousarray(self.faces, np.int64).reshape(-1, 3)
        if not np.isfinite(positions).all():
            raise ValueError("positions must be finite")
        if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
            raise ValueError(f"faces must hold integers from 0 to {len(positions) - 1}")
        return Mesh(positions, faces)

    def frame(self) -> tuple[np.ndarray, float]:
        """Middle of the box, float64 [3], and half its longest side, 1 where it has none: positions less the middle, divided by
        this, are in -1..1."""
        if not len(self.positions):
            return np.zeros(3), 1.0
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        half = float(np.max(high / 2 - low / 2))
        return low / 2 + high / 2, half if half > 0 else 1.0
