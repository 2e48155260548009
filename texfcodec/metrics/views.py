"""Image quality by the protocol of the MPEG mesh metric (mpeg-pcc-mmetric, mode ibsm): renders of both sides, compared.

Orthographic views from Fibonacci directions span the bounding sphere of the reference's axis-aligned box. All back faces are
culled, even those of double-sided materials, because the protocol knows no materials. A pixel counts if both renders cover it.
Differences of the outlines are thus left out and have figures of their own: PSNR over pixels that either side covers, on white,
and the number of pixels that one side alone covers. Errors are pooled over all counted pixels of all views: a view with few of
them has little weight. On the three textures of the basketball player for which the tool's figures are known, all fifteen agree
to 0.002 dB; without the rounding to 8 bits they are up to 0.6 dB too high.

The second half of this module is 3D-PSNR of meshes (psnr_3d.py has that of streams).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..core.colour_error import ColourError, colour_mse, decibels
from ..core.json_text import json_ready
from ..errors import InputError
from ..geometry.mesh import Mesh
from ..render.camera import Camera, bounding_sphere, fibonacci_direction, orthographic
from ..render.environment import Environment
from ..render.lighting import Lighting
from ..render.shade import Picture, render_scene, render_texf
from ..render.textures import MipScenes, Textures
from ..scene.fetch import pack_source, sample_source
from ..scene.scene import ALPHA_OPAQUE, Scene
from ..texf import Texf
from .face_match import FaceMatch, Sheets
from .psnr_3d import SourceSamples, psnr_of
from .ssim import ssim as mean_ssim

VIEWS, SIZE = 16, 2048
NEAREST_SAMPLES = 100_000  # points of 3D-PSNR where each has to look for its nearest face


@dataclass
class _View:
    """Errors of one view.

    pixels, mse: number of pixels that both sides cover, and mean squared errors by plane there; lost, gained: number of pixels
    that the reference alone and the other alone covers; outline_mse: errors of these, on white; ssim, lpips: None if not
    requested.
    """

    pixels: int
    mse: dict
    lost: int
    gained: int
    outline_mse: dict
    ssim: float | None = None
    lpips: float | None = None


@dataclass(frozen=True, kw_only=True)
class ViewSettings:
    """Settings of the views.

    Parameters
    ----------
    environment : Environment, optional
        The light; None for the base colour as it is.
    mipmaps : bool
        Sample minified images and fields as viewers do, between two mip levels or levels of the field, instead of at points
        alone.
    """

    environment: Environment | None = None
    mipmaps: bool = False


def compare_views(reference: Scene | Texf, other: Scene | Texf, views: int = VIEWS, size: int = SIZE, ssim: bool = False,
                  lpips: Callable[[np.ndarray, np.ndarray], float] | None = None, threads: int = 1,
                  on_view: Callable[[int, int], object] | None = None, settings: ViewSettings | None = None) -> dict:
    """Draw both assets from several directions and return image metrics of other against reference.

    Parameters
    ----------
    reference, other : Scene or Texf
        Source and decoded asset.
    views : int
        Number of views, at least 1.
    size : int
        Side of a view in pixels.
    ssim : bool
        Compute SSIM as well.
    lpips : function, optional
        Distance of two uint8 images [H, W, 3], such as perceptual.Lpips.
    threads : int
        Views at a time; the result does not depend on it.
    on_view : function, optional
        Called with (views done, views) after each, in order.
    settings : ViewSettings, optional
        Settings of both sides' views; None for the protocol's.

    Returns
    -------
    dict
        "psnr", "union_psnr": {"rgb", "y", "u", "v", "yuv"} in dB; "ssim", "lpips", "views", "size", "pixels", "silhouette".

    Raises
    ------
    InputError
        TXF-I95 and TXF-I99.
    ValueError
        views or size is below 1.

    Notes
    -----
    Rendered values are rounded to 8 bits and PSNR has peak 255; None is lossless. psnr is over pixels that both sides cover, the
    counted ones; "pixels": their number. rgb is the PSNR of the mean of the three
    errors, yuv that of (6 Y + U + V) / 8 of the mean squared errors (not of the decibels, as psnr_yuv611 is). union_psnr is over
    pixels that either side covers, on white.
    ssim is the mean over all counted pixels and the RGB channels, on white. lpips is the mean over views with a counted pixel, of
    whole images on white. Both are None if not requested.
    silhouette: "lost", "gained": pixels that the reference alone and the other alone covers; "pixels": both together; "share": of
    the pixels that either covers.
    """
    if views < 1 or size < 1:
        raise ValueError(f"there must be at least one view of one pixel, not {views} of {size}")
    cameras, settings = _cameras(reference, views, size), settings or ViewSettings()
    render_reference, render_other = renderer(reference, settings), renderer(other, settings)

    def compare_view(i):
        return _compare(render_reference(cameras[i]), render_other(cameras[i]), ssim, lpips)

    seen = []
    with ThreadPoolExecutor(threads) as pool:
        for i, view in enumerate(pool.map(compare_view, range(views))):
            seen.append(view)
            if on_view:
                on_view(i + 1, views)
    return _figures(seen, views, size)


class KeptViews:
    """Views of a reference that are drawn once and compared with several others.

    Parameters
    ----------
    reference, views, size, settings
        As of compare_views().
    """

    def __init__(self, reference: Scene | Texf, views: int, size: int, settings: ViewSettings) -> None:
        self._cameras, self._settings, self._size = _cameras(reference, views, size), settings, size
        self._pictures = [renderer(reference, settings)(camera) for camera in self._cameras]

    def compare(self, other: Scene | Texf, threads: int = 1) -> dict:
        """Compare the reference with another asset; see compare_views().

        Parameters
        ----------
        other : Scene or Texf
            The decoded asset.
        threads : int
            Views at a time.

        Returns
        -------
        dict
            As of compare_views().
        """
        render = renderer(other, self._settings)
        with ThreadPoolExecutor(threads) as pool:
            seen = list(pool.map(lambda camera, picture: _compare(picture, render(camera), False, None), self._cameras,
                                 self._pictures))
        return _figures(seen, len(self._cameras), self._size)


def _cameras(reference, views, size):
    sphere = bounding_sphere(reference.positions)
    return [orthographic(fibonacci_direction(i, views), *sphere, size) for i in range(views)]


def _figures(seen, views, size):
    """The result of compare_views(). seen: the _View of each view. Raises InputError TXF-I95."""
    if not any(view.pixels for view in seen):
        raise InputError("TXF-I95", "no pixel of any view is covered by both sides", views=views, size=size)
    return {**_pooled([view for view in seen if view.pixels]), **_outlines(seen), "views": views, "size": size,
            "pixels": sum(view.pixels for view in seen)}


def renderer(side: Scene | Texf, settings: ViewSettings) -> Callable[[Camera], Picture]:
    """Return the function that draws a Scene or Texf from a camera, with all back faces culled.

    Parameters
    ----------
    side : Scene or Texf
        The asset.
    settings : ViewSettings
        Light and sampling.

    Returns
    -------
    function (Camera) -> Picture
        Draws one view.
    """
    side = replace(side, materials=[replace(m, double_sided=False) for m in side.materials])
    light = None if settings.environment is None else Lighting(side, settings.environment, settings.mipmaps)
    if isinstance(side, Texf):
        return lambda camera: render_texf(side, camera, filtering=settings.mipmaps, shaded=light)
    source = Textures(side, pack_source, MipScenes(side)) if settings.mipmaps else pack_source(side)
    return lambda camera: render_scene(side, camera, source=source, shaded=light)


def _compare(a, b, ssim, lpips):
    """_View of two Pictures from one camera."""
    mask = np.zeros(a.height * a.width, np.bool_)
    mask[a.pixel] = True
    both, gained = b.pixel[mask[b.pixel]], b.pixel[~mask[b.pixel]]
    mask[b.pixel] = False
    lost = a.pixel[mask[a.pixel]]
    image_a, image_b = _image(a), _image(b)
    mse, outline_mse = (_mse(image_a, image_b, pixel) for pixel in (both, np.concatenate([lost, gained])))
    view = _View(len(both), mse, len(lost), len(gained), outline_mse)
    if ssim and len(both):
        mask[:] = False
        mask[both] = True
        view.ssim = mean_ssim(image_a, image_b, mask.reshape(a.height, a.width))
    if lpips and len(both):
        view.lpips = lpips(image_a, image_b)
    return view


def _mse(image_a, image_b, pixel):
    """Mean squared errors of pixels, int64 [M], as ColourError has them; 0 without any."""
    if not len(pixel):
        return dict.fromkeys(("y", "u", "v", "rgb"), 0.0)
    return colour_mse(image_a.reshape(-1, 3)[pixel], image_b.reshape(-1, 3)[pixel])


def _image(picture):
    if not np.isfinite(picture.colour).all():
        raise InputError("TXF-I99", "a rendered colour is not finite",
                         value=int((~np.isfinite(picture.colour).all(axis=1)).sum()))
    return picture.image()


def _pooled(seen):
    weights = np.array([v.pixels for v in seen], np.float64)
    weights /= weights.sum()
    first = seen[0]
    return {"psnr": _psnr({name: weights @ [v.mse[name] for v in seen] for name in ("rgb", "y", "u", "v")}),
            "ssim": None if first.ssim is None else float(weights @ [v.ssim for v in seen]),
            "lpips": None if first.lpips is None else float(np.mean([v.lpips for v in seen]))}


def _psnr(mse):
    """PSNR of mean squared errors {"rgb", "y", "u", "v"}, and of the three planes together."""
    mse = {name: float(value) for name, value in mse.items()}
    mse["yuv"] = (6 * mse["y"] + mse["u"] + mse["v"]) / 8
    return json_ready({name: decibels(value) for name, value in mse.items()})


def _outlines(seen):
    """Sums of _View over all views for pixels that one side alone covers: "union_psnr" and "silhouette" of compare_views()."""
    lost, gained, both = (sum(getattr(v, name) for v in seen) for name in ("lost", "gained", "pixels"))
    union = lost + gained + both
    squares = {name: sum(v.pixels * v.mse[name] + (v.lost + v.gained) * v.outline_mse[name] for v in seen)
               for name in ("rgb", "y", "u", "v")}
    return {"union_psnr": _psnr({name: value / union for name, value in squares.items()}),
            "silhouette": {"pixels": lost + gained, "share": (lost + gained) / union, "lost": lost, "gained": gained}}


def mesh_psnr_3d(reference: Scene, mesh: Scene, samples: int = NEAREST_SAMPLES, threads: int = 1) -> dict:
    """Return the 3D-PSNR of a mesh that any codec has decoded, against its reference.

    Parameters
    ----------
    reference, mesh : Scene
        Source and decoded mesh, each with a face that has area.
    samples : int
        Number of points of the reference's surface.
    threads : int
        Most threads.

    Returns
    -------
    dict
        As of psnr_3d.measure().

    Raises
    ------
    ValueError
        A mesh has no area.

    Notes
    -----
    Colours are compared with those at the nearest points of the mesh. If the mesh has kept the reference's vertices and faces,
    they are compared at the same points: the search would cost a mesh without errors up to 0.3 dB. Errors are weighted by the
    reference's alpha if the mesh has alpha.
    """
    reference_samples = SourceSamples(reference, samples, threads)
    places = FaceMatch(reference, mesh, threads).find(reference_samples.face, reference_samples.bary)
    got = sample_source(pack_source(mesh), places.face, places.bary, threads)
    error = ColourError()
    error.add(reference_samples.colour[:, :3], got[:, :3], reference_samples.colour[:, 3] / 255.0 if _has_alpha(mesh) else None)
    return psnr_of(error)


def _has_alpha(scene):
    """Return whether any material uses alpha."""
    return any(m.alpha_mode != ALPHA_OPAQUE for m in scene.materials)


class MeshColours:
    """Colours of a mesh at the points nearest to given points, on the layer that faces the same way.

    Parameters
    ----------
    scene : Scene
        With a face that has area.
    threads : int
        Most threads.
    """

    def __init__(self, scene: Scene, threads: int = 1) -> None:
        self._source, self._threads = pack_source(scene), threads
        self._sheets = Sheets(Mesh(scene.positions, scene.faces))

    def query(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the mesh's colours at its points nearest to given points.

        Parameters
        ----------
        points : float64 [M, 3]
            World.
        normals : float64 [M, 3]
            Directions that the surface should face, of length 1, or 0 for any.

        Returns
        -------
        float32 [M, 4]
            RGBA, 0..255, sRGB-coded, straight alpha.
        """
        nearest = self._sheets.find(points, normals, threads=self._threads)
        return sample_source(self._source, nearest.face, nearest.bary, self._threads)
