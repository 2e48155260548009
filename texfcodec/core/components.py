"""Connected components of a graph."""

import numpy as np


def components(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Component of every node, int64 [count], numbered in the order of their first nodes.

    a, b: ints [N] in 0..count - 1, the two ends of the edges, in any order and direction; an edge may occur twice. No kernel:
    decoders without numba call this. A million edges take 0.05 s, three times a kernel's time.
    """
    label = np.arange(count)  # of a node: one of the same component that is not after it
    while len(a):
        ends = label[a], label[b]
        np.minimum.at(label, np.maximum(*ends), np.minimum(*ends))
        _follow(label)
        apart = label[a] != label[b]  # at most half of the components that edges leave stay apart
        a, b = a[apart], b[apart]
    return (np.cumsum(label == np.arange(count)) - 1)[label]


def _follow(label):
    """Replaces every label by that of its node until it is the first node's own."""
    while True:
        after = label[label]
        if np.array_equal(after, label):
            return
        label[:] = after
