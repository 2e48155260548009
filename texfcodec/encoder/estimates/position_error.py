"""How far a picture is off because positions are rounded to the lattice (encoder only).

What moves is not so much the texture on the surface, by a small part of a texel, as the surface that is seen: where layers lie
close to each other another one comes to the front. That is hard to reckon and easy to look at, so a few pictures are drawn. """

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import ColourError
from ...render.camera import bounding_sphere, fibonacci_direction, orthographic
from ...render.shade import render_scene
from ...scene.fetch import pack_source

if TYPE_CHECKING:
    from ...geometry.canonical import CanonicalCube
    from ...scene.scene import Scene

VIEWS, SIZE = 4, 512


def rounding_mse(scene: Scene, cube: CanonicalCube, threads: int) -> float:
    """Mean squared error of Y over the pixels of a few views that show the source and its positions on the lattice. Halving the
    step about halves it, as the pixels lie along lines."""
    plain = replace(scene, materials=[replace(m, double_sided=False) for m in scene.materials])
    moved = replace(plain, positions=cube.to_world(cube.to_lattice(plain.positions)))
    source, (centre, radius) = pack_source(plain), bounding_sphere(plain.positions)
    error = ColourError()
    for i in range(VIEWS):
        camera = orthographic(fibonacci_direction(i, VIEWS), centre, radius, SIZE)
        a, b = (render_scene(one, camera, threads=threads, source=source) for one in (plain, moved))
        both, of_a, of_b = np.intersect1d(a.pixel, b.pixel, assume_unique=True, return_indices=True)
        if len(both):
            error.add(a.colour[of_a], b.colour[of_b])
    return error.mse()["y"] if error.samples else 0.0
