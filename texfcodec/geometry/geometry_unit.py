"""Decoded geometry units: one for each field and material (spec clause 5.6)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass
class GeometryUnit:
    """Decoded mesh of one field and material. lattice: int64 [V, 3]; faces: int64 [F, 3] into lattice; uv: int64 [V, 2] in steps
    of 2**-uv_fraction_bits texels of its field, None if the field is over voxels. With uv, a lattice position occurs once for
    every chart that contains it."""

    field: int
    material: int
    lattice: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None = None


class LatticeMesh(NamedTuple):
    """lattice: int64 [V, 3]; faces: int64 [F, 3] into lattice."""

    lattice: np.ndarray
    faces: np.ndarray


def field_surface(units: list, number: int) -> LatticeMesh:
    """Concatenate the geometry units of one field to a single LatticeMesh. units: all GeometryUnits of the stream; number: of
    the field."""
    of_field = [u for u in units if u.field == number]
    starts = np.cumsum([0] + [len(u.lattice) for u in of_field])
    faces = [u.faces + s for u, s in zip(of_field, starts[:-1], strict=True)]
    return LatticeMesh(np.concatenate([u.lattice for u in of_field]), np.concatenate(faces))


def field_uv(units: list, number: int) -> np.ndarray:
    """Concatenate the UVs of the geometry units of one field over texels: int64 [V, 2], parallel to the lattice of
    field_surface(). units: all GeometryUnits of the stream; number: of the field."""
    return np.concatenate([u.uv for u in units if u.field == number])
