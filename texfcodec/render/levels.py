"""Coarser levels of a field for minified pictures, as mip maps are for a texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..field.query import query_field
from ..field.texels import TexelSupport

if TYPE_CHECKING:
    from ..field.voxels import VoxelSupport
    from ..texf import Field


@dataclass
class Level:
    """A level of detail of a field, whose cells are 2**level of the field's own voxels or texels a side.

    Attributes
    ----------
    level : int
        Its number; 0 is the field itself.
    support : VoxelSupport or TexelSupport
        Places of its values.
    values : uint8 (level 0) or float32 [N, C]
        Plain means of the field's values in each cell: those of a decoder that leaves levels out, but for rounding.
    counts : int64 [N]
        Number of values in each cell.
    """

    level: int
    support: VoxelSupport | TexelSupport
    values: np.ndarray
    counts: np.ndarray

    def query(self, places: np.ndarray) -> np.ndarray:
        """Return the level's values at places of the field.

        Parameters
        ----------
        places : float64 [M, 3] or [M, 2]
            Over voxels grid coordinates, see field.query.query_field; over texels those of the full image.

        Returns
        -------
        float32 [M, C]
            0..255.
        """
        if isinstance(self.support, TexelSupport):
            return self.support.query(places, self.values)
        places = places if self.level == 0 else places / (1 << self.level)
        return query_field(places, self.support.size, self.support.keys, self.support.brick_map, self.values)[0]


class Pyramid:
    """Levels of detail of planes of one field, each built on first use. Threads that use it at once may build a level twice, no
    more.

    names: of planes that have one support, side by side in the values; empty: the colours that a viewer shows without light.
    """

    def __init__(self, field: Field, names: Sequence[str] = ()) -> None:
        self.arrays = _arrays(field, names)
        support = field.support_of(names[0]) if names else field.support
        values = self.arrays[0] if len(self.arrays) == 1 else np.hstack(self.arrays)
        self._levels = [Level(0, support, values, np.ones(len(support), np.int64))]

    @property
    def last(self) -> int:
        """Number of the level that is a single cell."""
        return self._levels[0].support.depth

    def level(self, number: int) -> Level:
        """Return level `number`, 0 (the field itself) to last (the coarsest)."""
        levels = self._levels
        while len(levels) <= number:
            levels = [*levels, _coarser(levels[-1])]
        self._levels = max(levels, self._levels, key=len)
        return levels[number]


def pyramid_of(field: Field, names: Sequence[str] = ()) -> Pyramid:
    """Return the Pyramid, the levels of detail, of some planes of a field.

    Parameters
    ----------
    field : Field
        It keeps the pyramid, which is built anew if its values are other arrays.
    names : sequence of str
        Of planes that have one support; empty for the colours without light.

    Returns
    -------
    Pyramid
        Of the planes side by side.
    """
    kept = field._pyramids.get(tuple(names))
    if kept is None or any(a is not b for a, b in zip(kept.arrays, _arrays(field, names), strict=True)):
        kept = field._pyramids[tuple(names)] = Pyramid(field, names)
    return kept


def _arrays(field, names):
    return [field.planes[name] for name in names] if names else [field.rgba]


def _coarser(fine):
    parents = fine.support.keys >> 3
    first = np.flatnonzero(np.diff(parents, prepend=-1))
    counts = np.add.reduceat(fine.counts, first)
    sums = np.add.reduceat(fine.values * fine.counts[:, None].astype(np.float64), first, axis=0)
    return Level(fine.level + 1, fine.support.coarser(1), (sums / counts[:, None]).astype(np.float32), counts)
