"""Which decoded face a face of the source became: found by its corners on the lattice, its orientation and its material."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..geometry.areas import face_areas

if TYPE_CHECKING:
    from ..geometry.mesh import Mesh
    from ..scene.scene import Scene
    from ..texf import Texf

# Of the square root of a mesh's area: by so much farther counts a face that looks the other way. A person has 1.3 sides of that,
# so it is 0.7 % of the side, some voxels, which is more than surfaces are moved and less than the thickness of most parts.
SHEETS = 4 / 500_000**0.5


def sheet_gap(mesh: Mesh) -> float:
    """The distance by which a face of the mesh that looks the other way counts as farther, in the mesh's units."""
    middle, half = mesh.frame()
    return float(SHEETS * half * np.sqrt(face_areas((mesh.positions - middle) / half, mesh.faces).sum()))


def decoded_faces(scene: Scene, texf: Texf) -> tuple[np.ndarray, np.ndarray]:
    """(face of texf that each face of the source became int64 [F], -1 where there is none; by how many corners it is turned int64
    [F]: corner k of the source is corner (k + turn) % 3 there)."""
    here, turn = _face_keys(texf.cube.to_lattice(scene.positions)[scene.faces], scene.face_material)
    there, turned = _face_keys(texf.lattice_positions[texf.faces], texf.face_material)
    number = np.unique(np.concatenate([here, there]), axis=0, return_inverse=True)[1].reshape(-1)
    face = np.full(len(number), -1, np.int64)
    face[number[len(here) :]] = np.arange(len(there))
    found = face[number[: len(here)]]
    if not len(there):
        return found, np.zeros(len(here), np.int64)
    return found, np.where(found >= 0, (turned[np.maximum(found, 0)] - turn) % 3, 0)


def _face_keys(lattice, material):
    """int64 [F, 4]: three packed corners, lattice int64 [F, 3, 3], the smallest first and orientation kept, and the material; and
    which corner was the smallest, int64 [F]."""
    packed = lattice[:, :, 0] | lattice[:, :, 1] << 20 | lattice[:, :, 2] << 40
    first = packed.argmin(axis=1)
    order = (first[:, None] + np.arange(3)) % 3
    return np.column_stack([np.take_along_axis(packed, order, axis=1), material]), first
