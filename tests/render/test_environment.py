"""The sky's closed forms against brute force, and the tables of the lobes against the integrals that they stand for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from oracles import shading as naive
from texfcodec.render.environment import DAYLIGHT, Environment, furnace, ggx_lobe
from texfcodec.render.lobes import LEAST, MIN_CHARLIE, charlie_integral, ggx_integral
from texfcodec.render.look_up import look_up

RNG = np.random.default_rng(14)
DIRECTIONS = np.array([naive.unit(d) for d in [(0, 1, 0), (0, -1, 0), (1, 0, 0), *RNG.normal(size=(9, 3))]])


def columns(rows):
    return np.ascontiguousarray(np.asarray(rows).T, np.float32)


def test_sky_is_the_curve_of_its_control_colours():
    assert_allclose(DAYLIGHT.radiance(columns(DIRECTIONS)).T, naive.sky(DAYLIGHT.gradient, DIRECTIONS), atol=1e-5)


def test_irradiance_is_exact():
    brute = [naive.sky(DAYLIGHT.gradient, naive.hemisphere(n)).mean(axis=0) for n in DIRECTIONS]
    assert_allclose(DAYLIGHT.irradiance(columns(DIRECTIONS)).T, brute, atol=5e-5)


@pytest.mark.parametrize("roughness", [0.0, 0.07, 0.2, 0.33, 0.5, 0.77, 1.0])
def test_prefiltered_sky_stays_within_a_thousandth_of_brute_force(roughness):
    got = DAYLIGHT.prefiltered(columns(DIRECTIONS), np.full(len(DIRECTIONS), roughness, np.float32)).T
    for axis, colour in zip(DIRECTIONS, got, strict=True):
        half = naive.half_vectors(axis, max(roughness**2, naive.MIRROR))
        light = 2 * (half @ axis)[:, None] * half - axis
        weight = np.maximum(light @ axis, 0)
        assert_allclose(colour, weight @ naive.sky(DAYLIGHT.gradient, light) / weight.sum(), atol=1e-3)


def test_table_of_the_sky_stays_within_a_thousandth_between_its_nodes():
    y, roughness = RNG.uniform(-1, 1, 300), RNG.uniform(0, 1, 300)
    basis = np.polynomial.legendre.legvander(y, 8)
    exact = [basis[i] * ggx_lobe(r * r) @ DAYLIGHT._zonal for i, r in enumerate(roughness)]
    assert_allclose(DAYLIGHT.prefiltered(columns(np.column_stack([y, y, y])), roughness.astype(np.float32)).T, exact, atol=1e-3)


def test_narrow_lobes_end_at_the_mirror_and_wide_ones_at_the_cosine():
    assert_allclose(ggx_lobe(0.0), np.ones(9), atol=3e-3)
    assert_allclose(ggx_lobe(1.0)[:3], [1, 2 / 3, 1 / 4], atol=1e-12)


def test_furnace_is_the_same_wherever_one_looks():
    oven = furnace((0.25, 0.5, 1.0))
    for light in (oven.radiance(columns(DIRECTIONS)), oven.irradiance(columns(DIRECTIONS)),
                  oven.prefiltered(columns(DIRECTIONS), np.linspace(0, 1, len(DIRECTIONS), dtype=np.float32))):
        assert_allclose(light.T, np.tile([0.25, 0.5, 1.0], (len(DIRECTIONS), 1)), atol=2e-6)


def test_sky_never_leaves_its_control_colours():
    y = np.linspace(-1, 1, 1001, dtype=np.float32)
    sky = DAYLIGHT.radiance(np.stack([y, y, y]))
    assert (sky.min(axis=1) >= DAYLIGHT.gradient.min(axis=0) - 1e-5).all()
    assert (sky.max(axis=1) <= DAYLIGHT.gradient.max(axis=0) + 1e-5).all()


def test_prefiltering_keeps_the_sky_s_sum():
    """Over all directions a lobe only moves light about."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    y = nodes.astype(np.float32)
    for roughness in (0.0, 0.4, 1.0):
        got = DAYLIGHT.prefiltered(np.stack([y, y, y]), np.full(len(y), roughness, np.float32))
        assert_allclose(got @ weights, DAYLIGHT.radiance(np.stack([y, y, y])) @ weights, rtol=2e-3)


def test_two_environments_do_not_share_tables():
    assert not np.allclose(furnace().irradiance(columns(DIRECTIONS)), DAYLIGHT.irradiance(columns(DIRECTIONS)))
    bright = Environment(gradient=2 * DAYLIGHT.gradient)
    assert_allclose(bright.irradiance(columns(DIRECTIONS)), 2 * DAYLIGHT.irradiance(columns(DIRECTIONS)), rtol=1e-6)


VIEWS = [0.05, 0.2, 0.5, 0.83, 1.0]


@pytest.mark.parametrize("roughness", [0.0, 0.15, 0.4, 0.7, 1.0])
def test_table_of_ggx_stays_within_two_hundredths_of_brute_force_and_within_four_thousandths_unless_steep(roughness):
    n = np.array([0, 0, 1.0])
    for nv in VIEWS:
        a, b = ggx_integral(np.array([nv], np.float32), np.array([roughness], np.float32))
        v = np.array([np.sqrt(1 - nv * nv), 0, nv])
        brute = [part[0] for part in naive.under_sky(n, v, roughness**2, naive.white)]
        assert_allclose([a[0], b[0]], brute, atol=0.02 if nv < 0.1 else 0.004)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_table_of_charlie_stays_within_five_thousandths_of_brute_force(roughness):
    n, alpha = np.array([0, 0, 1.0]), roughness**2
    around = naive.hemisphere(n, 400)
    for nv in VIEWS[1:]:
        v = np.array([np.sqrt(1 - nv * nv), 0, nv])
        half = around + v
        nh, nl = (half / np.linalg.norm(half, axis=1, keepdims=True)) @ n, around @ n
        lobe = (2 + 1 / alpha) * (1 - nh**2) ** (0.5 / alpha) / (2 * np.pi) / (4 * (nl + nv - nl * nv))
        got = charlie_integral(np.array([nv], np.float32), np.array([roughness], np.float32))
        assert_allclose(got[0], min(np.pi * lobe.mean(), 1), atol=0.005)


def test_no_lobe_reflects_more_than_it_gets():
    grid = np.meshgrid(np.linspace(float(LEAST), 1, 200), np.linspace(0, 1, 200))
    nv, roughness = (axis.ravel().astype(np.float32) for axis in grid)
    a, b = ggx_integral(nv, roughness)
    assert (a >= 0).all() and (b >= 0).all() and (a + b).max() <= 1 + 1e-6
    cloth = charlie_integral(nv, np.maximum(roughness, MIN_CHARLIE).astype(np.float32))
    assert cloth.min() >= 0 and cloth.max() <= 1


def test_look_up_clamps_and_counts_nan_as_zero():
    table = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    asked = np.array([-5, np.nan, np.inf, 0.5], np.float32)
    assert look_up(table, asked, np.zeros(4, np.float32)).T.tolist() == [[0, 1], [0, 1], [6, 7], [3, 4]]
    assert look_up(table, np.zeros(4, np.float32), asked).T.tolist() == [[0, 1], [0, 1], [4, 5], [2, 3]]
    with pytest.raises(ValueError, match="do not fit"):
        look_up(table, asked, asked[:2])
    with pytest.raises(ValueError, match="do not fit"):
        look_up(table[:1], asked, asked)
