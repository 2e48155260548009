"""Image quality by the protocol of the MPEG mesh metric (mpeg-pcc-mmetric, mode ibsm): renders of both sides, compared.

| code | class | meaning |
|---|---|---|
| TXF-I95 | InputError | no pixel of any view is covered by both sides |
| TXF-I99 | InputError | a rendered colour is not finite |

Orthographic views from Fibonacci directions span the bounding sphere of the reference's axis-aligned box. Every back face is
culled, those of double-sided materials as well, because the protocol knows no materials. A pixel counts where both renders cover
it. Errors are pooled over all counted pixels of all views: a view in which little is seen weighs little.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..asset.scene import ALPHA_OPAQUE
from ..errors import InputError
from ..render.camera import bounding_sphere, fibonacci_direction, orthographic
from ..render.shade import render_scene, render_texf
from ..texf import Texf
from .psnr import ColourError, decibels, json_ready
from .ssim import ssim as mean_ssim

VIEWS, SIZE = 16, 2048
BLOCK = 1 << 14  # points asked at a time: trimesh keeps every candidate triangle of all of them


@dataclass
class _View:
    """What one view adds: pixels covered by both sides, mean squared errors by plane, SSIM and LPIPS (None if not asked)."""

    pixels: int
    mse: dict
    ssim: float | None
    lpips: float | None


def compare_views(reference, other, views=VIEWS, size=SIZE, ssim=False, lpips=None, threads=1, on_view=None):
    """Image metrics of other against reference, each a Scene or a Texf.

    views >= 1; size: pixels a side; ssim: compute SSIM as well; lpips: function of two uint8 images [H, W, 3], such as
    perceptual.Lpips, or None; threads: views at a time; on_view: called with (views done, views) after each, in order. The
    result does not depend on threads.

    Returns {"psnr": {"rgb", "y", "u", "v", "yuv"} in dB, "ssim", "lpips", "views", "size", "pixels"}. Rendered values are rounded
    to 8 bits and PSNR has peak 255. psnr rgb is of the mean of the three errors, yuv of (6 Y + U + V) / 8 of the mean squared
    errors (not of the decibels, as psnr.py's psnr_yuv611 is); None is lossless. ssim: mean over all counted pixels and the RGB
    channels, on white; lpips: mean over views with a counted pixel, whole images on white; both None if not asked for.
    Raises InputError with the codes of this module's table.
    """
    if views < 1 or size < 1:
        raise ValueError(f"there must be at least one view of one pixel, not {views} of {size}")
    centre, radius = bounding_sphere(reference.positions)
    render_reference, render_other = _renderer(reference), _renderer(other)

    def one(i):
        camera = orthographic(fibonacci_direction(i, views), centre, radius, size)
        return _compare(render_reference(camera), render_other(camera), ssim, lpips)

    seen = []
    with ThreadPoolExecutor(threads) as pool:
        for i, view in enumerate(pool.map(one, range(views))):
            seen += [view] if view.pixels else []
            if on_view:
                on_view(i + 1, views)
    if not seen:
        raise InputError("TXF-I95", "no pixel of any view is covered by both sides", views=views, size=size)
    return {**_pooled(seen), "views": views, "size": size, "pixels": sum(v.pixels for v in seen)}


def _renderer(side):
    """Function Camera -> Picture of a Scene or Texf with every back face culled."""
    side = replace(side, materials=[replace(m, double_sided=False) for m in side.materials])
    if isinstance(side, Texf):
        return lambda camera: render_texf(side, camera, filtering=False)
    source = pack_source(side)
    return lambda camera: render_scene(side, camera, source=source)


def _compare(a, b, ssim, lpips):
    """_View of two Pictures from one camera."""
    mask = np.zeros(a.height * a.width, np.bool_)
    mask[a.pixel] = True
    pixel = b.pixel[mask[b.pixel]]
    if len(pixel) == 0:
        return _View(0, {}, None, None)
    image_a, image_b = _image(a), _image(b)
    error = ColourError()
    error.add(image_a.reshape(-1, 3)[pixel], image_b.reshape(-1, 3)[pixel])
    view = _View(error.samples, error.mse(), None, None)
    if ssim:
        mask[:] = False
        mask[pixel] = True
        view.ssim = mean_ssim(image_a, image_b, mask.reshape(a.height, a.width))
    if lpips:
        view.lpips = lpips(image_a, image_b)
    return view


def _image(picture):
    if not np.isfinite(picture.colour).all():
        raise InputError("TXF-I99", "a rendered colour is not finite",
                         value=int((~np.isfinite(picture.colour).all(axis=1)).sum()))
    return picture.image()


def _pooled(seen):
    weights = np.array([v.pixels for v in seen], np.float64)
    weights /= weights.sum()
    mse = {name: float(weights @ [v.mse[name] for v in seen]) for name in ("rgb", "y", "u", "v")}
    mse["yuv"] = (6 * mse["y"] + mse["u"] + mse["v"]) / 8
    first = seen[0]
    return {"psnr": json_ready({name: decibels(value) for name, value in mse.items()}),
            "ssim": None if first.ssim is None else float(weights @ [v.ssim for v in seen]),
            "lpips": None if first.lpips is None else float(np.mean([v.lpips for v in seen]))}


class MeshColours:
    """A mesh that answers points as a Texf does, with the colour at its nearest surface point: so quality.measure takes it.

    scene: Scene with at least one face; threads.
    """

    def __init__(self, scene, threads=1):
        import trimesh

        self.fields = [scene]  # one: the nearest face is sought over the whole mesh
        self.has_alpha = any(m.alpha_mode != ALPHA_OPAQUE for m in scene.materials)
        self._source, self._threads = pack_source(scene), threads
        self._origin = scene.positions.min(axis=0)
        self._side = float((scene.positions - self._origin).max()) or 1.0
        self._mesh = trimesh.Trimesh((scene.positions - self._origin) / self._side, scene.faces, process=False)

    def query(self, points):
        """Colours at world points [M, 3]: float32 [M, 4], 0..255, sRGB-coded, straight alpha."""
        from trimesh.proximity import closest_point
        from trimesh.triangles import points_to_barycentric

        out = np.empty((len(points), 4), np.float32)
        for begin in range(0, len(points), BLOCK):
            part = slice(begin, begin + BLOCK)
            near, _, face = closest_point(self._mesh, (points[part] - self._origin) / self._side)
            bary = points_to_barycentric(self._mesh.triangles[face], near)
            out[part] = sample_source(self._source, face, _inside(bary), self._threads)
        return out


def _inside(bary):
    """Barycentric coordinates that are of this triangle; a triangle without area answers with its first corner."""
    bary = np.clip(np.where(np.isfinite(bary), bary, 0.0), 0.0, 1.0)
    total = bary.sum(axis=1, keepdims=True)
    return np.where(total > 0, bary / np.where(total > 0, total, 1.0), (1.0, 0.0, 0.0))
