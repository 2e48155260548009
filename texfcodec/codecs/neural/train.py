"""Fused kernels of the 3DNTC fit: latents and network forward and backward, and their steps, in float32 (encoder only).

LANES samples pass through the network side by side, one component per row, so that every inner loop runs along a row. The latents
are read as the decoder reads them, rounded to INT4, and their gradient passes the rounding unchanged. After each step latents are
clipped to the range; otherwise those outside would never get a gradient again (41.7 instead of 44.4 dB). fastmath lets sums be
reordered and fused. No decoder is affected, because the fit is judged by the integer evaluation.
"""

from typing import Any

import numpy as np

from ...core.kernel import kernel
from .infer import CHUNK, CODES, LOCAL_BITS, _local, _phase

LANES = 128
MOMENTUM, SQUARE_DECAY, TINY = 0.9, 0.99, 1e-8  # a square decay of 0.999 costs 1 dB in 3,000 steps, 0.95 gains nothing
fused: dict[str, Any] = {"fastmath": True}


@kernel(**fused)
def _dense(weight, bias, x, y, inputs, outputs):
    """y[o] = bias[o] + sum over i of weight[o, i] * x[i], rows of LANES; inputs and outputs are multiples of 4."""
    for o in range(0, outputs, 4):
        for k in range(4):
            for l in range(LANES):
                y[o + k, l] = bias[o + k]
        for i in range(0, inputs, 4):
            a0, a1, a2, a3 = weight[o, i], weight[o, i + 1], weight[o, i + 2], weight[o, i + 3]
            b0, b1, b2, b3 = weight[o + 1, i], weight[o + 1, i + 1], weight[o + 1, i + 2], weight[o + 1, i + 3]
            c0, c1, c2, c3 = weight[o + 2, i], weight[o + 2, i + 1], weight[o + 2, i + 2], weight[o + 2, i + 3]
            d0, d1, d2, d3 = weight[o + 3, i], weight[o + 3, i + 1], weight[o + 3, i + 2], weight[o + 3, i + 3]
            for l in range(LANES):
                x0, x1, x2, x3 = x[i, l], x[i + 1, l], x[i + 2, l], x[i + 3, l]
                y[o, l] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                y[o + 1, l] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
                y[o + 2, l] += c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3
                y[o + 3, l] += d0 * x0 + d1 * x1 + d2 * x2 + d3 * x3


@kernel(**fused)
def _outer(slope, x, weight, bias, outputs, inputs):
    """weight[o, i] += sum over lanes of slope[o] * x[i]; bias[o] += sum of slope[o]."""
    for o in range(outputs):
        total = np.float32(0)
        for l in range(LANES):
            total += slope[o, l]
        bias[o] += total
    zero = np.float32(0)
    for o in range(0, outputs, 2):
        for i in range(0, inputs, 4):
            a0, a1, a2, a3 = zero, zero, zero, zero
            b0, b1, b2, b3 = zero, zero, zero, zero
            for l in range(LANES):
                g, h = slope[o, l], slope[o + 1, l]
                a0 += g * x[i, l]
                a1 += g * x[i + 1, l]
                a2 += g * x[i + 2, l]
                a3 += g * x[i + 3, l]
                b0 += h * x[i, l]
                b1 += h * x[i + 1, l]
                b2 += h * x[i + 2, l]
                b3 += h * x[i + 3, l]
            weight[o, i] += a0
            weight[o, i + 1] += a1
            weight[o, i + 2] += a2
            weight[o, i + 3] += a3
            weight[o + 1, i] += b0
            weight[o + 1, i + 1] += b1
            weight[o + 1, i + 2] += b2
            weight[o + 1, i + 3] += b3


@kernel(**fused)
def _activate(y, slope, rows):
    """Applies the hard GELU in place and fills its slope."""
    edge, third = np.float32(1.5), np.float32(1.0 / 3.0)
    for o in range(rows):
        for l in range(LANES):
            v = y[o, l]
            m = min(max(v, -edge), edge)
            y[o, l] = v if v > edge else m * (m + edge) * third
            slope[o, l] = np.float32(1) if v > edge else (np.float32(0) if v < -edge else (m + m + edge) * third)


@kernel(**fused)
def _corner_weights(position, resolution, corner, weight):
    """Fills weight float32 [8] with the trilinear weights of one sample on one level, renormalised; 0 for absent latents."""
    unity, unit, part = np.float32(1), np.float32(1.0 / (1 << LOCAL_BITS)), (1 << LOCAL_BITS) - 1
    u = np.float32(_local(position[0], resolution) & part) * unit
    v = np.float32(_local(position[1], resolution) & part) * unit
    w = np.float32(_local(position[2], resolution) & part) * unit
    near, far = (unity - u) * (unity - v), u * (unity - v)
    weight[0], weight[4], weight[1], weight[5] = near * (unity - w), near * w, far * (unity - w), far * w
    near, far = (unity - u) * v, u * v
    weight[2], weight[6], weight[3], weight[7] = near * (unity - w), near * w, far * (unity - w), far * w
    total = np.float32(0)
    for q in range(8):
        weight[q] = weight[q] if corner[q] >= 0 else np.float32(0)
        total += weight[q]
    scale = unity / total if total > 0 else np.float32(0)
    for q in range(8):
        weight[q] *= scale


@kernel(allocates=True, **fused)
def _read(position, cell, corners, codes, features, resolutions, octaves, first_wave, weight, x):
    """Writes the network inputs of up to LANES samples to x float32 [inputs + CHUNK, LANES]: latents level by level, waves.

    codes: int8 [N, padded] as 2 q + 1, 0 in the padding; features: latents per row without padding; weight: float32 [L, LANES,
    8], filled for _scatter. Latents are first copied together: a batch is spread over the surface, and waiting for memory, cache
    line by cache line, took half of the time.
    """
    padded, lanes = codes.shape[1], position.shape[0]
    sums, near = np.empty(padded, np.float32), np.empty((8 * LANES, padded), np.int8)
    for level in range(resolutions.shape[0]):
        for l in range(lanes):
            corner = corners[cell[l, level]]
            for q in range(8):
                code = codes[max(corner[q], 0)]
                for c in range(0, padded, CHUNK):
                    for k in range(c, c + CHUNK):
                        near[8 * l + q, k] = code[k]
        for l in range(lanes):
            share = weight[level, l]
            _corner_weights(position[l], resolutions[level], corners[cell[l, level]], share)
            sums[:] = np.float32(0)
            for q in range(8):
                w = share[q] * np.float32(1 / CODES)
                for c in range(0, padded, CHUNK):
                    for k in range(c, c + CHUNK):
                        sums[k] += w * np.float32(near[8 * l + q, k])
            for k in range(padded):
                x[level * features + k, l] = sums[k]
    first = resolutions.shape[0] * features
    for l in range(lanes):
        row = first
        for octave in range(octaves):
            for axis in range(3):
                phase = _phase(position[l, axis], first_wave, octave)
                x[row, l] = np.float32(abs(phase - 32768) - 16384) * np.float32(1.0 / 16384)
                x[row + 1, l] = np.float32(abs(((phase + 16384) & 65535) - 32768) - 16384) * np.float32(1.0 / 16384)
                row += 2


@kernel(allocates=True, **fused)
def _scatter(cell, corners, features, weight, slope, gradient, touched):
    """Transpose of the latents' part of _read: adds slope float32 [inputs, LANES] to gradient float32 [N, padded]. As in _read,
    its rows are first read together. The sum of this pass goes to touched float32 [1], or the compiler would remove it."""
    padded = gradient.shape[1]
    part, total = np.zeros(padded, np.float32), np.float32(0)
    for level in range(cell.shape[1]):
        for l in range(cell.shape[0]):
            corner = corners[cell[l, level]]
            for q in range(8):
                total += gradient[max(corner[q], 0), 0]
        for l in range(cell.shape[0]):
            corner, share = corners[cell[l, level]], weight[level, l]
            for k in range(features):
                part[k] = slope[level * features + k, l]
            for q in range(8):
                w = share[q]
                if w > 0:
                    row = gradient[corner[q]]
                    for c in range(0, padded, CHUNK):
                        for k in range(c, c + CHUNK):
                            row[k] += w * part[k]
    touched[0] = total


@kernel(**fused)
def _forward(widths, weight, bias, a, d):
    """Fills a float32 [layers + 1, rows, LANES] with activations from the inputs in a[0], and d with slopes of the hidden
    layers."""
    layers = widths.shape[0] - 1
    for n in range(layers):
        _dense(weight[n], bias[n], a[n], a[n + 1], widths[n], widths[n + 1])
        if n + 1 < layers:
            _activate(a[n + 1], d[n + 1], widths[n + 1])


@kernel(allocates=True, **fused)
def _backward(widths, turned, none, a, d, g, cell, corners, features, shares, latent_gradient, weight_gradient, bias_gradient,
              touched):
    """Adds the gradient of up to LANES samples; g[layers]: slopes by the outputs; a, d: of _forward; shares: of _read;
    touched: of _scatter."""
    layers = widths.shape[0] - 1
    for n in range(layers, 0, -1):
        _outer(g[n], a[n - 1], weight_gradient[n - 1], bias_gradient[n - 1], widths[n], widths[n - 1])
        _dense(turned[n - 1], none, g[n], g[n - 1], widths[n], widths[n - 1])
        if n > 1:
            for o in range(widths[n - 1]):
                for l in range(LANES):
                    g[n - 1, o, l] *= d[n - 1, o, l]
    _scatter(cell, corners, features, shares, g[0], latent_gradient, touched)


@kernel(allocates=True, **fused)
def _train(position, target, share, slope, cell, corners, codes, features, resolutions, octaves, first_wave, widths, weight,
           turned, bias, latent_gradient, weight_gradient, bias_gradient):
    """Adds the gradient of the squared error over samples. Returns that error, weighted and summed over components.

    position: int32 [M, 3]; target: uint8 [M, C]; share: uint8 [M, C] weights of the errors; slope: float32 [0, 0], or [M, C]
    derivatives by the outputs that replace those of the error; cell: int32 [M, L] rows of corners int32 [.., 8], which contain
    rows of codes int8 [N, padded] or -1; widths: int64 [layers + 1], multiples of 4; weight: float32 [layers, rows, rows];
    turned: its layers transposed. fit.py makes all of it from the same tables.
    """
    layers, rows = widths.shape[0] - 1, weight.shape[1]
    a, d = np.zeros((layers + 1, rows + CHUNK, LANES), np.float32), np.zeros((layers + 1, rows, LANES), np.float32)
    g, none = np.zeros((layers + 1, rows, LANES), np.float32), np.zeros(rows, np.float32)
    shares = np.zeros((cell.shape[1], LANES, 8), np.float32)
    error, given, touched = 0.0, slope.shape[0] > 0, np.empty(1, np.float32)
    for begin in range(0, position.shape[0], LANES):
        end = min(begin + LANES, position.shape[0])
        if end - begin < LANES:
            g[layers] = 0
        _read(position[begin:end], cell[begin:end], corners, codes, features, resolutions, octaves, first_wave, shares, a[0])
        _forward(widths, weight, bias, a, d)
        for l in range(end - begin):
            for c in range(target.shape[1]):
                e = a[layers, c, l] - (np.float32(target[begin + l, c]) * np.float32(1 / 127.5) - np.float32(1))
                w = np.float32(share[begin + l, c]) * np.float32(1 / 255)
                error += w * e * e
                g[layers, c, l] = slope[begin + l, c] if given else w * e
        _backward(widths, turned, none, a, d, g, cell[begin:end], corners, features, shares, latent_gradient, weight_gradient,
                  bias_gradient, touched)
    return error


@kernel(allocates=True, **fused)
def _evaluate(position, cell, corners, codes, features, resolutions, octaves, first_wave, widths, weight, bias, out):
    """Writes the network's outputs in float32, as in _train, to out float32 [M, C] on the scale 0..255, not clipped."""
    layers, rows = widths.shape[0] - 1, weight.shape[1]
    a, d = np.zeros((layers + 1, rows + CHUNK, LANES), np.float32), np.zeros((layers + 1, rows, LANES), np.float32)
    shares = np.zeros((cell.shape[1], LANES, 8), np.float32)
    for begin in range(0, position.shape[0], LANES):
        end = min(begin + LANES, position.shape[0])
        _read(position[begin:end], cell[begin:end], corners, codes, features, resolutions, octaves, first_wave, shares, a[0])
        _forward(widths, weight, bias, a, d)
        for l in range(end - begin):
            for c in range(out.shape[1]):
                out[begin + l, c] = (a[layers, c, l] + np.float32(1)) * np.float32(127.5)


@kernel(**fused)
def _adam(value, gradients, mean, square, rate, mean_scale, square_scale):
    """One step of Adam on flat arrays; gradients: float32 [parts, size], summed in order and cleared."""
    unity = np.float32(1)
    for i in range(value.shape[0]):
        g = np.float32(0)
        for part in range(gradients.shape[0]):
            g += gradients[part, i]
            gradients[part, i] = np.float32(0)
        mean[i] = np.float32(MOMENTUM) * mean[i] + (unity - np.float32(MOMENTUM)) * g
        square[i] = np.float32(SQUARE_DECAY) * square[i] + (unity - np.float32(SQUARE_DECAY)) * g * g
        value[i] -= rate * mean[i] * mean_scale / (np.sqrt(square[i] * square_scale) + np.float32(TINY))


@kernel(allocates=True, **fused)
def _move_rows(low, high, features, gradients, value, square, times, rate, warming, codes):
    """Moves the rows low..high-1 of latents that have a gradient against it, by `rate` over a running root mean square of the
    row. Other rows do not change.

    gradients: float32 [parts, N, padded], summed in order and cleared; square: float32 [N]; times: int32 [N], number of moves of
    each row; warming: float32 [T], 1 / (1 - SQUARE_DECAY ** t), 1 from T on. Writes the values that a decoder reads, 2 q + 1, to
    codes int8 [N, padded].
    """
    unity, keep, padded = np.float32(1), np.float32(SQUARE_DECAY), value.shape[1]
    powers = np.zeros(CHUNK, np.float32)
    for row in range(low, high):
        g = gradients[0, row]
        for part in range(1, gradients.shape[0]):
            other = gradients[part, row]
            for c in range(0, padded, CHUNK):
                for k in range(c, c + CHUNK):
                    g[k] += other[k]
                    other[k] = np.float32(0)
        powers[:] = np.float32(0)
        for c in range(0, padded, CHUNK):
            for k in range(CHUNK):
                powers[k] += g[c + k] * g[c + k]
        total = powers.sum()
        if total == 0:
            continue
        times[row] += 1
        square[row] = keep * square[row] + (unity - keep) * total / np.float32(features)
        scale = warming[times[row]] if times[row] < warming.shape[0] else unity
        size = rate / (np.sqrt(square[row] * scale) + np.float32(TINY))
        moved = value[row]
        for c in range(0, padded, CHUNK):
            for k in range(c, c + CHUNK):
                moved[k] -= size * g[k]
                g[k] = np.float32(0)
        _round_row(moved, codes[row], features)


@kernel(**fused)
def _round_row(value, codes, features):
    """Clips latents to the range of INT4 and writes the values that a decoder reads, 2 q + 1, and 0 in the padding."""
    half, most = np.float32(CODES // 2), np.float32(1.0 - 1e-4)
    for c in range(0, value.shape[0], CHUNK):
        for k in range(c, c + CHUNK):
            value[k] = min(max(value[k], -most), most)
            codes[k] = np.int8(2 * np.int32(np.floor(value[k] * half)) + 1)
    for k in range(features, value.shape[0]):
        codes[k] = 0


@kernel(**fused)
def _round_latents(value, codes, features):
    """Applies _round_row to all rows."""
    for row in range(value.shape[0]):
        _round_row(value[row], codes[row], features)
