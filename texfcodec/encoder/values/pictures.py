"""Pictures that a refinement learns from, and their loss (encoder only; paper, section on IR).

Views are drawn as in the paper: perspective, 45 degrees, looking at the object's centre, azimuth and sine of elevation even,
distance even in 1.2 to 3.0 (sides of the canonical cube). The loss of a view is mean |difference| / 255 + 1 - SSIM over the
covered pixels; its gradient goes through SSIM (metrics/ssim.py) and is exact.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.colour_error import decibels
from ...metrics.ssim import ssim_gradient
from ...render.camera import perspective
from ...render.raster import Fragments, rasterise

ITERATIONS, VIEWS, SIZE = 30, 8, 1024  # the paper's
FIELD_OF_VIEW, NEAREST, FARTHEST = 45.0, 1.2, 3.0
HELD_OUT_VIEWS, HELD_OUT_EVERY, PATIENCE = 4, 5, 2  # views, iterations between checks, checks without gain before it stops
HELD_OUT_SEED = 1_000_003  # added to that of the other views
OPAQUE = 127  # pixels of less alpha are left out


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Length of a refinement, and its pictures. views: pictures of an iteration; size: pixels a side; seed: of the
    views."""

    iterations: int = ITERATIONS
    views: int = VIEWS
    size: int = SIZE
    seed: int = 0


USUAL = Schedule()


class Cameras:
    """Random views of a mesh in a cube of side 1. lattice: int64 [V, 3]; faces: int64 [F, 3]; position_bits; seed: of the views;
    size: pixels a side."""

    def __init__(self, lattice: np.ndarray, faces: np.ndarray, position_bits: int, seed: int, threads: int,
                 size: int = SIZE) -> None:
        self.positions, self.faces = lattice / float(1 << position_bits), faces
        self.random, self.threads, self.size = np.random.default_rng(seed), threads, size
        used = self.positions[np.unique(faces)]
        self.centre = (used.min(axis=0) + used.max(axis=0)) / 2

    def next(self) -> Fragments:
        """Rasterise all faces, both sides of them, for the next random camera."""
        azimuth, sine = self.random.uniform(0, 2 * np.pi), self.random.uniform(-1, 1)
        flat = np.sqrt(1 - sine * sine)
        direction = np.array([np.cos(azimuth) * flat, sine, np.sin(azimuth) * flat])
        eye = self.centre + direction * self.random.uniform(NEAREST, FARTHEST)
        camera = perspective(eye, self.centre, FIELD_OF_VIEW, self.size)
        return rasterise(camera, self.positions, self.faces, cull=False, threads=self.threads)


def picture_loss(size: int, pixel: np.ndarray, target: np.ndarray, shown: np.ndarray,
                 threads: int) -> tuple[float, float, np.ndarray]:
    """Return (loss, mean squared error, gradient of the loss by shown, float32 [M, 3]) of a picture against its target.

    pixel: int64 [M], the covered pixels of a picture of `size` a side, row * size + column; target, shown: float32 [M, 3], their
    colours in 0..255.
    """
    rows, columns = pixel // size, pixel % size
    top, left = rows.min(), columns.min()
    shape = (rows.max() - top + 1, columns.max() - left + 1)
    a, b, mask = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
    place = (rows - top, columns - left)
    a[place], b[place], mask[place] = target, shown, True
    similarity, slope = ssim_gradient(a, b, mask, threads=threads)
    difference = shown - target
    loss = float(np.abs(difference).mean()) / 255 + 1 - similarity
    error = float((difference.astype(np.float64) ** 2).mean())
    return loss, error, np.sign(difference) / np.float32(255 * difference.size) - slope[place]


def keep_best(iterate: Callable[[int], float], judge: Callable[[], list[tuple[float, float]]], values: Sequence[np.ndarray],
              iterations: int, begin: float) -> tuple[list[dict], int]:
    """Run the iterations of a refinement while held-out views gain, and leave the best state in values.

    iterate(n): does iteration n, from 1, and returns its loss; judge(): returns (loss, mean squared error) of each held-out
    view; values: arrays that iterate changes; iterations: at most; begin: start of the refinement, by time.perf_counter. Returns
    (log: {"iteration", "seconds", "loss", "held_out_loss", "held_out_psnr"} of each check, index of the row that was kept).
    Nothing changes if no view shows anything. Figures that are not finite are None in the log, and never the best.
    """

    def check(n, loss):
        seen = judge()
        held, error = np.mean(seen, axis=0).tolist() if seen else (None, None)
        error = _finite(error)
        log.append({"iteration": n, "seconds": round(time.perf_counter() - begin, 3), "loss": _finite(loss),
                    "held_out_loss": _finite(held), "held_out_psnr": decibels(error) if error else None})
        return bool(seen)

    log: list[dict] = []
    kept, best = 0, [v.copy() for v in values]
    for n in range(1, iterations + 1) if check(0, None) else ():
        loss = iterate(n)
        if n % HELD_OUT_EVERY and n != iterations:
            continue
        check(n, loss)
        held = log[-1]["held_out_loss"]
        if held is not None and held < log[kept]["held_out_loss"]:
            kept, best = len(log) - 1, [v.copy() for v in values]
        elif len(log) - 1 - kept >= PATIENCE:
            break
    for value, array in zip(values, best, strict=True):
        value[...] = array
    return log, kept


def _finite(v):
    return v if v is not None and np.isfinite(v) else None
