"""Inverse rendering: it improves voxel colours until their pictures look like the source's (encoder only; paper, section on IR).

Geometry and voxels stay as they are, so a picture is linear in the colours: every pixel is a trilinear blend of at most eight
voxels. The gradient of a view's loss (pictures.py) is scattered with the blend's weights, and Adam takes the steps. Held-out
views decide when to stop and which iteration is kept; the start is kept if no iteration is better.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ...core.kernel import kernel
from ...scene.fetch import sample_source
from .pictures import HELD_OUT_SEED, HELD_OUT_VIEWS, OPAQUE, SIZE, USUAL, Cameras, Schedule, keep_best, picture_loss
from .surface_fit import BLOCK, FieldSurface, _corners

RATE = 0.5  # Adam's step in 8-bit levels, falling to a tenth along a cosine; of 0.1 to 3 the best on three assets
DECAY, SQUARE_DECAY, TINY = 0.9, 0.99, 1e-8


@kernel
def _blend(rank, weight, values, out):
    """Fill out float32 [M, C] with trilinear colours of values float32 [N, C]; rank int32 [M, 8] < N, -1 without a voxel."""
    for i in range(rank.shape[0]):
        for c in range(values.shape[1]):
            total = 0.0
            for k in range(8):
                if rank[i, k] >= 0:
                    total += weight[i, k] * values[rank[i, k], c]
            out[i, c] = np.float32(total)


@kernel
def _scatter(rank, weight, slope, low, high, gradient):
    """Add slope float32 [M, C] to gradient float32 [N, C] of the voxels low..high-1, in pixel order: the transpose of _blend."""
    for i in range(rank.shape[0]):
        for k in range(8):
            r = np.int64(rank[i, k])
            if low <= r < high:
                for c in range(slope.shape[1]):
                    gradient[r, c] += np.float32(weight[i, k] * slope[i, c])


@kernel
def _adam(values, gradient, mean, square, begin, end, rate, mean_scale, square_scale):
    """Do one step of Adam on rows begin..end-1, kept in 0..255; clear the gradient."""
    for i in range(begin, end):
        for c in range(values.shape[1]):
            g = gradient[i, c]
            mean[i, c] = np.float32(DECAY * mean[i, c] + (1.0 - DECAY) * g)
            square[i, c] = np.float32(SQUARE_DECAY * square[i, c] + (1.0 - SQUARE_DECAY) * g * g)
            step = rate * mean[i, c] * mean_scale / (np.sqrt(square[i, c] * square_scale) + TINY)
            values[i, c] = np.float32(min(max(values[i, c] - step, 0.0), 255.0))
            gradient[i, c] = 0.0


@dataclass
class View:
    """A picture as a linear map of the voxels' colours. size: pixels a side; pixel: int64 [M], the covered ones, row * size +
    column; target: float32 [M, 3], the source's colours; rank: int32 [M, 8] into all voxels, -1 without a voxel; weight: float32
    [M, 8]."""

    size: int
    pixel: np.ndarray
    target: np.ndarray
    rank: np.ndarray
    weight: np.ndarray

    def colours(self, values: np.ndarray) -> np.ndarray:
        """Return the colours of the covered pixels, float32 [M, 3], blended from voxel colours, float32 [N, 3] of all fields."""
        out = np.empty_like(self.target)
        _blend(self.rank, self.weight, values, out)
        return out

    def loss(self, values: np.ndarray, threads: int) -> tuple[float, float, np.ndarray]:
        """Return (loss, mean squared error, gradient of the loss by colours(), float32 [M, 3]) of the picture that voxel colours
        show. values: float32 [N, 3], of all fields."""
        return picture_loss(self.size, self.pixel, self.target, self.colours(values), threads)


class Pictures:
    """Source of random Views of one asset, in a cube of side 1. surfaces: FieldSurfaces, one per field, on one lattice; seed: of
    the cameras; size: pixels a side."""

    def __init__(self, surfaces: list[FieldSurface], seed: int, threads: int, size: int = SIZE) -> None:
        self.surfaces, self.threads, self.size = surfaces, threads, size
        self.face_field = np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces])
        self.first_face = np.cumsum([0] + [len(s.faces) for s in surfaces])
        self.first_voxel = np.cumsum([0] + [len(s.keys) for s in surfaces])
        faces = np.concatenate([s.faces for s in surfaces])
        self.cameras = Cameras(surfaces[0].lattice, faces, surfaces[0].position_bits, seed, threads, size)

    def view(self) -> View:
        """Return the next View, without pixels that no voxel covers or whose source is transparent."""
        seen = self.cameras.next()
        target = np.empty((len(seen.face), 4), np.float32)
        rank, weight = np.full((len(seen.face), 8), -1, np.int32), np.zeros((len(seen.face), 8), np.float32)
        which = self.face_field[seen.face]
        for i, surface in enumerate(self.surfaces):
            rows = np.flatnonzero(which == i)
            face, bary = seen.face[rows] - self.first_face[i], seen.bary[rows]
            target[rows] = sample_source(surface.source, face, bary, self.threads)
            points = np.einsum("nc,ncd->nd", bary, surface.lattice[surface.faces[face]])
            points *= surface.resolution / (1 << surface.position_bits)
            near, share = np.empty((len(rows), 8), np.int32), np.empty((len(rows), 8), np.float32)
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(lambda b, s=surface, p=points, r=near, w=share: _corners(p, b, min(b + BLOCK, len(p)), s.resolution,
                                                                                     *s.brick_map.arrays, r, w),
                              range(0, len(rows), BLOCK)))
            rank[rows], weight[rows] = np.where(near >= 0, near + self.first_voxel[i], -1), share
        keep = np.flatnonzero((weight.sum(axis=1) > 0) & (target[:, 3] > OPAQUE))
        return View(self.size, seen.pixel[keep], np.ascontiguousarray(target[keep, :3]), rank[keep], weight[keep])


def held_out(pictures: Pictures, count: int = HELD_OUT_VIEWS) -> list[View]:
    """Return `count` Views for judging, without those that show nothing. pictures: with a seed of its own."""
    return [v for v in (pictures.view() for _ in range(count)) if len(v.pixel)]


def refine_by_rendering(surfaces: list[FieldSurface], colours: list[np.ndarray], threads: int = 1,
                        schedule: Schedule = USUAL, on_progress: Callable[[int, int], object] = lambda done, total: None,
                        ) -> tuple[list[np.ndarray], list[dict], int]:
    """Improve the voxel colours of all fields together until rendered pictures look like the source's.

    surfaces: FieldSurfaces, one per field; colours: float32 [N, 3] per field, 0..255. Returns (colours in the same form, log and
    index of the row that was kept, both as of keep_best). The result depends on the seed, not on the number of threads.
    """
    begin, pictures = time.perf_counter(), Pictures(surfaces, schedule.seed, threads, schedule.size)
    judges = held_out(Pictures(surfaces, schedule.seed + HELD_OUT_SEED, threads, schedule.size))
    values = np.ascontiguousarray(np.concatenate(colours), np.float32)
    gradient, mean, square = (np.zeros_like(values) for _ in range(3))
    cuts = np.linspace(0, len(values), threads + 1).astype(np.int64)
    ranges = list(zip(cuts[:-1], cuts[1:], strict=True))
    with ThreadPoolExecutor(threads) as pool:

        def iterate(step):
            loss = 0.0
            for _ in range(schedule.views):
                view = pictures.view()
                if len(view.pixel) == 0:
                    continue
                of_view, _, slope = view.loss(values, threads)
                loss += of_view / schedule.views
                list(pool.map(lambda r, v=view, s=slope: _scatter(v.rank, v.weight, s, *r, gradient), ranges))
            rate = RATE * (0.55 + 0.45 * np.cos(np.pi * step / schedule.iterations))
            scales = 1 / (1 - DECAY**step), 1 / (1 - SQUARE_DECAY**step)
            list(pool.map(lambda r: _adam(values, gradient, mean, square, *r, rate, *scales), ranges))
            on_progress(step, schedule.iterations)
            return loss

        judge = lambda: [v.loss(values, threads)[:2] for v in judges]
        log, kept = keep_best(iterate, judge, [values], schedule.iterations, begin)
    cuts = np.cumsum([len(c) for c in colours])[:-1]
    return np.split(values, cuts), log, kept
