"""The 3DNTC payload (spec clause 11): the data that a GPU keeps for all fields together, and the tables that evaluation reads.

Latents are arranged in levels, coarse grids of the canonical cube. A level without a hash has one row of latents for every voxel
that the surface touches at its resolution; both sides derive the brick map that indexes it from the geometry. A level with a hash
is a table of 2**table_log2 rows that voxels share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import LimitError, StreamError
from ...field.grid import build_brick_map
from .infer import CHUNK, CODES, HASH_FIELD, answer, fixed_weights, voxel_values
from .neural_syntax import FORM_TRANSPORT
from .parameter_count import WAVE_INPUTS, parameter_count
from .transport import dec_transport, enc_transport

if TYPE_CHECKING:
    from ...field.voxels import VoxelSupport
    from ...geometry.canonical import CanonicalCube
    from ...limits import Limits

MAX_EXPONENT = 26  # biased binary16 exponent: magnitudes below 2**12, so that no sum overflows
BRICK_BYTES = 24  # resident index (11.10): key, first row, first octant, octants in use, two slots of the table of bricks


@dataclass(frozen=True)
class Level:
    """One grid of latents. resolution: voxels a side; table_log2: 0, or the hash table has 2**table_log2 rows; area_threshold:
    as that of a field (5.5); entries: rows per field, () if the level is hashed."""

    resolution: int
    table_log2: int
    area_threshold: int
    entries: tuple[int, ...] = ()

    @property
    def rows(self) -> int:
        return 1 << self.table_log2 if self.table_log2 else sum(self.entries)


@dataclass
class Payload:
    """Latents and network of all fields. features: latents per row, even; octaves, first_wave: of the waves (11.5); hidden:
    widths; components: outputs; halves: uint16 [P] binary16 parameters, layer by layer, weights [outputs, inputs], then biases;
    codes: int8 [N, features] in -8..7, level by level, field by field, in the order of the Morton keys."""

    features: int
    octaves: int
    first_wave: int
    hidden: tuple[int, ...]
    levels: tuple[Level, ...]
    components: int
    halves: np.ndarray | Any = field(default=None, repr=False)
    codes: np.ndarray | Any = field(default=None, repr=False)  # Any: both are None in a design alone, where nothing reads them

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of inputs, hidden layers and outputs."""
        return (len(self.levels) * self.features + WAVE_INPUTS * self.octaves, *self.hidden, self.components)

    @property
    def parameters(self) -> int:
        return parameter_count(self.widths)

    @property
    def rows(self) -> int:
        return sum(level.rows for level in self.levels)

    @cached_property
    def evaluated(self) -> tuple:
        """Codes and network in the form that infer._infer reads, computed once for all fields."""
        codes = np.zeros((len(self.codes), -(-self.features // CHUNK) * CHUNK), np.int8)
        codes[:, : self.features] = 2 * self.codes + np.int8(1)
        return codes, self.features, self.octaves, self.first_wave, *network_arrays(self)

    def first_row(self, number: int, level: int) -> int:
        """Return the first row in codes of the latents of one level (its index in levels) for field `number`."""
        before = sum(earlier.rows for earlier in self.levels[:level])
        return before + (0 if self.levels[level].table_log2 else sum(self.levels[level].entries[:number]))


def resident_bytes(payload: Payload, index: int = 0) -> dict[str, int]:
    """Return the bytes that a GPU keeps of a payload: {"latents", "network", "index", "total"}. index: sum of index_bytes over
    all fields and levels."""
    sizes = {"latents": payload.rows * payload.features // 2, "network": 2 * payload.parameters, "index": index}
    return sizes | {"total": sum(sizes.values())}


def index_bytes(keys: np.ndarray) -> int:
    """Return the bytes on a GPU of the index from one set of voxels to their latents (11.10): BRICK_BYTES per 8x8x8 brick and 8
    bytes of occupancy per occupied 4x4x4 octant. keys: ascending int64 Morton keys."""
    return BRICK_BYTES * len(np.unique(keys >> 9)) + 8 * len(np.unique(keys >> 6))


def enc_codes(codes: np.ndarray) -> bytes:
    """Pack INT4 codes of latents into bytes: two per byte, the first in the low bits. codes: int8 [N, F], F even."""
    pairs = (codes.reshape(-1, 2).astype(np.int64) & 15).astype(np.uint8)
    return (pairs[:, 0] | pairs[:, 1] << 4).tobytes()


def dec_codes(data: bytes, features: int) -> np.ndarray:
    """Unpack the bytes of enc_codes to codes int8 [N, features]."""
    packed = np.frombuffer(data, np.uint8)
    pairs = np.stack([packed & 15, packed >> 4], axis=1).astype(np.int8)
    return (pairs - (pairs >= CODES // 2) * np.int8(CODES)).reshape(-1, features)


def _check_halves(halves, offset):
    """Refuses parameters that are not finite or too large (5.7.4). Raises StreamError."""
    bad = np.flatnonzero((halves >> 10 & 31) > MAX_EXPONENT)
    if len(bad):
        raise StreamError("TXF-S50", "a network parameter is not a number or too large", clause="5.7.4", offset=offset,
                          value=f"{int(halves[bad[0]]):#06x}", allowed=f"|w| < {1 << MAX_EXPONENT - 14}")


def payload_values(payload: Payload, form: int) -> dict:
    """Return the syntax values of neural_parameters (spec 5.7.4) for a payload. form: FORM_TRANSPORT codes the latents by
    entropy, FORM_RESIDENT packs them as a GPU keeps them."""
    levels = [{"level_resolution": level.resolution, "table_log2": level.table_log2, "latent_threshold": level.area_threshold,
               "num_latents": list(level.entries)} for level in payload.levels]
    return {
        "form": form, "num_features": payload.features, "wave_octaves": payload.octaves, "first_wave": payload.first_wave,
        "num_hidden": len(payload.hidden), "hidden_width": list(payload.hidden), "num_levels": len(levels),
        "latent_levels": levels, "network_data": payload.halves.astype("<u2").tobytes(),
        "latent_data": enc_transport(payload.codes) if form == FORM_TRANSPORT else enc_codes(payload.codes),
    }


def payload_of(values: dict, limits: Limits) -> Payload:
    """Return the Payload of an attribute unit without its codes, which may be many: take_codes() adds them once the levels have
    been checked against the geometry. values: syntax values of the unit. Raises StreamError, LimitError."""
    levels = tuple(Level(level["level_resolution"], level["table_log2"], level["latent_threshold"], tuple(level["num_latents"]))
                   for level in values["latent_levels"])
    payload = Payload(values["num_features"], values["wave_octaves"], values["first_wave"], tuple(values["hidden_width"]), levels,
                      values["NumOutputs"], np.frombuffer(values["network_data"], "<u2"))
    _check_halves(payload.halves, values["offset"])
    if limits.latents is not None and payload.rows * payload.features > limits.latents:
        raise LimitError("TXF-L10", "the payload has more latents than the limit allows", clause="5.7.4",
                         value=payload.rows * payload.features, allowed=limits.latents)
    return payload


def take_codes(payload: Payload, values: dict) -> None:
    """Unpacks the latents of an attribute unit into the payload that payload_of() made of the unit."""
    if values["form"] == FORM_TRANSPORT:
        payload.codes = dec_transport(values["latent_data"], payload.rows, payload.features)
    else:
        payload.codes = dec_codes(values["latent_data"], payload.features)


class Tables:
    """The arrays from which infer evaluates one field. index: the index of the latents (levels, places, slots, bricks, words,
    ranks), built from keys; network: codes and network of payload; see infer._infer for the arrays."""

    def __init__(self, payload: Payload, number: int, keys: list[np.ndarray | None]) -> None:
        """keys: per level, ascending int64 Morton keys of the field's voxels, or None if the level is hashed."""
        maps = [build_brick_map(np.zeros(0, np.int64) if k is None else k) for k in keys]
        levels = [(level.resolution, level.table_log2, payload.first_row(number, n), number * HASH_FIELD)
                  for n, level in enumerate(payload.levels)]
        places = np.cumsum([(0, 0)] + [(len(m.slots), len(m.bricks)) for m in maps], axis=0)
        self.index = (np.array(levels, np.int64), places.astype(np.int64), np.concatenate([m.slots for m in maps]),
                      np.concatenate([m.bricks for m in maps]), np.concatenate([m.words for m in maps]),
                      np.concatenate([m.ranks for m in maps]))
        self.components, self.keys = payload.components, keys
        self.payload: Payload | None = None
        self.network: tuple | None = None
        if payload.codes is not None:
            self.take_values(payload)

    def take_values(self, payload: Payload) -> None:
        """Replace codes and network by those of a payload of the same design; the index stays."""
        self.payload, self.network = payload, payload.evaluated

    @property
    def arrays(self) -> tuple:
        assert self.network is not None  # take_values() comes first
        return *self.index, *self.network

    def values(self, support: VoxelSupport, threads: int = 1) -> np.ndarray:
        """Return the values at the voxels of a support, at their centres (11.8): uint8 [N, C]."""
        return voxel_values(support.xyz(), support.resolution, self, threads)

    def query(self, cube: CanonicalCube, points: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the values at world points: float32 [M, C] in 0..255. cube: CanonicalCube, which maps the points to the grid;
        points: float64 [M, 3]."""
        return answer(cube, points, self, threads)


def network_arrays(payload: Payload) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the network's parameters in the form that infer reads: widths int64, padded to multiples of 4; weight int32
    [layers, rows, rows]; bias int64 [layers, rows], 30 fractional bits."""
    fixed = fixed_weights(payload.halves)
    weights, biases = split_parameters(fixed, payload.widths)
    padded = np.array([-(-w // 4) * 4 for w in payload.widths], np.int64)
    rows = int(padded.max())
    weight, bias = np.zeros((len(weights), rows, rows), np.int32), np.zeros((len(weights), rows), np.int64)
    for n, (w, b) in enumerate(zip(weights, biases, strict=True)):
        weight[n, : w.shape[0], : w.shape[1]], bias[n, : len(b)] = w, b << 14
    return padded, weight, bias


def split_parameters(flat: np.ndarray, widths: Sequence[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Split a network's parameters into (weights [outputs, inputs] by layer, biases [outputs] by layer). flat: [P] in stream
    order; widths: of inputs, hidden layers and outputs."""
    weights, biases, at = [], [], 0
    for i, o in zip(widths[:-1], widths[1:], strict=True):
        weights.append(flat[at : at + i * o].reshape(o, i))
        biases.append(flat[at + i * o : at + i * o + o])
        at += (i + 1) * o
    return weights, biases


def join_parameters(weights: list[np.ndarray], biases: list[np.ndarray]) -> np.ndarray:
    """Concatenate the weights and biases of layers to parameters in stream order, [P]; the mirror of split_parameters."""
    return np.concatenate([np.concatenate([w.reshape(-1), b]) for w, b in zip(weights, biases, strict=True)])
