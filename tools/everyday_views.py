"""The metric's views of many variants of one mesh: what depends on the geometry alone is done once.

As quality.views.compare_views, with which a test compares it: the variants share positions and faces, so that each view of them
is rasterised once, and only shaded for a variant.
"""

from dataclasses import replace

import numpy as np

from texfcodec.asset.sample import pack_source
from texfcodec.ground.colour_error import RGB_TO_YUV, decibels
from texfcodec.quality.views import VIEWS
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.layers import see_through
from texfcodec.render.raster import Fragments, rasterise
from texfcodec.render.shade import render_scene, shade_source
from tools.everyday_points import SIZE, rounded


class MetricViews:
    """The views of a source Scene and what they show of variants of another: psnr(variant).

    placed: Scene with the positions, faces and materials that all variants have. Where a material can be seen through, what is in
    front depends on the images, and every variant is rendered anew.
    """

    def __init__(self, source, placed, threads=1, views=VIEWS, size=SIZE):
        self._threads = threads
        self._peeled = see_through(placed.materials, placed.face_material)
        centre, radius = bounding_sphere(source.positions)
        source, packed = _one_sided(source), pack_source(source)
        self._views = []
        for i in range(views):
            camera = orthographic(fibonacci_direction(i, views), centre, radius, size)
            picture = render_scene(source, camera, source=packed, threads=threads)
            colours = picture.image().reshape(-1, 3)
            if self._peeled:
                self._views.append((camera, picture.pixel, colours[picture.pixel]))
                continue
            fragments = rasterise(camera, placed.positions, placed.faces, threads=threads)
            common = np.isin(fragments.pixel, picture.pixel, assume_unique=True)
            fragments = Fragments(*(getattr(fragments, name)[common] for name in ("pixel", "face", "bary", "depth")), size, size)
            self._views.append((camera, fragments, colours[fragments.pixel]))

    def psnr(self, variant):
        """{"y", "rgb", "yuv"} in dB of a variant against the source, pooled over all pixels that both cover, to three digits."""
        variant, squares, pixels = _one_sided(variant), np.zeros((3, 3)), 0
        packed = pack_source(variant)
        for camera, covered, colours in self._views:
            look = self._rendered if self._peeled else self._shaded
            difference = look(variant, packed, camera, covered, colours)
            squares += difference.T @ difference
            pixels += len(difference)
        if not pixels:
            raise SystemExit("no pixel of any view is covered by both sides")
        y, u, v = np.einsum("ij,jk,ik->i", RGB_TO_YUV, squares, RGB_TO_YUV) / pixels
        errors = {"y": y, "rgb": np.trace(squares) / 3 / pixels, "yuv": (6 * y + u + v) / 8}
        return rounded({name: decibels(max(float(error), 0.0)) for name, error in errors.items()})

    def _shaded(self, variant, packed, camera, fragments, colours):
        """Differences float64 [M, 3] of the 8-bit colours at the fragments."""
        return _rounded(shade_source(packed, fragments, self._threads)[:, :3]) - colours

    def _rendered(self, variant, packed, camera, pixel, colours):
        """As _shaded, over the pixels that a rendering covers as well."""
        picture = render_scene(variant, camera, source=packed, threads=self._threads)
        common, ours, _ = np.intersect1d(pixel, picture.pixel, assume_unique=True, return_indices=True)
        return picture.image().reshape(-1, 3)[common].astype(np.float64) - colours[ours]


def _one_sided(scene):
    return replace(scene, materials=[replace(m, double_sided=False) for m in scene.materials])


def _rounded(colours):
    return np.rint(np.clip(colours, 0, 255)).astype(np.float64)
