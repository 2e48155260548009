"""Integer arithmetic for the kernels of several rooms."""

import numpy as np

from .kernel import instruction, kernel


@kernel
def _isqrt(v):
    """floor(sqrt(v)) for 0 <= v < 2**62, by the digit-by-digit method without floats."""
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


@instruction("ctpop")
def _ones(v):
    """Number of set bits of 0 <= v < 2**63."""
    return int(v).bit_count()
