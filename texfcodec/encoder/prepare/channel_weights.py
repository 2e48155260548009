"""Weights of the channels of an asset: the effect of an error in each channel on the shaded picture, measured on a few small
pictures, so that bytes go to visible errors (encoder only)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...render.camera import bounding_sphere, fibonacci_direction, orthographic
from ...render.lighting import Lighting
from ...render.raster import visible
from ...render.shade import shade_source
from ...render.triangles import set_up
from ...scene.channels import BASE_COLOUR, BY_NAME
from ...scene.factors import FLAT
from ...scene.fetch import pack_source
from ..values.map_planes import map_names

if TYPE_CHECKING:
    from ...scene.scene import Scene

VIEWS, SIZES = 4, {"fast": 96, "balanced": 256}  # sides of the pictures by effort
NOISE = 6.0  # levels of 255; 1.5 and 3 give the same weights but for the helmet's normals, 10.0 at 6 and 11.7 at 1.5
USUAL_GAIN = 0.34  # of base colour: squared error of the picture over that of the values; 0.03 to 0.49 on seven assets
LEAST, MOST = 0.01, 16.0  # weights: between them are 32 QP
LEAST_BASE, MOST_BASE = 0.4, 2.0  # of base colour, which is looked at without light too
SHADING, TURNED = "shading", 0.02  # what stands among the weights for shading normals; radians
ALONG = 2 / 3  # of the squared error of a deviation: the third along the normal is lost when its length is made 1
# What coding leaves is no noise from point to point. Fine steps, of normals over texels, leave errors that differ from texel to
# texel and are halved between them; coarse steps, of scalars, leave smooth ones that are not. With both, and base
# colour's own weight, 3 to 6 % fewer bytes at equal pictures in light (cat, avocado, snapper, a controller; 0.6 and 2: 1 to 7 %).
FINE, COARSE = 0.8, 1.6
Weights = dict[str, float]


def table_weights() -> Weights:
    """Return the default weights by channel name, for assets that are not measured."""
    return {name: channel.weight for name, channel in BY_NAME.items()}


def shown_of_radians(weights: Weights) -> float:
    """Return the squared error of a shaded picture, in squared levels, for each squared radian that shading normals are off.
    weights: of measured_weights() or the table."""
    return weights.get(SHADING, USUAL_GAIN * BY_NAME["normal"].weight * FLAT**2 / 2)


def measured_weights(scene: Scene, is_free: bool, size: int, threads: int) -> Weights:
    """Return weights by channel name, measured on small lit pictures of a scene: how much more a squared error of a channel's
    values shows than that of base colour usually does. They are measured for base colour, if the encoder may choose the quality
    (is_free), and for the channels that materials have maps of; the other weights are those of the table. The entry SHADING is
    as shown_of_radians() returns it. scene: with the materials that are coded; size: of the pictures, of SIZES."""
    weights, names = table_weights(), sorted(map_names(scene.materials))
    is_lit = scene.corner_normal is not None and not all(material.unlit for material in scene.materials)
    gains = _gains(scene, names, is_lit, size, threads) if names or is_lit else {}
    weights |= {SHADING: gains.pop(SHADING)} if SHADING in gains else {}
    for name, gain in gains.items():
        channel, weight = BY_NAME[name], gain / USUAL_GAIN
        if channel is BASE_COLOUR:
            weights[name] = min(max(weight, LEAST_BASE), MOST_BASE) if is_free else channel.weight
        elif channel.over:
            weight = min(max(weight, LEAST), MOST)
            weights |= {name: max(FINE * weight, LEAST), f"{name}_object": ALONG * weight}
        else:
            weights[name] = min(max(weight * (1.0 if channel.srgb else COARSE), LEAST), MOST)
    return weights


def _gains(scene, names, is_lit, size, threads):
    """Return {name: squared error of shaded pictures over that of the values} of channels, of base colour if there are any
    channels, and of SHADING if the scene is lit; {} if nothing is visible."""
    opaque = replace(scene, materials=[replace(m, alpha_mode=0) for m in scene.materials])
    lighting, source, (centre, radius) = Lighting(opaque), pack_source(opaque), bounding_sphere(scene.positions)
    names = [*([BASE_COLOUR.name] if names else []), *names, *([SHADING] if is_lit else [])]
    turned = Lighting(_with_turned_normals(opaque)) if is_lit else lighting
    errors, pixels = dict.fromkeys(names, 0.0), 0
    for i in range(VIEWS):
        camera = orthographic(fibonacci_direction(i, VIEWS), centre, radius, size)
        two_sided = np.array([m.double_sided for m in scene.materials], bool)[scene.face_material]
        fragments = visible(set_up(camera, scene.positions, scene.faces, True, two_sided), threads)
        if not len(fragments.face):
            continue
        rgba = shade_source(source, fragments, threads)
        clean = lighting.coded(camera, fragments, rgba, threads=threads)
        pixels += clean.size
        for name in names:
            if name == SHADING:
                off = turned.coded(camera, fragments, rgba, threads=threads) - clean
            elif name == BASE_COLOUR.name:
                off = lighting.coded(camera, fragments, _greyer(rgba, i), threads=threads) - clean
            else:
                off = lighting.coded(camera, fragments, rgba, threads=threads, noise=(name, NOISE)) - clean
            errors[name] += float((off.astype(np.float64) ** 2).sum())
    squares = {SHADING: 2 * TURNED**2}  # of what was done to values, or to directions; else of NOISE
    gains = {name: errors[name] / pixels / squares.get(name, NOISE**2 / 3) for name in names} if pixels else {}
    return {name: gain for name, gain in gains.items() if np.isfinite(gain)}  # light can make a colour infinite


def _with_turned_normals(scene):
    """Return the scene with wrong shading normals, by TURNED radians in each of two directions."""
    off = np.random.default_rng(0).normal(0, TURNED, scene.corner_normal.shape).astype(np.float32)
    normal = scene.corner_normal + off
    return replace(scene, corner_normal=normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), np.float32(1e-12)))


def _greyer(rgba, seed):
    """Return colours float32 [M, 4], made lighter or darker by noise: most of the error of coding is luma."""
    off = np.random.default_rng(seed).uniform(-NOISE, NOISE, (len(rgba), 1)).astype(np.float32)
    return np.column_stack([np.clip(rgba[:, :3] + off, 0, 255), rgba[:, 3]])
