"""The encoder's choice of a prediction kernel: every candidate codes a few pieces of the field, the cheapest wins."""

import numpy as np

from .codec import LAMBDA, enc_attributes
from .prediction import DEFAULT_KERNEL, KERNELS
from .quantise import step_of

PIECES = 4
PIECE_VOXELS = {"fast": 0, "balanced": 1 << 14, "best": 1 << 40}  # per piece; 0: the default unseen


def _pieces(count, voxels):
    """Evenly spread runs of `voxels` neighbouring voxels in Morton order, or the whole field where it is small."""
    if count <= PIECES * voxels:
        return [slice(0, count)]
    return [slice(begin, begin + voxels) for begin in np.linspace(0, count - voxels, PIECES).astype(int)]


def _lagrangian_cost(keys, depth, values, qp, kernel, threads):
    """Bits plus squared error in steps, weighed as the quantiser weighs them."""
    coded, means = enc_attributes(keys, depth, values, qp, kernel, threads)
    error = (means.astype(np.float64) - values) / [step_of(v) for v in qp]
    return 8 * sum(len(c) for c in coded.codewords) + (error**2).sum() / LAMBDA


def choose_kernel(keys, depth, values, qp, effort, threads=1):
    """Prediction kernel for a field, one of KERNELS. keys: int64 [N]; values: int32 [N, C]; qp: [C]; effort: see PIECE_VOXELS."""
    voxels = PIECE_VOXELS[effort]
    if not voxels or len(keys) < 64:
        return DEFAULT_KERNEL
    pieces = _pieces(len(keys), voxels)
    costs = [sum(_lagrangian_cost(keys[p], depth, values[p], qp, kernel, threads) for p in pieces) for kernel in KERNELS]
    return KERNELS[int(np.argmin(costs))]
