"""A textured surface made by code for the benchmarks: a bumpy torus, about as many voxels per face as a scan has."""

import numpy as np

from texfcodec.scene.scene import Material, Scene, Texture


def torus(rows=160, columns=80, texels=1024):
    """Closed torus of 2 * rows * columns faces with a noisy texture."""
    u, v = np.meshgrid(np.arange(rows) / rows, np.arange(columns) / columns, indexing="ij")
    radius = 0.35 + 0.02 * np.sin(12 * np.pi * u) * np.cos(8 * np.pi * v)
    ring = 1 + radius * np.cos(2 * np.pi * v)
    positions = np.stack([ring * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * v), ring * np.sin(2 * np.pi * u)], -1)
    i, j = np.divmod(np.arange(rows * columns), columns)
    corner = lambda di, dj: ((i + di) % rows) * columns + (j + dj) % columns
    faces = np.concatenate([np.stack([corner(0, 0), corner(1, 0), corner(1, 1)], 1),
                            np.stack([corner(0, 0), corner(1, 1), corner(0, 1)], 1)])
    place = lambda di, dj: np.stack([(i + di) / rows, (j + dj) / columns], 1)
    uv = np.concatenate([np.stack([place(0, 0), place(1, 0), place(1, 1)], 1),
                         np.stack([place(0, 0), place(1, 1), place(0, 1)], 1)])
    return Scene(positions.reshape(-1, 3), faces, np.zeros(len(faces), np.int64), uv, None, [Material("skin", texture=0)],
                 [Texture(_picture(texels))])


def _picture(texels):
    """Waves of several lengths and a little noise: neither flat nor white."""
    y, x = np.mgrid[:texels, :texels] * (2 * np.pi / texels)
    rng = np.random.default_rng(0)
    waves = sum(np.sin(rng.integers(1, 40) * x + rng.integers(1, 40) * y + rng.uniform(0, 6)) for _ in range(8)) / 4
    planes = [127 + 60 * waves + 30 * np.sin((5 + c) * x) + rng.normal(0, 4, x.shape) for c in range(3)]
    return np.dstack([np.clip(np.stack(planes, -1), 0, 255), np.full(x.shape, 255)]).astype(np.uint8)
