"""Image quality by the protocol of the MPEG mesh metric (mpeg-pcc-mmetric, mode ibsm): renders of both sides, compared.

Orthographic views from Fibonacci directions span the bounding sphere of the reference's axis-aligned box. Every back face is
culled, those of double-sided materials as well, because the protocol knows no materials. A pixel counts where both renders cover
it. Errors are pooled over all counted pixels of all views: a view in which little is seen weighs little. On the three textures of
the basketball player for which the tool's figures are known, all fifteen agree to 0.002 dB; without the rounding to 8 bits they
are up to 0.6 dB too high.

Below that stands what 3D-PSNR (measure.py) needs where the source's faces must first be found on the other side.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..asset.sample import pack_source, sample_source
from ..asset.scene import ALPHA_OPAQUE, Scene
from ..errors import InputError
from ..ground.areas import sample_surface
from ..ground.colour_error import ColourError, decibels, json_ready
from ..ground.ssim import ssim as mean_ssim
from ..render.camera import bounding_sphere, fibonacci_direction, orthographic
from ..render.shade import render_scene, render_texf
from ..texf import Texf
from .faces import decoded_faces
from .measure import SourceSamples

VIEWS, SIZE = 16, 2048
NEAREST_SAMPLES = 100_000  # points of 3D-PSNR where each has to look for its nearest face
LANDMARKS, NEIGHBOURS = 500_000, 8
BLOCK = 1 << 15  # points asked at a time, each with its NEIGHBOURS triangles


@dataclass
class _View:
    """What one view adds: pixels covered by both sides, mean squared errors by plane, SSIM and LPIPS (None if not asked)."""

    pixels: int
    mse: dict
    ssim: float | None
    lpips: float | None


def compare_views(reference: Scene | Texf, other: Scene | Texf, views: int = VIEWS, size: int = SIZE, ssim: bool = False,
                  lpips: Callable[[np.ndarray, np.ndarray], float] | None = None, threads: int = 1,
                  on_view: Callable[[int, int], object] | None = None) -> dict:
    """Image metrics of other against reference, each a Scene or a Texf.

    views >= 1; size: pixels a side; ssim: compute SSIM as well; lpips: function of two uint8 images [H, W, 3], such as
    perceptual.Lpips, or None; threads: views at a time; on_view: called with (views done, views) after each, in order. The
    result does not depend on threads.

    Returns {"psnr": {"rgb", "y", "u", "v", "yuv"} in dB, "ssim", "lpips", "views", "size", "pixels"}. Rendered values are rounded
    to 8 bits and PSNR has peak 255. psnr rgb is of the mean of the three errors, yuv of (6 Y + U + V) / 8 of the mean squared
    errors (not of the decibels, as psnr.py's psnr_yuv611 is); None is lossless. ssim: mean over all counted pixels and the RGB
    channels, on white; lpips: mean over views with a counted pixel, whole images on white; both None if not asked for.
    Raises InputError TXF-I95 and TXF-I99.
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


def fields_of_faces(scene: Scene, texf: Texf) -> np.ndarray | None:
    """The field that each face of the source is in: int64 [F], -1 for a face that is not in the stream; see faces.decoded_faces.

    None where less than half of the faces are found: then the stream was made from something else.
    """
    face, _ = decoded_faces(scene, texf)
    if 2 * np.count_nonzero(face >= 0) < len(face):
        return None
    return np.where(face >= 0, texf.face_field[np.maximum(face, 0)], -1) if len(texf.faces) else face


def mesh_psnr_3d(reference: Scene, mesh: Scene, samples: int = NEAREST_SAMPLES, threads: int = 1) -> dict:
    """3D-PSNR of a decoded mesh, at the points of its surface nearest to points of the reference's; where it has kept the
    reference's vertices and faces, at the same points, because looking for them costs a mesh that is all right up to 0.3 dB.

    reference, mesh: Scene, each with a face that has area. Returns what measure.measure returns. Errors weigh by the reference's
    alpha where the mesh has alpha. Raises ValueError for meshes without area.
    """
    asked = SourceSamples(reference, samples, threads)
    if np.array_equal(reference.positions, mesh.positions) and np.array_equal(reference.faces, mesh.faces):
        got = sample_source(pack_source(mesh), asked.face, asked.bary, threads)
    else:
        corners = reference.positions[reference.faces[asked.face]]
        points = np.einsum("mk,mkc->mc", asked.bary, corners)
        got = MeshColours(mesh, threads).query(points, _normals(corners))
    error = ColourError()
    error.add(asked.colour[:, :3], got[:, :3], asked.colour[:, 3] / 255.0 if _has_alpha(mesh) else None)
    result = json_ready(error.result())
    return {name: result[f"psnr_{name}"] for name in ("y", "yuv611", "rgb")} | {"samples": error.samples}


def _has_alpha(scene):
    """Whether alpha means something in it."""
    return any(m.alpha_mode != ALPHA_OPAQUE for m in scene.materials)


class MeshColours:
    """The colours of a mesh at its points nearest to given ones. Of surfaces that lie on each other, the one that faces the given
    way answers: without that, the lining of a garment would answer for its outside.

    scene: Scene with a face that has area; threads.
    """

    def __init__(self, scene: Scene, threads: int = 1) -> None:
        from scipy.spatial import cKDTree  # here, as is trimesh below, because it takes long to import

        self._source, self._threads = pack_source(scene), threads
        self._origin = scene.positions.min(axis=0)
        self._side = float((scene.positions - self._origin).max())
        self._corners = ((scene.positions - self._origin) / self._side)[scene.faces]
        self._normals = _normals(self._corners)
        face, bary = sample_surface(scene.positions, scene.faces, LANDMARKS)
        places = np.einsum("mk,mkc->mc", bary, self._corners[face])
        self._face = np.concatenate([face, np.arange(len(scene.faces))])  # a centroid each: no face is too small to be found
        places = np.concatenate([places, self._corners.mean(axis=1)])
        edges = self._corners[:, 1:] - self._corners[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
        self._turn = 4 * np.sqrt(area / LANDMARKS)  # a normal that is off by 1 counts as four landmarks' spacing
        self._tree = cKDTree(np.hstack([places, self._turn * self._normals[self._face]]))

    def query(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Colours at world points, float64 [M, 3], of surfaces that face along normals, float64 [M, 3] of length 1 (or 0: any).

        Returns float32 [M, 4], 0..255, sRGB-coded, straight alpha. The nearest point is exact on its triangle, and the triangle
        is the nearest of those around the NEIGHBOURS nearest of LANDMARKS points spread over the mesh.
        """
        out = np.empty((len(points), 4), np.float32)
        for begin in range(0, len(points), BLOCK):
            part = slice(begin, begin + BLOCK)
            face, bary = self._nearest((points[part] - self._origin) / self._side, normals[part])
            out[part] = sample_source(self._source, face, bary, self._threads)
        return out

    def _nearest(self, points, normals):
        """(face int64 [M], bary float64 [M, 3]) of points in units of the mesh's side."""
        from trimesh.triangles import closest_point, points_to_barycentric

        keys = np.hstack([points, self._turn * normals])
        faces = self._face[self._tree.query(keys, NEIGHBOURS, workers=self._threads)[1]]
        every = np.repeat(points, NEIGHBOURS, axis=0)
        with np.errstate(all="ignore"):  # triangles without area
            near = closest_point(self._corners[faces.ravel()], every)
            distance = np.linalg.norm(near - every, axis=1).reshape(faces.shape)
        against = np.einsum("mkc,mc->mk", self._normals[faces], normals) < 0
        best = np.argmin(np.where(np.isfinite(distance), distance, np.inf) + self._turn * against, axis=1)
        row = np.arange(len(points))
        face = faces[row, best]
        with np.errstate(all="ignore"):
            return face, _inside(points_to_barycentric(self._corners[face], near.reshape(*faces.shape, 3)[row, best]))


def _normals(corners):
    """Unit normals float64 [M, 3] of triangles [M, 3, 3]; zero where a triangle has no area."""
    edges = corners[:, 1:] - corners[:, :1]
    edges = edges / np.maximum(np.abs(edges).max(axis=(1, 2), initial=0.0, keepdims=True), 1e-300)
    normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def _inside(bary):
    """Barycentric coordinates that are of this triangle; a triangle without area answers with its first corner."""
    bary = np.clip(np.where(np.isfinite(bary), bary, 0.0), 0.0, 1.0)
    total = bary.sum(axis=1, keepdims=True)
    return np.where(total > 0, bary / np.where(total > 0, total, 1.0), (1.0, 0.0, 0.0))
