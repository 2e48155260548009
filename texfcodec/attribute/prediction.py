"""Prediction of a block's children from the decoded neighbourhood (spec clause 7.3).

A child is predicted by a weighted mean of its own parent, of the seven parents that touch the child's corner of it and, where
those have been decoded before, of their children that touch the child. Seven weights form a kernel:
[parent, face parent, edge parent, corner parent, face child, edge child, corner child].
"""

from ..kernel import kernel

KERNEL_SIZE = 7
# From smooth photographs to flat colours with sharp edges. BD-rate RGB against G-PCC over QP 28 and 40 on basket, scissors, cat,
# Mars, water bottle: smoothest -1, -13, -10, -10, +22 %; second -1, -16, -8, -9, +11 %; third +11, -9, +3, +1, 0 %; sharpest +57,
# +29, +38, +31, -21 %.
KERNELS = ((64, 32, 4, 1, 48, 16, 4), (64, 24, 1, 0, 32, 8, 0), (64, 12, 0, 0, 16, 4, 0), (64, 2, 0, 0, 4, 0, 0))
DEFAULT_KERNEL = KERNELS[1]


@kernel
def _predict(p, first, table, first_child, occupancy, parent_mean, child_mean, kernel, predicted):
    """Fills predicted int64 [8, C] for the children of parent p (spec 7.3.2).

    first: first parent of the slice; children of parents first..p-1 are decoded. table: int32 [n, 27] of the parents, whose
    entries are below n = len(occupancy) = len(parent_mean) by construction. |sum| < 27 * 255 * 2**34 < 2**47.
    """
    components = parent_mean.shape[1]
    for octant in range(8):
        if not (occupancy[p] >> octant) & 1:
            continue
        total = kernel[0]
        for c in range(components):
            predicted[octant, c] = kernel[0] * parent_mean[p, c]
        ox, oy, oz = octant & 1, (octant >> 1) & 1, (octant >> 2) & 1
        for m in range(1, 8):
            mx, my, mz = m & 1, (m >> 1) & 1, (m >> 2) & 1
            q = table[p, 13 + 9 * mx * (2 * ox - 1) + 3 * my * (2 * oy - 1) + mz * (2 * oz - 1)]
            if q < 0:
                continue
            if q < first or q > p:
                w = kernel[mx + my + mz]
                total += w
                for c in range(components):
                    predicted[octant, c] += w * parent_mean[q, c]
                continue
            child = first_child[q]
            for place in range(8):
                if not (occupancy[q] >> place) & 1:
                    continue
                off = place ^ octant  # along a crossed axis the touching child has the other bit, elsewhere any
                if off & m == m:
                    rest = off & ~m
                    distance = mx + my + mz + (rest & 1) + ((rest >> 1) & 1) + ((rest >> 2) & 1)
                    w = kernel[3 + distance]
                    total += w
                    for c in range(components):
                        predicted[octant, c] += w * child_mean[child, c]
                child += 1
        for c in range(components):
            predicted[octant, c] = (2 * predicted[octant, c] + total) // (2 * total)
