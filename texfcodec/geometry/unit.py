"""Geometry as it decodes: one unit per field and material (spec clause 5.6)."""

from dataclasses import dataclass

import numpy as np


@dataclass
class GeometryUnit:
    """lattice: int64 [V, 3]; faces: int64 [F, 3] into lattice."""

    field: int
    material: int
    lattice: np.ndarray
    faces: np.ndarray


def field_surface(units: list, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Lattice and faces of all geometry units of one field, joined: (int64 [V, 3], int64 [F, 3])."""
    mine = [u for u in units if u.field == number]
    starts = np.cumsum([0] + [len(u.lattice) for u in mine])
    faces = [u.faces + s for u, s in zip(mine, starts[:-1], strict=True)]
    return np.concatenate([u.lattice for u in mine]), np.concatenate(faces)
