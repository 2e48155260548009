"""What a 3DNTC fit learns from: samples denser where there is more to learn, and pictures after it."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import painted_sphere

from texfcodec.codecs.base import Source as CodecSource
from texfcodec.codecs.neural import fit_samples as samples_module
from texfcodec.codecs.neural.design import choose_design
from texfcodec.codecs.neural.fit import Fit
from texfcodec.codecs.neural.fit_samples import Source
from texfcodec.encoder.encode import encode_scene
from texfcodec.encoder.values import picture_refinement, pictures
from texfcodec.encoder.values.map_planes import groups_of
from texfcodec.encoder.values.pictures import Schedule
from texfcodec.geometry.surface import make_surface
from texfcodec.options import EncodeOptions
from texfcodec.precompile import small_scene
from texfcodec.report import Report
from texfcodec.scene.scene import Material, Scene, Texture

OPTIONS = EncodeOptions(codec="3dntc", resident_bytes=40_000, steps=200, threads=2)


def half_busy():
    """A square, its left half grey, its right half noise."""
    image = np.full((64, 64, 4), 128, np.uint8)
    image[:, 32:, :3] = np.random.default_rng(1).integers(0, 256, (64, 32, 3))
    image[..., 3] = 255
    side, faces = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64), np.array([[0, 1, 2], [0, 2, 3]])
    return Scene(np.insert(side, 2, 0.5, axis=1), faces, np.zeros(2, np.int64), side[faces], None, [Material(texture=0)],
                 [Texture(image)])


def source_of(scene, components=3):
    surface = make_surface(scene, OPTIONS)
    return shown(scene, surface, np.zeros(len(surface.faces), np.int64), components), surface


def shown(scene, surface, face_field, components=3):
    return Source(CodecSource(scene, surface, face_field, [], groups_of(set(), components == 4)), 2)


@pytest.mark.parametrize("count", [1000, 12_345])
def test_busy_places_get_more_samples_that_count_for_less(count):
    source, _ = source_of(half_busy())
    samples = source.draw_busy(count, [0, 0])
    grey = (samples.target == 128).all(axis=1)
    assert len(samples) == count and len(samples.share) == count
    assert 0.1 < grey.mean() < 0.3  # of the area it is half
    assert samples.share[grey].mean() > 3 * samples.share[~grey].mean()
    weight = samples.share[:, 0].astype(np.float64)
    assert weight[grey].sum() / weight.sum() == pytest.approx(0.5, abs=0.05)  # as if they were spread evenly


def test_where_all_is_alike_samples_stay_even():
    scene = half_busy()
    scene.textures[0].image[:] = 77
    samples = source_of(scene)[0].draw_busy(5000, [0, 0])
    assert samples.share.min() >= 254


@pytest.mark.parametrize("components", [3, 4])
def test_many_chunks_make_one_set_whatever_the_threads(components, monkeypatch):
    monkeypatch.setattr(samples_module, "CHUNK", 1000)
    drawn = []
    for threads in (1, 3):
        source, _ = source_of(half_busy(), components)
        source.threads = threads
        drawn.append(source.draw_busy(2345, [3, 0]))
    assert len(drawn[0]) == 2345 and drawn[0].target.shape == drawn[0].share.shape == (2345, components)
    assert all(np.array_equal(a, b) for a, b in zip(vars(drawn[0]).values(), vars(drawn[1]).values(), strict=True))
    assert len(np.unique(drawn[0].position, axis=0)) > 1500  # the chunks differ
    assert not np.array_equal(drawn[0].position, source.draw_busy(2345, [4, 0]).position)


@pytest.fixture(scope="module")
def fitted():
    """A short fit to a painted sphere, its source and position bits."""
    source, surface = source_of(painted_sphere())
    bits = surface.cube.position_bits
    design = choose_design([(surface.lattice, surface.faces)], bits, 3, OPTIONS)
    fit = Fit(design.payload, design.tables, source.draw_busy(1 << 15, [0, 0]), source.draw(2000, [0, 1]), threads=2)
    fit.run(OPTIONS.steps)
    return fit, source, bits


def state_of(fit):
    return [v.copy() for v in fit.values]


def restore(fit, state):
    for value, kept in zip(fit.values, state, strict=True):
        value[...] = kept
    fit.upload()


def test_pictures_bring_the_payload_closer_in_views_it_has_not_seen(fitted):
    fit, source, bits = fitted
    before = state_of(fit)
    log, kept = picture_refinement.refine_by_pictures(fit, source, bits, Schedule(iterations=10, views=2, size=96))
    assert kept > 0 and log[kept]["held_out_loss"] < 0.98 * log[0]["held_out_loss"]
    drawing = picture_refinement.Pictures(source, fit.tables, bits, 99, 96)
    judges = [drawing.next() for _ in range(8)]
    after = sum(judge.loss(fit)[0] for judge in judges)
    restore(fit, before)
    assert after < sum(judge.loss(fit)[0] for judge in judges)


def test_a_fit_in_torch_is_refined_like_the_other(fitted):
    pytest.importorskip("torch", reason="torch is not installed: pip install texfcodec[ntc]")
    from texfcodec.codecs.neural.fit_torch import TorchFit

    made, source, bits = fitted
    fit = TorchFit(made.design, made.tables, made.samples, made.held_out, 0, 2, device="cpu", batch=4096)
    fit.run(30)
    log, kept = picture_refinement.refine_by_pictures(fit, source, bits, Schedule(iterations=5, views=2, size=64))
    assert kept > 0
    codes = fit.codes.copy()
    fit.download()  # what is on the device is what was kept
    assert np.array_equal(fit.codes, codes)


def test_pictures_show_all_fields():
    scene = small_scene()
    for material in scene.materials:
        material.alpha_mode = 0
    surface = make_surface(scene, OPTIONS)
    face_field = np.array([0, 0, 1, 1])
    design = choose_design([(surface.lattice, surface.faces[face_field == i]) for i in (0, 1)], surface.cube.position_bits, 3,
                           OPTIONS)
    source = shown(scene, surface, face_field)
    drawing = picture_refinement.Pictures(source, design.tables, surface.cube.position_bits, 0, 64)
    seen = [drawing.next() for _ in range(6)]
    assert {f for p in seen for f in p.samples.field.tolist()} == {0, 1}
    fit = Fit(design.payload, design.tables, source.draw(4096, [0, 0]), source.draw(500, [0, 1]), threads=2)
    assert all(np.isfinite(p.loss(fit)[0]) for p in seen if len(p.pixel))
    for p in seen:  # the second field's latents lie behind the first's
        rows = p.cells[1][p.cells[0][:, 0]]
        first = design.payload.first_row(1, 0)
        assert (rows[p.samples.field == 0] < first).all() and rows[p.samples.field == 1].max(initial=first) >= first


def test_nothing_is_kept_of_steps_that_lead_away(fitted, monkeypatch):
    fit, source, bits = fitted
    before, codes = state_of(fit), fit.codes.copy()
    monkeypatch.setattr(picture_refinement, "RATE", 50.0)
    log, kept = picture_refinement.refine_by_pictures(fit, source, bits, Schedule(iterations=20, views=1, size=64))
    assert kept == 0 and len(log) == 1 + pictures.PATIENCE  # it did not go on for all of them
    assert all(np.array_equal(a, b) for a, b in zip(fit.values, before, strict=True)) and np.array_equal(fit.codes, codes)


def test_a_payload_with_alpha_is_left_alone_and_the_report_says_why():
    report = Report()
    options = EncodeOptions(codec="3dntc", resident_bytes=40_000, steps=5, refine="render", resolution=32)
    told = encode_scene(small_scene(), options, report).choices["refinement"]
    assert told["kind"] == "off" and "alpha" in told["reason"]


@pytest.mark.parametrize("asked, kind", [("auto", "off"), ("off", "off"), ("render", None)])
def test_the_report_says_whether_and_why(asked, kind, monkeypatch):
    report, real = Report(), picture_refinement.refine_by_pictures
    small = lambda fit, source, bits, schedule, **named: real(fit, source, bits, replace(schedule, size=64), **named)
    monkeypatch.setattr(picture_refinement, "refine_by_pictures", small)
    options = EncodeOptions(codec="3dntc", resident_bytes=40_000, steps=20, refine=asked, refine_iterations=1, resolution=32)
    told = encode_scene(painted_sphere(), options, report).choices["refinement"]
    assert told["asked"] == asked and told["reason"] and (told["kind"] == kind if kind else len(told["iterations"]) == 2)
