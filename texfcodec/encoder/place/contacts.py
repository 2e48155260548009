"""Splitting a mesh into fields, so that surfaces that lie close together do not share voxels (paper: limitations).

Faces are first grouped into pieces: edge-connected components, each of which is divided by the sign of the dominant normal
component if it folds onto itself. Pieces that meet in a cell of 2x2x2 voxels get different fields by greedy colouring.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.kernel import kernel
from ...field.morton import _morton_key
from ...field.surface_walk import FACE, _next_row, grid_coordinates, surface_walk
from ...geometry.edges import face_components

MAX_FIELDS = 16
MIN_CONTACT = 0.002  # share of the smaller piece's cells that two pieces must share to count as meeting
MIN_FOLD = 0.01  # share of a component's cells with opposite normals that makes it a folding one
MIN_CROWD = 0.05  # share of the cells that hold more than NEAR + 1 pieces, from which on all meetings in them are counted
FIRST_TABLE = 1 << 10  # slots of a hash table before it doubles
NEAR, FAR = 3, 2 * MAX_FIELDS  # a piece meets so many of those after it in a cell


@dataclass
class Contacts:
    """The labels of surface parts in each grid cell of 2x2x2 voxels. component: int64 [F]; direction: int64 [F], 0..5 for +x -x
    +y -y +z -z; cell, label: parallel int64 arrays, ascending by cell, one entry per cell and label = component * 6 +
    direction."""

    component: np.ndarray
    direction: np.ndarray
    cell: np.ndarray
    label: np.ndarray


def face_directions(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the dominant direction of each face's normal, int64 [F] in 0..5 (+x -x +y -y +z -z). lattice: positions, int64 [V,
    3]."""
    p = lattice[faces].astype(np.float64)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    axis = np.argmax(np.abs(normal), axis=1)
    return 2 * axis + (normal[np.arange(len(faces)), axis] < 0)


@kernel
def _cell_slot(key, keys, taken, table, mask):
    slot = (((key ^ (key >> 17)) & 0xFFFFFFFF) * 2654435 >> 5) & mask
    while taken[slot] == table and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel
def _pair_slot(key, label, keys, labels):
    mask = keys.shape[0] - 1
    slot = ((((key ^ (key >> 17)) & 0xFFFFFFFF) * 2654435 >> 5) + label * 7919) & mask
    while keys[slot] >= 0 and (keys[slot] != key or labels[slot] != label):
        slot = (slot + 1) & mask
    return slot


@kernel(allocates=True)
def _twice(entries):
    """Return entries, int64 [2, n], with as much room again. A copy by slices compiles numba's messages about shapes, for 2 s."""
    n = entries.shape[1]
    more = np.empty((2, 2 * n), np.int64)
    for row in range(2):
        for i in range(n):
            more[row, i] = entries[row, i]
    return more


@kernel(allocates=True)
def _cells(corners, faces, face_label, resolution, walk):
    """Return every (cell, label) that the samples fall into, int64 [2, n], ascending by label, as the faces are. It is a single
    array, because numba lets an interrupt through between two, and crashes on it.

    The table holds the cells of one label at a time, which keeps it small: a slot is in use if it has the number of the table,
    which is new for every label and whenever the table doubles.
    """
    start, half, state = walk.start, walk.half_step, walk.state
    keys, taken = np.zeros(FIRST_TABLE, np.int64), np.zeros(FIRST_TABLE, np.int64)
    entries, mask, table = np.empty((2, FIRST_TABLE), np.int64), FIRST_TABLE - 1, 0
    begin, used, label, last = 0, 0, np.int64(-1), resolution - 1
    while True:
        count = _next_row(corners, faces, 1, walk)
        if count == 0:
            break
        if face_label[state[FACE]] != label:
            label, begin, table, mask = face_label[state[FACE]], used, table + 1, FIRST_TABLE - 1
        run = np.int64(-1)
        for i in range(count):
            cx = min(max((start[0] + (2 * i + 1) * half[0]) >> 32, 0), last) >> 1
            cy = min(max((start[1] + (2 * i + 1) * half[1]) >> 32, 0), last) >> 1
            cz = min(max((start[2] + (2 * i + 1) * half[2]) >> 32, 0), last) >> 1
            key = _morton_key(cx, cy, cz)
            if key == run:
                continue
            run = key
            slot = _cell_slot(key, keys, taken, table, mask)
            if taken[slot] == table:
                continue
            keys[slot], taken[slot] = key, table
            if used == entries.shape[1]:
                entries = _twice(entries)
            entries[0, used], entries[1, used] = key, label
            used += 1
            if 2 * (used - begin) > mask:
                table, mask = table + 1, 2 * mask + 1
                if mask >= len(keys):
                    keys, taken = np.zeros(mask + 1, np.int64), np.zeros(mask + 1, np.int64)
                for k in range(begin, used):
                    slot = _cell_slot(entries[0, k], keys, taken, table, mask)
                    keys[slot], taken[slot] = entries[0, k], table
    return entries[:, :used].copy()


def find_contacts(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                  component: np.ndarray | None = None) -> Contacts:
    """Return the Contacts of a surface: the components and face directions that have samples in each cell of 2x2x2 voxels.
    lattice: int64 [V, 3] in 0..2**position_bits - 1; faces: int64 [F, 3] over welded vertices; resolution: voxels along a side
    of the cube; component: int64 [F], of face_components if it is None."""
    component = face_components(faces) if component is None else component
    direction = face_directions(lattice, faces)
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    label = component * 6 + direction
    order = np.argsort(label, kind="stable")
    cell, label = _cells(corners, faces[order], label[order], resolution, surface_walk())
    order = np.argsort(cell, kind="stable")
    return Contacts(component, direction, cell[order], label[order])


@kernel(allocates=True)
def _count_folds(cell, label, components):
    """Return int64 [2, components]: cells of every component, and those with faces of opposite direction. Entries ascend by cell
    and label."""
    counts, mask = np.zeros((2, components), np.int64), 0
    for i in range(len(cell)):
        component = label[i] // 6
        mask |= 1 << (label[i] % 6)
        if i + 1 == len(cell) or cell[i + 1] != cell[i] or label[i + 1] // 6 != component:
            counts[0, component] += 1
            counts[1, component] += (mask & (mask >> 1) & 0b010101) != 0
            mask = 0
    return counts


def folding_components(contacts: Contacts) -> np.ndarray:
    """Return the numbers of components that fold onto themselves, ascending int64: faces of opposite direction share more than
    MIN_FOLD of their cells."""
    cells, folded = _count_folds(contacts.cell, contacts.label, int(contacts.component.max()) + 1)
    return np.flatnonzero(folded > MIN_FOLD * np.maximum(cells, 1))


def pieces_of(contacts: Contacts, split: np.ndarray | Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Return the piece of every face and of every contact label: (int64 [F], int64 [labels]). A piece is a component, or for
    components in `split` the faces of one sign of the dominant direction. Pieces are numbered 2 * component + sign."""
    cut = np.zeros(int(contacts.component.max()) + 1, np.int64)
    cut[list(split)] = 1
    face_piece = 2 * contacts.component + (contacts.direction & 1) * cut[contacts.component]
    component = contacts.label // 6
    return face_piece, 2 * component + (contacts.label & 1) * cut[component]


@kernel(allocates=True)
def _pieces_by_cell(cell, piece):
    """Return the distinct (cell, piece), int64 [2, n], ascending. Entries ascend by cell and component, and a component has at
    most two pieces, so each is searched among the last two and comes before at most one of them."""
    count = 0
    pairs = np.empty((2, len(cell)), np.int64)
    for i in range(len(cell)):
        known = False
        for j in range(max(count - 2, 0), count):
            known |= pairs[0, j] == cell[i] and pairs[1, j] == piece[i]
        if not known:
            pairs[0, count], pairs[1, count] = cell[i], piece[i]
            if count > 0 and pairs[0, count - 1] == cell[i] and pairs[1, count - 1] > piece[i]:
                pairs[1, count - 1], pairs[1, count] = pairs[1, count], pairs[1, count - 1]
            count += 1
    return pairs[:, :count].copy()


@kernel(allocates=True)
def _count_pairs(cell, piece, gaps):
    """Return pairs of pieces at most `gaps` entries apart in one cell, and the number of such cells: int64 [3, n]. The tables
    double as needed."""
    keys, counts, used = np.full(FIRST_TABLE, -1, np.int64), np.zeros((2, FIRST_TABLE), np.int64), 0
    for i in range(len(cell)):
        for j in range(i + 1, min(i + gaps + 1, len(cell))):
            if cell[j] != cell[i]:
                break
            low, high = piece[i], piece[j]
            slot = _pair_slot(low, high, keys, counts[0])
            if keys[slot] < 0:
                keys[slot], counts[0, slot] = low, high
                used += 1
            counts[1, slot] += 1
            if 2 * used > len(keys):
                old_keys, old_counts = keys, counts
                keys, counts = np.full(2 * len(old_keys), -1, np.int64), np.zeros((2, 2 * len(old_keys)), np.int64)
                for k in range(len(old_keys)):
                    if old_keys[k] >= 0:
                        slot = _pair_slot(old_keys[k], old_counts[0, k], keys, counts[0])
                        keys[slot], counts[0, slot], counts[1, slot] = old_keys[k], old_counts[0, k], old_counts[1, k]
    occupied = np.flatnonzero(keys >= 0)
    pairs = np.empty((3, len(occupied)), np.int64)
    pairs[0], pairs[1], pairs[2] = keys[occupied], counts[0][occupied], counts[1][occupied]
    return pairs


def _meetings(cell, piece):
    """Return (pairs of pieces that meet and the number of cells, int64 [3, n] in no order; the cells per piece). cell, piece: by
    entry of Contacts."""
    cell, piece = _pieces_by_cell(cell, piece)
    crowded = _distinct(cell[NEAR + 1:][cell[NEAR + 1:] == cell[: -NEAR - 1]]) > MIN_CROWD * _distinct(cell)
    # A few crowded cells matter not: their pieces meet in others as well.
    return _count_pairs(cell, piece, FAR if crowded else NEAR), np.bincount(piece)


def _distinct(ascending):
    """Return the number of different values in an ascending array."""
    return int((ascending[1:] != ascending[:-1]).sum()) + (len(ascending) > 0)


@kernel(allocates=True)
def _greedy(order, starts, others, cells, most):
    """Return the colour of every piece, int64 [P] below `most`: in this order, the colour that shares the fewest cells with
    pieces before it. starts: int64 [P + 1] into others and cells, the pieces that each meets and the number of shared cells."""
    colour, load = np.full(len(order), -1, np.int64), np.zeros(most, np.int64)
    for piece in order:
        load[:] = 0
        for k in range(starts[piece], starts[piece + 1]):
            if colour[others[k]] >= 0:
                load[colour[others[k]]] += cells[k]
        colour[piece] = np.argmin(load)
    return colour


def colour_pieces(contacts: Contacts, split: np.ndarray | Sequence[int] = (), most: int = MAX_FIELDS) -> np.ndarray:
    """Return the field of every face, int64 [F] numbered from 0 without gaps: greedy colouring, larger pieces first, gives
    pieces that meet in cells different fields as far as `most` fields allow. split: components in two pieces, as of
    pieces_of()."""
    face_piece, label_piece = pieces_of(contacts, split)
    (a, b, count), sizes = _meetings(contacts.cell, label_piece)
    meets = count > np.maximum(MIN_CONTACT * np.minimum(sizes[a], sizes[b]), 1)
    first, other, cells = np.append(a[meets], b[meets]), np.append(b[meets], a[meets]), np.tile(count[meets], 2)
    grouped = np.argsort(first, kind="stable")
    starts = np.append(0, np.cumsum(np.bincount(first, minlength=len(sizes))))
    colour = np.zeros(max(len(sizes), int(face_piece.max()) + 1), np.int64)
    colour[: len(sizes)] = _greedy(np.argsort(-sizes, kind="stable"), starts, other[grouped], cells[grouped], most)
    return np.unique(colour[face_piece], return_inverse=True)[1].reshape(-1)
