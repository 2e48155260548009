"""Scenes that are worth keeping as texels: a textured wall, boxes that show a palette, and what decoding them gives."""

import numpy as np

from texfcodec.api import decode, encode
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.scene.scene import WRAP_REPEAT, Material, Scene, Texture


def smooth_image(width=32, height=32, channels=4, seed=0):
    """Random waves: uint8 [height, width, 4], opaque with three channels."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] * (2 * np.pi)
    image = np.full((height, width, 4), 255, np.uint8)
    for c in range(channels):
        a, b, phase = rng.integers(1, 4), rng.integers(1, 4), rng.random() * 7
        image[..., c] = np.rint(127.5 + 120 * np.sin(a * x / width + b * y / height + phase))
    return image


def wall(image, wrap=(WRAP_REPEAT, WRAP_REPEAT), low=0.0, high=1.0, n=6, **material):
    """A bumpy wall of n x n squares facing the viewer, UVs low..high over its image."""
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    positions = np.stack([u, v, 0.1 * np.sin(5 * u) * np.cos(4 * v)], -1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.vstack([np.stack([a, a + n + 1, a + 1], 1), np.stack([a + 1, a + n + 1, a + n + 2], 1)])
    uv = low + (high - low) * positions[:, :2]
    return Scene(positions, faces, np.zeros(len(faces), np.int64), uv[faces], None,
                 [Material("wall", texture=0, double_sided=True, **material)], [Texture(image, wrap)])


def noisy_wall(noise, n=8):
    """A wall whose left half is flat and whose right half is another material with noise."""
    scene = wall(smooth_image(64, 64, 3), n=n)
    image = smooth_image(64, 64, 3, seed=1).astype(float)
    image[..., :3] += np.random.default_rng(0).normal(0, noise, (64, 64, 3))
    scene.textures.append(Texture(np.clip(image, 0, 255).astype(np.uint8)))
    scene.materials = [Material("calm", texture=0), Material("noisy", texture=1)]
    scene.face_material[len(scene.faces) // 2 :] = 1
    return scene


def coded(scene, lod=0, **options):
    options = EncodeOptions(**({"support": "texels", "resolution": 64, "qp": 16} | options))
    return decode(encode(scene, options), DecodeOptions(lod=lod))


def boxes(colours=21, count=60, width=256, seed=0):
    """Boxes of a voxel editor: each shows the centre of one texel of a palette of one row."""
    rng = np.random.default_rng(seed)
    palette = np.full((1, width, 4), 255, np.uint8)
    palette[..., :3] = rng.integers(0, 256, (1, width, 3))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                      [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    cells = rng.permutation(512)[:count]
    places = np.stack([cells % 8, cells // 8 % 8, cells // 64], 1).astype(float)
    shown = rng.choice(rng.choice(width, colours, replace=False), count)
    uv = np.stack([(shown + 0.5) / width, np.full(count, 0.5)], 1)
    return Scene(positions=(places[:, None] + corners).reshape(-1, 3),
                 faces=(8 * np.arange(count)[:, None, None] + sides).reshape(-1, 3), face_material=np.zeros(12 * count, np.int64),
                 corner_uv=np.repeat(uv, 12, axis=0)[:, None, :].repeat(3, axis=1), corner_color=None,
                 materials=[Material(texture=0)], textures=[Texture(palette, (WRAP_REPEAT, WRAP_REPEAT))])
