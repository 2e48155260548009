"""The shaded pictures of one Scene against those of many variants: as metrics.views.compare_views, with which a test compares
it, but the Scene's own are drawn once."""

from dataclasses import replace

import numpy as np

from texfcodec.core.colour_error import ColourError, decibels
from texfcodec.core.json_text import json_ready
from texfcodec.metrics.views import Look
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.environment import DAYLIGHT
from texfcodec.render.lighting import Lighting
from texfcodec.render.shade import render_scene, render_texf
from texfcodec.texf import Texf

LIGHT = Look(environment=DAYLIGHT)


class LitViews:
    """The views of a Scene in daylight. views, size: their number and pixels a side."""

    def __init__(self, scene, views, size, threads=1):
        self._threads, draw = threads, _drawer(scene, threads)
        centre, radius = bounding_sphere(scene.positions)
        self._seen = []
        for i in range(views):
            camera = orthographic(fibonacci_direction(i, views), centre, radius, size)
            picture = draw(camera)
            covered = np.zeros(size * size, bool)
            covered[picture.pixel] = True
            self._seen.append((camera, covered, picture.image().reshape(-1, 3)))

    def psnr(self, other):
        """{"psnr", "psnr_y"}: of RGB and Y of a Scene or Texf in dB, over all pixels that both cover; None where exact."""
        draw, error = _drawer(other, self._threads), ColourError()
        for camera, covered, image in self._seen:
            picture = draw(camera)
            pixel = picture.pixel[covered[picture.pixel]]
            error.add(image[pixel], picture.image().reshape(-1, 3)[pixel])
        mse = error.mse()
        return json_ready({"psnr": decibels(mse["rgb"]), "psnr_y": decibels(mse["y"])})


def _drawer(side, threads):
    """Function Camera -> Picture of a Scene or Texf, every back face culled."""
    side = replace(side, materials=[replace(m, double_sided=False) for m in side.materials])
    light = Lighting(side, LIGHT.environment, LIGHT.mipmaps)
    if isinstance(side, Texf):
        return lambda camera: render_texf(side, camera, filtering=LIGHT.mipmaps, threads=threads, shaded=light)
    return lambda camera: render_scene(side, camera, threads=threads, shaded=light)
