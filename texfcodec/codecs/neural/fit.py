"""Fits a 3DNTC payload to the source (encoder only; paper, section on 3DNTC).

Gradient descent on the squared errors of all channels at surface samples, with cosine decay; Adam moves the network. A batch
takes every n-th sample along a Morton curve over the whole surface. It covers the surface evenly, and consecutive samples read
the same latents. The same seed gives the same payload for every number of threads.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core import cleanup
from ...core.colour_error import decibels
from ...core.threads import over_blocks
from ...errors import InputError
from .fit_samples import Samples, cells_of, order_along_curve
from .infer import BLOCK, CHUNK, infer
from .payload import Payload, Tables, join_parameters
from .train import MOMENTUM, SQUARE_DECAY, TINY, _adam, _evaluate, _move_rows, _round_latents, _train

BATCH = 4096  # more steps with smaller batches are better
# For the latents, no momentum and one mean square a row: within 0.05 dB of Adam, with a third of the memory to move.
LATENT_RATE, NETWORK_RATE = 0.03, 0.01
LATENT_START = 0.05
LOOKS = 20  # times that the held-out points are asked on the way
PATIENCE, LEAST_GAIN = 3, 0.005  # so many looks that together gain less than so many dB end the fit
SETTLED_DECAY = 0.15  # but not while the rates are higher than that: most of the gain comes when they fall
LARGEST = 4092.0  # parameters in the stream are below 2**12
WARMING = (1 / (1 - SQUARE_DECAY ** np.maximum(np.arange(2048), 1))).astype(np.float32)
SAVE_SECONDS = 30.0  # between checkpoints
PARTS = 4  # of a batch, whose gradients are added up in order, so that the number of threads changes nothing
NO_SLOPE = np.zeros((0, 0), np.float32)


class Fit:
    """A fit of latents and a network to samples of the surface: parameters, optimiser's state and log. design: payload.Payload
    without codes and halves; tables: payload.Tables by field; samples, held_out: fit_samples.Samples; batch: samples per step;
    judged: components whose PSNR decides whether the fit still improves."""

    def __init__(self, design: Payload, tables: list[Tables], samples: Samples, held_out: Samples, seed: int = 0,
                 threads: int = 1, batch: int = BATCH, judged: Sequence[int] = (0, 1, 2)) -> None:
        self.design, self.tables, self.seed, self.threads = design, tables, seed, threads
        self.held_out, self.judged = held_out, list(judged)
        self._arrange(samples, batch)
        self.held_cells = cells_of(held_out, tables)
        self.resolutions = np.array([level.resolution for level in design.levels], np.int64)
        self._start()

    def _arrange(self, samples, batch):
        """Sorts samples into batches and looks up the latents around them."""
        order = order_along_curve(samples.position)
        self.batches = max(1, len(order) // batch)
        self.samples = samples.taken(order[: len(order) // self.batches * self.batches].reshape(-1, self.batches).T.reshape(-1))
        self.cell, self.corners = cells_of(self.samples, self.tables)

    def _start(self):
        random = np.random.default_rng(self.seed)
        self.widths = np.array([-(-w // 4) * 4 for w in self.design.widths], np.int64)
        layers, rows = len(self.widths) - 1, int(self.widths.max())
        latent = _aligned((self.design.rows, -(-self.design.features // CHUNK) * CHUNK))
        latent[:, : self.design.features] = random.uniform(-LATENT_START, LATENT_START, (len(latent), self.design.features))
        weight, bias = np.zeros((layers, rows, rows), np.float32), np.zeros((layers, rows), np.float32)
        for n, (i, o) in enumerate(zip(self.design.widths[:-1], self.design.widths[1:], strict=True)):
            weight[n, :o, :i] = random.standard_normal((o, i)) * np.sqrt((2.0 if n + 1 < layers else 0.2) / i)
        self.values = [latent, weight, bias]
        self.means = [np.zeros_like(v) for v in self.values[1:]]
        self.squares = [np.zeros(len(latent), np.float32), *(np.zeros_like(v) for v in self.values[1:])]
        self.gradients = [_aligned((PARTS, *v.shape)) for v in self.values]
        self.times, self.codes = np.zeros(len(latent), np.int32), np.empty(latent.shape, np.int8)
        self.upload()
        self.step, self.seconds, self.log, self._order = 0, 0.0, [], (-1, np.zeros(0, np.int64))

    def _epoch(self, epoch):
        """Order of the batches in an epoch."""
        return np.random.default_rng([self.seed, 1, epoch]).permutation(self.batches)

    def _batch(self):
        """Rows (begin, end) of the next batch. Every epoch takes each batch once, in a new order."""
        epoch, place = divmod(self.step, self.batches)
        if self._order[0] != epoch:
            self._order = epoch, self._epoch(epoch)
        size = len(self.samples) // self.batches
        return self._order[1][place] * size, (self._order[1][place] + 1) * size

    def _decay(self, steps):
        """Factor of the learning rates at the next step."""
        return 0.5 * (1 + np.cos(np.pi * self.step / steps))

    def _take_steps(self, until, steps, pool):
        """Takes steps up to number `until` of `steps`. Returns the errors of their batches, as _one_step()."""
        return [self._one_step(steps, pool) for _ in range(until - self.step)]

    def _one_step(self, steps, pool):
        """Takes one step. Returns the mean squared error of its batch before the step, on the scale 0..255."""
        begin, end = self._batch()
        part, decay = slice(begin, end), self._decay(steps)
        error = self.learn(self.samples.taken(part), (self.cell[part], self.corners), pool)
        self.step += 1
        self.move(decay, self.step, pool)
        return error / max(self.samples.share[part].sum(dtype=np.int64) / 255, TINY) * 127.5**2

    def learn(self, samples: Samples, cells: tuple[np.ndarray, np.ndarray], pool: ThreadPoolExecutor,
              slope: np.ndarray = NO_SLOPE) -> float:
        """Add the gradient of the squared error at samples to the fit's gradient. Returns that error, weighted and summed over
        components. cells: of cells_of; pool: threads; slope: float32 [M, C], derivatives by the network's outputs that replace
        those of the squared error."""
        (_, weight, bias), (cell, corners) = self.values, cells
        turned = np.ascontiguousarray(weight.transpose(0, 2, 1))
        cuts = np.linspace(0, len(samples), PARTS + 1).astype(np.int64)

        def train_part(k):
            part = slice(cuts[k], cuts[k + 1])
            return _train(samples.position[part], samples.target[part], samples.share[part], slope[part], cell[part], corners,
                          self.codes, self.design.features, self.resolutions, self.design.octaves, self.design.first_wave,
                          self.widths, weight, turned, bias, *(g[k] for g in self.gradients))

        return sum(pool.map(train_part, range(PARTS)))

    def move(self, decay: float, step: int, pool: ThreadPoolExecutor) -> None:
        """Move all parameters against their gradient and clear the gradient. decay: factor of the learning rates; step: number
        of the move, from 1; pool: threads."""
        latent = self.values[0]

        def move_part(k):
            low, high = len(latent) * k // self.threads, len(latent) * (k + 1) // self.threads
            _move_rows(low, high, self.design.features, self.gradients[0], latent, self.squares[0], self.times,
                       np.float32(LATENT_RATE * decay), WARMING, self.codes)

        list(pool.map(move_part, range(self.threads)))
        scale = np.float32(1 / (1 - MOMENTUM**step)), np.float32(1 / (1 - SQUARE_DECAY**step))
        for n in (1, 2):
            flat = [a.reshape(-1) for a in (self.values[n], self.means[n - 1], self.squares[n])]
            _adam(flat[0], self.gradients[n].reshape(PARTS, -1), *flat[1:], np.float32(NETWORK_RATE * decay), *scale)

    def forget(self) -> None:
        """Clears the optimiser's state, but not the values."""
        for array in (*self.means, *self.squares, self.times):
            array[...] = 0

    def answers(self, samples: Samples, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the network's outputs at samples, float32 [M, C] on the scale 0..255, not clipped. cells: the latents around
        the samples, of cells_of."""
        got = np.empty((len(samples), self.design.components), np.float32)

        def evaluate_block(begin):
            part = slice(begin, begin + BLOCK)
            _evaluate(samples.position[part], cells[0][part], cells[1], self.codes, self.design.features, self.resolutions,
                      self.design.octaves, self.design.first_wave, self.widths, *self.values[1:], got[part])

        over_blocks(evaluate_block, len(samples), BLOCK, self.threads)
        return got

    def upload(self) -> None:
        """Recomputes everything derived from the latents after an outside change to them."""
        _round_latents(self.values[0], self.codes, self.design.features)

    def download(self) -> None:
        """Updates values, means, squares, times and codes, if a subclass keeps them elsewhere."""

    def errors(self, exact: bool = False) -> np.ndarray:
        """Return sums over the held-out points by component, float64 [2, C]: weighted squared errors, and weights. exact:
        evaluate payload() in integers, as a decoder does, instead of in floats."""
        want, share = self.held_out.target, self.held_out.share / 255.0
        if exact:
            payload, got = self.payload(), np.empty((len(want), self.design.components), np.float32)
            for number, table in enumerate(self.tables):
                table.take_values(payload)
                rows = np.flatnonzero(self.held_out.field == number)
                got[rows] = infer(self.held_out.position[rows], table, self.threads) / 256.0
        else:
            got = self.answers(self.held_out, self.held_cells)
        error = (np.clip(got, 0, 255) - want) ** 2 * share
        return np.stack([error.sum(axis=0), share.sum(axis=0)])

    def psnr(self, exact: bool = False) -> float:
        """PSNR in dB over all judged components at the held-out points; exact as in errors()."""
        return pooled_psnr(self.errors(exact), self.judged)

    def payload(self) -> Payload:
        """The design with the present codes and parameters."""
        _, weight, bias = self.values
        sizes = list(zip(self.design.widths[:-1], self.design.widths[1:], strict=True))
        flat = join_parameters([weight[n, :o, :i] for n, (i, o) in enumerate(sizes)],
                               [bias[n, :o] for n, (_, o) in enumerate(sizes)])
        flat = np.clip(flat, -LARGEST, LARGEST)
        codes = self.codes[:, : self.design.features] >> 1
        return replace(self.design, codes=codes, halves=flat.astype(np.float16).view(np.uint16))

    def run(self, steps: int, on_look: Callable[[Fit, int], object] = lambda fit, steps: None,
            checkpoint: Path | None = None) -> Payload:
        """Train until step number `steps`, or less if the fit no longer improves, and return the payload.

        on_look(fit, steps): called LOOKS times on the way, after the PSNR at held-out points is measured; log holds {"step",
        "seconds", "train_psnr", "psnr"} of each call. checkpoint: path to which the state is written periodically, and from
        which it is read if the file exists.
        """
        if checkpoint is not None:
            self._resume(checkpoint, steps)
        begin, saved, every = time.perf_counter() - self.seconds, time.perf_counter(), max(1, steps // LOOKS)
        with ThreadPoolExecutor(self.threads) as pool:
            while self.step < steps:
                errors = self._take_steps(min(steps, (self.step // every + 1) * every), steps, pool)
                self.download()
                self.seconds = time.perf_counter() - begin
                reached = self._checked_psnr(errors)
                trained = decibels(max(float(np.mean(errors)), 1e-9))
                self.log.append({"step": self.step, "seconds": round(self.seconds, 2), "train_psnr": round(trained, 3),
                                 "psnr": round(reached, 3)})
                on_look(self, steps)
                if checkpoint is not None and (time.perf_counter() - saved > SAVE_SECONDS or self.step == steps):
                    self._save(checkpoint, steps)
                    saved = time.perf_counter()
                if self._decay(steps) < SETTLED_DECAY and self._settled():
                    break
        return self.payload()

    def _checked_psnr(self, errors):
        """psnr(). Raises InputError TXF-I58 if it, an error of the last steps or a value is not finite."""
        try:
            if np.isfinite(errors).all() and all(np.isfinite(v).all() for v in self.values):
                return self.psnr()
        except ValueError:  # values whose products are no numbers
            pass
        raise InputError("TXF-I58", "the fit has diverged", value=f"step {self.step}", allowed="finite numbers")

    def _settled(self):
        psnr = [row["psnr"] for row in self.log]
        return len(psnr) > PATIENCE and max(psnr[-PATIENCE:]) < max(psnr[:-PATIENCE]) + LEAST_GAIN

    def _identity(self, steps):
        """Text that a checkpoint must match to be resumed."""
        colours = int(self.samples.target.sum(dtype=np.int64))
        return repr((steps, self.seed, self.design, len(self.samples), colours))

    def _save(self, path, steps):
        arrays = {f"{kind}{n}": a for kind in ("values", "means", "squares") for n, a in enumerate(getattr(self, kind))}
        part = path.with_name(path.name + ".part")
        cleanup.remove(part)
        with cleanup.new_file(part) as file:
            np.savez(file, step=self.step, seconds=self.seconds, log=repr(self.log), identity=self._identity(steps),
                     times=self.times, **arrays)
        cleanup.rename_all([(part, path)])

    def _resume(self, path, steps):
        if not path.exists():
            return
        import ast
        import zipfile

        try:
            with open(path, "rb") as raw, np.load(raw) as file:
                if str(file["identity"]) != self._identity(steps):
                    raise InputError("TXF-I55", "the checkpoint belongs to another fit", value=path.name)
                for kind in ("values", "means", "squares"):
                    for n, array in enumerate(getattr(self, kind)):
                        array[...] = file[f"{kind}{n}"]
                self.times[...] = file["times"]
                self.step, self.seconds, self.log = int(file["step"]), float(file["seconds"]), ast.literal_eval(str(file["log"]))
        except (OSError, KeyError, ValueError, SyntaxError, zipfile.BadZipFile) as error:
            raise InputError("TXF-I55", f"the checkpoint cannot be read: {error}", value=path.name) from None
        self.upload()


def pooled_psnr(errors: np.ndarray, components: Sequence[int]) -> float:
    """Return the PSNR in dB over some components together. errors: float64 [2, C] as Fit.errors() returns; infinite without
    weight or error."""
    error, weight = errors[:, list(components)].sum(axis=1)
    return decibels(float(error / max(weight, TINY)))


def _aligned(shape):
    """Zeros float32 aligned to a cache line, so that a row of 16 latents occupies one line."""
    size = int(np.prod(shape))
    room = np.zeros(size + 16, np.float32)
    skip = -room.ctypes.data % 64 // 4
    return room[skip : skip + size].reshape(shape)
