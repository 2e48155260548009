"""Material maps of fields over voxels in the atlas: fitted like its colours, with normals in the atlas's tangent space."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.kernel import kernel
from ...field.on_face import corner_weights
from ...geometry.tangents import corner_tangents
from ...scene.channels import BY_NAME, channel_over
from ...scene.factors import FLAT
from .fill_uncovered import fill_uncovered
from .packed_images import packed_texels

if TYPE_CHECKING:
    from ...texf import Texf
    from .bake import Baked


class AtlasMaps:
    """Makes the images of an atlas beside base colour: maps such as normals or roughness. texf: decoded stream (Texf); faces:
    int64 [n], those of the atlas; baked: their Baked; normal: float32 [n, 3, 3], shading normals of their corners, or None if no
    packed image has a normal map."""

    def __init__(self, texf: Texf, faces: np.ndarray, baked: Baked, normal: np.ndarray | None) -> None:
        self.texf, self.faces, self.system, self.atlas, self.normal = texf, faces, baked.system, baked.atlas, normal
        self._corners = texf.positions[texf.faces[faces]]
        self._which = texf.face_field[faces]
        self._tangent: np.ndarray | None = None
        if normal is not None:
            self._tangent = corner_tangents(texf.positions, texf.faces[faces], baked.atlas.corner_uv, normal)

    def image(self, packed: tuple[str, ...]) -> np.ndarray:
        """Return the atlas image of the channels that share it, uint8 [H, W, 3], or [H, W, 4] if one is in alpha. packed: an
        entry of packed_images_of()."""
        counts = [channel_over(name, planar=True).components for name in packed]
        fitted = self.system.fitted(self._function(packed), sum(counts), threads=self.texf.threads)
        values = dict(zip(packed, np.split(fitted, np.cumsum(counts)[:-1], axis=1), strict=True))
        image = np.zeros((self.atlas.height, self.atlas.width, 4), np.uint8)
        image[self.system.covered] = packed_texels(values)
        image = image if any(3 in BY_NAME[name].columns for name in packed) else np.ascontiguousarray(image[..., :3])
        fill_uncovered(image, self.system.covered)
        return image

    def _function(self, packed):
        """Function (points float64 [M, 3], face int64 [M] of the atlas) -> values of the channels of an image [M, C]."""
        channels = [channel_over(name, planar=False) for name in packed]

        def sample(points, face):
            values = self._values(channels, points, face)
            for number, name in enumerate(packed):
                if channel_over(name, planar=True).unit == "degrees":
                    values[number] = self._turned(points, face, values[number])
            return values[0] if len(values) == 1 else np.concatenate(values, axis=1)

        return sample

    def _values(self, channels, points, face):
        """Values of channels, a list of float32 [M, C]; 255 if a field lacks the channel."""
        out = [np.full((len(points), channel.components), 255, np.float32) for channel in channels]
        which = self._which[face]
        for number in np.flatnonzero(np.bincount(which)).tolist():
            names = [channel.name for channel in channels if channel.name in self.texf.fields[number].planes]
            if names:
                chosen = np.flatnonzero(which == number)
                answers = self.texf.query_planes(number, names, points[chosen], self.faces[face[chosen]])
                for channel, values in zip(channels, out, strict=True):
                    if channel.name in answers:
                        values[chosen] = answers[channel.name]
        return out

    def _turned(self, points, face, offsets):
        """x and y of normals in the atlas's tangent space, float32 [M, 2] in 0..255. offsets: values of the channel."""
        normals, tangents, xy = self.normal, self._tangent, np.empty((len(points), 2), np.float32)
        assert normals is not None and tangents is not None, "a normal map needs the normals of its corners"
        _in_tangent_space(points, face, self._corners, normals, tangents, offsets, xy)
        return xy


@kernel
def _normalise(vector):
    """Scale a vector float64 [3] to length 1, in place, unless it is shorter than 1e-12."""
    over = 1 / max(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]), 1e-12)
    for k in range(3):
        vector[k] *= over


@kernel(allocates=True)
def _in_tangent_space(points, face, corners, normals, tangents, offsets, xy):
    """Write x and y of normals in the atlas's tangent space to xy, float32 [M, 2] in 0..255.

    points: float64 [M, 3]; face: int64 [M]; corners: float64 [F, 3, 3]; normals: float [F, 3, 3]; tangents: float [F, 3, 4];
    offsets: float32 [M, 3] in 0..255, differences of the normals from the interpolated normals."""
    weight, bent, tangent, normal = np.zeros(3), np.empty(3), np.empty(4), np.empty(3)
    for m in range(points.shape[0]):
        f = face[m]
        corner_weights(points[m, 0], points[m, 1], points[m, 2], corners[f], weight)
        for k in range(4):
            tangent[k] = weight[0] * tangents[f, 0, k] + weight[1] * tangents[f, 1, k] + weight[2] * tangents[f, 2, k]
        for k in range(3):
            normal[k] = weight[0] * normals[f, 0, k] + weight[1] * normals[f, 1, k] + weight[2] * normals[f, 2, k]
        _normalise(normal)
        _normalise(tangent)
        for k in range(3):
            bent[k] = normal[k] + (offsets[m, k] / FLAT - 1)
        _normalise(bent)
        along = across = 0.0
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            along += bent[k] * tangent[k]
            across += bent[k] * (normal[i] * tangent[j] - normal[j] * tangent[i])
        xy[m, 0], xy[m, 1] = (along + 1) * FLAT, ((-across if tangent[3] < 0 else across) + 1) * FLAT
