"""Material maps of fields over voxels in the atlas: fitted as its colours are, normals turned into the atlas's tangent space."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...geometry.tangents import corner_tangents
from ...scene.channels import BY_NAME, channel_over
from ...scene.factors import FLAT
from .gaps import fill_gaps
from .sheets import sheet_colours

if TYPE_CHECKING:
    from ...texf import Texf
    from .bake import Baked


class AtlasMaps:
    """texf: decoded stream (Texf); faces: int64 [n], those of the atlas; baked: their Baked; normal: float32 [n, 3, 3], shading
    normals of their corners, None where no normal map is asked for."""

    def __init__(self, texf: Texf, faces: np.ndarray, baked: Baked, normal: np.ndarray | None) -> None:
        self.texf, self.faces, self.system, self.atlas, self.normal = texf, faces, baked.system, baked.atlas, normal
        self._corners = texf.positions[texf.faces[faces]]
        self._which = texf.face_field[faces]
        self._tangent: np.ndarray | None = None
        if normal is not None:
            self._tangent = corner_tangents(texf.positions, texf.faces[faces], baked.atlas.corner_uv, normal)

    def image(self, sheet: tuple[str, ...]) -> np.ndarray:
        """The image of a sheet: uint8 [H, W, 3], or [H, W, 4] where a channel is in alpha."""
        values = {}
        for name in sheet:
            channel = channel_over(name, planar=True)
            ask = self._ask_normal(name) if channel.unit == "degrees" else self._ask(name)
            values[name] = self.system.fitted(ask, channel.components, threads=self.texf.threads)
        image = np.zeros((self.atlas.height, self.atlas.width, 4), np.uint8)
        image[self.system.covered] = sheet_colours(values)
        image = image if any(3 in BY_NAME[name].columns for name in sheet) else np.ascontiguousarray(image[..., :3])
        fill_gaps(image, self.system.covered)
        return image

    def _ask(self, name):
        """Function (points float64 [M, 3], face int64 [M] of the atlas) -> values [M, C]; 255 where a field lacks the channel."""
        channel = channel_over(name, planar=False)

        def ask(points, face):
            out = np.full((len(points), channel.components), 255, np.float32)
            for number in np.unique(self._which[face]).tolist():
                chosen = np.flatnonzero(self._which[face] == number)
                if channel.name in self.texf.fields[number].planes:
                    asked = self.faces[face[chosen]]
                    out[chosen] = self.texf.query_planes(number, (channel.name,), points[chosen], asked)[channel.name]
            return out

        return ask

    def _ask_normal(self, name):
        """As _ask, x and y of the normals in the atlas's tangent space, float32 [M, 2] in 0..255."""
        ask, normals, tangents = self._ask(name), self.normal, self._tangent
        assert normals is not None and tangents is not None, "a normal map needs the normals of its corners"

        def ask_normal(points, face):
            weights = self._weights(points, face)
            normal, tangent = (np.einsum("mk,mkc->mc", weights, corner[face]) for corner in (normals, tangents))
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            bent = normal + (ask(points, face) / FLAT - 1)
            bent /= np.maximum(np.linalg.norm(bent, axis=1, keepdims=True), 1e-12)
            along = tangent[:, :3] / np.maximum(np.linalg.norm(tangent[:, :3], axis=1, keepdims=True), 1e-12)
            across = np.cross(normal, along) * np.where(tangent[:, 3:] < 0, -1.0, 1.0)
            xy = np.column_stack([(bent * along).sum(axis=1), (bent * across).sum(axis=1)])
            return ((xy + 1) * FLAT).astype(np.float32)

        return ask_normal

    def _weights(self, points, face):
        """Barycentric coordinates of points on their faces, float64 [M, 3]; thirds on a face without area."""
        a, b, c = (self._corners[face, k] for k in range(3))
        u, v, w = b - a, c - a, points - a
        uu, uv, vv, wu, wv = ((p * q).sum(axis=1) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
        area = uu * vv - uv * uv
        with np.errstate(all="ignore"):
            second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
        out = np.column_stack([1 - second - third, second, third])
        return np.clip(np.where(np.isfinite(out).all(axis=1, keepdims=True), out, 1 / 3), 0, 1)
