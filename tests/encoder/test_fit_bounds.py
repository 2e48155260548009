"""Bounds of what the encoder fits to a surface, at rates that diverge, and of scenes whose positions lie on ties."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from bounds import Draws, Group
from shapes import mapped_sheet, noise, painted_sphere, scene_of

from texfcodec.api import decode
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.values import inverse_render
from texfcodec.encoder.values.pictures import Schedule
from texfcodec.encoder.values.surface_fit import FieldSurface, fit_surface
from texfcodec.field.grid import build_brick_map
from texfcodec.field.morton import decode_morton, encode_morton
from texfcodec.field.samples import surface_samples
from texfcodec.field.voxelise import voxelise
from texfcodec.options import EncodeOptions
from texfcodec.scene.fetch import pack_source, sample_source
from texfcodec.scene.scene import ALPHA_BLEND, Scene

case = Group("Fits of the encoder")

BITS = 8


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


@case("surface fit", 0.001, "levels")
def surface_fit(draw: Draws) -> float:
    """By how many levels a surface fit is worse than its start; infinite where a value is none, or another one with threads.
    Stress: faces there up to twenty times, lines, voxels that no sample sees, one colour, alpha 0, one to five threads
    Bound: Conjugate gradients from the start lower the damped squared error at every step, and the damping is 0 at the start:
    what is left of the error at the samples cannot be more. The matrix has a damped diagonal, so no voxel is undetermined;
    sums in binary32 are off by parts of a thousandth of a level.
    """
    surface, start = field_surface(draw)
    fitted = fit_surface(surface, start, 1)
    if not (np.isfinite(fitted).all() and fitted.min() >= 0 and fitted.max() <= 255):
        return np.inf
    if not all(np.array_equal(fitted, fit_surface(surface, start, threads)) for threads in (2, 5)):
        return np.inf
    return max(0.0, error_on_samples(surface, fitted) - error_on_samples(surface, start))


@case("inverse rendering", 0, "growth of the loss", seeds=4)
def inverse_rendering(draw: Draws) -> float:
    """By how much the loss of held-out views has grown; infinite where a colour leaves 0..255 or something else than the start
    is kept where nothing gained.
    Stress: rates from 0.001 to 1e300 and below 0, one colour, alpha 0, nothing to see
    Bound: Held-out views decide what is kept, the start where none gains; a loss that is no number gains nothing.
    """
    surface, start = field_surface(draw)
    rate = draw.pick((0.5, 1e4, 1e38, 1e300, -1e300, draw.power(-3, 300)))
    with patch.object(inverse_render, "RATE", rate), np.errstate(all="ignore"):
        threads, schedule = draw.pick((1, 2)), Schedule(seed=draw.integer(0, 9), iterations=5, views=1, size=16)
        (got,), log, kept = inverse_render.refine_by_rendering([surface], [start], threads, schedule)
    if not (np.isfinite(got).all() and got.min() >= 0 and got.max() <= 255) or (kept == 0 and not np.array_equal(got, start)):
        return np.inf
    return log[kept]["held_out_loss"] - log[0]["held_out_loss"] if kept else 0.0


floats = Group("Floats of the encoder")


PLAIN = {"resolution": 16, "qp": 28, "effort": "fast", "refine": "off", "threads": 1}


def scene_on_ties(draw: Draws) -> tuple[Scene, int]:
    """(A scene whose positions lie in the middle between lattice positions, the lattice's bits)."""
    bits = draw.integer(8, 12)
    scene = painted_sphere(4, seed=draw.integer(0, 9)) if draw.pick((True, False)) else \
        mapped_sheet({"roughness": noise(1, 8, 8)}, noise(2, 8, 8), cells=2)
    last, low, high = (1 << bits) - 1, scene.positions.min(axis=0), scene.positions.max(axis=0)
    unit = (scene.positions - low) / (high - low).max()
    inner = (unit > 0.1) & (unit < 0.9)
    return replace(scene, positions=np.where(inner, (np.floor(unit * last) + 0.5) / last, np.round(unit))), bits


def nudged(scene: Scene, way: float) -> Scene:
    """A scene of which every position, UV and colour is the next number up or down; those at 0 and 1 stay, with the cube."""
    move = lambda a: None if a is None else np.where((a == 0) | (a == 1), a, np.nextafter(a, a.dtype.type(way)))
    return replace(scene, positions=move(scene.positions), corner_uv=move(scene.corner_uv), corner_color=move(scene.corner_color))


@floats("scenes on ties", 1, "lattice steps", seeds=2)
def either_side(draw: Draws) -> float:
    """Lattice steps between what is decoded of a scene on ties and of the same an ulp up and down; infinite where a stream is
    not sound or another number of faces comes back.
    Stress: positions in the middle between lattice positions, and all positions, UVs and colours an ulp up or down; voxels,
    texels and a map
    Bound: A float that decides otherwise moves a position by one step, never two. Everything behind is made from the decoded
    lattice, UVs and values (6, 7), so each of the three streams is sound: its checksums of geometry, keys and values are
    tested.
    """
    scene, bits = scene_on_ties(draw)
    support = draw.pick(("voxels", "texels")) if scene.textures else "voxels"
    options = EncodeOptions(**PLAIN | {"qp": draw.integer(4, 50)}, position_bits=bits, support=support)
    made = [decode(encode_scene(one, options).data) for one in (scene, nudged(scene, np.inf), nudged(scene, -np.inf))]
    if len({len(texf.faces) for texf in made}) > 1:
        return np.inf
    corners = [np.sort(texf.lattice_positions[texf.faces].reshape(-1, 3), axis=0) for texf in made]
    return float(max(np.abs(other - corners[0]).max() for other in corners[1:]))


@pytest.mark.parametrize("hard", [*case, *floats], ids=lambda hard: hard.name)
def test_no_trial_of_a_case_is_worse_than_its_bound(hard):
    worst = hard.worst()
    assert worst.value <= hard.bound, worst
