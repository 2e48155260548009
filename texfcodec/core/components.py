"""Connected components of a graph."""

import numpy as np

from .kernel import kernel


def components(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Component of every node, int64 [count], numbered in the order of their first nodes.

    a, b: ints [N] in 0..count - 1, the two ends of the edges, in any order and direction; an edge may occur twice.
    """
    label = np.arange(count)
    _join(np.ascontiguousarray(a, np.int64), np.ascontiguousarray(b, np.int64), label)
    return label


@kernel
def _join(a, b, label):
    """Replaces label int64 [N], initially each node's own number, by its component. Until the last loop a label is a node of the
    same component that is not after this one, so roots are first nodes. Every index is an end of an edge, below N, or was read
    from label."""
    for i in range(a.shape[0]):
        x, y = a[i], b[i]
        while label[x] != x:
            label[x] = label[label[x]]
            x = label[x]
        while label[y] != y:
            label[y] = label[label[y]]
            y = label[y]
        if x < y:
            label[y] = x
        else:
            label[x] = y
    count = np.int64(0)
    for i in range(label.shape[0]):
        if label[i] == i:
            label[i] = count
            count += 1
        else:
            label[i] = label[label[i]]  # a node before it, which has its component already
