"""Integer arithmetic that kernels of several rooms need."""

import numpy as np

from .kernel import kernel


@kernel
def _isqrt(v):
    """floor(sqrt(v)) for 0 <= v < 2**62, by the digit-by-digit method: no float anywhere."""
    root = np.int64(0)
    bit = np.int64(1) << 60
    while bit > v:
        bit >>= 2
    while bit != 0:
        if v >= root + bit:
            v -= root + bit
            root = (root >> 1) + bit
        else:
            root >>= 1
        bit >>= 2
    return root


@kernel
def _ones32(v):
    """Set bits of 0 <= v < 2**32 held in an int64."""
    v = v - ((v >> 1) & 0x55555555)
    v = (v & 0x33333333) + ((v >> 2) & 0x33333333)
    v = (v + (v >> 4)) & 0x0F0F0F0F
    v = v + (v >> 8)
    return (v + (v >> 16)) & 63
