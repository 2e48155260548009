"""The checksum of a geometry unit's faces. It does not depend on Draco's order of faces (spec clause 5.6.3)."""

import zlib

import numpy as np

from ..core.kernel import kernel

# What a byte makes of a register of 0: with all ones before and after, zlib's CRC-32 of byte b is _TABLE[b ^ 255] ^ 0xFF000000.
_TABLE = np.array([zlib.crc32(bytes([byte ^ 0xFF])) ^ 0xFF000000 for byte in range(256)], np.int64)


def geometry_crc(lattice: np.ndarray, faces: np.ndarray, uv: np.ndarray | None = None) -> int:
    """Return the checksum of a mesh, which ignores the order of its faces: the sum of the faces' CRC-32, modulo 2**32. lattice:
    int64 [V, 3] in 0..2**20-1; faces: int64 [F, 3] into lattice; uv: int64 [V, 2] in -2**26..2**26, or None. Raises IndexError
    for a corner out of range."""
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(lattice):
        raise IndexError("a face has a corner that does not exist")
    corners = lattice if uv is None else np.hstack([lattice, uv])
    return int(_sum_of_faces(np.ascontiguousarray(corners, np.int64), np.ascontiguousarray(faces, np.int64), _TABLE))


@kernel
def _sum_of_faces(corners, faces, table):
    total = np.int64(0)
    for f in range(faces.shape[0]):
        first = _least_turn(corners, faces[f])
        crc = np.int64(0xFFFFFFFF)
        for i in range(3):
            corner = corners[faces[f, (first + i) % 3]]
            for k in range(corner.shape[0]):
                for shift in range(0, 32, 8):
                    crc = table[(crc ^ (corner[k] >> shift)) & 255] ^ (crc >> 8)
        total += crc ^ np.int64(0xFFFFFFFF)
    return total & np.int64(0xFFFFFFFF)


@kernel
def _least_turn(corners, face):
    """Corner 0..2 at which the face's row must start to be lexicographically least."""
    best = 0
    for turn in range(1, 3):
        order = 0
        for i in range(3):
            a, b = corners[face[(turn + i) % 3]], corners[face[(best + i) % 3]]
            for k in range(a.shape[0]):
                if order == 0 and a[k] != b[k]:
                    order = -1 if a[k] < b[k] else 1
        if order < 0:
            best = turn
    return best
