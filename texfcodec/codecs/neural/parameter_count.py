"""Counts of a 3DNTC network for its syntax; a separate module, so that reading a stream loads no kernels."""

from collections.abc import Sequence

WAVE_INPUTS = 6  # per octave: three axes, two phases


def parameter_count(widths: Sequence[int]) -> int:
    """Number of weights and biases of a network. widths: inputs, hidden units and outputs."""
    return sum((i + 1) * o for i, o in zip(widths[:-1], widths[1:], strict=True))
