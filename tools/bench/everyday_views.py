"""The metric's views of many variants of one mesh: what depends on the geometry alone is done once.

As metrics.views.compare_views, with which a test compares it: the variants share positions and faces, so that each view of them
is rasterised, and where faces can be seen through peeled, once, and only shaded for a variant.
"""

from dataclasses import replace

import numpy as np

from texfcodec.core.colour_error import RGB_TO_YUV, decibels
from texfcodec.metrics.views import VIEWS
from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
from texfcodec.render.depth_layers import CLOSED, LAYERS, PASSES, opacity
from texfcodec.render.raster import Fragments, visible
from texfcodec.render.shade import Picture, render_scene, shade_source
from texfcodec.render.triangles import set_up
from texfcodec.scene.fetch import pack_source
from texfcodec.scene.scene import ALPHA_OPAQUE
from tools.bench.everyday_points import SIZE, rounded


class MetricViews:
    """The views of a source Scene and what they show of variants of another: psnr(variant).

    placed: Scene with the positions, faces and materials that all variants have.
    """

    def __init__(self, source, placed, threads=1, views=VIEWS, size=SIZE):
        self._threads, self._size = threads, size
        centre, radius = bounding_sphere(source.positions)
        source, packed = _one_sided(source), pack_source(source)
        self._views = []
        for i in range(views):
            camera = orthographic(fibonacci_direction(i, views), centre, radius, size)
            picture = render_scene(source, camera, source=packed, threads=threads)
            covered = np.zeros(size * size, bool)
            covered[picture.pixel] = True
            self._views.append((peel(placed, camera, covered, threads), picture.image().reshape(-1, 3), covered))

    def psnr(self, variant):
        """{"y", "rgb", "yuv"} in dB of a variant against the source, pooled over all pixels that both cover, to three digits."""
        packed, squares, pixels = pack_source(variant), np.zeros((3, 3)), 0
        for layers, colours, covered in self._views:
            pixel, seen = self._look(variant, packed, layers)
            difference = (seen - colours[pixel])[covered[pixel]]
            squares += difference.T @ difference
            pixels += len(difference)
        if not pixels:
            raise SystemExit("no pixel of any view is covered by both sides")
        y, u, v = np.einsum("ij,jk,ik->i", RGB_TO_YUV, squares, RGB_TO_YUV) / pixels
        errors = {"y": y, "rgb": np.trace(squares) / 3 / pixels, "yuv": (6 * y + u + v) / 8}
        return rounded({name: decibels(max(float(error), 0.0)) for name, error in errors.items()})

    def _look(self, variant, packed, layers):
        """(pixel int64 [M], what is seen there float64 [M, 3], rounded to 8 bits)."""
        if len(layers) == 1 and (_modes(variant)[layers[0].face] == ALPHA_OPAQUE).all():
            colour = shade_source(packed, layers[0], self._threads)[:, :3]
            return layers[0].pixel, np.rint(np.clip(colour, 0, 255)).astype(np.float64)
        pixel, colour, alpha = self._composite(variant, packed, layers)
        image = Picture(self._size, self._size, pixel, colour, alpha).image().reshape(-1, 3)
        return pixel, image[pixel].astype(np.float64)

    def _composite(self, variant, packed, layers):
        """As render.depth_layers.composite, of layers that are peeled already."""
        count = self._size * self._size
        colour, through, number = np.zeros((count, 3), np.float32), np.ones(count, np.float32), np.zeros(count, np.uint8)
        going_on = np.ones(count, bool)
        for layer in layers:
            layer = part_of(layer, going_on[layer.pixel])
            pixel, rgba = layer.pixel, shade_source(packed, layer, self._threads)
            alpha = opacity(variant.materials, variant.face_material[layer.face], rgba[:, 3])
            colour[pixel] += (through[pixel] * alpha)[:, None] * rgba[:, :3]
            through[pixel] *= 1 - alpha
            number[pixel] += alpha > 0
            going_on[pixel] = (through[pixel] > CLOSED) & (number[pixel] < LAYERS)
        pixel = np.flatnonzero(through < 1)
        alpha = 1 - through[pixel]
        return pixel, colour[pixel] / alpha[:, None], alpha


def peel(scene, camera, wanted, threads=1):
    """The layers of a Scene in front of a camera, [Fragments], front to back; in each pixel as far as the first opaque face.
    wanted: bool [height * width], the pixels that anybody will ask for. One layer at least, which may be empty."""
    triangles, mode, layers, beyond = set_up(camera, scene.positions, scene.faces), _modes(scene), [], None
    while len(layers) < PASSES:
        seen = visible(triangles, threads, beyond)
        seen = part_of(seen, wanted[seen.pixel])
        if layers and len(seen.pixel) == 0:
            break
        layers.append(seen)
        going_on = mode[seen.face] != ALPHA_OPAQUE
        if not going_on.any():
            break
        beyond = np.full(camera.width * camera.height, np.inf)
        beyond[seen.pixel[going_on]] = seen.depth[going_on]
    return layers


def part_of(fragments, chosen):
    """The chosen ones, bool [M], of Fragments."""
    arrays = (getattr(fragments, name)[chosen] for name in ("pixel", "face", "bary", "depth"))
    return Fragments(*arrays, fragments.width, fragments.height)


def _modes(scene):
    """Alpha mode of each face, int64 [F]."""
    return np.array([m.alpha_mode for m in scene.materials], np.int64)[scene.face_material]


def _one_sided(scene):
    return replace(scene, materials=[replace(m, double_sided=False) for m in scene.materials])
