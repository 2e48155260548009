"""Runs the settings of accuracy_knobs.py on one asset, again and again, and keeps a line of each run."""

import itertools
import json
import math
import statistics
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass

from texfcodec.api import decode, encode_to_result
from texfcodec.encoder.dry_run import estimate
from texfcodec.encoder.encode import Encoder
from texfcodec.encoder.values import source_field
from texfcodec.metrics.psnr_3d import SourceSamples
from texfcodec.metrics.views import compare_views
from texfcodec.options import DecodeOptions, EncodeOptions
from texfcodec.report import Report
from tools.bench.accuracy_knobs import REFERENCE_SAMPLES, REFERENCE_SIZE, REFERENCE_VIEWS, TEXELS, VOXELS, Place

PROCESSOR, WALL = "processor", "wall"
SPENT = 12.0  # processor seconds after which a setting is not run again
SEEDS = 3  # in each run of 3D-PSNR with so many points
IMAGE_VIEWS, IMAGE_SIZE = 8, 1024  # of image PSNR, where a knob is judged by it
USUAL_K, SMALL_K, MANY_VOXELS = 1024, 512, 2_000_000  # K at which voxels are tried: the small one where the usual has too many
WARM_K = 128


def place_of(scene, threads=1, neural=False, quick=False):
    """The Place of a scene: over texels where the encoder by itself puts most faces there; quick: with half the K."""
    options = EncodeOptions(threads=threads)
    supports = Encoder(scene=scene).supported(options, Report()).candidates[0].value
    planar = sum(len(plan.group.faces) for plan in supports.plans)
    k = SMALL_K if estimate(scene, EncodeOptions(resolution=USUAL_K))[0] > MANY_VOXELS else USUAL_K
    k = k // 2 if quick else k
    side = max((max(texture.image.shape[:2]) for texture in scene.textures), default=0)
    return Place(TEXELS if 2 * planar > len(scene.faces) else VOXELS, k, side, neural)


@contextmanager
def transfer_density(density):
    """The transfer's most samples per voxel edge, for a while; None changes nothing."""
    usual, fitted = dict(source_field.TRANSFER_DENSITY), source_field.FITTED_DENSITY
    if density is not None:
        source_field.TRANSFER_DENSITY.update(dict.fromkeys(usual, density))
        source_field.FITTED_DENSITY = density
    try:
        yield
    finally:
        source_field.TRANSFER_DENSITY.update(usual)
        source_field.FITTED_DENSITY = fitted


def reference_of(quick=False):
    """(views, pixels a side, samples) of what the metrics are compared with."""
    if quick:
        return REFERENCE_VIEWS // 2, REFERENCE_SIZE // 4, REFERENCE_SAMPLES // 8
    return REFERENCE_VIEWS, REFERENCE_SIZE, REFERENCE_SAMPLES


class Bench:
    """Runs settings on one scene. samples: of 3D-PSNR; quick: smaller references for the metrics."""

    def __init__(self, scene, place, samples, threads=1, quick=False):
        self.scene, self.place, self.threads, self.warm, self._made = scene, place, threads, set(), {}
        self.samples = SourceSamples(scene, samples, threads)
        self.reference = reference_of(quick)

    def run(self, setting, turn):
        """One run: {"wall", "processor", ...} in seconds; of an encode also "bytes", "geometry" and, on the first turn, "psnr_y"
        and "image_y" (None: lossless, or not asked for); of a metric "errors", its dB off the reference's."""
        if setting["kind"] == "encode":
            return self._encode(setting, turn)
        return self._views(setting) if setting["kind"] == "views" else self._samples(setting, turn)

    def _encode(self, setting, turn):
        options = dict(setting["options"])
        density, threads = options.pop("density", None), options.pop("threads", self.threads)
        self._warm_up(options, density)
        with transfer_density(density):
            made, seconds = timed(encode_to_result, self.scene, EncodeOptions(**options, threads=threads))
        run = seconds | {"bytes": made.sizes["total"], "geometry": made.sizes["geometry"]}
        if turn:
            return run
        texf = self._decoded(made)
        image = compare_views(self.scene, texf, IMAGE_VIEWS, IMAGE_SIZE, threads=self.threads) if setting.get("image") else None
        return run | {"psnr_y": self.samples.compare(texf)["y"], "image_y": image and image["psnr"]["y"]}

    def _warm_up(self, options, density):
        """The kernels of this kind of setting are loaded before it is timed."""
        kind = ("resolution" in options, *map(options.get, ("codec", "support", "effort", "refine", "max_error")))
        if kind in self.warm:
            return
        self.warm.add(kind)
        small = {"refine_iterations": 1, "steps": 1} if options.get("codec") else {"refine_iterations": 1}
        small |= {"resolution": WARM_K} if "resolution" in options else {}
        with transfer_density(density):
            encode_to_result(self.scene, EncodeOptions(**options | small, threads=self.threads))

    def _decoded(self, made):
        return decode(made.data, DecodeOptions(threads=self.threads))

    def _once(self, name, make):
        """What the metrics' runs share: the stream at home, and each reference."""
        if name not in self._made:
            self._made[name] = make()
        return self._made[name]

    def _stream(self):
        made = self._once("stream", lambda: encode_to_result(self.scene, EncodeOptions(**self.place.base(self.place.home),
                                                                                       threads=self.threads)))
        return self._once("texf", lambda: self._decoded(made))

    def _views(self, setting):
        views, size, _ = self.reference

        def psnr(views, size):
            return compare_views(self.scene, self._stream(), views, size, threads=self.threads)["psnr"]["y"]

        self._once("warm", lambda: psnr(1, 64))
        reference = self._once("views", lambda: psnr(views, size))
        found, seconds = timed(psnr, setting["views"], setting["size"])
        return seconds | {"errors": _errors([found], reference)}

    def _samples(self, setting, turn):
        texf = self._stream()

        def psnr(number, seed):
            return SourceSamples(self.scene, number, self.threads, seed).compare(texf)["y"]

        reference = self._once("samples", lambda: psnr(self.reference[2], 10**6))
        found, seconds = timed(lambda: [psnr(setting["samples"], SEEDS * turn + i) for i in range(SEEDS)])
        return {clock: round(value / SEEDS, 4) for clock, value in seconds.items()} | {"errors": _errors(found, reference)}


def _errors(found, reference):
    """dB that values are off; none where one of them is lossless."""
    return [] if reference is None or None in found else [round(value - reference, 5) for value in found]


def timed(call, *arguments):
    """(what call(*arguments) returns, {"wall", "processor"} seconds that it took)."""
    wall, processor = time.perf_counter(), time.process_time()
    made = call(*arguments)
    return made, {PROCESSOR: round(time.process_time() - processor, 4), WALL: round(time.perf_counter() - wall, 4)}


@dataclass
class Measured:
    """A setting and its runs. seconds: {clock: (median, least, most)}; bytes: of the whole stream; psnr_y, image_y: dB, infinite
    where lossless, None where it was not measured; errors: of a metric, dB."""

    setting: dict
    seconds: dict
    runs: int
    bytes: int = 0
    geometry: int = 0
    psnr_y: float | None = None
    image_y: float | None = None
    errors: tuple = ()

    @property
    def spread(self):
        """The slowest run's wall seconds over the fastest's, less 1; None of one run."""
        _, least, most = self.seconds[WALL]
        return most / max(least, 1e-9) - 1 if self.runs > 1 else None


def measured_of(setting, runs):
    """Measured of the runs of a setting."""
    seconds = {clock: [run[clock] for run in runs] for clock in (PROCESSOR, WALL)}
    seconds = {clock: (statistics.median(values), min(values), max(values)) for clock, values in seconds.items()}
    first = runs[0]
    if setting["kind"] != "encode":
        return Measured(setting, seconds, len(runs), errors=tuple(error for run in runs for error in run["errors"]))
    image = None if not setting.get("image") else math.inf if first["image_y"] is None else first["image_y"]
    return Measured(setting, seconds, len(runs), first["bytes"], first["geometry"],
                    math.inf if first["psnr_y"] is None else first["psnr_y"], image)


def key_of(setting):
    """A setting as text, by which it is known again."""
    return json.dumps(setting, sort_keys=True)


def run_settings(settings, bench, cache, conditions, repeats):
    """{key_of(setting): Measured}. All settings are run once, then all again, so that a busy spell of the machine does not meet
    one of them alone; one that has taken SPENT is not run again. Runs that a line of the file `cache` has under these conditions
    are not repeated. conditions: JSON-ready dict of what else the figures depend on; bench: function that returns the Bench."""
    settings = {key_of(setting): setting for setting in settings}
    runs = {key: found for key, found in read_runs(cache, conditions).items() if key in settings}
    todo = list(itertools.product(range(repeats), settings.items()))
    for number, (turn, (key, setting)) in enumerate(todo, 1):
        known = runs.setdefault(key, [])
        if len(known) > turn or sum(run[PROCESSOR] for run in known) * (SEEDS if setting["kind"] == "samples" else 1) > SPENT:
            continue
        known.append(bench().run(setting, len(known)))
        with open(cache, "a", encoding="utf-8") as file:
            file.write(json.dumps({**conditions, "setting": setting, "run": known[-1]}) + "\n")
        print(f"[{number}/{len(todo)}] {cache.stem}: {key}: {known[-1][PROCESSOR]:.2f} s", file=sys.stderr, flush=True)
    return {key: measured_of(setting, runs[key]) for key, setting in settings.items()}


def known_place(cache, conditions, make):
    """The Place that the file `cache` names under these conditions, or what make() returns, which is then written there."""
    setting = {"kind": "place"}
    known = read_runs(cache, conditions).get(key_of(setting))
    if known:
        return Place(**known[0])
    place = make()
    with open(cache, "a", encoding="utf-8") as file:
        file.write(json.dumps({**conditions, "setting": setting, "run": vars(place)}) + "\n")
    return place


def read_runs(cache, conditions):
    """{key: its runs} of the lines with these conditions; a line that was cut off is passed over, and ended."""
    text, runs = cache.read_text(encoding="utf-8") if cache.exists() else "", {}
    if text and not text.endswith("\n"):
        with open(cache, "a", encoding="utf-8") as file:
            file.write("\n")
    for line in text.splitlines():
        try:
            line = json.loads(line)
        except ValueError:
            continue
        if all(line.get(k) == v for k, v in conditions.items()):
            runs.setdefault(key_of(line["setting"]), []).append(line["run"])
    return runs
