"""Meshes with noise for the tests of the encoder's geometry, where no two edges cost the same."""

import numpy as np

from texfcodec.geometry.mesh import Mesh


def rough(mesh, size=0.02, seed=0):
    """A mesh (positions, faces) whose vertices are shifted by random lengths of about `size`."""
    return Mesh(mesh[0] + np.random.default_rng(seed).normal(0, size, mesh[0].shape), mesh[1])


def grid(side=8, height=0.0, inner=0.3, seed=0):
    """A square of 2 side^2 faces whose border is straight, its inner vertices shifted by up to `inner` cells and lifted."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    inside = (x > 0) & (x < side) & (y > 0) & (y < side)
    x, y = (c + inside * rng.uniform(-inner, inner, c.shape) for c in (x, y))
    z = height * inside * rng.uniform(-1, 1, x.shape)
    v = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = v[:-1, :-1].ravel(), v[1:, :-1].ravel(), v[1:, 1:].ravel(), v[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(np.stack([x, y, z], axis=-1).reshape(-1, 3) / side, faces)


def torus(n=16, m=10):
    """A closed surface with a hole through it, of 2 n m faces."""
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m, indexing="ij")
    p = np.stack([(1 + 0.4 * np.cos(v)) * np.cos(u), (1 + 0.4 * np.cos(v)) * np.sin(u), 0.4 * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b, c, d = (((i + s) % n * m + (j + t) % m).ravel() for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return Mesh(p, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))
