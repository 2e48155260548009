"""Rate control by search: the stream that meets a byte budget or a 3D-PSNR, over grid resolution K and QP."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..codecs import codec_of
from ..decoder import decode_stream
from ..errors import InputError
from ..limits import UNLIMITED
from ..metrics.psnr_3d import SourceSamples, measure_or_warn
from ..options import DecodeOptions, EncodeOptions
from ..report import Report
from .decide.mesh import FEWEST
from .estimates.probe import VOXELS_PER_AREA
from .pipeline import Encoded, code
from .plan import OverBudget, Plan, least_bytes, plan

if TYPE_CHECKING:
    from ..scene.scene import Scene

FREE = 0  # in place of a K: the encoder chooses supports
LADDER = (64, 128, 256, 512, 1024, 1536, 2048)
FIRST_K, FIRST_QP, LAST_QP = 1024, 28, 63
FINER_BELOW, COARSER_ABOVE = 30, 38  # QPs where the next K of LADDER may beat this one; measured on bball_0001, K 256..2048
BITS_PER_QP, DECIBELS_PER_QP = 0.17, 0.42  # first guesses: log2 of attribute bytes and dB lost with each QP
LEAST_SHARE = 0.95  # of the geometry's bytes as one field, for safety: parted by components it took 1.00 to 1.23 times, 11 assets
MOST_PLANS, NEAR_QP, REPLAN_QP = 4, 2, 8  # of meshes; QPs within which one suits, and that the next is away where none did
SECONDS, SECONDS_PER_VOXEL = 0.8, 2.4e-6  # of an encode with two threads


@dataclass
class Trial:
    """One encode. made: its stream is let go of once it is not the best; psnr: dict of SourceSamples.compare, or None until asked
    for; report: warnings and dropped properties of its own."""

    made: Encoded
    report: Report
    seconds: float

    @property
    def resolution(self) -> int | None:
        return self.made.resolution

    @property
    def qp(self) -> int | None:
        return self.made.qp

    @property
    def sizes(self) -> dict:
        return self.made.sizes

    @property
    def psnr(self) -> dict | None:
        return self.made.psnr_3d

    @property
    def psnr_y(self) -> float:
        """3D-PSNR of Y in dB; infinite for a lossless one, and where there is nothing to see."""
        return math.inf if self.psnr is None or self.psnr["y"] is None else self.psnr["y"]

    def row(self) -> dict:
        """What the report says about this trial."""
        return {"resolution": self.resolution, "qp": self.qp, "bytes": self.sizes["total"],
                "psnr_y": self.psnr and self.psnr["y"], "seconds": round(self.seconds, 3)}


def encode_to_target(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """The best 3D-PSNR within options.target_bytes, or the fewest bytes with a 3D-PSNR of Y of options.target_psnr.

    scene: Scene; options: EncodeOptions with one of the two targets; report: Report. Returns the Encoded that keeps the target;
    its choices hold "search", a row per trial. Raises InputError TXF-I51 where no K and QP do, naming the best that was reached.
    """
    search = _Search(scene, options, report)
    search.refuse_hopeless()
    found = search.climb()
    rows = report.trials = [t.row() for t in search.trials]
    if found is None:
        raise search.unreachable(rows)
    found.made.choices["search"] = rows
    _add_sentences(report, found.report)
    return found.made


def _add_sentences(report, other):
    """Adds what another Report has to say to a Report."""
    report.warnings += other.warnings
    report.dropped += other.dropped
    report.remarks += other.remarks


def estimate(scene: Scene, options: EncodeOptions) -> tuple[int, float]:
    """(voxels, seconds) that encoding will need, guessed from the surface area alone."""
    assert options.resolution is not None  # its __post_init__ fills it in
    corners = scene.positions[scene.faces]
    side = float((scene.positions.max(axis=0) - scene.positions.min(axis=0)).max()) or 1.0
    edges = (corners[:, 1:] - corners[:, :1]) / side
    area = float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()) / 2
    voxels = round(min(area * VOXELS_PER_AREA * options.resolution**2, float(options.resolution) ** 3))
    seconds = SECONDS + voxels * SECONDS_PER_VOXEL + codec_of(options.codec).seconds(options)
    return max(voxels, 1), round(seconds, 1)


class _Search:
    """Trials over (K, QP); for a budget the smallest QP that fits is sought, for a quality the largest."""

    def __init__(self, scene, options, report):
        self.scene, self.options, self.report = scene, options, report
        self.budget = options.target_bytes
        self.trials: list[Trial] = []
        self._samples: SourceSamples | None = None
        self._planned: tuple[int | None, Plan | None] = (None, None)  # (K, its Plan), the latest
        self._geometry: list[int] = []

    def refuse_hopeless(self):
        """Raises what unreachable() makes where header and geometry alone are over the budget: before anything is tried. Not
        where a smaller mesh may be sent."""
        if self.budget is None or (self.options.mesh_is_free and len(self.scene.faces) >= FEWEST):
            return
        with self.report.stage("geometry"):
            header, geometry = least_bytes(self.scene, self._request(FREE, FIRST_QP))
        if header + LEAST_SHARE * geometry > self.budget:
            self._geometry.append(geometry)
            raise self.unreachable([])

    def climb(self):
        """The best Trial or None: at the supports and the mesh that the encoder chooses, where texels or a smaller mesh are among
        them, else on the ladder."""
        if self.options.rate_is_free:
            report = Report(self.report.on_progress)
            planned = self._plan(FREE, FIRST_QP, report)
            self._add_seconds(report)
            smaller = planned is None or planned.smaller_mesh
            best = None
            if smaller and self.options.mesh_is_free:
                best = self._climb_meshes()
            elif planned and (planned.one_colour or not planned.over_voxels) and self.options.support != "voxels":
                best = self.best_at(FREE, FIRST_QP)
            if best or (planned and planned.one_colour):
                _add_sentences(self.report, report)
                return best
        return self._climb_ladder()

    def _climb_meshes(self):
        """The best Trial or None where the mesh depends on the QP: it is chosen again at the QP that was found, until that stays;
        coarser, or finer for a quality, for as long as nothing meets the target."""
        qp, best = FIRST_QP, None
        for _ in range(MOST_PLANS):
            found = self.best_at(FREE, qp)
            if found and (best is None or self._better(found, best)):
                best = found
            if found and abs(found.qp - qp) <= NEAR_QP:
                break
            qp = found.qp if found else qp + (REPLAN_QP if self.budget else -REPLAN_QP)
            if not 0 <= qp <= LAST_QP:
                break
            self._planned = None, None
        return best

    def _climb_ladder(self):
        """Walks the ladder from FIRST_K to finer or coarser K for as long as that is better; the best Trial or None."""
        best = self.best_at(FIRST_K, FIRST_QP)
        if self._planned[1] and self._planned[1].one_colour:
            return best
        coarser = best.qp >= COARSER_ABOVE if best else self.budget is not None
        finer = best.qp <= FINER_BELOW if best else self.budget is None
        if not (coarser or finer):
            return best
        step, place = (-1 if coarser else 1), LADDER.index(FIRST_K)
        while 0 <= place + step < len(LADDER) and not self._hopeless():
            start = self._scaled_qp(best, LADDER[place], LADDER[place + step])
            place += step
            found = self.best_at(LADDER[place], start)
            if best and (found is None or not self._better(found, best)):
                break
            best = found
            if best and not (best.qp >= COARSER_ABOVE if step < 0 else best.qp <= FINER_BELOW):
                break
        return best

    def best_at(self, resolution, start):
        """The Trial at this K that meets the target at the least cost, or None."""
        report, tried = Report(self.report.on_progress), {}
        planned = self._plan(resolution, start, report)
        self._add_seconds(report)
        if planned is None:
            return None

        def excess(x):
            trial = self._encode(resolution, x if self.budget else LAST_QP - x)
            tried[x] = trial
            if self.budget:
                fixed = trial.sizes["total"] - trial.sizes["attributes"]
                return math.log2(max(trial.sizes["attributes"], 1) / (self.budget - fixed)) if fixed < self.budget else math.inf
            return self.options.target_psnr - self._measured(trial).psnr_y

        x = start if self.budget else LAST_QP - start
        if planned.one_colour:  # no QP changes anything
            x = x if excess(x) <= 0 else None
        else:
            x = smallest_root(excess, x, BITS_PER_QP if self.budget else DECIBELS_PER_QP)
        for trial in tried.values():
            if x is None or trial is not tried[x]:
                trial.made.data, trial.made.values = b"", []
        if x is None:
            return None
        _add_sentences(tried[x].report, report)
        return self._measured(tried[x])

    def _better(self, a, b):
        return a.psnr_y > b.psnr_y if self.budget else a.sizes["total"] < b.sizes["total"]

    def _scaled_qp(self, best, old, new):
        """Where to start at another K: bytes and quality move by about seven QP with every doubling of K."""
        at = best.qp if best else (LAST_QP if self.budget else 0)
        return min(max(at + round(7 * math.log2(new / old)), 0), LAST_QP)

    def _hopeless(self):
        """Whether what a trial needs beside its attributes is over the budget already."""
        least = min([*self._geometry, *(t.sizes["total"] - t.sizes["attributes"] for t in self.trials)])
        return self.budget is not None and least >= self.budget

    def _encode(self, resolution, qp):
        begin, report = time.perf_counter(), Report(self.report.on_progress)
        planned = self._plan(resolution, qp, report)
        assert planned is not None  # best_at() has looked
        made = code(planned.with_qp(qp), report)
        self._add_seconds(report)
        self.trials.append(Trial(made, report, time.perf_counter() - begin))
        return self.trials[-1]

    def _request(self, resolution, qp):
        return self.options.changed(target_bytes=None, target_psnr=None, resolution=resolution or None, qp=qp)

    def _plan(self, resolution, qp, report) -> Plan | None:
        """The Plan for a K, or with the encoder's choice of supports for FREE, None where its geometry is over the budget; kept
        until the next K."""
        if self._planned[0] != resolution:
            try:
                self._planned = resolution, plan(self.scene, self._request(resolution, qp), report, budget=self.budget)
            except OverBudget as over:
                self._geometry.append(over.geometry)
                self._planned = resolution, None
        return self._planned[1]

    def _measured(self, trial):
        if trial.psnr is None:
            begin, report, threads = time.perf_counter(), Report(self.report.on_progress), self.options.threads
            with report.stage("measure"):
                samples = self._samples = self._samples or SourceSamples(self.scene, threads=threads)
                texf = decode_stream(trial.made.data, DecodeOptions(threads=threads, limits=UNLIMITED), Report())
                trial.made.psnr_3d = measure_or_warn(lambda: samples.compare(texf), report)
                if trial.psnr is None and not self.budget:
                    raise InputError("TXF-I94", report.warnings[0])
            self._add_seconds(report)
            trial.seconds += time.perf_counter() - begin
        return trial

    def _add_seconds(self, report):
        for name, value in report.seconds.items():
            self.report.seconds[name] = self.report.seconds.get(name, 0.0) + value

    def unreachable(self, rows):
        """The error that names the best of what was tried."""
        if self.budget:
            geometry = min([*self._geometry, *(t.sizes["geometry"] for t in self.trials)])
            least = min(rows, key=lambda r: r["bytes"], default=None)
            best = least and {"best": least["bytes"], "resolution": least["resolution"], "qp": least["qp"]}
            return InputError("TXF-I51", f"no K and QP fit into the budget: geometry alone takes {geometry} bytes, and fewer "
                              "position bits make it smaller", value=self.budget, **(best or {"allowed": f"> {geometry}"}))
        most = max(rows, key=lambda r: r["psnr_y"])
        return InputError("TXF-I51", "no K and QP reach this 3D-PSNR", value=self.options.target_psnr,
                          best=round(most["psnr_y"], 2), resolution=most["resolution"], qp=most["qp"])


def smallest_root(excess: Callable[[int], float], start: int, slope: float, last: int = LAST_QP) -> int | None:
    """Smallest whole x in 0..last with excess(x) <= 0, or None.

    excess falls with x, at first by about `slope` a step; start: first guess. Guesses follow the line through the two latest
    values, and halve the interval once there have been five.
    """
    low, high, known, x = -1, last + 1, [], start
    while high - low > 1:
        x = min(max(x, low + 1), high - 1)
        value = excess(x)
        known.append((x, value))
        if value <= 0:
            high = x
        else:
            low = x
        x = (low + high) // 2 if len(known) >= 5 else _next_guess(known, slope, low, high)
    return high if high <= last else None


def _next_guess(known, slope, low, high):
    """Where the line through the latest two values (or the first with the given slope) meets zero."""
    x, value = known[-1]
    if math.isinf(value):
        return high - 1 if value > 0 else low + 1
    if len(known) > 1 and math.isfinite(known[-2][1]):
        run, rise = x - known[-2][0], known[-2][1] - value
        if run and rise / run > 0.1 * slope:
            slope = rise / run
    return math.ceil(x + value / slope)
