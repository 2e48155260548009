"""Fits of a 3DNTC payload to a coloured square, small enough for a test."""

import numpy as np

from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_samples import Samples
from texfcodec.codecs.neural.payload import Level, Payload, Tables

SIDE = 8  # voxels a side of the small design's grid


def plane_fit(count=4096, seed=0, threads=1, components=3, octaves=2, target=None, uneven=False):
    """A Fit to a coloured square in the middle of the cube. uneven: samples that count for more and for less."""
    random = np.random.default_rng(5)
    position = random.integers(0, 1 << 24, (count, 3)).astype(np.int32)
    position[:, 2] = (1 << 23) + 5000
    if target is None:
        x, y = position[:, 0], position[:, 1]
        target = np.stack([x >> 16, y >> 16, (x >> 15) & 255, y >> 17], axis=1)
    share = random.integers(1, 256, (count, components)) if uneven else np.full((count, components), 255)
    samples = Samples(position, target[:, :components].astype(np.uint8), share.astype(np.uint8), np.zeros(count, np.int16))
    keys = square_keys()
    design = Payload(8, octaves, 2 * SIDE, (12, 8), (Level(SIDE, 0, 0, (len(keys),)),), components)
    return Fit(design, [Tables(design, 0, [keys])], samples, samples.taken(slice(0, 512)), seed, threads)


def square_keys():
    """Ascending Morton keys of the layer of voxels below and the one above the middle."""
    from texfcodec.field.morton import encode_morton

    xyz = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), [SIDE // 2 - 1, SIDE // 2], indexing="ij"), axis=-1)
    return np.sort(encode_morton(xyz.reshape(-1, 3)))
