"""Which decoded face a face of the source became: found by its corners on the lattice, its orientation and its material."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..texf import Texf


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
