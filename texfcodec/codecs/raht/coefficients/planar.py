"""Additional state of the blocks of a planar support (spec clause 7.11): a block there has at most four children, with z = 0.

The contexts include the coefficients of the same split in the surrounding blocks. Blocks of a surface in space seldom have such
neighbours.
"""

import numpy as np

from ....core.kernel import kernel
from ..transform.octree import COLUMNS
from ..transform.raht import PLANAR_NODES

MOST = 2  # larger coefficients are alike
ALIKE, ALIKE_SIGNS = (MOST + 1) ** 4, 9  # values of Scratch.alike and Scratch.alike_signs
WEST, NORTH, NORTH_WEST, NORTH_EAST, SOUTH_WEST = COLUMNS[1, [4, 10, 1, 19, 7]].tolist()  # of a block in its neighbour table


def new_kept(nodes: int, components: int, planar: int) -> np.ndarray:
    """Return zeros int8 [nodes, 3, C], where kernels keep each block's coefficients as context of later blocks; no rows if the
    support is not planar."""
    return np.zeros((nodes if planar else 0, len(PLANAR_NODES), components), np.int8)


@kernel(forceinline=True)
def _keep(p, blocks, s):
    """Stores the coefficients of block p, clipped to -MOST..MOST, for later blocks and those of the level below."""
    for c in range(s.q.shape[1]):
        for j in range(PLANAR_NODES.shape[0]):
            blocks.kept[p, j, c] = min(max(s.q[PLANAR_NODES[j], c], -MOST), MOST)


@kernel(forceinline=True)
def _sign_class(v):
    return 0 if v == 0 else (1 if v > 0 else 2)


@kernel(forceinline=True)
def _look_around(p, first, c0, c1, blocks, s):
    """Fills s.alike and s.alike_signs, int64 [7, C], for the splits of components c0..c1-1 (spec 7.11.2)."""
    table, kept = blocks.nodes.table, blocks.kept
    for c in range(c0, c1):
        for j in range(PLANAR_NODES.shape[0]):
            west = north = corners = np.int64(0)
            q = np.int64(table[p, WEST])
            if q >= first:
                west = np.int64(kept[q, j, c])
            q = np.int64(table[p, NORTH])
            if q >= first:
                north = np.int64(kept[q, j, c])
            for i in (NORTH_WEST, NORTH_EAST, SOUTH_WEST):
                q = np.int64(table[p, i])
                if first <= q < p:
                    corners += abs(np.int64(kept[q, j, c]))
            node, above = PLANAR_NODES[j], abs(np.int64(blocks.kept_above[p, j, c]))
            s.alike[node, c] = 27 * abs(west) + 9 * abs(north) + 3 * min(corners, np.int64(MOST)) + above
            s.alike_signs[node, c] = 3 * _sign_class(west) + _sign_class(north)
