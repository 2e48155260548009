"""Memory layout of the network in a 3DNTC fit on a GPU: one flat vector of matrices whose sides are powers of two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .infer import CHUNK
from .parameter_count import WAVE_INPUTS
from .payload import Payload

LEAST_SIDE = 16  # of a matrix that matrix units take
LEAST_BLOCK = 32
BLOCKS = ((16384, 64), (0, LEAST_BLOCK))  # samples of a program, for batches from so many on; 128 gave nan on an H200


def _power(count):
    return max(LEAST_SIDE, 1 << (int(count) - 1).bit_length())


def block_of(batch: int) -> int:
    """Return the number of samples that each GPU program of the fused step takes from a batch of so many samples."""
    return next(block for least, block in BLOCKS if batch >= least)


@dataclass(frozen=True)
class Layout:
    """Sizes of a design's latents and network on the GPU, padded to powers of two. feature_block, wave_block: padded latents of
    a level and padded waves, which follow one another in the network's inputs; outputs: padded widths of the layers; inputs:
    padded widths of their inputs; weights, biases: begin of each layer in the vector of `size` parameters, matrices [outputs,
    inputs] row by row; block: samples per program."""

    batch: int
    block: int
    components: int
    levels: int
    resolutions: tuple[int, ...]
    features: int
    padded: int
    octaves: int
    first_wave: int
    widths: tuple[int, ...]
    feature_block: int
    wave_block: int
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    weights: tuple[int, ...]
    biases: tuple[int, ...]
    size: int

    @classmethod
    def of(cls, design: Payload, batch: int, block: int = 0) -> Layout:
        """Return the Layout of a design. batch: samples per batch; block: samples per GPU program, 0 takes block_of(batch)."""
        features, waves, levels = _power(design.features), _power(WAVE_INPUTS * design.octaves), len(design.levels)
        outputs = tuple(_power(width) for width in design.widths[1:])
        inputs = (levels * features + waves, *outputs[:-1])
        weights, biases, at = [], [], 0
        for i, o in zip(inputs, outputs, strict=True):
            weights.append(at)
            biases.append(at + i * o)
            at += (i + 1) * o
        return cls(batch=batch, block=block or block_of(batch), components=design.components, levels=levels,
                   resolutions=tuple(level.resolution for level in design.levels), features=design.features,
                   padded=-(-design.features // CHUNK) * CHUNK, octaves=design.octaves, first_wave=design.first_wave,
                   widths=design.widths, feature_block=features, wave_block=waves, inputs=inputs, outputs=outputs,
                   weights=tuple(weights), biases=tuple(biases), size=at)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the parameters of fit.Fit in the vector: int64 [layers, rows, rows] of weights and [layers, rows] of biases,
        -1 for padding. rows: as in Fit, the largest width rounded up to 4."""
        rows = max(-(-width // 4) * 4 for width in self.widths)
        layers = len(self.outputs)
        weight, bias = np.full((layers, rows, rows), -1, np.int64), np.full((layers, rows), -1, np.int64)
        for n, (i, o) in enumerate(zip(self.widths[:-1], self.widths[1:], strict=True)):
            column = self._columns() if n == 0 else np.arange(i)
            weight[n, :o, :i] = self.weights[n] + np.arange(o)[:, None] * self.inputs[n] + column
            bias[n, :o] = self.biases[n] + np.arange(o)
        return weight, bias

    def _columns(self):
        """Columns of the first layer's inputs."""
        latents = np.arange(self.levels)[:, None] * self.feature_block + np.arange(self.features)
        waves = self.levels * self.feature_block + np.arange(WAVE_INPUTS * self.octaves)
        return np.concatenate([latents.reshape(-1), waves])
