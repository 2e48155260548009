"""The 3DNTC fit: its gradient, its promises (seed, checkpoint, budget) and what the integers cost against floats."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from plane_fits import plane_fit

from texfcodec import EncodeOptions, decode
from texfcodec.codecs.neural.design import POINTS, point_bytes
from texfcodec.codecs.neural.fit import NO_SLOPE
from texfcodec.codecs.neural.payload import join_parameters, split_parameters
from texfcodec.encoder.encode import encode_scene
from texfcodec.errors import InputError
from texfcodec.metrics.psnr_3d import measure
from texfcodec.precompile import small_scene


def learn(fit, slope=NO_SLOPE):
    """The error at a fit's samples; its gradient, or that of slopes, is left in gradients."""
    for g in fit.gradients:
        g[:] = 0
    with ThreadPoolExecutor(fit.threads) as pool:
        return fit.learn(fit.samples, (fit.cell, fit.corners), pool, slope)


def test_slopes_that_are_given_take_the_errors_place():
    fit = plane_fit(300, threads=2)
    learn(fit)
    expected = [g.sum(axis=0) for g in fit.gradients]
    wrong = fit.answers(fit.samples, (fit.cell, fit.corners)) - fit.samples.target
    learn(fit, (wrong / 127.5).astype(np.float32))
    for g, one in zip(fit.gradients, expected, strict=True):
        np.testing.assert_allclose(g.sum(axis=0), one, rtol=1e-3, atol=1e-3)


def test_gradient_is_that_of_the_error():
    fit = plane_fit(256)
    s, (_, weight, bias) = fit.samples, fit.values

    def error():
        return float((((fit.answers(s, (fit.cell, fit.corners)).astype(np.float64) - s.target) / 127.5) ** 2).sum())

    assert learn(fit) == pytest.approx(error(), rel=1e-4)
    by_weight, by_bias = (g.sum(axis=0) for g in fit.gradients[1:])
    for array, gradient, place in ((weight, by_weight, (0, 3, 2)), (weight, by_weight, (1, 5, 7)), (weight, by_weight, (2, 1, 4)),
                                   (bias, by_bias, (0, 4)), (bias, by_bias, (2, 0))):
        kept, step = array[place], 1e-2
        sides = []
        for sign in (1, -1):
            array[place] = kept + sign * step
            sides.append(error())
        array[place] = kept
        assert 2 * gradient[place] == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=0.02, abs=0.02)


def test_gradient_reaches_the_latents():
    """A latent's code moved by one changes the error by about its gradient times the step."""
    fit = plane_fit(256)
    learn(fit)
    gradient = fit.gradients[0].sum(axis=0)
    row, k = np.unravel_index(np.abs(gradient).argmax(), gradient.shape)
    kept = fit.codes[row, k]
    sides = []
    for sign in (2, -2):
        fit.codes[row, k] = kept + sign
        sides.append(learn(fit))
    assert 2 * gradient[row, k] == pytest.approx((sides[0] - sides[1]) / (4 / 16), rel=0.05)


def test_the_same_seed_gives_the_same_payload_for_any_threads_and_another_seed_another():
    one, two, three = (plane_fit(seed=seed, threads=threads).run(30) for seed, threads in ((1, 1), (1, 3), (2, 1)))
    assert np.array_equal(one.codes, two.codes) and np.array_equal(one.halves, two.halves)
    assert not np.array_equal(one.codes, three.codes)


def test_a_fit_taken_up_from_its_checkpoint_ends_as_if_never_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("texfcodec.codecs.neural.fit.SAVE_SECONDS", 0.0)
    whole = plane_fit().run(40)

    def stop(fit, steps):
        if fit.step >= 20:
            raise KeyboardInterrupt

    path = tmp_path / "fit.ckpt"
    with pytest.raises(KeyboardInterrupt):
        plane_fit().run(40, stop, path)
    resumed = plane_fit(threads=2)
    payload = resumed.run(40, checkpoint=path)
    assert np.array_equal(whole.codes, payload.codes) and np.array_equal(whole.halves, payload.halves)
    assert resumed.log[0]["step"] < 20 and resumed.log[-1]["step"] == 40


@pytest.mark.parametrize("damage", ["other fit", "no archive", "cut off"])
def test_a_checkpoint_of_something_else_is_refused(tmp_path, damage):
    path = tmp_path / "fit.ckpt"
    plane_fit().run(10, checkpoint=path)
    if damage == "no archive":
        path.write_bytes(b"nothing")
    elif damage == "cut off":
        path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError) as error:
        plane_fit(seed=1 if damage == "other fit" else 0).run(10, checkpoint=path)
    assert error.value.code == "TXF-I55"


def test_a_fit_that_no_longer_improves_ends_early():
    noise = np.random.default_rng(3).integers(0, 256, (4096, 4))
    fit = plane_fit(target=noise, seed=1)
    fit.run(400)
    assert 300 <= fit.step < 400 and len(fit.log) < 20


def test_a_fit_that_diverges_is_named_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("texfcodec.codecs.neural.fit.NETWORK_RATE", 1e30)
    with pytest.raises(InputError) as error, np.errstate(all="ignore"):
        plane_fit(1024).run(6, checkpoint=tmp_path / "fit.ckpt")
    assert error.value.code == "TXF-I58" and list(tmp_path.iterdir()) == []


def test_integers_cost_next_to_nothing_against_floats():
    """Answers of the decoder's integers against the floats that the fit reckons with."""
    fit = plane_fit(threads=2)
    fit.run(600)
    assert fit.psnr(exact=True) > fit.psnr() - 0.05 and fit.psnr() > 25


def test_parameters_survive_joining_and_splitting():
    random = np.random.default_rng(0)
    widths = (7, 5, 1, 3)
    weights = [random.standard_normal((o, i)) for i, o in zip(widths[:-1], widths[1:], strict=True)]
    biases = [random.standard_normal(o) for o in widths[1:]]
    again = split_parameters(join_parameters(weights, biases), widths)
    assert all(np.array_equal(a, b) for a, b in zip(weights + biases, again[0] + again[1], strict=True))


# The whole way.


def encoded(scene, **settings):
    made = fitted(scene, **settings)
    return made.data, made.choices


def fitted(scene, **settings):
    return encode_scene(scene, EncodeOptions(codec="3dntc", threads=1, **{"resolution": 64, "steps": 60, **settings}))


@pytest.mark.parametrize("budget", [20_000, 40_000, 100_000])
def test_the_budget_is_kept_and_nearly_used(budget):
    _, facts = encoded(small_scene(), resident_bytes=budget, steps=1)
    kept = facts["resident"]
    assert 0.75 * budget < kept["total"] <= budget
    assert kept["total"] == kept["latents"] + kept["network"] + kept["index"]


def test_a_budget_below_the_network_is_refused():
    with pytest.raises(InputError) as error:
        encoded(small_scene(), resident_bytes=10_000)
    assert error.value.code == "TXF-I54" and int(error.value.details["allowed"].split()[-1]) > 10_000


def test_points_have_the_papers_sizes():
    assert point_bytes("mpeg1") == ((1 << 15) + (1 << 14)) * 8 + 2 * (50 * 64 + 64 + 64 * 48 + 48 + 48 * 32 + 32 + 32 * 3 + 3)
    assert set(POINTS) == {f"mpeg{n}" for n in range(1, 7)} | {f"aom{n}" for n in range(1, 6)}


@pytest.mark.slow
def test_more_steps_come_closer(sample_scene):
    closer = []
    for steps in (30, 300):
        made = fitted(sample_scene, steps=steps, resident_bytes=120_000)
        closer.append(measure(sample_scene, decode(made.data), 20_000)["rgb"])
    assert closer[1] > closer[0] + 1


@pytest.mark.parametrize("settings", [{"latent_index": "hash", "point": "mpeg1"}, {"transport": True, "resident_bytes": 60_000}])
def test_other_forms_decode_to_what_the_encoder_promised(settings):
    scene = small_scene()
    made = fitted(scene, steps=10, **settings)
    texf = decode(made.data)
    import hashlib

    total = hashlib.sha256()
    for field in texf.fields:
        for channels in (slice(0, 3), slice(3, 4)):
            total.update(np.ascontiguousarray(field.keys, "<i8"))
            total.update(np.ascontiguousarray(field.rgba[:, channels]))
    assert texf.has_alpha and total.hexdigest() == made.reconstruction_sha256


def test_the_transport_form_is_smaller_and_means_the_same():
    plain, packed = (encoded(small_scene(), resident_bytes=60_000, transport=t)[0] for t in (False, True))
    assert len(packed) < len(plain)
    assert all(np.array_equal(a.rgba, b.rgba) for a, b in zip(decode(plain).fields, decode(packed).fields, strict=True))


def test_pictures_and_queries_ask_the_payload_itself(sample_scene):
    """Level 0 of a picture is Texf.query, and that is infer: finer than the voxels, which are few here."""
    from texfcodec.render.camera import bounding_sphere, fibonacci_direction, orthographic
    from texfcodec.render.shade import render_scene, render_texf

    data, _ = encoded(sample_scene, resolution=16, steps=300, resident_bytes=120_000)
    texf = decode(data)
    camera = orthographic(fibonacci_direction(1, 4), *bounding_sphere(texf.positions), 64)
    source, shown = render_scene(sample_scene, camera), render_texf(texf, camera, filtering=False)
    texf.evaluators = None
    voxels = render_texf(texf, camera, filtering=False)
    errors = [np.mean((picture.image().astype(float) - source.image()) ** 2) for picture in (shown, voxels)]
    assert errors[0] < 0.7 * errors[1]
