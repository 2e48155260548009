"""What an error in each channel of an asset does to its shaded picture: measured on a few small pictures, so that bytes go where
they show (encoder only)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...render.camera import bounding_sphere, fibonacci_direction, orthographic
from ...render.lighting import Lighting
from ...render.raster import visible
from ...render.shade import shade_source
from ...render.triangles import set_up
from ...scene.channels import BY_NAME
from ...scene.fetch import pack_source
from ..map_planes import map_names

if TYPE_CHECKING:
    from ...scene.scene import Scene

VIEWS, SIZE = 4, 256
NOISE = 6.0  # levels of 255
USUAL_GAIN = 0.34  # of base colour: squared error of the picture over that of the values; 0.16 to 0.47 on seven assets
LEAST, MOST = 0.01, 16.0  # weights: between them are 32 QP
ALONG = 2 / 3  # of the squared error of a deviation: the third along the normal is lost when its length is made 1
Weights = dict[str, float]


def table_weights() -> Weights:
    """Weights by channel name where nothing is measured."""
    return {name: channel.weight for name, channel in BY_NAME.items()}


def measured_weights(scene: Scene, threads: int) -> Weights:
    """Weights by channel name: how much more a squared error of its values shows than one of base colour usually does, for the
    channels that materials have maps of; those of the table for the rest. scene: with the materials that are coded."""
    weights, names = table_weights(), sorted(map_names(scene.materials))
    if not names:
        return weights
    opaque = replace(scene, materials=[replace(m, alpha_mode=0) for m in scene.materials])
    lighting, source, (centre, radius) = Lighting(opaque), pack_source(opaque), bounding_sphere(scene.positions)
    errors, pixels = dict.fromkeys(names, 0.0), 0
    for i in range(VIEWS):
        camera = orthographic(fibonacci_direction(i, VIEWS), centre, radius, SIZE)
        two_sided = np.array([m.double_sided for m in scene.materials], bool)[scene.face_material]
        fragments = visible(set_up(camera, scene.positions, scene.faces, True, two_sided), threads)
        if not len(fragments.face):
            continue
        rgba = shade_source(source, fragments, threads)
        clean = lighting.coded(camera, fragments, rgba, threads=threads)
        pixels += clean.size
        for name in names:
            off = lighting.coded(camera, fragments, rgba, threads=threads, noise=(name, NOISE)) - clean
            errors[name] += float((off.astype(np.float64) ** 2).sum())
    if not pixels:
        return weights
    for name in names:
        gain = errors[name] / pixels / (NOISE**2 / 3)
        weight = min(max(gain / USUAL_GAIN, LEAST), MOST)
        weights |= {name: weight} | ({f"{name}_object": ALONG * weight} if BY_NAME[name].over else {})
    return weights
