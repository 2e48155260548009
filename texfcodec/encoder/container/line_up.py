"""Stored values in the order of a stream's vertices (encoder only)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...errors import InputError

if TYPE_CHECKING:
    from ...texf import Texf


class LinedUp(NamedTuple):
    """source: int64 [N], row of the source of each stored vertex; splits: int64 [S, 2], (corner, vertex) of corners that do not
    use their unit's vertex."""

    source: np.ndarray
    splits: np.ndarray


def line_up(texf: Texf, units: tuple[int, ...], points: np.ndarray, faces: np.ndarray, value: np.ndarray) -> LinedUp:
    """Return source rows for the vertices of some units.

    Parameters
    ----------
    texf : Texf
        The decoded stream.
    units : tuple of int
        Its geometry units that a primitive consists of.
    points : float64 [V, 3]
        Source vertices in the stream's space.
    faces : int64 [F, 3]
        Indices into points.
    value : int64 [V]
        Equal for vertices whose stored values are equal.

    Raises
    ------
    InputError
        TXF-I62 if a decoded face is not one of the source's.
    """
    lattice = texf.cube.to_lattice(points)
    decoded_lattice = np.concatenate([texf.units[n].lattice for n in units])
    bases = np.cumsum([0] + [len(texf.units[n].lattice) for n in units])
    decoded = np.concatenate([texf.units[n].faces + base for n, base in zip(units, bases[:-1], strict=True)])
    row = _matching(_packed(lattice)[faces], _packed(decoded_lattice)[decoded])
    corner_row = np.take_along_axis(faces[row.face], (np.arange(3) + row.turn[:, None]) % 3, axis=1).reshape(-1)
    return _split(decoded.reshape(-1), corner_row, value, len(decoded_lattice))


def _packed(lattice):
    return lattice[:, 0] | lattice[:, 1] << 20 | lattice[:, 2] << 40


class _Match(NamedTuple):
    """face: int64 [F] of the source; turn: int64 [F], source corner of the first corner."""

    face: np.ndarray
    turn: np.ndarray


def _matching(source, decoded):
    """Return the source face of every decoded one, a different one for each. source, decoded: int64 [F, 3], places of corners."""
    (rows_a, turn_a), (rows_b, turn_b) = _canonical(source), _canonical(decoded)
    _, kind = np.unique(np.concatenate([rows_a, rows_b]), axis=0, return_inverse=True)
    kind = kind.reshape(-1)
    ranks = [_ranked(kind[: len(source)]), _ranked(kind[len(source) :])]
    base = int(max(rank.max(initial=0) for rank in ranks)) + 1
    keys_a, keys_b = kind[: len(source)] * base + ranks[0], kind[len(source) :] * base + ranks[1]
    order = np.argsort(keys_a)
    at = np.minimum(np.searchsorted(keys_a[order], keys_b), len(order) - 1)
    face = order[at]
    if (keys_a[face] != keys_b).any():
        raise InputError("TXF-I62", "a decoded face is not one of the source's", value=int((keys_a[face] != keys_b).sum()))
    return _Match(face, (turn_a[face] - turn_b) % 3)


def _canonical(faces):
    """Return (faces turned so that the smallest corner is first, that corner's number)."""
    turn = faces.argmin(axis=1)
    return np.take_along_axis(faces, (np.arange(3) + turn[:, None]) % 3, axis=1), turn


def _ranked(kind):
    """Return the number of earlier entries of the same kind."""
    order = np.argsort(kind, kind="stable")
    ranked = kind[order]
    first = np.searchsorted(ranked, ranked)
    rank = np.empty(len(kind), np.int64)
    rank[order] = np.arange(len(kind)) - first
    return rank


def _split(vertex, row, value, count):
    """Return the LinedUp of corners. vertex: decoded vertex of each; row: source row of each; count: decoded vertices."""
    source = np.zeros(count, np.int64)
    source[vertex[::-1]] = row[::-1]
    other = np.flatnonzero(value[row] != value[source[vertex]])
    if not len(other):
        return LinedUp(source, np.zeros((0, 2), np.int64))
    pairs, first, number = np.unique(np.stack([vertex[other], value[row[other]]], axis=1), axis=0, return_index=True,
                                     return_inverse=True)
    new = count + number.reshape(-1)
    return LinedUp(np.concatenate([source, row[other[first]]]), np.stack([other, new], axis=1))
