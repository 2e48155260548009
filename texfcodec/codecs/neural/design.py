"""Chooses the shape of a 3DNTC payload for a budget of resident bytes, or for one of the paper's operating points (encoder
only)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...field.voxelise import voxelise
from ...field.voxels import MOST_DROPPED
from .operating_points import DEFAULT_POINT, POINTS
from .payload import Level, Payload, Tables, index_bytes, resident_bytes

if TYPE_CHECKING:
    from ...geometry.geometry_unit import LatticeMesh
    from .neural_options import NeuralOptions

HIDDEN = (64, 48, 32)
# Surface grid alone: one level of 32 latents reaches what two of 16 do, with half the look-ups and the index.
# Mixed: half of them on a surface grid, half in a hash table over FINER times finer cells, where busy surface wins the rows
# that it shares with plain surface: +0.5 dB (basketball player, 409 kB) and +2.3 dB (water bottle, 690 kB) over the grid alone.
FEATURES = {"surface": 32, "mixed": 16}
FINER = 3  # bottle at 2.3, 3.2, 5.2 times: 47.7, 48.1, 47.9 dB
# Of the latents at most, rows rounded down to a power of two; 0.37 and 0.76 of the bottle's end within 0.03 dB.
HASHED_SHARE = 0.7
OCTAVES, FIRST_WAVE = 3, 2  # the longest wave of a surface grid spans one voxel
HASHED_OCTAVES, HASHED_WAVE = 3, 2  # of hashed grids the whole cube: shared latents need to be told apart
HASHED_GRID = 2048  # the paper's K for sources of 2048 texels
FIRST_RESOLUTION, MOST_RESOLUTION = 64, 8192 // FINER
NETWORK_GUESS = 8000  # parameters; only where the hash table's share is worked out


@dataclass
class Design:
    """Sizes of a fit before it begins. payload: payload.Payload without codes and halves; tables: payload.Tables by field,
    without values; resident: as resident_bytes() returns."""

    payload: Payload
    tables: list[Tables]
    resident: dict


def choose_design(surfaces: list[LatticeMesh], position_bits: int, components: int, options: NeuralOptions) -> Design:
    """Return the Design (grids of latents, network) that options request. surfaces: decoded meshes by field; components: outputs
    of the network."""
    point = options.point or DEFAULT_POINT
    if options.latent_index == "hash":
        return hashed_design(point, components, len(surfaces))
    budget = options.resident_bytes or point_bytes(point)
    return surface_design(surfaces, position_bits, budget, components, options)


def point_bytes(name: str) -> int:
    """Return the bytes on a GPU of an operating point of the paper, with three output components. name: a key of POINTS."""
    return resident_bytes(_hashed(name, 3))["total"]


def _hashed(name, components):
    features, spans = POINTS[name]
    levels = tuple(Level(-(-HASHED_GRID // span), log2, 0) for span, log2 in spans)
    return Payload(features, HASHED_OCTAVES, HASHED_WAVE, HIDDEN, levels, components)


def hashed_design(name: str, components: int, fields: int) -> Design:
    """Return the Design of an operating point in the paper's own form: hash tables over cells of a few voxels of a grid of 2048.
    name: a key of POINTS."""
    payload = _hashed(name, components)
    tables = [Tables(payload, number, [None] * len(payload.levels)) for number in range(fields)]
    return Design(payload, tables, resident_bytes(payload))


def surface_design(surfaces: list[LatticeMesh], position_bits: int, budget: int, components: int,
                   options: NeuralOptions) -> Design:
    """Return the Design with the finest grid of latents at the surface's voxels that fits `budget` bytes on a GPU. The payload
    includes a hash table if options.latent_index is "mixed".

    surfaces: decoded meshes by field; components: outputs of the network. Raises InputError TXF-I54 if not even one latent fits.
    """
    log2 = 0
    if options.latent_index == "mixed":
        room = HASHED_SHARE * (budget - 2 * NETWORK_GUESS) / (FEATURES["mixed"] // 2)
        log2 = max(int(room), 1).bit_length() - 1
    low, high, best, tried = 0, MOST_RESOLUTION + 1, None, None
    while high - low > 1:
        middle = min(max(_guess(tried, budget), low + 1), high - 1)
        tried = _surface_payload(surfaces, position_bits, middle, components, options, log2)
        if tried[2]["total"] <= budget:
            low, best = middle, tried
        else:
            high = middle
    if best is None:
        assert tried is not None
        raise InputError("TXF-I54", "the budget is too small for a grid of "
                                    "latents", value=budget, allowed=f">= {tried[2]['total']}")
    payload, keys, resident = best
    others = [None] * (len(payload.levels) - 1)
    return Design(payload, [Tables(payload, number, [k, *others]) for number, k in enumerate(keys)], resident)


def _guess(tried, budget):
    """Resolution that would just fill the budget if the number of latents grew with its square. tried: the last trial, or
    None."""
    if tried is None:
        return FIRST_RESOLUTION
    payload, _, resident = tried
    rest = resident["network"] + sum(level.rows for level in payload.levels[1:]) * payload.features // 2
    return int(payload.levels[0].resolution * np.sqrt(max(budget - rest, 0) / (resident["total"] - rest)))


def _surface_payload(surfaces, position_bits, resolution, components, options, log2):
    """(Payload without values, keys by field, resident bytes) of a surface grid, plus a hash table over finer cells if log2 is
    set."""
    keys, threshold = _latent_voxels(surfaces, position_bits, resolution, options.area_threshold, options.threads)
    levels: tuple[Level, ...] = (Level(resolution, 0, threshold, tuple(len(k) for k in keys)),)
    if log2:
        levels += (Level(FINER * resolution, log2, 0),)
    features = FEATURES["mixed" if log2 else "surface"]
    payload = Payload(features, OCTAVES, resolution * FIRST_WAVE, HIDDEN, levels, components)
    return payload, keys, resident_bytes(payload, sum(index_bytes(k) for k in keys))


def _latent_voxels(surfaces, position_bits, resolution, area_threshold, threads):
    """(Morton keys int64 [N] by field of the voxels with latents (11.3), their area threshold). The threshold is the requested
    one, or 0 if a field would lose more than MOST_DROPPED of its surface."""
    keys = []
    for lattice, faces in surfaces:
        touched, weights = voxelise(lattice, faces, position_bits, resolution, 0, threads)
        keep = weights >= area_threshold << 24
        if weights[~keep].sum(dtype=np.float64) > MOST_DROPPED * weights.sum(dtype=np.float64) or not keep.any():
            return [voxelise(lattice, faces, position_bits, resolution, 0, threads)[0] for lattice, faces in surfaces], 0
        keys.append(touched[keep])
    return keys, area_threshold
