"""Splitting a mesh into fields, so that surfaces that lie close together do not share voxels (paper: limitations).

Faces are first grouped into pieces: edge-connected components, and, where a component folds onto itself, its parts by the sign
of the dominant normal component. Pieces that meet in a cell of 2x2x2 voxels get different fields by greedy colouring.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.kernel import kernel
from ...field.morton import _morton_key
from ...field.surface_walk import FACE, _next_row, grid_coordinates, surface_walk

MAX_FIELDS = 16
MIN_CONTACT = 0.002  # share of the smaller piece's cells that two pieces must share to count as meeting
MIN_FOLD = 0.01  # share of a component's cells with opposite normals that makes it a folding one
MIN_CROWD = 0.05  # share of the cells that hold more than NEAR + 1 pieces, from which on all meetings in them are counted
NEAR, FAR = 3, 2 * MAX_FIELDS  # a piece meets so many of those after it in a cell


@dataclass
class Contacts:
    """What meets where. component: int64 [F]; direction: int64 [F], 0..5 for +x -x +y -y +z -z; cell, label: parallel int64
    arrays, ascending by cell, one entry per cell and label = component * 6 + direction."""

    component: np.ndarray
    direction: np.ndarray
    cell: np.ndarray
    label: np.ndarray


def face_components(faces: np.ndarray) -> np.ndarray:
    """Edge-connected component of every face: int64 [F]. faces: int64 [F, 3] over welded vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    key = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = owner[order][same], owner[order][same + 1]
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(faces), len(faces)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def face_directions(lattice: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Dominant direction of every face's normal, int64 [F] in 0..5 (+x -x +y -y +z -z)."""
    p = lattice[faces].astype(np.float64)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    axis = np.argmax(np.abs(normal), axis=1)
    return 2 * axis + (normal[np.arange(len(faces)), axis] < 0)


@kernel
def _pair_slot(key, label, keys, labels):
    mask = keys.shape[0] - 1
    slot = ((((key ^ (key >> 17)) & 0xFFFFFFFF) * 2654435 >> 5) + label * 7919) & mask
    while keys[slot] >= 0 and (keys[slot] != key or labels[slot] != label):
        slot = (slot + 1) & mask
    return slot


@kernel
def _cells(corners, faces, face_label, resolution, walk, keys, labels):
    """Marks every (cell, label) the samples fall into; the tables double as needed. Returns int64 [2, entries]: keys, labels. One
    array, because numba lets an interrupt through between two, and crashes on it."""
    start, half, state = walk.start, walk.half_step, walk.state
    used, last = 0, resolution - 1
    while True:
        count = _next_row(corners, faces, 1, walk)
        if count == 0:
            break
        label, run = face_label[state[FACE]], np.int64(-1)
        for i in range(count):
            cx = min(max((start[0] + (2 * i + 1) * half[0]) >> 32, 0), last) >> 1
            cy = min(max((start[1] + (2 * i + 1) * half[1]) >> 32, 0), last) >> 1
            cz = min(max((start[2] + (2 * i + 1) * half[2]) >> 32, 0), last) >> 1
            key = _morton_key(cx, cy, cz)
            if key == run:
                continue
            run = key
            slot = _pair_slot(key, label, keys, labels)
            if keys[slot] < 0:
                keys[slot], labels[slot] = key, label
                used += 1
                if 2 * used > keys.shape[0]:
                    old_keys, old_labels = keys, labels
                    keys, labels = np.full(2 * keys.shape[0], -1, np.int64), np.zeros(2 * keys.shape[0], np.int64)
                    for k in range(old_keys.shape[0]):
                        if old_keys[k] >= 0:
                            slot = _pair_slot(old_keys[k], old_labels[k], keys, labels)
                            keys[slot], labels[slot] = old_keys[k], old_labels[k]
    found = np.flatnonzero(keys >= 0)
    entries = np.empty((2, len(found)), np.int64)
    entries[0], entries[1] = keys[found], labels[found]
    return entries


def find_contacts(lattice: np.ndarray, faces: np.ndarray, position_bits: int, resolution: int,
                  component: np.ndarray | None = None) -> Contacts:
    """Contacts of a surface on a grid of resolution K. lattice: int64 [V, 3]; faces: int64 [F, 3] over welded vertices;
    component: int64 [F], of face_components where it is None."""
    component = face_components(faces) if component is None else component
    direction = face_directions(lattice, faces)
    corners = np.ascontiguousarray(grid_coordinates(lattice, position_bits, resolution))
    table = np.full(1 << 16, -1, np.int64), np.zeros(1 << 16, np.int64)
    cell, label = _cells(corners, np.ascontiguousarray(faces), component * 6 + direction, resolution, surface_walk(), *table)
    order = np.lexsort((label, cell))
    return Contacts(component, direction, cell[order], label[order])


def _unique_pairs(cell, piece):
    """Distinct (cell, piece) pairs, ascending by cell, then piece."""
    order = np.lexsort((piece, cell))
    cell, piece = cell[order], piece[order]
    new = np.ones(len(cell), bool)
    new[1:] = (cell[1:] != cell[:-1]) | (piece[1:] != piece[:-1])
    return cell[new], piece[new]


def folding_components(contacts: Contacts) -> np.ndarray:
    """Components in which faces of opposite direction share more than MIN_FOLD of the cells: ascending int64 array."""
    component = contacts.label // 6
    bits = 1 << (contacts.label % 6)
    group = np.ones(len(bits), bool)
    group[1:] = (contacts.cell[1:] != contacts.cell[:-1]) | (component[1:] != component[:-1])
    first = np.flatnonzero(group)
    mask = np.bitwise_or.reduceat(bits, first)
    opposite = (mask & (mask >> 1) & 0b010101) != 0
    owner = component[first]
    cells = np.bincount(owner)
    folded = np.bincount(owner, weights=opposite, minlength=len(cells))
    return np.flatnonzero(folded > MIN_FOLD * np.maximum(cells, 1))


def pieces_of(contacts: Contacts, split: np.ndarray | Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Piece of every face and of every contact label: (int64 [F], int64 [labels]); the components in `split` are cut by the sign
    of the direction. Pieces are numbered 2 * component + sign."""
    cut = np.zeros(int(contacts.component.max()) + 1, np.int64)
    cut[list(split)] = 1
    face_piece = 2 * contacts.component + (contacts.direction & 1) * cut[contacts.component]
    component = contacts.label // 6
    return face_piece, 2 * component + (contacts.label & 1) * cut[component]


def _meetings(cell, piece):
    """Pairs of pieces that meet and in how many cells: (int64 [n], int64 [n], int64 [n]), and the cells per piece."""
    cell, piece = _unique_pairs(cell, piece)
    sizes = np.bincount(piece)
    crowded = len(np.unique(cell[NEAR + 1:][cell[NEAR + 1:] == cell[: -NEAR - 1]])) > MIN_CROWD * len(np.unique(cell))
    pairs = []
    for gap in range(1, (FAR if crowded else NEAR) + 1):  # a few crowded cells matter not: their pieces meet in others as well
        same = np.flatnonzero(cell[gap:] == cell[:-gap])
        pairs.append(piece[same] * len(sizes) + piece[same + gap])
    pair, count = np.unique(np.concatenate(pairs), return_counts=True)
    return pair // len(sizes), pair % len(sizes), count, sizes


def colour_pieces(contacts: Contacts, split: np.ndarray | Sequence[int] = (), most: int = MAX_FIELDS) -> np.ndarray:
    """Field of every face, int64 [F] numbered from 0 without gaps, at most so many: greedy colouring of the pieces, larger ones
    first."""
    face_piece, label_piece = pieces_of(contacts, split)
    a, b, count, sizes = _meetings(contacts.cell, label_piece)
    meets = count > np.maximum(MIN_CONTACT * np.minimum(sizes[a], sizes[b]), 1)
    weight: dict[int, list[tuple[int, int]]] = {}
    for x, y, n in zip(a[meets].tolist(), b[meets].tolist(), count[meets].tolist(), strict=True):
        weight.setdefault(x, []).append((y, n))
        weight.setdefault(y, []).append((x, n))
    colour = np.zeros(max(len(sizes), int(face_piece.max()) + 1), np.int64)
    done = set()
    for piece in np.argsort(-sizes, kind="stable").tolist():
        load = [0] * most
        for other, n in weight.get(piece, ()):
            if other in done:
                load[colour[other]] += n
        colour[piece] = load.index(min(load))
        done.add(piece)
    return np.unique(colour[face_piece], return_inverse=True)[1].reshape(-1)
