"""Fused kernels of the 3DNTC fit for a CUDA GPU, in Triton (comes with torch; encoder only).

A step is four launches, none of which needs the host: gradients of a batch (look-up, interpolation, waves, network forward and
backward, latents' gradient scattered by atomic additions), moves of the latents, moves of the network, and the counter of steps.
The formulas are those of train.py. Products use 16-bit or tf32 matrix units and accumulate in float32; master copies are float32.
The order of atomic additions varies, so runs with one seed differ in their last bits.

TRITON_INTERPRET=1 runs the kernels on the processor, for tests.
"""

from __future__ import annotations

from typing import Any

import triton
import triton.language as tl
from triton import jit as compiled  # Triton keeps what it compiles

from .fit_layout import Layout
from .infer import CODES, LOCAL_BITS, POSITION_BITS
from .train import MOMENTUM, SQUARE_DECAY, TINY

SCALE = 256.0  # of slopes in 16 bits, whose smallest normal number is 6e-5
ROWS, PARAMETERS, PARTIALS = 128, 64, 32  # latents' rows and parameters that a program moves; partial gradients added at a time
PRODUCTS = ("float16", "tf32", "float32")
MAX_LEVELS, HIDDEN_LAYERS = 2, 3


@compiled
def _product(a, b, HALF: tl.constexpr, PRECISION: tl.constexpr):
    if HALF:
        return tl.dot(a.to(tl.float16), b.to(tl.float16))
    else:
        return tl.dot(a, b, input_precision=PRECISION)


@compiled
def _activated(h):
    m = tl.minimum(tl.maximum(h, -1.5), 1.5)
    value = tl.where(h > 1.5, h, m * (m + 1.5) * (1.0 / 3.0))
    slope = tl.where(h > 1.5, 1.0, tl.where(h < -1.5, 0.0, (m + m + 1.5) * (1.0 / 3.0)))
    return value, slope


@compiled
def _axis_weight(position, m, axis: tl.constexpr, resolution, far, LOCAL: tl.constexpr, SHIFT: tl.constexpr):
    """Weights [M, 8] of one axis. far: whether a corner is the far one, [1, 8]."""
    p = tl.load(position + 3 * m + axis).to(tl.int64)
    local = ((p * resolution) >> SHIFT) - (1 << (LOCAL - 1))
    part = (local & ((1 << LOCAL) - 1)).to(tl.float32) * (1.0 / (1 << LOCAL))
    return tl.where(far, part[:, None], 1.0 - part[:, None])


@compiled
def _corners(position, cell, corners, m, resolution, LEVEL: tl.constexpr, LEVELS: tl.constexpr, LOCAL: tl.constexpr,
             SHIFT: tl.constexpr):
    """Rows of the eight latents around each sample and their weights, [M, 8] both; -1 and 0 for absent latents."""
    q = tl.arange(0, 8)[None, :]
    row = tl.load(cell + m * LEVELS + LEVEL).to(tl.int64)
    corner = tl.load(corners + row[:, None] * 8 + q)
    share = _axis_weight(position, m, 0, resolution, (q & 1) > 0, LOCAL, SHIFT)
    share *= _axis_weight(position, m, 1, resolution, (q & 2) > 0, LOCAL, SHIFT)
    share *= _axis_weight(position, m, 2, resolution, (q & 4) > 0, LOCAL, SHIFT)
    share = tl.where(corner >= 0, share, 0.0)
    total = tl.sum(share, axis=1)
    share *= tl.where(total > 0, 1.0 / tl.where(total > 0, total, 1.0), 0.0)[:, None]
    return corner, share


@compiled
def _latents(codes, corner, share, k, FEATURES: tl.constexpr, PADDED: tl.constexpr, UNIT: tl.constexpr):
    """Interpolated latents [M, FP]."""
    at = corner[:, :, None].to(tl.int64) * PADDED + k[None, None, :]
    there = (corner >= 0)[:, :, None] & (k < FEATURES)[None, None, :]
    code = tl.load(codes + at, mask=there, other=0).to(tl.float32)
    return tl.sum(share[:, :, None] * code, axis=1) * UNIT


@compiled
def _scattered(gradient, corner, share, slope, k, FEATURES: tl.constexpr, PADDED: tl.constexpr):
    at = corner[:, :, None].to(tl.int64) * PADDED + k[None, None, :]
    there = (share > 0)[:, :, None] & (k < FEATURES)[None, None, :]
    tl.atomic_add(gradient + at, share[:, :, None] * slope[:, None, :], mask=there, sem="relaxed")


@compiled
def _waves(position, m, first_wave, OCTAVES: tl.constexpr, WP: tl.constexpr, SHIFT: tl.constexpr):
    """Triangle waves [M, WP], 0 in the padding."""
    k = tl.arange(0, WP)
    used = k < 6 * OCTAVES
    octave = tl.where(used, k // 6, 0)
    p = tl.load(position + 3 * m[:, None] + ((k % 6) // 2)[None, :]).to(tl.int64)
    factor = (first_wave.to(tl.int64) << octave.to(tl.int64))[None, :]
    phase = ((p * factor) >> SHIFT) + ((k % 2) * 16384)[None, :]
    phase = (phase & 65535).to(tl.int32)
    wave = (tl.abs(phase - 32768) - 16384).to(tl.float32) * (1.0 / 16384)
    return tl.where(used[None, :], wave, 0.0)


@compiled(do_not_specialize=["resolution0", "resolution1", "first_wave", "size"])
def _gradients(position, target, weight, cell, corners, codes, net, gradient, partial, sums, order, counter,
               resolution0, resolution1, first_wave, size,
               COMPONENTS: tl.constexpr, LEVELS: tl.constexpr, FEATURES: tl.constexpr,
               PADDED: tl.constexpr, OCTAVES: tl.constexpr, FP: tl.constexpr, WP: tl.constexpr, N1: tl.constexpr,
               N2: tl.constexpr, N3: tl.constexpr, N4: tl.constexpr, W1: tl.constexpr, W2: tl.constexpr, W3: tl.constexpr,
               W4: tl.constexpr, B1: tl.constexpr, B2: tl.constexpr, B3: tl.constexpr, B4: tl.constexpr,
               SIZE: tl.constexpr, LOCAL: tl.constexpr, LOCAL_SHIFT: tl.constexpr, WAVE_SHIFT: tl.constexpr,
               UNIT: tl.constexpr, GAIN: tl.constexpr, HALF: tl.constexpr, PRECISION: tl.constexpr, M: tl.constexpr):
    """Gradients of M samples of a batch of `size` samples. The counter selects the batch.

    position: int32 [S, 3]; target, weight: uint8 [S, C]; cell: int32 [S, L]; corners: int32 [.., 8]; codes: int8 [N, PADDED];
    net: float32 [SIZE], of Layout. Adds to gradient float32 [N, PADDED]; writes partial float32 [programs, SIZE] and sums float32
    [programs, 2]: squared errors and weights.
    """
    program = tl.program_id(0)
    batch = tl.load(order + tl.load(counter)).to(tl.int64)
    m = batch * size + program * M + tl.arange(0, M)
    I1: tl.constexpr = LEVELS * FP + WP
    k, kw = tl.arange(0, FP), tl.arange(0, WP)
    o1, o2, o3, o4 = tl.arange(0, N1), tl.arange(0, N2), tl.arange(0, N3), tl.arange(0, N4)

    wave = _waves(position, m, first_wave, OCTAVES, WP, WAVE_SHIFT)
    ww = tl.load(net + W1 + o1[:, None] * I1 + (LEVELS * FP + kw)[None, :])
    corner0, share0 = _corners(position, cell, corners, m, resolution0, 0, LEVELS, LOCAL, LOCAL_SHIFT)
    x0 = _latents(codes, corner0, share0, k, FEATURES, PADDED, UNIT)
    w0 = tl.load(net + W1 + o1[:, None] * I1 + k[None, :])
    h1 = _product(wave, tl.trans(ww), HALF, PRECISION) + _product(x0, tl.trans(w0), HALF, PRECISION)
    h1 += tl.load(net + B1 + o1)[None, :]
    if LEVELS > 1:
        corner1, share1 = _corners(position, cell, corners, m, resolution1, 1, LEVELS, LOCAL, LOCAL_SHIFT)
        x1 = _latents(codes, corner1, share1, k, FEATURES, PADDED, UNIT)
        w1 = tl.load(net + W1 + o1[:, None] * I1 + (FP + k)[None, :])
        h1 += _product(x1, tl.trans(w1), HALF, PRECISION)
    a1, d1 = _activated(h1)
    w2 = tl.load(net + W2 + o2[:, None] * N1 + o1[None, :])
    a2, d2 = _activated(_product(a1, tl.trans(w2), HALF, PRECISION) + tl.load(net + B2 + o2)[None, :])
    w3 = tl.load(net + W3 + o3[:, None] * N2 + o2[None, :])
    a3, d3 = _activated(_product(a2, tl.trans(w3), HALF, PRECISION) + tl.load(net + B3 + o3)[None, :])
    w4 = tl.load(net + W4 + o4[:, None] * N3 + o3[None, :])
    y = _product(a3, tl.trans(w4), HALF, PRECISION) + tl.load(net + B4 + o4)[None, :]

    used = (o4 < COMPONENTS)[None, :]
    at = m[:, None] * COMPONENTS + o4[None, :]
    share = tl.load(weight + at, mask=used, other=0).to(tl.float32) * (1.0 / 255)
    error = y - (tl.load(target + at, mask=used, other=0).to(tl.float32) * (1.0 / 127.5) - 1.0)
    tl.store(sums + 2 * program, tl.sum(tl.sum(share * error * error, axis=1), axis=0))
    tl.store(sums + 2 * program + 1, tl.sum(tl.sum(share, axis=1), axis=0))

    own = partial + program.to(tl.int64) * SIZE
    back: tl.constexpr = 1.0 / GAIN
    g4 = share * error * GAIN
    tl.store(own + W4 + o4[:, None] * N3 + o3[None, :], _product(tl.trans(g4), a3, HALF, PRECISION) * back)
    tl.store(own + B4 + o4, tl.sum(g4, axis=0) * back)
    g3 = _product(g4, w4, HALF, PRECISION) * d3
    tl.store(own + W3 + o3[:, None] * N2 + o2[None, :], _product(tl.trans(g3), a2, HALF, PRECISION) * back)
    tl.store(own + B3 + o3, tl.sum(g3, axis=0) * back)
    g2 = _product(g3, w3, HALF, PRECISION) * d2
    tl.store(own + W2 + o2[:, None] * N1 + o1[None, :], _product(tl.trans(g2), a1, HALF, PRECISION) * back)
    tl.store(own + B2 + o2, tl.sum(g2, axis=0) * back)
    g1 = _product(g2, w2, HALF, PRECISION) * d1
    turned = tl.trans(g1)
    tl.store(own + W1 + o1[:, None] * I1 + (LEVELS * FP + kw)[None, :], _product(turned, wave, HALF, PRECISION) * back)
    tl.store(own + W1 + o1[:, None] * I1 + k[None, :], _product(turned, x0, HALF, PRECISION) * back)
    tl.store(own + B1 + o1, tl.sum(g1, axis=0) * back)
    _scattered(gradient, corner0, share0, _product(g1, w0, HALF, PRECISION) * back, k, FEATURES, PADDED)
    if LEVELS > 1:
        tl.store(own + W1 + o1[:, None] * I1 + (FP + k)[None, :], _product(turned, x1, HALF, PRECISION) * back)
        _scattered(gradient, corner1, share1, _product(g1, w1, HALF, PRECISION) * back, k, FEATURES, PADDED)


@compiled
def _move_rows(latent, gradient, square, times, codes, warming, schedule, counter, rows, rate,
               FEATURES: tl.constexpr, PADDED: tl.constexpr, WIDE: tl.constexpr, HALF_CODES: tl.constexpr, KEEP: tl.constexpr,
               SMALL: tl.constexpr, WARM: tl.constexpr, BLOCK: tl.constexpr):
    """train._move_rows for BLOCK rows: moves rows with a gradient, clears the gradient and writes the rows' codes."""
    row, k = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.arange(0, WIDE)
    inside = (row < rows)[:, None] & (k < PADDED)[None, :]
    at = row.to(tl.int64)[:, None] * PADDED + k[None, :]
    g = tl.load(gradient + at, mask=inside, other=0.0)
    power = tl.sum(g * g, axis=1)
    moved = power > 0
    count = tl.load(times + row, mask=moved, other=0) + 1
    mean = KEEP * tl.load(square + row, mask=moved, other=0.0) + (1 - KEEP) * power / FEATURES
    scale = tl.load(warming + tl.minimum(count, WARM - 1), mask=moved, other=1.0)
    scale = tl.where(count < WARM, scale, 1.0)
    size = rate * tl.load(schedule + 3 * tl.load(counter)) / (tl.sqrt(mean * scale) + SMALL)
    touched = inside & moved[:, None]
    value = tl.load(latent + at, mask=touched, other=0.0) - size[:, None] * g
    value = tl.minimum(tl.maximum(value, -1.0 + 1e-4), 1.0 - 1e-4)
    tl.store(times + row, count, mask=moved)
    tl.store(square + row, mean, mask=moved)
    tl.store(latent + at, value, mask=touched)
    tl.store(gradient + at, tl.zeros_like(g), mask=touched)
    code = 2 * tl.floor(value * HALF_CODES).to(tl.int32) + 1
    tl.store(codes + at, tl.where((k < FEATURES)[None, :], code, 0).to(tl.int8), mask=touched)


@compiled
def _move_network(net, partial, mean, square, sums, errors, schedule, counter, rate, PROGRAMS: tl.constexpr,
                  SIZE: tl.constexpr, MEAN_KEEP: tl.constexpr, KEEP: tl.constexpr, SMALL: tl.constexpr, BLOCK: tl.constexpr,
                  PART: tl.constexpr):
    """train._adam for BLOCK parameters, whose partial gradients are added in order; the first program writes the error."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    step, inside = tl.load(counter), at < SIZE
    total = tl.zeros([BLOCK], tl.float32)
    for first in range(0, PROGRAMS, PART):
        rows = first + tl.arange(0, PART)
        there = (rows < PROGRAMS)[:, None] & inside[None, :]
        total += tl.sum(tl.load(partial + rows.to(tl.int64)[:, None] * SIZE + at[None, :], mask=there, other=0.0), axis=0)
    decay, mean_scale, square_scale = (tl.load(schedule + 3 * step), tl.load(schedule + 3 * step + 1),
                                       tl.load(schedule + 3 * step + 2))
    m = MEAN_KEEP * tl.load(mean + at, mask=inside, other=0.0) + (1 - MEAN_KEEP) * total
    s = KEEP * tl.load(square + at, mask=inside, other=0.0) + (1 - KEEP) * total * total
    value = tl.load(net + at, mask=inside, other=0.0) - rate * decay * m * mean_scale / (tl.sqrt(s * square_scale) + SMALL)
    tl.store(mean + at, m, mask=inside)
    tl.store(square + at, s, mask=inside)
    tl.store(net + at, value, mask=inside)
    if tl.program_id(0) == 0:
        error = tl.zeros([PART], tl.float32)
        share = tl.zeros([PART], tl.float32)
        for first in range(0, PROGRAMS, PART):
            rows = first + tl.arange(0, PART)
            error += tl.load(sums + 2 * rows, mask=rows < PROGRAMS, other=0.0)
            share += tl.load(sums + 2 * rows + 1, mask=rows < PROGRAMS, other=0.0)
        tl.store(errors + step, tl.sum(error, axis=0) / tl.maximum(tl.sum(share, axis=0), SMALL) * (127.5 * 127.5))


@compiled
def _advance(counter):
    tl.store(counter, tl.load(counter) + 1)


def suits(layout: Layout, components: int) -> str:
    """Return "" if the fused kernels can fit a design of this layout, else a sentence with the reason."""
    if layout.levels > MAX_LEVELS or len(layout.outputs) != HIDDEN_LAYERS + 1:
        return f"the fused kernels take at most {MAX_LEVELS} levels, and {HIDDEN_LAYERS} hidden layers"
    return "" if layout.batch % layout.block == 0 else f"batches must be multiples of {layout.block} samples"


class FusedStep:
    """Launches the kernels of a step over a fit's state on the device. state: fit_torch.State; products: arithmetic of the
    matrix products, "float16", "tf32" or "float32"."""

    def __init__(self, state: Any, layout: Layout, products: str = "float16") -> None:
        import torch

        self.state, self.layout, self.products = state, layout, products
        self.programs = layout.batch // layout.block
        new = lambda *shape: torch.zeros(shape, dtype=torch.float32, device=state.latent.device)
        self.gradient, self.partial, self.sums = new(*state.latent.shape), new(self.programs, layout.size), new(self.programs, 2)

    def gradients(self) -> None:
        """Adds to gradient, and writes partial and sums, for the batch that the counter selects."""
        s, lay = self.state, self.layout
        resolutions = [*lay.resolutions, 0][:2]
        half = self.products == "float16"
        names = {f"N{n + 1}": lay.outputs[n] for n in range(4)} | {f"W{n + 1}": lay.weights[n] for n in range(4)}
        _gradients[(self.programs,)](
            s.position, s.target, s.share, s.cell, s.corners, s.codes, s.net, self.gradient, self.partial, self.sums, s.order,
            s.counter, *resolutions, lay.first_wave, lay.batch, COMPONENTS=lay.components, LEVELS=lay.levels,
            FEATURES=lay.features, PADDED=lay.padded, OCTAVES=lay.octaves, FP=lay.feature_block, WP=lay.wave_block, **names,
            **{f"B{n + 1}": lay.biases[n] for n in range(4)}, SIZE=lay.size, LOCAL=LOCAL_BITS,
            LOCAL_SHIFT=POSITION_BITS - LOCAL_BITS, WAVE_SHIFT=POSITION_BITS + 1 - 16, UNIT=1 / CODES,
            GAIN=SCALE if half else 1.0, HALF=half, PRECISION="tf32" if self.products == "tf32" else "ieee", M=lay.block,
            num_warps=4 if lay.block <= 32 else 8)

    def move(self, latent_rate: float, network_rate: float) -> None:
        """Move all parameters against their gradient, clear the gradient and increment the counter. The rates are those before
        the schedule's decay."""
        s, lay = self.state, self.layout
        rows = len(s.latent)
        _move_rows[(-(-rows // ROWS),)](
            s.latent, self.gradient, s.row_square, s.times, s.codes, s.warming, s.schedule, s.counter, rows, latent_rate,
            FEATURES=lay.features, PADDED=lay.padded, WIDE=triton.next_power_of_2(lay.padded), HALF_CODES=CODES // 2,
            KEEP=SQUARE_DECAY, SMALL=TINY, WARM=len(s.warming), BLOCK=ROWS)
        _move_network[(-(-lay.size // PARAMETERS),)](
            s.net, self.partial, s.mean, s.square, self.sums, s.errors, s.schedule, s.counter, network_rate,
            PROGRAMS=self.programs, SIZE=lay.size, MEAN_KEEP=MOMENTUM, KEEP=SQUARE_DECAY, SMALL=TINY, BLOCK=PARAMETERS,
            PART=PARTIALS)
        _advance[(1,)](s.counter, num_warps=1)
