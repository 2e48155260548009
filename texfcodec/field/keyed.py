"""Base of all supports: sorted Morton keys with a tree of levels above them (spec clauses 7.1 and 8.3)."""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Self, TypeVar

import numpy as np

Kept = TypeVar("Kept")


class Keyed(ABC):
    """A set of cells that hold values; base of dataclasses. keys: int64 [N] ascending Morton keys; level_shift: number of omitted
    levels (a cell is 2**level_shift full ones wide); planar: whether every z is 0."""

    keys: np.ndarray
    level_shift: int
    planar = False

    @property
    @abstractmethod
    def depth(self) -> int:
        """Levels of the tree over these cells."""

    def kept(self, name: str, make: Callable[[], Kept]) -> Kept:
        """Result of make(), computed at the first call for this name and cached until forget(). Codecs keep here what all planes
        on these keys share."""
        own = self.__dict__.setdefault("_kept", {})
        if name not in own:
            own[name] = make()
        return own[name]

    def forget(self) -> None:
        """Clears the cache of kept()."""
        self.__dict__.pop("_kept", None)

    def __len__(self) -> int:
        return len(self.keys)

    def coarser(self, levels: int) -> Self:
        """Return the support of the parent cells `levels` octree levels up, at most the root."""
        shift = min(levels, self.depth)
        if not shift:
            return self
        parents = self.keys >> 3 * shift
        keys = parents[np.flatnonzero(np.diff(parents, prepend=-1))]
        return replace(self, keys=keys, level_shift=self.level_shift + shift)  # type: ignore[type-var]  # a dataclass derives

    def mean(self, values: np.ndarray, levels: int) -> np.ndarray:
        """Return the mean of the values inside each cell of coarser(levels), rounded, uint8 [n, C] (spec clause 8.3). values:
        uint8 [N, C] on these keys."""
        parents = self.keys >> 3 * min(levels, self.depth)
        first = np.flatnonzero(np.diff(parents, prepend=-1))
        counts = np.diff(np.append(first, len(parents)))[:, None]
        sums = np.add.reduceat(values.astype(np.int64), first, axis=0)
        return ((2 * sums + counts) // (2 * counts)).astype(np.uint8)


def keys_crc(keys: np.ndarray) -> int:
    """CRC-32 over Morton keys as 64-bit little-endian numbers (spec 6.4 and 6.5)."""
    return zlib.crc32(np.ascontiguousarray(keys, "<i8").data)
