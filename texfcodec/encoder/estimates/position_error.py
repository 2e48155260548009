"""How far a picture is off because positions are rounded to the lattice (encoder only).

What moves is not so much the texture on the surface, by a small part of a texel, as the surface that is seen: where layers lie
close to each other another one comes to the front, and flat faces catch the light otherwise. That is hard to reckon and easy to
look at, so a few pictures are drawn, in light where the asset is lit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...core.colour_error import ColourError
from ...geometry.areas import relative_areas
from ...geometry.canonical import MAX_BITS, fit_cube
from ...geometry.shading_normals import corner_normals
from ...render.camera import bounding_sphere, fibonacci_direction, orthographic
from ...render.lighting import Lighting
from ...render.shade import render_scene
from ...scene.fetch import pack_source
from ...scene.normal_rule import BOTH, MOST_ANGLE, PAIRS, NormalRule

if TYPE_CHECKING:
    from ...geometry.canonical import CanonicalCube
    from ...scene.scene import Scene

VIEWS, SIZE = 4, 512
SMOOTH = NormalRule(PAIRS, BOTH, MOST_ANGLE)  # no angle decides anything, so that rounding turns normals and no more


class PositionError:
    """Looks at a Scene's positions on lattices; the source itself is drawn once."""

    def __init__(self, scene: Scene, threads: int) -> None:
        self.scene, self.threads = replace(scene, materials=[replace(m, double_sided=False) for m in scene.materials]), threads
        self.lit = not all(material.unlit for material in scene.materials)
        self._source, sphere = pack_source(self.scene), bounding_sphere(scene.positions)
        self._cameras = [orthographic(fibonacci_direction(i, VIEWS), *sphere, SIZE) for i in range(VIEWS)]
        self._seen = self._pictures(self.scene)

    def _pictures(self, scene):
        """In flat colours and, where there is light, in light."""
        lights = [None, *([Lighting(scene)] if self.lit else [])]
        return [[render_scene(scene, camera, threads=self.threads, source=self._source, shaded=light) for camera in self._cameras]
                for light in lights]

    def mse(self, cube: CanonicalCube) -> float:
        """Mean squared error of Y over the pixels of a few views that show the source and its positions on a lattice, in flat
        colours or in light, where it is larger. Halving the step about halves it, as the pixels lie along lines. Normals of the
        file stay as they are."""
        moved = replace(self.scene, positions=cube.to_world(cube.to_lattice(self.scene.positions)))
        return max(_mse(*pair) for pair in zip(self._seen, self._pictures(moved), strict=True))

    def turned_normals(self, cube: CanonicalCube) -> float:
        """Mean square, over the surface, of the angles in radians by which a lattice turns smooth shading normals that are made
        of positions; 0 where the file has none or no material is lit."""
        scene = self.scene
        if scene.corner_normal is None or not self.lit:
            return 0.0
        a, b = (corner_normals(one.to_lattice(scene.positions), scene.faces, [SMOOTH]).astype(np.float64)
                for one in (fit_cube(scene.positions, MAX_BITS), cube))
        angle = 2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=2) / 2, 1.0))
        return float((angle**2).mean(axis=1) @ relative_areas(scene.positions, scene.faces))


def _mse(pictures, others):
    error = ColourError()
    for a, b in zip(pictures, others, strict=True):
        both, of_a, of_b = np.intersect1d(a.pixel, b.pixel, assume_unique=True, return_indices=True)
        if len(both):
            error.add(a.colour[of_a], b.colour[of_b])
    return error.mse()["y"] if error.samples else 0.0
