"""Draco bytes of faces of a surface: coded, or estimated from pieces if there are many faces (encoder only)."""

import math

import numpy as np

from ...errors import InputError
from ...field.morton import encode_morton
from ...geometry.areas import used_vertices
from ...geometry.draco import MAX_UV_BITS, enc_geometry, enc_textured, split_corners

MOST_CODED = 1 << 18  # faces; Draco takes five seconds or more for a million, and each candidate mesh needs its bytes
PIECES, PIECE = 4, 1 << 15  # pieces, and faces of each: within 5 % of the whole on three meshes, UVs alone within a third
MORTON_BITS = 16


def draco_bytes(lattice: np.ndarray, faces: np.ndarray, position_bits: int, uv: np.ndarray | None = None) -> float:
    """Return the bytes of some faces as a Draco unit, infinite if Draco cannot code it. lattice: int64 [V, 3], positions; faces:
    int64 [F, 3]; uv: int64 [F, 3, 2] of any origin, UVs of the corners, or None without UVs."""
    try:
        return _coded_bytes(lattice, faces, position_bits, uv)
    except InputError:
        return math.inf


def _coded_bytes(lattice, faces, position_bits, uv):
    """Return the same by coding all faces. Raises InputError TXF-I62 if Draco cannot code the mesh."""
    if len(faces) > MOST_CODED:
        chosen = _pieces(lattice, faces, position_bits)
        part = _coded_bytes(lattice, faces[chosen], position_bits, None if uv is None else uv[chosen])
        return round(part * len(faces) / len(chosen))
    if uv is None:
        used, local = used_vertices(faces, len(lattice))
        return len(enc_geometry(lattice[used], local, position_bits))
    if np.ptp(uv.reshape(-1, 2), axis=0).max() >= 1 << MAX_UV_BITS:
        return math.inf
    vertex, uv, corners = split_corners(faces, uv - uv.min(axis=(0, 1)))
    return len(enc_textured(lattice[vertex], corners, uv, position_bits)[0])


def _pieces(lattice, faces, position_bits):
    """Return the faces of PIECES pieces, evenly spread along the Morton curve, int64 [PIECES * PIECE] ascending."""
    order = np.argsort(encode_morton(lattice[faces[:, 0]] >> max(position_bits - MORTON_BITS, 0)), kind="stable")
    begin = np.linspace(0, len(faces) - PIECE, PIECES).astype(np.int64)
    return np.sort(order[(begin[:, None] + np.arange(PIECE)).ravel()])

