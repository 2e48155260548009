"""Integer arithmetic that kernels of several rooms need."""

import numpy as np
from numba.extending import intrinsic, overload

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


def _ones(v):
    """Set bits of 0 <= v < 2**63; one instruction in kernels, which have no name for it."""
    return int(v).bit_count()


@intrinsic
def _population(_, v):
    return v(v), lambda context, builder, signature, values: builder.ctpop(values[0])


@overload(_ones)
def _ones_in_kernels(v):
    return lambda v: _population(np.int64(v))  # type: ignore[call-arg]  # numba gives the first one
