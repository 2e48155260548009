"""The canonical cube and its integer lattice (spec clause 6.1 and 8.1; paper: canonical space of the field)."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError

MAX_COORDINATE = 1e150  # beyond this a difference of two coordinates is no longer safe to scale
MIN_BITS, MAX_BITS = 8, 20


@dataclass(frozen=True)
class CanonicalCube:
    """Minimum corner and longest side of the axis-aligned box, both binary64, and the bits of a lattice coordinate."""

    origin: tuple[float, ...]
    side: float
    position_bits: int

    @property
    def last(self) -> int:
        """Largest lattice coordinate, 2**B - 1."""
        return (1 << self.position_bits) - 1

    def to_lattice(self, points: np.ndarray) -> np.ndarray:
        """Return the lattice point nearest to each world point. points: float64 [..., 3]. Returns int64 of the same shape in
        0..2**B-1. Encoder only."""
        if self.side == 0:
            return np.zeros(np.shape(points), np.int64)
        scaled = (np.asarray(points, np.float64) - self.origin) / self.side * self.last
        return np.clip(np.floor(scaled + 0.5), 0, self.last).astype(np.int64)

    def to_world(self, lattice: np.ndarray) -> np.ndarray:
        """Return world positions of lattice coordinates p: origin + side * (p / (2**B - 1)) in binary64 (spec 8.1). lattice:
        int64 or float64 [..., 3]."""
        return np.asarray(self.origin) + self.side * (np.asarray(lattice, np.float64) / self.last)

    def to_grid(self, points: np.ndarray, resolution: int) -> np.ndarray:
        """Grid coordinates of world points for a field of resolution K: lattice coordinate * K / 2**B, float64 [..., 3].

        A vertex at lattice position p has grid coordinate p K / 2**B, and voxel v covers [v, v + 1) on every axis.
        """
        scale = self.last * (resolution / (1 << self.position_bits))
        if self.side == 0:
            return np.zeros(np.shape(points), np.float64)
        return (np.asarray(points, np.float64) - self.origin) / self.side * scale


def finer_cube(cube: CanonicalCube) -> CanonicalCube:
    """Return the cube of the finest lattice in which every world point keeps the grid coordinates that it has in `cube`. Encoder
    only."""
    side = cube.side * ((1 << MAX_BITS) - 1) / (cube.last << (MAX_BITS - cube.position_bits))
    return CanonicalCube(cube.origin, side, MAX_BITS)


def fit_cube(positions: np.ndarray, position_bits: int) -> CanonicalCube:
    """Return the canonical cube around a mesh; side 0 at the origin without positions. positions: float64 [V, 3], finite;
    position_bits: bits of a lattice coordinate. Raises InputError for coordinates out of range."""
    if len(positions) == 0:
        return CanonicalCube((0.0, 0.0, 0.0), 0.0, position_bits)
    low, high = positions.min(axis=0), positions.max(axis=0)
    if max(np.abs(low).max(), np.abs(high).max()) > MAX_COORDINATE:
        raise InputError("TXF-I60", "the mesh has coordinates that are too large", value=float(np.abs(positions).max()),
                         allowed=f"|coordinate| <= {MAX_COORDINATE}")
    side = float((high - low).max())
    if 0 < side < 1e-290:
        raise InputError("TXF-I61", "the mesh is too small to be scaled", value=side, allowed=">= 1e-290")
    return CanonicalCube(tuple(float(v) for v in low), side, position_bits)
