"""Samples that a 3DNTC payload is fitted to: points on the source's surface with the values of all channels, and the latents
around them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from ...core.kernel import kernel
from ...errors import InputError
from ...field.morton import _morton_key
from ...geometry.areas import relative_areas, sample_surface
from ...scene.channels import ALPHA, COLOURS
from ...scene.fetch import pack_source, sample_source
from .infer import LOCAL_BITS, POSITION_BITS, _local, _rows_around, cube_positions

if TYPE_CHECKING:
    from ...scene.channels import Channel
    from ..base import Source as CodecSource

CHUNK = 1 << 20  # points sampled at a time
MOST_WORKERS = 4  # chunks in memory at a time
# Where values vary more there is more to learn, so samples are taken there more often and count for less.
CANDIDATES = 3  # points looked at for every sample; where samples are more than so many times denser, points are taken twice
RUN = 4  # neighbours whose values are compared
NOISE, FLOOR = 4.0, 0.3  # levels of 255 that every place is taken to vary by; share of the samples that is spread evenly


@dataclass
class Samples:
    """Points on the surface and their values to fit. position: int32 [M, 3] as infer takes them; target: uint8 [M, C]; share:
    uint8 [M, C], weights of the squared errors, 255 for 1; field: int16 [M], number of each point's field."""

    position: np.ndarray
    target: np.ndarray
    share: np.ndarray
    field: np.ndarray

    def __len__(self):
        return len(self.position)

    def taken(self, rows: np.ndarray | slice) -> Samples:
        """Return only the selected samples. rows: int64 [m] or slice."""
        return Samples(self.position[rows], self.target[rows], self.share[rows], self.field[rows])


class Source:
    """Draws samples from a codecs.base.Source. weights: float32 [C], of the components' squared errors, the largest 1. Raises
    InputError TXF-I63 if no face has area."""

    def __init__(self, shown: CodecSource, threads: int) -> None:
        surface = shown.surface
        self.lattice, self.faces, self.face_field = surface.lattice.astype(np.float64), surface.faces, shown.face_field
        self.areas = relative_areas(self.lattice, self.faces)
        if not self.areas.sum() > 0:
            raise InputError("TXF-I63", "no face has an area, so no payload can be fitted", value=len(self.faces))
        self.scale = 2.0 ** (POSITION_BITS - surface.cube.position_bits)
        self.packed, self.channels, self.threads = pack_source(shown.scene, surface.origin_face), shown.channels, threads
        self.weights = component_weights(self.channels)
        self._mapped = {c: shown.mapped(c) for c in self.channels if c not in COLOURS}
        self._maps = cast(Callable[..., np.ndarray], shown.maps)  # None only where nothing asks it
        self.on_pictures = shown.on_pictures
        none = np.zeros(0, np.int64), np.zeros((0, 3))
        for channel in self._mapped:  # so that what a map needs is made before many threads ask for it
            self._maps(channel.name, *none, 1)

    @property
    def components(self) -> int:
        """Number of components of a sample."""
        return len(self.weights)

    def at(self, face: np.ndarray, bary: np.ndarray, threads: int) -> Samples:
        """Return Samples at places on the surface, with the source's values there as target: face int64 [M]; bary float64 [M,
        3]. A channel without a map in the face's material has weight 0."""
        points = np.einsum("mk,mkc->mc", bary, self.lattice[self.faces[face]])
        rgba = np.rint(sample_source(self.packed, face, bary, threads)).astype(np.uint8)
        # what cannot be seen need not be right
        seen = np.maximum(rgba[:, 3], 1) if ALPHA in self.channels else np.full(len(face), 255, np.uint8)
        target, share = np.zeros((2, len(face), self.components), np.uint8)
        ends = np.cumsum([channel.components for channel in self.channels])
        for channel, end in zip(self.channels, ends.tolist(), strict=True):
            columns, weight = slice(end - channel.components, end), self.weights[end - 1]
            rows = slice(None) if channel in COLOURS else np.flatnonzero(self._mapped[channel][face])
            counted = 255 if channel is ALPHA else seen[rows, None]
            share[rows, columns] = np.maximum(np.rint(counted * weight), 1)
            if channel in COLOURS:
                target[:, columns] = rgba[:, list(channel.columns)]
            else:
                target[rows, columns] = np.rint(self._maps(channel.name, face[rows], bary[rows], threads))
        return Samples(cube_positions(points * self.scale), target, share, self.face_field[face].astype(np.int16))

    def draw(self, count: int, seed: int | Sequence[int]) -> Samples:
        """Return `count` random Samples, spread evenly by area over the coded surface."""
        return self.at(*sample_surface(self.lattice, self.faces, count, seed, self.areas), self.threads)

    def draw_busy(self, count: int, seed: Sequence[int]) -> Samples:
        """Draw samples as draw() does, but denser where values vary. The samples' shares compensate for that on average."""
        chunks = max(1, -(-count * CANDIDATES // CHUNK))

        def chunk(k):
            wanted = count * (k + 1) // chunks - count * k // chunks
            places = sample_surface(self.lattice, self.faces, CANDIDATES * wanted, [*seed, k], self.areas)
            return _thinned(self.at(*places, 1), wanted, self.weights, np.random.default_rng([*seed, k, 1]))

        with ThreadPoolExecutor(min(self.threads, MOST_WORKERS)) as pool:
            parts = list(pool.map(chunk, range(chunks)))
        return Samples(*(np.concatenate(arrays) for arrays in zip(*(vars(p).values() for p in parts), strict=True)))


def component_weights(channels: Sequence[Channel]) -> np.ndarray:
    """Weights of the squared errors of the channels' components, float32 [C], the largest 1."""
    weights = [channel.weight for channel in channels for _ in range(channel.components)]
    return (np.array(weights) / max(weights)).astype(np.float32)


def _thinned(samples, wanted, weights, random):
    """Draws `wanted` of the samples, at a density of FLOOR plus a part proportional to the local spread of values. weights:
    float32 [C], of the components."""
    samples = samples.taken(order_along_curve(samples.position))
    begins = np.arange(0, len(samples), RUN)
    length = np.diff(np.append(begins, len(samples)))[:, None]
    value = samples.target * (samples.share * (np.float32(1 / 255) / np.sqrt(weights)))  # share is weighted, a value by its root
    mean, power = (np.add.reduceat(v, begins, axis=0) / length for v in (value, value**2))
    spread = np.sqrt(np.maximum(power - mean**2, 0).sum(axis=1) + NOISE**2)
    density = np.repeat(FLOOR + (1 - FLOOR) * spread / np.average(spread, weights=length[:, 0]), length[:, 0])
    places = np.cumsum(density) * (wanted / density.sum())
    rows = np.searchsorted(places, np.arange(wanted) + random.random()).clip(max=len(samples) - 1)
    taken = samples.taken(rows)
    share = taken.share * (density.min() / density[rows])[:, None]
    taken.share = np.floor(share + random.random((wanted, 1))).astype(np.uint8)  # right on average
    return taken


@kernel
def _keys(position, resolution, keys):
    """Morton keys of the cells of latents that points lie in; cell (x, y, z) has the latents x..x+1, y..y+1, z..z+1."""
    for i in range(position.shape[0]):
        x, y, z = (_local(np.int64(position[i, 0]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 1]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 2]), resolution) >> LOCAL_BITS)
        keys[i] = _morton_key(x + 1, y + 1, z + 1)


@kernel(allocates=True)
def _corner_rows(position, resolution, log2, first, salt, slots, bricks, words, ranks, corner):
    """Fills corner int32 [M, 8] with the rows of the eight latents of the cells that points lie in, -1 for absent latents."""
    row = np.empty(8, np.int64)
    for i in range(position.shape[0]):
        x, y, z = (_local(np.int64(position[i, 0]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 1]), resolution) >> LOCAL_BITS,
                   _local(np.int64(position[i, 2]), resolution) >> LOCAL_BITS)
        _rows_around(x, y, z, resolution, log2, salt, slots, bricks, words, ranks, row)
        for q in range(8):
            corner[i, q] = row[q] + first if row[q] >= 0 else -1


def order_along_curve(position: np.ndarray) -> np.ndarray:
    """Return the order, int64 [M], of points along a Morton curve of 2048 cells a side: neighbours in this order read the same
    latents. position: int32 [M, 3], as infer takes them."""
    keys = np.empty(len(position), np.int64)
    _keys(position, 2048, keys)
    return np.argsort(keys, kind="stable")


def cells_of(samples: Samples, tables: list) -> tuple[np.ndarray, np.ndarray]:
    """Find the rows of the latents around each sample: (cell int32 [M, L], corners int32 [cells, 8]). Row cell[i, n] of corners
    contains the rows of the eight latents of level n around sample i, -1 for absent latents. tables: payload.Tables by field."""
    levels = len(tables[0].index[0])
    cell, corners, num_cells = np.empty((len(samples), levels), np.int32), [], 0
    for number, table in enumerate(tables):
        of_field = np.flatnonzero(samples.field == number)
        of_level, places, slots, bricks, words, ranks = table.index
        for n in range(levels):
            keys = np.empty(len(of_field), np.int64)
            _keys(samples.position[of_field], of_level[n, 0], keys)
            _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
            rows = np.empty((len(first), 8), np.int32)
            s, t, b, e = places[n, 0], places[n + 1, 0], places[n, 1], places[n + 1, 1]
            _corner_rows(samples.position[of_field[first]], *of_level[n], slots[s:t], bricks[b:e], words[b:e], ranks[b:e], rows)
            cell[of_field, n] = num_cells + inverse.reshape(-1)
            corners.append(rows)
            num_cells += len(rows)
    return cell, np.concatenate(corners) if corners else np.empty((0, 8), np.int32)
