"""Pictures: fragments get their colours from the source's textures or from decoded fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..core.kernel import kernel
from ..core.threads import over_blocks
from ..scene.fetch import PackedSource, pack_source, sample_source
from .backdrop import Background, rows
from .depth_layers import composite, opacity, see_through
from .environment import Environment
from .field_sampler import FieldSampler
from .lighting import Lighting
from .raster import Fragments, visible
from .textures import Textures, with_finite_uvs
from .triangles import set_up

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from ..texf import Texf
    from .camera import Camera

BLOCK = 1 << 16  # fragments shaded at a time


def box_down(image: np.ndarray, times: int) -> np.ndarray:
    """Return the picture at 1 / times of its size: each pixel is the rounded mean of times x times coded values.

    Parameters
    ----------
    image : uint8 [H, W, 3]
        The picture.
    times : int
        Divisor.

    Returns
    -------
    uint8 [H // times, W // times, 3]
        The small picture.
    """
    height, width = image.shape[0] // times, image.shape[1] // times
    blocks = image[: height * times, : width * times].reshape(height, times, width, times, 3)
    return ((blocks.sum(axis=(1, 3), dtype=np.uint32) + times * times // 2) // (times * times)).astype(np.uint8)


@dataclass
class Picture:
    """A camera's picture, before rounding and without a background.

    Attributes
    ----------
    width, height : int
        Pixels.
    pixel : int64 [M]
        Covered pixels, row * width + column, ascending.
    colour : float32 [M, 3]
        RGB, 0..255, sRGB-coded, straight.
    alpha : float32 [M]
        0..1, below 1 only if no opaque surface is behind the transparent ones.
    """

    width: int
    height: int
    pixel: np.ndarray
    colour: np.ndarray
    alpha: np.ndarray

    def image(self, background: Background = (255, 255, 255)) -> np.ndarray:
        """Return the picture over a background, as 8-bit pixels.

        Parameters
        ----------
        background : background
            One colour, or those of the top and of the bottom row.

        Returns
        -------
        uint8 [height, width, 3]
            NaN becomes 0.
        """
        out = np.empty((self.height, self.width, 3), np.uint8)
        out[:] = rows(background, self.height)
        _paint(self.pixel, self.colour, self.alpha, out.reshape(-1, 3))
        return out


def render_scene(scene: Scene, camera: Camera, cull: bool = True, threads: int = 1, source: PackedSource | Textures | None = None,
                 shaded: Lighting | Environment | None = None) -> Picture:
    """Draw a Scene with its own textures (bilinear, as glTF defines them).

    Parameters
    ----------
    scene : Scene
        The source.
    camera : Camera
        The camera.
    cull : bool
        Leave out back faces of materials that are not double-sided.
    threads : int
        Most threads.
    source : PackedSource or Textures, optional
        pack_source(scene), or Textures of it, which may have mip levels, to use again for other views.
    shaded : Environment or Lighting, optional
        The light, or the scene's Lighting to use again; None: the base colour as it is.

    Returns
    -------
    Picture
        Alpha is as in depth_layers.composite(). A scene without visible faces gives an empty Picture.
    """
    return render_lights(scene, camera, [_lighting(scene, shaded)], cull, threads, source)[0]


def render_lights(scene: Scene, camera: Camera, lights: Sequence[Lighting | None], cull: bool = True, threads: int = 1,
                  source: PackedSource | Textures | None = None) -> list[Picture]:
    """Draw a Scene in several lights from the same camera. If all is opaque, visibility and base colour are computed once.

    Parameters
    ----------
    lights : sequence of Lighting or None
        Of the scene; None: the base colour as it is.
    scene, camera, cull, threads, source
        As of render_scene().

    Returns
    -------
    list of Picture
        One for each light.
    """
    source = pack_source(scene) if source is None else source
    triangles = set_up(camera, scene.positions, scene.faces, cull, _two_sided(scene.materials, scene.face_material))

    def shade(fragments):
        if isinstance(source, Textures):
            return source.colours(camera, fragments, threads)
        return shade_source(source, fragments, threads)

    return _render(triangles, scene.materials, scene.face_material, threads, shade, lights)


def colour_fragments(camera: Camera, fragments: Fragments, lights: Sequence[Lighting | None],
                     source: PackedSource) -> list[Picture]:
    """Draw some fragments of an opaque Scene in several lights.

    Parameters
    ----------
    camera : Camera
        As for the fragments.
    fragments : Fragments
        All visible points, or some; the pictures show no others.
    lights, source
        As of render_lights().

    Returns
    -------
    list of Picture
        One for each light.
    """
    return _coloured(camera, fragments, partial(shade_source, source), lights)


def render_texf(texf: Texf, camera: Camera, cull: bool = True, filtering: bool = True, threads: int = 1,
                shaded: Lighting | Environment | None = None) -> Picture:
    """Draw a decoded Texf.

    Parameters
    ----------
    texf : Texf
        A decoded stream.
    camera, cull, threads, shaded
        As of render_scene().
    filtering : bool
        As of shade_field().

    Returns
    -------
    Picture
        Empty for a Texf without fields, which has no colour.
    """
    if not texf.fields:
        return Picture(camera.width, camera.height, np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    positions, faces, face_material, light = texf.positions, texf.faces, texf.face_material, _lighting(texf, shaded)
    triangles = set_up(camera, positions, faces, cull, _two_sided(texf.materials, face_material))

    def shade(fragments):
        return shade_field(texf, camera, fragments, positions, faces, filtering, threads)

    return _render(triangles, texf.materials, face_material, threads, shade, [light], filtering)[0]


def _lighting(asset, shaded):
    return Lighting(asset, shaded) if isinstance(shaded, Environment) else shaded


def _in_light(light, camera, fragments, rgba, filtering, threads):
    """Colours float32 [M, 3]: the base colour without a light, else the lit colour."""
    return rgba[:, :3] if light is None else light.coded(camera, fragments, rgba, filtering, threads)


def shade_source(source: PackedSource, fragments: Fragments, threads: int = 1) -> np.ndarray:
    """Return the base colour of a source Scene at fragments, without light.

    Parameters
    ----------
    source : PackedSource
        Of pack_source(). UVs that are not finite are read as 0.
    fragments : Fragments
        M visible points.
    threads : int
        Most threads.

    Returns
    -------
    float32 [M, 4]
        RGBA, 0..255.
    """
    return sample_source(with_finite_uvs(source), fragments.face, fragments.bary, threads)


def shade_field(texf: Texf, camera: Camera, fragments: Fragments, positions: np.ndarray, faces: np.ndarray,
                filtering: bool = True, threads: int = 1) -> np.ndarray:
    """Return the base colour of a decoded Texf at fragments, without light, each from the field of its face.

    Parameters
    ----------
    texf : Texf
        A decoded stream.
    camera : Camera
        The camera.
    fragments : Fragments
        M visible points.
    positions : float64 [V, 3]
        World.
    faces : int64 [F, 3]
        texf's own, or others for the same faces in the same order.
    filtering : bool
        If a pixel is wider than a voxel, mix the two levels of the field nearest to the pixel's width. Where two surfaces are
        closer than a coarse voxel this mixes them, as lower levels of detail do.
    threads : int
        Most threads.

    Returns
    -------
    float32 [M, 4]
        RGBA, 0..255; without filtering, and for narrower pixels, exactly those of Texf.query at the fragments' points.

    Raises
    ------
    IndexError
        A face index is outside the mesh.
    """
    out = np.zeros((len(fragments.face), 4), np.float32)
    if len(fragments.face) and (fragments.face.min() < 0 or fragments.face.max() >= len(faces)):
        raise IndexError("face index outside the mesh")
    which = texf.face_field[fragments.face] if len(texf.fields) > 1 else None
    sampler = FieldSampler(texf, camera, fragments.depth.max(initial=0.0) if filtering else None, positions, faces)
    for number in range(len(texf.fields)):
        chosen = np.arange(0) if which is None else np.flatnonzero(which == number)
        sample = sampler.of_field(number)

        def shade_block(begin, chosen=chosen, sample=sample):
            place = slice(begin, begin + BLOCK) if which is None else chosen[begin : begin + BLOCK]
            out[place] = sample(fragments.face[place], fragments.bary[place], fragments.depth[place])

        over_blocks(shade_block, len(out) if which is None else len(chosen), BLOCK, threads)
    return out


def _coloured(camera, fragments, shade, lights, filtering=True, threads=1):
    """Pictures of opaque fragments, one for each light; the arguments are as of _render()."""
    rgba, alpha = shade(fragments), np.ones(len(fragments.pixel), np.float32)
    colours = [_in_light(light, camera, fragments, rgba, filtering, threads) for light in lights]
    return [Picture(camera.width, camera.height, fragments.pixel, colour, alpha) for colour in colours]


def _render(triangles, materials, face_material, threads, shade, lights, filtering=True):
    """Pictures of triangles, one for each light; a single pass if every face is opaque. shade: Fragments -> float32 [M, 4], base
    colour and alpha."""
    camera = triangles.camera
    width, height = camera.width, camera.height
    if not see_through(materials, face_material):
        return _coloured(camera, visible(triangles, threads), shade, lights, filtering, threads)

    def layer(fragments, light):
        rgba = shade(fragments)
        colour = _in_light(light, camera, fragments, rgba, filtering, threads)
        return colour, opacity(materials, face_material[fragments.face], rgba[:, 3])

    return [Picture(width, height, *composite(triangles, partial(layer, light=light), threads)) for light in lights]


def _two_sided(materials, face_material):
    return np.array([m.double_sided for m in materials], np.bool_)[face_material]


@kernel
def _paint(pixel, colour, alpha, image):
    """Writes colours over the background in image, uint8 [height * width, 3]; pixels outside it are skipped."""
    for i in range(pixel.shape[0]):
        p = pixel[i]
        if p < 0 or p >= image.shape[0]:
            continue
        for c in range(3):
            value = colour[i, c] * alpha[i] + image[p, c] * (np.float32(1) - alpha[i])
            image[p, c] = np.uint8(np.rint(min(max(value, 0.0), 255.0))) if value == value else 0
