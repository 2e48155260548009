"""How far the maps of whole materials are from the source's, and base colour with them: at surface points, channel by channel and
pooled into one figure.

A channel's error is the mean squared error of its values in 0..255. Normals are compared as what a viewer shades with: unit
vectors of object space, the vertex normal and the map together, 127.5 being 1; a rival's tangent space thereby stands on the same
ground as deviations over voxels. The pooled error is the mean over all components of all channels, each by its channel's weight
(channels.Channel.weight), at the points whose material has the map.
"""

from functools import partial

import numpy as np

from texfcodec.core.colour_error import decibels
from texfcodec.core.json_text import json_ready
from texfcodec.encoder.decide.materials import needed_scene
from texfcodec.encoder.decide.normal_rules import Shading
from texfcodec.encoder.shown_maps import Frames, ShownMaps
from texfcodec.geometry.areas import sample_surface
from texfcodec.geometry.surface import make_surface
from texfcodec.metrics.angular_error import angular_error
from texfcodec.metrics.face_match import FaceMatch
from texfcodec.options import FINEST_POSITIONS, EncodeOptions
from texfcodec.render.tangent_frames import deviated_normals, interpolate_corners
from texfcodec.scene.channels import BASE_COLOUR, BY_NAME, MAPS, channel_over
from texfcodec.scene.factors import FLAT
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.normal_rule import USUAL
from texfcodec.texf import Texf

BLOCK = 1 << 17  # points asked at a time


def needed_maps(scene):
    """(the Scene without maps that show nothing or one value alone, its Surface): what any way of coding it has to code."""
    options = EncodeOptions(position_bits=FINEST_POSITIONS)
    surface = make_surface(scene, options)
    return needed_scene(scene, surface, options.effects).value.scene, surface


class SceneMaps:
    """What a Scene says at places on its Surface. threads: for look-ups."""

    def __init__(self, scene, surface, threads=1):
        shading = Shading([USUAL] * len(scene.materials))
        self.threads, self._base = threads, pack_source(scene, surface.origin_face)
        rebuilt = partial(shading.corner_normals, surface)
        self._maps, self._frames = ShownMaps(scene, surface, rebuilt), Frames(scene, surface, rebuilt)

    def values(self, name, face, bary):
        """A channel, as materials name it, at faces int64 [M] that have it: float32 [M, C]."""
        if name == BASE_COLOUR.name:
            return sample_source(self._base, face, bary, self.threads)[:, :3]
        if BY_NAME[name].unit == "degrees":
            return self._frames.bent(name, face, bary, self.threads) * np.float32(FLAT)
        return self._maps(name, face, bary, self.threads)


class TexfMaps:
    """What a Texf, its fields over voxels, says at the same places of the Scene that it was made of. ValueError: a field is over
    texels."""

    def __init__(self, texf, scene, surface, threads=1):
        if any(field.over_texels for field in texf.fields):
            raise ValueError("errors of maps are measured over voxels alone")
        self.texf, self.surface = texf, surface
        self._match, self._field = FaceMatch(scene, texf, threads), texf.face_field
        self._normals = texf.shading_normals()
        corners = texf.positions[texf.faces]
        self._geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float32)

    def values(self, name, face, bary):
        """As SceneMaps.values()."""
        channel = channel_over(name, planar=False)
        out = np.zeros((len(face), channel.components), np.float32)
        places = self._match.find(self.surface.origin_face[face], bary)
        for number in range(len(self.texf.fields)):
            mine = np.flatnonzero(self._field[places.face] == number)
            if len(mine):
                out[mine] = self.texf.query_planes(number, [channel.name], places.points[mine], None)[channel.name]
        return self._with_normals(out, places) if channel.unit == "degrees" else out

    def _with_normals(self, deviation, places):
        """Normals in 0..255 of deviations at Places."""
        normal = interpolate_corners(self._normals, places.face, places.bary)
        return deviated_normals(deviation / np.float32(FLAT) - 1, normal, self._geometric[places.face]) * np.float32(FLAT)


def map_errors(scene, decoded, samples, threads=1):
    """{"pooled": dB, "plain": the same with weights of 1, "channels": {name: {"psnr": dB, "weight", and of normals
    "mean_degrees", "p95_degrees"}}, "samples"} of what was decoded of a Scene, a Texf or a Scene with the same faces. None: no
    error at all."""
    scene, surface = needed_maps(scene)
    source = SceneMaps(scene, surface, threads)
    if isinstance(decoded, Texf):
        other = TexfMaps(decoded, scene, surface, threads)
    else:
        other = SceneMaps(decoded, surface, threads)
    places = sample_surface(surface.lattice.astype(np.float64), surface.faces, samples, 0)
    found, pooled, plain = {}, np.zeros(2), np.zeros(2)
    for name in [BASE_COLOUR.name, *(c.name for c in MAPS)]:
        mapped = np.array([name == BASE_COLOUR.name or name in m.maps for m in scene.materials], bool)
        mine = np.flatnonzero(mapped[surface.material[places[0]]])
        if not len(mine):
            continue
        want, got = (np.concatenate(parts) for parts in zip(*_asked(name, source, other, places, mine), strict=True))
        error, weight = (got.astype(np.float64) - want) ** 2, channel_over(name, planar=False).weight
        plain += (error.sum(), error.size)
        pooled += (weight * error.sum(), weight * error.size)
        found[name] = json_ready({"psnr": decibels(float(error.mean())), "weight": weight})
        if BY_NAME[name].unit == "degrees":
            found[name] |= _angles(want, got)
    told = json_ready({"pooled": decibels(pooled[0] / pooled[1]), "plain": decibels(plain[0] / plain[1])})
    return told | {"channels": found, "samples": samples}


def _asked(name, source, other, places, mine):
    """Pairs of what both sides say of a channel, block by block."""
    for begin in range(0, len(mine), BLOCK):
        rows = mine[begin : begin + BLOCK]
        yield tuple(side.values(name, places[0][rows], places[1][rows]) for side in (source, other))


def _angles(want, got):
    angles = angular_error(want, got)
    return {"mean_degrees": angles["mean_degrees"], "p95_degrees": angles["p95_degrees"]}
