"""Normative integer evaluation of a 3DNTC payload (spec clause 11): point in, values out, the same bits on every machine.

LANES points go side by side, a component a row, so that every inner loop runs along a row. Operands are int32 and sums int64:
|weight| < 2**28, |activation| <= 2**24, at most 304 inputs and a bias below 2**42 stay below 2**61."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from ...core.integer import _ones
from ...core.kernel import kernel
from ...core.threads import over_blocks
from ...field.grid import _brick_slot
from ...field.morton import _spread

if TYPE_CHECKING:
    from ...geometry.canonical import CanonicalCube

POSITION_BITS = 24  # of a point in the canonical cube
LOCAL_BITS = 12  # of a point in a latent cell; 8 would cost 0.1 dB where the network is steep
CODES = 16  # values of a latent
ONE_BITS = 14  # fractional bits of an activation
WEIGHT_BITS = 16  # fractional bits of a weight
WEIGHT_SUM_BITS = 24  # the weights of a point's corners add up to at most 2**24
WEIGHT_ONE = 1 << WEIGHT_BITS
MOST = 1 << 24  # activations are clamped to this magnitude
EDGE = 3 << (ONE_BITS - 1)  # 3/2, where hard GELU becomes the identity
LEVEL_SCALE = 255 * 128  # half the range of values with 8 fractional bits
VALUE_BITS = 8
HASH_Y, HASH_Z, HASH_FIELD = 2654435761, 805459861, 3674653429  # products with coordinates < 2**46
LANES = 128  # 64: 1.9 instead of 2.1 million points a second on two cores
CHUNK = 8  # rows of latents are padded to a multiple: loops of known length become vector instructions, others of 16 do not
BLOCK = 1 << 14


@kernel
def _local(p, resolution):
    """Coordinate relative to the latents' centres, LOCAL_BITS fractional bits: p < 2**24, resolution <= 2**13."""
    return ((p * resolution) >> (POSITION_BITS - LOCAL_BITS)) - (1 << (LOCAL_BITS - 1))


@kernel
def _phase(p, first_wave, octave):
    """Phase of a wave in 2**-16 periods: first_wave half periods over the cube, doubled by every octave; product < 2**46."""
    return ((p * (first_wave << octave)) >> (POSITION_BITS + 1 - 16)) & 65535


@kernel
def _hashed_row(x, y, z, log2, salt):
    """Row of the latent at (x, y, z) of a hashed level, counted from the level's first (11.3)."""
    return ((x + 1) ^ ((y + 1) * HASH_Y) ^ ((z + 1) * HASH_Z) ^ salt) & ((1 << log2) - 1)


@kernel
def _rows_of_voxels(x, y, z, size, slots, bricks, words, ranks, row):
    """Writes the ranks of the eight voxels x..x+1, y..y+1, z..z+1 to row int64 [8], -1 for absent voxels: as _rank_of_voxel, with
    one look-up if they share a brick."""
    xs = _spread(max(x, 0)), _spread(x + 1)
    ys = _spread(max(y, 0)) << 1, _spread(y + 1) << 1
    zs = _spread(max(z, 0)) << 2, _spread(z + 1) << 2
    last, b = np.int64(-1), np.int64(-1)
    for q in range(8):
        dx, dy, dz = q & 1, (q >> 1) & 1, q >> 2
        row[q] = -1
        if x + dx < 0 or y + dy < 0 or z + dz < 0 or x + dx >= size or y + dy >= size or z + dz >= size:
            continue
        key = xs[dx] | ys[dy] | zs[dz]
        if key >> 9 != last:
            last = key >> 9
            b = slots[_brick_slot(last, slots, bricks)]
        if b >= 0:
            word, bit = (key >> 5) & 15, key & 31
            bits = np.int64(words[b, word])
            if (bits >> bit) & 1:
                row[q] = ranks[b, word] + _ones(bits & ((np.int64(1) << bit) - 1))


@kernel
def _rows_around(x, y, z, resolution, log2, salt, slots, bricks, words, ranks, row):
    """Writes the rows of a cell's eight latents, counted from the level's first, to row int64 [8], -1 for absent latents
    (11.3)."""
    if log2 > 0:
        for q in range(8):
            row[q] = _hashed_row(x + (q & 1), y + ((q >> 1) & 1), z + (q >> 2), log2, salt)
    else:
        _rows_of_voxels(x, y, z, resolution, slots, bricks, words, ranks, row)


@kernel
def _weights(u, v, w, corner, weight):
    """Writes the integer weights (11.4) of the eight latents around a point at (u, v, w) of their cell to weight int32 [8], 0 if
    corner is -1. Returns their sum, at most 2**24."""
    unity, shift, total = 1 << LOCAL_BITS, 3 * LOCAL_BITS - WEIGHT_SUM_BITS, np.int64(0)
    near, far = (unity - u) * (unity - v), u * (unity - v)
    weight[0], weight[4] = near * (unity - w) >> shift, near * w >> shift
    weight[1], weight[5] = far * (unity - w) >> shift, far * w >> shift
    near, far = (unity - u) * v, u * v
    weight[2], weight[6] = near * (unity - w) >> shift, near * w >> shift
    weight[3], weight[7] = far * (unity - w) >> shift, far * w >> shift
    for q in range(8):
        weight[q] = weight[q] if corner[q] >= 0 else 0
        total += weight[q]
    return total


@kernel(allocates=True)
def _read_level(positions, resolution, log2, first, salt, slots, bricks, words, ranks, codes, features, x, row):
    """Writes the latents of one level at up to LANES points to rows row.. of x, int32 [inputs + CHUNK, LANES] (11.4).

    codes: int8 [N, padded], 2 q + 1, 0 in the padding; |sum| <= 15 * 2**24, times the reciprocal below 2**42. Every corner is
    checked against N. Points that share a cell, as neighbours often do, share its look-up.
    """
    padded, part = codes.shape[1], (1 << LOCAL_BITS) - 1
    corner, weight, sums = np.full(8, -1, np.int64), np.empty(8, np.int32), np.empty(padded, np.int32)
    x0, y0, z0 = np.int64(-2), np.int64(-2), np.int64(-2)  # no cell: the least is -1
    for l in range(positions.shape[0]):
        u, v, w = (_local(positions[l, 0], resolution), _local(positions[l, 1], resolution), _local(positions[l, 2], resolution))
        if u >> LOCAL_BITS != x0 or v >> LOCAL_BITS != y0 or w >> LOCAL_BITS != z0:
            x0, y0, z0 = u >> LOCAL_BITS, v >> LOCAL_BITS, w >> LOCAL_BITS
            _rows_around(x0, y0, z0, resolution, log2, salt, slots, bricks, words, ranks, corner)
            for q in range(8):
                corner[q] = corner[q] + first if 0 <= corner[q] < codes.shape[0] - first else -1
        total = _weights(u & part, v & part, w & part, corner, weight)
        sums[:] = 0
        for q in range(8):
            if weight[q] > 0:
                code = codes[corner[q]]
                for c in range(0, padded, CHUNK):
                    for k in range(c, c + CHUNK):
                        sums[k] += np.int64(weight[q]) * np.int64(code[k])
        scale = (np.int64(1) << 38) // total if total > 0 else np.int64(0)
        for k in range(padded):
            x[row + k, l] = (np.int64(sums[k]) * scale + (1 << 27)) >> 28


@kernel
def _read_waves(positions, octaves, first_wave, x, row):
    """Triangle waves of the position (11.5)."""
    for l in range(positions.shape[0]):
        r = row
        for octave in range(octaves):
            for axis in range(3):
                phase = _phase(np.int64(positions[l, axis]), first_wave, octave)
                x[r, l] = abs(phase - 32768) - 16384
                x[r + 1, l] = abs(((phase + 16384) & 65535) - 32768) - 16384
                r += 2


@kernel
def _layer(weight, bias, x, total, y, inputs, outputs, hidden):
    """One layer (11.6). weight: int32 [outputs, inputs]; bias: int64 [outputs], 30 fractional bits; x: int32 [inputs, LANES];
    total: int64 [4, LANES], room for sums; y: int32 [outputs, LANES]. outputs is a multiple of 4."""
    for o in range(0, outputs, 4):
        for k in range(4):
            for l in range(LANES):
                total[k, l] = bias[o + k]
        for i in range(0, inputs, 4):
            for k in range(0, 4, 2):
                a0, a1, a2, a3 = weight[o + k, i], weight[o + k, i + 1], weight[o + k, i + 2], weight[o + k, i + 3]
                o1 = o + k + 1
                b0, b1, b2, b3 = weight[o1, i], weight[o1, i + 1], weight[o1, i + 2], weight[o1, i + 3]
                for l in range(LANES):
                    v0, v1, v2, v3 = np.int64(x[i, l]), np.int64(x[i + 1, l]), np.int64(x[i + 2, l]), np.int64(x[i + 3, l])
                    total[k, l] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
                    total[k + 1, l] += b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
        for k in range(4):
            for l in range(LANES):
                v = min(max((total[k, l] + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS, -MOST), MOST)
                if hidden:  # hard GELU; |m| * |m + EDGE| * 43691 < 2**47
                    m = min(max(v, -EDGE), EDGE)
                    v = v if v > EDGE else (m * (m + EDGE) * 43691 + (1 << 30)) >> 31
                y[o + k, l] = v


@kernel
def _network(widths, weight, bias, a, total):
    """All layers: inputs in a[0], outputs in the last of a int32 [layers + 1, rows, LANES]."""
    layers = widths.shape[0] - 1
    for n in range(layers):
        _layer(weight[n], bias[n], a[n], total, a[n + 1], widths[n], widths[n + 1], n + 1 < layers)


@kernel(allocates=True)
def _infer(positions, levels, places, slots, bricks, words, ranks, codes, features, octaves, first_wave, widths, weight, bias,
           out):
    """Writes the values of points of one field to out uint16 [M, C], 8 fractional bits.

    positions: int32 [M, 3] in 0..2**24-1; levels: int64 [L, 4] of resolution, table_log2, first row and salt of the hash; places:
    int64 [L + 1, 2], begin of each level's brick map in slots and in bricks, words and ranks; widths: int64 [layers + 1],
    multiples of 4; weight: int32 [layers, rows, rows], bias: int64 [layers, rows]; rows >= every width.
    """
    layers, rows = widths.shape[0] - 1, weight.shape[1]
    a, total = np.zeros((layers + 1, rows + CHUNK, LANES), np.int32), np.zeros((4, LANES), np.int64)
    for begin in range(0, positions.shape[0], LANES):
        end = min(begin + LANES, positions.shape[0])
        row = 0
        for n in range(levels.shape[0]):
            s, t, b, e = places[n, 0], places[n + 1, 0], places[n, 1], places[n + 1, 1]
            _read_level(positions[begin:end], levels[n, 0], levels[n, 1], levels[n, 2], levels[n, 3], slots[s:t], bricks[b:e],
                        words[b:e], ranks[b:e], codes, features, a[0], row)
            row += features
        _read_waves(positions[begin:end], octaves, first_wave, a[0], row)
        _network(widths, weight, bias, a, total)
        for l in range(end - begin):
            for c in range(out.shape[1]):
                y = np.int64(a[layers, c, l]) + (1 << ONE_BITS)
                out[begin + l, c] = min(max((y * LEVEL_SCALE + (1 << (ONE_BITS - 1))) >> ONE_BITS, 0), 255 << VALUE_BITS)


def cube_positions(grid: np.ndarray) -> np.ndarray:
    """Return the integer positions at which infer() evaluates (11.2), int32 of the shape of grid. grid: float64 [..., 3] grid
    coordinates for K = 2**POSITION_BITS; points outside the cube are moved to its border."""
    return np.floor(np.clip(grid, 0, (1 << POSITION_BITS) - 1)).astype(np.int32)


def voxel_positions(xyz: np.ndarray, resolution: int) -> np.ndarray:
    """Return the integer positions of voxel centres for infer() (11.2): floor((2 v + 1) 2**23 / K), int32 [N, 3]. xyz: integers
    [N, 3] in 0..K-1; resolution: K."""
    return (((2 * np.asarray(xyz, np.int64) + 1) << (POSITION_BITS - 1)) // resolution).astype(np.int32)


def fixed_weights(halves: np.ndarray) -> np.ndarray:
    """Network parameters as fixed-point numbers with WEIGHT_BITS fractional bits (11.6), int64 of the shape of halves.

    halves: uint16, binary16 patterns of magnitude below 2**12 (payload.py has checked). Magnitudes from 2**-6 on are exact,
    smaller ones are rounded to the nearest, halves away from zero.
    """
    exponent, fraction = (halves.astype(np.int64) >> 10) & 31, halves.astype(np.int64) & 1023
    mantissa = np.where(exponent > 0, fraction + 1024, fraction)
    shift = np.maximum(exponent, 1) - 9
    left, right = mantissa << np.maximum(shift, 0), np.maximum(-shift, 1)
    value = np.where(shift >= 0, left, (mantissa + (1 << (right - 1))) >> right)
    return np.where(halves >> 15, -value, value)


class Tables(Protocol):
    """The tables that infer() reads for a field: payload.Tables."""

    components: int

    @property
    def arrays(self) -> tuple:
        """Index and network, as in _infer()."""


def infer(positions: np.ndarray, tables: Tables, threads: int = 1) -> np.ndarray:
    """Evaluate latents and network of one field at points, in integers only. positions: int32 [M, 3] from cube_positions or
    voxel_positions; tables: of the field.

    Returns uint16 [M, C]: values 0..255 with VALUE_BITS fractional bits (11.7).
    """
    positions = np.ascontiguousarray(positions, np.int32)
    if len(positions) and (positions.min() < 0 or positions.max() >> POSITION_BITS):
        raise IndexError("a position outside the cube")
    out = np.empty((len(positions), tables.components), np.uint16)

    def infer_block(begin):
        part = slice(begin, begin + BLOCK)
        _infer(positions[part], *tables.arrays, out[part])

    over_blocks(infer_block, len(positions), BLOCK, threads)
    return out


def answer(cube: CanonicalCube, points: np.ndarray, tables: Tables, threads: int = 1) -> np.ndarray:
    """Evaluate one field at world points: float32 [M, C] on the scale 0..255. points: float64 [M, 3], which are moved to the
    border of the CanonicalCube if they are outside; tables: of the field."""
    low, high = np.array(cube.origin) - cube.side, np.array(cube.origin) + 2 * cube.side  # further out is on the border anyway
    return infer_values(cube_positions(cube.to_grid(np.clip(points, low, high), 1 << POSITION_BITS)), tables, threads)


def infer_values(positions: np.ndarray, tables: Tables, threads: int = 1) -> np.ndarray:
    """Return the values of infer() as float32 [M, C] on the scale 0..255; arguments as there."""
    return infer(positions, tables, threads) * np.float32(1 / (1 << VALUE_BITS))


def voxel_values(xyz: np.ndarray, resolution: int, tables: Tables, threads: int = 1) -> np.ndarray:
    """Evaluate one field at the centres of voxels (11.8) and round: uint8 [N, C]. xyz: integers [N, 3], voxel indices;
    resolution: voxels a side; tables: of the field."""
    values = infer(voxel_positions(xyz, resolution), tables, threads).astype(np.int64)
    return ((values + (1 << (VALUE_BITS - 1))) >> VALUE_BITS).astype(np.uint8)
