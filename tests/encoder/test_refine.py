"""Surface fit, inverse rendering, and the choice between them."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from shapes import painted_sphere, scene_of

from texfcodec.encoder.encode import Encoder, encode_scene
from texfcodec.encoder.values import inverse_render
from texfcodec.encoder.values.inverse_render import Pictures, View, held_out, refine_by_rendering
from texfcodec.encoder.values.pictures import Schedule, keep_best
from texfcodec.encoder.values.surface_fit import (
    DAMPING,
    HELD_OUT,
    HELD_OUT_SEED,
    FieldSurface,
    _normal_equations,
    fit_surface,
)
from texfcodec.field.grid import build_brick_map
from texfcodec.options import EncodeOptions
from texfcodec.report import Report
from texfcodec.scene.fetch import pack_source


def surfaces_of(scene, resolution, **choices):
    """(FieldSurfaces, transfer colours) of a scene, in field order."""
    options = EncodeOptions(resolution=resolution, qp=28, refine="off", **choices)
    made = Encoder(scene=scene).filled(options, Report())
    found = []
    for i, field in enumerate(made.fields):
        mine = made.source.face_field == i
        source = pack_source(scene, made.surface.origin_face[mine])
        found.append(FieldSurface(made.surface.lattice, made.surface.faces[mine], source, made.surface.cube.position_bits,
                                  resolution, field.keys, build_brick_map(field.keys)))
    return found, [f.planes["base_colour"] for f in made.fields]


@pytest.fixture(scope="module")
def textured():
    return surfaces_of(painted_sphere(), 64, partition="off")


def needles(count=40):
    """A fan of slivers a thousand times longer than wide, and one triangle far from everything."""
    from texfcodec.scene.scene import Material, Scene

    angle = np.linspace(0, 1, count + 1) * 0.04
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(count + 1)], axis=1)
    positions = np.concatenate([[[0, 0, 0]], rim, [[0.5, 0.9, 0.9], [0.501, 0.9, 0.9], [0.5, 0.901, 0.9]]])
    faces = np.array([[0, i + 1, i + 2] for i in range(count)] + [[count + 2, count + 3, count + 4]])
    colour = np.random.default_rng(3).random((len(faces), 3, 4)).astype(np.float32)
    colour[..., 3] = 1
    return Scene(positions, faces, np.zeros(len(faces), np.int64), np.zeros((len(faces), 3, 2)), colour, [Material()], [])


def mse(surface, colour):
    points = surface.sample(HELD_OUT, HELD_OUT_SEED, 2)
    return surface.error(colour, *points, 2)["rgb"]


def test_fit_takes_most_of_the_error_at_points_it_has_not_seen():
    (surface,), (colour,) = surfaces_of(painted_sphere(), 64)
    assert mse(surface, fit_surface(surface, colour, 2)) < 0.4 * mse(surface, colour)


def dense_of(matrix):
    """The matrix of the fit, float64 [N, N], by scipy; its product and diagonal are those of scipy, bit for bit."""
    count = len(matrix.first) - 1
    theirs = csr_matrix((matrix.gram, matrix.columns, matrix.first), shape=(count, count))
    x = np.random.default_rng(1).normal(size=(count, 3)).astype(np.float32)
    assert np.array_equal(matrix.times(x), theirs @ x) and np.array_equal(matrix.diagonal(), theirs.diagonal())
    return theirs.toarray().astype(np.float64)


def test_fit_solves_the_damped_least_squares():
    (surface,), (colour,) = surfaces_of(painted_sphere(3), 10)
    matrix, right = _normal_equations(surface, 2, 2, lambda *_: None)
    dense = dense_of(matrix)
    assert np.allclose(dense, dense.T, atol=1e-4 * dense.max())
    damping = DAMPING * dense.diagonal().mean()
    exact = colour + np.linalg.solve(dense + damping * np.eye(len(dense)), right - dense @ colour)
    got = fit_surface(surface, colour, 2, iterations=200)
    assert np.abs(got - np.clip(exact, 0, 255)).max() < 0.5


def test_condition_number_on_slivers_and_lonely_voxels_keeps_its_bound():
    (surface,), (colour,) = surfaces_of(needles(), 64)
    matrix, _ = _normal_equations(surface, 2, 1, lambda *_: None)
    dense = dense_of(matrix)
    damping = DAMPING * dense.diagonal().mean()
    values = np.linalg.eigvalsh(dense + damping * np.eye(len(dense)))
    assert values[0] >= 0.99 * damping
    assert values[-1] / values[0] <= 1.01 * (1 + dense.sum(axis=1).max() / damping)
    fitted = fit_surface(surface, colour)
    assert np.isfinite(fitted).all() and fitted.min() >= 0 and fitted.max() <= 255


def test_a_fit_that_is_worse_is_not_kept(monkeypatch):
    from texfcodec.encoder.values import refinement
    from texfcodec.encoder.values import source_field as preparing

    monkeypatch.setattr(preparing, "FITTED_DENSITY", preparing.TRANSFER_DENSITY["balanced"])
    monkeypatch.setattr(refinement, "fit_surface", lambda surface, colour, *_, **__: 255 - colour)
    options = EncodeOptions(resolution=64, qp=28)
    one, other = (encode_scene(painted_sphere(), options.changed(refine=kind)).data for kind in ("fit", "off"))
    assert one == other


@pytest.mark.parametrize("choices, reason", [
    ({"effort": "fast"}, "effort fast"), ({"max_error": 0}, "error bound"), ({"qp": 63}, "coding would hide"),
    ({"refine": "off"}, "off"),
])
def test_auto_does_without_and_says_why(choices, reason):
    report = Report()
    told = encode_scene(painted_sphere(), EncodeOptions(**{"resolution": 64} | choices), report).choices["refinement"]
    assert told["kind"] == "off"
    assert reason in told["reason"]


def test_auto_does_without_where_one_colour_covers_all():
    plain = needles()
    plain.corner_color[:] = 0.5
    report = Report()
    told = encode_scene(plain, EncodeOptions(resolution=64, qp=20), report).choices["refinement"]
    assert told["kind"] == "off" and "one colour" in told["reason"]


def test_auto_fits_what_gains_and_reports_before_and_after(sample_scene):
    report = Report()
    facts = encode_scene(sample_scene, EncodeOptions(resolution=64, qp=20), report).choices["refinement"]
    assert facts["kind"] == "fit" and facts["predicted_gain_db"] > 0 and any(f["kept"] for f in facts["fields"])
    assert all(f["psnr_y_after"] > f["psnr_y_before"] for f in facts["fields"] if f["kept"])


def test_gradient_of_a_view_is_the_differential_of_its_loss():
    random = np.random.default_rng(1)
    size, rows = 24, np.arange(24 * 24)
    rank = random.integers(-1, 40, (len(rows), 8)).astype(np.int32)
    weight = random.random((len(rows), 8)).astype(np.float32) * (rank >= 0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-6)
    view = View(size, rows, random.uniform(0, 255, (len(rows), 3)).astype(np.float32), rank, weight)
    values = random.uniform(40, 210, (40, 3)).astype(np.float32)
    gradient = np.zeros_like(values)
    inverse_render._scatter(rank, weight, view.loss(values, 1)[2].astype(np.float32), 0, 40, gradient)
    for voxel, channel in [(0, 0), (7, 1), (39, 2), (20, 0)]:
        losses = []
        for step in (1.0, -1.0):
            moved = values.copy()
            moved[voxel, channel] += step
            losses.append(view.loss(moved, 1)[0])
        assert (losses[0] - losses[1]) / 2 == pytest.approx(gradient[voxel, channel], rel=0.05, abs=2e-6)


def test_scatter_is_the_transpose_of_blend():
    random = np.random.default_rng(2)
    rank, weight = random.integers(-1, 9, (50, 8)).astype(np.int32), random.random((50, 8)).astype(np.float32)
    values, slope = random.random((9, 3)).astype(np.float32), random.random((50, 3)).astype(np.float32)
    out, back = np.empty((50, 3), np.float32), np.zeros((9, 3), np.float32)
    inverse_render._blend(rank, weight, values, out)
    for low, high in ((0, 4), (4, 9)):
        inverse_render._scatter(rank, weight, slope, low, high, back)
    assert (out * slope).sum() == pytest.approx((values * back).sum(), rel=1e-4)


def test_inverse_rendering_repeats_for_a_seed_and_any_threads(textured):
    surfaces, colours = textured
    runs = [refine_by_rendering(surfaces, colours, threads, Schedule(iterations=2, views=2, size=96)) for threads in (1, 2)]
    assert np.array_equal(runs[0][0][0], runs[1][0][0])
    assert [row["loss"] for row in runs[0][1]] == [row["loss"] for row in runs[1][1]]


def test_inverse_rendering_lowers_the_loss_of_views_it_was_not_trained_on(textured):
    surfaces, colours = textured
    refined, log, kept = refine_by_rendering(surfaces, colours, 2, Schedule(iterations=10, views=4, size=128))
    assert kept > 0 and log[kept]["held_out_loss"] < log[0]["held_out_loss"]
    judges = held_out(Pictures(surfaces, 99, 2, 128))
    before, after = (np.mean([v.loss(np.concatenate(c), 2)[1] for v in judges]) for c in (colours, refined))
    assert after < before


def test_looks_at_what_is_no_number_are_never_kept():
    looks, values = iter([[(1.0, 4.0)], [(np.nan, np.inf)], [(np.inf, np.nan)]]), np.zeros(2)
    log, kept = keep_best(lambda n: float(values.__iadd__(np.nan)[0]), lambda: next(looks), [values], 10, 0.0)
    assert kept == 0 and values.tolist() == [0, 0] and len(log) == 3
    assert [row[name] for row in log[1:] for name in ("loss", "held_out_loss", "held_out_psnr")] == [None] * 6


@pytest.mark.parametrize("refine", ["auto", "fit"])
def test_faces_without_area_keep_their_transfer(refine):
    """A line of three corners is kept on the lattice, and has no point to fit at."""
    line = scene_of([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    made = encode_scene(line, EncodeOptions(resolution=8, qp=40, refine=refine), Report())
    fields = made.choices["refinement"].get("fields", [])
    assert made.counts["faces"] == 1 and all(field["kept"] is False for field in fields)


def test_values_of_a_field_are_kept_for_its_own_surface_voxels_and_k():
    """Textures are filtered by the K of all fields, whichever K a field has of its own."""
    from texfcodec.encoder.values.source_field import field_keys

    filled = Encoder(scene=painted_sphere(8)).filled(EncodeOptions(resolution=16, qp=28, refine="off"), Report())
    keys = lambda source, k: field_keys("transfer", source, filled.fields, k)
    assert keys(filled.source, 16) == keys(filled.source, 16)
    other = filled.source._replace(face_field=filled.source.face_field + 1)
    assert len({*keys(filled.source, 16), *keys(filled.source, 32), *keys(other, 16)}) == 3
