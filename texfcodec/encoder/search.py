"""Rate control by search: the stream that meets a byte budget or a PSNR, over the QP.

A plan makes every other choice, at the price of a byte that the QP sets. So there is one dimension: a first QP is guessed from
the bytes that the supports of a plan are expected to take, values are coded there, and the line through the trials leads to the
next QP, between whole ones if the codec has such. A plan, which is a Filled, is made again if the QP has gone far from the plan's
own; caches keep everything that does not depend on the QP.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..bitstream.stream import Stream, write_stream
from ..bitstream.values import header_values
from ..core.colour_error import decibels
from ..decoder import decode_stream
from ..errors import InputError
from ..geometry.surface import make_surface
from ..limits import UNLIMITED
from ..metrics.psnr_3d import SAMPLES, SourceSamples
from ..metrics.views import KeptViews, ViewSettings
from ..options import DecodeOptions, EncodeOptions
from ..render.environment import DAYLIGHT
from ..report import Report
from .caches import Cache, Caches
from .encode import Encoder
from .faces import SentSurface
from .mesh.candidates import FEWEST
from .place.geometry_units import code_geometry, geometry_bytes
from .place.stage import OverBudget
from .requests import Requests
from .values.map_planes import groups_of
from .write import Encoded, write

if TYPE_CHECKING:
    from ..scene.scene import Scene
    from .stages import Filled
    from .supports.choice import Supports

FIRST_QP, LAST_QP = 28, 63
GUESSED_QPS = 14, 50  # a first guess is not beyond
FINER_RATES = ((20, "r06"), (22, "r05"))  # up to these QPs K may be as fine as that of the rate
BITS_PER_QP, DECIBELS_PER_QP = 0.18, 0.45  # first guesses: log2 of attribute bytes and dB lost with each QP
LEAST_SHARE = 0.95  # of the geometry's bytes as one field, for safety: parted by components it took 1.00 to 1.23 times, 11 assets
MESH_SHARE = 0.45  # of a stream's bytes that a mesh takes which was chosen by its price: 0.36 to 0.55, two scans, QP 24 to 33
# dB over what is expected of colours at FIRST_QP, medians of six assets, pictures with their smaller mesh; dB a QP from there
GAINS, GUESSED_DECIBELS = {"surface": 1.0, "flat": 0.0, "lit": 0.8}, 0.5
UNUSED, USED = 0.03, 0.985  # share of a budget that may stay unused, and that is aimed at
OVER, AIM_OVER = 0.145, 0.07  # dB over the PSNR that are accepted, and that are aimed at
REACH = (3.0, 4.5, 9.0, 9.0, 9.0, math.inf)  # QPs from that of the first, second, ... plan within which it suits
CLOSE = 4.5  # QPs between plans of which one meets the target and one does not: another in between would be like one of them
MOST_TRIALS, MOST_STEP, CLOSED = 9, 8.0, 0.03  # of one plan; QPs at once; QPs between which no other is tried
ENOUGH = 7  # trials in all, from which on the best that meets the target is taken, as near as it may be
LAST_TRIALS = 3  # that the plan of the best may have beyond those
GAP, JUMP = 0.3, 2.5  # QPs between which none is tried where the target is as far off as from so many QPs: a unit became exact
SEARCH_SAMPLES = 250_000  # of 3D-PSNR: differences of 0.01 dB are seen
VIEWS, SIZE = 8, 512


@dataclass(kw_only=True)
class Trial:
    """One encode. qp: of the values, not always whole; psnr: of Y in dB, None if no pixel or point is visible; psnr_of: as
    target_psnr_of of EncodeOptions; report: its own warnings and dropped properties; seconds: of coding and measuring."""

    encoded: Encoded
    qp: float
    position_bits: int
    psnr: float | None
    psnr_of: str
    report: Report
    seconds: float

    @property
    def bytes(self) -> int:
        """Size of the stream."""
        return self.encoded.sizes["total"]

    def row(self) -> dict:
        """Return the row of the report for this trial."""
        psnr = None if self.psnr is None or math.isinf(self.psnr) else round(self.psnr, 4)
        return {"resolution": self.encoded.resolution, "qp": round(self.qp, 3), "bytes": self.bytes, "psnr_y": psnr,
                "psnr_of": self.psnr_of, "faces": self.encoded.counts["faces"], "position_bits": self.position_bits,
                "seconds": round(self.seconds, 3)}


def encode_to_target(scene: Scene, options: EncodeOptions, report: Report) -> Encoded:
    """Search the QP for the best stream within a byte budget, or for the smallest stream with a PSNR of Y.

    Parameters
    ----------
    scene : Scene
        The source.
    options : EncodeOptions
        With one of target_bytes and target_psnr.
    report : Report
        Receives seconds by stage, a row per trial, and the messages of the best trial.

    Returns
    -------
    Encoded
        The stream that keeps the target; its choices["search"] holds a row per trial.

    Raises
    ------
    InputError
        TXF-I51 if no QP keeps the target, naming the best value; otherwise as of encode_scene().
    LimitError, SupportError
        As of encode_scene().
    """
    search = _Search(scene, options, report)
    search.refuse_hopeless()
    search.run()
    rows = report.trials = [trial.row() for trial in search.trials]
    if search.best is None:
        raise search.unreachable(rows)
    encoded = search.best.encoded
    encoded.choices["search"] = rows
    for name in ("warnings", "dropped", "remarks"):
        getattr(report, name).extend(getattr(search.best.report, name))
    return encoded


def least_bytes(scene: Scene, options: EncodeOptions) -> tuple[int, int]:
    """Return (bytes of the header, bytes of the geometry) of the smallest coding of a scene's own mesh: a single field over
    voxels, at the options' position bits. This is known before any colour is read."""
    surface = SentSurface(make_surface(scene, Requests.of(options).prepare))
    geometry, _ = code_geometry(surface, np.zeros(len(surface.faces), np.int64), {})
    header = Stream(header_values([], surface, geometry, 1, groups_of(set(), False)))
    return len(write_stream(header)[0]), geometry_bytes(geometry)


@dataclass(frozen=True)
class _Target:
    """The target of a search: a budget of bytes, or a PSNR. A place is a QP, reversed for a PSNR, so that larger places always
    meet the target."""

    budget: int | None
    psnr: float

    def place(self, qp: float) -> float:
        """Return a QP's place on the axis of the search (the QP for a budget, LAST_QP - qp for a PSNR), or the QP of a place."""
        return qp if self.budget else LAST_QP - qp

    @property
    def slope(self) -> float:
        """Rough fall of the excess with each place."""
        return BITS_PER_QP if self.budget else DECIBELS_PER_QP

    def is_met(self, trial: Trial) -> bool:
        """Return whether a trial keeps the target: no more bytes than the budget, or at least the PSNR."""
        return trial.bytes <= self.budget if self.budget else _psnr(trial) >= self.psnr

    def is_near(self, trial: Trial) -> bool:
        """Return whether a trial keeps the target and is so near to it (UNUSED of a budget, OVER a PSNR) that the search may
        end."""
        near = trial.bytes >= (1 - UNUSED) * self.budget if self.budget else _psnr(trial) <= self.psnr + OVER
        return near and self.is_met(trial)

    def excess(self, trial: Trial) -> float:
        """Return by how much a trial misses the aim, negative on the safe side: log2 of its attribute bytes over those aimed at,
        or dB under the PSNR aimed at. The result is bounded by MOST_STEP places."""
        if self.budget:
            fixed, room = trial.bytes - trial.encoded.sizes["attributes"], USED * self.budget
            excess = math.log2(max(trial.encoded.sizes["attributes"], 1) / (room - fixed)) if fixed < room else math.inf
        else:
            excess = self.psnr + AIM_OVER - _psnr(trial)
        return min(max(excess, -MOST_STEP * self.slope), MOST_STEP * self.slope)

    def is_better(self, trial: Trial, other: Trial | None) -> bool:
        """Return whether a trial is better than another, both of which meet the target: it has more bytes of the budget, or
        fewer bytes at the PSNR. other: None if there is no other."""
        if other is None:
            return True
        return trial.bytes > other.bytes if self.budget else trial.bytes < other.bytes


def _psnr(trial):
    return math.inf if trial.psnr is None else trial.psnr


@dataclass(eq=False)
class _Line:
    """A plan and its trials. qp: the QP that the plan was made for; planning: Report of the plan; tried: (place, excess) in
    order."""

    plan: Filled
    qp: int
    planning: Report
    tried: list[tuple[float, float]] = field(default_factory=list)

    @property
    def has_met(self) -> bool:
        """True if a trial met the target."""
        return any(excess <= 0 for _, excess in self.tried)


class _Search:
    """Trials over the QP: along one plan for as long as it suits, then along another. Meshes and supports differ from plan to
    plan, so the target may lie between the results of two plans: then the search goes on with the plan that meets it."""

    def __init__(self, scene, options, report):
        self.scene, self.options, self.report = scene, options, report
        self.target = _Target(options.target_bytes, options.target_psnr or 0.0)
        self.trials: list[Trial] = []
        self.best: Trial | None = None
        self._lines: list[_Line] = []
        self._encoder = Encoder(scene=scene, caches=Caches.of_search())
        self._geometry, self._least_qp = [], 0
        self._slope = self.target.slope
        self._measure = _measure_of(scene, options)

    def refuse_hopeless(self):
        """Raise the error of unreachable() before any trial if header and geometry alone are over the budget. Do nothing if a
        smaller mesh may be sent."""
        if self.target.budget is None or (self.options.mesh_is_free and len(self.scene.faces) >= FEWEST):
            return
        with self.report.stage("geometry"):
            header, geometry = self._least_bytes
        if header + LEAST_SHARE * geometry > self.target.budget:
            self._geometry.append(geometry)
            raise self.unreachable([])

    @cached_property
    def _least_bytes(self):
        return least_bytes(self.scene, self._request(FIRST_QP))

    def run(self):
        """Fill trials, and set best if a trial meets the target."""
        qp = self._first_qp()
        while True:
            report = Report(self.report.on_progress)
            planned = self._plan(round(qp), report)
            self.report.take_seconds(report)
            if planned is None:  # its geometry takes the whole budget
                if round(qp) == LAST_QP:
                    return
                self._least_qp = round(qp) + 1
                qp = min(round(qp) + MOST_STEP, LAST_QP)
                continue
            reach = REACH[min(len(self._lines), len(REACH) - 1)]
            self._lines.append(_Line(planned, round(qp), report))
            further = self._along(self._lines[-1], qp, reach)
            if further is None and self.best is None and not planned.is_uniform:
                further = self._easier(round(qp))
            elif further is not None and (settled := self._settled()):
                self._along(settled, self._following(settled), math.inf, max(ENOUGH, len(self.trials) + LAST_TRIALS))
                return
            if further is None:
                return
            qp = further

    def _settled(self):
        """Return the line to go on with if one of two plans close to each other meets the target and the other misses it; None if
        another plan is needed."""
        met, missed = ([line for line in self._lines if line.has_met is is_met] for is_met in (True, False))
        near = [a for a in met for b in missed if abs(a.qp - b.qp) <= CLOSE]
        return min(near, key=lambda line: min(-excess for _, excess in line.tried if excess <= 0)) if near else None

    def _following(self, line):
        """Return the QP to try next on a line; None if none is left."""
        place = next_place(line.tried, self._slope, not line.plan.price.planes.has_fractions)
        return None if place is None else max(self.target.place(place), self._least_qp)

    def _along(self, line, qp, reach, enough=ENOUGH):
        """Try QPs on a line. Return a QP that another plan suits better; None if the search is done. reach: QPs around its own
        that the plan suits; enough: trials in all."""
        if qp is not None and not line.plan.price.planes.has_fractions:
            qp = round(qp)
        while qp is not None and len(line.tried) < MOST_TRIALS:
            trial = self._encode(line.plan, qp, line.planning)
            is_enough = self.best is not None and len(self.trials) >= enough
            if line.plan.is_uniform or is_enough or self.target.is_near(trial):
                return None
            line.tried.append((self.target.place(qp), self.target.excess(trial)))
            self._slope = slope_of(line.tried, self._slope)
            qp = self._following(line)
            if qp is None:
                return None
            others = [abs(qp - other.qp) for other in self._lines if other.has_met and other is not line]
            if abs(qp - line.qp) > min([reach, *others]):
                return self._between(qp)
        return None

    def _easier(self, qp):
        """Return a QP whose plan is more likely to meet the target than the plan of this QP; None if there is none."""
        place = self.target.place(qp)
        return self.target.place(min(place + MOST_STEP, LAST_QP)) if place < LAST_QP else None

    def _between(self, qp):
        """Return the QP for another plan. If trials, of any plan, have missed and met the target, it lies between the nearest of
        both."""
        known = [(self.target.excess(trial), trial.qp) for trial in self.trials]
        missed = min((point for point in known if point[0] > 0), default=None)
        met = max((point for point in known if point[0] <= 0), default=None)
        if not (missed and met):
            return qp
        share = min(max(missed[0] / (missed[0] - met[0]), 0.2), 0.8)
        return missed[1] + share * (met[1] - missed[1])

    def _first_qp(self):
        """Return a QP that is likely to meet the target, from the bytes or the error expected of supports at FIRST_QP."""
        report = Report(self.report.on_progress)
        supports = self._encoder.supported(self._request(FIRST_QP), report).candidates[0].value
        self.report.take_seconds(report)
        if not supports.attributes or not supports.mse or not supports.colour_mse:
            return FIRST_QP
        qp = FIRST_QP + (self._by_bytes(supports, self.target.budget) if self.target.budget else self._by_psnr(supports))
        return FIRST_QP if abs(qp - FIRST_QP) < 1 else min(max(qp, GUESSED_QPS[0]), GUESSED_QPS[1])

    def _by_bytes(self, supports: Supports, budget: int) -> float:
        """Return the offset to FIRST_QP, from the bytes that attributes take there and the bytes that the budget leaves for
        them."""
        left = budget - sum(self._least_bytes)
        if self.options.mesh_is_free and not supports.plans:
            left = max(left, (1 - MESH_SHARE) * budget)
        return math.log2(supports.attributes / max(left, 0.1 * budget)) / BITS_PER_QP

    def _by_psnr(self, supports: Supports) -> float:
        """Return the offset to FIRST_QP, from the dB that are expected there."""
        of = self.options.target_psnr_of
        mse = supports.mse if of == "lit" else supports.colour_mse
        return (decibels(mse or 1.0) + GAINS[of] - self.target.psnr) / GUESSED_DECIBELS

    def _encode(self, planned, qp, planning):
        """Return the Trial of a plan at a QP, and keep it if it is the best. planning: Report of the plan."""
        begin, report = time.perf_counter(), Report(self.report.on_progress)
        encoded = write(planned.between(qp), report)
        with report.stage("measure"):
            texf = _decoded(encoded, self.options.threads)
            psnr = self._measured(texf, encoded, report)
        self.report.take_seconds(report)
        for name in ("warnings", "dropped", "remarks"):
            setattr(report, name, [*getattr(planning, name), *getattr(report, name)])
        trial = Trial(encoded=encoded, qp=qp, position_bits=planned.surface.cube.position_bits, psnr=psnr,
                      psnr_of=self.options.target_psnr_of, report=report, seconds=time.perf_counter() - begin)
        self.trials.append(trial)
        if self.target.is_met(trial) and self.target.is_better(trial, self.best):
            self.best = trial
        for other in self.trials:
            if other is not self.best:
                other.encoded.data, other.encoded.values = b"", []
        return trial

    def _measured(self, texf, encoded, report):
        """Return the PSNR of Y in dB, infinite for a lossless stream; None, with a warning, if no pixel or point is visible."""
        try:
            quality = self._measure(texf)
        except InputError as error:
            if not self.target.budget or error.code not in ("TXF-I94", "TXF-I95"):
                raise
            report.warnings.append(error.message)
            return None
        if self.options.target_psnr_of == "surface":
            encoded.psnr_3d = quality
        return math.inf if quality["y"] is None else quality["y"]

    def _request(self, qp):
        request = self.options.without_target()
        rate = next((rate for most, rate in FINER_RATES if qp <= most), request.rate)
        return request.changed(qp=qp, **({"rate": rate} if request.rate_is_free else {}))

    def _plan(self, qp, report) -> Filled | None:
        """Return the plan for a QP; None if its geometry is over the budget."""
        try:
            return self._encoder.filled(self._request(qp), report, budget=self.target.budget)
        except OverBudget as over:
            self._geometry.append(over.geometry)
            return None

    def unreachable(self, rows):
        """Return the error TXF-I51 that no QP meets the target; it names the best trial. rows: of Trial.row()."""
        if self.target.budget:
            geometry = min([*self._geometry, *(t.encoded.sizes["geometry"] for t in self.trials)])
            least = min(rows, key=lambda r: r["bytes"], default=None)
            best = least and {"best": least["bytes"], "resolution": least["resolution"], "qp": least["qp"]}
            return InputError("TXF-I51", f"no QP meets the budget: geometry alone takes {geometry} bytes; lower --position-bits",
                              value=self.target.budget, **(best or {"allowed": f"> {geometry}"}))
        most = max(rows, key=lambda r: r["psnr_y"] or math.inf)
        return InputError("TXF-I51", f"no QP reaches this PSNR of {most['psnr_of']}", value=self.target.psnr,
                          best=round(most["psnr_y"], 2), resolution=most["resolution"], qp=most["qp"])


def _measure_of(scene, options):
    """Return the function that measures the PSNR of Y of a Texf for a search: {"y", ...} in dB. It prepares the source at its
    first call, and keeps that."""
    cache, threads = Cache(), options.threads
    if options.target_psnr_of == "surface":
        samples = SAMPLES if options.measure else SEARCH_SAMPLES
        source = lambda: SourceSamples(scene, samples, threads)
        return lambda texf: cache.get("samples", source).compare(texf)
    settings = ViewSettings(environment=DAYLIGHT if options.target_psnr_of == "lit" else None)
    views = lambda: KeptViews(scene, VIEWS, SIZE, settings)
    return lambda texf: cache.get("views", views).compare(texf, threads)["psnr"]


def _decoded(encoded, threads):
    """Return the Texf of a stream, with the values that the encoder has from its mirror of the decoder."""
    known = lambda values, group: group.join(encoded.values[values["field_index"]])
    return decode_stream(encoded.data, DecodeOptions(threads=threads, limits=UNLIMITED), Report(), known)


def slope_of(tried: list[tuple[float, float]], slope: float) -> float:
    """Return the slope that predicts the next step of the search: the fall in excess per place between the latest two trials,
    but not far from a likely slope. tried: (place, excess) in order, of _Target.place() and excess(); slope: the likely one."""
    if len(tried) < 2 or abs(tried[-1][0] - tried[-2][0]) < 0.5:
        return slope
    own = (tried[-2][1] - tried[-1][1]) / (tried[-1][0] - tried[-2][0])
    return min(max(own, 0.4 * slope), 2.5 * slope)


def next_place(tried: list[tuple[float, float]], slope: float, whole: bool = False) -> float | None:
    """Return the place to try next, in 0..LAST_QP: where the excess over the target may be 0; None if nothing is left to try.

    tried: (place, excess) of the trials in order; a place is a QP, or LAST_QP less the QP; excess falls with place, at first by
    about `slope`; whole: whether places are whole numbers; the result is then the first whose excess is not above 0.
    """
    low = max((point for point in tried if point[1] > 0), default=None)
    high = min((point for point in tried if point[1] <= 0), default=None)
    if low and high:
        width = high[0] - low[0]
        closed = GAP if low[1] - high[1] > JUMP * slope else CLOSED
        if width <= (1 if whole else closed):
            return None
        share = low[1] / (low[1] - high[1])
        share = 0.5 if len(tried) > 4 and len(tried) % 2 else min(max(share, 0.1), 0.9)
        place = low[0] + share * width
        return min(max(math.ceil(place), low[0] + 1), high[0] - 1) if whole else place
    place, excess = tried[-1]
    if len(tried) > 2 and excess == tried[-2][1] == tried[-3][1] and abs(excess) < MOST_STEP * slope:
        return None  # no QP changes anything any more
    step = min(max(excess / slope, -MOST_STEP), MOST_STEP)
    following = min(max(place + step, 0), LAST_QP)
    following = math.ceil(following) if whole else following
    return None if abs(following - place) < CLOSED else following
