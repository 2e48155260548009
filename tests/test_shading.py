"""Lit materials: what the core material and each effect must do, what they cost where they are not used, and what bad input gives."""

import itertools
import math

import numpy as np
import pytest
from naive import shading as naive
from numpy.testing import assert_allclose, assert_array_equal

from texfcodec.asset.srgb import linear_to_srgb
from texfcodec.render import material as shading
from texfcodec.render import terms
from texfcodec.render.effects import DEFAULTS, EFFECTS, ShadingTable, effects_of, full_parameters
from texfcodec.render.environment import DAYLIGHT, Environment, Light, furnace
from texfcodec.render.lobes import ggx_lights, ggx_lights_stretched
from texfcodec.render.material import expose, shade
from texfcodec.render.surface import Points
from texfcodec.render.thin_film import film_reflectance

COUNT = 300


def directions(count=COUNT, seed=0, steepest=0.05):
    """Normals and views [count, 3] float32, unit, the views above the surface."""
    rng = np.random.default_rng(seed)
    n, v = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in rng.normal(size=(2, 8 * count, 3)))
    n = np.where(np.einsum("mk,mk->m", n, v)[:, None] < 0, -n, n)
    chosen = np.flatnonzero(np.einsum("mk,mk->m", n, v) > steepest)[:count]
    return n[chosen].astype(np.float32), v[chosen].astype(np.float32)


def lit(environment=DAYLIGHT, channels=None, base=(0.7, 0.5, 0.3), seen=None, unlit=False, **parameters):
    """Radiance [M, 3] of one material. channels: values by name, one per point or one for all."""
    n, v = directions() if seen is None else seen
    fill = lambda value: np.broadcast_to(np.asarray(value, np.float32), (len(n), np.shape(value)[-1]))
    values = {name: fill(value) for name, value in {"base_colour": base, **(channels or {})}.items()}
    table = ShadingTable(parameters=[{k: np.atleast_1d(p) for k, p in parameters.items()}], channels=[set(channels or {})], unlit=[unlit])
    return shade(Points(material=np.zeros(len(n), np.int64), normal=n, view=v, values=values), table, environment)


# Against brute force: sky by quadrature, glTF's BRDF in float64; decibels of sRGB-coded colour, over directions.

MATERIALS = [("white plastic", (0.8, 0.8, 0.8), 0, 0.3, 50), ("matt red", (0.6, 0.1, 0.1), 0, 0.9, 50), ("gloss black", (0.02,) * 3, 0, 0.1, 55),
             ("polished gold", (1, 0.8, 0.4), 1, 0.2, 42), ("brushed gold", (1, 0.8, 0.4), 1, 0.5, 35), ("cast iron", (0.6, 0.55, 0.5), 1, 0.8, 38),
             ("mirror", (0.9, 0.9, 0.9), 1, 0.0, 65), ("half metal", (0.5, 0.6, 0.7), 0.5, 0.6, 39)]


@pytest.mark.parametrize("name, base, metallic, roughness, decibels", MATERIALS, ids=[m[0] for m in MATERIALS])
def test_core_material_is_as_near_to_brute_force_as_stated(name, base, metallic, roughness, decibels):
    n, v = directions(40, seed=3, steepest=0.1)
    lights = [(light.direction, light.irradiance, light.radius) for light in DAYLIGHT.lights]
    brute = [naive.radiance(DAYLIGHT.gradient, lights, a, b, base, metallic, roughness)
             for a, b in zip(n.astype(float), v.astype(float), strict=True)]
    got = lit(base=base, seen=(n, v), metallic=metallic, roughness=roughness)
    error = expose(got) - expose(np.array(brute, np.float32))
    assert 10 * math.log10(255**2 / np.mean(error**2)) > decibels


@pytest.mark.parametrize("base, ior, nanometres", list(itertools.product([(0.04,) * 3, (0.9, 0.6, 0.3)], [1.3, 1.8], [150, 400, 800])))
def test_thin_film_stays_within_five_hundredths_of_the_sum_over_wavelengths(base, ior, nanometres):
    cosine = np.array([0.3, 0.7, 1.0], np.float32)
    got = film_reflectance(cosine, np.repeat(np.array(base, np.float32)[:, None], 3, 1), *(np.full(3, x, np.float32) for x in (ior, nanometres)))
    brute = np.array([naive.film(float(c), base, ior, nanometres) for c in cosine])
    assert_allclose(got.T, brute, atol=0.05)


# Energy.


STACKS = {"bare": {}, "clear coat": {"clearcoat": 1, "clearcoat_roughness": 0.3}, "sheen": {"sheen_colour": (1, 1, 1), "sheen_roughness": 0.6},
          "thin glass": {"transmission": 1}, "thick glass": {"transmission": 0.7, "thickness": 1, "dispersion": 2},
          "paper": {"diffuse_transmission": 0.5}, "strong specular": {"ior": 2.4}, "all": {
              "clearcoat": 0.5, "sheen_colour": (1, 1, 1), "sheen_roughness": 0.4, "transmission": 0.5, "diffuse_transmission": 0.5, "ior": 1.8}}


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("metallic", [0, 0.5, 1])
def test_white_furnace_loses_and_gains_at_most_one_percent(stack, metallic):
    for roughness in (0, 0.3, 0.6, 1):
        got = lit(furnace(), base=(1, 1, 1), metallic=metallic, roughness=roughness, **STACKS[stack])
        assert_allclose(got, 1, atol=0.01)


def test_no_coloured_material_gives_more_than_it_gets():
    rng = np.random.default_rng(2)
    for _ in range(60):
        colour = lambda: tuple(rng.random(3))
        got = lit(furnace(), base=colour(), metallic=rng.random(), roughness=rng.random(), clearcoat=rng.random(), clearcoat_roughness=rng.random(),
                  sheen_colour=colour(), sheen_roughness=rng.random(), specular=rng.random(), specular_colour=colour(), ior=1 + rng.random(),
                  transmission=rng.random(), diffuse_transmission=rng.random(), diffuse_transmission_colour=colour(), thickness=rng.random(),
                  attenuation_distance=rng.random(), attenuation_colour=colour(), iridescence=rng.random(), anisotropy=rng.random())
        assert got.max() <= 1.01 and got.min() >= 0


def ring_of_lights(n, rings=48):
    """The white sky over a normal as many lights of equal effect."""
    around = naive.hemisphere(np.asarray(n, float), rings)
    each = math.pi / len(around) / (around @ n)
    return tuple(Light(direction=d, irradiance=np.full(3, e), radius=0.0) for d, e in zip(around, each, strict=True))


@pytest.mark.parametrize("parameters", [{"metallic": 1, "roughness": 0.5}, {"metallic": 1, "roughness": 1}, {"metallic": 0, "roughness": 0.6},
                                        {"metallic": 1, "roughness": 0.5, "anisotropy": 0.6}, {"metallic": 0, "sheen_colour": (1, 1, 1), "sheen_roughness": 0.7}],
                         ids=str)
def test_furnace_made_of_lights_agrees_with_the_sky_within_four_percent(parameters):
    """The lobes under lights and their tables under a sky are made in different ways. An anisotropic lobe has no table of its own."""
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
            round_lobe = ggx_lights(columns(n[one]), columns(eye[one]), nv, alpha, lamp)
            long_lobe = ggx_lights_stretched(columns(n[one]), columns(eye[one]), nv, (columns(side[one]), columns(other[one])), (2 * alpha, alpha), lamp)
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


def test_matt_surfaces_give_their_irradiance():
    n, v = directions(steepest=0.5)
    got = lit(Environment(gradient=DAYLIGHT.gradient), base=(1, 1, 1), seen=(n, v), metallic=0, specular=0, roughness=1)
    brute = np.array([naive.sky(DAYLIGHT.gradient, naive.hemisphere(a.astype(float), 32)).mean(axis=0) for a in n])
    assert_allclose(got, brute, atol=2e-3)


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
    got = lit(Environment(gradient=DAYLIGHT.gradient), base=(1, 1, 1), seen=(n, v), metallic=0, transmission=1, roughness=0, specular=0)
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
    lamp = Environment(gradient=np.zeros((9, 3)), lights=(Light(direction=np.array([0, 0, 1.0]), irradiance=np.ones(3), radius=0.05),))
    n, v = np.tile(np.array([0, 0, 1], np.float32), (2, 1)), np.array([naive.unit((0.6, 0, 1)), naive.unit((0, 0.6, 1))], np.float32)

    def seen(**more):
        table = ShadingTable(parameters=[{"metallic": (1,), "roughness": (0.3,), "anisotropy": (0.9,), **more}], channels=[set()], unlit=[False])
        tangent = np.tile(np.array([1, 0, 0, 1], np.float32), (2, 1))
        return shade(Points(material=np.zeros(2, np.int64), normal=n, view=v, tangent=tangent), table, lamp)[:, 0]

    along, across = seen()
    assert along > 3 * across
    turned = seen(anisotropy_rotation=(math.pi / 2,))
    assert_allclose(turned, [across, along], rtol=1e-3)
    assert_allclose(seen(anisotropy_rotation=(math.pi,)), [along, across], rtol=1e-3)


# What is off is absent, and costs nothing.

FAINT = {"occlusion": ({"occlusion": [1 - 1e-5]}, {}), "emission": ({}, {"emissive": (1e-5,) * 3}), "specular": ({}, {"ior": 1.50001}),
         "clearcoat": ({}, {"clearcoat": 1e-5}), "sheen": ({}, {"sheen_colour": (1e-5,) * 3, "sheen_roughness": 0.3}),
         "transmission": ({}, {"transmission": 1e-5}), "volume": ({}, {"transmission": 1e-5, "thickness": 1}),
         "dispersion": ({}, {"transmission": 1e-5, "thickness": 1, "dispersion": 1}), "iridescence": ({}, {"iridescence": 1e-5}),
         "anisotropy": ({}, {"anisotropy": 1e-4}), "diffuse_transmission": ({}, {"diffuse_transmission": 1e-5})}


def test_every_effect_has_a_faint_form():
    assert set(FAINT) == {effect.name for effect in EFFECTS}


@pytest.mark.parametrize("name", FAINT)
def test_a_faint_effect_is_hardly_seen_and_one_that_is_off_is_absent(name):
    channels, parameters = FAINT[name]
    for metallic, roughness in ((0, 0.3), (1, 0.7), (0.5, 0.5)):
        bare = lit(metallic=metallic, roughness=roughness)
        # the stretched lobe takes its squares of lengths in another order: its highlight differs by rounding, hence the share
        assert_allclose(lit(channels=channels, metallic=metallic, roughness=roughness, **parameters), bare, atol=1e-3, rtol=2e-3)
        off = {p: np.zeros(len(DEFAULTS[p])) for p in parameters if p != "ior"}
        assert_array_equal(lit(metallic=metallic, roughness=roughness, **off), bare)


TERMS = {"occlusion": "occlusion", "emission": "emission", "specular": "specular", "clearcoat": "clearcoat", "sheen": "sheen",
         "transmission": "transmission", "volume": "volume", "dispersion": "dispersed", "iridescence": "iridescence",
         "anisotropy": "anisotropic_gloss", "diffuse_transmission": "diffuse_transmission"}


@pytest.mark.parametrize("name", TERMS)
def test_a_term_is_evaluated_only_at_points_whose_material_uses_it(name, monkeypatch):
    asked = {term: 0 for term in (*TERMS.values(), "gloss", "diffuse")}
    for term in asked:
        def counted(surface, *more, term=term, real=getattr(terms, term)):
            asked[term] += len(surface.material)
            return real(surface, *more)

        monkeypatch.setattr(terms, term, counted)
    channels, parameters = FAINT[name]
    n, v = directions()
    material = np.arange(COUNT) % 3
    table = ShadingTable(parameters=[{"metallic": (0.5,)}, {"metallic": (0,), **{k: np.atleast_1d(p) for k, p in parameters.items()}}, {"clearcoat": (1,)}],
                         channels=[set(), set(channels), set()], unlit=[False, False, True])
    values = {c: np.broadcast_to(np.float32(x), (COUNT, len(x))) for c, x in channels.items()}
    shade(Points(material=material, normal=n, view=v, values=values), table, DAYLIGHT)
    used = {TERMS[effect] for effect in table.effects[1]}
    users = int((material == 1).sum())
    assert asked["gloss"] + asked["anisotropic_gloss"] == asked["diffuse"] == int((material < 2).sum())
    assert {term: asked[term] for term in TERMS.values()} == {term: users if term in used else 0 for term in TERMS.values()}


def test_unlit_materials_give_their_base_colour_and_ask_nothing(monkeypatch):
    for term in ("gloss", "diffuse", "emission", "clearcoat"):
        monkeypatch.setattr(terms, term, None)
    monkeypatch.setattr(Environment, "build", None)
    base = np.random.default_rng(0).random((COUNT, 3)).astype(np.float32)
    bright = Environment(gradient=DAYLIGHT.gradient, exposure=4.0)
    got = expose(lit(bright, base=base, unlit=True, emissive=(1, 1, 1), clearcoat=1), bright.exposure)
    assert_allclose(got, 255 * linear_to_srgb(base), atol=1e-3)


# Effects and their table.


def test_only_what_shows_is_an_effect():
    assert effects_of({}) == frozenset()
    assert effects_of({"clearcoat": (1,), "emissive": (1, 1, 1)}, {"occlusion"}, unlit=True) == {"unlit"}
    assert effects_of({"clearcoat": (0,), "sheen_roughness": (1,), "iridescence_ior": (2,)}, {"clearcoat", "sheen_colour"}) == frozenset()
    assert effects_of({"thickness": (1,), "dispersion": (1,)}) == frozenset()  # nothing goes through
    assert effects_of({"thickness": (1,), "diffuse_transmission": (1,)}) == {"volume", "diffuse_transmission"}
    assert effects_of({"occlusion_strength": (0,)}, {"occlusion"}) == frozenset()
    assert effects_of({}, {"specular_colour"}) == {"specular"}


def test_parameters_that_make_no_sense_count_as_something_that_does():
    full = full_parameters({"clearcoat": (math.nan,), "ior": (1, 2), "emissive_strength": (1e9,), "transmission": (-1,),
                            "anisotropy_rotation": (-1.5,), "attenuation_distance": (math.inf,), "unheard_of": (1,)})
    assert full == {**DEFAULTS, "emissive_strength": (65504.0,), "transmission": (0.0,), "anisotropy_rotation": (-1.5,)}


def test_table_wants_the_channels_of_its_effects_and_no_others():
    maps = {"base_colour", "roughness", "normal", "emissive", "clearcoat", "sheen_roughness", "occlusion"}
    table = ShadingTable(parameters=[{"emissive": (1, 1, 1)}, {"clearcoat": (1,)}], channels=[maps, maps], unlit=[False, True])
    assert table.wanted_channels() == {"base_colour", "roughness", "normal", "emissive", "occlusion"}
    assert table.is_lit
    dark = ShadingTable(parameters=[{}], channels=[maps], unlit=[True])
    assert dark.wanted_channels() == {"base_colour"} and not dark.is_lit


def test_final_values_are_map_times_factor():
    table = ShadingTable(parameters=[{}, {"roughness": (0.5,), "occlusion_strength": (0.25,), "anisotropy": (0.5,)}], channels=[(), ()], unlit=[False, False])
    material = np.array([0, 1])
    assert table.final("roughness", material, np.full((2, 1), 0.5)).tolist() == [[0.5], [0.25]]
    assert table.final("occlusion", material, np.zeros((2, 1))).tolist() == [[0.0], [0.75]]
    assert table.final("anisotropy", material, np.full((2, 3), 0.5)).tolist() == [[0.5, 0.5, 0.0], [0.5, 0.5, 0.25]]
    assert table.constant("roughness", material).tolist() == [[1.0], [0.5]]
    assert table.constant("anisotropy", material).tolist() == [[1.0, 0.5, 0.0], [1.0, 0.5, 0.5]]


def test_a_material_that_is_not_there_is_an_error():
    n, v = directions(3)
    with pytest.raises(IndexError, match="outside the table"):
        shade(Points(material=np.array([0, 1, 0]), normal=n, view=v), ShadingTable(parameters=[{}], channels=[()], unlit=[False]), DAYLIGHT)


# Bad input and threads.


def everything(rng, count):
    """Points and a table of materials that use all effects, none, and some."""
    widths = {"base_colour": 3, "roughness": 1, "metallic": 1, "occlusion": 1, "emissive": 3, "clearcoat": 1, "clearcoat_roughness": 1,
              "sheen_colour": 3, "sheen_roughness": 1, "specular": 1, "specular_colour": 3, "transmission": 1, "thickness": 1, "iridescence": 1,
              "iridescence_thickness": 1, "anisotropy": 3, "diffuse_transmission": 1, "diffuse_transmission_colour": 3}
    every = {name: tuple(2 * rng.random(len(default))) for name, default in DEFAULTS.items()}
    table = ShadingTable(parameters=[every, {}, {"clearcoat": (1,)}, {"dispersion": (1,), "transmission": (1,), "thickness": (1,)}],
                         channels=[set(widths), set(), {"occlusion"}, set()], unlit=[False, False, False, True])
    values = {name: rng.random((count, width)).astype(np.float32) for name, width in widths.items()}
    n, v = (rng.normal(size=(count, 3)).astype(np.float32) for _ in range(2))
    return Points(material=rng.integers(0, 4, count), normal=n, view=v, values=values, tangent=rng.normal(size=(count, 4)).astype(np.float32),
                  coat_normal=rng.normal(size=(count, 3)).astype(np.float32)), table


@pytest.mark.parametrize("seed", range(4))
def test_extreme_input_gives_finite_colours(seed):
    rng = np.random.default_rng(seed)
    points, table = everything(rng, 4000)
    odd = np.array([np.nan, np.inf, -np.inf, 0, -0.0, 1e-40, 1e-20, 1e20, 3e38, -3e38, 1, -1, 0.5], np.float32)
    for array in (points.normal, points.view, points.tangent, points.coat_normal, *points.values.values()):
        hit = rng.random(array.shape) < 0.2
        array[hit] = rng.choice(odd, hit.sum())
    points.normal[:50], points.view[25:75] = points.view[:50], -points.normal[25:75]  # straight on, and from straight behind
    got = shade(points, table, DAYLIGHT)
    assert np.isfinite(got).all() and got.min() >= 0
    coded = expose(got)
    assert coded.min() >= 0 and coded.max() <= 255


@pytest.mark.parametrize("parameters", [{"ior": 0}, {"ior": 65504, "transmission": 1, "thickness": 1, "dispersion": 65504}, {"attenuation_distance": 0, "transmission": 1, "thickness": 65504},
                                        {"iridescence": 1, "iridescence_ior": 0, "iridescence_thickness": (65504, 0)}, {"iridescence": 1, "iridescence_ior": 65504},
                                        {"emissive": (65504,) * 3, "emissive_strength": 65504}, {"sheen_colour": (65504,) * 3}, {"specular": 65504, "specular_colour": (65504,) * 3},
                                        {"anisotropy": 65504, "anisotropy_rotation": 65504}, {"clearcoat": 65504, "clearcoat_roughness": 65504}, {"roughness": 65504, "metallic": 65504}],
                         ids=str)
def test_extreme_parameters_give_finite_colours(parameters):
    """Factors above 1 without a map count as 1, as in a map."""
    got = lit(**parameters)
    assert np.isfinite(got).all() and got.min() >= 0
    if "emissive" not in parameters:
        assert lit(furnace(), **parameters).max() <= 1.02


@pytest.mark.parametrize("kind", ["normal", "view", "both"])
def test_directions_without_a_direction_count_as_the_view_or_as_z(kind):
    n, v = directions(4)
    z = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    for bad in (0, np.nan):
        broken = np.full_like(n, bad)
        got = lit(seen=(n if kind == "view" else broken, v if kind == "normal" else broken))
        assert_array_equal(got, lit(seen=(v if kind == "normal" else z if kind == "both" else n, v if kind == "normal" else z)))


def test_result_does_not_depend_on_threads(monkeypatch):
    points, table = everything(np.random.default_rng(9), 3000)
    monkeypatch.setattr(shading, "BLOCK", 128)
    assert_array_equal(shade(points, table, DAYLIGHT, threads=1), shade(points, table, DAYLIGHT, threads=4))


def test_groups_and_blocks_do_not_change_a_point(monkeypatch):
    points, table = everything(np.random.default_rng(8), 700)
    together = shade(points, table, DAYLIGHT)
    monkeypatch.setattr(shading, "BLOCK", 100)
    assert_allclose(shade(points, table, DAYLIGHT), together, rtol=1e-5, atol=1e-6)


def test_no_points_are_no_colours():
    got = shade(Points(material=np.zeros(0, np.int64), normal=np.zeros((0, 3), np.float32), view=np.zeros((0, 3), np.float32)),
                ShadingTable(parameters=[{}], channels=[()], unlit=[False]), DAYLIGHT)
    assert got.shape == (0, 3) and expose(got).shape == (0, 3)


def test_exposure_multiplies_before_coding_and_clamps():
    light = np.array([[0, 0.5, 1], [2, np.nan, -1], [np.inf, 0.25, 1e-3]], np.float32)
    assert_allclose(expose(light, 2), 255 * linear_to_srgb([[0, 1, 1], [1, 0, 0], [1, 0.5, 2e-3]]), atol=2e-3)
