"""PSNR and samples of a surface against values worked out by hand."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from texfcodec.core.colour_error import ColourError, colour_mse, decibels, psnr_3d
from texfcodec.core.json_text import json_ready
from texfcodec.geometry.areas import sample_surface

GREY = np.full((5, 3), 100.0)


def naive_mse(ref, got, weights):
    """Sample by sample, with BT.709 written the way the standard writes it."""
    sums, total = dict.fromkeys(("y", "u", "v", "rgb"), 0.0), 0.0
    for a, b, w in zip(ref, got, weights, strict=True):
        r, g, b_ = (float(y) - float(x) for x, y in zip(a, b, strict=True))
        luma = 0.2126 * r + 0.7152 * g + 0.0722 * b_
        for key, d2 in (("y", luma**2), ("u", ((b_ - luma) / 1.8556) ** 2), ("v", ((r - luma) / 1.5748) ** 2),
                        ("rgb", (r**2 + g**2 + b_**2) / 3)):
            sums[key] += w * d2
        total += w
    return {k: s / total for k, s in sums.items()}


def test_error_of_one_grey_level_is_48_13_db():
    assert psnr_3d(GREY, GREY + 1)["psnr_y"] == pytest.approx(20 * math.log10(255), abs=1e-9)


def test_yuv611_averages_decibels():
    p = psnr_3d(GREY, GREY + [3, -2, 9])
    assert p["psnr_yuv611"] == pytest.approx((6 * p["psnr_y"] + p["psnr_u"] + p["psnr_v"]) / 8)


def test_lossless_is_inf_and_null_in_json():
    error = ColourError()
    error.add(GREY, GREY)
    result = error.result()
    assert result["psnr_y"] == result["psnr_yuv611"] == result["psnr_rgb"] == math.inf
    assert json.loads(json.dumps(json_ready(result), allow_nan=False))["psnr_y"] is None
    assert json_ready(result)["mse_y"] == 0.0 and json_ready(result)["samples"] == 5


def test_colour_error_agrees_with_the_naive_sum_however_it_is_cut():
    rng = np.random.default_rng(1)
    ref, got, weights = rng.uniform(0, 255, (500, 3)), rng.uniform(0, 255, (500, 3)), rng.uniform(0, 2, 500)
    expected, error = naive_mse(ref, got, weights), ColourError()
    for start, stop in ((0, 1), (1, 1), (1, 300), (300, 500)):
        error.add(ref[start:stop], got[start:stop], weights[start:stop])
    assert error.samples == 500
    assert error.mse() == pytest.approx(expected, rel=1e-12)
    assert colour_mse(ref, got, weights) == pytest.approx(expected, rel=1e-12)


def test_more_samples_than_one_block_and_uint8_do_not_wrap():
    ref, got = np.zeros((70_000, 3), np.uint8), np.full((70_000, 3), 255, np.uint8)
    assert colour_mse(ref, got)["rgb"] == pytest.approx(255.0**2)
    assert colour_mse(got, ref)["rgb"] == pytest.approx(255.0**2)


@pytest.mark.parametrize("ref, got, weights, word", [
    (GREY, GREY[:3], None, r"\[5, 3\] and \[3, 3\]"), (GREY[:, :2], GREY[:, :2], None, r"\[N, 3\]"),
    (GREY, GREY, np.ones(4), "weights"), (GREY, GREY, -np.ones(5), "negative"), (GREY, GREY * np.nan, None, "finite"),
    (GREY, GREY, np.zeros(5), "no samples"), (GREY[:0], GREY[:0], None, "no samples"),
])
def test_colour_error_refuses(ref, got, weights, word):
    with pytest.raises(ValueError, match=word):
        colour_mse(ref, got, weights)


def test_decibels_refuses_negative_and_nan():
    for bad in (-1e-9, math.nan):
        with pytest.raises(ValueError, match="mean squared"):
            decibels(bad)


# Surface samples: one square of side 2, cut unevenly, and a face without area in front, between and behind.
SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1.5, 0, 0.0]])
SQUARE_FACES = np.array([[0, 1, 1], [0, 4, 3], [4, 4, 4], [4, 1, 2], [4, 2, 3], [0, 4, 1]])


def test_samples_are_even_by_area_and_skip_degenerate_faces():
    face, bary = sample_surface(SQUARE, SQUARE_FACES, 4000)
    counts = np.bincount(face, minlength=6)
    assert counts[[0, 2, 5]].tolist() == [0, 0, 0]
    assert np.abs(counts[[1, 3, 4]] - np.array([1500, 500, 2000])).max() <= 1
    points = np.einsum("nij,ni->nj", SQUARE[SQUARE_FACES[face]], bary)
    assert points.mean(axis=0) == pytest.approx([1, 1, 0], abs=0.03)
    assert points.var(axis=0) == pytest.approx([1 / 3, 1 / 3, 0], abs=0.02)  # a uniform square of side 2


def test_samples_are_reproducible_and_seeded():
    one, two, other = (sample_surface(SQUARE, SQUARE_FACES, 100, seed) for seed in (7, 7, 8))
    assert np.array_equal(one[0], two[0]) and np.array_equal(one[1], two[1])
    assert not np.array_equal(one[1], other[1])


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1.0, 1e30, 1e300])
def test_samples_do_not_depend_on_scale(scale):
    face, bary = sample_surface(SQUARE * scale, SQUARE_FACES, 300)
    expected = sample_surface(SQUARE, SQUARE_FACES, 300)
    assert np.abs(np.bincount(face, minlength=6) - np.bincount(expected[0], minlength=6)).max() <= 1
    assert np.array_equal(bary, expected[1])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 400), st.integers(0, 2**32), st.integers(-40, 40), st.integers(0, 1))
def test_samples_are_well_formed_on_random_soups(count, seed, exponent, flat_axes):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(12, 3)) * 10.0**exponent + 10.0**exponent
    positions[:, :flat_axes] = 0  # a soup in space, or in a plane
    faces = rng.integers(0, 12, (20, 3), dtype=np.int32)
    face, bary = sample_surface(positions, faces, count, seed)
    a, b, c = faces[face].T
    assert face.dtype == np.int64 and bary.shape == (count, 3) and (np.diff(face) >= 0).all()
    assert (bary >= 0).all() and np.abs(bary.sum(axis=1) - 1).max(initial=0) < 1e-12
    assert ((a != b) & (b != c) & (a != c)).all()


@pytest.mark.parametrize("positions, faces, count, word", [
    (SQUARE, SQUARE_FACES, -1, "negative"), (SQUARE, SQUARE_FACES + 1, 5, "0 to 4"), (SQUARE, SQUARE_FACES - 1, 5, "0 to 4"),
    (SQUARE, SQUARE_FACES.astype(float), 5, "integers"), (SQUARE, SQUARE_FACES[:, :2], 5, "F, 3"),
    (np.where(SQUARE > 1, np.inf, SQUARE), SQUARE_FACES, 5, "finite"), (np.ones((5, 3)), SQUARE_FACES, 5, "area"),
    (np.zeros((5, 3)), SQUARE_FACES, 5, "area"), (SQUARE * [1, 0, 0], SQUARE_FACES, 5, "area"),
    (SQUARE, SQUARE_FACES[:0], 5, "area"),
])
def test_sample_surface_refuses(positions, faces, count, word):
    with pytest.raises(ValueError, match=word):
        sample_surface(positions, faces, count)
