"""Image-space refinement of a fitted payload (encoder only; paper, section on IR).

Latents and network take further, small steps on the loss of rendered pictures (pictures.py), a step a picture. Held-out views
decide when to stop and which state is kept; the fit's own state is kept if none is better. Only for payloads without alpha: the
loss is of colours, and would let alpha drift.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...codecs.neural.fit_samples import Samples, Source, cells_of
from .pictures import HELD_OUT_SEED, HELD_OUT_VIEWS, SIZE, USUAL, Cameras, Schedule, keep_best, picture_loss

if TYPE_CHECKING:
    from ...codecs.neural.fit import Fit
    from ...codecs.neural.payload import Tables

RATE = 0.05  # of the fit's rates, falling along a cosine
SCALE = 1e4  # of the slopes, which a mean over a picture makes small beside train.TINY


@dataclass
class Picture:
    """A picture to learn from. size: pixels a side; pixel: int64 [M], the covered ones, row * size + column; samples: Samples
    [M], the surface points that these pixels show; cells: of the samples, by cells_of."""

    size: int
    pixel: np.ndarray
    samples: Samples
    cells: tuple

    def loss(self, fit: Fit) -> tuple[float, float, np.ndarray]:
        """Return the picture_loss() of what a fit shows: (loss, mean squared error, gradient by its colours float32 [M, 3])."""
        shown = np.clip(fit.answers(self.samples, self.cells), 0, 255)
        return picture_loss(self.size, self.pixel, self.samples.target.astype(np.float32), shown, fit.threads)


class Pictures:
    """Source of random Pictures of a fit_samples.Source; tables: payload.Tables by field; position_bits: of its lattice."""

    def __init__(self, source: Source, tables: list[Tables], position_bits: int, seed: int, size: int = SIZE) -> None:
        self.source, self.tables, self.size = source, tables, size
        self.cameras = Cameras(source.lattice, source.faces, position_bits, seed, source.threads, size)

    def next(self) -> Picture:
        """Return the next Picture."""
        seen = self.cameras.next()
        samples = self.source.at(seen.face, seen.bary, self.source.threads)
        return Picture(self.size, seen.pixel, samples, cells_of(samples, self.tables))


def refine_by_pictures(fit: Fit, source: Source, position_bits: int, schedule: Schedule = USUAL,
                       on_progress: Callable[[int, int], object] = lambda done, total: None) -> tuple[list[dict], int]:
    """Improve the latents and the network of a fit.Fit in place, by steps on the loss of rendered pictures.

    source: fit_samples.Source that it was fitted to; position_bits: of its lattice. Returns (log, index of the row that was
    kept) as of keep_best. The result depends on the seed alone.
    """
    begin, views = time.perf_counter(), schedule.views
    pictures = Pictures(source, fit.tables, position_bits, schedule.seed, schedule.size)
    judging = Pictures(source, fit.tables, position_bits, schedule.seed + HELD_OUT_SEED, schedule.size)
    judges = [p for p in (judging.next() for _ in range(HELD_OUT_VIEWS)) if len(p.pixel)]
    fit.forget()
    with ThreadPoolExecutor(fit.threads) as pool:

        def iterate(n):
            loss = sum(_step(fit, pictures.next(), (n - 1) * views + k, schedule.iterations * views, pool) for k in range(views))
            on_progress(n, schedule.iterations)
            return loss / views

        log, kept = keep_best(iterate, lambda: [p.loss(fit)[:2] for p in judges], fit.values, schedule.iterations, begin)
    fit.upload()
    return log, kept


def _step(fit, picture, step, steps, pool):
    """Take one step against a picture's loss; return the loss."""
    if len(picture.pixel) == 0:
        return 0.0
    loss, _, by_colour = picture.loss(fit)
    fit.learn(picture.samples, picture.cells, pool, by_colour * np.float32(SCALE))
    fit.move(RATE * 0.5 * (1 + np.cos(np.pi * step / steps)), step + 1, pool)
    return loss
