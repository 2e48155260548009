"""Inverse rendering: voxel colours improved until their pictures look like the source's (encoder only; paper, section on IR).

Geometry and voxels stay as they are, so a picture is linear in the colours: every pixel is a trilinear blend of at most eight
voxels. The loss of a view is mean |difference| / 255 + 1 - SSIM over the covered pixels; its exact gradient goes through SSIM
(quality/ssim.py) and is scattered with the blend's weights. Adam takes the steps. Views are drawn as in the paper: perspective,
45 degrees, looking at the object's centre, azimuth and sine of elevation even, distance even in 1.2 to 3.0 (sides of the
canonical cube). Held-out views decide when to stop and which iteration is kept; the start is kept where none is better.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..asset.sample import sample_source
from ..kernel import kernel
from ..quality.psnr import decibels
from ..quality.ssim import ssim_gradient
from ..render.camera import perspective
from ..render.raster import rasterise
from .surface_fit import BLOCK, _corners

ITERATIONS, VIEWS, SIZE = 30, 8, 1024  # the paper's
FIELD_OF_VIEW, NEAREST, FARTHEST = 45.0, 1.2, 3.0
RATE = 0.5  # Adam's step in 8-bit levels, falling to a tenth along a cosine; of 0.1 to 3 the best on three assets
DECAY, SQUARE_DECAY, TINY = 0.9, 0.99, 1e-8
HELD_OUT_VIEWS, HELD_OUT_EVERY, PATIENCE = 4, 5, 2  # views, iterations between looks, looks without gain before it stops


@kernel
def _blend(rank, weight, values, out):
    """Trilinear colours out float32 [M, C] of values float32 [N, C]; rank int32 [M, 8] < N, -1 where nothing is."""
    for i in range(rank.shape[0]):
        for c in range(values.shape[1]):
            total = 0.0
            for k in range(8):
                if rank[i, k] >= 0:
                    total += weight[i, k] * values[rank[i, k], c]
            out[i, c] = np.float32(total)


@kernel
def _scatter(rank, weight, slope, low, high, gradient):
    """Transpose of _blend for the voxels low..high-1: adds slope float32 [M, C] to gradient float32 [N, C], in pixel order."""
    for i in range(rank.shape[0]):
        for k in range(8):
            r = np.int64(rank[i, k])
            if low <= r < high:
                for c in range(slope.shape[1]):
                    gradient[r, c] += np.float32(weight[i, k] * slope[i, c])


@kernel
def _adam(values, gradient, mean, square, begin, end, rate, mean_scale, square_scale):
    """One step of Adam on rows begin..end-1, kept in 0..255; clears the gradient."""
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
    column; target: float32 [M, 3], the source's colours; rank: int32 [M, 8] into all voxels, -1 for none; weight: float32
    [M, 8]."""

    size: int
    pixel: np.ndarray
    target: np.ndarray
    rank: np.ndarray
    weight: np.ndarray

    def colours(self, values):
        """What the field shows, float32 [M, 3]."""
        out = np.empty_like(self.target)
        _blend(self.rank, self.weight, values, out)
        return out

    def loss(self, values, threads):
        """(loss, mean squared error, its slope by colours() float32 [M, 3])."""
        shown = self.colours(values)
        rows, columns = self.pixel // self.size, self.pixel % self.size
        top, left = rows.min(), columns.min()
        shape = (rows.max() - top + 1, columns.max() - left + 1)
        a, b, mask = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
        place = (rows - top, columns - left)
        a[place], b[place], mask[place] = self.target, shown, True
        similarity, slope = ssim_gradient(a, b, mask, threads=threads)
        difference = shown - self.target
        loss = float(np.abs(difference).mean()) / 255 + 1 - similarity
        error = float((difference.astype(np.float64) ** 2).mean())
        return loss, error, np.sign(difference) / np.float32(255 * difference.size) - slope[place]


class Pictures:
    """Draws views of one asset, in a cube of side 1. surfaces: FieldSurfaces, one per field, on one lattice; seed: of the
    cameras; size: pixels a side."""

    def __init__(self, surfaces, seed, threads, size=SIZE):
        self.surfaces, self.threads, self.size = surfaces, threads, size
        self.random = np.random.default_rng(seed)
        self.faces = np.concatenate([s.faces for s in surfaces])
        self.face_field = np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces])
        self.first_face = np.cumsum([0] + [len(s.faces) for s in surfaces])
        self.first_voxel = np.cumsum([0] + [len(s.keys) for s in surfaces])
        self.positions = surfaces[0].lattice / float(1 << surfaces[0].position_bits)
        used = self.positions[np.unique(self.faces)]
        self.centre = (used.min(axis=0) + used.max(axis=0)) / 2

    def camera(self):
        """The next random camera."""
        azimuth, sine = self.random.uniform(0, 2 * np.pi), self.random.uniform(-1, 1)
        flat = np.sqrt(1 - sine * sine)
        direction = np.array([np.cos(azimuth) * flat, sine, np.sin(azimuth) * flat])
        eye = self.centre + direction * self.random.uniform(NEAREST, FARTHEST)
        return perspective(eye, self.centre, FIELD_OF_VIEW, self.size)

    def view(self):
        """The next View; pixels where no voxel answers or the source is transparent are left out."""
        seen = rasterise(self.camera(), self.positions, self.faces, cull=False, threads=self.threads)
        target = np.empty((len(seen.face), 4), np.float32)
        rank, weight = np.full((len(seen.face), 8), -1, np.int32), np.zeros((len(seen.face), 8), np.float32)
        which = self.face_field[seen.face]
        for i, surface in enumerate(self.surfaces):
            mine = np.flatnonzero(which == i)
            face, bary = seen.face[mine] - self.first_face[i], seen.bary[mine]
            target[mine] = sample_source(surface.source, face, bary, self.threads)
            points = np.einsum("nc,ncd->nd", bary, surface.lattice[surface.faces[face]])
            points *= surface.resolution / (1 << surface.position_bits)
            near, share = np.empty((len(mine), 8), np.int32), np.empty((len(mine), 8), np.float32)
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(lambda b, s=surface, p=points, r=near, w=share: _corners(p, b, min(b + BLOCK, len(p)), s.resolution,
                                                                                     *s.brick_map.arrays, r, w),
                              range(0, len(mine), BLOCK)))
            rank[mine], weight[mine] = np.where(near >= 0, near + self.first_voxel[i], -1), share
        keep = np.flatnonzero((weight.sum(axis=1) > 0) & (target[:, 3] > 127))
        return View(self.size, seen.pixel[keep], np.ascontiguousarray(target[keep, :3]), rank[keep], weight[keep])


def held_out(pictures, count=HELD_OUT_VIEWS):
    """The views that decide; drawn from their own Pictures. Those that show nothing are left out."""
    return [v for v in (pictures.view() for _ in range(count)) if len(v.pixel)]


def refine_by_rendering(surfaces, colours, threads=1, seed=0, iterations=ITERATIONS, views=VIEWS, size=SIZE,
                        on_progress=lambda done, total: None):
    """Improves the colours of all fields together.

    surfaces: FieldSurfaces, one per field; colours: float32 [N, 3] per field, 0..255. Returns (colours likewise, log: one
    {"iteration", "seconds", "loss", "held_out_loss", "held_out_psnr"} per look at the held-out views, which of them was kept).
    The same for a seed, whatever the number of threads.
    """
    begin, pictures = time.perf_counter(), Pictures(surfaces, seed, threads, size)
    judges = held_out(Pictures(surfaces, seed + 1_000_003, threads, size))
    values = np.ascontiguousarray(np.concatenate(colours), np.float32)
    gradient, mean, square = (np.zeros_like(values) for _ in range(3))
    log, best, kept, loss = [_look(judges, values, 0, None, begin, threads)], values.copy(), 0, 0.0
    cuts = np.linspace(0, len(values), threads + 1).astype(np.int64)
    ranges = list(zip(cuts[:-1], cuts[1:], strict=True))
    with ThreadPoolExecutor(threads) as pool:
        for step in range(1, iterations + 1) if judges else ():
            loss = 0.0
            for _ in range(views):
                view = pictures.view()
                if len(view.pixel) == 0:
                    continue
                one, _, slope = view.loss(values, threads)
                loss += one / views
                list(pool.map(lambda r, v=view, s=slope: _scatter(v.rank, v.weight, s, *r, gradient), ranges))
            rate = RATE * (0.55 + 0.45 * np.cos(np.pi * step / iterations))
            scales = 1 / (1 - DECAY**step), 1 / (1 - SQUARE_DECAY**step)
            list(pool.map(lambda r, a=rate, s=scales: _adam(values, gradient, mean, square, *r, a, *s), ranges))
            on_progress(step, iterations)
            if step % HELD_OUT_EVERY and step != iterations:
                continue
            log.append(_look(judges, values, step, loss, begin, threads))
            if log[-1]["held_out_loss"] < log[kept]["held_out_loss"]:
                best[:], kept = values, len(log) - 1
            elif len(log) - 1 - kept >= PATIENCE:
                break
    cuts = np.cumsum([len(c) for c in colours])[:-1]
    return np.split(best, cuts), log, kept


def _look(judges, values, step, loss, begin, threads):
    """The log's row for the colours at hand."""
    seen = [view.loss(values, threads)[:2] for view in judges]
    error = np.mean([mse for _, mse in seen]) if seen else 0.0
    return {"iteration": step, "seconds": round(time.perf_counter() - begin, 3), "loss": loss,
            "held_out_loss": float(np.mean([one for one, _ in seen])) if seen else None,
            "held_out_psnr": decibels(error) if error else None}
