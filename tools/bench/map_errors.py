"""How far the maps of whole materials are from the source's, and base colour with them: at surface points, channel by channel and
pooled into one figure.

A channel's error is the mean squared error of its values in 0..255, factors included. Normals are compared as what a viewer
shades with: unit vectors of object space, the vertex normal and the map together, 127.5 being 1; a rival's tangent space thereby
stands on the same ground as deviations over voxels. The pooled error is the mean over all components of all channels, each by its
channel's weight (channels.Channel.weight), at the points whose material has the map. """

import numpy as np

from texfcodec.core.colour_error import decibels
from texfcodec.core.json_text import json_ready
from texfcodec.encoder.prepare.materials import needed_scene
from texfcodec.geometry.surface import make_surface
from texfcodec.metrics.angular_error import angular_error
from texfcodec.metrics.shaded import BLOCK, Points, normals_at
from texfcodec.options import FINEST_POSITIONS, EncodeOptions
from texfcodec.render.lighting import Lighting
from texfcodec.scene.channels import BASE_COLOUR, BY_NAME, MAPS, channel_over
from texfcodec.scene.srgb import linear_to_srgb

UNIT = 127.5  # of a normal's component


def needed_maps(scene):
    """Return a Scene without the maps that show nothing or a single value, which no method needs to code."""
    options = EncodeOptions(position_bits=FINEST_POSITIONS)
    return needed_scene(scene, make_surface(scene, options), options.effects).value.scene


def map_errors(scene, decoded, samples, threads=1):
    """Return the errors of decoded maps: {"pooled": dB, "plain": dB with weights of 1, "channels": {name: {"psnr", "weight", and
    of normals "mean_degrees", "p95_degrees"}}, "samples"}. decoded: a Texf or a Scene with the same faces; samples: surface
    points. dB of None: no error."""
    scene = needed_maps(scene)
    points, lights = Points(scene, decoded, samples, threads), (Lighting(scene), Lighting(decoded))
    channels, pooled, plain = {}, np.zeros(2), np.zeros(2)
    for name in [BASE_COLOUR.name, *(c.name for c in MAPS)]:
        mapped = np.array([name == BASE_COLOUR.name or name in m.maps for m in scene.materials], bool)
        rows = np.flatnonzero(mapped[points.material])
        if not len(rows):
            continue
        want, got = (values_of(points, lights, side, name, rows) for side in (0, 1))
        error, weight = (got.astype(np.float64) - want) ** 2, channel_over(name, planar=False).weight
        plain += (error.sum(), error.size)
        pooled += (weight * error.sum(), weight * error.size)
        channels[name] = json_ready({"psnr": decibels(float(error.mean())), "weight": weight})
        if BY_NAME[name].unit == "degrees":
            angles = angular_error(want, got)
            channels[name] |= {key: angles[key] for key in ("mean_degrees", "p95_degrees")}
    both = json_ready({"pooled": decibels(pooled[0] / pooled[1]), "plain": decibels(plain[0] / plain[1])})
    return both | {"channels": channels, "samples": samples}


def values_of(points, lights, side, name, rows):
    """Return a channel's values at rows of Points, float [M, C] in 0..255. side: 0 for the source, 1 for the decoded."""
    if name == BASE_COLOUR.name:
        return points.rgba[side][rows, :3]
    if BY_NAME[name].unit == "degrees":
        return normals_at(points, lights, side, name, rows)[1] * UNIT
    face, bary = points.at[side]
    parts = (rows[begin : begin + BLOCK] for begin in range(0, len(rows), BLOCK))
    values = np.concatenate([lights[side].finals([name], face[part], bary[part])[name] for part in parts])
    return 255 * (linear_to_srgb(values) if BY_NAME[name].srgb else values)
