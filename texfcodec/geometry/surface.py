"""The source mesh on its lattice: equal positions merged, collapsed faces left out (encoder only)."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError, LimitError
from .canonical import CanonicalCube, fit_cube


@dataclass
class Surface:
    """The source on its lattice. cube; lattice: int64 [V, 3], no two alike; faces: int64 [F, 3], three different corners each;
    origin_face: int64 [F] into the scene's faces; material: int64 [F]."""

    cube: CanonicalCube
    lattice: np.ndarray
    faces: np.ndarray
    origin_face: np.ndarray
    material: np.ndarray


def make_surface(scene, options):
    """Puts the scene on the lattice, merges equal positions and leaves out faces that have lost a corner (Surface)."""
    limits = options.limits
    for code, what, count, limit in (("TXF-L02", "vertices", len(scene.positions), limits.vertices),
                                     ("TXF-L03", "faces", len(scene.faces), limits.faces)):
        if limit is not None and count > limit:
            raise LimitError(code, f"the mesh has more {what} than the limit allows", value=count, allowed=limit)
    cube = fit_cube(scene.positions, options.position_bits)
    points = cube.to_lattice(scene.positions)
    packed = points[:, 0] | (points[:, 1] << 20) | (points[:, 2] << 40)
    unique, place = np.unique(packed, return_inverse=True)
    lattice = np.stack([(unique >> shift) & 0xFFFFF for shift in (0, 20, 40)], axis=1)
    faces = place.reshape(-1)[scene.faces]
    keep = np.flatnonzero((faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0]))
    if len(keep) == 0 and not options.allow_empty:
        raise InputError("TXF-I63", "every face is degenerate: no three corners are apart", value=len(faces))
    return Surface(cube, lattice, faces[keep], keep, np.asarray(scene.face_material)[keep])
