"""Cases of what the encoder fits: filter, surface fit, inverse rendering, 3DNTC, on systems that are singular and at rates that
diverge."""

from concurrent.futures import ThreadPoolExecutor
from unittest.mock import patch

import numpy as np
from shapes import scene_of

from conformance.reference.filter import filter_stage
from texfcodec.codecs.neural import fit as neural_fit
from texfcodec.codecs.neural.fit_samples import Samples
from texfcodec.codecs.neural.payload import Level, Payload, Tables
from texfcodec.codecs.raht.transform import filter as filter_room
from texfcodec.codecs.raht.transform.octree import Octree
from texfcodec.codecs.raht.transform.quantise import step_of
from texfcodec.encoder.optimise import inverse_render
from texfcodec.encoder.optimise.surface_fit import FieldSurface, fit_surface
from texfcodec.errors import InputError
from texfcodec.field.grid import build_brick_map
from texfcodec.field.morton import decode_morton, encode_morton
from texfcodec.field.samples import surface_samples
from texfcodec.field.voxelise import voxelise
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_BLEND
from tools.proof.stability.case import Case, Draws
from tools.proof.stability.transform import hard_keys, values_of

GROUP = "Fits of the encoder"
BITS = 8
CONTENTS = ("constant", "checkerboard", "single outlier", "white noise")


def one_by_one(jobs: list) -> list:
    """Runs jobs alone."""
    return [job() for job in jobs]


def side_by_side(jobs: list) -> list:
    """Runs jobs in three threads."""
    with ThreadPoolExecutor(3) as pool:
        return list(pool.map(lambda job: job(), jobs))


def filter_fit(draw: Draws) -> float:
    """By how much the root mean square error of a component grows, in half ulps; infinite where the stage is another one with
    threads or the filter is not the oracle's."""
    keys, depth = hard_keys(draw)
    if depth == 13 or len(keys) > 600:
        return 0.0  # the oracle looks at every voxel
    components, qp = draw.pick((1, 3)), draw.integer(0, 63)
    original = values_of(draw.pick(CONTENTS), keys, components, draw)
    mean = values_of(draw.pick(CONTENTS), keys, components, draw)
    mean = (original + (mean.astype(np.int64) - original) * draw.integer(0, 16) // 16).astype(np.int32)
    rings = filter_room.rings_of(Octree(keys, depth))
    steps = np.array([step_of(qp)] * components, np.int64)
    with patch.object(filter_room.VoxelRings, "pieces", draw.pick((1 << 13, 5))):
        stages = [filter_room.fit_stage(rings, mean, original, steps, 1e9, run) for run in (one_by_one, side_by_side)]
        if (stages[0] is None) != (stages[1] is None):
            return np.inf
        if stages[0] is None:
            return 0.0
        taps = [filter_room.taps_of(stage) for stage in stages]
        after = filter_room.apply_stage(stages[0], rings, mean, steps, side_by_side)
    voxels = [tuple(v) for v in decode_morton(keys).tolist()]
    naive = filter_stage(dict(zip(voxels, mean.tolist(), strict=True)), stages[0].mask, taps[0], steps.tolist(), 0)
    if taps[0] != taps[1] or after.tolist() != list(naive.values()):
        return np.inf
    rms = lambda values: np.sqrt(((values.astype(np.float64) - original) ** 2).mean(axis=0))
    return float((rms(after) - rms(mean)).max() / 0.5)


def field_surface(draw: Draws) -> tuple[FieldSurface, np.ndarray]:
    """(A field of a few faces, its start): copies of a face, voxels that no sample sees, lines, one colour, alpha 0."""
    resolution, rng = draw.integer(1, 8), draw.generator()
    lattice = draw.integers((6, 3), 0, (1 << BITS) - 1)
    lattice[:, 2] //= draw.pick((1, 8, 256))
    faces = np.concatenate([draw.integers((3, 3), 0, 5), np.tile(draw.integers((1, 3), 0, 5), (draw.integer(0, 20), 1))])
    colours = np.column_stack([rng.random((6, 3)), np.ones(6)])
    if draw.pick((True, False)):
        colours[:] = colours[0]
    scene = scene_of(lattice, faces, colours)
    if draw.pick((True, False, False)):
        scene.materials[0].alpha_mode = ALPHA_BLEND
        scene.corner_color[draw.integer(0, len(faces) - 1) :, :, 3] = 0
    keys, _ = voxelise(lattice, faces, BITS, resolution)
    unseen = encode_morton(rng.integers(0, resolution, (draw.integer(0, 30), 3)))
    keys = np.unique(np.concatenate([keys, unseen]))
    surface = FieldSurface(lattice, faces, pack_source(scene), BITS, resolution, keys, build_brick_map(keys))
    start = np.full((len(keys), 3), draw.real(0, 255)) if draw.pick((True, False)) else rng.uniform(0, 255, (len(keys), 3))
    return surface, start.astype(np.float32)


def error_on_samples(surface: FieldSurface, colour: np.ndarray) -> float:
    """Root mean square error in levels at the samples of the fit, by a dictionary of voxels and in binary64."""
    rank = {tuple(v): i for i, v in enumerate(decode_morton(surface.keys).tolist())}
    total = weight = 0.0
    for points, face, bary, share in surface_samples(surface.lattice, surface.faces, BITS, surface.resolution, 2):
        rgba = sample_source(surface.source, face, bary).astype(np.float64)
        for x, wanted, area in zip(points - 0.5, rgba, share * rgba[:, 3] / 255, strict=True):
            base, got, held = np.floor(x), np.zeros(3), 0.0
            for corner in np.ndindex(2, 2, 2):
                at = rank.get(tuple((base + corner).astype(int).tolist()))
                if at is not None:
                    w = float(np.where(corner, x - base, 1 - (x - base)).prod())
                    got, held = got + w * colour[at], held + w
            if held > 0:
                total, weight = total + area * ((got / held - wanted[:3]) ** 2).sum(), weight + 3 * area
    return float(np.sqrt(total / weight)) if weight > 0 else 0.0


def surface_fit(draw: Draws) -> float:
    """By how many levels a surface fit is worse than its start; infinite where a value is none, or another one with threads."""
    surface, start = field_surface(draw)
    fitted = fit_surface(surface, start, 1)
    if not (np.isfinite(fitted).all() and fitted.min() >= 0 and fitted.max() <= 255):
        return np.inf
    if not all(np.array_equal(fitted, fit_surface(surface, start, threads)) for threads in (2, 5)):
        return np.inf
    return max(0.0, error_on_samples(surface, fitted) - error_on_samples(surface, start))


def inverse_rendering(draw: Draws) -> float:
    """By how much the loss of held-out views has grown; infinite where a colour leaves 0..255 or something else than the start is
    kept where nothing gained."""
    surface, start = field_surface(draw)
    rate = draw.pick((0.5, 1e4, 1e38, 1e300, -1e300, draw.power(-3, 300)))
    with patch.object(inverse_render, "RATE", rate), np.errstate(all="ignore"):
        (got,), log, kept = inverse_render.refine_by_rendering([surface], [start], draw.pick((1, 2)), draw.integer(0, 9),
                                                               iterations=5, views=1, size=16)
    if not (np.isfinite(got).all() and got.min() >= 0 and got.max() <= 255) or (kept == 0 and not np.array_equal(got, start)):
        return np.inf
    return log[kept]["held_out_loss"] - log[0]["held_out_loss"] if kept else 0.0


def neural_fit_at_any_rate(draw: Draws) -> float:
    """1 where a fit ends in something else than a payload that a stream can hold or TXF-I58."""
    rng, count = draw.generator(), 512
    position = rng.integers(0, 1 << 24, (count, 3)).astype(np.int32)
    kind = draw.integer(0, 2)
    target = np.full((count, 3), draw.integer(0, 255)) if kind else rng.integers(0, 256, (count, 3))
    share = np.full((count, 3), 0 if kind == 2 else 255, np.uint8)
    samples = Samples(position, target.astype(np.uint8), share, np.zeros(count, np.int16))
    design = Payload(4, 1, 2, (8,), (Level(8, 6, 0),), 3)
    rates = {"LATENT_RATE": draw.power(-2, 38), "NETWORK_RATE": draw.power(-2, 38)}
    fit = neural_fit.Fit(design, [Tables(design, 0, [None])], samples, samples.taken(slice(0, 64)), draw.integer(0, 9), batch=128)
    with patch.multiple(neural_fit, **rates), np.errstate(all="ignore"):
        try:
            payload = fit.run(12)
        except InputError as error:
            return float(error.code != "TXF-I58")
    return float(((payload.halves >> 10 & 31) > 26).any() or not -8 <= payload.codes.min() <= payload.codes.max() <= 7)


CASES = (
    Case("filter fit", GROUP,
         "every hard content decoded as any other, on cubes, planes, shells and lines: equations without rank, however little "
         "is gained",
         1, "half ulps",
         "Coefficients are kept where, as they are rounded and cut, the squared error falls; that is reckoned from the same "
         "sums as the fit (7.7), so only the filter's own rounding can add: half an ulp in the root mean square. Sums are made "
         "by chunks of fixed size, so threads change nothing.",
         filter_fit, 12),
    Case("surface fit", GROUP,
         "faces there up to twenty times, lines, voxels that no sample sees, one colour, alpha 0, one to five threads",
         0.001, "levels",
         "Conjugate gradients from the start lower the damped squared error at every step, and the damping is 0 at the start: "
         "what is left of the error at the samples cannot be more. The matrix has a damped diagonal, so no voxel is "
         "undetermined; sums in binary32 are off by parts of a thousandth of a level.",
         surface_fit, 6),
    Case("inverse rendering", GROUP,
         "rates from 0.001 to 1e300 and below 0, one colour, alpha 0, nothing to see",
         0, "growth of the loss",
         "Held-out views decide what is kept, the start where none gains; a loss that is no number gains nothing.",
         inverse_rendering, 4),
    Case("3DNTC fits at any rate", GROUP,
         "rates of latents and network from 0.01 to 1e38, noise, one colour, no weight at all",
         0, "other ends",
         "Latents are put back into the range of INT4 and parameters cut below 2^12 (5.7.4); a fit whose numbers are none any "
         "more ends as TXF-I58, before anything is written.",
         neural_fit_at_any_rate, 8),
)
