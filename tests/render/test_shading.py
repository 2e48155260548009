"""Lit materials: how near they are to brute force, that they make no light, and what each term must do."""

import math

import numpy as np
import pytest
from lit import COUNT, directions, lit, table_of
from numpy.testing import assert_allclose

from oracles import shading as naive
from texfcodec.render.environment import DAYLIGHT, Environment, Light, furnace
from texfcodec.render.lobes import ggx_lights, ggx_lights_stretched
from texfcodec.render.material import expose, shade
from texfcodec.render.shading_points import ShadingPoints
from texfcodec.render.thin_film import film_reflectance

# Against brute force: sky by quadrature, glTF's BRDF in float64; decibels of sRGB-coded colour, over directions.

MATERIALS = [("white plastic", (0.8, 0.8, 0.8), 0, 0.3, 50), ("matt red", (0.6, 0.1, 0.1), 0, 0.9, 50),
             ("gloss black", (0.02,) * 3, 0, 0.1, 55), ("polished gold", (1, 0.8, 0.4), 1, 0.2, 42),
             ("brushed gold", (1, 0.8, 0.4), 1, 0.5, 35), ("cast iron", (0.6, 0.55, 0.5), 1, 0.8, 38),
             ("mirror", (0.9, 0.9, 0.9), 1, 0.0, 65), ("half metal", (0.5, 0.6, 0.7), 0.5, 0.6, 39)]


@pytest.mark.parametrize("name, base, metallic, roughness, decibels", MATERIALS, ids=[m[0] for m in MATERIALS])
def test_core_material_is_as_near_to_brute_force_as_stated(name, base, metallic, roughness, decibels):
    n, v = directions(24, seed=3, steepest=0.1)
    lights = [(light.direction, light.irradiance, light.radius) for light in DAYLIGHT.lights]
    brute = [naive.radiance(DAYLIGHT.gradient, lights, a, b, base, metallic, roughness)
             for a, b in zip(n.astype(float), v.astype(float), strict=True)]
    got = lit(base=base, seen=(n, v), metallic=metallic, roughness=roughness)
    error = expose(got) - expose(np.array(brute, np.float32))
    assert 10 * math.log10(255**2 / np.mean(error**2)) > decibels


@pytest.mark.parametrize("base", [(0.04,) * 3, (0.9, 0.6, 0.3)])
@pytest.mark.parametrize("ior", [1.3, 1.8])
@pytest.mark.parametrize("nanometres", [150, 400, 800])
def test_thin_film_stays_within_five_hundredths_of_the_sum_over_wavelengths(base, ior, nanometres):
    cosine = np.array([0.3, 0.7, 1.0], np.float32)
    bare = np.repeat(np.array(base, np.float32)[:, None], 3, axis=1)
    got = film_reflectance(cosine, bare, np.full(3, ior, np.float32), np.full(3, nanometres, np.float32))
    brute = np.array([naive.film(float(c), base, ior, nanometres) for c in cosine])
    assert_allclose(got.T, brute, atol=0.05)


# Energy.


STACKS = {"bare": {}, "clear coat": {"clearcoat": 1, "clearcoat_roughness": 0.3},
          "sheen": {"sheen_colour": (1, 1, 1), "sheen_roughness": 0.6}, "thin glass": {"transmission": 1},
          "thick glass": {"transmission": 0.7, "thickness": 1, "dispersion": 2}, "paper": {"diffuse_transmission": 0.5},
          "strong specular": {"ior": 2.4}, "all": {"clearcoat": 0.5, "sheen_colour": (1, 1, 1), "sheen_roughness": 0.4,
                                                   "transmission": 0.5, "diffuse_transmission": 0.5, "ior": 1.8}}


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("metallic", [0, 0.5, 1])
def test_white_furnace_loses_and_gains_at_most_one_percent(stack, metallic):
    for roughness in (0, 0.3, 0.6, 1):
        got = lit(furnace(), base=(1, 1, 1), metallic=metallic, roughness=roughness, **STACKS[stack])
        assert_allclose(got, 1, atol=0.01)


def test_no_coloured_material_gives_more_than_it_gets():
    rng = np.random.default_rng(2)
    shares = ("metallic", "roughness", "clearcoat", "clearcoat_roughness", "sheen_roughness", "specular", "transmission",
              "thickness", "diffuse_transmission", "attenuation_distance", "iridescence", "anisotropy")
    colours = ("base", "sheen_colour", "specular_colour", "diffuse_transmission_colour", "attenuation_colour")
    for _ in range(60):
        drawn = {name: rng.random() for name in shares} | {name: tuple(rng.random(3)) for name in colours}
        got = lit(furnace(), ior=1 + rng.random(), **drawn)
        assert got.max() <= 1.01 and got.min() >= 0


def ring_of_lights(n, rings=48):
    """The white sky over a normal as many lights of equal effect."""
    around = naive.hemisphere(np.asarray(n, float), rings)
    each = math.pi / len(around) / (around @ n)
    return tuple(Light(direction=d, irradiance=np.full(3, e), radius=0.0) for d, e in zip(around, each, strict=True))


@pytest.mark.parametrize("parameters", [
    {"metallic": 1, "roughness": 0.5}, {"metallic": 1, "roughness": 1}, {"metallic": 0, "roughness": 0.6},
    {"metallic": 1, "roughness": 0.5, "anisotropy": 0.6}, {"metallic": 0, "sheen_colour": (1, 1, 1), "sheen_roughness": 0.7},
], ids=str)
def test_furnace_made_of_lights_agrees_with_the_sky_within_four_percent(parameters):
    """The lobes under lights and their tables under a sky are made in different ways. An anisotropic lobe has no table of its
    own."""
    n = np.array([0, 0, 1], np.float32)
    environment = Environment(gradient=np.zeros((9, 3)), lights=ring_of_lights(n))
    views = np.array([naive.unit((math.sqrt(1 - c * c), 0, c)) for c in (0.3, 0.6, 0.95)], np.float32)
    got = lit(environment, base=(1, 1, 1), seen=(np.tile(n, (3, 1)), views), **parameters)
    assert_allclose(got, 1, atol=0.25 if "anisotropy" in parameters else 0.04)


# Laws.


def test_lobes_are_reciprocal():
    n, v = directions(seed=5)
    l = directions(seed=6)[1]
    l = np.where(np.einsum("mk,mk->m", n, l)[:, None] < 0, -l, l)
    columns = lambda a: np.ascontiguousarray(a.T)
    side = np.cross(n, np.roll(n, 1, axis=1) + [0.3, 0.1, 0.2])
    side = (side / np.linalg.norm(side, axis=1, keepdims=True)).astype(np.float32)
    other = np.cross(n, side).astype(np.float32)
    alpha = np.full(1, 0.3, np.float32)
    for i in range(0, len(n), 5):
        both = []
        for eye, light in ((v, l), (l, v)):
            lamp = (Light(direction=light[i].astype(float), irradiance=np.ones(3), radius=0.05),)
            nv, nl = (np.maximum(n[i : i + 1] @ d[i], 1e-3).astype(np.float32) for d in (eye, light))
            one = slice(i, i + 1)
            surface = columns(n[one]), columns(eye[one]), nv
            round_lobe = ggx_lights(*surface, alpha, lamp)
            long_lobe = ggx_lights_stretched(*surface, (columns(side[one]), columns(other[one])), (2 * alpha, alpha), lamp)
            both.append(np.concatenate([(s.spec + s.spec_edge)[:, 0] / nl for s in (round_lobe, long_lobe)]))
        assert_allclose(both[0], both[1], rtol=2e-3)


def test_a_perfect_mirror_shows_the_sky_in_its_colour():
    n, v = directions(steepest=0.3)
    mirror = 2 * np.einsum("mk,mk->m", n, v)[:, None] * n - v
    got = lit(Environment(gradient=DAYLIGHT.gradient), base=(1, 1, 1), seen=(n, v), metallic=1, roughness=0)
    assert_allclose(got, naive.sky(DAYLIGHT.gradient, mirror.astype(float)), atol=0.01)


def test_at_grazing_angles_everything_smooth_is_a_mirror():
    n, v = np.array([[0, 1, 0]], np.float32), np.array([naive.unit((1, 0.01, 0))], np.float32)
    for metallic, base in ((0, 0.0), (1, 0.2)):
        assert lit(furnace(), base=(base,) * 3, seen=(n, v), metallic=metallic, roughness=0.0).min() > 0.9


def test_full_occlusion_leaves_the_lights_alone():
    dark = Environment(gradient=np.zeros((9, 3)), lights=DAYLIGHT.lights)
    assert_allclose(lit(channels={"occlusion": [0.0]}), lit(dark), atol=1e-6)
    assert_allclose(lit(channels={"occlusion": [1.0]}), lit(), atol=1e-6)


def test_emission_adds_and_the_coat_dims_it():
    black = Environment(gradient=np.zeros((9, 3)))
    assert_allclose(lit(black, emissive=(0.5, 0.25, 0), emissive_strength=4), np.tile([2, 1, 0], (COUNT, 1)), rtol=1e-6)
    coated = lit(black, emissive=(1, 1, 1), clearcoat=1)
    assert (coated < 0.97).all() and (coated > 0).all()


def test_a_clear_thin_sheet_shows_the_sky_behind_it():
    n, v = directions(steepest=0.9)
    glass = dict(base=(1, 1, 1), metallic=0, transmission=1, roughness=0, specular=0)
    got = lit(Environment(gradient=DAYLIGHT.gradient), seen=(n, v), **glass)
    assert_allclose(got, naive.sky(DAYLIGHT.gradient, -v.astype(float)), atol=0.01)


def test_volume_takes_away_its_colour_once_a_distance():
    glass = dict(metallic=0, transmission=1, roughness=0, specular=0, ior=1, base=(1, 1, 1))
    clear = lit(furnace(), thickness=2, **glass)
    tinted = lit(furnace(), thickness=2, attenuation_distance=1, attenuation_colour=(0.9, 0.5, 0.2), **glass)
    assert_allclose(tinted / clear, np.tile([0.81, 0.25, 0.04], (COUNT, 1)), rtol=1e-4)


def test_dispersion_parts_the_colours():
    white = Environment(gradient=np.repeat(np.linspace(0, 1, 9)[:, None], 3, axis=1))
    glass = dict(metallic=0, transmission=1, roughness=0, thickness=1, base=(1, 1, 1))
    plain, parted = lit(white, **glass), lit(white, dispersion=5, **glass)
    assert np.ptp(plain, axis=1).max() < 1e-6 < 0.01 < np.ptp(parted, axis=1).max()
    assert_allclose(parted[:, 1], plain[:, 1], atol=1e-6)


def test_anisotropy_stretches_the_highlight_along_its_direction():
    above = Light(direction=np.array([0, 0, 1.0]), irradiance=np.ones(3), radius=0.05)
    lamp = Environment(gradient=np.zeros((9, 3)), lights=(above,))
    n, tangent = np.tile(np.array([0, 0, 1], np.float32), (2, 1)), np.tile(np.array([1, 0, 0, 1], np.float32), (2, 1))
    v = np.array([naive.unit((0.6, 0, 1)), naive.unit((0, 0.6, 1))], np.float32)

    def seen(**more):
        table = table_of({"metallic": 1, "roughness": 0.3, "anisotropy": 0.9, **more})
        return shade(ShadingPoints(material=np.zeros(2, np.int64), normal=n, view=v, tangent=tangent), table, lamp)[:, 0]

    along, across = seen()
    assert along > 3 * across
    turned = seen(anisotropy_rotation=math.pi / 2)
    assert_allclose(turned, [across, along], rtol=1e-3)
    assert_allclose(seen(anisotropy_rotation=math.pi), [along, across], rtol=1e-3)
