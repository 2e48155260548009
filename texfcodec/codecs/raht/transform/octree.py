"""The octree over the active voxels for RAHT, and the neighbour tables of its levels (spec clause 7.1).

Level 0 is the root, level D = ceil(log2 K) holds the voxels. Nodes of a level are in Morton order; node i owns the children
first_child[i] .. first_child[i + 1] - 1 of the next level, and occupancy[i] has bit c set when the child with octant c exists.
"""

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....core.integer import _ones
from ....core.kernel import kernel

NEIGHBOURS = 27  # offset (dx, dy, dz) of entry 9 * (dx + 1) + 3 * (dy + 1) + dz + 1; entry 13 is the node itself
# Where a support is planar, only every third neighbour is there, from entry 1 on: loops over them are
# range(planar, NEIGHBOURS, NEIGHBOUR_STEPS[planar])
NEIGHBOUR_STEPS = np.array((1, 3))


@dataclass
class Level:
    """The nodes of one octree level, in Morton order. first_child: int64 [n + 1]; occupancy: uint8 [n]; octant: uint8 [n] (place
    in the parent); weight: int64 [n] (voxels below the node). The voxel level has no children: first_child and occupancy are
    None."""

    octant: np.ndarray
    weight: np.ndarray
    first_child: np.ndarray | None = None
    occupancy: np.ndarray | None = None

    def __len__(self):
        return len(self.octant)


# Where entry i of a node's neighbours is in its table: there are only the nine with z = 0 where a support is planar
COLUMNS = np.array((range(NEIGHBOURS), [i // 3 for i in range(NEIGHBOURS)]))
# The parents of a level's blocks: first_child int64 [n + 1], occupancy uint8 [n], table int32 [n, 27], by COLUMNS; weight int64,
# by child; planar: 1 where z = 0 for all, else 0
Nodes = namedtuple("Nodes", "first_child occupancy weight table planar")


@kernel
def _parents(keys, weight, parent_keys, first_child, occupancy, parent_weight):
    """Groups ascending keys by key >> 3. Returns the number of parents. The output arrays are as long as keys."""
    n = 0
    for i in range(keys.shape[0]):
        parent = keys[i] >> 3
        if n == 0 or parent_keys[n - 1] != parent:
            parent_keys[n] = parent
            first_child[n] = i
            occupancy[n] = 0
            parent_weight[n] = 0
            n += 1
        occupancy[n - 1] |= np.uint8(1 << (keys[i] & 7))
        parent_weight[n - 1] += weight[i]
    return n


def build_octree(keys: np.ndarray, depth: int) -> list[Level]:
    """Build the octree over cells and return its Levels 0 (root) to depth. keys: int64 [N], N >= 1, ascending unique Morton keys
    below 8**depth; each counts as weight 1."""
    level = Level((keys & 7).astype(np.uint8), np.ones(len(keys), np.int64))
    levels = [level]
    for _ in range(depth):
        n = len(keys)
        parent_keys, first, weight = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
        occupancy = np.empty(n, np.uint8)
        m = _parents(keys, level.weight, parent_keys, first, occupancy, weight)
        keys = parent_keys[:m].copy()
        level = Level((keys & 7).astype(np.uint8), weight[:m].copy(), np.append(first[:m], n), occupancy[:m].copy())
        levels.append(level)
    return levels[::-1]


def _adjacent():
    """Children of each of a node's neighbours that touch the node: (their places, int64 [27, 8]; their cells as in _cells, int64
    [27, 8]; their number, int64 [27])."""
    places, cells = np.zeros((NEIGHBOURS, 8), np.int64), np.zeros((NEIGHBOURS, 8), np.int64)
    counts = np.zeros(NEIGHBOURS, np.int64)
    for i, place in np.ndindex(NEIGHBOURS, 8):
        x, y, z = (2 * d - 1 + (place >> axis & 1) for axis, d in enumerate((i // 9, i // 3 % 3, i % 3)))
        if all(0 <= v < 4 for v in (x, y, z)):
            places[i, counts[i]], cells[i, counts[i]] = place, 16 * x + 4 * y + z
            counts[i] += 1
    return places, cells, counts


def _steps(entry):
    """Number of axes on which a neighbour differs from its node: 0 the node itself, 1 across a face, 2 an edge, 3 a corner."""
    return abs(entry // 9 - 1) + abs(entry // 3 % 3 - 1) + abs(entry % 3 - 1)


ADJACENT_PLACE, ADJACENT_CELL, ADJACENT = _adjacent()
# A node's neighbours and their steps: faces and edges, first the PLANAR_DIRECTIONS with z = 0, then corners, from CORNERS on
DIRECTIONS = np.array(sorted((i for i in range(NEIGHBOURS) if _steps(i)), key=lambda i: (_steps(i) == 3, i % 3 != 1)))
STEPS = np.array([_steps(i) for i in DIRECTIONS.tolist()])
PLANAR_DIRECTIONS, CORNERS = 8, 18
CELLS = 64
CENTRE = np.array([21 + 16 * (o & 1) + 4 * (o >> 1 & 1) + (o >> 2 & 1) for o in range(8)])  # cells of a node's own children


@kernel(forceinline=True)
def _cells(p, begin, end, table, first_child, occupancy, planar, cells):
    """Fills cells int64 [64] with the numbers of the children around and in node p: cell 16 x + 4 y + z with coordinates 0..3,
    the node's own children at 1 and 2; -1 for empty cells. Only children of the nodes begin..end-1 are included. Returns the
    occupied cells, a bit each."""
    cells[:] = -1
    filled = np.int64(0)
    for i in range(planar, NEIGHBOURS, NEIGHBOUR_STEPS[planar]):
        q = np.int64(table[p, COLUMNS[planar, i]])
        if q < begin or q >= end:
            continue
        taken, child = np.int64(occupancy[q]), first_child[q]
        for j in range(ADJACENT[i]):
            place = ADJACENT_PLACE[i, j]
            if (taken >> place) & 1:
                cells[ADJACENT_CELL[i, j]] = child + _ones(taken & ((1 << place) - 1))
                filled |= np.int64(1) << ADJACENT_CELL[i, j]
    return filled


@kernel(allocates=True)
def _neighbours(first_child, occupancy, parent_table, begin, end, planar, table):
    """Fills the neighbour table of the children of parents begin..end-1 (spec 7.1), -1 for absent nodes.

    parent_table: int32 [parents, 27]; table: int32 [children, 27]; by COLUMNS. A child's neighbours are 27 of the parent's 64
    cells.
    """
    cells = np.zeros(CELLS, np.int64)
    for p in range(begin, end):
        _cells(p, 0, first_child.shape[0] - 1, parent_table, first_child, occupancy, planar, cells)
        child = first_child[p]
        for octant in range(8):
            if not (occupancy[p] >> octant) & 1:
                continue
            corner = CENTRE[octant] - 21
            for dx in range(3):
                for dy in range(3):
                    for dz in range(planar, 3 - planar):
                        table[child, COLUMNS[planar, 9 * dx + 3 * dy + dz]] = cells[corner + 16 * dx + 4 * dy + dz]
            child += 1


def new_table(nodes: int, planar: int) -> np.ndarray:
    """Return a table of each node's neighbours in which all are absent, -1: int32 [nodes, 27], or [nodes, 9] if planar."""
    return np.full((nodes, NEIGHBOURS // NEIGHBOUR_STEPS[planar]), -1, np.int32)


class Octree:
    """Levels over ascending unique Morton keys, and the neighbour table of each, computed at first access. All planes on the same
    keys share it. keys: int64 [N], N >= 1; planar: whether every z is 0."""

    def __init__(self, keys: np.ndarray, depth: int, planar: int = 0) -> None:
        self.keys, self.planar, self.levels = keys, int(planar), build_octree(keys, depth)
        self.rings: Any = None  # of filter.rings_of()
        root = new_table(1, self.planar)
        root[0, COLUMNS[self.planar, 13]] = 0  # has only itself
        self._tables = {0: root}  # by depth; threads that make one at the same time make the same

    def table(self, depth: int, ranges: list[tuple[int, int]] | None = None, run: Callable | None = None) -> np.ndarray:
        """Return the table of the neighbours of each node at `depth`, as new_table() has it, computed at first access. ranges:
        ranges of nodes one level above, one job each; run: runs a list of jobs."""
        if depth not in self._tables:
            level, above, table = self.levels[depth - 1], self.table(depth - 1), new_table(len(self.levels[depth]), self.planar)
            job = lambda b, e: lambda: _neighbours(level.first_child, level.occupancy, above, b, e, self.planar, table)
            jobs = [job(*r) for r in ranges or [(0, len(level))]]
            (run or (lambda jobs: [job() for job in jobs]))(jobs)
            self._tables[depth] = table
        return self._tables[depth]
