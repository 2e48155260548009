"""The images of a Scene as renderers sample them: bilinear, or between two mip levels if a pixel is wider than a texel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..core.threads import over_blocks
from ..scene.fetch import PackedSource, sample_source
from ..scene.srgb import linear_to_srgb, srgb_to_linear
from .field_sampler import mixed, texels_per_unit

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .camera import Camera
    from .raster import Fragments

BLOCK = 1 << 16  # fragments at a time


class Textures:
    """Samples of images of a Scene at fragments.

    The pixel's footprint on a face is its area there, as for fields over texels (field_sampler.py): a face at a slant samples
    no other level. A level's texels are means of 2 x 2 of the level below in linear light, rounded to 8 bits, as in graphics
    libraries.

    Parameters
    ----------
    scene : Scene
        The source.
    pack : function (Scene) -> PackedSource
        scene.fetch.pack_source, or pack_map of a channel.
    mips : MipScenes, optional
        Of the scene; None: its images alone.
    colour : bool
        Whether the images' first three columns are sRGB-coded.
    """

    def __init__(self, scene: Scene, pack: Callable[[Scene], PackedSource], mips: MipScenes | None = None,
                 colour: bool = True) -> None:
        self.scene, self.pack, self.mips, self.colour = scene, pack, mips, colour
        self.sources = {0: with_finite_uvs(pack(scene))}  # by level
        self._density = None if mips is None else self._texels_per_unit()

    def _texels_per_unit(self):
        source = self.sources[0]
        texture = source.material_texture[source.face_material]
        size = np.where(texture >= 0, 1, 0)[:, None] * source.textures[texture, 1:3]
        return texels_per_unit(self.scene.positions[self.scene.faces], source.corner_uv * size[:, None].astype(np.float64))

    def build(self, camera: Camera | None, deepest: float) -> None:
        """Build the mip levels that fragments need, before threads read them. deepest: their largest depth along the camera's
        forward."""
        if self.mips is None or self._density is None or camera is None:
            return
        widest = self._density.max(initial=0.0) * camera.pixel * (deepest if camera.perspective else 1.0)
        most = int(np.ceil(min(np.log2(max(widest, 1.0)), self.mips.last)))
        for number in range(1, most + 1):
            if number not in self.sources:  # threads that ask at once may make one twice, no more
                self.sources[number] = with_finite_uvs(self.pack(self.mips.level(number, self.colour)))

    def sample(self, camera: Camera | None, face: np.ndarray, bary: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Sample the images at points of faces: RGBA float32 [M, 4], 0..255. depth: of the points along the camera's forward, for
        the mip levels, which build() must have built."""
        if self.mips is None or self._density is None or camera is None:
            return sample_source(self.sources[0], face, bary)
        wide = self._density[face] * (camera.pixel * depth if camera.perspective else camera.pixel)
        if not np.any(wide > 1):
            return sample_source(self.sources[0], face, bary)
        fineness = np.minimum(np.log2(np.maximum(wide, 1)), self.mips.last)
        return mixed(lambda number, chosen: sample_source(self.sources[number], face[chosen], bary[chosen]), fineness)

    def colours(self, camera: Camera, fragments: Fragments, threads: int = 1) -> np.ndarray:
        """Sample the images at fragments: RGBA float32 [M, 4], 0..255."""
        self.build(camera, fragments.depth.max(initial=0.0))
        out = np.empty((len(fragments.face), 4), np.float32)

        def fill_block(begin):
            part = slice(begin, begin + BLOCK)
            out[part] = self.sample(camera, fragments.face[part], fragments.bary[part], fragments.depth[part])

        over_blocks(fill_block, len(out), BLOCK, threads)
        return out


class MipScenes:
    """A Scene with its images at 1 / 2**level of their size, for textures that share it; levels are built on first use."""

    def __init__(self, scene: Scene) -> None:
        self._scenes = {(0, True): scene, (0, False): scene}
        self.last = max((max(t.image.shape[:2]) for t in scene.textures), default=1).bit_length() - 1

    def level(self, number: int, colour: bool) -> Scene:
        """Return the Scene with its images at level `number`. colour: whether the images are sRGB-coded."""
        if (number, colour) not in self._scenes:
            finer = self.level(number - 1, colour)
            halves: dict[int, np.ndarray] = {}  # several textures may be one image
            for texture in finer.textures:
                if id(texture.image) not in halves:
                    halves[id(texture.image)] = halved(texture.image, colour)
            textures = [replace(texture, image=halves[id(texture.image)]) for texture in finer.textures]
            self._scenes[number, colour] = replace(finer, textures=textures)
        return self._scenes[number, colour]


def halved(image: np.ndarray, colour: bool) -> np.ndarray:
    """Return an image at half its size: means over the area of each texel.

    Parameters
    ----------
    image : uint8 [H, W, 4]
        Any size.
    colour : bool
        Average the first three columns in linear light.

    Returns
    -------
    uint8 [H', W', 4]
        Half the size, rounded down but at least 1.
    """
    values = image.astype(np.float32)
    if colour:
        values[..., :3] = (255 * srgb_to_linear(np.arange(256) / 255)).astype(np.float32)[image[..., :3]]
    values = _shrunk(_shrunk(values, 0), 1)
    if colour:
        values[..., :3] = 255 * linear_to_srgb(values[..., :3] / 255)
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)


def _shrunk(values, axis):
    """Half as many rows along an axis. If they are odd, each is the mean over three, weighted to keep its position."""
    count = values.shape[axis]
    if count == 1:
        return values
    half, rows = count // 2, np.moveaxis(values, axis, 0)
    if count % 2 == 0:
        return np.moveaxis((rows[::2] + rows[1::2]) / 2, 0, axis)
    i = np.arange(half, dtype=np.float32).reshape(-1, *(1,) * (rows.ndim - 1))
    taps = (half - i) * rows[0:-1:2] + half * rows[1::2] + (i + 1) * rows[2::2]
    return np.moveaxis(taps / count, 0, axis)


def with_finite_uvs(source: PackedSource) -> PackedSource:
    """Return a packed source with 0 for UVs that are not finite.

    Parameters
    ----------
    source : PackedSource
        Any.

    Returns
    -------
    PackedSource
        The same if all are finite.
    """
    if np.isfinite(source.corner_uv).all():
        return source
    return source._replace(corner_uv=np.nan_to_num(source.corner_uv, nan=0.0, posinf=0.0, neginf=0.0))
