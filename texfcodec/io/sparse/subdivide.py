"""Faces cut where values vary between their corners more than interpolation shows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

TOLERANCE = 4 / 255  # of a channel at the middle of an edge, below which the edge stays whole
ROUNDS = 6  # an edge becomes at most 2**ROUNDS


def subdivided(positions: np.ndarray, faces: np.ndarray, values: np.ndarray, sample: Callable[[np.ndarray], np.ndarray],
               longest: np.ndarray, most_faces: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Return (positions, faces, values, whether the budget ended it) of a surface whose edges are cut in half, again and again,
    where they are longer than a voxel and values at their middle differ from the mean of their ends.

    positions: float64 [V, 3]; faces: int64 [F, 3]; values: float32 [V, C], of the vertices; sample: values at points; longest:
    float64 [3], size of a voxel; most_faces: budget. Both faces at an edge see the same cut, so no crack opens.
    """
    whole = faces[:0]  # faces of which no edge can be cut any more: a new cut is at an edge of a cut face
    for _ in range(ROUNDS):
        edges, of_face = _edges(faces, len(positions))
        a, b = edges[:, 0], edges[:, 1]
        long = np.flatnonzero((((positions[a] - positions[b]) / longest) ** 2).sum(axis=1) > 1)
        if not len(long):
            break
        middle = (positions[a[long]] + positions[b[long]]) / 2
        between = sample(middle)
        off = np.abs(between - (values[a[long]] + values[b[long]]) / 2).max(axis=1) > TOLERANCE
        cut = np.full(len(edges), -1, np.int64)
        cut[long[off]] = len(positions) + np.arange(int(off.sum()))
        at = cut[of_face]
        more = int((at >= 0).sum())
        if not more:
            break
        if len(whole) + len(faces) + more > most_faces:
            return positions, np.concatenate([whole, faces]), values, True
        positions, values = np.concatenate([positions, middle[off]]), np.concatenate([values, between[off]])
        is_whole = (at < 0).all(axis=1)
        whole, faces = np.concatenate([whole, faces[is_whole]]), _cut(faces[~is_whole], at[~is_whole])
    return positions, np.concatenate([whole, faces]), values, False


def _edges(faces, count):
    """(edges int64 [E, 2], number of the edge opposite to no corner but after each, int64 [F, 3])."""
    ends = np.sort(np.stack([faces, faces[:, [1, 2, 0]]], axis=2).reshape(-1, 2), axis=1)
    key, of_face = np.unique(ends[:, 0] * np.int64(count) + ends[:, 1], return_inverse=True)
    return np.stack([key // count, key % count], axis=1), of_face.reshape(-1, 3)


def _cut(faces, at):
    """Faces int64 [F', 3] once edges are cut. at: int64 [F, 3], vertex at the middle of the edge after each corner, or -1, not
    of all three."""
    number, out = (at >= 0).sum(axis=1), []
    for count, pattern in ((1, _ONE), (2, _TWO), (3, _THREE)):
        some = number == count
        corners, middles = faces[some], at[some]
        if count == 1:
            turn = np.argmax(middles >= 0, axis=1)  # to the cut edge after the first corner
        elif count == 2:
            turn = (np.argmin(middles >= 0, axis=1) + 1) % 3  # the whole edge is the last
        else:
            turn = np.zeros(len(corners), np.int64)
        order = (turn[:, None] + np.arange(3)) % 3
        six = np.concatenate([np.take_along_axis(corners, order, 1), np.take_along_axis(middles, order, 1)], axis=1)
        out.append(six[:, pattern].reshape(-1, 3))
    return np.concatenate(out)


_ONE = np.array([[0, 3, 2], [3, 1, 2]])  # corners 0..2, and 3..5 in the middle of the edges after them
_TWO = np.array([[3, 1, 4], [0, 3, 4], [0, 4, 2]])
_THREE = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
