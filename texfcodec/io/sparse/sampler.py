"""Values of sparse voxels, or of a function, at points of a surface."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...field.grid import build_brick_map
from ...field.morton import encode_morton
from ...field.query import nearest_of_all, query_field
from ...report import plural
from ...scene.channels import BY_NAME
from ..corner_maps import any_channel_named

if TYPE_CHECKING:
    from ..parts import Notes

MOST_SIDE = 1 << 13  # voxels along an axis, which Morton keys hold
PROBED = 1 << 14  # corners without a voxel of their own whose distance to one is measured
Values = dict[str, np.ndarray]


def channel_values(named: Mapping[str, Any], count: int, notes: Notes, what: str) -> Values:
    """Return the channels among named arrays, float32 [count, C] in 0..1, colours sRGB-coded as images hold them.

    named: by name, as any_channel_named() knows them: uint8, or numbers in 0..1, [count] or [count, k]. Values outside are
    clipped, with a remark; arrays that are no channel are named in one. NaN stays. Raises InputError TXF-I44.
    """
    values: Values = {}
    for name, given in named.items():
        channel = any_channel_named(name)
        array = np.asarray(given)
        if not channel or channel in values:
            notes.remark(f"array '{name[:60]}' of {what} is left out: it is not a channel, or its channel is read already")
            continue
        components = BY_NAME[channel].components
        if array.dtype.kind not in "fiub" or array.ndim not in (1, 2) or len(array) != count:
            raise InputError("TXF-I44", f"'{name[:60]}' of {what} is not an array of numbers for each of them",
                             value=f"{array.dtype} {array.shape}"[:80], allowed=f"[{count}, {components}]")
        array = array.reshape(count, -1)
        if array.shape[1] < components:
            raise InputError("TXF-I44", f"'{name[:60]}' of {what} has too few components", value=array.shape[1],
                             allowed=components)
        if array.shape[1] > components:
            if channel == "base_colour" and array.shape[1] == 4 and not any(any_channel_named(n) == "alpha" for n in named):
                values["alpha"] = _unit(array[:, 3:], notes, f"alpha of {what}")
            else:
                notes.remark(f"'{name[:60]}' of {what} has more components than its channel; the first {components} are read")
        values[channel] = _unit(array[:, :components], notes, f"{name[:60]} of {what}")
    return values


def _unit(array, notes, what):
    out = np.asarray(array, np.float32)
    if array.dtype == np.uint8:
        return out / np.float32(255)
    outside = (out < 0) | (out > 1)
    if outside.any():
        notes.remark(f"{what}: " + plural(int(outside.sum()), "value is", "values are") + " outside 0..1 and clipped")
    return np.clip(out, 0, 1)


@dataclass(frozen=True)
class SparseVoxels:
    """Voxels with values. xyz: int64 [N, 3], distinct, 0..MOST_SIDE - 1; values: by channel, float32 [N, C]; origin, size:
    float64 [3], of the grid's corner and of a voxel, which covers xyz to xyz + 1 of them; counts: of points of at()."""

    xyz: np.ndarray
    values: Values
    origin: np.ndarray
    size: np.ndarray
    counts: dict[str, int] = field(default_factory=lambda: {"nearest": 0})

    @cached_property
    def _sorted(self):
        """Return (ascending keys, BrickMap, values of all channels side by side, voxels) in the order of their keys."""
        keys = encode_morton(self.xyz)
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        joined = np.concatenate(list(self.values.values()), axis=1)[order]
        return keys, build_brick_map(keys), np.ascontiguousarray(joined), self.xyz[order]

    def grid(self, points: np.ndarray) -> np.ndarray:
        """Return points, float64 [n, 3], in voxels."""
        return (points - self.origin) / self.size

    def at(self, points: np.ndarray, threads: int = 1) -> Values:
        """Return the values at points, float64 [n, 3]: trilinear among the present of the eight voxels around, with weights
        that sum to 1, else those of the nearest voxel."""
        keys, brick_map, joined, _ = self._sorted
        out, missed = query_field(self.grid(points), MOST_SIDE, keys, brick_map, joined, threads)
        self.counts["nearest"] += int((missed > 0).sum())
        return dict(zip(self.values, np.split(out, np.cumsum([v.shape[1] for v in self.values.values()])[:-1], axis=1),
                        strict=True))

    def fit(self, points: np.ndarray) -> str:
        """Return a sentence on how far the voxels are from the vertices of a surface, float64 [n, 3]."""
        (keys, *_, xyz), places = self._sorted, self.grid(points)
        cell = np.clip(np.floor(places), 0, MOST_SIDE - 1).astype(np.int64)
        key = encode_morton(cell)
        has_own = keys[np.minimum(np.searchsorted(keys, key), len(keys) - 1)] == key
        homeless = places[~has_own]
        if not len(homeless):
            return f"voxels: each of {plural(len(points), 'vertex has', 'vertices has')} a voxel of its own"
        some = np.ascontiguousarray(homeless[:: -(-len(homeless) // PROBED)])
        away = np.sqrt(((xyz[nearest_of_all(some, MOST_SIDE, keys)] + 0.5 - some) ** 2).sum(axis=1))
        return (f"voxels: {100 * len(homeless) / len(points):.1f} % of {len(points)} vertices have no voxel of their own; the "
                f"nearest centre is {away.mean():.2f} voxels away on average, {away.max():.2f} at most; "
                f"{int(self.counts['nearest'])} take its value, the others are interpolated")


@dataclass(frozen=True)
class PointFunction:
    """A caller's function of points, float64 [n, 3] -> {channel name: [n] or [n, C]}, with the notes of the run."""

    function: Callable[[np.ndarray], Mapping[str, Any]]
    notes: Notes
    names: list[str] = field(default_factory=list)

    def at(self, points: np.ndarray, threads: int = 1) -> Values:
        """Return the values at points. threads: not used. Raises InputError TXF-I45 for what the function does wrong."""
        try:
            named = self.function(points.copy())
        except Exception as error:  # of any kind: it is the caller's own code
            raise InputError("TXF-I45", "the function of points raised an exception",
                             reason=f"{type(error).__name__}: {error}"[:200]) from error
        if not isinstance(named, Mapping) or not all(isinstance(name, str) for name in named):
            raise InputError("TXF-I45", "the function of points did not return a dict of arrays by channel name",
                             value=type(named).__name__)
        try:
            values = channel_values(named, len(points), self.notes, "the function's values")
        except InputError as error:
            raise InputError("TXF-I45", "the function of points returned an array of the wrong kind or shape",
                             reason=str(error)[:200]) from error
        if self.names and sorted(values) != self.names:
            raise InputError("TXF-I45", "the function of points returned other channels than before", value=str(sorted(values)))
        self.names[:] = sorted(values)
        if not values or not all(np.isfinite(value).all() for value in values.values()):
            raise InputError("TXF-I45", "the function of points returned no channel, or values that are not finite",
                             value=str(list(named))[:80])
        return values
